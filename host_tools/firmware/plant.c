#include "plant.h"

#include <math.h>

#include "f32_play.h"

#define TRIES 100      /* of the search for z; halving alone needs about 60 */
#define ENOUGH 1e-13   /* of the largest number at hand: rounding */

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

/* What rdpi_f32_rate_step will return for this sample, without taking it. */
static rdpi_real_t rate_with(const rdpi_f32_rate_t *rate, rdpi_real_t z_um)
{
    if (rate->oldest == rate->window) {
        return 0; /* the first sample */
    }
    rdpi_real_t raw_um_per_s = fabs(z_um - rate->z_um[rate->oldest]) * rate->per_window_s;
    return raw_um_per_s + rate->keep * (rate->filtered_um_per_s - raw_um_per_s);
}

/* z = F(rho(z)): the secant through both ends of where it must lie, or their middle where that goes too slowly. */
static rdpi_real_t solved(const rdpi_block_t *block, rdpi_real_t drive_V)
{
    rdpi_real_t low_um = rdpi_f32_predict(block->axis, drive_V, block->p[0]);
    rdpi_real_t high_um = rdpi_f32_predict(block->axis, drive_V, block->p[1]);
    if (low_um > high_um) {
        rdpi_real_t swapped_um = low_um;
        low_um = high_um;
        high_um = swapped_um;
    }
    rdpi_real_t enough_um = (rdpi_real_t)ENOUGH * (fabs(low_um) + fabs(high_um));
    rdpi_real_t above = rdpi_f32_predict(block->axis, drive_V, rate_with(block->rate, low_um)) - low_um;
    rdpi_real_t below = rdpi_f32_predict(block->axis, drive_V, rate_with(block->rate, high_um)) - high_um;
    rdpi_real_t z_um = low_um;
    for (int k = 0; k < TRIES && high_um - low_um > enough_um; k++) {
        z_um = k % 3 == 2 || !(above > below) ? (low_um + high_um) / 2
                                              : low_um + (high_um - low_um) * above / (above - below);
        rdpi_real_t miss_um = rdpi_f32_predict(block->axis, drive_V, rate_with(block->rate, z_um)) - z_um;
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
    rdpi_real_t taken_um = block->of_control             ? block->p[2] + block->p[3] * drive_V
                           : block->p[1] > block->p[0] ? solved(block, drive_V)
                                                       : rdpi_f32_predict(block->axis, drive_V, block->p[0]);
    *rate_um_per_s = rdpi_f32_rate_step(block->rate, taken_um, 0);
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
