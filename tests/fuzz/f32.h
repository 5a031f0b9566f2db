/* What both fuzzers of the float library share. */
#ifndef FUZZ_F32_H
#define FUZZ_F32_H

#include <math.h>

#include "actuator.h"
#include "bytes.h"

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
    const rdpi_f32_line_t *line = params->curve;
    for (unsigned k = 1; k < params->curve_pieces && (x_um - line->to_um) * line->gain_um_per_V > 0; k++) {
        line++;
    }
    double drive_V = (double)x_um * (double)line->V_per_um + (double)line->offset_V;
    return drive_V >= (double)params->min_V && drive_V <= (double)params->max_V;
}

/* NaN, infinities and subnormals included. */
static number_t take_any(void)
{
    float value;
    take(&value, sizeof value);
    return (number_t)value;
}

#include "calls.h"

#endif
