/* The play (backlash) operator and its rate-dependent slope in fixed point: Ang et al., IROS 2003, eq. 1 and 14. */
#ifndef RDPI_Q31_PLAY_H
#define RDPI_Q31_PLAY_H

#include "q31_math.h"

/* Eq. 1. Scaling and overflow: all are drive units. x - r and x + r stay within 2^30. */
static inline int32_t rdpi_q31_play(int32_t x, int32_t r, int32_t y)
{
    int32_t low = x - r;
    int32_t high = x + r;
    return y < low ? low : (y > high ? high : y);
}

/* Eq. 14: W_i at `rate`, 0 .. RDPI_Q31_ONE. Scaling and overflow: rounded down. W_i stays between its values at rest
 * and at the guard. */
static inline int32_t rdpi_q31_slope(const rdpi_q31_play_t *play, int32_t rate)
{
    return play->slope + (int32_t)(rdpi_q31_mul_rate(play->slope_rate, rate) >> 30);
}

#endif
