/* The rate estimator: a difference over a window of time, then a first-order low-pass. Both are configured in seconds,
 * so that one set of parameters serves any sample time T.
 *
 *   rho_k = |z_k - z_(k-N)| / (N T),  N = max(1, round(window_s / T)),  z_0 in place of samples before the first
 *   low-pass: rho'_k = rho'_(k-1) + (1 - exp(-T / filter_s)) (rho_k - rho'_(k-1)),  rho'_0 = 0; none if filter_s = 0 */
#ifndef RDPI_F32_RATE_H
#define RDPI_F32_RATE_H

#include "f32_math.h"

/* Forgets the samples seen. */
static inline void rdpi_f32_rate_reset(rdpi_f32_rate_t *rate)
{
    rate->oldest = rate->window; /* none yet */
    rate->filtered_um_per_s = 0;
}

/* E = 1 - exp(-u), 0 <= u <= 64: a series at u / 2^16, then 16 times E(2 u) = E (2 - E), where nothing cancels. expm1
 * of libm would be larger than all the rest of the step. */
static inline rdpi_real_t rdpi_f32_rate_blend(rdpi_real_t u)
{
    u /= 65536;
    rdpi_real_t last = sizeof u > sizeof(float) ? 1 - u / 4 : 1; /* single precision would round it off */
    rdpi_real_t fraction = u * (1 - u / 2 * (1 - u / 3 * last));
    for (unsigned doublings = 16; doublings > 0u; doublings--) {
        fraction *= 2 - fraction;
    }
    return fraction;
}

/* Whether init can take this sample time at all. */
static inline bool rdpi_f32_is_time(rdpi_real_t sample_time_s)
{
    return sample_time_s >= RDPI_MIN_SAMPLE_TIME_S && sample_time_s * RDPI_MIN_SAMPLE_TIME_S <= 1;
}

/* Sets up `rate` for samples that are `sample_time_s` apart, with no sample seen yet. Returns
 *
 * - RDPI_ERR_SAMPLE_TIME unless RDPI_MIN_SAMPLE_TIME_S <= sample_time_s <= 1 / RDPI_MIN_SAMPLE_TIME_S,
 * - RDPI_ERR_RATE unless window_s >= 0 and filter_s >= 0,
 * - RDPI_ERR_WINDOW if N > RDPI_MAX_WINDOW,
 * - RDPI_OK otherwise. */
static inline rdpi_status_t rdpi_f32_rate_init(rdpi_f32_rate_t *rate, rdpi_real_t window_s, rdpi_real_t filter_s,
                                               rdpi_real_t sample_time_s)
{
    if (!rdpi_f32_is_time(sample_time_s)) {
        return RDPI_ERR_SAMPLE_TIME;
    }
    if (!(window_s >= 0) || !(filter_s >= 0)) {
        return RDPI_ERR_RATE;
    }
    rdpi_real_t samples = window_s / sample_time_s + (rdpi_real_t)0.5;
    if (!(samples < (rdpi_real_t)(RDPI_MAX_WINDOW + 1))) {
        return RDPI_ERR_WINDOW;
    }
    rate->window = (uint16_t)(samples < 2 ? 1 : samples);
    rate->per_window_s = 1 / ((rdpi_real_t)rate->window * sample_time_s);
    rate->keep = sample_time_s < 64 * filter_s ? 1 - rdpi_f32_rate_blend(sample_time_s / filter_s) : 0;
    rdpi_f32_rate_reset(rate);
    return RDPI_OK;
}

/* The rate of the sample `z_um` in the direct case, which is the frequent one: N = 1, no low-pass, there is a sample
 * before it, and none was missed. Does not store the sample. O(1). */
static inline rdpi_real_t rdpi_f32_rate_direct(const rdpi_f32_rate_t *rate, rdpi_real_t z_um)
{
    return fabs(z_um - rate->z_um[0]) * rate->per_window_s;
}

/* Takes the sample `z_um`, |z_um| <= 2e7, and returns the rate in um/s, >= 0. Before it, `missed` samples were missed:
 * they are taken to lie on the straight line from the sample before them. O(missed + 1), or O(1) for N = 1 without
 * low-pass. The first sample is O(N).
 *
 * Points of the line are rounded. The difference over N samples therefore uses, in this order:
 *
 * 1. the slope of the line, if both ends of the difference lie on the line;
 * 2. the samples at both ends, if both are samples;
 * 3. a point of the line, if there is nothing else. */
static inline rdpi_real_t rdpi_f32_rate_step(rdpi_f32_rate_t *rate, rdpi_real_t z_um, unsigned missed)
{
    if (rate->oldest == rate->window || missed > RDPI_MAX_MISSED) {
        rdpi_f32_rate_reset(rate);
        for (size_t k = 0; k < rate->window; k++) {
            rate->z_um[k] = z_um;
        }
        rate->oldest = 0;
        missed = 0;
    }
    rdpi_real_t step_um = z_um - rate->z_um[(rate->oldest > 0u ? rate->oldest : rate->window) - 1u];
    step_um /= (rdpi_real_t)(missed + 1u);
    if (RDPI_QUICK_STEP > 0 && rate->window == 1u && rate->keep <= 0) { /* the loop below gives the same */
        rate->z_um[0] = z_um;
        return fabs(step_um) * rate->per_window_s;
    }
    unsigned left = missed + 1u;
    while (left-- > 0u) {
        rdpi_real_t point_um = rdpi_f32_fma((rdpi_real_t)left, -step_um, z_um);
        rdpi_real_t moved_um = point_um - rate->z_um[rate->oldest];
        if (left + rate->window <= missed + 1u) {
            moved_um = (rdpi_real_t)rate->window * step_um;
        }
        rate->z_um[rate->oldest] = point_um;
        rate->oldest = (uint16_t)(rate->oldest + 1u < rate->window ? rate->oldest + 1u : 0u);

        rdpi_real_t raw_um_per_s = fabs(moved_um) * rate->per_window_s;
        /* Not filtered += (1 - keep) (raw - filtered): rounding of a large old value would stay in a small new one. */
        rate->filtered_um_per_s = rdpi_f32_fma(rate->keep, rate->filtered_um_per_s - raw_um_per_s, raw_um_per_s);
    }
    return rate->filtered_um_per_s;
}

#endif
