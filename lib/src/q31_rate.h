/* The rate estimator of f32_rate.h in fixed point. It works on distances per window, so that a jump of any size passes
 * through the low-pass undistorted. Only the result is divided by the distance at the guard. */
#ifndef RDPI_Q31_RATE_H
#define RDPI_Q31_RATE_H

#include "q31_blend.h"

/* Forgets the samples seen. */
static inline void rdpi_q31_rate_reset(rdpi_q31_rate_t *rate)
{
    rate->oldest = rate->window; /* none yet */
    rate->filtered = 0;
    rate->direct = false;
}

/* Sets the blend of the low-pass. */
static inline void rdpi_q31_rate_blend(rdpi_q31_rate_t *rate, uint32_t time_ns, uint32_t filter_ns)
{
    unsigned zeros = rdpi_q31_clz(time_ns);
    uint64_t quotient = ((uint64_t)(time_ns << zeros) << 31) / filter_ns; /* u 2^(31 + zeros), >= 2^30 */
    unsigned surplus = 32u - rdpi_q31_clz64(quotient | UINT32_MAX);
    rdpi_q31_scaled_t u = {(uint32_t)(quotient >> surplus), 31 + (int)zeros - (int)surplus};

    rdpi_q31_scaled_t blend = rdpi_q31_blend(u);
    rate->blend = blend.mantissa;
    rate->blend_shift = (uint8_t)(blend.exponent - 32);
}

/* Sets up `rate` for samples that are `sample_time_ns` apart, with no sample seen yet. rdpi_q31_init says what it
 * refuses. */
static inline rdpi_status_t rdpi_q31_rate_init(rdpi_q31_rate_t *rate, const rdpi_q31_params_t *params,
                                               uint32_t sample_time_ns)
{
    if (sample_time_ns == 0u) {
        return RDPI_ERR_SAMPLE_TIME;
    }
    uint64_t window = ((uint64_t)params->rate_window_ns + sample_time_ns / 2u) / sample_time_ns;
    window = window < 1u ? 1u : window;
    uint64_t window_ns = window * sample_time_ns;
    if (window > RDPI_MAX_WINDOW || window_ns > UINT32_MAX) {
        return RDPI_ERR_WINDOW;
    }
    /* distance per window at the guard, times 2^31: guard 2^guard_shift */
    uint64_t distance = params->guard_mantissa * window_ns;
    unsigned zeros = rdpi_q31_clz64(distance);
    int shift = 63 - (int)zeros + params->guard_exponent;
    if (shift < 0 || shift > 62) {
        return RDPI_ERR_RATE;
    }
    rate->window = (uint16_t)window;
    rate->guard = (uint32_t)((distance << zeros) >> 32);
    rate->guard_shift = (uint8_t)shift;
    rate->per_guard = (uint32_t)(((uint64_t)1 << 62) / rate->guard);
    rate->direct_shift = (uint8_t)(31u - rate->guard_shift);
    rate->blend = 0;
    rate->blend_shift = 0;
    if (params->rate_filter_ns > sample_time_ns / 64u) { /* or exp(-64) is left */
        rdpi_q31_rate_blend(rate, sample_time_ns, params->rate_filter_ns);
    }
    rdpi_q31_rate_reset(rate);
    return RDPI_OK;
}

/* The distance between two references. */
static inline uint32_t rdpi_q31_distance(int32_t a, int32_t b)
{
    return a > b ? (uint32_t)a - (uint32_t)b : (uint32_t)b - (uint32_t)a;
}

/* The direct case: the largest distance to the sample before that is within the guard. */
static inline uint32_t rdpi_q31_rate_direct_limit(const rdpi_q31_rate_t *rate)
{
    return rate->guard >> rate->direct_shift;
}

/* The direct case: the rate for a distance to the sample before, at most rdpi_q31_rate_direct_limit. */
static inline int32_t rdpi_q31_rate_direct(const rdpi_q31_rate_t *rate, uint32_t distance)
{
    return (int32_t)rdpi_q31_mulh(distance << rate->direct_shift, rate->per_guard);
}

/* The direct case: takes a sample, and returns its distance to the sample before. */
static inline uint32_t rdpi_q31_rate_direct_distance(rdpi_q31_rate_t *rate, int32_t z)
{
    uint32_t distance = rdpi_q31_distance(z, rate->z[0]);
    rate->z[0] = z;
    return distance;
}

/* As rdpi_f32_rate_step. Returns the rate: RDPI_Q31_ONE at the guard, and more beyond it. Sets `direct` for the next
 * sample. Scaling and overflow: distances are < 2^32. In 63 bits they carry 31 bits of fraction. */
static RDPI_Q31_SELDOM int32_t rdpi_q31_rate_step(rdpi_q31_rate_t *rate, int32_t z, unsigned missed)
{
    if (rate->oldest == rate->window || missed > RDPI_MAX_MISSED) {
        rdpi_q31_rate_reset(rate);
        for (size_t k = 0; k < rate->window; k++) {
            rate->z[k] = z;
        }
        rate->oldest = 0;
        missed = 0;
    }
    unsigned left = missed + 1u;
    rate->direct = rate->window == 1u && rate->blend == 0u && rate->guard_shift <= 31u;
    if (rate->direct) {
        uint32_t distance = rdpi_q31_rate_direct_distance(rate, z), way = rdpi_q31_part(distance, left);
        way = way * left < distance ? way + 1u : way;
        return way > rdpi_q31_rate_direct_limit(rate) ? INT32_MAX : rdpi_q31_rate_direct(rate, way);
    }
    int32_t last = rate->z[(rate->oldest > 0u ? rate->oldest : rate->window) - 1u];
    for (; left > 0u; left--) {
        uint32_t way = rdpi_q31_part(rdpi_q31_distance(z, last), left);
        last = (int32_t)(z > last ? (uint32_t)last + way : (uint32_t)last - way);
        int32_t oldest = rate->z[rate->oldest];
        rate->z[rate->oldest] = last;
        rate->oldest = (uint16_t)(rate->oldest + 1u < rate->window ? rate->oldest + 1u : 0u);

        int64_t raw = (int64_t)((uint64_t)rdpi_q31_distance(last, oldest) << 31);
        if (rate->blend == 0u) {
            rate->filtered = raw;
        } else {
            rate->filtered += rdpi_q31_mul_wide(raw - rate->filtered, rate->blend) >> rate->blend_shift;
        }
    }
    uint64_t distance = (uint64_t)rate->filtered >> rate->guard_shift;
    return distance > rate->guard ? INT32_MAX : (int32_t)rdpi_q31_mulh((uint32_t)distance, rate->per_guard);
}

#endif
