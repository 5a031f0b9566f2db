/* What both fuzzers of the float library share. */
#ifndef FUZZ_F32_H
#define FUZZ_F32_H

#include <math.h>

#include "bytes.h"
#include "rdpi/f32.h"

#define rdpi(verb) rdpi_f32_##verb
#define DRIVE drive_V
#define RATE rate_um_per_s
#define MIN_DRIVE min_V
#define MAX_DRIVE max_V
#define THRESHOLD r_um
#define MEMORY memory_um
#define LOWEST_DRIVE (-1e30)
typedef rdpi_f32_t axis_t;
typedef rdpi_f32_params_t params_t;
typedef rdpi_real_t number_t;

static number_t guard_of(const params_t *params)
{
    return params->max_um_per_s;
}

static bool usable_reference(number_t reference)
{
    return fabs((double)reference) <= RDPI_MAX_REFERENCE_UM;
}

static bool usable_drive(number_t drive, number_t rate)
{
    return !isnan(drive) && rate >= 0;
}

static bool is_nothing(number_t displacement)
{
    return isnan(displacement);
}

static bool is_finite(number_t displacement)
{
    return isfinite(displacement);
}

static bool inside_range(const params_t *params, number_t x_um)
{
    double drive_V = (double)x_um * (double)params->V_per_um + (double)params->offset_V;
    return drive_V >= (double)params->min_V && drive_V <= (double)params->max_V;
}

/* NaN, infinities and subnormals included. */
static number_t take_any(void)
{
    float value;
    take(&value, sizeof value);
    return (number_t)value;
}

/* Intercepts by their recurrence. */
static void derive_intercepts(rdpi_f32_play_t *play, size_t count)
{
    double intercept = 0, rate = 0;
    for (size_t i = 0; i < count; i++) {
        if (i > 0) {
            intercept += ((double)play[i].slope - play[i - 1].slope) * play[i].r_um;
            rate += ((double)play[i].slope_rate_s_per_um - play[i - 1].slope_rate_s_per_um) * play[i].r_um;
        }
        play[i].intercept_um = (rdpi_real_t)intercept;
        play[i].intercept_rate_s = (rdpi_real_t)rate;
    }
}

/* S^-1 from S (eq. 13): thresholds are images of thresholds, slopes are inverses of slopes. */
static void derive_inverse(rdpi_f32_deadzone_t *inverse, const rdpi_f32_deadzone_t *saturation, size_t count)
{
    double slope = 0, image = 0, inverse_before = 0;
    for (size_t j = 0; j < count; j++) {
        if (j > 0) {
            image += slope * ((double)saturation[j].d_um - saturation[j - 1].d_um);
        }
        slope += saturation[j].weight;
        inverse[j].d_um = (rdpi_real_t)image;
        inverse[j].weight = (rdpi_real_t)(1 / slope - inverse_before);
        inverse_before = 1 / slope;
    }
}

#include "calls.h"

#endif
