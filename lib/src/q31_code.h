/* DAC codes in fixed point, to the drive and back. */
#ifndef RDPI_Q31_CODE_H
#define RDPI_Q31_CODE_H

#include "rdpi/q31.h"

/* The drive of a code. */
static inline int64_t rdpi_q31_drive_of_code(const rdpi_q31_params_t *params, int64_t code)
{
    int64_t half = (int64_t)1 << (params->drive_shift - 1u);
    return params->drive_of_code_0 + ((code * params->drive_per_code + half) >> params->drive_shift);
}

/* The code nearest to a drive inside the range. */
static inline int64_t rdpi_q31_code_of_drive(const rdpi_q31_params_t *params, int32_t drive)
{
    int64_t half = (int64_t)1 << (params->code_shift - 1u);
    return ((int64_t)(drive - params->drive_of_code_0) * params->codes_per_drive + half) >> params->code_shift;
}

#endif
