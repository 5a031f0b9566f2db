/* The play (backlash) operator and its rate-dependent weights: Ang et al., IROS 2003, eq. 1 and 14. */
#ifndef RDPI_PLAY_H
#define RDPI_PLAY_H

#include <tgmath.h> /* fma of whichever type rdpi_real_t is */

#include "rdpi/f32.h"

/* Whether steps take a short way where no play engages or lets go: a third of the instructions, 2 to 3 kB of code. */
#if !defined(RDPI_QUICK_STEP)
#if defined(__OPTIMIZE_SIZE__)
#define RDPI_QUICK_STEP 0
#else
#define RDPI_QUICK_STEP 1
#endif
#endif

/* Of functions: APART from callers whose usual way must not pay for it; WITHIN its callers; SHARED, once in the program
 * where size counts, within its callers where time does. */
#if !defined(__GNUC__) || !defined(__OPTIMIZE__)
#define RDPI_APART
#define RDPI_WITHIN inline
#define RDPI_SHARED inline
#elif RDPI_QUICK_STEP
#define RDPI_APART __attribute__((noinline))
#define RDPI_WITHIN inline __attribute__((always_inline))
#define RDPI_SHARED RDPI_WITHIN
#else
#define RDPI_APART
#define RDPI_WITHIN inline
#define RDPI_SHARED __attribute__((noinline, unused))
#endif

/* a b + c, in one instruction where the core has one; never a call of libm's. */
static inline rdpi_real_t rdpi_f32_fma(rdpi_real_t a, rdpi_real_t b, rdpi_real_t c)
{
#if defined(__FP_FAST_FMAF)
    return fma(a, b, c);
#else
    return a * b + c;
#endif
}

/* Eq. 1: the play of threshold `r_um` (>= 0) moves to where the input `x_um` pushes it from its last output `y_um`. */
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
