/* The exact inverse of the rate-dependent play bank.
 *
 * The published inverse (Ang et al., eq. 12 and 18) is exact only while the weights are constant. This one keeps the
 * forward plays' own states and solves sum of w_i play_i(x) = v for x, so it is exact for any sequence of rates. */
#ifndef RDPI_INVERSE_H
#define RDPI_INVERSE_H

#include "rdpi/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The input x in um at which the bank's output is `v_um`, to rounding. Changes no state: move the plays to what was
 * really output with rdpi_f32_plays_move.
 *   y_um    states of the plays, y_um[0] = the present input; states that one history can reach (see
 *           rdpi_f32_set_memory)
 *   r_um    thresholds, 0 = r_0 < r_1 < ...
 *   slopes  W_i at the present rate, all > 0
 * Cost class: one division, O(count). ISR safe, re-entrant. */
rdpi_real_t rdpi_f32_plays_solve(const rdpi_real_t *y_um, const rdpi_real_t *r_um, const rdpi_real_t *slopes,
                                 size_t count, rdpi_real_t v_um);

#ifdef __cplusplus
}
#endif
#endif
