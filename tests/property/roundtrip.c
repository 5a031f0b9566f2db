/* Property test: whatever the parameters, profiles, rates and limits, the drive that rdpi_f32_step outputs, put into
 * the model it inverts, gives back the reference.
 *
 * The model it is put into (plant_t) is written from the definitions in long double; nothing of it is the library's.
 * The published formula inverse runs beside it. */
#include <stdio.h>
#include <stdlib.h>

#include "f32_saturation.h"
#include "formula_inverse.h"
#include "rdpi/f32.h"
#include "scenario.h"

#define CASES 5000
#define STEPS 500
#define TOLERANCE (sizeof(rdpi_real_t) == sizeof(float) ? 1e-5 : 1e-12) /* of the stroke */

/* The rate by the definitions in f32_rate.h and f32.h, from the whole history. */
typedef struct {
    double z_um[STEPS * (RDPI_MAX_MISSED + 2)], filtered, window_s, filter_s, sample_time_s;
    int seen;
} history_t;

static void history_add(history_t *history, double z_um)
{
    int k = history->seen++, window = (int)floor(history->window_s / history->sample_time_s + 0.5);
    window = window < 1 ? 1 : window;
    history->z_um[k] = z_um;
    double before = history->z_um[k < window ? 0 : k - window];
    double raw = fabs(z_um - before) / (window * history->sample_time_s);
    double blend = history->filter_s > 0 ? 1 - exp(-history->sample_time_s / history->filter_s) : 1;
    history->filtered += blend * (raw - history->filtered);
}

/* Samples missed in between lay on a straight line; after too many, or before the first, nothing is known. */
static double history_rate(history_t *history, double z_um, unsigned missed)
{
    if (history->seen == 0 || missed > RDPI_MAX_MISSED) {
        history->seen = 0;
        history->filtered = 0;
        missed = 0;
    }
    double last_um = history->seen > 0 ? history->z_um[history->seen - 1] : z_um;
    for (unsigned k = 1; k <= missed + 1; k++) {
        history_add(history, last_um + (z_um - last_um) * k / (missed + 1));
    }
    return history->filtered;
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
static unsigned long steps, range_clips, slew_clips, rounded, guarded, held, gaps, restarts;

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
    rdpi_real_t reference_um = z_um + params->offset_um;
    const rdpi_f32_piece_t *piece = rdpi_f32_piece_find(params->inverse_saturation, params->deadzones, reference_um);
    rdpi_real_t v_um = rdpi_f32_piece_at(piece, z_um);
    plant_move(plant, formula_inverse_step(inverse, params->play, params->plays, rate_um_per_s, v_um));
    return (double)(plant_z(plant, rate_um_per_s) - z_um);
}

static void run_case(int number)
{
    scenario_t scenario;
    random_scenario(&scenario, (law_t)(number % LAWS));
    const rdpi_f32_params_t *params = &scenario.actuator.params;
    rdpi_f32_t axis;
    plant_t plant = {params, {0}}, formula_plant = {params, {0}};
    formula_inverse_t inverse = {{0}};
    static history_t history;
    profile_t profile = {.stroke_um = scenario.stroke_um};
    double stroke_um = scenario.stroke_um, sample_time_s = scenario.sample_time_s;

    require(rdpi_f32_init(&axis, params, (rdpi_real_t)sample_time_s) == RDPI_OK, "init refused", number, -1);
    history.seen = 0;
    history.filtered = 0;
    history.window_s = (double)params->rate_window_s;
    history.filter_s = (double)params->rate_filter_s;
    history.sample_time_s = sample_time_s;
    bool at_rest = true;
    for (size_t i = 0; i < params->plays; i++) {
        plant.y[i] = params->memory_um[i];
        at_rest = at_rest && plant.y[i] == 0;
    }
    unsigned missed = 0;
    for (int k = 0; k < STEPS; k++) {
        rdpi_real_t reference_um = (rdpi_real_t)(profile_next(&profile) + (double)params->offset_um);
        rdpi_real_t drive_before_V = axis.drive_V, rate_before = axis.rate_um_per_s;
        if (choose(200) == 0) {
            reference_um = NAN;
        }
        if (choose(200) == 0) {
            unsigned ticks = 1u + (unsigned)choose(RDPI_MAX_MISSED + 4);
            rdpi_f32_missed(&axis, ticks);
            missed += ticks;
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
            missed++;
            require(!(reference_um == reference_um), "a number was refused", number, k);
            require(drive_V == drive_before_V && axis.rate_um_per_s == rate_before, "not held", number, k);
            continue;
        }
        double z_um = (double)reference_um - (double)params->offset_um;
        double rate_um_per_s = fmin(history_rate(&history, z_um, missed), (double)params->max_um_per_s);
        require((missed > 0) == ((axis.flags & RDPI_FLAG_MISSED) != 0), "flag of missed samples", number, k);
        gaps += missed > 0;
        restarts += missed > RDPI_MAX_MISSED;
        missed = 0;
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
                bool short_of = up == (params->curve[0].gain_um_per_V > 0) ? error_um <= TOLERANCE * stroke_um
                                                                  : error_um >= -TOLERANCE * stroke_um;
                require(short_of, "clipped although the limit was not met", number, k);
            } else {
                add(&roundtrip, error_um / stroke_um);
            }
        }
        if (at_rest) {
            add(&formula[scenario.law],
                formula_error(&inverse, &formula_plant, (rdpi_real_t)z_um, axis.rate_um_per_s) / stroke_um);
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
    actuator_t actuator = {
        .saturation = {{0, 1}},
        .curve = {{.gain_um_per_V = (rdpi_real_t)0.125}},
        .params = {
            .plays = 10,
            .deadzones = 1,
            .sweep_cycles = 1,
            .max_um_per_s = (rdpi_real_t)(0.8 * singular_um_per_s),
            .min_slope_ratio = (rdpi_real_t)0.2,
            .min_V = -1000,
            .max_V = 1000,
            .sweep_V_per_s = 1000,
        },
    };
    for (int i = 0; i < 10; i++) {
        actuator.play[i].r_um = (rdpi_real_t)(6.25 * i / 9);
        actuator.play[i].slope = (rdpi_real_t)(0.6 + 0.06 * i);
        actuator.play[i].slope_rate_s_per_um = (rdpi_real_t)(-0.6 * (1 - i / 18.0) / singular_um_per_s);
    }
    actuator_derive(&actuator);
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
           "%lu held, %lu after a gap\n", steps, CASES, range_clips, slew_clips, rounded, guarded, held, gaps);
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
    require(range_clips > 10000 && slew_clips > 10000 && guarded > 10000 && held > 1000 && restarts > 1000,
            "a limit hardly met", -1, -1);
    require(roundtrip.worst <= TOLERANCE, "the round trip is not exact", -1, -1);
    require(states.worst <= TOLERANCE, "the library's plays are not where the drive has put them", -1, -1);
    require(rates.worst <= TOLERANCE, "the rate is not the one defined", -1, -1);
    require(formula[CONSTANT].worst <= TOLERANCE, "the formula inverse is not exact at constant slopes", -1, -1);
    return 0;
}
