/* The bank of rate-dependent plays and its exact inverse: Ang et al., IROS 2003, eq. 9 and 17.
 *
 * The published inverse (eq. 12 and 18) is exact only while the weights are constant. This one keeps the states y_i of
 * the forward plays themselves, and solves
 *
 *   f(x) = sum of w_i play_i(x) = v
 *
 * for x. It is therefore exact for any sequence of rates.
 *
 * As x moves one way, f is continuous, increasing and piecewise linear. Play i engages, which means that it begins to
 * move with x, at a corner of f: at x = y_i + r_i while x rises, at x = y_i - r_i while x falls. For states that one
 * history has led to, both sequences are ordered. The plays that move with x are therefore always 0 .. k, and
 *
 *   f(x) = W_k x + remainder,   remainder = sum over i > k of w_i y_i  -/+  P_k      (- rising, + falling).
 *
 * P_k = sum over i <= k of w_i r_i is the intercept of the loading curve. The remainder stays the same until a play
 * engages or x turns round. It is kept in two parts, at rate 0 and per unit rate, because w and P are linear in the
 * rate. Whenever a play engages or x turns round, it is summed afresh, so that rounding does not add up.
 *
 * Three ideas keep the code short:
 *
 * - Falling is rising seen in a mirror. `side`, +1 or -1, turns one into the other. `climb` is how far f has to climb,
 *   of either sign; `rise` is the same seen in the mirror, where x rises.
 * - The engaged plays need no states: x implies them. They are stored when x turns round.
 * - Looking for a solution (rdpi_f32_bank_walk) moves no play. rdpi_f32_bank_move does that, to what is really output.
 *
 * While no play engages or lets go, the solution is one division (rdpi_f32_bank_way). */
#ifndef RDPI_F32_BANK_H
#define RDPI_F32_BANK_H

#include <float.h>
#include <math.h> /* INFINITY */

#include "f32_play.h"

static inline rdpi_real_t rdpi_f32_bank_side(bool falling)
{
    return falling ? (rdpi_real_t)-1 : (rdpi_real_t)1;
}

/* The state of play i. */
static inline rdpi_real_t rdpi_f32_bank_state(const rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t i)
{
    rdpi_real_t lag_um = rdpi_f32_bank_side(bank->falling) * play[i].r_um;
    return i <= bank->engaged ? bank->y_um[0] - lag_um : bank->y_um[i];
}

/* Eq. 9 and 17: f at any x. It is summed by parts, f = sum of W_i (y_i - y_(i+1)), so that no weight is ever formed. */
static inline rdpi_real_t rdpi_f32_bank_at(const rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t count,
                                           rdpi_real_t rate_um_per_s, rdpi_real_t x_um)
{
    rdpi_real_t v_um = 0;
    rdpi_real_t y_um = x_um;
    for (size_t i = 1; i < count; i++) {
        rdpi_real_t next_um = rdpi_f32_play(x_um, play[i].r_um, rdpi_f32_bank_state(bank, play, i));
        v_um += rdpi_f32_slope(&play[i - 1u], rate_um_per_s) * (y_um - next_um);
        y_um = next_um;
    }
    return v_um + rdpi_f32_slope(&play[count - 1u], rate_um_per_s) * y_um;
}

/* Moves x on to `x_um`, in the direction in which it goes. Finds the plays that engage on the way, and sums the
 * remainder afresh over the others, by parts as rdpi_f32_bank_at does. The search goes from the last play down. It ends
 * at the place of the last engaged play at the latest: x implies the state of that play, so its place can hold a
 * sentinel. */
static inline void rdpi_f32_bank_advance(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t count,
                                         rdpi_real_t side, rdpi_real_t x_um)
{
    rdpi_real_t way_um = side * x_um;
    const rdpi_f32_play_t *row = &play[count - 1u];
    const rdpi_real_t *y_um = &bank->y_um[count - 1u];
    rdpi_real_t remainder_um = 0, remainder_rate_s = 0, above_um = 0;
    bank->y_um[bank->engaged] = -side * (rdpi_real_t)INFINITY;
    while (rdpi_f32_fma(side, *y_um, row->r_um) >= way_um) {
        rdpi_real_t apart_um = *y_um - above_um;
        above_um = *y_um;
        remainder_um = rdpi_f32_fma(row->slope, apart_um, remainder_um);
        remainder_rate_s = rdpi_f32_fma(row->slope_rate_s_per_um, apart_um, remainder_rate_s);
        y_um--;
        row--;
    }
    bank->last_engaged = row;
    bank->engaged = (uint16_t)(y_um - bank->y_um);
    bank->y_um[0] = x_um;
    remainder_um = rdpi_f32_fma(-row->slope, above_um, remainder_um);
    remainder_rate_s = rdpi_f32_fma(-row->slope_rate_s_per_um, above_um, remainder_rate_s);
    bank->remainder_um = rdpi_f32_fma(-side, row->intercept_um, remainder_um);
    bank->remainder_rate_s = rdpi_f32_fma(-side, row->intercept_rate_s, remainder_rate_s);
}

/* Takes the states `y_um`, which one history can lead to, as they are. x seems to come from below all corners, so that
 * no play is engaged, however the states are rounded. */
static inline void rdpi_f32_bank_set(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t count,
                                     const rdpi_real_t *y_um)
{
    rdpi_real_t x_um = y_um[0];
    for (size_t i = 1; i < count; i++) {
        bank->y_um[i] = y_um[i];
    }
    bank->falling = false;
    bank->engaged = 0;
    rdpi_f32_bank_advance(bank, play, count, 1, -FLT_MAX);
    bank->y_um[0] = x_um;
}

/* How far f has to climb to `v_um`. If that is against the direction in which x goes, x has to turn round. */
static inline rdpi_real_t rdpi_f32_bank_climb(const rdpi_f32_bank_t *bank, rdpi_real_t rate_um_per_s, rdpi_real_t v_um)
{
    rdpi_real_t left_um = v_um - rdpi_f32_fma(rate_um_per_s, bank->remainder_rate_s, bank->remainder_um);
    return rdpi_f32_fma(-rdpi_f32_slope(bank->last_engaged, rate_um_per_s), bank->y_um[0], left_um);
}

/* How far x has to go for f to climb by `climb_um`, if no play engages or lets go on the way. */
static inline rdpi_real_t rdpi_f32_bank_way(const rdpi_f32_bank_t *bank, rdpi_real_t rate_um_per_s,
                                            rdpi_real_t climb_um)
{
    return climb_um / rdpi_f32_slope(bank->last_engaged, rate_um_per_s);
}

/* Stores the states of the engaged plays, which x has implied so far. Called where x turns round: they stay there. */
static inline void rdpi_f32_bank_store(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, rdpi_real_t side)
{
    rdpi_real_t x_um = bank->y_um[0];
    for (size_t i = bank->engaged; i > 0u; i--) {
        bank->y_um[i] = rdpi_f32_fma(-side, play[i].r_um, x_um);
    }
}

/* An input of the bank. */
typedef struct {
    rdpi_real_t x_um;
    bool turned; /* x has to turn round on the way there, and rdpi_f32_bank_store has been called */
} rdpi_f32_target_t;

/* `x_um` from any source but rdpi_f32_bank_walk. */
static inline rdpi_f32_target_t rdpi_f32_bank_target(rdpi_real_t x_um)
{
    rdpi_f32_target_t target = {x_um, false};
    return target;
}

/* The x where f has climbed by `climb_um`, to rounding. All slopes must be > 0 at this rate. No play moves: call
 * rdpi_f32_bank_move with what is really output. The walk goes from corner to corner, seen in the mirror, up to the
 * last corner before that x. If there is no corner, x goes as far as rdpi_f32_bank_way, to the last bit. */
static inline rdpi_f32_target_t rdpi_f32_bank_walk(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t count,
                                                   rdpi_real_t rate_um_per_s, rdpi_real_t climb_um)
{
    const rdpi_f32_play_t *row = bank->last_engaged, *last = &play[count - 1u];
    const rdpi_real_t *y_um = &bank->y_um[bank->engaged];
    rdpi_real_t side = rdpi_f32_bank_side(bank->falling), rise_um = side * climb_um;
    rdpi_f32_target_t target = {0, rise_um < 0};

    if (target.turned) {
        rdpi_f32_bank_store(bank, play, side);
        side = -side;
        rise_um = -rise_um;
        row = play;
        y_um = bank->y_um;
    }
    rdpi_real_t slope = rdpi_f32_slope(row, rate_um_per_s);
    rdpi_real_t behind_um = -side * bank->y_um[0]; /* -x: it takes one copy less per corner than x itself */
    while (row != last) {
        y_um++;
        rdpi_real_t corner_um = rdpi_f32_fma(side, *y_um, row[1].r_um);
        rdpi_real_t beyond_um = rdpi_f32_fma(-slope, corner_um + behind_um, rise_um);
        if (beyond_um <= 0) {
            break;
        }
        rise_um = beyond_um;
        behind_um = -corner_um;
        row++;
        slope = rdpi_f32_slope(row, rate_um_per_s);
    }
    target.x_um = side * (rise_um / slope - behind_um);
    return target;
}

/* Moves the input to target.x_um, and every play with it. Returns the side to which x goes then. That side is the old
 * one if x does not move, even if target.turned. */
static RDPI_F32_SHARED rdpi_real_t rdpi_f32_bank_move(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t count,
                                                      rdpi_f32_target_t target)
{
    rdpi_real_t side = rdpi_f32_bank_side(bank->falling);
    bool let_go = false;
    if (side * target.x_um < side * bank->y_um[0]) {
        if (!target.turned) {
            rdpi_f32_bank_store(bank, play, side);
        }
        let_go = bank->engaged > 0u;
        bank->engaged = 0;
        bank->falling = !bank->falling;
        side = -side;
    }
    size_t next = bank->engaged + 1u;
    if (let_go ||
        (next < count && rdpi_f32_fma(side, bank->y_um[next], bank->last_engaged[1].r_um) < side * target.x_um)) {
        rdpi_f32_bank_advance(bank, play, count, side, target.x_um);
    } else {
        bank->y_um[0] = target.x_um;
    }
    return side;
}

#endif
