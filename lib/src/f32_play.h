/* The play (backlash) operator and its rate-dependent slope: Ang et al., IROS 2003, eq. 1 and 14. */
#ifndef RDPI_F32_PLAY_H
#define RDPI_F32_PLAY_H

#include "f32_math.h"

/* Eq. 1: the input `x_um` pushes the play of threshold `r_um` (>= 0) from its last output `y_um`. Returns where to. */
static inline rdpi_real_t rdpi_f32_play(rdpi_real_t x_um, rdpi_real_t r_um, rdpi_real_t y_um)
{
    rdpi_real_t low = x_um - r_um;
    rdpi_real_t high = x_um + r_um;
    return y_um < low ? low : (y_um > high ? high : y_um);
}

/* Eq. 14: W_i, the slope of the loading curve beyond r_i, at `rate_um_per_s` >= 0. */
static inline rdpi_real_t rdpi_f32_slope(const rdpi_f32_play_t *play, rdpi_real_t rate_um_per_s)
{
    return rdpi_f32_fma(play->slope_rate_s_per_um, rate_um_per_s, play->slope);
}

#endif
