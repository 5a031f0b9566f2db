/* The exact inverse of the rate-dependent play bank, and the bank's states that make it cheap.
 *
 * The published inverse (Ang et al., IROS 2003, eq. 12 and 18) is exact only while the weights are constant. This one
 * keeps the forward plays' own states and solves f(x) = sum of w_i play_i(x) = v for x (eq. 9 and 17), so it is exact
 * for any sequence of rates.
 *
 * As x moves one way, f is continuous, increasing and piecewise linear. Its corners are where the next play engages:
 * rising at x = y_i + r_i, falling at x = y_i - r_i. Both sequences are ordered for states reached from one history, so
 * the plays that move with x are always 0 .. k, the slope is W_k, and
 *
 *   f(x) = W_k x + rest,   rest = sum over i > k of w_i y_i  -/+  P_k      (- rising, + falling),
 *
 * where P_k = sum over i <= k of w_i r_i is the loading curve's intercept. Neither x nor rest changes the other until a
 * play engages or x turns round; w and P are linear in the rate, so rest is kept in two parts. Falling is rising seen
 * in a mirror: `side`, +1 or -1, turns it over.
 *
 * rest is summed afresh whenever a play engages or x turns round, so rounding cannot pile up. While none engages and
 * the engaged ones do not let go, the solution is one division (rdpi_f32_bank_way). */
#ifndef RDPI_F32_BANK_H
#define RDPI_F32_BANK_H

#include <float.h>
#include <math.h> /* INFINITY */

#include "f32_play.h"

static inline rdpi_real_t rdpi_f32_bank_side(bool falling)
{
    return falling ? (rdpi_real_t)-1 : (rdpi_real_t)1;
}

/* State of play i. */
static inline rdpi_real_t rdpi_f32_bank_state(const rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t i)
{
    rdpi_real_t lag_um = rdpi_f32_bank_side(bank->falling) * play[i].r_um;
    return i <= bank->engaged ? bank->y_um[0] - lag_um : bank->y_um[i];
}

/* f at any x, as eq. 9 and 17 define it. Summed by parts, f = sum of W_i (y_i - y_(i+1)): no weight is ever formed. */
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

/* Takes x, where it is heading, to `x_um`: finds out which plays engage, and sums rest afresh over those that do not,
 * by parts as rdpi_f32_bank_at does. The state of the last that is engaged already is implied by x, so its place can
 * end the search. */
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

/* Takes on `y_um`, states that one history can reach, as they are: x seems to come from below them all, so that none is
 * engaged, however they are rounded. */
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

/* How far f has to climb to `v_um`. Where it has to climb away from where x is heading, x turns round. */
static inline rdpi_real_t rdpi_f32_bank_climb(const rdpi_f32_bank_t *bank, rdpi_real_t rate_um_per_s, rdpi_real_t v_um)
{
    rdpi_real_t left_um = v_um - rdpi_f32_fma(rate_um_per_s, bank->remainder_rate_s, bank->remainder_um);
    return rdpi_f32_fma(-rdpi_f32_slope(bank->last_engaged, rate_um_per_s), bank->y_um[0], left_um);
}

/* How far x has to go for f to climb by `climb_um` if no play engages or lets go on the way there. */
static inline rdpi_real_t rdpi_f32_bank_way(const rdpi_f32_bank_t *bank, rdpi_real_t rate_um_per_s,
                                            rdpi_real_t climb_um)
{
    return climb_um / rdpi_f32_slope(bank->last_engaged, rate_um_per_s);
}

/* Notes where x, heading for `side`, has taken the engaged plays: there they stay once it turns round. */
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

/* `x_um`, from any source. */
static inline rdpi_f32_target_t rdpi_f32_bank_target(rdpi_real_t x_um)
{
    rdpi_f32_target_t target = {x_um, false};
    return target;
}

/* The x where f has climbed by `climb_um`, to rounding, for slopes that are all > 0 at this rate. No play moves;
 * rdpi_f32_bank_move must follow, to what is really output. Walks from corner to corner, all seen in the mirror, to the
 * last one before that x; where there is none, x goes rdpi_f32_bank_way, to the last bit. */
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
    rdpi_real_t behind_um = -side * bank->y_um[0]; /* less x: one copy less per corner than x itself */
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

/* The x at which f is `v_um`. */
static inline rdpi_f32_target_t rdpi_f32_bank_solve(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t count,
                                                    rdpi_real_t rate_um_per_s, rdpi_real_t v_um)
{
    return rdpi_f32_bank_walk(bank, play, count, rate_um_per_s, rdpi_f32_bank_climb(bank, rate_um_per_s, v_um));
}

/* Moves every play (eq. 1) to the input target.x_um. Returns the side where x is heading then: it has not turned round if
 * what is output has it stay. */
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
