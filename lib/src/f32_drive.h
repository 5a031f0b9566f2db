/* Conversions between the drive, the input x of the plays, and DAC codes. */
#ifndef RDPI_F32_DRIVE_H
#define RDPI_F32_DRIVE_H

#include "f32_math.h"

static rdpi_real_t rdpi_f32_x_of_drive(const rdpi_f32_params_t *params, rdpi_real_t drive_V)
{
    return params->gain_um_per_V * (drive_V - params->offset_V);
}

static rdpi_real_t rdpi_f32_drive_of_x(const rdpi_f32_params_t *params, rdpi_real_t x_um)
{
    return rdpi_f32_fma(x_um, params->V_per_um, params->offset_V);
}

/* The code nearest to an x inside the range, to rounding. 0 without codes. */
static RDPI_F32_SHARED uint32_t rdpi_f32_code_of_x(const rdpi_f32_params_t *params, rdpi_real_t x_um)
{
    rdpi_real_t code = rdpi_f32_fma(x_um, params->codes_per_um, params->code_of_x_0);
    return (uint32_t)rdpi_f32_clamp(code, 0, params->last_code);
}

#endif
