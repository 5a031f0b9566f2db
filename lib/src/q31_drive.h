/* Conversions between the input x of the plays, the drive and DAC codes in fixed point. */
#ifndef RDPI_Q31_DRIVE_H
#define RDPI_Q31_DRIVE_H

#include "q31_code.h"
#include "q31_math.h"

/* Whether a drive or threshold fits its format. */
static inline bool rdpi_q31_in_format(int32_t drive)
{
    return drive >= -RDPI_Q31_MAX_DRIVE && drive <= RDPI_Q31_MAX_DRIVE;
}

/* The drive, or the end of the range that it is beyond. */
static inline int32_t rdpi_q31_in_range(const rdpi_q31_params_t *params, int32_t drive)
{
    return drive < params->min_drive ? params->min_drive : (drive > params->max_drive ? params->max_drive : drive);
}

/* The x, or the end of the range that it is beyond. */
static inline int32_t rdpi_q31_x_in_range(const rdpi_q31_params_t *params, int32_t x)
{
    return x < params->min_x ? params->min_x : (x > params->max_x ? params->max_x : x);
}

/* way 2^-shift factor, rounded. Scaling and overflow: |way| <= 2^30, so that the product stays within 2^61. */
static inline int64_t rdpi_q31_scale(int32_t way, int32_t factor, uint32_t shift)
{
    return (rdpi_q31_mul(way, factor) + ((int64_t)1 << (shift - 1u))) >> shift;
}

/* On one piece of the input curve. Scaling and overflow: saturates at +-RDPI_Q31_MAX_DRIVE. */
static inline int32_t rdpi_q31_line_x(const rdpi_q31_line_t *line, int32_t drive)
{
    return rdpi_q31_clamp(line->from_x + rdpi_q31_scale(drive - line->from_drive, line->x_per_drive, line->x_shift),
                          -RDPI_Q31_MAX_DRIVE, RDPI_Q31_MAX_DRIVE);
}

static inline int32_t rdpi_q31_line_drive(const rdpi_q31_line_t *line, int32_t x)
{
    return rdpi_q31_clamp(line->from_drive + rdpi_q31_scale(x - line->from_x, line->drive_per_x, line->drive_shift),
                          -RDPI_Q31_MAX_DRIVE, RDPI_Q31_MAX_DRIVE);
}

/* How many pieces checked parameters have. With RDPI_MAX_CURVE_PIECES 1, the compiler leaves out what follows for
 * more. */
static inline unsigned rdpi_q31_pieces(const rdpi_q31_params_t *params)
{
    return RDPI_MAX_CURVE_PIECES > 1 ? params->curve_pieces : 1u;
}

/* The input curve, at a drive in its format. */
static inline int32_t rdpi_q31_x_of_drive(const rdpi_q31_params_t *params, int32_t drive)
{
    const rdpi_q31_line_t *line = params->curve;
    if (rdpi_q31_pieces(params) == 1u) {
        return drive;
    }
    for (unsigned left = rdpi_q31_pieces(params); left > 1u && drive >= line[1].from_drive; left--) {
        line++;
    }
    return rdpi_q31_line_x(line, drive);
}

/* Its inverse, at an x in the range. */
static inline int32_t rdpi_q31_drive_of_x(const rdpi_q31_params_t *params, int32_t x)
{
    const rdpi_q31_line_t *line = params->curve;
    if (rdpi_q31_pieces(params) == 1u) {
        return x;
    }
    for (unsigned left = rdpi_q31_pieces(params); left > 1u && x >= line[1].from_x; left--) {
        line++;
    }
    return rdpi_q31_in_range(params, rdpi_q31_line_drive(line, x));
}

/* The drive of the last code, at max_V: the end of the range that is not the drive of code 0. */
static inline int32_t rdpi_q31_drive_of_last_code(const rdpi_q31_params_t *params)
{
    return params->min_drive + params->max_drive - params->drive_of_code_0;
}

/* The last code, which is the largest. */
static inline int32_t rdpi_q31_last_code(const rdpi_q31_params_t *params)
{
    return (int32_t)(((uint32_t)1 << params->dac_bits) - 1u);
}

/* Whether codes are 4 drive units or more apart (then drive_shift is 30 at most), and the numbers of output_direct in
 * rdpi_q31.c fit 32 bits. */
static inline bool rdpi_q31_codes_are_coarse(const rdpi_q31_params_t *params)
{
    return params->dac_bits > 0u && params->code_shift >= 33u && rdpi_q31_last_code(params) >> params->drive_shift == 0;
}

/* A slope per us as a change per sample. It saturates: no drive is further than 2^30 from another. */
static inline int64_t rdpi_q31_per_sample(uint64_t per_us, uint32_t sample_time_ns)
{
    const uint64_t most = (uint64_t)1 << 62;
    uint64_t whole = per_us / 1000u; /* per ns; the product of the rest does not overflow */
    return whole >= most / sample_time_ns
               ? (int64_t)most
               : (int64_t)(whole * sample_time_ns + per_us % 1000u * sample_time_ns / 1000u);
}

#endif
