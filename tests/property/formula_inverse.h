/* The published inverse of the play bank, kept as the reference that the exact one is compared with: Ang et al., IROS
 * 2003, eq. 12, 13 and 18. Thresholds and weights of a second bank of plays are computed anew from the slopes of each
 * sample. Exact while the slopes are constant; with slopes that change it is not, because the states of the second
 * bank were reached with other thresholds. */
#ifndef RDPI_FORMULA_INVERSE_H
#define RDPI_FORMULA_INVERSE_H

#include "f32_play.h"

typedef struct {
    rdpi_real_t y_um[RDPI_MAX_PLAYS]; /* the second bank's states; all 0 at rest */
} formula_inverse_t;

/* One sample: the input x in um for the bank output `v_um` = S^-1(z), at the present rate. */
static inline rdpi_real_t formula_inverse_step(formula_inverse_t *self, const rdpi_f32_play_t *play, size_t count,
                                               rdpi_real_t rate_um_per_s, rdpi_real_t v_um)
{
    rdpi_real_t x_um = 0, threshold_um = 0, slope = 0, inverse_slope = 0;
    for (size_t i = 0; i < count; i++) {
        /* eq. 12: r'_i = sum over j <= i of w_j (r_i - r_j), here as the loading curve's height at r_i */
        threshold_um += i == 0 ? 0 : slope * (play[i].r_um - play[i - 1].r_um);
        slope = rdpi_f32_slope(&play[i], rate_um_per_s);
        /* eq. 18: w'_0 + ... + w'_i = 1 / W_i */
        rdpi_real_t weight = 1 / slope - inverse_slope;
        inverse_slope += weight;
        self->y_um[i] = rdpi_f32_play(v_um, threshold_um, self->y_um[i]);
        x_um += weight * self->y_um[i];
    }
    return x_um;
}

#endif
