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
 * rdpi_f32_creep_solve solves that for h_k. In the next sample, rdpi_f32_creep_move moves the states m_i to it, or to what
 * was really output.
 *
 * A pole is slow if rounding would swallow what it moves in one sample. The P slow poles take turns, one every
 * `per_turn` samples:
 *
 * - The time of its move is that of a round, P per_turn samples. It moves towards the mean of h over the round before.
 * - Its state has two parts. What is too small for the first stays in the second, so that nothing is ever lost.
 * - What the slow poles add is summed anew in each round, so that rounding does not add up. It is used in the round
 *   that follows, and is that of the middle of it: 1.5 rounds after the states that it is made of.
 *
 * What a slow pole adds after a jump of h is therefore late by half a round, more or less. */
#ifndef RDPI_F32_CREEP_H
#define RDPI_F32_CREEP_H

#include <float.h>

#include "f32_math.h"
#include "f32_rate.h"
#include "rdpi/f32_chain.h"

/* A pole is slow if T / time_constant is below this. A fast one then settles to 2^-14 of its state or better, which is
 * what rounding swallows. */
#define SLOW_BELOW (8192 * (rdpi_real_t)(sizeof(rdpi_real_t) == sizeof(float) ? (double)FLT_EPSILON : DBL_EPSILON))

/* A round is no longer than this share of the fastest slow time constant, unless P samples are. */
#define ROUND_SHARE ((rdpi_real_t)1 / 512)

/* The most samples between two turns. */
#define MAX_PER_TURN 16

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
    creep->slow_um = settled_um;
    creep->h_um = 0;
    creep->next_um = 0;
    creep->mean_um = 0;
    creep->sum_um = 0;
    creep->turn = creep->poles - 1u;
    creep->wait = creep->per_turn;
}

/* 1 - exp(-u), u >= 0. */
static inline rdpi_real_t rdpi_f32_creep_blend(rdpi_real_t u)
{
    return rdpi_f32_rate_blend(u < 64 ? u : 64);
}

/* Counts the poles, and finds how often the slow ones take turns. */
static inline void rdpi_f32_creep_plan(rdpi_f32_creep_t *creep, const rdpi_f32_chain_params_t *params,
                                       rdpi_real_t sample_time_s)
{
    rdpi_real_t fastest = 0;
    creep->poles = params->poles;
    creep->fast = 0;
    for (size_t i = 0; i < params->poles; i++) {
        rdpi_real_t u = sample_time_s / params->pole[i].time_constant_s;
        if (u >= SLOW_BELOW) {
            creep->fast++;
        } else {
            fastest = u > fastest ? u : fastest;
        }
    }
    rdpi_real_t slow = (rdpi_real_t)(creep->poles - creep->fast);
    rdpi_real_t turn = 0;
    if (slow > 0) {
        turn = rdpi_f32_clamp(ROUND_SHARE / (fastest * slow), 1, MAX_PER_TURN);
    }
    creep->per_turn = (uint32_t)turn;
    creep->round = (rdpi_real_t)creep->per_turn * slow;
}

/* Sets up the poles for samples that are `sample_time_s` apart, the fast ones first. Returns false if they cannot be
 * inverted. */
static inline bool rdpi_f32_creep_init(rdpi_f32_creep_t *creep, const rdpi_f32_chain_params_t *params,
                                       rdpi_real_t sample_time_s)
{
    rdpi_f32_creep_plan(creep, params, sample_time_s);
    rdpi_real_t negative = 0, within = params->direct;
    size_t next_fast = 0, next_slow = creep->fast;
    for (size_t i = 0; i < params->poles; i++) {
        const rdpi_f32_pole_t *pole = &params->pole[i];
        rdpi_real_t u = sample_time_s / pole->time_constant_s, blend = rdpi_f32_creep_blend(u);
        rdpi_real_t weight = pole->share * (blend / u);
        within += pole->share - weight;
        negative += pole->share < 0 ? pole->share : 0;
        size_t place = next_fast;
        if (u < SLOW_BELOW) {
            place = next_slow;
            next_slow++;
            blend = rdpi_f32_creep_blend(u * creep->round);
        } else {
            next_fast++;
        }
        creep->per_sample[place] = u;
        creep->lag[place].blend = blend;
        creep->lag[place].weight = weight;
        creep->lag[place].weight_ahead = weight * (rdpi_real_t)1.5;
    }
    creep->per_direct = 1 / within;
    return params->direct + negative >= MIN_DIRECT;
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

/* The slow poles have all moved. */
static inline void rdpi_f32_creep_end_round(rdpi_f32_creep_t *creep)
{
    creep->turn = creep->poles - 1u;
    creep->slow_um = creep->settled_um + creep->next_um;
    creep->mean_um = creep->sum_um / creep->round;
    creep->next_um = 0;
    creep->sum_um = 0;
}

/* `sum_um` and what a slow pole that moves by `way_um` in a round will add in the middle of the next one. */
static inline rdpi_real_t rdpi_f32_creep_ahead(const rdpi_f32_lag_t *lag, rdpi_real_t way_um, rdpi_real_t sum_um)
{
    return rdpi_f32_fma(lag->weight_ahead, way_um, rdpi_f32_fma(lag->weight, lag->state_um, sum_um));
}

/* The turn of a slow pole. */
static inline void rdpi_f32_creep_turn(rdpi_f32_creep_t *creep)
{
    uint32_t turn = creep->turn;
    rdpi_f32_lag_t *lag = &creep->lag[turn];
    rdpi_real_t way_um = rdpi_f32_creep_pull(lag, lag->blend, creep->mean_um);
    creep->next_um = rdpi_f32_creep_ahead(lag, way_um, creep->next_um);
    creep->wait = creep->per_turn;
    creep->turn = turn - 1u;
    if (turn == creep->fast) {
        rdpi_f32_creep_end_round(creep);
    }
}

/* One sample at h = h_0 + h_um. Returns what all poles add in the next one, and h_0. */
static inline rdpi_real_t rdpi_f32_creep_move(rdpi_f32_creep_t *creep)
{
    rdpi_real_t h_um = creep->h_um, adds_um = creep->slow_um;
    uint32_t wait = creep->wait;
    if (wait > 0u) { /* there are slow poles */
        wait--;
        creep->wait = wait;
        creep->sum_um += h_um;
        if (wait == 0u) {
            rdpi_f32_creep_turn(creep);
        }
    }
    rdpi_f32_lag_t *lag = creep->lag;
    for (uint32_t left = creep->fast; left > 0u; left--) {
        lag->state_um = rdpi_f32_fma(lag->blend, h_um - lag->state_um, lag->state_um);
        adds_um = rdpi_f32_fma(lag->weight, lag->state_um, adds_um);
        lag++;
    }
    return adds_um;
}

/* The h that makes the displacement behind creep `z_um`, if all poles add `adds_um`, h_0 included. */
static inline rdpi_real_t rdpi_f32_creep_solve(rdpi_f32_creep_t *creep, rdpi_real_t adds_um, rdpi_real_t z_um)
{
    creep->h_um = (z_um - adds_um) * creep->per_direct;
    return creep->h_um + creep->settled_um;
}

/* `samples` samples at h = h_0 + `h_um`, at once. O(poles), however many they are. */
static inline void rdpi_f32_creep_wait(rdpi_f32_creep_t *creep, rdpi_real_t samples, rdpi_real_t h_um)
{
    rdpi_real_t slow_um = creep->settled_um, next_um = 0;
    for (size_t i = 0; i < creep->poles; i++) {
        rdpi_f32_lag_t *lag = &creep->lag[i];
        (void)rdpi_f32_creep_pull(lag, rdpi_f32_creep_blend(samples * creep->per_sample[i]), h_um);
        if (i >= creep->fast) {
            rdpi_real_t adds_um = rdpi_f32_creep_ahead(lag, lag->blend * (h_um - lag->state_um), 0);
            slow_um += adds_um;
            next_um += i > creep->turn ? adds_um : 0; /* has moved in this round */
        }
    }
    creep->slow_um = slow_um;
    creep->next_um = next_um;
}

#endif
