/* The saturation stage, a sum of one-sided dead zones, and its inverse: Ang et al., IROS 2003, eq. 7, 8 and 13. */
#ifndef RDPI_F32_SATURATION_H
#define RDPI_F32_SATURATION_H

#include "f32_math.h"

/* Eq. 7: the one-sided dead zone of threshold `d_um` > 0. */
static inline rdpi_real_t rdpi_f32_deadzone(rdpi_real_t v_um, rdpi_real_t d_um)
{
    return v_um > d_um ? v_um - d_um : 0;
}

/* Eq. 8: S(v) = sum of ws_j S_dj(v), S_0(v) = v. Thresholds ascend: the sum ends at the first that v does not exceed.
 * O(count), count >= 1. */
static inline rdpi_real_t rdpi_f32_saturation(const rdpi_f32_deadzone_t *term, size_t count, rdpi_real_t v_um)
{
    const rdpi_f32_deadzone_t *end = &term[count];
    rdpi_real_t z_um = term->weight * v_um;
    for (term++; term != end && v_um > term->d_um; term++) {
        z_um += term->weight * rdpi_f32_deadzone(v_um, term->d_um);
    }
    return z_um;
}

/* The piece of S^-1 on which a reference lies. Beyond the ends of the table, the first or the last piece goes on.
 * O(count), count >= 1. */
static inline const rdpi_f32_piece_t *rdpi_f32_piece_find(const rdpi_f32_piece_t *piece, size_t count,
                                                          rdpi_real_t reference_um)
{
    while (--count > 0u && reference_um > piece->to_um) {
        piece++;
    }
    return piece;
}

/* Whether a reference lies inside the piece. Its ends do not: each of them belongs to one of two pieces. */
static inline bool rdpi_f32_piece_holds(const rdpi_f32_piece_t *piece, rdpi_real_t reference_um)
{
    return (reference_um - piece->from_um) * (piece->to_um - reference_um) > 0;
}

/* Eq. 13: S^-1 on one piece. */
static inline rdpi_real_t rdpi_f32_piece_at(const rdpi_f32_piece_t *piece, rdpi_real_t z_um)
{
    return rdpi_f32_fma(piece->slope, z_um, piece->intercept_um);
}

#endif
