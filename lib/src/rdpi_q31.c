#include "rdpi/q31.h"

#include "q31_bank.h"
#include "q31_check.h"
#include "q31_drive.h"
#include "q31_rate.h"
#include "q31_saturation.h"

/* Where S^-1 saturates: twice what a drive in range reaches. */
#define MAX_BANK_OUTPUT RDPI_Q31_ONE

typedef char right_shift_is_arithmetic[(-1 >> 1) == -1 ? 1 : -1];

uint32_t rdpi_q31_digest_layout(uint64_t layout, const rdpi_q31_params_t *params)
{
    return layout == RDPI_Q31_LAYOUT ? rdpi_q31_checksum(params) : 0u;
}

/* Noise shaping: see rdpi_f32.c. */
static inline bool shapes_noise(const rdpi_q31_t *self)
{
    return RDPI_NOISE_SHAPING != 0 && self->params->noise_shaping != 0u;
}

rdpi_status_t rdpi_q31_init_layout(uint64_t layout, rdpi_q31_t *self, const rdpi_q31_params_t *params,
                                   uint32_t sample_time_ns)
{
    rdpi_status_t status = rdpi_q31_check_pointers(layout, self, params);
    if (status == RDPI_OK) {
        status = rdpi_q31_check_params(params);
    }
    if (status == RDPI_OK) {
        status = rdpi_q31_rate_init(&self->rate_estimator, params, sample_time_ns);
        if (status != RDPI_ERR_SAMPLE_TIME && rdpi_q31_out_of_time(params, sample_time_ns)) {
            status = RDPI_ERR_SAMPLE_RANGE; /* whatever follows from it */
        }
    }
    if (status == RDPI_OK) {
        self->params = params;
        self->slew = rdpi_q31_per_sample(params->slew_per_us, sample_time_ns);
        self->sweep_step = rdpi_q31_per_sample(params->sweep_per_us, sample_time_ns);
        self->direct_output = self->slew == 0 && rdpi_q31_pieces(params) == 1u && rdpi_q31_codes_are_coarse(params) &&
                              !shapes_noise(self);
        self->latest_piece.length = 0;
        rdpi_q31_reset(self);
        if (self->sweep_step < 1) { /* it would never arrive */
            status = RDPI_ERR_SWEEP;
        }
    }
    return status;
}

/* ---- memory ---- */

/* What the codes so far have missed is forgotten. */
static void forget_codes(rdpi_q31_t *self)
{
#if RDPI_NOISE_SHAPING
    self->carried = 0;
#else
    (void)self;
#endif
}

/* The next sample is the first: the rate history is forgotten. */
static void forget_samples(rdpi_q31_t *self)
{
    rdpi_q31_rate_reset(&self->rate_estimator);
    self->missed = 0;
}

/* Takes a drive that no step has output: that of the memory or of another source. Ends a sweep. */
static void put_drive(rdpi_q31_t *self, int32_t drive)
{
    const rdpi_q31_params_t *params = self->params;
    self->drive = rdpi_q31_in_range(params, drive);
    self->x = rdpi_q31_x_in_range(params, self->bank.y[0]);
    self->ramp = rdpi_q31_widen(self->drive);
    self->dac_code = params->dac_bits > 0u ? (uint32_t)rdpi_q31_code_of_drive(params, self->drive) : 0u;
    self->sweep_turns = 0;
    forget_codes(self);
}

void rdpi_q31_reset(rdpi_q31_t *self)
{
    rdpi_q31_bank_set(&self->bank, self->params, self->params->memory);
    put_drive(self, rdpi_q31_drive_of_x(self->params, self->bank.y[0]));
    forget_samples(self);
    self->rate = 0;
    self->flags = 0;
    self->guard_count = 0;
    self->clip_count = 0;
    self->input_count = 0;
    self->missed_count = 0;
}

rdpi_status_t rdpi_q31_set_memory(rdpi_q31_t *self, const int32_t *y)
{
    rdpi_status_t status = self == NULL || y == NULL ? RDPI_ERR_NULL : rdpi_q31_check_memory(self->params, y);
    if (status == RDPI_OK) {
        rdpi_q31_bank_set(&self->bank, self->params, y);
        put_drive(self, rdpi_q31_drive_of_x(self->params, y[0]));
    }
    return status;
}

void rdpi_q31_get_memory(const rdpi_q31_t *self, int32_t *y)
{
    for (size_t i = 0; i < self->params->plays; i++) {
        y[i] = rdpi_q31_bank_state(&self->bank, self->params, i);
    }
}

/* ---- the step ---- */

static void set_flag(rdpi_q31_t *self, uint32_t flag, uint32_t *count)
{
    self->flags |= flag;
    if (*count < UINT32_MAX) {
        (*count)++;
    }
}

static void add_missed(rdpi_q31_t *self, uint32_t ticks)
{
    uint32_t missed = self->missed + (ticks < UINT8_MAX ? ticks : UINT8_MAX);
    self->missed = (uint8_t)(missed < UINT8_MAX ? missed : UINT8_MAX);
    self->rate_estimator.direct = false;
}

/* The input is not usable. The drive is held, no state changes, and the sample counts as missed. */
static void refuse_input(rdpi_q31_t *self)
{
    set_flag(self, RDPI_FLAG_INPUT, &self->input_count);
    add_missed(self, 1);
}

/* The singularity guard. */
static int32_t limit_rate(rdpi_q31_t *self, int32_t rate)
{
    if (rate > RDPI_Q31_ONE) {
        rate = RDPI_Q31_ONE;
        set_flag(self, RDPI_FLAG_GUARD, &self->guard_count);
    }
    return rate;
}

/* The rate if the estimator is not `direct`. Also moves x to the end of the range if another source has left it
 * outside: every output passes that end. The plays are then moved from there, wherever the output was. */
static RDPI_Q31_SELDOM int32_t rate_not_direct(rdpi_q31_t *self, int32_t reference)
{
    const rdpi_q31_params_t *params = self->params;
    int32_t x = self->bank.y[0], inside = rdpi_q31_x_in_range(params, x);
    if (x != inside) {
        rdpi_q31_bank_move(&self->bank, params, x, inside);
    }
    if (self->direct_output) {
        self->drive = inside;
    } else {
        self->x = inside;
    }
    unsigned missed = self->missed;
    if (missed > 0u) {
        self->flags = RDPI_FLAG_MISSED;
    }
    self->missed = 0;
    return limit_rate(self, rdpi_q31_rate_step(&self->rate_estimator, reference, missed));
}

/* The rate of a sample, after the guard. */
static inline int32_t rate_of_sample(rdpi_q31_t *self, int32_t reference)
{
    if (!self->rate_estimator.direct) {
        return rate_not_direct(self, reference);
    }
    uint32_t distance = rdpi_q31_rate_direct_distance(&self->rate_estimator, reference);
    if (distance > rdpi_q31_rate_direct_limit(&self->rate_estimator)) {
        return limit_rate(self, INT32_MAX);
    }
    return rdpi_q31_rate_direct(&self->rate_estimator, distance);
}

/* S^-1, times 2^30, by a search. latest_piece is the one found. */
static RDPI_Q31_SELDOM int64_t v_beyond_piece(rdpi_q31_t *self, int32_t reference)
{
    const rdpi_q31_params_t *params = self->params;
    const rdpi_q31_deadzone_t *term = params->inverse_saturation;
    if (rdpi_q31_piece_find(&self->latest_piece, term, params->deadzones, params->inverse_shift, reference)) {
        return rdpi_q31_piece_at(&self->latest_piece, reference);
    }
    int32_t v = rdpi_q31_saturation(term, params->deadzones, params->inverse_shift, MAX_BANK_OUTPUT, reference);
    return (int64_t)v * RDPI_Q31_ONE;
}

#if RDPI_NOISE_SHAPING
/* How far codes are apart, in drive units, rounded down. */
static int32_t code_step(const rdpi_q31_params_t *params)
{
    int64_t step = params->drive_per_code < 0 ? -(int64_t)params->drive_per_code : params->drive_per_code;
    return (int32_t)(step >> params->drive_shift);
}

/* How far the drive is moved before it is rounded: see carry_um in rdpi_f32.c. Where the input curve is bent, the slope
 * is not that of the drive, and need not be. */
static RDPI_Q31_SELDOM int32_t carry(const rdpi_q31_t *self)
{
    int32_t half = code_step(self->params) / 2, slope = self->params->play[0].slope;
    int64_t carried = self->carried < 0 ? -self->carried : self->carried;
    int32_t way = carried < rdpi_q31_mul(slope, half) ? rdpi_q31_divide(carried, slope) : half;
    return self->carried < 0 ? -way : way;
}

/* See count_missed_um in rdpi_f32.c. Scaling and overflow: what is carried stays within 2^61, and what one step misses
 * within 2^62. */
static RDPI_Q31_SELDOM void count_missed(rdpi_q31_t *self, int64_t v)
{
    const rdpi_q31_params_t *params = self->params;
    int64_t most = 2 * rdpi_q31_mul(code_step(params), params->play[params->plays - 1u].slope);
    int64_t carried = self->carried + rdpi_q31_bank_climb(&self->bank, self->rate, v);
    carried = carried > most ? most : (carried < -most ? -most : carried);
    self->carried = (self->flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0u ? 0 : carried;
}
#endif

/* Outputs the ramp, rounded to a code if there are codes, and moves the plays there. `from` is that of
 * rdpi_q31_bank_move. */
static void output(rdpi_q31_t *self, int32_t from)
{
    const rdpi_q31_params_t *params = self->params;
    self->drive = rdpi_q31_in_range(params, (int32_t)(self->ramp >> 32));
    if (params->dac_bits > 0u) {
#if RDPI_NOISE_SHAPING
        if (shapes_noise(self)) {
            self->drive = rdpi_q31_in_range(params, self->drive + carry(self));
        }
#endif
        int64_t code = rdpi_q31_code_of_drive(params, self->drive);
        self->dac_code = (uint32_t)code;
        /* clamped, because the last code may round past the end of the range */
        self->drive = rdpi_q31_clamp(rdpi_q31_drive_of_code(params, code), params->min_drive, params->max_drive);
    }
    self->x = rdpi_q31_x_in_range(params, rdpi_q31_x_of_drive(params, self->drive));
    if (!rdpi_q31_bank_try_slide(&self->bank, self->x)) {
        rdpi_q31_bank_move(&self->bank, params, from, self->x);
    }
}

/* Outputs the drive of an x in range, as far as the slew limit allows. */
static RDPI_Q31_SELDOM void output_limited(rdpi_q31_t *self, int32_t x, int32_t reference)
{
    int64_t change = rdpi_q31_widen(rdpi_q31_drive_of_x(self->params, x)) - self->ramp;
    int64_t limited = change;
    if (self->slew > 0) {
        limited = change > self->slew ? self->slew : (change < -self->slew ? -self->slew : change);
    }
    if (limited != change) {
        if ((self->flags & RDPI_FLAG_RANGE) == 0u) {
            set_flag(self, RDPI_FLAG_SLEW, &self->clip_count);
        }
        self->flags |= RDPI_FLAG_SLEW;
    }
    if ((self->flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0u) {
        forget_codes(self);
    }
    self->ramp += limited;
    output(self, self->x);
#if RDPI_NOISE_SHAPING
    if (shapes_noise(self)) {
        count_missed(self, v_beyond_piece(self, reference)); /* kept no longer, for the fast way */
    }
#else
    (void)reference;
#endif
}

/* Outputs the code nearest to an x in range, which is the drive: what `output` does, if `direct_output` holds. */
static inline void output_direct(rdpi_q31_t *self, int32_t drive)
{
    const rdpi_q31_params_t *params = self->params;
    int32_t high = (int32_t)(rdpi_q31_mul(drive - params->drive_of_code_0, params->codes_per_drive) >> 32);
    int32_t code = ((high >> (params->code_shift - 33u)) + 1) >> 1;
    int64_t way = rdpi_q31_mul(code << (31u - params->drive_shift), params->drive_per_code);
    int32_t rounded = params->drive_of_code_0 + (int32_t)((way + RDPI_Q31_ONE) >> 31);

    self->ramp = rdpi_q31_widen(drive);
    self->dac_code = (uint32_t)code;
    if (!rdpi_q31_bank_try_slide(&self->bank, rounded)) {
        /* clamped, because the last code may round past the end of the range */
        rounded = rdpi_q31_in_range(params, rounded);
        rdpi_q31_bank_move(&self->bank, params, self->drive, rounded);
    }
    self->drive = rounded;
}

int32_t rdpi_q31_step(rdpi_q31_t *self, int32_t reference)
{
    int64_t v;
    bool beyond = false;
    self->flags = 0;
    if (rdpi_q31_piece_holds(&self->latest_piece, reference)) {
        v = rdpi_q31_piece_at(&self->latest_piece, reference);
    } else if (reference != RDPI_Q31_NO_REFERENCE) { /* no piece holds that one */
        v = v_beyond_piece(self, reference);
    } else {
        refuse_input(self);
        return self->drive;
    }
    self->rate = rate_of_sample(self, reference);
    int32_t x = rdpi_q31_bank_solve(&self->bank, self->params, rdpi_q31_fresh(self->rate), v, &beyond);
    if (beyond) {
        set_flag(self, RDPI_FLAG_RANGE, &self->clip_count);
    }
    if (self->direct_output) {
        output_direct(self, x);
    } else {
        output_limited(self, x, reference);
    }
    return self->drive;
}

void rdpi_q31_missed(rdpi_q31_t *self, uint32_t ticks)
{
    if (ticks > 0u) {
        add_missed(self, ticks);
    }
    self->missed_count += ticks < UINT32_MAX - self->missed_count ? ticks : UINT32_MAX - self->missed_count;
}

bool rdpi_q31_sweep(rdpi_q31_t *self)
{
    const rdpi_q31_params_t *params = self->params;

    if (self->sweep_turns == 0u) {
        self->sweep_turns = (uint16_t)(2u * params->sweep_cycles + 1u);
    }
    if (self->rate_estimator.oldest < self->rate_estimator.window && self->slew == 0) {
        self->ramp = rdpi_q31_widen(self->drive); /* there have been steps: the sweep begins at what they have output */
    }
    /* 2 C + 1: all the way to max_V; 2 C: all the way to min_V; ... 3, 2: a C-th part of that; 1: to sweep_end */
    int32_t limit = self->sweep_turns % 2u != 0u ? rdpi_q31_drive_of_last_code(params) : params->drive_of_code_0;
    int64_t swing = rdpi_q31_widen(limit) - rdpi_q31_widen(params->sweep_end);
    int64_t turn = rdpi_q31_widen(params->sweep_end) + swing / params->sweep_cycles * (self->sweep_turns / 2u);
    int64_t change = turn - self->ramp;

    self->flags = 0;
    self->rate = 0;
    forget_samples(self);
    forget_codes(self);
    if (change > self->sweep_step) {
        self->ramp += self->sweep_step;
    } else if (change < -self->sweep_step) {
        self->ramp -= self->sweep_step;
    } else {
        self->ramp = turn;
        self->sweep_turns--;
    }
    output(self, self->bank.y[0]);
    return self->sweep_turns > 0u;
}

/* Rounding a share of a distance down leads no state beyond where it was, and no two neighbours further apart. */
void rdpi_q31_forget_sweep(rdpi_q31_t *self)
{
    const rdpi_q31_params_t *params = self->params;
    rdpi_q31_bank_t *bank = &self->bank;
    int32_t forgotten = params->sweep_forgotten, x = bank->y[0];
    if (forgotten < 0) {
        forgotten = 0;
    }
    if (forgotten > RDPI_Q31_ONE) {
        forgotten = RDPI_Q31_ONE;
    }
    for (size_t i = 1; i < params->plays; i++) {
        int32_t way = rdpi_q31_bank_state(bank, params, i) - x;
        bank->y[i] = x + (int32_t)(rdpi_q31_mul(RDPI_Q31_ONE - forgotten, way) >> 30);
    }
    rdpi_q31_bank_set(bank, params, bank->y);
}

int32_t rdpi_q31_predict(const rdpi_q31_t *self, int32_t drive, int32_t rate)
{
    const rdpi_q31_params_t *params = self->params;
    if (rate < 0 || !rdpi_q31_in_format(drive)) {
        return RDPI_Q31_NO_REFERENCE;
    }
    int32_t guarded = rate < RDPI_Q31_ONE ? rate : RDPI_Q31_ONE;
    int32_t v = rdpi_q31_bank_at(&self->bank, params, guarded, rdpi_q31_x_of_drive(params, drive));
    return rdpi_q31_saturation(params->saturation, params->deadzones, params->saturation_shift, INT32_MAX, v);
}

int32_t rdpi_q31_forward(rdpi_q31_t *self, int32_t drive, int32_t rate)
{
    int32_t displacement = rdpi_q31_predict(self, drive, rate);

    self->flags = 0;
    if (displacement == RDPI_Q31_NO_REFERENCE) {
        refuse_input(self);
        return rdpi_q31_predict(self, self->drive, self->rate);
    }
    self->rate = limit_rate(self, rate);
    forget_samples(self);
    rdpi_q31_bank_move(&self->bank, self->params, self->bank.y[0], rdpi_q31_x_of_drive(self->params, drive));
    put_drive(self, drive);
    return displacement;
}
