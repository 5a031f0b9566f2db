#include "rdpi/f32_chain.h"

#include <string.h>

#include "crc.h"
#include "f32_bank.h"
#include "f32_creep.h"
#include "f32_drive.h"
#include "f32_lead.h"
#include "f32_math.h"
#include "f32_output.h"
#include "f32_unlag.h"
#include "f32_way.h"

/* The largest number of a lag in samples, of a speed in V per sample, and of codes in a V. */
#define MAX_QUOTIENT (MAX_NUMBER * (1 + ROUNDING) / RDPI_MIN_SAMPLE_TIME_S)

/* ---- the state as a value ---- */

/* All that a step, a sweep or forward changes, and that is not an array. One list for both directions. What follows from
 * other fields is left out: places of pointers, and the edge of the quick way. */
#define NUMBERS(APPLY)                                                                                                 \
    APPLY(axis.drive_V)                                                                                                \
    APPLY(axis.rate_um_per_s)                                                                                          \
    APPLY(axis.ramp_V)                                                                                                 \
    APPLY(axis.rate_estimator.filtered_um_per_s)                                                                       \
    APPLY(axis.bank.remainder_um)                                                                                      \
    APPLY(axis.bank.remainder_rate_s)                                                                                  \
    APPLY(lead.latest_um)                                                                                              \
    APPLY(lead.before_um)                                                                                              \
    APPLY(creep.h_um)                                                                                                  \
    APPLY(creep.settled_um)                                                                                            \
    APPLY(creep.slow_um)                                                                                               \
    APPLY(creep.next_um)                                                                                               \
    APPLY(creep.mean_um)                                                                                               \
    APPLY(creep.sum_um)                                                                                                \
    APPLY(unlag.asked_V)                                                                                               \
    APPLY(unlag.before_V)                                                                                              \
    APPLY(unlag.followed_V)                                                                                            \
    APPLY(unlag.ramp_V)                                                                                                \
    APPLY(unlag.carried_V)

#define COUNTS(APPLY)                                                                                                  \
    APPLY(uint32_t, axis.dac_code)                                                                                     \
    APPLY(uint32_t, axis.flags)                                                                                        \
    APPLY(uint32_t, axis.guard_count)                                                                                  \
    APPLY(uint32_t, axis.clip_count)                                                                                   \
    APPLY(uint32_t, axis.input_count)                                                                                  \
    APPLY(uint32_t, axis.missed_count)                                                                                 \
    APPLY(uint16_t, axis.sweep_turns)                                                                                  \
    APPLY(uint8_t, axis.missed)                                                                                        \
    APPLY(uint16_t, axis.rate_estimator.oldest)                                                                        \
    APPLY(uint16_t, axis.bank.engaged)                                                                                 \
    APPLY(bool, axis.bank.falling)                                                                                     \
    APPLY(uint32_t, creep.turn)                                                                                        \
    APPLY(uint32_t, creep.wait)                                                                                        \
    APPLY(uint32_t, unlag.dac_code)                                                                                    \
    APPLY(uint8_t, unlag.way)                                                                                          \
    APPLY(uint8_t, way)

/* ... and both flags of a first sample, as one count. */
#define FIRST 1u
#define UNLAG_FIRST 2u

/* CRC-32 of what tells this chain from another. */
static uint32_t identity(const rdpi_f32_chain_t *self)
{
    const rdpi_f32_rate_t *rate = &self->axis.rate_estimator;
    uint32_t crc = rdpi_crc32(rdpi_crc32(0, self->params->axis->digest), self->params->digest);
    return rdpi_crc32_block(rdpi_crc32(crc, rate->window), &rate->per_window_s, sizeof rate->per_window_s);
}

static uint32_t check_of(const rdpi_f32_chain_state_t *state)
{
    return rdpi_crc32_block(rdpi_crc32_block(0, state->count, sizeof state->count), state->number, sizeof state->number);
}

rdpi_status_t rdpi_f32_chain_get_state(const rdpi_f32_chain_t *self, rdpi_f32_chain_state_t *state)
{
    if (self == NULL || state == NULL) {
        return RDPI_ERR_NULL;
    }
    (void)memset(state, 0, sizeof *state);
    rdpi_real_t *number = state->number;
    uint32_t *count = state->count;
#define SAVE_NUMBER(field) *number = self->field; number++;
#define SAVE_COUNT(type, field) *count = self->field; count++;
    NUMBERS(SAVE_NUMBER)
    COUNTS(SAVE_COUNT)
    *count = (self->first ? FIRST : 0u) | (self->unlag.first ? UNLAG_FIRST : 0u);
#if RDPI_NOISE_SHAPING
    *number = self->axis.carried_um;
    number++;
#endif
    for (size_t k = 0; k < self->axis.rate_estimator.window; k++) {
        number[k] = self->axis.rate_estimator.z_um[k];
    }
    number += RDPI_MAX_WINDOW;
    rdpi_f32_get_memory(&self->axis, number);
    number += RDPI_MAX_PLAYS;
    for (size_t i = 0; i < self->creep.poles; i++) {
        number[2u * i] = self->creep.lag[i].state_um;
        number[2u * i + 1u] = self->creep.lag[i].rest_um;
    }
    state->digest = identity(self);
    state->check = check_of(state);
    return RDPI_OK;
}

rdpi_status_t rdpi_f32_chain_set_state(rdpi_f32_chain_t *self, const rdpi_f32_chain_state_t *state)
{
    if (self == NULL || state == NULL) {
        return RDPI_ERR_NULL;
    }
    if (state->digest != identity(self) || state->check != check_of(state)) {
        return RDPI_ERR_STATE;
    }
    rdpi_f32_chain_t next = *self;
    const rdpi_real_t *number = state->number;
    const uint32_t *count = state->count;
#define LOAD_NUMBER(field) next.field = *number; number++;
#define LOAD_COUNT(type, field) next.field = (type)*count; count++;
    NUMBERS(LOAD_NUMBER)
    COUNTS(LOAD_COUNT)
    next.first = (*count & FIRST) != 0u;
    next.unlag.first = (*count & UNLAG_FIRST) != 0u;
#if RDPI_NOISE_SHAPING
    next.axis.carried_um = *number;
    number++;
#endif
    for (size_t k = 0; k < self->axis.rate_estimator.window; k++) {
        next.axis.rate_estimator.z_um[k] = number[k];
    }
    number += RDPI_MAX_WINDOW;
    for (size_t i = 0; i < self->axis.params->plays; i++) {
        next.axis.bank.y_um[i] = number[i];
    }
    number += RDPI_MAX_PLAYS;
    for (size_t i = 0; i < self->creep.poles; i++) {
        next.creep.lag[i].state_um = number[2u * i];
        next.creep.lag[i].rest_um = number[2u * i + 1u];
    }
    next.axis.quick = false; /* the next step finds piece, line and edge */
    /* of an engaged that is none, is_sane finds that */
    next.axis.bank.last_engaged = &next.axis.params->play[next.axis.bank.engaged % next.axis.params->plays];
    if (!rdpi_f32_chain_is_sane(&next)) {
        return RDPI_ERR_STATE;
    }
    *self = next;
    return RDPI_OK;
}

/* ---- whether a state is one that a chain can have ---- */

/* NaN is not within anything. */
static bool is_within(rdpi_real_t value, rdpi_real_t limit)
{
    return fabs(value) <= limit;
}

/* The largest |x| to which a drive can lead that rdpi_f32_forward takes. */
static rdpi_real_t largest_x_um(const rdpi_f32_params_t *params)
{
    const rdpi_f32_line_t *last = &params->curve[rdpi_f32_pieces(params) - 1u];
    rdpi_real_t span_V = params->max_V - params->min_V;
    rdpi_real_t low_um = fabs(rdpi_f32_x_of_drive(params->curve, params->min_V - MAX_SPANS * span_V));
    rdpi_real_t high_um = fabs(rdpi_f32_x_of_drive(last, params->max_V + MAX_SPANS * span_V));
    return (low_um > high_um ? low_um : high_um) * (1 + ROUNDING);
}

/* The largest slope of the bank, at rest and at the guard, or change of one per unit rate. */
static rdpi_real_t largest_slope(const rdpi_f32_params_t *params)
{
    rdpi_real_t largest = 0;
    for (size_t i = 0; i < params->plays; i++) {
        rdpi_real_t slope = fabs(params->play[i].slope) + fabs(params->play[i].slope_rate_s_per_um);
        largest = slope > largest ? slope : largest;
    }
    return largest;
}

/* The largest displacement of the operator, relative to that of any other drive too. Of the sum by parts in the bank there
 * are as many terms as plays, none above slope times state, and an intercept. */
static rdpi_real_t largest_v_um(const rdpi_f32_params_t *params)
{
    rdpi_real_t most_um = largest_x_um(params) + params->play[params->plays - 1u].r_um;
    return 4 * (rdpi_real_t)params->plays * largest_slope(params) * most_um;
}

static rdpi_real_t largest_um(const rdpi_f32_params_t *params)
{
    rdpi_real_t weights = 0;
    for (size_t j = 0; j < params->deadzones; j++) {
        weights += fabs(params->saturation[j].weight);
    }
    return 2 * (weights * largest_v_um(params) + fabs(params->offset_um) + RDPI_MAX_REFERENCE_UM);
}

static bool is_bank_sane(const rdpi_f32_bank_t *bank, const rdpi_f32_params_t *params)
{
    rdpi_real_t most_um = largest_x_um(params), r_um = params->play[params->plays - 1u].r_um;
    rdpi_real_t most_v_um = largest_v_um(params);
    uint16_t engaged = bank->engaged;
    bool sane = engaged < params->plays && bank->last_engaged == &params->play[engaged] &&
                is_within(bank->y_um[0], most_um) && is_within(bank->remainder_um, most_v_um) &&
                is_within(bank->remainder_rate_s, most_v_um);
    for (size_t i = engaged + 1u; i < params->plays; i++) {
        sane = sane && is_within(bank->y_um[i], most_um + r_um);
    }
    return sane;
}

/* What the quick way goes by is kept only for it. */
static bool is_quick_way_sane(const rdpi_f32_t *axis, const rdpi_f32_params_t *params)
{
    rdpi_real_t most_um = largest_x_um(params);
    bool found = false, sane = is_within(axis->bank.edge_um, most_um);
    const rdpi_f32_piece_t *piece = axis->latest_piece;
    for (size_t j = 0; j < params->deadzones; j++) {
        found = found || piece == &params->inverse_saturation[j];
    }
#if RDPI_MAX_CURVE_PIECES > 1
    const rdpi_f32_line_t *line = axis->line;
    bool on_line = false;
    for (size_t i = 0; i < params->curve_pieces; i++) {
        on_line = on_line || line == &params->curve[i];
    }
    sane = sane && on_line && (axis->bank.engaged > 0u || is_within(axis->bank.middle_um, most_um));
#endif
    return sane && found;
}

static bool is_rate_sane(const rdpi_f32_rate_t *rate)
{
    uint16_t window = rate->window, oldest = rate->oldest;
    bool sane = window >= 1u && window <= RDPI_MAX_WINDOW && oldest <= window && rate->per_window_s > 0 &&
                rate->per_window_s <= (1 + ROUNDING) / RDPI_MIN_SAMPLE_TIME_S && rate->keep >= 0 && rate->keep <= 1 &&
                rate->filtered_um_per_s >= 0 &&
                rate->filtered_um_per_s <= 4 * RDPI_MAX_REFERENCE_UM / RDPI_MIN_SAMPLE_TIME_S;
    if (sane && oldest < window) {
        for (size_t k = 0; k < window; k++) {
            sane = sane && is_within(rate->z_um[k], 2 * RDPI_MAX_REFERENCE_UM);
        }
    }
    return sane;
}

static uint32_t last_code(const rdpi_f32_params_t *params)
{
    return params->dac_bits > 0u ? ((uint32_t)1 << params->dac_bits) - 1u : 0u;
}

/* In the range, to rounding. */
static bool is_a_drive(const rdpi_f32_params_t *params, rdpi_real_t drive_V)
{
    rdpi_real_t slack_V = ROUNDING * (fabs(params->min_V) + fabs(params->max_V));
    return drive_V >= params->min_V - slack_V && drive_V <= params->max_V + slack_V;
}

static bool is_axis_sane(const rdpi_f32_t *axis, const rdpi_f32_params_t *params)
{
    bool sane = is_a_drive(params, axis->drive_V) && is_a_drive(params, axis->ramp_V) &&
                axis->rate_um_per_s >= 0 && axis->rate_um_per_s <= params->max_um_per_s &&
                axis->dac_code <= last_code(params) && axis->sweep_turns <= 2u * params->sweep_cycles + 1u &&
                (!axis->quick || is_quick_way_sane(axis, params));
#if RDPI_NOISE_SHAPING
    sane = sane && is_within(axis->carried_um, largest_v_um(params));
#endif
    return sane;
}

static bool is_creep_sane(const rdpi_f32_creep_t *creep, const rdpi_f32_chain_params_t *params)
{
    const rdpi_real_t most_um = largest_um(params->axis);
    uint32_t poles = creep->poles, fast = creep->fast, turn = creep->turn;
    if (poles != params->poles || fast > poles) {
        return false;
    }
    rdpi_real_t weights = 1;
    for (size_t i = 0; i < poles; i++) {
        weights += fabs(params->pole[i].share);
    }
    const rdpi_real_t most_added_um = 4 * weights * most_um;
    bool sane = creep->per_turn <= MAX_PER_TURN && creep->wait <= creep->per_turn && creep->round >= 0 &&
                creep->round <= MAX_PER_TURN * RDPI_MAX_POLES && creep->per_direct > 0 &&
                creep->per_direct <= 2 / MIN_DIRECT && (fast == poles || (turn >= fast && turn < poles)) &&
                is_within(creep->settled_um, most_um) && is_within(creep->mean_um, most_um) &&
                is_within(creep->slow_um, most_added_um) && is_within(creep->next_um, most_added_um) &&
                is_within(creep->sum_um, MAX_PER_TURN * RDPI_MAX_POLES * most_um) &&
                is_within(creep->h_um, 2 / MIN_DIRECT * (2 * MAX_NUMBER + most_added_um)); /* if it is refused, too */
    for (size_t i = 0; i < poles; i++) {
        const rdpi_f32_lag_t *lag = &creep->lag[i];
        sane = sane && is_within(lag->state_um, most_um) && is_within(lag->rest_um, most_um) && lag->blend >= 0 &&
               lag->blend <= 1 && is_within(lag->weight, weights) && is_within(lag->weight_ahead, 2 * weights) &&
               creep->per_sample[i] > 0;
    }
    return sane;
}

static bool is_lead_sane(const rdpi_f32_lead_t *lead, bool first)
{
    return isfinite(lead->per_before) && isfinite(lead->per_step) && lead->max_um > 0 && lead->max_um <= MAX_NUMBER &&
           (first || (is_within(lead->latest_um, RDPI_MAX_REFERENCE_UM) &&
                      is_within(lead->before_um, 2 * RDPI_MAX_REFERENCE_UM)));
}

static bool is_unlag_sane(const rdpi_f32_unlag_t *unlag, const rdpi_f32_params_t *params)
{
    const rdpi_real_t most_V = 4 * (fabs(params->min_V) + fabs(params->max_V));
    return is_within(unlag->followed_V, most_V) && is_a_drive(params, unlag->ramp_V) && is_within(unlag->carried_V, most_V) &&
           unlag->per_step >= 0 && unlag->per_step <= MAX_QUOTIENT && unlag->codes_per_V >= 0 &&
           unlag->codes_per_V <= MAX_QUOTIENT && unlag->max_step_V >= 0 && unlag->max_step_V <= MAX_QUOTIENT &&
           unlag->dac_code <= last_code(params) &&
           (unlag->first || (is_within(unlag->asked_V, most_V) && is_within(unlag->before_V, most_V)));
}

/* A way through a lead or creep that the chain does not have would read what nothing has set up. */
static bool are_ways_sane(const rdpi_f32_chain_t *self)
{
    const rdpi_f32_chain_params_t *params = self->params;
    const bool leads = rdpi_f32_lead_wanted(params);
    const unsigned usual = (uint8_t)((leads ? LEAD : PLAIN) + (params->poles > 0u ? CREEP : PLAIN));
    const unsigned outer = self->way, way = has_lag(self) ? self->unlag.way : outer;
    return self->usual == usual && (way == usual || (leads && way == GENERAL)) && (outer == LAG) == has_lag(self);
}

/* Whether what the chain points to are parameters, and those of its operator: in a ramp of an axis, a copy with the same
 * digest. It sees a pointer that was damaged, if there is something else to read there. */
static bool has_parameters(const rdpi_f32_chain_t *self)
{
    const rdpi_f32_chain_params_t *params = self->params;
    const rdpi_f32_params_t *axis = self->axis.params;
    return params != NULL && axis != NULL && params->schema == RDPI_PARAMS_SCHEMA && axis->schema == RDPI_PARAMS_SCHEMA &&
           params->axis != NULL && axis->digest == params->axis->digest;
}

bool rdpi_f32_chain_is_sane(const rdpi_f32_chain_t *self)
{
    if (self == NULL || !has_parameters(self)) {
        return false;
    }
    const rdpi_f32_chain_params_t *params = self->params;
    return is_axis_sane(&self->axis, params->axis) && is_rate_sane(&self->axis.rate_estimator) &&
           is_bank_sane(&self->axis.bank, params->axis) && is_creep_sane(&self->creep, params) &&
           is_unlag_sane(&self->unlag, params->axis) &&
           (!rdpi_f32_lead_wanted(params) || is_lead_sane(&self->lead, self->first)) && are_ways_sane(self) &&
           self->preview_samples <= MAX_DELAY + 2u;
}

/* ---- exchange of parameters ---- */

/* The turning points that a play remembers bound its input: x is between y - r and y + r. These intervals lie within each
 * other, whatever unit they are in. So they pass through the input curves of both models, and become states again. */
typedef struct {
    rdpi_real_t r_um; /* half of the interval */
    rdpi_real_t y_um; /* its middle */
} rdpi_f32_play_state_t;

/* The x of `to` at the drive at which `from` has `x_um`. */
static rdpi_real_t x_elsewhere(const rdpi_f32_params_t *to, const rdpi_f32_params_t *from, rdpi_real_t x_um)
{
    rdpi_real_t drive_V = rdpi_f32_drive_of_x(rdpi_f32_line_of_x(from, x_um), x_um);
    return rdpi_f32_x_of_drive(rdpi_f32_line_of_drive(to, drive_V), drive_V);
}

/* Play i of `from`, in the x of `to`. */
static rdpi_f32_play_state_t play_elsewhere(const rdpi_f32_params_t *to, const rdpi_f32_t *from, size_t i)
{
    const rdpi_f32_params_t *params = from->params;
    rdpi_real_t y_um = rdpi_f32_bank_state(&from->bank, params->play, i), r_um = params->play[i].r_um;
    rdpi_real_t one_um = x_elsewhere(to, params, y_um - r_um), other_um = x_elsewhere(to, params, y_um + r_um);
    rdpi_f32_play_state_t play = {fabs(other_um - one_um) / 2, (one_um + other_um) / 2};
    return play;
}

/* The x of `to`, or the end of its range that it is beyond. */
static rdpi_real_t x_in_range(const rdpi_f32_params_t *to, rdpi_real_t x_um)
{
    const rdpi_f32_line_t *last = &to->curve[rdpi_f32_pieces(to) - 1u];
    rdpi_real_t one_um = rdpi_f32_x_of_drive(to->curve, to->min_V), other_um = rdpi_f32_x_of_drive(last, to->max_V);
    return one_um < other_um ? rdpi_f32_clamp(x_um, one_um, other_um) : rdpi_f32_clamp(x_um, other_um, one_um);
}

/* The states of the plays of `to`, at the places of its thresholds between those of `from`; beyond the last, its own.
 * Another source may have left x outside the range, and what is output is the end of it: x comes back to there, and each
 * play with the one before it. So no two of them are further apart than their thresholds. */
static void project_plays(const rdpi_f32_params_t *to, const rdpi_f32_t *from, rdpi_real_t *y_um)
{
    size_t i = 0;
    rdpi_f32_play_state_t below = play_elsewhere(to, from, 0), above = below;
    for (size_t k = 0; k < to->plays; k++) {
        rdpi_real_t r_um = to->play[k].r_um;
        while (above.r_um < r_um && i + 1u < from->params->plays) {
            i++;
            below = above;
            above = play_elsewhere(to, from, i);
        }
        rdpi_real_t apart_um = above.r_um - below.r_um;
        rdpi_real_t share = apart_um > 0 ? rdpi_f32_clamp((r_um - below.r_um) / apart_um, 0, 1) : 1;
        y_um[k] = rdpi_f32_fma(share, above.y_um - below.y_um, below.y_um);
        if (k > 0u) {
            rdpi_real_t gap_um = r_um - to->play[k - 1u].r_um;
            y_um[k] = rdpi_f32_clamp(y_um[k], y_um[k - 1u] - gap_um, y_um[k - 1u] + gap_um);
        } else {
            y_um[k] = x_in_range(to, y_um[k]);
        }
    }
}

/* More of its time constants in a sample than a pole can tell; the quotient may be infinite. */
#define FASTEST ((rdpi_real_t)1e9)

/* log2 of a number > 0, straight between powers of 2: poles are compared by it. */
static rdpi_real_t about_log2(rdpi_real_t number)
{
    rdpi_real_t whole = 0;
    number = number < FASTEST ? number : FASTEST;
    while (number >= 2) {
        number /= 2;
        whole += 1;
    }
    while (number < 1) {
        number *= 2;
        whole -= 1;
    }
    return whole + number - 1;
}

/* How far a pole that moves by `per_sample` of its distance would be behind h: between the two poles of `from` next to
 * it, or as the last of them. */
static rdpi_real_t behind_of_um(const rdpi_f32_creep_t *from, rdpi_real_t h_um, rdpi_real_t per_sample)
{
    const rdpi_real_t place = about_log2(per_sample);
    rdpi_real_t under = -INFINITY, over = INFINITY, under_um = 0, over_um = 0;
    for (size_t i = 0; i < from->poles; i++) {
        rdpi_real_t at = about_log2(from->per_sample[i]), lag_um = from->lag[i].state_um - h_um;
        if (at <= place && at > under) {
            under = at;
            under_um = lag_um;
        }
        if (at >= place && at < over) {
            over = at;
            over_um = lag_um;
        }
    }
    if (!isfinite(under) || !isfinite(over)) {
        return isfinite(under) ? under_um : over_um;
    }
    return over > under ? under_um + (place - under) / (over - under) * (over_um - under_um) : under_um;
}

/* Creep of `self`, which has settled at its present h, takes over how far each pole of `from` is behind. `h_um` is what
 * `from` really output, less its h_0. */
static void project_creep(rdpi_f32_creep_t *self, const rdpi_f32_creep_t *from, rdpi_real_t h_um)
{
    if (self->poles == 0u || from->poles == 0u) {
        return;
    }
    self->settled_um -= h_um;
    self->h_um = h_um;
    for (size_t i = 0; i < self->poles; i++) {
        self->lag[i].state_um = h_um + behind_of_um(from, h_um, self->per_sample[i]);
    }
    self->mean_um = from->mean_um;
    rdpi_f32_creep_wait(self, 0, h_um); /* what the slow ones add follows from their states */
}

/* The displacement of the operator, less h_0, at the latest sample: what was asked for, or where that was not output,
 * what was. */
static rdpi_real_t displacement_um(const rdpi_f32_chain_t *self)
{
    return was_clipped(&self->axis) ? output_um(self) : self->creep.h_um;
}

/* Whether both are made for the same time between samples, to rounding. */
static bool same_sample_time(const rdpi_f32_rate_t *one, const rdpi_f32_rate_t *other)
{
    rdpi_real_t per_s = one->per_window_s * (rdpi_real_t)one->window;
    rdpi_real_t other_per_s = other->per_window_s * (rdpi_real_t)other->window;
    return fabs(per_s - other_per_s) <= ROUNDING * per_s;
}

static bool same_codes(const rdpi_f32_params_t *one, const rdpi_f32_params_t *other)
{
    return one->dac_bits == other->dac_bits && one->min_V == other->min_V && one->max_V == other->max_V;
}

/* What `from` outputs is the output; the plays have their own drive where there is a lag. */
static void take_output(rdpi_f32_chain_t *self, const rdpi_f32_chain_t *from)
{
    rdpi_f32_t *axis = &self->axis;
    const rdpi_f32_params_t *params = axis->params;
    rdpi_real_t drive_V = from->axis.drive_V;
    self->unlag.ramp_V = drive_V;
    if (!has_lag(self)) {
        axis->ramp_V = drive_V;
    }
    axis->drive_V = drive_V;
    if (same_codes(params, from->axis.params)) {
        axis->dac_code = from->axis.dac_code;
    } else {
        const rdpi_f32_line_t *line = rdpi_f32_line_of_drive(params, drive_V);
        axis->dac_code = rdpi_f32_code_of_x(params, line, rdpi_f32_x_of_drive(line, drive_V));
    }
}

rdpi_status_t rdpi_f32_chain_inherit(rdpi_f32_chain_t *self, const rdpi_f32_chain_t *from)
{
    if (self == NULL || from == NULL) {
        return RDPI_ERR_NULL;
    }
    rdpi_f32_t *axis = &self->axis;
    const rdpi_f32_params_t *params = axis->params;
    rdpi_real_t y_um[RDPI_MAX_PLAYS];
    if (!same_sample_time(&axis->rate_estimator, &from->axis.rate_estimator)) {
        return RDPI_ERR_SAMPLE_TIME;
    }
    if (!(from->axis.drive_V >= params->min_V && from->axis.drive_V <= params->max_V)) {
        return RDPI_ERR_MEMORY;
    }
    project_plays(params, &from->axis, y_um);
    rdpi_status_t status = rdpi_f32_set_memory(axis, y_um);
    if (status == RDPI_OK) {
        rdpi_f32_chain_settle(self);
        project_creep(&self->creep, &from->creep, displacement_um(from));
        take_output(self, from);
        axis->guard_count = from->axis.guard_count;
        axis->clip_count = from->axis.clip_count;
        axis->input_count = from->axis.input_count;
        axis->missed_count = from->axis.missed_count;
    }
    return status;
}
