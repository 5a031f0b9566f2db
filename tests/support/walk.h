/* The plain breakpoint walk, the oracle for the library's bank: every play keeps its state and is moved by every
 * sample, the output is summed anew, and a solution starts from the present input. No prefix, no tail, nothing that
 * could drift; in long double. */
#ifndef RDPI_TEST_WALK_H
#define RDPI_TEST_WALK_H

#include "rdpi/f32.h"

typedef struct {
    const rdpi_f32_play_t *play;
    size_t count;
    long double y[RDPI_MAX_PLAYS]; /* y[0] = x */
} walk_t;

static inline long double walk_slope(const walk_t *self, size_t i, long double rate)
{
    return self->play[i].slope + rate * self->play[i].slope_rate_s_per_um;
}

/* Eq. 1 */
static inline void walk_move(walk_t *self, long double x)
{
    for (size_t i = 0; i < self->count; i++) {
        long double low = x - self->play[i].r_um, high = x + self->play[i].r_um;
        self->y[i] = self->y[i] < low ? low : (self->y[i] > high ? high : self->y[i]);
    }
}

/* Eq. 9 and 17: the sum of w_i y_i, w_i = W_i - W_(i-1). */
static inline long double walk_sum(const walk_t *self, long double rate)
{
    long double sum = 0, below = 0;
    for (size_t i = 0; i < self->count; i++) {
        long double slope = walk_slope(self, i, rate);
        sum += (slope - below) * self->y[i];
        below = slope;
    }
    return sum;
}

/* The x at which the sum is `v`. As x moves one way the sum is continuous, increasing and piecewise linear, with its
 * corners where the next play engages: rising at x = y_i + r_i, falling, which is rising in a mirror, at y_i - r_i. */
static inline long double walk_solve(const walk_t *self, long double rate, long double v)
{
    long double rise = v - walk_sum(self, rate); /* still to climb */
    long double side = rise < 0 ? -1 : 1, x = side * self->y[0];
    size_t k = 0;

    rise *= side;
    for (; k + 1 < self->count; k++) {
        long double corner = side * self->y[k + 1] + self->play[k + 1].r_um;
        if (corner > x) { /* else it is engaged already */
            long double climb = walk_slope(self, k, rate) * (corner - x);
            if (climb >= rise) {
                break;
            }
            rise -= climb;
            x = corner;
        }
    }
    return side * (x + rise / walk_slope(self, k, rate));
}

#endif
