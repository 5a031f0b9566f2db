#include "rdpi/f32.h"

#include <tgmath.h> /* fabs and isfinite for whichever type rdpi_real_t is; compilers inline both */

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "rdpi tells NaN from numbers: compile it without -ffast-math and -ffinite-math-only"
#endif

#include "f32_bank.h"
#include "f32_check.h"
#include "f32_drive.h"
#include "f32_rate.h"
#include "f32_saturation.h"

/* A drive further outside the range than this many times its width is no drive: rdpi_f32_forward refuses it. */
#define MAX_SPANS 16

/* With x = 0 further than this from code 0, single precision can be more than a code wrong. */
#define MAX_CODE_0 (2 << RDPI_MAX_DAC_BITS)

uint32_t rdpi_f32_digest_layout(uint64_t layout, const rdpi_f32_params_t *params)
{
    return layout == RDPI_F32_LAYOUT ? rdpi_f32_checksum(params) : 0u;
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

/* Once: the next step finds out what comes after. */
static void end_quick(rdpi_f32_t *self)
{
    if (RDPI_QUICK_STEP) {
        self->quick = false;
    }
}

/* What has happened since the latest sample does not matter to the next. */
static void forget_samples(rdpi_f32_t *self)
{
    rdpi_f32_rate_reset(&self->rate_estimator);
    self->missed = 0;
    end_quick(self);
}

/* Takes note of what is output when it is no step that outputs it. */
static void put_drive(rdpi_f32_t *self, rdpi_real_t drive_V)
{
    self->drive_V = rdpi_f32_clamp(drive_V, self->params->min_V, self->params->max_V);
    self->ramp_V = self->drive_V;
    self->dac_code = rdpi_f32_code_of_x(self->params, self->bank.y_um[0]);
    self->sweep_turns = 0;
    end_quick(self);
}

/* Takes checked states, as they are: what rdpi_f32_get_memory gave comes back bit for bit. */
static void put_memory(rdpi_f32_t *self, const rdpi_real_t *y_um)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_f32_bank_set(&self->bank, params->play, params->plays, y_um);
    put_drive(self, rdpi_f32_drive_of_x(params, self->bank.y_um[0]));
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

/* The input is not usable: the sample passes with everything held. */
static RDPI_F32_SELDOM rdpi_real_t refuse_input(rdpi_f32_t *self)
{
    set_flag(self, RDPI_FLAG_INPUT, &self->input_count);
    if (self->missed < UINT8_MAX) {
        self->missed++;
    }
    end_quick(self);
    return self->drive_V;
}

/* The singularity guard. */
static rdpi_real_t limit_rate(rdpi_f32_t *self, rdpi_real_t rate_um_per_s)
{
    if (rate_um_per_s > self->params->max_um_per_s) {
        rate_um_per_s = self->params->max_um_per_s;
        set_flag(self, RDPI_FLAG_GUARD, &self->guard_count);
    }
    self->rate_um_per_s = rate_um_per_s;
    return rate_um_per_s;
}

/* How much per sample is so much per second. */
static RDPI_F32_SHARED rdpi_real_t per_sample(const rdpi_f32_t *self, rdpi_real_t per_s)
{
    return per_s / ((rdpi_real_t)self->rate_estimator.window * self->rate_estimator.per_window_s);
}

/* Range and slew: what may be output of the drive wished for. `quick` as `walk` has it. */
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

/* Outputs a drive inside the range, to a code if there are codes, and moves the plays there: to target.x_um, which
 * belongs to it, or where the code takes it. Returns the side where they are heading then. `quick` as `walk` has it. */
static RDPI_F32_SHARED rdpi_real_t output(rdpi_f32_t *self, rdpi_real_t drive_V, rdpi_f32_target_t target,
                                      const bool quick)
{
    const rdpi_f32_params_t *params = self->params;
    if (!quick) {
        self->ramp_V = drive_V;
    }
    if (quick || params->dac_bits > 0u) {
        self->dac_code = rdpi_f32_code_of_x(params, target.x_um);
        rdpi_real_t code = (rdpi_real_t)self->dac_code;
        drive_V = rdpi_f32_fma(code, params->V_per_code, params->min_V);
        target.x_um = rdpi_f32_fma(code, params->um_per_code, params->x_of_code_0_um);
    }
    self->drive_V = drive_V;
    return rdpi_f32_bank_move(&self->bank, params->play, params->plays, target);
}

/* Whether samples that follow one another may take the quick way. Without codes dac_code is 0. At an end of the range a
 * drive of someone else's can just have come back, and half a code the other way is beyond it. */
static bool next_is_quick(const rdpi_f32_t *self)
{
    const rdpi_f32_params_t *params = self->params;
    return self->rate_estimator.window == 1u && self->rate_estimator.keep <= 0 && params->slew_V_per_s <= 0 && self->dac_code > 0u &&
           (rdpi_real_t)self->dac_code < params->last_code && fabs(params->code_of_x_0) <= MAX_CODE_0;
}

/* How far x may go from a code without a play engaging or letting go and with the drive inside the range, whatever
 * they are rounded to: there the quick way leads where the other does, to the last bit. It ends half a code before, at a
 * code, so that rounding does not lead beyond; three quarters before where x is free both ways. That is more than any
 * rounding. `side` is where x is heading. */
static RDPI_F32_HOT void set_edge(rdpi_f32_t *self, rdpi_real_t side)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_f32_bank_t *bank = &self->bank;
    const rdpi_f32_play_t *next = &bank->last_engaged[1];
    rdpi_real_t *next_um = &bank->y_um[bank->engaged + 1u];
    bool last = bank->engaged + 1u == params->plays;
    rdpi_real_t half = params->last_code / 2, code_um = fabs(params->um_per_code);
    rdpi_real_t middle_um = rdpi_f32_fma(half, params->um_per_code, params->x_of_code_0_um), reach_um = half * code_um;
    if (bank->engaged > 0u) {
        rdpi_real_t end_um = rdpi_f32_fma(side, middle_um, reach_um);
        if (!last) {
            rdpi_real_t corner_um = rdpi_f32_fma(side, *next_um, next->r_um);
            end_um = corner_um < end_um ? corner_um : end_um;
        }
        end_um = rdpi_f32_fma((rdpi_real_t)-0.5, code_um, end_um);
        int32_t codes = (int32_t)(rdpi_f32_fma(side, end_um, -bank->y_um[0]) * params->codes_per_um);
        rdpi_real_t code = (rdpi_real_t)self->dac_code + (rdpi_real_t)codes;
        bank->edge_um = rdpi_f32_fma(code, params->um_per_code, params->x_of_code_0_um);
    } else {
        if (last) { /* one play alone is free in all of the range */
            *next_um = middle_um;
        } else {
            reach_um -= fabs(*next_um - middle_um);
            reach_um = reach_um < next->r_um ? reach_um : next->r_um;
        }
        bank->edge_um = rdpi_f32_fma((rdpi_real_t)-0.75, code_um, reach_um);
    }
}

/* Whether x, which turns back, is still rounded to the code that is output, not one at an end of the range, and before
 * the first corner on that way, 2 r_1 off. rdpi_f32_bank_walk and `output` come to the same. */
static inline bool turns_within_code(const rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s)
{
    const rdpi_f32_params_t *params = self->params;
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
    rdpi_real_t beyond = rdpi_f32_fma(x_um, params->codes_per_um, params->code_of_x_0) - code;
    return beyond >= 0 && beyond < 1 && code > 1 && code < params->last_code - 1;
}

/* The end of any step: x to where the bank's output has climbed by `climb_um`, put out. `quick` is what the compiler
 * knows of self->quick: true, or false if nothing. */
static RDPI_F32_HOT rdpi_real_t finish_step(rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s, const bool quick)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_f32_target_t target = rdpi_f32_bank_walk(&self->bank, params->play, params->plays, rate_um_per_s, climb_um);
    rdpi_real_t wish_V = rdpi_f32_drive_of_x(params, target.x_um);
    rdpi_real_t drive_V = limit_drive(self, wish_V, quick);
    if (drive_V != wish_V) {
        target.x_um = rdpi_f32_x_of_drive(params, drive_V);
    }
    rdpi_real_t side = output(self, drive_V, target, quick);
    if (RDPI_QUICK_STEP && !quick) {
        self->quick = next_is_quick(self);
    }
    if (RDPI_QUICK_STEP && (quick || self->quick)) {
        set_edge(self, side);
    }
    return self->drive_V;
}

/* The end of a step that could have taken the quick way. */
static RDPI_F32_SELDOM rdpi_real_t finish_quick_step(rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s)
{
    return finish_step(self, climb_um, rate_um_per_s, true);
}

/* The same for a reference from which x may hardly turn back. */
static RDPI_F32_SELDOM rdpi_real_t step_over_edge(rdpi_f32_t *self, rdpi_real_t climb_um, rdpi_real_t rate_um_per_s)
{
    return turns_within_code(self, climb_um, rate_um_per_s) ? self->drive_V : finish_quick_step(self, climb_um, rate_um_per_s);
}

/* A step of any kind, and what opens the quick way to the next. */
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
    /* From the reference, which is exact, and not from z, which is rounded: the offset cancels. */
    rdpi_real_t rate_um_per_s = limit_rate(self, rdpi_f32_rate_step(&self->rate_estimator, reference_um, self->missed));
    self->missed = 0;
    const rdpi_f32_piece_t *piece = rdpi_f32_piece_find(params->inverse_saturation, params->deadzones, reference_um);
    if (RDPI_QUICK_STEP) {
        self->latest_piece = piece;
    }
    rdpi_real_t v_um = rdpi_f32_piece_at(piece, reference_um - params->offset_um);
    return finish_step(self, rdpi_f32_bank_climb(&self->bank, rate_um_per_s, v_um), rate_um_per_s, false);
}

/* The step of a sample that could take the quick way, were the rate not above the guard or S^-1 on another piece. */
static RDPI_F32_SELDOM rdpi_real_t step_over_guard_or_piece(rdpi_f32_t *self, rdpi_real_t reference_um, rdpi_real_t rate_um_per_s)
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
    return finish_quick_step(self, rdpi_f32_bank_climb(&self->bank, rate_um_per_s, v_um), rate_um_per_s);
}

/* Any step, in a fraction of the instructions while no play engages or lets go, S^-1 does not bend and no limit is met,
 * which is nearly always; to the last bit what step_without_quick comes to. Comparisons are such that NaN fails; nothing is
 * stored before the reference is known to be usable. */
rdpi_real_t rdpi_f32_step(rdpi_f32_t *self, rdpi_real_t reference_um)
{
    const rdpi_f32_params_t *params = self->params;
    if (!RDPI_QUICK_STEP || !self->quick) {
        return step_without_quick(self, reference_um);
    }
    const rdpi_f32_piece_t *piece = self->latest_piece;
    rdpi_f32_bank_t *bank = &self->bank;
    rdpi_real_t rate_um_per_s = rdpi_f32_rate_direct(&self->rate_estimator, reference_um);
    if (!(rate_um_per_s <= params->max_um_per_s)) {
        return step_over_guard_or_piece(self, reference_um, rate_um_per_s);
    }
    if (!rdpi_f32_piece_holds(piece, reference_um)) {
        return step_over_guard_or_piece(self, reference_um, rate_um_per_s);
    }
    rdpi_real_t v_um = rdpi_f32_piece_at(piece, reference_um - params->offset_um);
    rdpi_real_t climb_um = rdpi_f32_bank_climb(bank, rate_um_per_s, v_um);
    rdpi_real_t way_um = rdpi_f32_bank_way(bank, rate_um_per_s, climb_um);
    rdpi_real_t x_um = way_um + bank->y_um[0];
    rdpi_real_t room = bank->engaged == 0u ? bank->edge_um - fabs(x_um - bank->y_um[1])
                                           : way_um * (bank->edge_um - x_um);
    self->flags = 0;
    self->rate_estimator.z_um[0] = reference_um;
    self->rate_um_per_s = rate_um_per_s;
    if (!(room > 0)) {
        return step_over_edge(self, climb_um, rate_um_per_s);
    }
    self->dac_code = (uint32_t)rdpi_f32_fma(x_um, params->codes_per_um, params->code_of_x_0);
    rdpi_real_t code = (rdpi_real_t)self->dac_code;
    bank->y_um[0] = rdpi_f32_fma(code, params->um_per_code, params->x_of_code_0_um);
    self->drive_V = rdpi_f32_fma(code, params->V_per_code, params->min_V);
    return self->drive_V;
}

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
    /* 2 C + 1: all the way to max_V; 2 C: all the way to min_V; ... 3, 2: a C-th part of that; 1: to the end */
    unsigned cycles_left = self->sweep_turns / 2u;
    rdpi_real_t left = (rdpi_real_t)cycles_left / (rdpi_real_t)params->sweep_cycles;
    rdpi_real_t limit_V = self->sweep_turns % 2u != 0u ? params->max_V : params->min_V;
    rdpi_real_t turn_V = rdpi_f32_clamp(rdpi_f32_fma(left, limit_V - params->sweep_end_V, params->sweep_end_V), params->min_V,
                               params->max_V);
    rdpi_real_t sweep_step_V = per_sample(self, params->sweep_V_per_s);
    rdpi_real_t drive_V = rdpi_f32_clamp(turn_V, self->ramp_V - sweep_step_V, self->ramp_V + sweep_step_V);

    self->flags = 0;
    self->rate_um_per_s = 0;
    forget_samples(self);
    if (drive_V == turn_V) {
        self->sweep_turns--;
    }
    rdpi_f32_target_t target = rdpi_f32_bank_target(rdpi_f32_x_of_drive(params, drive_V));
    (void)output(self, drive_V, target, false);
    return self->sweep_turns > 0u;
}

rdpi_real_t rdpi_f32_predict(const rdpi_f32_t *self, rdpi_real_t drive_V, rdpi_real_t rate_um_per_s)
{
    const rdpi_f32_params_t *params = self->params;
    if (!(rate_um_per_s >= 0)) {
        return (rdpi_real_t)NAN;
    }
    rdpi_real_t rate = rate_um_per_s < params->max_um_per_s ? rate_um_per_s : params->max_um_per_s;
    rdpi_real_t v_um = rdpi_f32_bank_at(&self->bank, params->play, params->plays, rate, rdpi_f32_x_of_drive(params, drive_V));
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
    rdpi_f32_target_t target = rdpi_f32_bank_target(rdpi_f32_x_of_drive(params, drive_V));
    (void)limit_rate(self, rate_um_per_s);
    forget_samples(self);
    (void)rdpi_f32_bank_move(&self->bank, params->play, params->plays, target);
    put_drive(self, drive_V);
    return displacement_um;
}
