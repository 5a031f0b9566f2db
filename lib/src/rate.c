#include "rdpi/rate.h"

#include <tgmath.h> /* expm1 and isfinite for whichever type rdpi_real_t is */

rdpi_status_t rdpi_f32_rate_init(rdpi_f32_rate_t *rate, rdpi_real_t window_s, rdpi_real_t filter_s,
                                 rdpi_real_t sample_time_s)
{
    if (!(sample_time_s > 0) || !isfinite(sample_time_s)) {
        return RDPI_ERR_SAMPLE_TIME;
    }
    if (!(window_s >= 0) || !(filter_s >= 0) || !isfinite(filter_s)) {
        return RDPI_ERR_RATE;
    }
    rdpi_real_t samples = window_s / sample_time_s + (rdpi_real_t)0.5;
    if (!(samples < (rdpi_real_t)(RDPI_MAX_WINDOW + 1))) {
        return RDPI_ERR_WINDOW;
    }
    rate->window = samples < 2 ? (uint16_t)1 : (uint16_t)samples;
    rate->per_window_s = 1 / ((rdpi_real_t)rate->window * sample_time_s);
    if (!isfinite(2 * RDPI_MAX_REFERENCE_UM * rate->per_window_s)) {
        return RDPI_ERR_SAMPLE_TIME;
    }
    rate->blend = filter_s > 0 ? -expm1(-sample_time_s / filter_s) : 1;
    rdpi_f32_rate_reset(rate);
    return RDPI_OK;
}

void rdpi_f32_rate_reset(rdpi_f32_rate_t *rate)
{
    rate->started = false;
    rate->oldest = 0;
    rate->filtered_um_per_s = 0;
}

rdpi_real_t rdpi_f32_rate_step(rdpi_f32_rate_t *rate, rdpi_real_t z_um)
{
    if (!rate->started) {
        rate->started = true;
        for (uint16_t k = 0; k < rate->window; k++) {
            rate->z_um[k] = z_um;
        }
    }
    rdpi_real_t moved_um = z_um - rate->z_um[rate->oldest];
    rate->z_um[rate->oldest] = z_um;
    rate->oldest = (uint16_t)(rate->oldest + 1u < rate->window ? rate->oldest + 1u : 0u);

    rdpi_real_t raw_um_per_s = (moved_um < 0 ? -moved_um : moved_um) * rate->per_window_s;
    rate->filtered_um_per_s += rate->blend * (raw_um_per_s - rate->filtered_um_per_s);
    return rate->filtered_um_per_s;
}
