/* The inverse of creep and relaxation in fixed point. f32_creep.h says how it works. What is different here:
 *
 * - Displacements are not relative to h_0: what h_0 adds is a constant.
 * - The states have 32 bits of fraction. A pole of any time constant moves on by what is left to go in whole units, so
 *   nothing is lost, and the sums of products are exact.
 *
 * Scaling and overflow: |h| and all states are < 2^30, so they differ by less than 2^31. The share of what comes at
 * once and the magnitudes of all others add up to 2 at most, weights are less than their shares, and references are
 * < 2^31. In z 2^30 = z_h h + sum weight m + settled, the terms are therefore < 2^61, 2^61, 2^61 and 2^60. */
#ifndef RDPI_Q31_CREEP_H
#define RDPI_Q31_CREEP_H

#include "q31_blend.h"

/* Poles of more samples than this are slow. */
#define SLOW_SAMPLES 4096u

/* The largest |h|. */
#define MAX_H (RDPI_Q31_ONE - 1)

/* How many slow poles may wait for their turn, so that their blend stays far below 1. */
#if RDPI_MAX_POLES > 64
#error "define RDPI_MAX_POLES as at most 64"
#endif

/* (1 - exp(-u)) / u, times 2^30. Never more than 2^30, because a blend is rounded down from u. */
static inline int32_t rdpi_q31_creep_mean(rdpi_q31_scaled_t u)
{
    rdpi_q31_scaled_t blend = rdpi_q31_blend(u);
    uint64_t mantissa = blend.mantissa > 0u ? blend.mantissa : (uint64_t)1 << 32;
    return (int32_t)(((mantissa << 30) / u.mantissa) >> (blend.exponent - u.exponent)); /* by 32 at most: u < 2^32 */
}

/* Sets up one pole, whose turn comes every `turns` samples: 0 for a fast one, whose turn comes in each. */
static inline void rdpi_q31_creep_pole(rdpi_q31_lag_t *lag, const rdpi_q31_pole_t *pole, uint32_t sample_time_ns,
                                       unsigned turns)
{
    uint64_t time_ns = (uint64_t)sample_time_ns * (turns > 0u ? turns : 1u);
    rdpi_q31_scaled_t blend = rdpi_q31_blend(rdpi_q31_ratio(time_ns, pole->time_constant_ns));
    uint32_t mantissa = blend.mantissa > 0u ? blend.mantissa : UINT32_MAX;
    int32_t mean = rdpi_q31_creep_mean(rdpi_q31_ratio(sample_time_ns, pole->time_constant_ns));
    lag->weight = (int32_t)(rdpi_q31_mul(pole->share, mean) >> 30);
    if (turns > 0u) {
        lag->blend = (int32_t)(mantissa >> 1);
        lag->shift = (uint8_t)(blend.exponent - 33);
    } else {
        lag->blend = (int32_t)(mantissa >> (blend.exponent - 31));
        lag->shift = 0;
    }
}

static inline bool rdpi_q31_creep_is_slow(const rdpi_q31_pole_t *pole, uint32_t sample_time_ns)
{
    return pole->time_constant_ns > (uint64_t)sample_time_ns * SLOW_SAMPLES;
}

/* Sets up creep^-1 of checked parameters. Its state is that of rdpi_q31_creep_settle. */
static inline void rdpi_q31_creep_init(rdpi_q31_creep_t *creep, const rdpi_q31_chain_params_t *params,
                                       uint32_t sample_time_ns)
{
    unsigned slow = 0, next_slow;
    uint32_t at_once = (uint32_t)params->direct; /* within a sample, times 2^30 */
    for (size_t i = 0; i < params->poles; i++) {
        slow += rdpi_q31_creep_is_slow(&params->pole[i], sample_time_ns) ? 1u : 0u;
    }
    creep->fast = 0;
    next_slow = params->poles - slow;
    for (size_t i = 0; i < params->poles; i++) {
        const rdpi_q31_pole_t *pole = &params->pole[i];
        rdpi_q31_lag_t *lag;
        if (rdpi_q31_creep_is_slow(pole, sample_time_ns)) {
            lag = &creep->lag[next_slow];
            next_slow++;
            rdpi_q31_creep_pole(lag, pole, sample_time_ns, slow);
        } else {
            lag = &creep->lag[creep->fast];
            creep->fast++;
            rdpi_q31_creep_pole(lag, pole, sample_time_ns, 0);
        }
        at_once += (uint32_t)pole->share - (uint32_t)lag->weight;
    }
    creep->per_direct = (int32_t)((((uint64_t)1 << 58) + at_once / 2u) / at_once);
}

/* Creep has settled at `h`. */
static inline void rdpi_q31_creep_settle(rdpi_q31_creep_t *creep, const rdpi_q31_chain_params_t *params, int32_t h)
{
    int32_t constant = RDPI_Q31_ONE - params->direct;
    creep->h = rdpi_q31_clamp(h, -MAX_H, MAX_H);
    creep->slow = 0;
    creep->next = 0;
    creep->turn = 0;
    for (size_t i = 0; i < params->poles; i++) {
        rdpi_q31_lag_t *lag = &creep->lag[i];
        lag->state = creep->h * ((int64_t)1 << 32);
        constant -= params->pole[i].share;
        creep->slow += i < creep->fast ? 0 : rdpi_q31_mul(lag->weight, creep->h);
    }
    creep->settled = rdpi_q31_mul(constant, creep->h);
}

/* The displacement of the operator with which the one behind creep is `z`. */
static inline int32_t rdpi_q31_creep_solve(const rdpi_q31_creep_t *creep, int32_t z)
{
    int64_t left = z * (int64_t)RDPI_Q31_ONE - creep->settled - creep->slow;
    for (size_t i = 0; i < creep->fast; i++) {
        left -= rdpi_q31_mul(creep->lag[i].weight, (int32_t)(creep->lag[i].state >> 32));
    }
    int32_t whole = rdpi_q31_clamp(left >> 30, -INT32_MAX, INT32_MAX);
    return rdpi_q31_clamp(rdpi_q31_mul(creep->per_direct, whole) >> 28, -MAX_H, MAX_H);
}

/* Creep goes on for a sample, in which the displacement of the operator is creep->h. */
static inline void rdpi_q31_creep_move(rdpi_q31_creep_t *creep, size_t poles)
{
    for (size_t i = 0; i < creep->fast; i++) {
        rdpi_q31_lag_t *lag = &creep->lag[i];
        lag->state += 2 * rdpi_q31_mul(lag->blend, creep->h - (int32_t)(lag->state >> 32));
    }
    size_t slow = (size_t)creep->fast + creep->turn;
    if (slow < poles) {
        rdpi_q31_lag_t *lag = &creep->lag[slow];
        lag->state += rdpi_q31_mul(lag->blend, creep->h - (int32_t)(lag->state >> 32)) >> lag->shift;
        creep->next += rdpi_q31_mul(lag->weight, (int32_t)(lag->state >> 32));
        creep->turn++;
        if (slow + 1u == poles) {
            creep->slow = creep->next;
            creep->next = 0;
            creep->turn = 0;
        }
    }
}

#endif
