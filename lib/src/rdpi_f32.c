#include "rdpi/f32.h"

#include "f32_check.h"
#include "f32_bank.h"
#include "f32_drive.h"
#include "f32_math.h"
#include "f32_rate.h"
#include "f32_saturation.h"
#include "f32_step.h"

/* How many codes x = 0 may be away from code 0 for the quick way. Beyond, single precision can be a code wrong. */
#define MAX_CODE_0 (2L << RDPI_MAX_DAC_BITS)

/* Whether steps that the quick way does not serve have ways of their own. */
#define WHOLE_QUICK_WAY (RDPI_QUICK_STEP > 1)

uint32_t rdpi_f32_digest_layout(uint64_t layout, const rdpi_f32_params_t *params)
{
    rdpi_f32_scan_t scan;
    return layout == RDPI_F32_LAYOUT ? rdpi_f32_scan(&scan, params) : 0u;
}

rdpi_status_t rdpi_f32_init_layout(uint64_t layout, rdpi_f32_t *self, const rdpi_f32_params_t *params,
                                   rdpi_real_t sample_time_s)
{
    rdpi_status_t status = rdpi_f32_check_pointers(layout, self, params);
    if (status == RDPI_OK) {
        status = rdpi_f32_check_params(self, params, sample_time_s);
    }
    if (status == RDPI_OK) {
        self->params = params;
        rdpi_f32_reset(self);
    }
    return status;
}

/* ---- memory ---- */

/* What `quick` states may no longer hold. The next step takes the long way, and finds out. */
static void end_quick(rdpi_f32_t *self)
{
    if (RDPI_QUICK_STEP > 0) {
        self->quick = false;
    }
}

/* What the codes so far have missed is forgotten. */
static void forget_codes(rdpi_f32_t *self)
{
#if RDPI_NOISE_SHAPING
    self->carried_um = 0;
#else
    (void)self;
#endif
}

/* The next sample is the first: the rate history is forgotten. */
static void forget_samples(rdpi_f32_t *self)
{
    rdpi_f32_rate_reset(&self->rate_estimator);
    self->missed = 0;
    end_quick(self);
}

/* Takes a drive that no step has output: that of the memory or of another source. Ends a sweep. */
static void put_drive(rdpi_f32_t *self, rdpi_real_t drive_V)
{
    self->drive_V = rdpi_f32_clamp(drive_V, self->params->min_V, self->params->max_V);
    self->ramp_V = self->drive_V;
    rdpi_real_t x_um = self->bank.y_um[0];
    self->dac_code = rdpi_f32_code_of_x(self->params, rdpi_f32_line_of_x(self->params, x_um), x_um);
    self->sweep_turns = 0;
    forget_codes(self);
    end_quick(self);
}

/* Takes checked states as they are, so that those of rdpi_f32_get_memory come back bit for bit. */
static void put_memory(rdpi_f32_t *self, const rdpi_real_t *y_um)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_f32_bank_set(&self->bank, params->play, params->plays, y_um);
    rdpi_real_t x_um = self->bank.y_um[0];
    put_drive(self, rdpi_f32_drive_of_x(rdpi_f32_line_of_x(params, x_um), x_um));
}

void rdpi_f32_reset(rdpi_f32_t *self)
{
    put_memory(self, self->params->memory_um);
    forget_samples(self);
    self->rate_um_per_s = 0;
    self->flags = 0;
    self->guard_count = 0;
    self->clip_count = 0;
    self->input_count = 0;
    self->missed_count = 0;
}

rdpi_status_t rdpi_f32_set_memory(rdpi_f32_t *self, const rdpi_real_t *y_um)
{
    rdpi_status_t status = self == NULL || y_um == NULL ? RDPI_ERR_NULL : rdpi_f32_check_memory(self->params, y_um);
    if (status == RDPI_OK) {
        put_memory(self, y_um);
    }
    return status;
}

void rdpi_f32_get_memory(const rdpi_f32_t *self, rdpi_real_t *y_um)
{
    for (size_t i = 0; i < self->params->plays; i++) {
        y_um[i] = rdpi_f32_bank_state(&self->bank, self->params->play, i);
    }
}

/* ---- the step ---- */

static void set_flag(rdpi_f32_t *self, uint32_t flag, uint32_t *count)
{
    self->flags |= flag;
    if (*count < UINT32_MAX) {
        (*count)++;
    }
}

/* The input is not usable. The drive is held, no state changes, and the sample counts as missed. */
static RDPI_F32_SELDOM rdpi_real_t refuse_input(rdpi_f32_t *self)
{
    set_flag(self, RDPI_FLAG_INPUT, &self->input_count);
    if (self->missed < UINT8_MAX) {
        self->missed++;
    }
    end_quick(self);
    return self->drive_V;
}

/* The singularity guard. Stores the rate. */
static rdpi_real_t limit_rate(rdpi_f32_t *self, rdpi_real_t rate_um_per_s)
{
    if (rate_um_per_s > self->params->max_um_per_s) {
        rate_um_per_s = self->params->max_um_per_s;
        set_flag(self, RDPI_FLAG_GUARD, &self->guard_count);
    }
    self->rate_um_per_s = rate_um_per_s;
    return rate_um_per_s;
}

/* A slope per second as a change per sample. */
static RDPI_F32_SHARED rdpi_real_t per_sample(const rdpi_f32_t *self, rdpi_real_t per_s)
{
    return per_s / ((rdpi_real_t)self->rate_estimator.window * self->rate_estimator.per_window_s);
}

/* Range and slew limit: what may be output of the drive wished for. `quick` is that of finish_step. */
static inline rdpi_real_t limit_drive(rdpi_f32_t *self, rdpi_real_t wish_V, const bool quick)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_real_t drive_V = rdpi_f32_clamp(wish_V, params->min_V, params->max_V);
    uint32_t clipped = drive_V != wish_V ? RDPI_FLAG_RANGE : 0u;
    if (!quick && params->slew_V_per_s > 0) {
        rdpi_real_t slew_V = per_sample(self, params->slew_V_per_s);
        rdpi_real_t reached_V = rdpi_f32_clamp(drive_V, self->ramp_V - slew_V, self->ramp_V + slew_V);
        if (reached_V != drive_V) {
            clipped |= RDPI_FLAG_SLEW;
            drive_V = reached_V;
        }
    }
    if (clipped != 0u) {
        set_flag(self, clipped, &self->clip_count);
    }
    return drive_V;
}

/* Noise shaping. What a code misses is counted as a displacement, at the output of the plays, and not as a drive: a code
 * that goes too far can move plays that one which falls short does not move, so that drives which add up to nothing leave
 * displacements which do not. */
static inline bool shapes_noise(const rdpi_f32_t *self)
{
    return RDPI_NOISE_SHAPING != 0 && self->params->noise_shaping != 0u;
}

#if RDPI_NOISE_SHAPING
/* How far x is moved before it is rounded, to make up for what the codes so far have missed. By half a code at most: the
 * code is one of the two next to x, and what is left waits. The slope need not be the true one, because what the code
 * really misses is counted afterwards: that of the identity serves all. */
static RDPI_F32_SELDOM rdpi_real_t carry_um(const rdpi_f32_t *self, const rdpi_f32_line_t *line)
{
    rdpi_real_t half_um = fabs(line->um_per_code) / 2;
    return rdpi_f32_clamp(self->carried_um / self->params->play[0].slope, -half_um, half_um);
}

/* Counts what the code of this step has missed of `v_um`. Where the drive was clipped, nothing is made up for later. Two
 * codes on the last slope are more than what adds up by rounding to the codes next to x. */
static RDPI_F32_SELDOM void count_missed_um(rdpi_f32_t *self, rdpi_real_t v_um)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_real_t missed_um = rdpi_f32_bank_climb(&self->bank, self->rate_um_per_s, v_um);
    rdpi_real_t most_um = 2 * fabs(params->curve[0].um_per_code) * params->play[params->plays - 1u].slope;
    bool clipped = (self->flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0u;
    self->carried_um = clipped ? 0 : rdpi_f32_clamp(self->carried_um + missed_um, -most_um, most_um);
}
#endif

/* The piece of the input curve on which dac_code lies, for the quick way. */
static inline const rdpi_f32_line_t *line_of_code(const rdpi_f32_t *self)
{
#if RDPI_MAX_CURVE_PIECES > 1
    return self->line;
#else
    return self->params->curve;
#endif
}

static inline void keep_line(rdpi_f32_t *self, const rdpi_f32_line_t *line)
{
#if RDPI_QUICK_STEP > 0 && RDPI_MAX_CURVE_PIECES > 1
    self->line = line;
#else
    (void)self;
    (void)line;
#endif
}

/* Outputs a drive inside the range, rounded to a code if there are codes, and moves the plays there. target.x_um is the
 * x of the drive, and `line` the piece of either; a code has an x of its own. Returns the side to which x goes then.
 * `quick` is that of finish_step. */
static RDPI_F32_SHARED rdpi_real_t output(rdpi_f32_t *self, rdpi_real_t drive_V, rdpi_f32_target_t target,
                                          const rdpi_f32_line_t *line, const bool quick)
{
    const rdpi_f32_params_t *params = self->params;
    if (!quick) {
        self->ramp_V = drive_V;
    }
    if (quick || params->dac_bits > 0u) {
        self->dac_code = rdpi_f32_code_of_x(params, line, target.x_um);
        rdpi_real_t code = (rdpi_real_t)self->dac_code;
        line = rdpi_f32_line_of_code(params, line, code);
        drive_V = rdpi_f32_fma(code, params->V_per_code, params->min_V);
        target.x_um = rdpi_f32_fma(code, line->um_per_code, line->x_of_code_0_um);
        keep_line(self, line);
    }
    self->drive_V = drive_V;
    return rdpi_f32_bank_move(&self->bank, params->play, params->plays, target);
}

/* Whether the parameters and the code allow the next step the quick way; see `quick` in rdpi_f32_t. Without codes,
 * dac_code is 0. The first and the last code do not open it: a drive of another source may just have come back from
 * outside the range, and half a code to one side is outside. */
static bool next_is_quick(const rdpi_f32_t *self)
{
    const rdpi_f32_params_t *params = self->params;
    return self->rate_estimator.window == 1u && self->rate_estimator.keep <= 0 && params->slew_V_per_s <= 0 &&
           !shapes_noise(self) && self->dac_code > 0u && (rdpi_real_t)self->dac_code < params->last_code &&
           fabs(line_of_code(self)->code_of_x_0) <= MAX_CODE_0;
}

/* Sets the middle of where x is free both ways, and returns how far it is free from there. `next` is the play that ends
 * it, or NULL: a single play is free in all of `line`. Without the input curve, the state of that play is the middle. */
static inline rdpi_real_t set_middle(rdpi_f32_bank_t *bank, const rdpi_f32_line_t *line, const rdpi_f32_play_t *next)
{
#if RDPI_MAX_CURVE_PIECES > 1
    const rdpi_real_t *next_um = &bank->y_um[1];
    rdpi_real_t low_um = line->middle_um - line->reach_um, high_um = line->middle_um + line->reach_um;
    if (next != NULL) {
        rdpi_real_t lowest_um = *next_um - next->r_um, highest_um = *next_um + next->r_um;
        low_um = lowest_um > low_um ? lowest_um : low_um;
        high_um = highest_um < high_um ? highest_um : high_um;
    }
    bank->middle_um = (low_um + high_um) / 2;
    return (high_um - low_um) / 2;
#else
    rdpi_real_t *next_um = &bank->y_um[1];
    if (next == NULL) {
        *next_um = line->middle_um;
        return line->reach_um;
    }
    rdpi_real_t reach_um = line->reach_um - fabs(*next_um - line->middle_um);
    return reach_um < next->r_um ? reach_um : next->r_um;
#endif
}

/* What set_middle set. */
static inline rdpi_real_t middle_um(const rdpi_f32_bank_t *bank)
{
#if RDPI_MAX_CURVE_PIECES > 1
    return bank->middle_um;
#else
    return bank->y_um[1];
#endif
}

/* Sets bank.edge_um; see `quick` in rdpi_f32_t. x goes to `side`. The edge is at a code, half a code or more before the
 * next corner and before the end of `line`, so that rounding to a code does not lead beyond. Where no play is engaged
 * and x is free both ways, it is three quarters of a code before. Both margins are larger than any rounding. */
static RDPI_F32_HOT void set_edge(rdpi_f32_t *self, rdpi_real_t side)
{
    const rdpi_f32_line_t *line = line_of_code(self);
    rdpi_f32_bank_t *bank = &self->bank;
    const rdpi_f32_play_t *next = &bank->last_engaged[1];
    const rdpi_real_t *next_um = &bank->y_um[bank->engaged + 1u];
    bool last = bank->engaged + 1u == self->params->plays;
    rdpi_real_t code_um = fabs(line->um_per_code);
    if (bank->engaged > 0u) {
        rdpi_real_t end_um = rdpi_f32_fma(side, line->middle_um, line->reach_um);
        if (!last) {
            rdpi_real_t corner_um = rdpi_f32_fma(side, *next_um, next->r_um);
            end_um = corner_um < end_um ? corner_um : end_um;
        }
        end_um = rdpi_f32_fma((rdpi_real_t)-0.5, code_um, end_um);
        int32_t codes = (int32_t)(rdpi_f32_fma(side, end_um, -bank->y_um[0]) * line->codes_per_um);
        rdpi_real_t code = (rdpi_real_t)self->dac_code + (rdpi_real_t)codes;
        bank->edge_um = rdpi_f32_fma(code, line->um_per_code, line->x_of_code_0_um);
    } else {
        bank->edge_um = rdpi_f32_fma((rdpi_real_t)-0.75, code_um, set_middle(bank, line, last ? NULL : next));
    }
}

/* Whether x turns round, but is still rounded to the code that is output. That code must not be at an end of the range
 * or between two pieces, and x must be before the first corner on the way back, which is 2 r_1 off. rdpi_f32_bank_walk
 * and `output` would then give the same code. `asks`: keeps the drive of x, as in rdpi_f32_step_asking. Behind the turn
 * no play is engaged, so that x is not the one for which `step` has kept the drive. */
static inline bool turns_within_code(rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s, const bool asks)
{
    const rdpi_f32_params_t *params = self->params;
    const rdpi_f32_line_t *line = line_of_code(self);
    const rdpi_f32_bank_t *bank = &self->bank;
    rdpi_real_t rise_um = rdpi_f32_bank_side(bank->falling) * climb_um;
    if (!(rise_um < 0) || bank->engaged == 0u) {
        return false;
    }
    rdpi_real_t slope = rdpi_f32_slope(params->play, rate_um_per_s);
    if (-rise_um > slope * params->play[1].r_um) {
        return false;
    }
    rdpi_real_t x_um = climb_um / slope + bank->y_um[0], code = (rdpi_real_t)self->dac_code;
    rdpi_real_t beyond = rdpi_f32_fma(x_um, line->codes_per_um, line->code_of_x_0) - code;
    if (asks) {
        self->ramp_V = rdpi_f32_drive_of_x(line, x_um);
    }
    return beyond >= 0 && beyond < 1 && code > 1 && code > line->from_code && code < params->last_code - 1;
}

/* The drive of an x on the quick way. At a code where a piece begins, rounding can leave x on the piece before it. */
static inline rdpi_real_t drive_before_edge(const rdpi_f32_t *self, rdpi_real_t x_um)
{
    const rdpi_f32_line_t *line = line_of_code(self);
    bool begins = (rdpi_real_t)self->dac_code <= line->from_code;
    return rdpi_f32_drive_of_x(begins ? rdpi_f32_line_of_x(self->params, x_um) : line, x_um);
}

/* The end of any step: finds the x where the output of the bank has climbed by `climb_um`, and outputs it. `quick` is
 * what the compiler knows of self->quick: true, or false if it knows nothing. `asks`: as in rdpi_f32_step_asking. */
static RDPI_F32_HOT rdpi_real_t finish_step(rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s,
                                            const bool quick, const bool asks)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_f32_target_t target = rdpi_f32_bank_walk(&self->bank, params->play, params->plays, rate_um_per_s, climb_um);
    const rdpi_f32_line_t *line = rdpi_f32_line_of_x(params, target.x_um);
    rdpi_real_t wish_V = rdpi_f32_drive_of_x(line, target.x_um);
    rdpi_real_t drive_V = limit_drive(self, wish_V, quick);
    if (drive_V != wish_V) {
        line = rdpi_f32_line_of_drive(params, drive_V);
        target.x_um = rdpi_f32_x_of_drive(line, drive_V);
    }
#if RDPI_NOISE_SHAPING
    if (!quick && drive_V == wish_V && shapes_noise(self)) {
        target.x_um += carry_um(self, line);
        line = rdpi_f32_line_of_x(params, target.x_um);
    }
#endif
    if (asks) {
        self->ramp_V = drive_V;
    }
    rdpi_real_t side = output(self, drive_V, target, line, quick);
    if (RDPI_QUICK_STEP > 0 && !quick) {
        self->quick = next_is_quick(self);
    }
    if (RDPI_QUICK_STEP > 0 && (quick || self->quick)) {
        set_edge(self, side);
    }
    return self->drive_V;
}

/* The end of a step that began while `quick` was true. */
static RDPI_F32_SELDOM rdpi_real_t finish_quick_step(rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s)
{
    return finish_step(self, climb_um, rate_um_per_s, true, false);
}

static RDPI_F32_SELDOM rdpi_real_t finish_quick_asking(rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s)
{
    return finish_step(self, climb_um, rate_um_per_s, true, true);
}

static RDPI_F32_HOT rdpi_real_t finish_quickly(rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s,
                                               const bool asks)
{
    return asks ? finish_quick_asking(self, climb_um, rate_um_per_s) : finish_quick_step(self, climb_um, rate_um_per_s);
}

/* Taken while `quick` is true, if x would leave bank.edge_um: a play may engage, `line` may end, or x turns
 * round. */
static RDPI_F32_HOT rdpi_real_t step_over_edge(rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s,
                                               const bool asks)
{
    if (turns_within_code(self, climb_um, rate_um_per_s, asks)) {
        return self->drive_V;
    }
    return finish_quickly(self, climb_um, rate_um_per_s, asks);
}

static RDPI_F32_SELDOM rdpi_real_t step_over_edge_only(rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s)
{
    return step_over_edge(self, climb_um, rate_um_per_s, false);
}

static RDPI_F32_SELDOM rdpi_real_t step_over_edge_asking(rdpi_f32_t *self, rdpi_real_t climb_um,
                                                         rdpi_real_t rate_um_per_s)
{
    return step_over_edge(self, climb_um, rate_um_per_s, true);
}

/* Taken while `quick` is false. Serves samples of any kind, and may make `quick` true for the next. */
static RDPI_F32_SELDOM rdpi_real_t step_without_quick(rdpi_f32_t *self, rdpi_real_t reference_um)
{
    const rdpi_f32_params_t *params = self->params;
    self->flags = 0;
    if (!(fabs(reference_um) <= RDPI_MAX_REFERENCE_UM)) {
        return refuse_input(self);
    }
    if (self->missed > 0u) {
        self->flags = RDPI_FLAG_MISSED;
    }
    /* The rate of the reference, which is exact, and not of z, which is rounded: the offset cancels. */
    rdpi_real_t rate_um_per_s = limit_rate(self, rdpi_f32_rate_step(&self->rate_estimator, reference_um, self->missed));
    self->missed = 0;
    const rdpi_f32_piece_t *piece = rdpi_f32_piece_find(params->inverse_saturation, params->deadzones, reference_um);
    if (RDPI_QUICK_STEP > 0) {
        self->latest_piece = piece;
    }
    rdpi_real_t v_um = rdpi_f32_piece_at(piece, reference_um - params->offset_um);
    rdpi_real_t climb_um = rdpi_f32_bank_climb(&self->bank, rate_um_per_s, v_um);
    rdpi_real_t drive_V = finish_step(self, climb_um, rate_um_per_s, false, false);
#if RDPI_NOISE_SHAPING
    if (shapes_noise(self)) {
        count_missed_um(self, v_um);
    }
#endif
    return drive_V;
}

/* Taken while `quick` is true, if the rate is above the guard or the reference is not inside latest_piece. References
 * that are not usable come here too. */
static RDPI_F32_HOT rdpi_real_t step_over_guard_or_piece(rdpi_f32_t *self, rdpi_real_t reference_um,
                                                         rdpi_real_t rate_um_per_s, const bool asks)
{
    const rdpi_f32_params_t *params = self->params;
    self->flags = 0;
    if (!(fabs(reference_um) <= RDPI_MAX_REFERENCE_UM)) {
        return refuse_input(self);
    }
    rate_um_per_s = limit_rate(self, rate_um_per_s);
    const rdpi_f32_piece_t *piece = rdpi_f32_piece_find(params->inverse_saturation, params->deadzones, reference_um);
    self->rate_estimator.z_um[0] = reference_um;
    self->latest_piece = piece;
    rdpi_real_t v_um = rdpi_f32_piece_at(piece, reference_um - params->offset_um);
    return finish_quickly(self, rdpi_f32_bank_climb(&self->bank, rate_um_per_s, v_um), rate_um_per_s, asks);
}

static RDPI_F32_SELDOM rdpi_real_t step_over_any(rdpi_f32_t *self, rdpi_real_t reference_um, rdpi_real_t rate_um_per_s)
{
    return step_over_guard_or_piece(self, reference_um, rate_um_per_s, false);
}

static RDPI_F32_SELDOM rdpi_real_t step_over_any_asking(rdpi_f32_t *self, rdpi_real_t reference_um,
                                                        rdpi_real_t rate_um_per_s)
{
    return step_over_guard_or_piece(self, reference_um, rate_um_per_s, true);
}

/* From the quick way to the one for any reference. Nothing has been stored yet. */
static RDPI_F32_HOT rdpi_real_t leave_quick_way(rdpi_f32_t *self, rdpi_real_t reference_um, rdpi_real_t rate_um_per_s,
                                                const bool asks)
{
    if (!WHOLE_QUICK_WAY) {
        return step_without_quick(self, reference_um);
    }
    return asks ? step_over_any_asking(self, reference_um, rate_um_per_s)
                : step_over_any(self, reference_um, rate_um_per_s);
}

/* There are four ways into the step, and this function chooses between them:
 *
 * - step_without_quick, while `quick` is false;
 * - step_over_guard_or_piece, if the rate is above the guard or the reference is not inside latest_piece;
 * - step_over_edge, if x would leave bank.edge_um;
 * - the quick way otherwise, which is nearly always: the rest of this function.
 *
 * Without WHOLE_QUICK_WAY, step_without_quick is also the second, and the third unless x turns within its code.
 *
 * All four give the same bits as step_without_quick. Why the quick way may be so short stands at `quick` in rdpi_f32_t.
 * NaN fails every comparison here. Nothing is stored before the reference is known to be usable. `asks` is that of
 * rdpi_f32_step_asking. */
static RDPI_F32_HOT rdpi_real_t step(rdpi_f32_t *self, rdpi_real_t reference_um, const bool asks)
{
    const rdpi_f32_params_t *params = self->params;
    if (RDPI_QUICK_STEP == 0 || !self->quick) {
        return step_without_quick(self, reference_um);
    }
    const rdpi_f32_piece_t *piece = self->latest_piece;
    rdpi_f32_bank_t *bank = &self->bank;
    rdpi_real_t rate_um_per_s = rdpi_f32_rate_direct(&self->rate_estimator, reference_um);
    if (!(rate_um_per_s <= params->max_um_per_s)) {
        return leave_quick_way(self, reference_um, rate_um_per_s, asks);
    }
    if (!rdpi_f32_piece_holds(piece, reference_um)) {
        return leave_quick_way(self, reference_um, rate_um_per_s, asks);
    }
    rdpi_real_t v_um = rdpi_f32_piece_at(piece, reference_um - params->offset_um);
    rdpi_real_t climb_um = rdpi_f32_bank_climb(bank, rate_um_per_s, v_um);
    rdpi_real_t way_um = rdpi_f32_bank_way(bank, rate_um_per_s, climb_um);
    rdpi_real_t x_um = way_um + bank->y_um[0];
    rdpi_real_t before_edge = RDPI_F32_RARE(bank->engaged == 0u) ? bank->edge_um - fabs(x_um - middle_um(bank))
                                                  : way_um * (bank->edge_um - x_um); /* > 0: x stays before it */
    bool goes_on = before_edge > 0;
    if (!WHOLE_QUICK_WAY && !goes_on && !turns_within_code(self, climb_um, rate_um_per_s, asks)) {
        return step_without_quick(self, reference_um);
    }
    self->flags = 0;
    self->rate_estimator.z_um[0] = reference_um;
    self->rate_um_per_s = rate_um_per_s;
    if (!goes_on) {
        if (!WHOLE_QUICK_WAY) { /* x turns within its code */
            return self->drive_V;
        }
        return asks ? step_over_edge_asking(self, climb_um, rate_um_per_s)
                    : step_over_edge_only(self, climb_um, rate_um_per_s);
    }
    if (asks) {
        self->ramp_V = drive_before_edge(self, x_um);
    }
    const rdpi_f32_line_t *line = line_of_code(self);
    self->dac_code = (uint32_t)rdpi_f32_fma(x_um, line->codes_per_um, line->code_of_x_0);
    rdpi_real_t code = (rdpi_real_t)self->dac_code;
    bank->y_um[0] = rdpi_f32_fma(code, line->um_per_code, line->x_of_code_0_um);
    self->drive_V = rdpi_f32_fma(code, params->V_per_code, params->min_V);
    return self->drive_V;
}

rdpi_real_t rdpi_f32_step(rdpi_f32_t *self, rdpi_real_t reference_um)
{
    return step(self, reference_um, false);
}

#if RDPI_QUICK_STEP > 0
rdpi_real_t rdpi_f32_step_asking(rdpi_f32_t *self, rdpi_real_t reference_um)
{
    return step(self, reference_um, true);
}
#endif

void rdpi_f32_missed(rdpi_f32_t *self, uint32_t ticks)
{
    uint32_t missed = self->missed + (ticks < UINT8_MAX ? ticks : UINT8_MAX);
    self->missed = (uint8_t)(missed < UINT8_MAX ? missed : UINT8_MAX);
    end_quick(self);
    self->missed_count += ticks < UINT32_MAX - self->missed_count ? ticks : UINT32_MAX - self->missed_count;
}

bool rdpi_f32_sweep(rdpi_f32_t *self)
{
    const rdpi_f32_params_t *params = self->params;
    if (self->sweep_turns == 0u) {
        self->sweep_turns = (uint16_t)(2u * params->sweep_cycles + 1u);
    }
    if (self->rate_estimator.oldest < self->rate_estimator.window && params->slew_V_per_s <= 0) {
        self->ramp_V = self->drive_V; /* there have been steps: the sweep begins at what they have output */
    }
    /* 2 C + 1: all the way to max_V; 2 C: all the way to min_V; ... 3, 2: a C-th part of that; 1: to sweep_end_V */
    unsigned cycles_left = self->sweep_turns / 2u;
    rdpi_real_t left = (rdpi_real_t)cycles_left / (rdpi_real_t)params->sweep_cycles;
    rdpi_real_t limit_V = self->sweep_turns % 2u != 0u ? params->max_V : params->min_V;
    rdpi_real_t turn_V = rdpi_f32_fma(left, limit_V - params->sweep_end_V, params->sweep_end_V);
    turn_V = rdpi_f32_clamp(turn_V, params->min_V, params->max_V);
    rdpi_real_t sweep_step_V = per_sample(self, params->sweep_V_per_s);
    rdpi_real_t drive_V = rdpi_f32_clamp(turn_V, self->ramp_V - sweep_step_V, self->ramp_V + sweep_step_V);

    self->flags = 0;
    self->rate_um_per_s = 0;
    forget_samples(self);
    forget_codes(self);
    if (drive_V == turn_V) {
        self->sweep_turns--;
    }
    const rdpi_f32_line_t *line = rdpi_f32_line_of_drive(params, drive_V);
    rdpi_f32_target_t target = rdpi_f32_bank_target(rdpi_f32_x_of_drive(line, drive_V));
    (void)output(self, drive_V, target, line, false);
    return self->sweep_turns > 0u;
}

void rdpi_f32_forget_sweep(rdpi_f32_t *self)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_f32_bank_t *bank = &self->bank;
    rdpi_real_t forgotten = rdpi_f32_clamp(params->sweep_forgotten, 0, 1);
    if (forgotten > 0) { /* 0 leaves the next step its last bit */
        rdpi_f32_get_memory(self, bank->y_um);
        for (size_t i = 1; i < params->plays; i++) {
            bank->y_um[i] = rdpi_f32_fma(-forgotten, bank->y_um[i] - bank->y_um[0], bank->y_um[i]);
        }
        rdpi_real_t drive_V = self->drive_V, ramp_V = self->ramp_V; /* from x they would be rounded once more */
        put_memory(self, bank->y_um);
        self->drive_V = drive_V;
        self->ramp_V = ramp_V;
    }
}

rdpi_real_t rdpi_f32_predict(const rdpi_f32_t *self, rdpi_real_t drive_V, rdpi_real_t rate_um_per_s)
{
    const rdpi_f32_params_t *params = self->params;
    if (!(rate_um_per_s >= 0)) {
        return (rdpi_real_t)NAN;
    }
    rdpi_real_t rate = rate_um_per_s < params->max_um_per_s ? rate_um_per_s : params->max_um_per_s;
    rdpi_real_t x_um = rdpi_f32_x_of_drive(rdpi_f32_line_of_drive(params, drive_V), drive_V);
    rdpi_real_t v_um = rdpi_f32_bank_at(&self->bank, params->play, params->plays, rate, x_um);
    return rdpi_f32_saturation(params->saturation, params->deadzones, v_um) + params->offset_um;
}

rdpi_real_t rdpi_f32_forward(rdpi_f32_t *self, rdpi_real_t drive_V, rdpi_real_t rate_um_per_s)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_real_t displacement_um = rdpi_f32_predict(self, drive_V, rate_um_per_s);

    self->flags = 0;
    rdpi_real_t outside_V = drive_V - rdpi_f32_clamp(drive_V, params->min_V, params->max_V);
    if (!isfinite(displacement_um) || !isfinite(rate_um_per_s) ||
        fabs(outside_V) > MAX_SPANS * (params->max_V - params->min_V)) {
        return rdpi_f32_predict(self, refuse_input(self), self->rate_um_per_s);
    }
    rdpi_real_t x_um = rdpi_f32_x_of_drive(rdpi_f32_line_of_drive(params, drive_V), drive_V);
    rdpi_f32_target_t target = rdpi_f32_bank_target(x_um);
    (void)limit_rate(self, rate_um_per_s);
    forget_samples(self);
    (void)rdpi_f32_bank_move(&self->bank, params->play, params->plays, target);
    put_drive(self, drive_V);
    return displacement_um;
}
