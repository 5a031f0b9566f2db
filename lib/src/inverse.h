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
 * the engaged ones do not let go, the solution is one division (rdpi_f32_bank_near). */
#ifndef RDPI_INVERSE_H
#define RDPI_INVERSE_H

#include "play.h"

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

/* Sums rest afresh for `engaged` plays engaged. */
static inline void rdpi_f32_bank_engage(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t count,
                                        size_t engaged)
{
    rdpi_real_t side = rdpi_f32_bank_side(bank->falling);
    const rdpi_f32_play_t *row = &play[engaged], *last = &play[count - 1u];
    const rdpi_real_t *next_um = &bank->y_um[engaged + 1u];
    rdpi_real_t rest_um = -side * row->intercept_um;
    rdpi_real_t rest_rate_s = -side * row->intercept_rate_s;
    bank->at = row;
    bank->engaged = (uint16_t)engaged;
    for (; row != last; row++) {
        rest_um = rdpi_f32_fma(row[1].slope - row->slope, *next_um, rest_um);
        rest_rate_s = rdpi_f32_fma(row[1].slope_rate_s_per_um - row->slope_rate_s_per_um, *next_um, rest_rate_s);
        next_um++;
    }
    bank->rest_um = rest_um;
    bank->rest_rate_s = rest_rate_s;
}

/* Takes on `y_um`, states that one history can reach. */
static inline void rdpi_f32_bank_set(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t count,
                                     const rdpi_real_t *y_um)
{
    for (size_t i = 0; i < count; i++) {
        bank->y_um[i] = y_um[i];
    }
    bank->falling = false;
    rdpi_f32_bank_engage(bank, play, count, 0);
}

/* v less rest. */
static inline rdpi_real_t rdpi_f32_bank_left(const rdpi_f32_bank_t *bank, rdpi_real_t rate_um_per_s, rdpi_real_t v_um)
{
    return v_um - rdpi_f32_fma(rate_um_per_s, bank->rest_rate_s, bank->rest_um);
}

/* The x at which f is `v_um` if no play engages or lets go on the way there. */
static inline rdpi_real_t rdpi_f32_bank_near(const rdpi_f32_bank_t *bank, rdpi_real_t rate_um_per_s, rdpi_real_t v_um)
{
    return rdpi_f32_bank_left(bank, rate_um_per_s, v_um) / rdpi_f32_slope(bank->at, rate_um_per_s);
}

/* x turns round: the engaged plays stay where it has taken them. Leaves rest as it was. */
static inline void rdpi_f32_bank_turn(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play)
{
    rdpi_real_t side = rdpi_f32_bank_side(bank->falling);
    for (size_t i = bank->engaged; i > 0u; i--) {
        bank->y_um[i] = bank->y_um[0] - side * play[i].r_um;
    }
    bank->engaged = 0;
    bank->falling = !bank->falling;
}

/* An input of the bank. */
typedef struct {
    rdpi_real_t x_um;
    size_t engaged; /* a guess, which saves time, at how many plays it engages */
    bool turned;    /* x has turned round, and rest is still to be summed */
} rdpi_f32_target_t;

/* The x at which f is `v_um`, to rounding, for slopes that are all > 0 at this rate. No play moves; rdpi_f32_bank_move
 * must follow, to what is really output. Walks from corner to corner, all seen in the mirror, and from the first that
 * lies beyond v back. */
static inline rdpi_f32_target_t rdpi_f32_bank_solve(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t count,
                                                    rdpi_real_t rate_um_per_s, rdpi_real_t v_um)
{
    rdpi_real_t slope = rdpi_f32_slope(bank->at, rate_um_per_s);
    rdpi_real_t left_um = rdpi_f32_bank_left(bank, rate_um_per_s, v_um);
    rdpi_real_t rise_um = rdpi_f32_fma(-slope, bank->y_um[0], left_um); /* still to climb */
    bool falling = rise_um < 0;
    rdpi_real_t side = rdpi_f32_bank_side(falling);
    rdpi_real_t x_um = side * bank->y_um[0];
    rdpi_f32_target_t target = {0, bank->engaged, falling != bank->falling};

    if (target.turned) {
        rdpi_f32_bank_turn(bank, play);
        target.engaged = 0;
        slope = rdpi_f32_slope(play, rate_um_per_s);
    }
    rise_um *= side;
    play += target.engaged;
    while (rise_um > 0 && target.engaged + 1u < count) {
        play++;
        rdpi_real_t corner_um = rdpi_f32_fma(side, bank->y_um[target.engaged + 1u], play->r_um);
        rise_um = rdpi_f32_fma(-slope, corner_um - x_um, rise_um);
        x_um = corner_um;
        if (rise_um > 0) { /* v lies beyond it */
            target.engaged++;
            slope = rdpi_f32_slope(play, rate_um_per_s);
        }
    }
    target.x_um = side * (x_um + rise_um / slope);
    return target;
}

/* Whether play i has engaged when x, on its way to where the bank is heading, gets to `x_um`. */
static inline bool rdpi_f32_bank_engages(const rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t i,
                                         rdpi_real_t side, rdpi_real_t x_um)
{
    return side * (x_um - bank->y_um[i]) > play[i].r_um;
}

/* Moves every play (eq. 1) to the input target.x_um. */
static inline void rdpi_f32_bank_move(rdpi_f32_bank_t *bank, const rdpi_f32_play_t *play, size_t count,
                                      rdpi_f32_target_t target)
{
    if (target.x_um != bank->y_um[0] && (target.x_um < bank->y_um[0]) != bank->falling) {
        rdpi_f32_bank_turn(bank, play);
        target.turned = true;
    }
    rdpi_real_t side = rdpi_f32_bank_side(bank->falling);
    size_t k = target.engaged > bank->engaged ? target.engaged : bank->engaged;
    while (k + 1u < count && rdpi_f32_bank_engages(bank, play, k + 1u, side, target.x_um)) {
        k++;
    }
    while (k > bank->engaged && !rdpi_f32_bank_engages(bank, play, k, side, target.x_um)) {
        k--;
    }
    if (target.turned || k > bank->engaged) {
        rdpi_f32_bank_engage(bank, play, count, k);
    }
    bank->y_um[0] = target.x_um;
}

#endif
