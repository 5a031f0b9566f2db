/* Conversions between the drive, the input x of the plays, and DAC codes: the input curve. Its pieces are searched from
 * the first, because few steps search. With RDPI_MAX_CURVE_PIECES 1, the compiler knows the piece, and no code is left
 * of any search. */
#ifndef RDPI_F32_DRIVE_H
#define RDPI_F32_DRIVE_H

#include "f32_math.h"

#if RDPI_MAX_CURVE_PIECES > 1
#define RDPI_F32_SEARCH RDPI_F32_SHARED
#else
#define RDPI_F32_SEARCH inline
#endif

/* rdpi_f32_forward refuses a drive that is further outside the range than this many times its width. */
#define MAX_SPANS 16

/* How many pieces checked parameters have. */
static inline unsigned rdpi_f32_pieces(const rdpi_f32_params_t *params)
{
    return RDPI_MAX_CURVE_PIECES > 1 ? params->curve_pieces : 1u;
}

/* The piece on which a drive lies. */
static RDPI_F32_SEARCH const rdpi_f32_line_t *rdpi_f32_line_of_drive(const rdpi_f32_params_t *params,
                                                                     rdpi_real_t drive_V)
{
    const rdpi_f32_line_t *line = params->curve;
    for (unsigned left = rdpi_f32_pieces(params); left > 1u && drive_V > line->to_V; left--) {
        line++;
    }
    return line;
}

/* The piece on which an x lies. Where the gain is negative, x falls from piece to piece. */
static RDPI_F32_SEARCH const rdpi_f32_line_t *rdpi_f32_line_of_x(const rdpi_f32_params_t *params, rdpi_real_t x_um)
{
    const rdpi_f32_line_t *line = params->curve;
    for (unsigned left = rdpi_f32_pieces(params); left > 1u && (x_um - line->to_um) * line->gain_um_per_V > 0; left--) {
        line++;
    }
    return line;
}

/* The piece on which a code lies that an x on `line` has been rounded to: the next one at the end of `line`. */
static inline const rdpi_f32_line_t *rdpi_f32_line_of_code(const rdpi_f32_params_t *params, const rdpi_f32_line_t *line,
                                                           rdpi_real_t code)
{
#if RDPI_MAX_CURVE_PIECES > 1
    bool next = code >= line->to_code && line != &params->curve[params->curve_pieces - 1u];
    return next ? &line[1] : line;
#else
    (void)line;
    (void)code;
    return params->curve;
#endif
}

static inline rdpi_real_t rdpi_f32_x_of_drive(const rdpi_f32_line_t *line, rdpi_real_t drive_V)
{
    return line->gain_um_per_V * (drive_V - line->offset_V);
}

static inline rdpi_real_t rdpi_f32_drive_of_x(const rdpi_f32_line_t *line, rdpi_real_t x_um)
{
    return rdpi_f32_fma(x_um, line->V_per_um, line->offset_V);
}

/* The code nearest to an x on `line` and inside the range, to rounding. 0 without codes. */
static RDPI_F32_SHARED uint32_t rdpi_f32_code_of_x(const rdpi_f32_params_t *params, const rdpi_f32_line_t *line,
                                                   rdpi_real_t x_um)
{
    rdpi_real_t code = rdpi_f32_fma(x_um, line->codes_per_um, line->code_of_x_0);
    return (uint32_t)rdpi_f32_clamp(code, 0, params->last_code);
}

#endif
