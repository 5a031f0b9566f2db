/* Creep and relaxation in fixed point, and their exact inverse. f32_creep.h says how they work. What is different here:
 *
 * - Displacements are not relative to h_0: what h_0 adds is a constant.
 * - The states have 32 bits of fraction. A pole of any time constant moves on by what is left to go in whole units, so
 *   nothing is lost in a second part, and the sums of products are exact.
 *
 * Scaling and overflow: |h| and all states are < 2^30, so they differ by less than 2^31. The share of what comes at
 * once and the magnitudes of all others add up to 2 at most, weights are no larger than their shares, and references
 * are < 2^31. In 2^30 z = within h + sum weight m + settled, the terms are therefore < 2^61, 2^61, 2^61 and 2^60; a
 * slow pole is taken further by up to 1.5 times what it moves, which is 2^-6 of the way at most, because there are 64
 * poles at most. */
#ifndef RDPI_Q31_CREEP_H
#define RDPI_Q31_CREEP_H

#include "q31_blend.h"
#include "rdpi/q31_chain.h"

/* Poles of more samples than this are slow. */
#define SLOW_SAMPLES 4096u

/* The largest |h|. */
#define MAX_H (RDPI_Q31_ONE - 1)

/* (1 - exp(-u)) / u, times 2^30. Never more than 2^30, because a blend is rounded down from u. */
static inline int32_t rdpi_q31_creep_mean(rdpi_q31_scaled_t u)
{
    rdpi_q31_scaled_t blend = rdpi_q31_blend(u);
    uint64_t mantissa = blend.mantissa > 0u ? blend.mantissa : (uint64_t)1 << 32;
    return (int32_t)(((mantissa << 30) / u.mantissa) >> (blend.exponent - u.exponent)); /* by 32 at most: u < 2^32 */
}

/* Sets up one pole, which moves every `samples` samples. Fast ones move in each. */
static inline void rdpi_q31_creep_pole(rdpi_q31_lag_t *lag, const rdpi_q31_pole_t *pole, uint32_t sample_time_ns,
                                       bool fast, unsigned samples)
{
    rdpi_q31_scaled_t u = rdpi_q31_ratio(sample_time_ns, pole->time_constant_ns);
    rdpi_q31_scaled_t blend =
        rdpi_q31_blend(rdpi_q31_ratio((uint64_t)sample_time_ns * samples, pole->time_constant_ns));
    uint32_t mantissa = blend.mantissa > 0u ? blend.mantissa : UINT32_MAX;
    lag->per_sample = u.mantissa;
    lag->exponent = (uint8_t)u.exponent;
    lag->weight = (int32_t)(rdpi_q31_mul(pole->share, rdpi_q31_creep_mean(u)) >> 30);
    lag->blend = (int32_t)(mantissa >> (fast ? blend.exponent - 31 : 1));
    lag->shift = (uint8_t)(fast ? 0 : blend.exponent - 33);
}

/* Sets up the poles of checked parameters, the fast ones first. Their state is that of rdpi_q31_creep_settle. */
static inline void rdpi_q31_creep_init(rdpi_q31_creep_t *creep, const rdpi_q31_chain_params_t *params,
                                       uint32_t sample_time_ns)
{
    const uint64_t slowest = (uint64_t)sample_time_ns * SLOW_SAMPLES;
    uint32_t within = (uint32_t)params->direct; /* a sample, times 2^30 */
    unsigned fast = 0, slow = 0;
    for (size_t i = 0; i < params->poles; i++) {
        fast += params->pole[i].time_constant_ns <= slowest ? 1u : 0u;
    }
    creep->fast = (uint16_t)fast;
    creep->poles = params->poles;
    slow = params->poles - fast;
    creep->per_round = slow > 0u ? ((uint32_t)1 << 31) / slow : 0u;
    rdpi_q31_lag_t *next_fast = creep->lag, *next_slow = &creep->lag[fast];
    for (size_t i = 0; i < params->poles; i++) {
        const rdpi_q31_pole_t *pole = &params->pole[i];
        rdpi_q31_lag_t *lag;
        if (pole->time_constant_ns <= slowest) {
            lag = next_fast;
            next_fast++;
            rdpi_q31_creep_pole(lag, pole, sample_time_ns, true, 1);
        } else {
            lag = next_slow;
            next_slow++;
            rdpi_q31_creep_pole(lag, pole, sample_time_ns, false, slow);
        }
        within += (uint32_t)pole->share - (uint32_t)lag->weight;
    }
    creep->per_direct = (int32_t)((((uint64_t)1 << 58) + within / 2u) / within);
}

/* What a pole adds to the displacement, times 2^30. */
static inline int64_t rdpi_q31_creep_adds(const rdpi_q31_lag_t *lag)
{
    return rdpi_q31_mul(lag->weight, (int32_t)(lag->state >> 32));
}

/* How far a pole is from `h`. */
static inline int32_t rdpi_q31_creep_left(const rdpi_q31_lag_t *lag, int32_t h)
{
    return h - (int32_t)(lag->state >> 32);
}

/* Creep has settled at `h`. */
static inline void rdpi_q31_creep_settle(rdpi_q31_creep_t *creep, const rdpi_q31_chain_params_t *params, int32_t h)
{
    int32_t constant = RDPI_Q31_ONE - params->direct;
    creep->h = rdpi_q31_clamp(h, -MAX_H, MAX_H);
    creep->mean = creep->h;
    creep->slow = 0;
    creep->next = 0;
    creep->sum = 0;
    creep->turn = creep->fast;
    for (size_t i = 0; i < creep->poles; i++) {
        rdpi_q31_lag_t *lag = &creep->lag[i];
        lag->state = creep->h * ((int64_t)1 << 32);
        constant -= params->pole[i].share;
        creep->slow += i < creep->fast ? 0 : rdpi_q31_creep_adds(lag);
    }
    creep->settled = rdpi_q31_mul(constant, creep->h);
}

/* `total`, times 2^30, less what all poles and h_0 add. */
static inline int64_t rdpi_q31_creep_less(const rdpi_q31_creep_t *creep, int64_t total)
{
    const rdpi_q31_lag_t *end = &creep->lag[creep->fast];
    int64_t left = total - creep->settled - creep->slow;
    for (const rdpi_q31_lag_t *lag = creep->lag; lag != end; lag++) {
        left -= rdpi_q31_creep_adds(lag);
    }
    return left;
}

/* The displacement behind creep, with creep->h as that of the operator. */
static inline int32_t rdpi_q31_creep_behind(const rdpi_q31_creep_t *creep)
{
    int64_t within = (int64_t)(((uint64_t)1 << 58) / (uint32_t)creep->per_direct); /* <= 2^31 */
    return rdpi_q31_clamp(-rdpi_q31_creep_less(creep, -within * creep->h) >> 30, -INT32_MAX, INT32_MAX);
}

/* The displacement of the operator with which the one behind creep is `z`. */
static inline int32_t rdpi_q31_creep_solve(const rdpi_q31_creep_t *creep, int32_t z)
{
    int64_t left = rdpi_q31_creep_less(creep, z * (int64_t)RDPI_Q31_ONE);
    int32_t whole = rdpi_q31_clamp(left >> 30, -INT32_MAX, INT32_MAX);
    return rdpi_q31_clamp(rdpi_q31_mul(creep->per_direct, whole) >> 28, -MAX_H, MAX_H);
}

/* One sample in which the displacement of the operator is creep->h. */
static inline void rdpi_q31_creep_move(rdpi_q31_creep_t *creep)
{
    const rdpi_q31_lag_t *end = &creep->lag[creep->fast];
    for (rdpi_q31_lag_t *lag = creep->lag; lag != end; lag++) {
        lag->state += 2 * rdpi_q31_mul(lag->blend, rdpi_q31_creep_left(lag, creep->h));
    }
    if (creep->fast != creep->poles) {
        rdpi_q31_lag_t *lag = &creep->lag[creep->turn];
        int64_t way = rdpi_q31_mul(lag->blend, rdpi_q31_creep_left(lag, creep->mean)) >> lag->shift;
        int64_t later = lag->state + way + way + (way >> 1);
        lag->state += way;
        creep->next += rdpi_q31_mul(lag->weight, (int32_t)(later >> 32));
        creep->sum += creep->h;
        creep->turn++;
        if (creep->turn == creep->poles) {
            creep->turn = creep->fast;
            creep->slow = creep->next;
            creep->mean = (int32_t)rdpi_q31_mul_wide(2 * creep->sum, creep->per_round);
            creep->next = 0;
            creep->sum = 0;
        }
    }
}

/* `samples` > 0 samples in which the displacement of the operator is creep->h, at once. O(poles), however many they
 * are. */
static inline void rdpi_q31_creep_wait(rdpi_q31_creep_t *creep, uint32_t samples)
{
    creep->slow = 0;
    creep->next = 0;
    creep->mean = creep->h;
    creep->sum = (int64_t)creep->h * (creep->turn - creep->fast);
    for (size_t i = 0; i < creep->poles; i++) {
        rdpi_q31_lag_t *lag = &creep->lag[i];
        uint64_t product = (uint64_t)lag->per_sample * samples;
        unsigned zeros = rdpi_q31_clz64(product);
        rdpi_q31_scaled_t u = {(uint32_t)((product << zeros) >> 32), (int)lag->exponent + (int)zeros - 32};
        rdpi_q31_scaled_t blend = rdpi_q31_blend(u);
        int32_t mantissa = blend.mantissa > 0u ? (int32_t)(blend.mantissa >> 1) : INT32_MAX;
        int64_t way = rdpi_q31_mul(mantissa, rdpi_q31_creep_left(lag, creep->h));
        lag->state += blend.exponent > 32 ? way >> (blend.exponent - 33) : 2 * way;
        int64_t adds = i < creep->fast ? 0 : rdpi_q31_creep_adds(lag);
        creep->slow += adds;
        creep->next += i < creep->turn ? adds : 0;
    }
}

#endif
