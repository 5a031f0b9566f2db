/* The play (backlash) operator and a bank of them: Ang et al., IROS 2003, eq. 1, 9, 16 and 17.
 *
 * Cost class of every function: O(count). All are ISR safe, re-entrant, and valid for count >= 1. */
#ifndef RDPI_PLAY_H
#define RDPI_PLAY_H

#include "rdpi/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Eq. 1: the play of threshold `r_um` (>= 0) moves to where the input `x_um` pushes it from its last output `y_um`. */
static inline rdpi_real_t rdpi_f32_play(rdpi_real_t x_um, rdpi_real_t r_um, rdpi_real_t y_um)
{
    rdpi_real_t low = x_um - r_um;
    rdpi_real_t high = x_um + r_um;
    return y_um < low ? low : (y_um > high ? high : y_um);
}

/* Moves each of the `count` plays, states `y_um`, thresholds `r_um`, to the input `x_um`. */
void rdpi_f32_plays_move(rdpi_real_t *y_um, const rdpi_real_t *r_um, size_t count, rdpi_real_t x_um);

/* Eq. 14 and 15: slopes of the loading curve at `rate_um_per_s` >= 0, W_i = slope_i + slope_rate_i * rate, into
 * `slopes_out`. */
void rdpi_f32_slopes_at(rdpi_real_t *slopes_out, const rdpi_real_t *slopes, const rdpi_real_t *slope_rate_s_per_um,
                        size_t count, rdpi_real_t rate_um_per_s);

/* Eq. 9 and 17: v = sum of w_i y_i in um, with the play weights w_i = W_i - W_(i-1), w_0 = W_0 of eq. 16. */
rdpi_real_t rdpi_f32_plays_sum(const rdpi_real_t *y_um, const rdpi_real_t *slopes, size_t count);

#ifdef __cplusplus
}
#endif
#endif
