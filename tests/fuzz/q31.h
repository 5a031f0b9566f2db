/* What both fuzzers of the fixed-point library share. */
#ifndef FUZZ_Q31_H
#define FUZZ_Q31_H

#include <math.h>

#include "bytes.h"
#include "rdpi/q31.h"

#define rdpi(verb) rdpi_q31_##verb
#define DRIVE drive
#define RATE rate
#define MIN_DRIVE min_drive
#define MAX_DRIVE max_drive
#define THRESHOLD r
#define MEMORY memory
#define LOWEST_DRIVE (-RDPI_Q31_MAX_DRIVE)
typedef rdpi_q31_t axis_t;
typedef rdpi_q31_params_t params_t;
typedef int32_t number_t;

static number_t guard_of(const params_t *params)
{
    (void)params;
    return RDPI_Q31_ONE;
}

static bool usable_reference(number_t reference)
{
    return reference != RDPI_Q31_NO_REFERENCE;
}

static bool usable_drive(number_t drive, number_t rate)
{
    return drive >= -RDPI_Q31_MAX_DRIVE && drive <= RDPI_Q31_MAX_DRIVE && rate >= 0;
}

static bool is_nothing(number_t displacement)
{
    return displacement == RDPI_Q31_NO_REFERENCE;
}

static bool is_finite(number_t displacement)
{
    return displacement != RDPI_Q31_NO_REFERENCE;
}

static bool inside_range(const params_t *params, number_t x)
{
    return x >= params->min_x && x <= params->max_x;
}

static number_t take_any(void)
{
    return (number_t)take_u32();
}

/* `value` as mantissa / 2^shift. */
static int32_t mantissa_of(double value, uint8_t *shift)
{
    int exponent;
    double fraction = frexp(value, &exponent);
    double mantissa = round(ldexp(fraction, 31));
    if (fabs(mantissa) >= 0x1p31) {
        mantissa /= 2;
        exponent++;
    }
    *shift = (uint8_t)(31 - exponent);
    return (int32_t)mantissa;
}

/* The codes, if there are, of the whole range, from whichever end the gain says. */
static void derive_codes(params_t *params, bool rising)
{
    double last = ldexp(1, params->dac_bits) - 1, span = (double)params->max_drive - params->min_drive;
    params->drive_of_code_0 = rising ? params->min_drive : params->max_drive;
    if (params->dac_bits > 0) {
        params->codes_per_drive = mantissa_of((rising ? last : -last) / span, &params->code_shift);
        params->drive_per_code = mantissa_of((rising ? span : -span) / last, &params->drive_shift);
    }
}

/* The slopes of the pieces of the input curve, from where they begin and where the range ends. */
static void derive_curve(params_t *params, rdpi_q31_line_t *curve)
{
    for (size_t k = 0; k < params->curve_pieces; k++) {
        bool last = k + 1 == params->curve_pieces;
        double drives = (double)(last ? params->max_drive : curve[k + 1].from_drive) - curve[k].from_drive;
        double x = (double)(last ? params->max_x : curve[k + 1].from_x) - curve[k].from_x;
        uint8_t shift = 1;
        curve[k].x_per_drive = mantissa_of(x / drives, &shift);
        curve[k].x_shift = shift;
        curve[k].drive_per_x = mantissa_of(drives / x, &shift);
        curve[k].drive_shift = shift;
    }
}

#include "calls.h"

#endif
