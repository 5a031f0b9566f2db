#include "plant.h"

#include <math.h>

#include "f32_play.h"

#define TRIES 100      /* of the search for z; halving alone needs about 60 */
#define ENOUGH 1e-13   /* of the largest number at hand: rounding */
#define MANY 3         /* times dF/drate: an error of the rate is halved within as many samples as it is taken over */

static rdpi_real_t bent(const rdpi_real_t *p, rdpi_real_t u_V)
{
    rdpi_real_t within_V = fmin(fmax(u_V, p[2]), p[3]), span_V = p[3] - p[2], u = (within_V - p[2]) / span_V;
    rdpi_real_t end_slope = p[1] + (u_V < p[2] ? p[0] : -p[0]);
    return u_V + span_V * u * (1 - u) * (p[0] + p[1] * (1 - 2 * u)) + end_slope * (u_V - within_V);
}

static rdpi_real_t staircase(const rdpi_block_t *block, rdpi_real_t u)
{
    rdpi_real_t sum = u;
    for (uint32_t i = 0; i < block->count; i++) {
        sum += block->a[i] * sin((rdpi_real_t)(i + 1u) * block->p[0] * u);
    }
    return sum;
}

static rdpi_real_t delayed(const rdpi_block_t *block, rdpi_real_t u)
{
    uint32_t held = block->count - 1u, at = (uint32_t)block->state[0]; /* of the oldest, which comes out next but one */
    rdpi_real_t *past = block->state + 1, oldest = past[at];
    past[at] = u;
    at = at + 1u < held ? at + 1u : 0u;
    block->state[0] = (rdpi_real_t)at;
    return past[at] + block->p[0] * (oldest - past[at]);
}

static rdpi_real_t lagging(const rdpi_block_t *block, rdpi_real_t u)
{
    rdpi_real_t *ahead = block->state, *last = ahead + block->count, moved = u - *last;
    rdpi_real_t sum = u + block->p[0] * (u - last[1]);
    *last = u;
    for (uint32_t i = 0; i < block->count; i++) {
        ahead[i] = block->a[i] * ahead[i] - block->b[i] * moved;
        sum += block->c[i] * ahead[i];
    }
    return sum;
}

static rdpi_real_t ringing(const rdpi_block_t *block, rdpi_real_t u)
{
    rdpi_real_t *s = block->state, in = u - s[2], out = block->b[0] * in + s[0];
    s[0] = block->b[1] * in - block->a[1] * out + s[1];
    s[1] = block->b[2] * in - block->a[2] * out;
    return s[2] + out;
}

static rdpi_real_t widened(const rdpi_block_t *block, rdpi_real_t u, rdpi_real_t drive_V)
{
    const rdpi_real_t *p = block->p;
    rdpi_real_t share = fmin(rdpi_f32_rate_step(block->rate, u, 0) / p[0], 2);
    return u + pow(share, p[1]) * (p[2] * (u - p[4] - p[5] * drive_V) + p[3] * (u - p[6]));
}

/* How many samples back the operator's rate looks; z_um: what it gives at the lowest and at the highest rate. */
static uint32_t looked_back(const rdpi_block_t *block, const rdpi_real_t *z_um)
{
    const rdpi_f32_rate_t *law = &block->axis->rate_estimator;
    rdpi_real_t by_rate_s = block->p[4] * fabs(z_um[1] - z_um[0]) / (block->p[1] - block->p[0]);
    rdpi_real_t least = MANY * (1 - law->keep) * by_rate_s * (rdpi_real_t)law->window * law->per_window_s + 1;
    return least < law->window ? law->window : least < block->count ? (uint32_t)least : block->count;
}

/* The rate of the operator if it now gives z_um; over as many samples as the law has, the same as rdpi_f32_rate_step. */
static rdpi_real_t rate_with(const rdpi_block_t *block, uint32_t back, rdpi_real_t z_um)
{
    const rdpi_f32_rate_t *law = &block->axis->rate_estimator;
    const rdpi_real_t *state = block->state;
    uint32_t at = (uint32_t)state[0];
    if (state[1] <= 0) {
        return state[2]; /* the first sample */
    }
    rdpi_real_t before_um = state[3u + (at >= back ? at - back : at + block->count - back)];
    rdpi_real_t raw_um_per_s = fabs(z_um - before_um) * law->per_window_s * (law->window / (rdpi_real_t)back);
    return raw_um_per_s + law->keep * (state[2] - raw_um_per_s);
}

static void take(const rdpi_block_t *block, rdpi_real_t z_um, rdpi_real_t rate_um_per_s)
{
    rdpi_real_t *state = block->state;
    for (uint32_t k = 0; k < block->count && state[1] <= 0; k++) {
        state[3u + k] = z_um;
    }
    uint32_t at = (uint32_t)state[0];
    state[3u + at] = z_um;
    state[0] = at + 1u < block->count ? at + 1u : 0;
    state[1] = 1;
    state[2] = rate_um_per_s;
}

/* z = F(rho(z)): the secant through both ends of where it must lie, or their middle where that goes too slowly. */
static rdpi_real_t solved(const rdpi_block_t *block, rdpi_real_t drive_V, const rdpi_real_t *ends_um, uint32_t back)
{
    rdpi_real_t low_um = fmin(ends_um[0], ends_um[1]), high_um = fmax(ends_um[0], ends_um[1]), z_um = low_um;
    rdpi_real_t enough_um = (rdpi_real_t)ENOUGH * (fabs(low_um) + fabs(high_um));
    rdpi_real_t above = rdpi_f32_predict(block->axis, drive_V, rate_with(block, back, low_um)) - low_um;
    rdpi_real_t below = rdpi_f32_predict(block->axis, drive_V, rate_with(block, back, high_um)) - high_um;
    for (int k = 0; k < TRIES && high_um - low_um > enough_um; k++) {
        z_um = k % 3 == 2 || !(above > below) ? (low_um + high_um) / 2
                                              : low_um + (high_um - low_um) * above / (above - below);
        rdpi_real_t miss_um = rdpi_f32_predict(block->axis, drive_V, rate_with(block, back, z_um)) - z_um;
        if (fabs(miss_um) <= enough_um) {
            break;
        }
        if (miss_um > 0) {
            low_um = z_um;
            above = miss_um;
        } else {
            high_um = z_um;
            below = miss_um;
        }
    }
    return z_um;
}

static rdpi_real_t operated(const rdpi_block_t *block, rdpi_real_t drive_V, rdpi_real_t *rate_um_per_s)
{
    const rdpi_real_t *p = block->p;
    uint32_t back = block->axis->rate_estimator.window;
    rdpi_real_t taken_um = p[2] + p[3] * drive_V;
    if (!block->of_control) {
        rdpi_real_t ends_um[2] = {rdpi_f32_predict(block->axis, drive_V, p[0]), 0};
        if (p[1] > p[0]) {
            ends_um[1] = rdpi_f32_predict(block->axis, drive_V, p[1]);
            back = looked_back(block, ends_um);
            taken_um = solved(block, drive_V, ends_um, back);
        } else {
            taken_um = ends_um[0];
        }
    }
    *rate_um_per_s = rate_with(block, back, taken_um);
    take(block, taken_um, *rate_um_per_s);
    return rdpi_f32_forward(block->axis, drive_V, *rate_um_per_s);
}

rdpi_status_t rdpi_plant_rate_init(rdpi_f32_rate_t *rate, rdpi_real_t window_s, rdpi_real_t filter_s,
                                   rdpi_real_t sample_time_s)
{
    return rdpi_f32_rate_init(rate, window_s, filter_s, sample_time_s);
}

void rdpi_plant_run(const rdpi_block_t *block, size_t count, size_t samples, rdpi_real_t *signal, rdpi_real_t *driven_V,
                    rdpi_real_t *rate_um_per_s)
{
    for (; count > 0u; count--, block++) {
        const rdpi_real_t *p = block->p;
        for (size_t k = 0; k < samples; k++) {
            rdpi_real_t u = signal[k], s;
            switch ((rdpi_block_kind_t)block->kind) {
            case RDPI_BLOCK_LINE: signal[k] = p[0] + p[1] * u; break;
            case RDPI_BLOCK_BENT: signal[k] = bent(p, u); break;
            case RDPI_BLOCK_CUBIC:
                s = (u - p[0]) / p[1] - 1;
                signal[k] = u + p[1] * s * (p[2] + s * (p[3] + s * p[4]));
                break;
            case RDPI_BLOCK_CLAMP: signal[k] = fmin(fmax(u, p[0]), p[1]); break;
            case RDPI_BLOCK_ROUND: signal[k] = p[0] + p[1] * nearbyint((u - p[0]) / p[1]); break;
            case RDPI_BLOCK_STAIRCASE: signal[k] = staircase(block, u); break;
            case RDPI_BLOCK_SLEW:
                signal[k] = block->state[0] += fmin(fmax(u - block->state[0], -p[0]), p[0]);
                break;
            case RDPI_BLOCK_DELAY: signal[k] = delayed(block, u); break;
            case RDPI_BLOCK_LAGS: signal[k] = lagging(block, u); break;
            case RDPI_BLOCK_RING: signal[k] = ringing(block, u); break;
            case RDPI_BLOCK_PLAY: signal[k] = block->state[0] = rdpi_f32_play(u, p[0], block->state[0]); break;
            case RDPI_BLOCK_WIDEN: signal[k] = widened(block, u, driven_V[k]); break;
            case RDPI_BLOCK_OPERATOR:
                driven_V[k] = u;
                signal[k] = operated(block, u, &rate_um_per_s[k]);
                break;
            }
        }
    }
}
