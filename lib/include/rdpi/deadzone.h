/* The saturation stage, a sum of one-sided dead zones, and its inverse: Ang et al., IROS 2003, eq. 7, 8 and 13.
 *
 * S(v) = sum of ws_j S_dj(v) with 0 = d_0 < d_1 < ... < d_m, S_0(v) = v and S_d(v) = max(v - d, 0). It is piecewise
 * linear; the slope of piece j is ws_0 + ... + ws_j, and S has an inverse iff all of them are positive.
 *
 * Cost class of every function: O(count). All are ISR safe, re-entrant, and valid for count >= 1. */
#ifndef RDPI_DEADZONE_H
#define RDPI_DEADZONE_H

#include "rdpi/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Eq. 7: the one-sided dead zone of threshold `d_um` > 0. */
static inline rdpi_real_t rdpi_f32_deadzone(rdpi_real_t v_um, rdpi_real_t d_um)
{
    return v_um > d_um ? v_um - d_um : 0;
}

/* Eq. 8: z = S(v), um. */
rdpi_real_t rdpi_f32_saturation(const rdpi_real_t *d_um, const rdpi_real_t *weights, size_t count, rdpi_real_t v_um);

/* Eq. 13 solved for v: v = S^-1(z), um, for any finite z. */
rdpi_real_t rdpi_f32_saturation_inverse(const rdpi_real_t *d_um, const rdpi_real_t *weights, size_t count,
                                        rdpi_real_t z_um);

#ifdef __cplusplus
}
#endif
#endif
