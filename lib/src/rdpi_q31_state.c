#include "rdpi/q31_chain.h"

#include <string.h>

#include "crc.h"
#include "q31_bank.h"
#include "q31_creep.h"
#include "q31_drive.h"
#include "q31_math.h"
#include "q31_unlag.h"

/* ---- the state as a value: see rdpi_f32_state.c. The next step takes the rate for one that is not direct, and finds x:
 * neither is part of it ---- */

#define WIDE(APPLY)                                                                                                    \
    APPLY(axis.ramp)                                                                                                   \
    APPLY(axis.rate_estimator.filtered)                                                                                \
    APPLY(axis.bank.f_at_rest)                                                                                         \
    APPLY(axis.bank.f_rate)                                                                                            \
    APPLY(creep.settled)                                                                                               \
    APPLY(creep.slow)                                                                                                  \
    APPLY(creep.next)                                                                                                  \
    APPLY(creep.sum)                                                                                                   \
    APPLY(unlag.ramp)

#define NUMBERS(APPLY)                                                                                                 \
    APPLY(axis.drive)                                                                                                  \
    APPLY(axis.rate)                                                                                                   \
    APPLY(axis.bank.room)                                                                                              \
    APPLY(lead.latest)                                                                                                 \
    APPLY(lead.before)                                                                                                 \
    APPLY(creep.mean)                                                                                                  \
    APPLY(creep.h)                                                                                                     \
    APPLY(unlag.asked)                                                                                                 \
    APPLY(unlag.before)                                                                                                \
    APPLY(unlag.followed)                                                                                              \
    APPLY(unlag.carried)

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
    APPLY(uint16_t, creep.turn)                                                                                        \
    APPLY(uint32_t, unlag.dac_code)                                                                                    \
    APPLY(bool, unlag.first)                                                                                           \
    APPLY(bool, first)

/* CRC-32 of what tells this chain from another. */
static uint32_t identity(const rdpi_q31_chain_t *self)
{
    uint32_t crc = rdpi_crc32(rdpi_crc32(0, self->params->axis->digest), self->params->digest);
    return rdpi_crc32(crc, self->sample_time_ns);
}

static uint32_t check_of(const rdpi_q31_chain_state_t *state)
{
    uint32_t crc = rdpi_crc32_block(0, state->wide, sizeof state->wide);
    crc = rdpi_crc32_block(crc, state->number, sizeof state->number);
    return rdpi_crc32_block(crc, state->count, sizeof state->count);
}

rdpi_status_t rdpi_q31_chain_get_state(const rdpi_q31_chain_t *self, rdpi_q31_chain_state_t *state)
{
    if (self == NULL || state == NULL) {
        return RDPI_ERR_NULL;
    }
    const rdpi_q31_rate_t *rate = &self->axis.rate_estimator;
    (void)memset(state, 0, sizeof *state);
    int64_t *wide = state->wide;
    int32_t *number = state->number;
    uint32_t *count = state->count;
#define SAVE_WIDE(field) *wide = self->field; wide++;
#define SAVE_NUMBER(field) *number = self->field; number++;
#define SAVE_COUNT(type, field) *count = self->field; count++;
    WIDE(SAVE_WIDE)
    NUMBERS(SAVE_NUMBER)
    COUNTS(SAVE_COUNT)
    (void)count; /* behind the last one */
#if RDPI_NOISE_SHAPING
    *wide = self->axis.carried;
    wide++;
#endif
    for (size_t i = 0; i < self->creep.poles; i++) {
        wide[i] = self->creep.lag[i].state;
    }
    for (size_t k = 0; rate->oldest < rate->window && k < rate->window; k++) {
        number[k] = rate->z[k];
    }
    rdpi_q31_get_memory(&self->axis, &number[RDPI_MAX_WINDOW]);
    state->digest = identity(self);
    state->check = check_of(state);
    return RDPI_OK;
}

/* Whether one history can lead to the plays, so that no way between two corners overflows, and f and room are theirs. */
static bool is_one_history(const rdpi_q31_t *axis)
{
    const rdpi_q31_params_t *params = axis->params;
    const rdpi_q31_bank_t *bank = &axis->bank;
    int32_t y[RDPI_MAX_PLAYS];
    rdpi_q31_get_memory(axis, y);
    for (size_t i = 1; i < params->plays; i++) {
        int32_t gap = params->play[i].r - params->play[i - 1u].r, lag = y[i] - y[i - 1u];
        if (lag > gap || lag < -gap || !rdpi_q31_in_format(y[i])) {
            return false;
        }
        if (bank->y[i] != y[i]) { /* of an engaged play: rdpi_q31_bank_retreat reads its place, too */
            return false;
        }
    }
    rdpi_q31_bank_t anew = *bank, here = *bank;
    rdpi_q31_bank_set(&anew, params, y);
    rdpi_q31_bank_advance(&here, params, bank->y[0]); /* finds how much room there is */
    return anew.f_at_rest == bank->f_at_rest && anew.f_rate == bank->f_rate && bank->room <= here.room;
}

/* Whether fields fit each other that a step relies on. rdpi_q31_chain_is_sane does not look: a step that interrupts it
 * changes several of them. */
static bool fits_together(const rdpi_q31_chain_t *self)
{
    const rdpi_q31_creep_t *creep = &self->creep;
    const int64_t most = (int64_t)MAX_H * (creep->turn - creep->fast); /* the mean of a round is within MAX_H, too */
    return is_one_history(&self->axis) && creep->sum >= -most && creep->sum <= most;
}

rdpi_status_t rdpi_q31_chain_set_state(rdpi_q31_chain_t *self, const rdpi_q31_chain_state_t *state)
{
    if (self == NULL || state == NULL) {
        return RDPI_ERR_NULL;
    }
    if (state->digest != identity(self) || state->check != check_of(state)) {
        return RDPI_ERR_STATE;
    }
    rdpi_q31_chain_t next = *self;
    rdpi_q31_bank_t *bank = &next.axis.bank;
    const int64_t *wide = state->wide;
    const int32_t *number = state->number;
    const uint32_t *count = state->count;
#define LOAD_WIDE(field) next.field = *wide; wide++;
#define LOAD_NUMBER(field) next.field = *number; number++;
#define LOAD_COUNT(type, field) next.field = (type)*count; count++;
    WIDE(LOAD_WIDE)
    NUMBERS(LOAD_NUMBER)
    COUNTS(LOAD_COUNT)
    (void)count;
#if RDPI_NOISE_SHAPING
    next.axis.carried = *wide;
    wide++;
#endif
    for (size_t i = 0; i < self->creep.poles; i++) {
        next.creep.lag[i].state = wide[i];
    }
    for (size_t k = 0; k < self->axis.rate_estimator.window; k++) {
        next.axis.rate_estimator.z[k] = number[k];
    }
    for (size_t i = 0; i < self->axis.params->plays; i++) {
        bank->y[i] = number[RDPI_MAX_WINDOW + i];
    }
    next.axis.rate_estimator.direct = false;
    next.axis.latest_piece.length = 0; /* the next step finds it */
    /* of an engaged that is none, is_sane finds that */
    bank->last_engaged = &next.axis.params->play[bank->engaged % next.axis.params->plays];
    if (!rdpi_q31_chain_is_sane(&next) || !fits_together(&next)) {
        return RDPI_ERR_STATE;
    }
    *self = next;
    return RDPI_OK;
}

/* ---- whether a state is one that a chain can have: see rdpi_f32_state.c ---- */

/* The least mantissa of a guard and of a unit. */
#define HALF ((uint32_t)1 << 31)

/* What h_0 adds to the displacement, and what slow poles add, which is taken 2^-5 further at most: see q31_creep.h. */
#define MAX_SETTLED (RDPI_Q31_ONE / 4)
#define MAX_SLOW (RDPI_Q31_ONE / 2 + RDPI_Q31_ONE / 32)

/* Both parts of f: see q31_bank.h. */
#define MAX_F (RDPI_Q31_ONE / 4)

/* The upper half of a number. */
static int32_t upper(int64_t number)
{
    return (int32_t)(number >> 32);
}

static bool is_within(int32_t value, int32_t limit)
{
    return value >= -limit && value <= limit;
}

static bool is_bank_sane(const rdpi_q31_bank_t *bank, const rdpi_q31_params_t *params)
{
    uint16_t engaged = bank->engaged;
    bool sane = engaged < params->plays && bank->last_engaged == &params->play[engaged] && rdpi_q31_in_format(bank->y[0]) &&
                bank->room >= 0 && bank->room <= RDPI_Q31_ONE && is_within(upper(bank->f_at_rest), MAX_F) &&
                is_within(upper(bank->f_rate), MAX_F);
    for (size_t i = engaged + 1u; i < params->plays; i++) {
        sane = sane && rdpi_q31_in_format(bank->y[i]);
    }
    return sane;
}

static bool is_rate_sane(const rdpi_q31_rate_t *rate)
{
    uint16_t window = rate->window;
    return window >= 1u && window <= RDPI_MAX_WINDOW && rate->oldest <= window && upper(rate->filtered) >= 0 &&
           rate->guard >= HALF && rate->per_guard >= HALF / 2u && rate->guard_shift <= 62u &&
           rate->blend_shift <= 30u && rate->direct_shift == (uint8_t)(31u - rate->guard_shift) &&
           (!rate->direct || (window == 1u && rate->blend == 0u && rate->guard_shift <= 31u));
}

static uint32_t last_code(const rdpi_q31_params_t *params)
{
    return params->dac_bits > 0u ? ((uint32_t)1 << params->dac_bits) - 1u : 0u;
}

/* In the range, to rounding. */
static bool is_a_drive(const rdpi_q31_params_t *params, int32_t drive)
{
    return drive >= params->min_drive - 4 && drive <= params->max_drive + 4;
}

static bool is_axis_sane(const rdpi_q31_t *axis, const rdpi_q31_params_t *params)
{
    int32_t drive = axis->drive, used = axis->rate;
    bool sane = drive >= params->min_drive && drive <= params->max_drive && used >= 0 && used <= RDPI_Q31_ONE &&
                axis->dac_code <= last_code(params) && axis->sweep_turns <= 2u * params->sweep_cycles + 1u &&
                rdpi_q31_in_format(axis->x) && is_a_drive(params, upper(axis->ramp)) && axis->slew >= 0 &&
                axis->sweep_step >= 1;
#if RDPI_NOISE_SHAPING
    sane = sane && is_within(upper(axis->carried), HALF / 4);
#endif
    return sane;
}

static bool is_creep_sane(const rdpi_q31_creep_t *creep, const rdpi_q31_chain_params_t *params)
{
    uint16_t poles = creep->poles, fast = creep->fast, turn = creep->turn;
    if (poles != params->poles || fast > poles) {
        return false;
    }
    bool sane = is_within(creep->h, MAX_H) && is_within(creep->mean, MAX_H) && is_within(upper(creep->settled), MAX_SETTLED) &&
                is_within(upper(creep->slow), MAX_SLOW) && is_within(upper(creep->next), MAX_SLOW) &&
                is_within(upper(creep->sum), RDPI_MAX_POLES) && creep->per_direct >= RDPI_Q31_ONE / 8 &&
                creep->per_direct <= RDPI_Q31_ONE && turn >= fast &&
                (turn < poles || (turn == poles && fast == poles));
    for (size_t i = 0; i < poles; i++) {
        const rdpi_q31_lag_t *lag = &creep->lag[i];
        sane = sane && is_within(upper(lag->state), RDPI_Q31_ONE) && lag->blend >= 0 &&
               is_within(lag->weight, RDPI_Q31_ONE) && lag->per_sample >= HALF / 2u && lag->exponent <= 94u &&
               lag->shift <= 62u;
    }
    return sane;
}

static bool is_lead_sane(const rdpi_q31_lead_t *lead)
{
    return is_within(lead->per_sum, RDPI_Q31_ONE) && is_within(lead->per_change, RDPI_Q31_ONE) &&
           is_within(lead->latest, INT32_MAX) && is_within(lead->before, INT32_MAX) && lead->shift >= 1u && lead->shift <= 63u;
}

static bool is_unlag_sane(const rdpi_q31_unlag_t *unlag, const rdpi_q31_params_t *params)
{
    return rdpi_q31_in_format(unlag->followed) && is_a_drive(params, upper(unlag->ramp)) &&
           rdpi_q31_in_format(unlag->carried) && unlag->per_step >= 0 && unlag->per_step <= RDPI_Q31_ONE &&
           rdpi_q31_in_format(unlag->asked) && is_within(unlag->before, RDPI_Q31_ONE) &&
           unlag->dac_code <= last_code(params) && unlag->shift >= 1u && unlag->shift <= 63u;
}

/* Whether what the chain points to are parameters, and those of its operator. */
static bool has_parameters(const rdpi_q31_chain_t *self)
{
    const rdpi_q31_chain_params_t *params = self->params;
    const rdpi_q31_params_t *axis = self->axis.params;
    return params != NULL && axis != NULL && params->schema == RDPI_PARAMS_SCHEMA && axis->schema == RDPI_PARAMS_SCHEMA &&
           params->axis != NULL && axis->digest == params->axis->digest;
}

bool rdpi_q31_chain_is_sane(const rdpi_q31_chain_t *self)
{
    if (self == NULL || !has_parameters(self)) {
        return false;
    }
    const rdpi_q31_params_t *axis = self->params->axis;
    return is_axis_sane(&self->axis, axis) && is_rate_sane(&self->axis.rate_estimator) &&
           is_bank_sane(&self->axis.bank, axis) && is_creep_sane(&self->creep, self->params) &&
           is_lead_sane(&self->lead) && is_unlag_sane(&self->unlag, axis) && self->sample_time_ns > 0u &&
           self->preview_samples <= RDPI_Q31_MAX_LEAD_NS + 2u;
}

/* ---- exchange of parameters: see rdpi_f32_state.c ---- */

typedef struct {
    int64_t r; /* half of the interval in which the input is, times 2 */
    int64_t y; /* its middle, times 2 */
} rdpi_q31_play_state_t;

/* a b / c, rounded towards 0. Scaling and overflow: |a| and |b| < 2^31. */
static int64_t proportion(int64_t a, int64_t b, int64_t c)
{
    return c != 0 ? a * b / c : 0;
}

/* The x of `to` at the drive at which `from` has `x`. The parameters have other units, and the same output range. */
static int32_t x_elsewhere(const rdpi_q31_params_t *to, const rdpi_q31_params_t *from, int32_t x)
{
    int32_t drive = x;
    if (rdpi_q31_pieces(from) > 1u) {
        const rdpi_q31_line_t *line = from->curve;
        for (unsigned left = rdpi_q31_pieces(from); left > 1u && x >= line[1].from_x; left--) {
            line++;
        }
        drive = rdpi_q31_line_drive(line, x);
    }
    int64_t way = proportion((int64_t)drive - from->drive_of_code_0,
                             (int64_t)rdpi_q31_drive_of_last_code(to) - to->drive_of_code_0,
                             (int64_t)rdpi_q31_drive_of_last_code(from) - from->drive_of_code_0);
    int32_t there = rdpi_q31_clamp(to->drive_of_code_0 + way, -RDPI_Q31_ONE, RDPI_Q31_ONE);
    return rdpi_q31_pieces(to) > 1u
               ? rdpi_q31_x_of_drive(to, rdpi_q31_clamp(there, -RDPI_Q31_MAX_DRIVE, RDPI_Q31_MAX_DRIVE))
               : there;
}

/* Play i of `from`, in the x of `to`. */
static rdpi_q31_play_state_t play_elsewhere(const rdpi_q31_params_t *to, const rdpi_q31_t *from, size_t i)
{
    const rdpi_q31_params_t *params = from->params;
    int32_t y = rdpi_q31_bank_state(&from->bank, params, i), r = params->play[i].r;
    int64_t one = x_elsewhere(to, params, y - r), other = x_elsewhere(to, params, y + r);
    rdpi_q31_play_state_t play = {other > one ? other - one : one - other, one + other};
    return play;
}

static void project_plays(const rdpi_q31_params_t *to, const rdpi_q31_t *from, int32_t *y)
{
    size_t i = 0;
    rdpi_q31_play_state_t below = play_elsewhere(to, from, 0), above = below;
    for (size_t k = 0; k < to->plays; k++) {
        int64_t r = 2 * (int64_t)to->play[k].r;
        while (above.r < r && i + 1u < from->params->plays) {
            i++;
            below = above;
            above = play_elsewhere(to, from, i);
        }
        int64_t part = (r < above.r ? r : above.r) - below.r, apart = above.r - below.r;
        int64_t twice = apart > 0 ? below.y + proportion(part, above.y - below.y, apart) : above.y;
        y[k] = rdpi_q31_clamp(twice / 2, -RDPI_Q31_MAX_DRIVE, RDPI_Q31_MAX_DRIVE);
        if (k > 0u) {
            int32_t gap = to->play[k].r - to->play[k - 1u].r;
            y[k] = rdpi_q31_clamp(y[k], y[k - 1u] - gap, y[k - 1u] + gap);
        } else {
            y[k] = rdpi_q31_x_in_range(to, y[k]);
        }
    }
}

/* log2 of what a pole moves in a sample, times 2^31, straight between powers of 2. */
static int64_t about_log2(const rdpi_q31_lag_t *lag)
{
    unsigned zeros = rdpi_q31_clz(lag->per_sample);
    int64_t mantissa = (uint32_t)(lag->per_sample << zeros);
    return mantissa - (lag->exponent + (int64_t)zeros) * ((int64_t)1 << 31);
}

/* A larger logarithm than any. */
#define NONE ((int64_t)1 << 62)

/* How far a pole like `lag` would be behind h: between the two poles of `from` next to it, or as the last of them. */
static int64_t behind_of(const rdpi_q31_creep_t *from, const rdpi_q31_lag_t *lag)
{
    const int64_t place = about_log2(lag);
    int64_t under = -NONE, over = NONE, under_lag = 0, over_lag = 0;
    for (size_t i = 0; i < from->poles; i++) {
        int64_t at = about_log2(&from->lag[i]), less = (int64_t)upper(from->lag[i].state) - from->h;
        if (at <= place && at > under) {
            under = at;
            under_lag = less;
        }
        if (at >= place && at < over) {
            over = at;
            over_lag = less;
        }
    }
    if (under == -NONE || over == NONE) {
        return under == -NONE ? over_lag : under_lag;
    }
    return under_lag + proportion((place - under) >> 9, over_lag - under_lag, (over - under) >> 9);
}

/* A displacement in units of `from` in those of `to`. */
static int64_t rescaled(const rdpi_q31_params_t *to, const rdpi_q31_params_t *from, int64_t way)
{
    int64_t scaled = proportion(way, from->unit_mantissa >> 1, to->unit_mantissa >> 1);
    int shift = from->unit_exponent - to->unit_exponent;
    shift = shift > 31 ? 31 : (shift < -62 ? -62 : shift); /* saturates: |scaled| < 2^32 */
    return shift >= 0 ? scaled * ((int64_t)1 << shift) : scaled / ((int64_t)1 << -shift);
}

/* The share of h_0 in the displacement, times 2^30. */
static int32_t share_of_settled(const rdpi_q31_chain_params_t *params)
{
    int32_t share = RDPI_Q31_ONE - params->direct;
    for (size_t i = 0; i < params->poles; i++) {
        share -= params->pole[i].share;
    }
    return share;
}

/* Creep of `self`, which has settled at its present h, takes over how far h_0 and each pole of `from` are behind. */
static void project_creep(rdpi_q31_chain_t *self, const rdpi_q31_chain_t *from)
{
    const rdpi_q31_params_t *to = self->params->axis, *old = from->params->axis;
    rdpi_q31_creep_t *creep = &self->creep;
    if (creep->poles == 0u || from->creep.poles == 0u) {
        return;
    }
    int32_t share = share_of_settled(from->params);
    int64_t behind_0 = share != 0 ? rdpi_q31_clamp(from->creep.settled / share, -MAX_H, MAX_H) - (int64_t)from->creep.h : 0;
    int32_t h_0 = rdpi_q31_clamp(creep->h + rescaled(to, old, behind_0), -MAX_H, MAX_H);
    creep->settled = rdpi_q31_mul(share_of_settled(self->params), h_0);
    creep->mean = rdpi_q31_clamp(creep->h + rescaled(to, old, (int64_t)from->creep.mean - from->creep.h), -MAX_H, MAX_H);
    creep->slow = 0;
    for (size_t i = 0; i < creep->poles; i++) {
        rdpi_q31_lag_t *lag = &creep->lag[i];
        int64_t at = creep->h + rescaled(to, old, behind_of(&from->creep, lag));
        lag->state = rdpi_q31_widen(rdpi_q31_clamp(at, -MAX_H, MAX_H));
        creep->slow += i < creep->fast ? 0 : rdpi_q31_creep_adds(lag);
    }
}

/* What `from` outputs is the output; the plays have their own drive where there is a lag, and where there was one. */
static void take_output(rdpi_q31_chain_t *self, const rdpi_q31_chain_t *from)
{
    rdpi_q31_t *axis = &self->axis;
    const rdpi_q31_params_t *params = axis->params, *old = from->params->axis;
    int64_t way = proportion((int64_t)from->axis.drive - old->drive_of_code_0,
                             (int64_t)rdpi_q31_drive_of_last_code(params) - params->drive_of_code_0,
                             (int64_t)rdpi_q31_drive_of_last_code(old) - old->drive_of_code_0);
    axis->drive = rdpi_q31_clamp(params->drive_of_code_0 + way, params->min_drive, params->max_drive);
    self->unlag.ramp = rdpi_q31_widen(axis->drive);
    if (self->unlag.per_step == 0) {
        axis->ramp = self->unlag.ramp;
    }
    if (params->dac_bits == old->dac_bits) {
        axis->dac_code = from->axis.dac_code;
    } else {
        axis->dac_code = params->dac_bits > 0u ? (uint32_t)rdpi_q31_code_of_drive(params, axis->drive) : 0u;
    }
    if (params->dac_bits > 0u) { /* of the code, as a step leaves it */
        int64_t drive = rdpi_q31_drive_of_code(params, axis->dac_code);
        axis->drive = rdpi_q31_clamp(drive, params->min_drive, params->max_drive);
    }
}

rdpi_status_t rdpi_q31_chain_inherit(rdpi_q31_chain_t *self, const rdpi_q31_chain_t *from)
{
    if (self == NULL || from == NULL) {
        return RDPI_ERR_NULL;
    }
    rdpi_q31_t *axis = &self->axis;
    const rdpi_q31_params_t *params = axis->params, *old = from->params->axis;
    int32_t y[RDPI_MAX_PLAYS];
    if (params->min_mV != old->min_mV || params->max_mV != old->max_mV || params->unit_mantissa < HALF ||
        old->unit_mantissa < HALF) {
        return RDPI_ERR_DRIVE;
    }
    if (self->sample_time_ns != from->sample_time_ns) {
        return RDPI_ERR_SAMPLE_TIME;
    }
    project_plays(params, &from->axis, y);
    (void)rdpi_q31_set_memory(axis, y); /* it takes what project_plays makes: integers are not rounded */
    rdpi_q31_chain_settle(self);
    project_creep(self, from);
    take_output(self, from);
    axis->rate_estimator.direct = false; /* the next step begins where the plays are, not at the output */
    axis->guard_count = from->axis.guard_count;
    axis->clip_count = from->axis.clip_count;
    axis->input_count = from->axis.input_count;
    axis->missed_count = from->axis.missed_count;
    return RDPI_OK;
}
