/* The chain from command to displacement, one difference equation after the other, for the host tools: every effect
 * that remembers something, and the operator between them, with all that they remember in `state`. From a state to a
 * state: two calls with a part of the samples each give what one call with all of them gives. */
#ifndef RDPI_PLANT_H
#define RDPI_PLANT_H

#include "rdpi/rdpi.h"

#include "f32_rate.h"

typedef enum {
    RDPI_BLOCK_LINE,      /* p[0] + p[1] u */
    RDPI_BLOCK_BENT,      /* an input curve: quadratic, cubic, low_V, high_V */
    RDPI_BLOCK_CUBIC,     /* u + p[1] s (p[2] + s (p[3] + s p[4])), s = (u - p[0]) / p[1] - 1 */
    RDPI_BLOCK_CLAMP,     /* p[0] to p[1] */
    RDPI_BLOCK_ROUND,     /* to p[0] + k p[1] */
    RDPI_BLOCK_STAIRCASE, /* u + sum of a[i] sin((i + 1) p[0] u) */
    RDPI_BLOCK_SLEW,      /* at most p[0] per sample; state: the last output */
    RDPI_BLOCK_DELAY,     /* by count - 2 + p[0] samples; state: place of the oldest, then the last count - 1 inputs */
    RDPI_BLOCK_LAGS,      /* u + p[0] (u - rest) + sum of c[i] ahead[i]; see rdpi_plant_run. State: ahead, u, rest */
    RDPI_BLOCK_RING,      /* second order, transposed direct form II: a = 1 a1 a2, b; state: two and the zero */
    RDPI_BLOCK_PLAY,      /* a play of threshold p[0]; state: its output */
    RDPI_BLOCK_WIDEN,     /* (rate / p[0])^p[1], at most 2^p[1], times p[2] (u - p[4] - p[5] drive) + p[3] (u - p[6]) */
    RDPI_BLOCK_OPERATOR   /* p[0]: lowest and p[1]: highest rate; p[2] + p[3] drive: the control input; p[4]: steepest
                             piece of the saturation over its flattest. State: place of the oldest output, 1 if there was
                             a sample, the last rate, the last `count` outputs */
} rdpi_block_kind_t;

typedef struct {
    int kind;
    uint32_t count;
    rdpi_real_t p[7];
    const rdpi_real_t *a, *b, *c;
    rdpi_real_t *state;
    rdpi_f32_rate_t *rate; /* of RDPI_BLOCK_WIDEN */
    rdpi_f32_t *axis;      /* of RDPI_BLOCK_OPERATOR */
    int of_control;        /* ... whose rate is that of its control input, not of the displacement */
} rdpi_block_t;

/* rdpi_f32_rate_init. */
rdpi_status_t rdpi_plant_rate_init(rdpi_f32_rate_t *rate, rdpi_real_t window_s, rdpi_real_t filter_s,
                                   rdpi_real_t sample_time_s);

/* Runs a signal, (samples,), through `count` blocks, in its place. `driven_V` gets what goes into the operator, and
 * `rate_um_per_s` the operator's rate before the guard; without an operator, driven_V is what RDPI_BLOCK_WIDEN uses.
 *
 * A lag y' = (u - y) / T of a signal that is straight between samples is ahead of it by y_k - u_k = a[i] (y_(k-1) -
 * u_(k-1)) - b[i] (u_k - u_(k-1)), a = exp(-h / T), b = (1 - a) T / h.
 *
 * The operator's rate is that of what it gives, which depends on the rate: z = F(x, |dz/dt|), a differential equation
 * with the time constant dF/drate. Where a faster stroke goes further, as it does after each turn if faster loops are
 * wider, it is unstable: of the past follow no z, or several. Over N samples z depends on itself by c = dF/drate / (N T):
 * there is exactly one z if c < 1, and an error of the rate becomes -c / (1 - c) of it N samples later. N is the law's
 * window, or, while c is larger than a third, the least for which it is not. z lies between F at the lowest and F at the
 * highest rate, where it is sought. */
void rdpi_plant_run(const rdpi_block_t *block, size_t count, size_t samples, rdpi_real_t *signal, rdpi_real_t *driven_V,
                    rdpi_real_t *rate_um_per_s);

#endif
