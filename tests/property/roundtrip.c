/* Property test: whatever the parameters, profiles, rates and limits, the drive that rdpi_f32_step outputs, put into
 * the model it inverts, gives back the reference.
 *
 * The model it is put into is written here once more from the definitions (eq. 1, 7, 8, 9 and 16 of Ang et al., IROS
 * 2003), in long double, and shares nothing with the library. The published formula inverse runs beside it. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "formula_inverse.h"
#include "rdpi/deadzone.h"
#include "rdpi/rdpi.h"

#define CASES 5000
#define STEPS 500
#define TOLERANCE (sizeof(rdpi_real_t) == sizeof(float) ? 1e-5 : 1e-12) /* of the stroke */

/* ---- random numbers: xorshift64*, the same on every machine ---- */

static uint64_t random_state = 20031027;

static double uniform(double low, double high)
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return low + (high - low) * (double)((random_state * 2685821657736338717u) >> 11) / 9007199254740992.0;
}

static double log_uniform(double low, double high)
{
    return exp(uniform(log(low), log(high)));
}

static int choose(int count)
{
    return (int)uniform(0, count);
}

/* ---- the model by definition ---- */

typedef struct {
    const rdpi_f32_params_t *params;
    long double y[RDPI_MAX_PLAYS];
} plant_t;

static void plant_move(plant_t *plant, long double x)
{
    for (size_t i = 0; i < plant->params->plays; i++) {
        long double r = plant->params->thresholds_um[i];
        plant->y[i] = fmaxl(x - r, fminl(x + r, plant->y[i]));
    }
}

static long double plant_x(const plant_t *plant, rdpi_real_t drive_V)
{
    return (long double)plant->params->gain_um_per_V * ((long double)drive_V - plant->params->offset_V);
}

/* z of the states as they are, at a rate */
static long double plant_z(const plant_t *plant, rdpi_real_t rate_um_per_s)
{
    const rdpi_f32_params_t *params = plant->params;
    long double v = 0, z = 0, slope_before = 0;
    for (size_t i = 0; i < params->plays; i++) {
        long double slope = params->slopes[i] + (long double)params->slope_rate_s_per_um[i] * rate_um_per_s;
        v += (slope - slope_before) * plant->y[i];
        slope_before = slope;
    }
    for (size_t j = 0; j < params->deadzones; j++) {
        z += params->deadzone_weights[j] * (j == 0 ? v : fmaxl(v - params->deadzones_um[j], 0));
    }
    return z;
}

/* The rate by the definition in rate.h, from the whole history. */
typedef struct {
    double z_um[STEPS], filtered, window_s, filter_s, sample_time_s;
    int seen;
} history_t;

static double history_rate(history_t *history, double z_um)
{
    int k = history->seen++, window = (int)floor(history->window_s / history->sample_time_s + 0.5);
    window = window < 1 ? 1 : window;
    history->z_um[k] = z_um;
    double before = history->z_um[k < window ? 0 : k - window];
    double raw = fabs(z_um - before) / (window * history->sample_time_s);
    double blend = history->filter_s > 0 ? 1 - exp(-history->sample_time_s / history->filter_s) : 1;
    return history->filtered += blend * (raw - history->filtered);
}

/* ---- a random actuator ---- */

typedef enum { CONSTANT, MILD, STRONG, LAWS } law_t;

typedef struct {
    law_t law;
    double stroke_um, sample_time_s;
    rdpi_real_t thresholds_um[RDPI_MAX_PLAYS], slopes[RDPI_MAX_PLAYS], slope_rate[RDPI_MAX_PLAYS];
    rdpi_real_t deadzones_um[RDPI_MAX_DEADZONES], weights[RDPI_MAX_DEADZONES], memory_um[RDPI_MAX_PLAYS];
    rdpi_f32_params_t params;
} actuator_t;

static void ascend(rdpi_real_t *values, int count, double end)
{
    double sum = 0;
    for (int i = 0; i < count; i++) {
        sum += i == 0 ? 0 : uniform(0.2, 1.8) * end / count;
        values[i] = (rdpi_real_t)sum;
    }
}

/* One random draw per statement: C leaves the order within an expression open. */
static void random_actuator(actuator_t *self, law_t law)
{
    int plays = 1 + choose(RDPI_MAX_PLAYS), deadzones = 1 + choose(RDPI_MAX_DEADZONES);
    double stroke_um = 12.5 * log_uniform(0.1, 10), max_um_per_s = stroke_um * log_uniform(10, 1000);
    double gain_um_per_V = stroke_um / uniform(50, 150), offset_V = uniform(-50, 50), offset_um = uniform(-1, 1);
    double sample_time_s = log_uniform(1e-5, 1e-3), slope_before = 0;
    double window = choose(2) ? 0 : uniform(0, RDPI_MAX_WINDOW), filter = choose(2) ? 0 : log_uniform(0.1, 100);

    memset(self, 0, sizeof *self);
    self->law = law;
    self->stroke_um = stroke_um;
    self->sample_time_s = (double)(rdpi_real_t)sample_time_s;
    ascend(self->thresholds_um, plays, stroke_um * uniform(0.2, 0.6));
    for (int i = 0; i < plays; i++) {
        double kept = law == MILD ? uniform(0.8, 1.2) : uniform(0.21, 1); /* of the slope, at the guard */
        self->slopes[i] = (rdpi_real_t)log_uniform(0.2, 2);
        self->slope_rate[i] = (rdpi_real_t)(law == CONSTANT ? 0 : (double)self->slopes[i] * (kept - 1) / max_um_per_s);
    }
    ascend(self->deadzones_um, deadzones, stroke_um * uniform(0.1, 0.6));
    for (int j = 0; j < deadzones; j++) {
        double slope = log_uniform(0.4, 1.6);
        self->weights[j] = (rdpi_real_t)(slope - slope_before);
        slope_before = slope;
    }
    self->params = (rdpi_f32_params_t){
        .schema = RDPI_PARAMS_SCHEMA,
        .plays = (uint16_t)plays,
        .deadzones = (uint16_t)deadzones,
        .thresholds_um = self->thresholds_um,
        .slopes = self->slopes,
        .slope_rate_s_per_um = self->slope_rate,
        .deadzones_um = self->deadzones_um,
        .deadzone_weights = self->weights,
        .gain_um_per_V = (rdpi_real_t)(choose(2) ? gain_um_per_V : -gain_um_per_V),
        .offset_V = (rdpi_real_t)offset_V,
        .offset_um = (rdpi_real_t)(stroke_um * offset_um),
        .rate_window_s = (rdpi_real_t)(sample_time_s * window),
        .rate_filter_s = (rdpi_real_t)(sample_time_s * filter),
        .max_um_per_s = (rdpi_real_t)max_um_per_s,
        .min_slope_ratio = (rdpi_real_t)0.2,
        .min_V = -100000,
        .max_V = 100000,
    };
    if (choose(3) == 0) { /* a range that clips */
        self->params.min_V = (rdpi_real_t)(offset_V - uniform(10, 80));
        self->params.max_V = (rdpi_real_t)(offset_V + uniform(10, 80));
        self->params.dac_bits = (uint16_t)(choose(4) ? 0 : 8 + choose(9));
    }
    if (choose(4) == 0) {
        self->params.slew_V_per_s = (rdpi_real_t)(log_uniform(0.5, 50) / sample_time_s);
    }
    if (choose(2)) { /* memory: what some history inside the range has left */
        plant_t past = {&self->params, {0}};
        for (int k = 0; k < 6; k++) {
            plant_move(&past, plant_x(&past, (rdpi_real_t)(offset_V + uniform(-10, 10))));
        }
        for (int i = 0; i < plays; i++) {
            self->memory_um[i] = (rdpi_real_t)past.y[i];
        }
        self->params.memory_um = self->memory_um;
    }
}

/* ---- random profiles: pieces of 1 to 100 samples, each of one kind ---- */

typedef struct {
    double stroke_um, now_um; /* now_um within half a stroke of 0 */
    double centre_um, amplitude_um, step_um, omega, phase;
    int kind, left, until_turn;
} profile_t;

enum { HOLD, JUMPS, SINE, ZIGZAG, MINOR_LOOPS, KINDS };

static double profile_next(profile_t *self)
{
    double half_um = self->stroke_um / 2;
    if (self->left-- == 0) {
        self->kind = choose(KINDS);
        self->left = choose(100);
        self->until_turn = 0;
        self->step_um = self->stroke_um * log_uniform(1e-4, 0.1);
        self->amplitude_um = self->kind == MINOR_LOOPS ? self->stroke_um * log_uniform(1e-3, 0.1) : half_um;
        self->amplitude_um *= uniform(0.2, 1);
        self->centre_um = (half_um - self->amplitude_um) * uniform(-1, 1);
        self->omega = log_uniform(1e-3, 1);
        self->phase = uniform(0, 6);
    }
    switch (self->kind) {
    case JUMPS:
        if (choose(5) == 0) {
            self->now_um = half_um * uniform(-1, 1);
        }
        break;
    case ZIGZAG: /* a reversal every few samples */
        if (self->until_turn-- == 0) {
            self->until_turn = choose(6);
            self->step_um *= -uniform(0.7, 1.4);
        }
        self->now_um = fmax(-half_um, fmin(half_um, self->now_um + self->step_um));
        break;
    case SINE:
    case MINOR_LOOPS:
        self->phase += self->omega;
        self->now_um = self->centre_um + self->amplitude_um * sin(self->phase);
        break;
    default: /* HOLD */
        break;
    }
    return self->now_um;
}

/* ---- scores ---- */

typedef struct {
    double worst, sum_of_squares; /* of the stroke */
    unsigned long samples;
} score_t;

static void add(score_t *score, double error)
{
    score->worst = fabs(error) > score->worst ? fabs(error) : score->worst;
    score->sum_of_squares += error * error;
    score->samples++;
}

static double rms(const score_t *score)
{
    return sqrt(score->sum_of_squares / (double)score->samples);
}

static score_t roundtrip, states, rates, formula[LAWS];
static unsigned long steps, range_clips, slew_clips, rounded, guarded, held;

static void require(bool holds, const char *what, int number, int step)
{
    if (!holds) {
        printf("roundtrip: case %d, step %d: %s\n", number, step, what);
        exit(1);
    }
}

/* A flagged drive sits at its limit, and no drive exceeds one. Without DAC. */
static void check_limits(const rdpi_f32_params_t *params, double sample_time_s, double before_V, double drive_V,
                         bool range, bool slew, int number, int step)
{
    double moved_V = fabs(drive_V - before_V), slew_V = (double)params->slew_V_per_s * sample_time_s;
    double rounding_V = 1e-6 * (1 + fabs(drive_V) + fabs(before_V));
    if (slew) {
        require(fabs(moved_V - slew_V) <= rounding_V, "flagged for slew, not at its limit", number, step);
    } else if (range) {
        require(drive_V == (double)params->min_V || drive_V == (double)params->max_V, "flagged for range, inside it",
                number, step);
    }
    require(slew_V <= 0 || moved_V <= slew_V + rounding_V, "moved more than the slew allows", number, step);
}

/* The formula inverse's own chain, unlimited, at the library's rate. Returns its error in um. */
static double formula_error(formula_inverse_t *inverse, plant_t *plant, rdpi_real_t z_um, rdpi_real_t rate_um_per_s)
{
    const rdpi_f32_params_t *params = plant->params;
    rdpi_real_t slopes[RDPI_MAX_PLAYS];
    rdpi_f32_slopes_at(slopes, params->slopes, params->slope_rate_s_per_um, params->plays, rate_um_per_s);
    rdpi_real_t v_um = rdpi_f32_saturation_inverse(params->deadzones_um, params->deadzone_weights, params->deadzones,
                                                   z_um);
    plant_move(plant, formula_inverse_step(inverse, params->thresholds_um, slopes, params->plays, v_um));
    return (double)(plant_z(plant, rate_um_per_s) - z_um);
}

static void run_case(int number)
{
    actuator_t actuator;
    random_actuator(&actuator, (law_t)(number % LAWS));
    const rdpi_f32_params_t *params = &actuator.params;
    rdpi_f32_t axis;
    plant_t plant = {params, {0}}, formula_plant = {params, {0}};
    formula_inverse_t inverse = {{0}};
    static history_t history;
    profile_t profile = {.stroke_um = actuator.stroke_um};
    double stroke_um = actuator.stroke_um, sample_time_s = actuator.sample_time_s;

    require(rdpi_f32_init(&axis, params, (rdpi_real_t)sample_time_s) == RDPI_OK, "init refused", number, -1);
    memset(&history, 0, sizeof history);
    history.window_s = (double)params->rate_window_s;
    history.filter_s = (double)params->rate_filter_s;
    history.sample_time_s = sample_time_s;
    for (size_t i = 0; params->memory_um != NULL && i < params->plays; i++) {
        plant.y[i] = params->memory_um[i];
    }
    for (int k = 0; k < STEPS; k++) {
        rdpi_real_t reference_um = (rdpi_real_t)(profile_next(&profile) + (double)params->offset_um);
        rdpi_real_t drive_before_V = axis.drive_V, rate_before = axis.rate_um_per_s;
        if (choose(200) == 0) {
            reference_um = NAN;
        }

        rdpi_real_t drive_V = rdpi_f32_step(&axis, reference_um);
        steps++;

        bool range = axis.flags & RDPI_FLAG_RANGE, slew = axis.flags & RDPI_FLAG_SLEW;
        rdpi_real_t y_um[RDPI_MAX_PLAYS];
        rdpi_f32_get_memory(&axis, y_um);
        plant_move(&plant, plant_x(&plant, drive_V));
        for (size_t i = 0; i < params->plays; i++) {
            add(&states, (double)(y_um[i] - plant.y[i]) / stroke_um);
        }
        if (axis.flags & RDPI_FLAG_INPUT) {
            held++;
            require(!(reference_um == reference_um), "a number was refused", number, k);
            require(drive_V == drive_before_V && axis.rate_um_per_s == rate_before, "not held", number, k);
            continue;
        }
        rdpi_real_t z_um = reference_um - params->offset_um;
        double rate_um_per_s = fmin(history_rate(&history, (double)z_um), (double)params->max_um_per_s);
        double error_um = (double)(plant_z(&plant, axis.rate_um_per_s) - z_um);
        /* a wrong rate, as the displacement missed in one sample */
        add(&rates, ((double)axis.rate_um_per_s - rate_um_per_s) * sample_time_s / stroke_um);
        guarded += (axis.flags & RDPI_FLAG_GUARD) != 0;
        range_clips += range;
        slew_clips += slew;
        rounded += params->dac_bits > 0;
        require(drive_V >= params->min_V && drive_V <= params->max_V, "drive outside its range", number, k);
        if (params->dac_bits > 0) {
            double share = axis.dac_code / (ldexp(1, params->dac_bits) - 1);
            double code_V = params->min_V + share * ((double)params->max_V - params->min_V);
            require(fabs(drive_V - code_V) <= 1e-4, "drive and DAC code differ", number, k);
        } else {
            check_limits(params, sample_time_s, drive_before_V, drive_V, range, slew, number, k);
            if (range || slew) { /* short of what was asked for, not beyond it */
                bool up = drive_V == params->max_V || (drive_V != params->min_V && drive_V > drive_before_V);
                bool short_of = up == (params->gain_um_per_V > 0) ? error_um <= TOLERANCE * stroke_um
                                                                  : error_um >= -TOLERANCE * stroke_um;
                require(short_of, "clipped although the limit was not met", number, k);
            } else {
                add(&roundtrip, error_um / stroke_um);
            }
        }
        if (params->memory_um == NULL) {
            add(&formula[actuator.law],
                formula_error(&inverse, &formula_plant, z_um, axis.rate_um_per_s) / stroke_um);
        }
    }
}

/* ---- the two inverses side by side on the paper's profiles ---- */

#define PI 3.14159265358979323846

static double sine(double t)
{
    return 6.25 * sin(2 * PI * 10 * t);
}

/* 5, 20 and 35 Hz with amplitudes that swell and fade; 12.5 um peak to peak */
static double three_sines(double t)
{
    double swell = 0.75 + 0.25 * sin(2 * PI * t);
    return swell * (3.2 * sin(2 * PI * 5 * t) + 2.05 * sin(2 * PI * 20 * t) + 1.45 * sin(2 * PI * 35 * t));
}

/* Ten plays over 12.5 um at 10 kHz; W_0 would reach 0 at `singular_um_per_s`, the others later. */
static void compare(const char *law, double singular_um_per_s, const char *name, double (*reference)(double))
{
    actuator_t actuator = {.stroke_um = 12.5};
    for (int i = 0; i < 10; i++) {
        actuator.thresholds_um[i] = (rdpi_real_t)(6.25 * i / 9);
        actuator.slopes[i] = (rdpi_real_t)(0.6 + 0.06 * i);
        actuator.slope_rate[i] = (rdpi_real_t)(-0.6 * (1 - i / 18.0) / singular_um_per_s);
    }
    actuator.weights[0] = 1;
    actuator.params = (rdpi_f32_params_t){
        .schema = RDPI_PARAMS_SCHEMA,
        .plays = 10,
        .deadzones = 1,
        .thresholds_um = actuator.thresholds_um,
        .slopes = actuator.slopes,
        .slope_rate_s_per_um = actuator.slope_rate,
        .deadzones_um = actuator.deadzones_um,
        .deadzone_weights = actuator.weights,
        .gain_um_per_V = (rdpi_real_t)0.125,
        .max_um_per_s = (rdpi_real_t)(0.8 * singular_um_per_s),
        .min_slope_ratio = (rdpi_real_t)0.2,
        .min_V = -1000,
        .max_V = 1000,
    };
    rdpi_f32_t axis;
    plant_t plant = {&actuator.params, {0}}, formula_plant = {&actuator.params, {0}};
    formula_inverse_t inverse = {{0}};
    score_t exact = {0}, published = {0};
    double low_um = 0, high_um = 0, fastest_um_per_s = 0;

    require(rdpi_f32_init(&axis, &actuator.params, (rdpi_real_t)1e-4) == RDPI_OK, "init refused", -1, -1);
    for (int k = 0; k < 10000; k++) {
        rdpi_real_t z_um = (rdpi_real_t)reference(1e-4 * k);
        plant_move(&plant, plant_x(&plant, rdpi_f32_step(&axis, z_um)));
        low_um = fmin(low_um, (double)z_um);
        high_um = fmax(high_um, (double)z_um);
        fastest_um_per_s = fmax(fastest_um_per_s, (double)axis.rate_um_per_s);
        add(&exact, (double)(plant_z(&plant, axis.rate_um_per_s) - z_um));
        add(&published, formula_error(&inverse, &formula_plant, z_um, axis.rate_um_per_s));
    }
    double percent = 100 / (high_um - low_um);
    printf("%-6s  %-12s  %6.2f  %8.0f  %9.1e  %9.1e  %9.3f  %9.3f\n", law, name, high_um - low_um, fastest_um_per_s,
           percent * rms(&exact), percent * exact.worst, percent * rms(&published), percent * published.worst);
    require(exact.worst <= TOLERANCE * (high_um - low_um), "the exact inverse is not exact", -1, -1);
}

int main(void)
{
    for (int number = 0; number < CASES; number++) {
        run_case(number);
    }
    printf("%lu random steps, %d actuators; %lu clipped by range, %lu by slew, %lu with a DAC, %lu at the guard, "
           "%lu held\n", steps, CASES, range_clips, slew_clips, rounded, guarded, held);
    printf("worst error, share of the stroke (limit %.0e): round trip %.1e over %lu steps, plays %.1e, rate %.1e\n",
           TOLERANCE, roundtrip.worst, roundtrip.samples, states.worst, rates.worst);
    const char *laws[LAWS] = {"none", "mild", "strong"};
    for (int law = 0; law < LAWS; law++) {
        printf("formula inverse, rate law %-6s: rms %9.2e, max %9.2e of the stroke over %lu steps\n", laws[law],
               rms(&formula[law]), formula[law].worst, formula[law].samples);
    }

    printf("\nTen plays, 10 kHz; error of displacement in %% of the stroke\n");
    printf("%-6s  %-12s  %6s  %8s  %9s  %9s  %9s  %9s\n", "law", "profile", "p-p um", "max um/s", "exact rms", "max",
           "form. rms", "max");
    compare("mild", 7250, "10 Hz", sine);
    compare("mild", 7250, "5-20-35 Hz", three_sines);
    compare("strong", 1450, "10 Hz", sine);
    compare("strong", 1450, "5-20-35 Hz", three_sines);

    require(roundtrip.samples >= 1000000, "too few steps were free of clipping", -1, -1);
    require(range_clips > 10000 && slew_clips > 10000 && guarded > 10000 && held > 1000, "a limit hardly met", -1, -1);
    require(roundtrip.worst <= TOLERANCE, "the round trip is not exact", -1, -1);
    require(states.worst <= TOLERANCE, "the library's plays are not where the drive has put them", -1, -1);
    require(rates.worst <= TOLERANCE, "the rate is not the one defined", -1, -1);
    require(formula[CONSTANT].worst <= TOLERANCE, "the formula inverse is not exact at constant slopes", -1, -1);
    return 0;
}
