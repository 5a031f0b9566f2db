/* Creep and relaxation, a sum of first-order lags of the displacement h of the operator, and its exact inverse.
 *
 * All that follows is relative to h_0, the displacement when creep had settled. The lag of h, with h straight between
 * samples, a = exp(-T / time_constant) and g = (1 - a) time_constant / T, is
 *
 *   l_k = g m_(k-1) + (1 - g) h_k,   m_k = m_(k-1) + (1 - a) (h_k - m_(k-1)).
 *
 * The displacement behind creep is therefore linear in h_k, which is all that is not known before the sample:
 *
 *   z_k = direct h_k + sum share_i l_i = (direct + sum share_i (1 - g_i)) h_k + sum share_i g_i m_(i,k-1).
 *
 * rdpi_f32_creep_solve solves that for h_k. rdpi_f32_creep_move then moves the states m_i to what was really output.
 *
 * A pole is slow if rounding would swallow what it moves in one sample. Of P slow poles, one moves in each sample:
 *
 * - Its time is that of P samples. It moves towards the mean of h over one round of P samples, the round before.
 * - Its state has two parts. What is too small for the first stays in the second, so that nothing is ever lost.
 * - What the slow poles add is summed anew in each round, so that rounding does not add up. It is used in the round
 *   that follows, and is that of the middle of it: 1.5 rounds after the states that it is made of. */
#ifndef RDPI_F32_CREEP_H
#define RDPI_F32_CREEP_H

#include <float.h>

#include "f32_math.h"
#include "f32_rate.h"
#include "rdpi/f32_chain.h"

/* A pole is slow if T / time_constant is below this. A fast one then settles to 2^-14 of its state or better, which is
 * what rounding swallows. */
#define SLOW_BELOW (8192 * (rdpi_real_t)(sizeof(rdpi_real_t) == sizeof(float) ? (double)FLT_EPSILON : DBL_EPSILON))

/* The least that `direct` and the negative shares may add up to. Above 0, the inverse is stable. */
#define MIN_DIRECT ((rdpi_real_t)1e-3)

/* Creep has settled at the displacement `settled_um`. */
static inline void rdpi_f32_creep_settle(rdpi_f32_creep_t *creep, rdpi_real_t settled_um)
{
    for (size_t i = 0; i < creep->poles; i++) {
        creep->lag[i].state_um = 0;
        creep->lag[i].rest_um = 0;
    }
    creep->settled_um = settled_um;
    creep->offset_um = settled_um;
    creep->slow_um = settled_um;
    creep->next_um = 0;
    creep->mean_um = 0;
    creep->sum_um = 0;
    creep->turn = creep->fast;
}

/* 1 - exp(-u), u >= 0. */
static inline rdpi_real_t rdpi_f32_creep_blend(rdpi_real_t u)
{
    return rdpi_f32_rate_blend(u < 64 ? u : 64);
}

/* Sets up the poles for samples that are `sample_time_s` apart, the fast ones first. Returns false if they cannot be
 * inverted. */
static inline bool rdpi_f32_creep_init(rdpi_f32_creep_t *creep, const rdpi_f32_chain_params_t *params,
                                       rdpi_real_t sample_time_s)
{
    rdpi_real_t least = params->direct, within = params->direct;
    size_t fast = 0, slow = 0;
    for (size_t i = 0; i < params->poles; i++) {
        bool is_slow = sample_time_s / params->pole[i].time_constant_s < SLOW_BELOW;
        fast += is_slow ? 0u : 1u;
        slow += is_slow ? 1u : 0u;
    }
    creep->fast = (uint16_t)fast;
    creep->poles = params->poles;
    creep->per_round = slow > 0u ? 1 / (rdpi_real_t)slow : 0;
    rdpi_f32_lag_t *next_fast = creep->lag, *next_slow = &creep->lag[fast];
    for (size_t i = 0; i < params->poles; i++) {
        const rdpi_f32_pole_t *pole = &params->pole[i];
        rdpi_real_t u = sample_time_s / pole->time_constant_s, blend = rdpi_f32_creep_blend(u);
        rdpi_real_t weight = pole->share * (blend / u);
        within += pole->share - weight;
        least += pole->share < 0 ? pole->share : 0;
        rdpi_f32_lag_t *lag;
        if (u < SLOW_BELOW) {
            lag = next_slow++;
            blend = rdpi_f32_creep_blend(u * (rdpi_real_t)slow);
        } else {
            lag = next_fast++;
        }
        lag->per_sample = u;
        lag->blend = blend;
        lag->weight = weight;
    }
    creep->per_direct = 1 / within;
    return least >= MIN_DIRECT;
}

/* The h, relative to h_0, that makes the displacement behind creep `z_um`. */
static inline rdpi_real_t rdpi_f32_creep_solve(const rdpi_f32_creep_t *creep, rdpi_real_t z_um)
{
    return (z_um - creep->offset_um) * creep->per_direct;
}

/* Moves a pole the share `blend` of the way to `h_um`, in two parts. Returns how far. */
static inline rdpi_real_t rdpi_f32_creep_pull(rdpi_f32_lag_t *lag, rdpi_real_t blend, rdpi_real_t h_um)
{
    rdpi_real_t way_um = rdpi_f32_fma(blend, h_um - lag->state_um, lag->rest_um);
    rdpi_real_t state_um = lag->state_um + way_um;
    lag->rest_um = way_um - (state_um - lag->state_um);
    lag->state_um = state_um;
    return way_um;
}

/* One sample at h = h_0 + `h_um`. */
static RDPI_F32_SHARED void rdpi_f32_creep_move(rdpi_f32_creep_t *creep, rdpi_real_t h_um)
{
    rdpi_real_t offset_um = 0;
    const rdpi_f32_lag_t *end = &creep->lag[creep->fast];
    for (rdpi_f32_lag_t *lag = creep->lag; lag != end; lag++) {
        lag->state_um = rdpi_f32_fma(lag->blend, h_um - lag->state_um, lag->state_um);
        offset_um = rdpi_f32_fma(lag->weight, lag->state_um, offset_um);
    }
    if (creep->fast != creep->poles) {
        rdpi_f32_lag_t *lag = &creep->lag[creep->turn];
        rdpi_real_t way_um = rdpi_f32_creep_pull(lag, lag->blend, creep->mean_um);
        rdpi_real_t later_um = rdpi_f32_fma((rdpi_real_t)1.5, way_um, lag->state_um);
        creep->next_um = rdpi_f32_fma(lag->weight, later_um, creep->next_um);
        creep->sum_um += h_um;
        creep->turn++;
        if (creep->turn == creep->poles) {
            creep->turn = creep->fast;
            creep->slow_um = creep->settled_um + creep->next_um;
            creep->mean_um = creep->sum_um * creep->per_round;
            creep->next_um = 0;
            creep->sum_um = 0;
        }
    }
    creep->offset_um = offset_um + creep->slow_um;
}

/* `samples` samples at h = h_0 + `h_um`, at once. O(poles), however many they are. */
static inline void rdpi_f32_creep_wait(rdpi_f32_creep_t *creep, rdpi_real_t samples, rdpi_real_t h_um)
{
    rdpi_real_t offset_um = 0, slow_um = 0, next_um = 0;
    for (size_t i = 0; i < creep->poles; i++) {
        rdpi_f32_lag_t *lag = &creep->lag[i];
        (void)rdpi_f32_creep_pull(lag, rdpi_f32_creep_blend(samples * lag->per_sample), h_um);
        rdpi_real_t adds_um = lag->weight * lag->state_um;
        offset_um += i < creep->fast ? adds_um : 0;
        slow_um += i < creep->fast ? 0 : adds_um;
        next_um += i >= creep->fast && i < creep->turn ? adds_um : 0;
    }
    creep->next_um = next_um;
    creep->slow_um = creep->settled_um + slow_um;
    creep->offset_um = offset_um + creep->slow_um;
}

#endif
