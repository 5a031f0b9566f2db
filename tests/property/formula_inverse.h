/* The published inverse of the play bank, kept as the reference that the exact one is compared with: Ang et al., IROS
 * 2003, eq. 12, 13 and 18. Thresholds and weights of a second bank of plays are computed anew from the slopes of each
 * sample. Exact while the slopes are constant; with slopes that change it is not, because the states of the second
 * bank were reached with other thresholds. */
#ifndef RDPI_FORMULA_INVERSE_H
#define RDPI_FORMULA_INVERSE_H

#include "rdpi/play.h"

typedef struct {
    rdpi_real_t y_um[RDPI_MAX_PLAYS]; /* the second bank's states; all 0 at rest */
} formula_inverse_t;

/* One sample: the input x in um for the bank output `v_um` = S^-1(z). `r_um` and `slopes` are the thresholds and, at
 * the present rate, the slopes W_i of the forward bank. */
static inline rdpi_real_t formula_inverse_step(formula_inverse_t *self, const rdpi_real_t *r_um,
                                               const rdpi_real_t *slopes, size_t count, rdpi_real_t v_um)
{
    rdpi_real_t thresholds_um[RDPI_MAX_PLAYS], inverse_slopes[RDPI_MAX_PLAYS];
    for (size_t i = 0; i < count; i++) {
        /* eq. 12: r'_i = sum over j <= i of w_j (r_i - r_j), here as the loading curve's height at r_i */
        thresholds_um[i] = i == 0 ? 0 : thresholds_um[i - 1] + slopes[i - 1] * (r_um[i] - r_um[i - 1]);
        /* eq. 18: w'_0 + ... + w'_i = 1 / W_i */
        inverse_slopes[i] = 1 / slopes[i];
    }
    rdpi_f32_plays_move(self->y_um, thresholds_um, count, v_um);
    return rdpi_f32_plays_sum(self->y_um, inverse_slopes, count);
}

#endif
