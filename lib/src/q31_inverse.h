/* The exact inverse of the rate-dependent play bank in fixed point. The method is that of inverse.h; here
 *
 *   2^30 f(x) = W_k x + rest + rho / 2^30 rest_rate
 *
 * and rest, rest_rate are exact integers, so they need not be summed afresh: f does not jump where a play engages or x
 * turns round, and that alone says how rest changes there.
 *
 * Scaling and overflow: |x|, |y|, r <= 2^29, so corners stay within 2^30 and distances to them within 2^31; slopes
 * <= 2^30 and neighbouring states differ by no more than their thresholds do, so |rest|, |rest_rate| <= 3 2^59. */
#ifndef RDPI_Q31_INVERSE_H
#define RDPI_Q31_INVERSE_H

#include "q31_play.h"

/* An input of the bank, and a guess, which saves time, at how many plays it engages. */
typedef struct {
    int32_t x;
    size_t engaged;
} rdpi_q31_target_t;

static inline int32_t rdpi_q31_bank_side(bool falling)
{
    return falling ? -1 : 1;
}

/* State of play i. */
static inline int32_t rdpi_q31_bank_state(const rdpi_q31_bank_t *bank, const rdpi_q31_play_t *play, size_t i)
{
    return i <= bank->engaged ? bank->y[0] - rdpi_q31_bank_side(bank->falling) * play[i].r : bank->y[i];
}

/* f at any x, as eq. 9 and 17 define it, summed by parts: v. */
static inline int32_t rdpi_q31_bank_at(const rdpi_q31_bank_t *bank, const rdpi_q31_play_t *play, size_t count,
                                       int32_t rate, int32_t x)
{
    int64_t sum = 0;
    int32_t y = x;
    for (size_t i = 1; i < count; i++) {
        int32_t next = rdpi_q31_play(x, play[i].r, rdpi_q31_bank_state(bank, play, i));
        sum += (int64_t)rdpi_q31_slope(&play[i - 1u], rate) * (y - next);
        y = next;
    }
    sum += (int64_t)rdpi_q31_slope(&play[count - 1u], rate) * y;
    return (int32_t)(sum >> 30);
}

/* What play i adds to rest, with its weight at rate 0 and with the change of that, as its state becomes `y`. */
static inline void rdpi_q31_bank_add(rdpi_q31_bank_t *bank, const rdpi_q31_play_t *play, size_t i, int32_t y)
{
    bank->rest += (int64_t)(play[i].slope - play[i - 1u].slope) * y;
    bank->rest_rate += (int64_t)(play[i].slope_rate - play[i - 1u].slope_rate) * y;
}

/* Takes on `y`, states that one history can reach. */
static inline void rdpi_q31_bank_set(rdpi_q31_bank_t *bank, const rdpi_q31_play_t *play, size_t count, const int32_t *y)
{
    bank->rest = 0;
    bank->rest_rate = 0;
    bank->engaged = 0;
    bank->falling = false;
    bank->y[0] = y[0];
    for (size_t i = 1; i < count; i++) {
        bank->y[i] = y[i];
        rdpi_q31_bank_add(bank, play, i, y[i]);
    }
}

/* x turns round: the engaged plays stay where it has taken them. */
static inline void rdpi_q31_bank_turn(rdpi_q31_bank_t *bank, const rdpi_q31_play_t *play)
{
    const rdpi_q31_play_t *last = &play[bank->engaged];
    int32_t side = rdpi_q31_bank_side(bank->falling);
    bank->rest += (int64_t)(last->slope - play->slope) * bank->y[0];
    bank->rest_rate += (int64_t)(last->slope_rate - play->slope_rate) * bank->y[0];
    for (size_t i = bank->engaged; i > 0u; i--) {
        bank->y[i] = bank->y[0] - side * play[i].r;
    }
    bank->engaged = 0;
    bank->falling = !bank->falling;
}

/* The x at which f is `v`, within a few units, for slopes that are all > 0 at this rate. No play moves: follow with
 * rdpi_q31_bank_move to what is really output. Scaling and overflow: |v| <= 2^30; x saturates at +-2^30. */
static inline rdpi_q31_target_t rdpi_q31_bank_solve(rdpi_q31_bank_t *bank, const rdpi_q31_play_t *play, size_t count,
                                                    int32_t rate, int32_t v)
{
    rdpi_q31_target_t target = {bank->y[0], bank->engaged};
    int32_t slope = rdpi_q31_slope(&play[target.engaged], rate);
    int64_t rise = (int64_t)v * RDPI_Q31_ONE - (int64_t)slope * target.x - bank->rest; /* still to climb */
    rise -= (bank->rest_rate >> 30) * rate;
    bool falling = rise < 0;

    if (falling != bank->falling) {
        rdpi_q31_bank_turn(bank, play);
        target.engaged = 0;
        slope = rdpi_q31_slope(&play[0], rate);
    }
    int32_t side = rdpi_q31_bank_side(falling);
    rise *= side;
    while (target.engaged + 1u < count) {
        const rdpi_q31_play_t *next = &play[target.engaged + 1u];
        int32_t corner = bank->y[target.engaged + 1u] + side * next->r;
        int64_t climb = (int64_t)slope * side * (corner - target.x);
        if (climb >= rise) {
            break;
        }
        rise -= climb;
        target.x = corner;
        target.engaged++;
        slope = rdpi_q31_slope(next, rate);
    }
    target.x = rdpi_q31_clamp(target.x + (int64_t)side * rdpi_q31_divide(rise, slope), -RDPI_Q31_ONE, RDPI_Q31_ONE);
    return target;
}

/* Whether play i has engaged when x, on its way to where the bank is heading, gets to `x`. */
static inline bool rdpi_q31_bank_engages(const rdpi_q31_bank_t *bank, const rdpi_q31_play_t *play, size_t i, int32_t x)
{
    return rdpi_q31_bank_side(bank->falling) * (x - bank->y[i]) > play[i].r;
}

/* Moves every play (eq. 1) to the input target.x, |x| <= 2^29. */
static inline void rdpi_q31_bank_move(rdpi_q31_bank_t *bank, const rdpi_q31_play_t *play, size_t count,
                                      rdpi_q31_target_t target)
{
    if (target.x != bank->y[0] && (target.x < bank->y[0]) != bank->falling) {
        rdpi_q31_bank_turn(bank, play);
    }
    size_t k = target.engaged > bank->engaged ? target.engaged : bank->engaged;
    while (k + 1u < count && rdpi_q31_bank_engages(bank, play, k + 1u, target.x)) {
        k++;
    }
    while (k > bank->engaged && !rdpi_q31_bank_engages(bank, play, k, target.x)) {
        k--;
    }
    int32_t side = rdpi_q31_bank_side(bank->falling);
    for (size_t i = bank->engaged + 1u; i <= k; i++) {
        rdpi_q31_bank_add(bank, play, i, -(bank->y[i] + side * play[i].r));
    }
    bank->engaged = (uint16_t)k;
    bank->y[0] = target.x;
}

#endif
