/* Property test: the fixed-point library against exact arithmetic with the same parameters, in steps, predictions,
 * drives of someone else and missed samples.
 *
 * The reference is written from the definitions (eq. 1, 7, 8, 9, 13 and 16 of Ang et al., IROS 2003) in double and
 * shares nothing with the library; its plays follow the drives that are output, as an actuator would, and must then
 * stand exactly where the library has them. Also prints a checksum of every result, which must be the same for every
 * compiler, word size and processor.
 *
 *     fixed [SEED]      other actuators, other samples, another checksum */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "checksum.h"
#include "rdpi/q31.h"

#define CASES 200
#ifndef STEPS /* fewer for emulators */
#define STEPS 5000
#endif
#define LIMIT (1.0 / (1 << 20)) /* of full scale: what q31.h promises */
#define FULL_SCALE ((double)RDPI_Q31_MAX_DRIVE)

/* ---- random numbers: integers only, or the compiler's floating point would have a say in the checksum ---- */

static uint64_t random_state = 20031027;

static uint32_t random_bits(void)
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return (uint32_t)((random_state * 2685821657736338717u) >> 32);
}

/* low .. high */
static int32_t uniform(int32_t low, int32_t high)
{
    return low + (int32_t)(((uint64_t)random_bits() * ((uint64_t)((int64_t)high - low) + 1u)) >> 32);
}

static int choose(int count)
{
    return uniform(0, count - 1);
}

static bool one_in(int count)
{
    return choose(count) == 0;
}

/* 2^low <= size < 2^high, every octave alike. */
static int32_t any_size(int low, int high)
{
    int32_t size = (int32_t)1 << uniform(low, high - 1);
    return size + uniform(0, size - 1);
}

static void require(bool holds, const char *what, int number, int step)
{
    if (!holds) {
        printf("fixed: case %d, step %d: %s\n", number, step, what);
        exit(1);
    }
}

/* ---- a random actuator ---- */

typedef struct {
    rdpi_q31_play_t play[RDPI_MAX_PLAYS];
    rdpi_q31_deadzone_t saturation[RDPI_MAX_DEADZONES], inverse_saturation[RDPI_MAX_DEADZONES];
    rdpi_q31_line_t curve[RDPI_MAX_CURVE_PIECES];
    int32_t memory[RDPI_MAX_PLAYS];
    rdpi_q31_params_t params;
    uint32_t sample_time_ns;
} actuator_t;

/* A slope from 2^-steepness to 1; the smallest and the largest allowed are not rare. */
static int32_t random_slope(int steepness)
{
    if (one_in(8)) {
        return one_in(2) ? RDPI_Q31_ONE : RDPI_Q31_ONE >> steepness;
    }
    return any_size(30 - steepness, 30);
}

static void random_plays(actuator_t *self, int32_t half_range)
{
    int count = 1 + choose(RDPI_MAX_PLAYS), steepness = 1 + choose(6);
    self->params.plays = (uint16_t)count;
    self->params.play = self->play;
    self->params.min_slope_ratio = 1;
    for (int i = 0; i < count; i++) {
        self->play[i].r = i == 0 ? 0 : self->play[i - 1].r + uniform(1, half_range / count);
        self->play[i].slope = random_slope(steepness);
        self->play[i].slope_rate = random_slope(steepness) - self->play[i].slope;
    }
}

/* Pieces with slopes from 1/2 to 2, and their inverse, whose numbers fit 31 bits of slope or do not. */
static void random_saturation(actuator_t *self, int32_t reach)
{
    int count = 1 + choose(RDPI_MAX_DEADZONES);
    int32_t one = 1 << 27, before = 0, inverse_before = 0;
    int steeper = one_in(3) ? 0 : 3 + choose(2);
    int64_t z = 0;
    self->params.deadzones = (uint8_t)count;
    self->params.saturation = self->saturation;
    self->params.inverse_saturation = self->inverse_saturation;
    self->params.saturation_shift = (uint8_t)(27 - steeper);
    self->params.inverse_shift = (uint8_t)(27 + steeper);
    for (int j = 0; j < count; j++) {
        int32_t slope = uniform(one / 2, one * 2), inverse = (int32_t)((int64_t)one * one / slope);
        if (j > 0) {
            int32_t length = uniform(2, (reach >> steeper) / count);
            self->saturation[j].d = self->saturation[j - 1].d + length;
            z += (int64_t)length * before;
            self->inverse_saturation[j].d = (int32_t)(z / one) << steeper;
        }
        self->saturation[j].weight = slope - before;
        self->inverse_saturation[j].weight = inverse - inverse_before;
        before = slope;
        inverse_before = inverse;
    }
}

/* dividend / divisor = result / 2^shift, 31 bits, rounded to the nearest. */
static int32_t mantissa(int64_t dividend, int64_t divisor, uint8_t *shift)
{
    for (*shift = 1; (dividend << *shift) / divisor < (int64_t)1 << 30; (*shift)++) {
    }
    int64_t rounded = ((dividend << *shift) + divisor / 2) / divisor;
    return rounded < INT32_MAX ? (int32_t)rounded : INT32_MAX;
}

static void random_codes(rdpi_q31_params_t *params)
{
    int64_t span = (int64_t)params->max_drive - params->min_drive;
    int32_t sign = one_in(2) ? -1 : 1;
    params->dac_bits = (uint8_t)(1 + choose(RDPI_MAX_DAC_BITS));
    int64_t last = ((int64_t)1 << params->dac_bits) - 1;
    params->drive_of_code_0 = sign > 0 ? params->min_drive : params->max_drive;
    params->codes_per_drive = sign * mantissa(last, span, &params->code_shift);
    params->drive_per_code = sign * mantissa(span, last, &params->drive_shift);
}

/* In half of the cases bends the input curve: pieces of any length whose slopes are 1/4 to 4. */
static void random_curve(actuator_t *self)
{
    rdpi_q31_params_t *params = &self->params;
    int64_t span = (int64_t)params->max_drive - params->min_drive, x = 0;
    params->curve = self->curve;
    params->curve_pieces = (uint8_t)(RDPI_MAX_CURVE_PIECES == 1 || one_in(2) ? 1 : 2 + choose(RDPI_MAX_CURVE_PIECES - 1));
    params->min_x = params->min_drive;
    params->max_x = params->max_drive;
    for (int k = 0; params->curve_pieces > 1 && k < params->curve_pieces; k++) {
        rdpi_q31_line_t *line = &self->curve[k];
        int64_t from = span * k / params->curve_pieces, to = span * (k + 1) / params->curve_pieces;
        int64_t rise = (to - from) * uniform(512, 2048) / 2048;
        uint8_t shift;
        line->from_drive = (int32_t)(params->min_drive + from);
        line->from_x = (int32_t)(params->min_x + x);
        line->x_per_drive = mantissa(rise, to - from, &shift);
        line->x_shift = shift;
        line->drive_per_x = mantissa(to - from, rise, &shift);
        line->drive_shift = shift;
        x += rise;
        params->max_x = (int32_t)(params->min_x + x);
    }
}

static int32_t clamp(int32_t value, int32_t low, int32_t high)
{
    return value < low ? low : (value > high ? high : value);
}

/* States that a few random excursions leave. */
static void random_memory(actuator_t *self)
{
    self->params.memory = self->memory;
    for (int k = choose(6); k >= 0; k--) {
        int32_t x = uniform(self->params.min_x, self->params.max_x);
        for (int i = 0; i < self->params.plays; i++) {
            int32_t r = self->play[i].r;
            self->memory[i] = clamp(self->memory[i], x - r, x + r);
        }
    }
}

static void random_actuator(actuator_t *self)
{
    memset(self, 0, sizeof *self);
    rdpi_q31_params_t *params = &self->params;
    int32_t half_range = any_size(27, 29);
    params->schema = RDPI_PARAMS_SCHEMA;
    params->min_drive = -half_range + uniform(0, half_range / 2);
    params->max_drive = half_range;
    params->drive_of_code_0 = params->min_drive;
    if (one_in(3)) {
        random_codes(params);
    }
    random_curve(self);
    self->sample_time_ns = (uint32_t)any_size(13, 20);
    params->sweep_cycles = 20;
    params->sweep_end = uniform(params->min_drive, params->max_drive);
    params->sweep_per_us = ((uint64_t)any_size(18, 26) << 32) / self->sample_time_ns * 1000u;
    params->slew_per_us = one_in(3) ? params->sweep_per_us * (uint64_t)(1 + choose(30)) : 0;
    params->rate_window_ns = one_in(2) ? (uint32_t)uniform(0, RDPI_MAX_WINDOW) * self->sample_time_ns : 0;
    params->rate_filter_ns = one_in(2) ? (uint32_t)any_size(10, 27) : 0;
    params->guard_mantissa = random_bits() | (uint32_t)1 << 31;
    params->guard_exponent = (int16_t)uniform(-28, -18);
    random_plays(self, half_range);
    random_saturation(self, half_range);
    random_memory(self);
    params->digest = rdpi_q31_digest(params);
}

/* ---- the definitions, in double ---- */

#define MAX_HISTORY (STEPS * (RDPI_MAX_MISSED + 1))

typedef struct {
    const actuator_t *actuator;
    double y[RDPI_MAX_PLAYS], z[MAX_HISTORY], filtered, rate, ramp;
    int seen;
    unsigned long missed;
} exact_t;

static double on_curve(const actuator_t *actuator, double value, bool of_x)
{
    const rdpi_q31_params_t *params = &actuator->params;
    int last = params->curve_pieces - 1;
    if (last == 0) {
        return value;
    }
    for (int k = 0;; k++) {
        const rdpi_q31_line_t *line = &actuator->curve[k];
        double to_drive = k < last ? line[1].from_drive : params->max_drive;
        double to_x = k < last ? line[1].from_x : params->max_x;
        if (k == last || value < (of_x ? to_x : to_drive)) {
            double slope = (to_x - line->from_x) / (to_drive - line->from_drive);
            return of_x ? line->from_drive + (value - line->from_x) / slope
                        : line->from_x + (value - line->from_drive) * slope;
        }
    }
}

static double exact_drive(const actuator_t *actuator, double x)
{
    return on_curve(actuator, x, true);
}

static double exact_x(const actuator_t *actuator, double drive)
{
    return fmax(-FULL_SCALE, fmin(FULL_SCALE, on_curve(actuator, drive, false)));
}

static void exact_begin(exact_t *self, const actuator_t *actuator)
{
    self->actuator = actuator;
    self->filtered = self->rate = 0;
    self->seen = 0;
    self->missed = 0;
    self->ramp = exact_drive(actuator, actuator->memory[0]);
    for (int i = 0; i < actuator->params.plays; i++) {
        self->y[i] = actuator->memory[i];
    }
}

static double limited(double value, double low, double high)
{
    return fmax(low, fmin(high, value));
}

static double sum_terms(const rdpi_q31_deadzone_t *term, int count, int shift, double v)
{
    double sum = term[0].weight * v;
    for (int j = 1; j < count; j++) {
        sum += term[j].weight * fmax(v - term[j].d, 0);
    }
    return ldexp(sum, -shift);
}

static void exact_forget_samples(exact_t *self)
{
    self->filtered = 0;
    self->seen = 0;
    self->missed = 0;
}

/* Of the guard; the references missed lie on a straight line, in whole units rounded towards the one before. */
static double exact_rate(exact_t *self, double z)
{
    const rdpi_q31_params_t *params = &self->actuator->params;
    double time = self->actuator->sample_time_ns;
    int window = (int)floor(params->rate_window_ns / time + 0.5);
    window = window < 1 ? 1 : window;
    double blend = params->rate_filter_ns > 0 ? -expm1(-time / params->rate_filter_ns) : 1;
    if (self->seen == 0 || self->missed > RDPI_MAX_MISSED) {
        exact_forget_samples(self);
    }
    double last = self->seen > 0 ? self->z[self->seen - 1] : z;
    int steps = (int)self->missed + 1;
    for (int k = 1; k <= steps; k++) {
        double now = last + trunc((z - last) / (steps - k + 1));
        double before = self->seen == 0 ? now : self->z[self->seen < window ? 0 : self->seen - window];
        self->z[self->seen++] = now;
        self->filtered += blend * (fabs(now - before) / (window * time) - self->filtered);
        last = now;
    }
    self->missed = 0;
    return fmin(1, self->filtered / ldexp(params->guard_mantissa, params->guard_exponent));
}

static double exact_output(const exact_t *self, double rate, double x)
{
    double v = 0, before = 0;
    for (int i = 0; i < self->actuator->params.plays; i++) {
        const rdpi_q31_play_t *play = &self->actuator->play[i];
        double slope = ldexp(play->slope + play->slope_rate * rate, -30);
        v += (slope - before) * limited(self->y[i], x - play->r, x + play->r);
        before = slope;
    }
    return v;
}

/* The x at which the output is v, or one beyond the range: of the corners, which are all y_i - r_i and y_i + r_i, the
 * nearest below and above, and between them a straight line. */
static double exact_inverse(const exact_t *self, double rate, double v)
{
    const rdpi_q31_params_t *params = &self->actuator->params;
    double low = params->min_x - 1.0, high = params->max_x + 1.0;
    if (exact_output(self, rate, low) >= v) {
        return low;
    }
    if (exact_output(self, rate, high) <= v) {
        return high;
    }
    for (int i = 0; i < params->plays; i++) {
        for (int side = -1; side <= 1; side += 2) {
            double corner = self->y[i] + side * (double)self->actuator->play[i].r;
            if (corner > low && corner < high) {
                if (exact_output(self, rate, corner) < v) {
                    low = corner;
                } else {
                    high = corner;
                }
            }
        }
    }
    double below = exact_output(self, rate, low), above = exact_output(self, rate, high);
    return above > below ? low + (high - low) * (v - below) / (above - below) : low;
}

static void exact_move(exact_t *self, double x)
{
    for (int i = 0; i < self->actuator->params.plays; i++) {
        double r = self->actuator->play[i].r;
        self->y[i] = limited(self->y[i], x - r, x + r);
    }
}

/* The drive before it is rounded to a code; the plays have yet to follow. */
static double exact_step(exact_t *self, double z)
{
    const actuator_t *actuator = self->actuator;
    const rdpi_q31_params_t *params = &actuator->params;
    self->rate = exact_rate(self, z);
    double v = sum_terms(actuator->inverse_saturation, params->deadzones, params->inverse_shift, z);
    double drive = exact_drive(actuator, limited(exact_inverse(self, self->rate, v), params->min_x, params->max_x));
    if (params->slew_per_us > 0) {
        double slew = ldexp((double)params->slew_per_us, -32) * actuator->sample_time_ns / 1000;
        drive = limited(drive, self->ramp - slew, self->ramp + slew);
    }
    self->ramp = drive;
    return drive;
}

static double exact_predict(const exact_t *self, double drive, double rate)
{
    const rdpi_q31_params_t *params = &self->actuator->params;
    double v = exact_output(self, fmin(rate, 1), exact_x(self->actuator, drive));
    double z = sum_terms(self->actuator->saturation, params->deadzones, params->saturation_shift, v);
    return limited(z, -INT32_MAX, INT32_MAX);
}

static void exact_forward(exact_t *self, double drive, double rate)
{
    exact_move(self, exact_x(self->actuator, drive));
    exact_forget_samples(self);
    self->rate = fmin(rate, 1);
    self->ramp = limited(drive, self->actuator->params.min_drive, self->actuator->params.max_drive);
}

/* ---- random references ---- */

typedef struct {
    int32_t now, step, limit;
    int kind, left;
} profile_t;

static int32_t profile_next(profile_t *self)
{
    if (self->left-- <= 0) {
        self->kind = choose(4);
        self->left = 1 + choose(60);
        self->step = any_size(0, 26);
        self->step *= one_in(2) ? -1 : 1;
    }
    switch (self->kind) {
    case 0: /* jumps */
        if (one_in(6)) {
            self->now = uniform(-self->limit, self->limit);
        }
        break;
    case 1: /* a reversal every few samples */
        if (one_in(4)) {
            self->step = -self->step;
        }
        self->now += self->step;
        break;
    case 2: /* ramp */
        self->now += self->step;
        break;
    default: /* hold */
        break;
    }
    if (self->now > self->limit || self->now < -self->limit) {
        self->step = -self->step;
        self->now = self->now > 0 ? self->limit : -self->limit;
    }
    return self->now;
}

/* ---- both side by side ---- */

static actuator_t actuator;
static exact_t exact;
static rdpi_q31_t axis;
static int number, step; /* where we are */

static struct {
    double worst, sum_of_squares, worst_prediction; /* of full scale */
    unsigned long steps, ranged, slewed, guarded, coded, held, missed, predictions, taken_over, refused;
    uint32_t checksum;
} total;

static void sum_up(uint32_t number)
{
    total.checksum = checksum_number(total.checksum, number, sizeof number);
}

static void sum_up_axis(void)
{
    sum_up((uint32_t)axis.drive);
    sum_up((uint32_t)axis.rate);
    sum_up(axis.dac_code);
    sum_up(axis.flags);
}

static void compare_step(int32_t z)
{
    const rdpi_q31_params_t *params = &actuator.params;
    bool late = exact.missed > 0;
    int32_t drive = rdpi_q31_step(&axis, z);
    double ideal = exact_step(&exact, z);
    double error = fabs(ldexp((double)axis.ramp, -32) - ideal) / FULL_SCALE;

    require(drive >= params->min_drive && drive <= params->max_drive, "out of range", number, step);
    require(late == ((axis.flags & RDPI_FLAG_MISSED) != 0), "missed samples wrongly flagged", number, step);
    if (params->dac_bits > 0) {
        double last = ldexp(1, params->dac_bits) - 1;
        double code = ((double)params->max_drive - params->min_drive) / last;
        require(fabs(drive - ideal) <= 0.5 * code + LIMIT * FULL_SCALE, "not the nearest code", number, step);
        require(axis.dac_code <= last, "no such code", number, step);
        total.coded++;
    }
    exact_move(&exact, exact_x(&actuator, drive));
    total.worst = fmax(total.worst, error);
    total.sum_of_squares += error * error;
    total.steps++;
    total.ranged += (axis.flags & RDPI_FLAG_RANGE) != 0;
    total.slewed += (axis.flags & RDPI_FLAG_SLEW) != 0;
    total.guarded += (axis.flags & RDPI_FLAG_GUARD) != 0;
    sum_up_axis();
}

/* Against the reach of displacements, 2^30. */
static void compare_prediction(int32_t displacement, double ideal)
{
    total.worst_prediction = fmax(total.worst_prediction, fabs(displacement - ideal) / (2 * FULL_SCALE));
    total.predictions++;
    sum_up((uint32_t)displacement);
}

/* A drive near the range, and a rate up to twice the guard's; one in ten of each is of no use. */
static void random_drive(int32_t *drive, int32_t *rate)
{
    int32_t reach = RDPI_Q31_MAX_DRIVE;
    *drive = one_in(10) ? (one_in(2) ? uniform(reach + 1, INT32_MAX) : uniform(INT32_MIN, -reach - 1))
                        : uniform(-reach, reach);
    *rate = one_in(10) ? uniform(INT32_MIN, -1) : uniform(0, INT32_MAX);
}

static void compare_predict(void)
{
    int32_t drive, rate;
    random_drive(&drive, &rate);
    int32_t displacement = rdpi_q31_predict(&axis, drive, rate);
    if (rate < 0 || drive > RDPI_Q31_MAX_DRIVE || drive < -RDPI_Q31_MAX_DRIVE) {
        require(displacement == RDPI_Q31_NO_REFERENCE, "a prediction for no drive or no rate", number, step);
        total.refused++;
    } else {
        compare_prediction(displacement, exact_predict(&exact, drive, rate / (double)RDPI_Q31_ONE));
    }
}

static void compare_forward(void)
{
    int32_t drive, rate;
    random_drive(&drive, &rate);
    bool usable = rdpi_q31_predict(&axis, drive, rate) != RDPI_Q31_NO_REFERENCE;
    int32_t displacement = rdpi_q31_forward(&axis, drive, rate);
    if (usable) {
        compare_prediction(displacement, exact_predict(&exact, drive, rate / (double)RDPI_Q31_ONE));
        exact_forward(&exact, drive, rate / (double)RDPI_Q31_ONE);
        total.taken_over++;
    } else {
        require((axis.flags & RDPI_FLAG_INPUT) != 0, "a drive of no use is not flagged", number, step);
        compare_prediction(displacement, exact_predict(&exact, axis.drive, exact.rate));
        exact.missed++;
        total.refused++;
    }
    sum_up_axis();
}

static void compare_hold(void)
{
    int32_t before = axis.drive;
    require(rdpi_q31_step(&axis, RDPI_Q31_NO_REFERENCE) == before, "a held drive moved", number, step);
    exact.missed++;
    total.held++;
}

static void compare_missed(void)
{
    uint32_t ticks = (uint32_t)(one_in(4) ? any_size(0, 30) : choose(8));
    rdpi_q31_missed(&axis, ticks);
    exact.missed += ticks;
    total.missed += ticks > 0;
}

static void compare_memory(void)
{
    int32_t y[RDPI_MAX_PLAYS];
    double slack = actuator.params.curve_pieces > 1 ? 2 : 0; /* a bent curve is rounded to whole x */
    rdpi_q31_get_memory(&axis, y);
    for (int i = 0; i < actuator.params.plays; i++) {
        require(fabs(y[i] - exact.y[i]) <= slack, "a play is not where the drives have taken it", number, step);
    }
}

static void compare_actuator(void)
{
    random_actuator(&actuator);
    rdpi_status_t status = rdpi_q31_init(&axis, &actuator.params, actuator.sample_time_ns);
    require(status == RDPI_OK, rdpi_status_text(status), number, -1);
    exact_begin(&exact, &actuator);
    profile_t profile = {0, 0, any_size(22, 30), 0, 0};
    for (step = 0; step < STEPS; step++) {
        int32_t z = profile_next(&profile);
        switch (choose(400)) {
        case 0:
            compare_forward();
            break;
        case 1:
        case 2:
            compare_hold();
            break;
        case 3:
        case 4:
            compare_missed();
            break;
        case 5:
            compare_predict();
            compare_memory();
            break;
        default:
            break;
        }
        compare_step(z);
    }
    compare_memory();
}

int main(int argc, char **argv)
{
    if (argc > 1) {
        random_state += (uint64_t)strtoul(argv[1], NULL, 10) << 32;
    }
    for (number = 0; number < CASES; number++) {
        compare_actuator();
    }
    printf("%lu steps, %d actuators; %lu clipped by range, %lu by slew, %lu at the guard, %lu to a code, %lu held, %lu "
           "late, %lu predictions, %lu drives taken over, %lu of no use\n",
           total.steps, CASES, total.ranged, total.slewed, total.guarded, total.coded, total.held, total.missed,
           total.predictions, total.taken_over, total.refused);
    printf("checksum of all results: %08lx\n", (unsigned long)total.checksum);
    printf("q31 against double, of full scale: drives worst 2^%.2f, rms 2^%.2f; displacements worst 2^%.2f; limit "
           "2^%.0f\n",
           log2(total.worst), log2(sqrt(total.sum_of_squares / (double)total.steps)), log2(total.worst_prediction),
           log2(LIMIT));
    require(total.ranged > 1000 && total.slewed > 1000 && total.guarded > 1000 && total.coded > 1000 &&
                total.held > 1000 && total.missed > 1000 && total.predictions > 1000 && total.taken_over > 1000 &&
                total.refused > 100,
            "something hardly happened", -1, -1);
    require(total.worst <= LIMIT && total.worst_prediction <= LIMIT, "not accurate enough", -1, -1);
    return 0;
}
