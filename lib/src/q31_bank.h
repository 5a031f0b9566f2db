/* The bank of rate-dependent plays and its exact inverse in fixed point: Ang et al., IROS 2003, eq. 9 and 17. The
 * method is that of f32_bank.h, with one difference: in place of the remainder, the bank keeps f itself, in two parts,
 *
 *   2^30 f(x) = f_at_rest + rho / 2^30 f_rate
 *
 * at the x where the plays stand. Both parts are exact integers, so they never have to be summed afresh: f does not
 * jump where a play engages or x turns round, and in between it changes by the slope of the last engaged play. `room`
 * is how far x can go on before anything else happens: up to where the next play engages, or to the end of the range.
 *
 * Scaling and overflow: |x|, |y|, r <= 2^29, and neighbouring states differ by no more than their thresholds do, so the
 * distances to corners stay within 2^30. Slopes are <= 2^30, so |f_at_rest| and |f_rate| are <= 2^60, and twice that
 * while they are summed. */
#ifndef RDPI_Q31_BANK_H
#define RDPI_Q31_BANK_H

#include "q31_play.h"

static inline int32_t rdpi_q31_bank_side(bool falling)
{
    return falling ? -1 : 1;
}

/* The state of play i. */
static inline int32_t rdpi_q31_bank_state(const rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params, size_t i)
{
    return i <= bank->engaged ? bank->y[0] - rdpi_q31_bank_side(bank->falling) * params->play[i].r : bank->y[i];
}

/* Eq. 9 and 17: v = f at any x, summed by parts. */
static inline int32_t rdpi_q31_bank_at(const rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params, int32_t rate,
                                       int32_t x)
{
    const rdpi_q31_play_t *play = params->play;
    size_t last = params->plays - 1u;
    int64_t sum = 0;
    int32_t y = x;
    for (size_t i = 0; i < last; i++) {
        int32_t next = rdpi_q31_play(x, play[i + 1u].r, rdpi_q31_bank_state(bank, params, i + 1u));
        sum += rdpi_q31_mul(rdpi_q31_slope(&play[i], rate), y - next);
        y = next;
    }
    sum += rdpi_q31_mul(rdpi_q31_slope(&play[last], rate), y);
    return (int32_t)(sum >> 30);
}

/* The corner at which play i, which is not engaged, will engage. */
static inline int32_t rdpi_q31_bank_corner(const rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params, size_t i)
{
    return bank->y[i] + rdpi_q31_bank_side(bank->falling) * params->play[i].r;
}

/* Moves x and the engaged plays by `way`, on which no play engages or lets go. */
static inline void rdpi_q31_bank_slide(rdpi_q31_bank_t *bank, int32_t way)
{
    bank->f_at_rest += rdpi_q31_mul(bank->last_engaged->slope, way);
    bank->f_rate += rdpi_q31_mul(bank->last_engaged->slope_rate, way);
    bank->y[0] += way;
}

/* Moves x on to `x`, in the direction in which it goes, over corners if there are any. */
static inline void rdpi_q31_bank_advance(rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params, int32_t x)
{
    const int32_t side = rdpi_q31_bank_side(bank->falling);
    int32_t room = side * ((bank->falling ? params->min_x : params->max_x) - x);
    while (bank->engaged + 1u < params->plays) {
        int32_t corner = bank->y[bank->engaged + 1u] + side * bank->last_engaged[1].r, ahead = side * (corner - x);
        if (ahead >= 0) {
            room = ahead < room ? ahead : room;
            break;
        }
        rdpi_q31_bank_slide(bank, corner - bank->y[0]);
        bank->engaged++;
        bank->last_engaged++;
    }
    rdpi_q31_bank_slide(bank, x - bank->y[0]);
    bank->room = room > 0 ? room : 0;
}

/* Takes the states `y`, which one history can lead to. */
static inline void rdpi_q31_bank_set(rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params, const int32_t *y)
{
    const rdpi_q31_play_t *play = params->play;
    bank->f_at_rest = rdpi_q31_mul(play[0].slope, y[0]);
    bank->f_rate = rdpi_q31_mul(play[0].slope_rate, y[0]);
    bank->y[0] = y[0];
    for (size_t i = 1; i < params->plays; i++) {
        bank->y[i] = y[i];
        bank->f_at_rest += rdpi_q31_mul(play[i].slope - play[i - 1u].slope, y[i]);
        bank->f_rate += rdpi_q31_mul(play[i].slope_rate - play[i - 1u].slope_rate, y[i]);
    }
    bank->falling = false;
    bank->engaged = 0;
    bank->last_engaged = params->play;
    rdpi_q31_bank_advance(bank, params, y[0]);
}

/* x turns round. The engaged plays stay where x has taken them: their states are stored. Does not update room. */
static inline void rdpi_q31_bank_turn(rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params)
{
    const int32_t side = rdpi_q31_bank_side(bank->falling), x = bank->y[0];
    const rdpi_q31_play_t *play = bank->last_engaged;
    for (int32_t *y = &bank->y[bank->engaged]; y != bank->y; y--) {
        *y = x - side * play->r;
        play--;
    }
    bank->falling = !bank->falling;
    bank->engaged = 0;
    bank->last_engaged = params->play;
}

/* How far 2^30 f has to climb to `v`. Scaling and overflow: |v| <= 2^62. */
static inline int64_t rdpi_q31_bank_climb(const rdpi_q31_bank_t *bank, int32_t rate, int64_t v)
{
    return v - bank->f_at_rest - rdpi_q31_mul_rate((int32_t)(bank->f_rate >> 30), rate);
}

/* x on its way over corners to where f has no excess over the wanted value. */
typedef struct {
    int64_t f_at_rest;           /* the change of the bank's on the way, plus the excess where it began */
    int64_t f_rate;              /* the change of the bank's on the way */
    int64_t excess;              /* at x */
    const rdpi_q31_play_t *play; /* the last one that is engaged at x */
    int32_t x;
    int32_t way; /* from the corner before to x */
} rdpi_q31_walk_t;

/* Goes on to `corner`, where the next play engages. Returns whether the solution is still ahead. */
static RDPI_Q31_HOT bool rdpi_q31_walk_corner(rdpi_q31_walk_t *walk, int32_t rate, int32_t corner, const bool falling)
{
    walk->way = corner - walk->x;
    walk->f_at_rest += rdpi_q31_mul(walk->play->slope, walk->way);
    walk->f_rate += rdpi_q31_mul(walk->play->slope_rate, walk->way);
    walk->x = corner;
    walk->play++;
    walk->excess = walk->f_at_rest + rdpi_q31_mul_rate((int32_t)(walk->f_rate >> 30), rate);
    return (walk->excess >= 0) == falling;
}

/* rdpi_q31_bank_walk in one direction. It is compiled once for each, because much of the loop depends on it. It goes to
 * the first corner behind the solution, finds the solution from there, and then takes x back to the corner before. */
static RDPI_Q31_HOT int32_t rdpi_q31_bank_walk_one_way(rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params,
                                                       int64_t excess, int32_t rate, const bool falling)
{
    const int32_t side = rdpi_q31_bank_side(falling);
    const int32_t end = falling ? params->min_x : params->max_x;
    if (falling != bank->falling) {
        rdpi_q31_bank_turn(bank, params);
    }
    rdpi_q31_walk_t walk = {excess, 0, excess, bank->last_engaged, bank->y[0], 0};
    const rdpi_q31_play_t *last = &params->play[params->plays - 1u];
    const int32_t *y = &bank->y[params->plays - 1u];
    while (last != walk.play && side * (*y + side * last->r - end) > 0) { /* it engages beyond the range */
        last--;
        y--;
    }
    y = &bank->y[bank->engaged];
    bool ahead = true;
    while (ahead && walk.play != last) {
        ahead = rdpi_q31_walk_corner(&walk, rate, y[1] + side * walk.play[1].r, falling);
        y++;
    }
    int32_t x = walk.x;
    int64_t rise = falling ? walk.excess : -walk.excess;
    if (ahead) {
        int32_t slope = rdpi_q31_slope(walk.play, rate);
        bank->room = side * (end - x);
        if (rdpi_q31_mul(slope, bank->room) < rise) {
            x = end + side;
        } else {
            x += side * rdpi_q31_divide(rise, slope);
        }
    } else {
        walk.play--;
        walk.x -= walk.way;
        walk.f_at_rest -= rdpi_q31_mul(walk.play->slope, walk.way);
        walk.f_rate -= rdpi_q31_mul(walk.play->slope_rate, walk.way);
        bank->room = side * walk.way;
        int32_t back = rdpi_q31_divide(-rise, rdpi_q31_slope(walk.play, rate));
        x -= back < bank->room ? side * back : walk.way; /* slopes are rounded, f is not */
    }
    bank->y[0] = walk.x;
    bank->engaged = (uint16_t)(walk.play - params->play);
    bank->last_engaged = walk.play;
    bank->f_at_rest += walk.f_at_rest - excess;
    bank->f_rate += walk.f_rate;
    return x;
}

/* The x where 2^30 f has climbed by `climb`, or an x beyond the range. The x of the bank turns round if it has to, and
 * moves to the last corner before that. */
static RDPI_Q31_SELDOM int32_t rdpi_q31_bank_walk(rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params,
                                                  int64_t climb, int32_t rate)
{
    return climb < 0 ? rdpi_q31_bank_walk_one_way(bank, params, -climb, rate, true)
                     : rdpi_q31_bank_walk_one_way(bank, params, -climb, rate, false);
}

/* The x at which 2^30 f is `v`, within a few units. All slopes must be > 0 at this rate. If that x is beyond the range,
 * returns the end of the range and sets `beyond`. The x of the bank moves to the last corner before that: call
 * rdpi_q31_bank_move with what is really output. */
static inline int32_t rdpi_q31_bank_solve(rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params, int32_t rate,
                                          int64_t v, bool *beyond)
{
    int64_t climb = rdpi_q31_bank_climb(bank, rate, v);
    bool falling = climb < 0;
    int64_t rise = falling ? -climb : climb; /* seen in the direction of the climb */
    int32_t slope = rdpi_q31_slope(bank->last_engaged, rate);
    if (falling != bank->falling || rdpi_q31_mul(slope, bank->room) < rise) {
        int32_t x = rdpi_q31_bank_walk(bank, params, climb, rate);
        int32_t end = bank->y[0] + (falling ? -bank->room : bank->room);
        *beyond = falling ? x < end : x > end;
        return *beyond ? end : x;
    }
    int32_t way = rdpi_q31_divide(rise, slope);
    return bank->y[0] + (falling ? -way : way);
}

/* Moves x on to `x`, if there is room for that. Returns whether there was. */
static inline bool rdpi_q31_bank_try_slide(rdpi_q31_bank_t *bank, int32_t x)
{
    int32_t way = x - bank->y[0];
    int32_t ahead = bank->falling ? -way : way;
    if ((uint32_t)ahead > (uint32_t)bank->room) {
        return false;
    }
    rdpi_q31_bank_slide(bank, way);
    bank->room -= ahead;
    return true;
}

/* Moves x from the corner where the last play has just engaged back to `x`, over other corners if there are any. `x` is
 * not before the corners of the plays that were engaged before a solution was looked for. */
static inline void rdpi_q31_bank_retreat(rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params, int32_t x)
{
    int32_t side = rdpi_q31_bank_side(bank->falling);
    while (bank->y[0] != x) {
        int32_t way = x - bank->y[0];
        bank->engaged--;
        bank->last_engaged--;
        if (bank->engaged > 0u) {
            int32_t corner = rdpi_q31_bank_corner(bank, params, bank->engaged) - bank->y[0];
            way = side * corner > side * way ? corner : way;
        }
        bank->room = -side * way;
        rdpi_q31_bank_slide(bank, way);
    }
}

/* Moves the input to `x`, |x| <= 2^29, and every play with it. `from` was the input before a solution was looked
 * for. */
static RDPI_Q31_SELDOM void rdpi_q31_bank_move(rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params, int32_t from,
                                               int32_t x)
{
    int32_t side = rdpi_q31_bank_side(bank->falling);
    if (side * (x - from) < 0) {
        rdpi_q31_bank_retreat(bank, params, from);
        rdpi_q31_bank_turn(bank, params);
    } else if (side * (x - bank->y[0]) < 0) {
        rdpi_q31_bank_retreat(bank, params, x);
        return;
    } else {
        /* x is ahead */
    }
    rdpi_q31_bank_advance(bank, params, x);
}

#endif
