/* Conversions between the drive and DAC codes in fixed point. The drive is the input x of the plays. */
#ifndef RDPI_Q31_DRIVE_H
#define RDPI_Q31_DRIVE_H

#include "q31_math.h"

/* Whether a drive or threshold fits its format. */
static bool rdpi_q31_in_format(int32_t drive)
{
    return drive >= -RDPI_Q31_MAX_DRIVE && drive <= RDPI_Q31_MAX_DRIVE;
}

/* The drive, or the end of the range that it is beyond. */
static int32_t rdpi_q31_in_range(const rdpi_q31_params_t *params, int32_t drive)
{
    return drive < params->min_drive ? params->min_drive : (drive > params->max_drive ? params->max_drive : drive);
}

static int64_t rdpi_q31_drive_of_code(const rdpi_q31_params_t *params, int64_t code)
{
    int64_t half = (int64_t)1 << (params->drive_shift - 1u);
    return params->drive_of_code_0 + ((code * params->drive_per_code + half) >> params->drive_shift);
}

/* The code nearest to a drive inside the range. */
static int64_t rdpi_q31_code_of_drive(const rdpi_q31_params_t *params, int32_t drive)
{
    int64_t half = (int64_t)1 << (params->code_shift - 1u);
    return ((int64_t)(drive - params->drive_of_code_0) * params->codes_per_drive + half) >> params->code_shift;
}

/* The drive of the last code, at max_V: the end of the range that is not the drive of code 0. */
static int32_t rdpi_q31_drive_of_last_code(const rdpi_q31_params_t *params)
{
    return params->min_drive + params->max_drive - params->drive_of_code_0;
}

/* The last code, which is the largest. */
static int32_t rdpi_q31_last_code(const rdpi_q31_params_t *params)
{
    return (int32_t)(((uint32_t)1 << params->dac_bits) - 1u);
}

/* Whether codes are 4 drive units or more apart (then drive_shift is 30 at most), and the numbers of output_direct in
 * rdpi_q31.c fit 32 bits. */
static bool rdpi_q31_codes_are_coarse(const rdpi_q31_params_t *params)
{
    return params->dac_bits > 0u && params->code_shift >= 33u && rdpi_q31_last_code(params) >> params->drive_shift == 0;
}

#endif
