/* Property test: the library's bank, which keeps two sums up to date, against the plain walk over every play, which
 * cannot drift; then the whole library against the same chain in long double. */
#include <float.h>
#include <stdio.h>
#include <stdlib.h>

#include "f32_bank.h"
#include "scenario.h"
#include "walk.h"

#define SINGLE (sizeof(rdpi_real_t) == sizeof(float))
#define EPSILON (SINGLE ? (double)FLT_EPSILON : DBL_EPSILON)

static void require(bool holds, const char *what)
{
    if (!holds) {
        printf("walk: %s\n", what);
        exit(1);
    }
}

static void worse(double *worst, long double error)
{
    double size = (double)fabsl(error);
    if (!(size <= *worst)) { /* NaN too */
        *worst = size;
    }
}

/* ---- the bank alone ---- */

#define SETS 100
#ifndef STEPS /* per set of parameters: RDPI_LONG makes it 1e7 in all */
#define STEPS 20000
#endif
#define LIMIT_X (80 * EPSILON) /* slopes down to 0.04 turn a rounding of v into 25 of x */
#define LIMIT_Y EPSILON        /* corners that coincide but for the rounding of two states and x */
#define DRIFT 2 /* the last tenth may be worse than the first by this factor: it has no other reason than chance */

/* Worst errors in the first and last tenth of each set's steps; the unit of length is half the stroke. */
static double first_x, last_x, first_y, last_y;
static unsigned long turns, elsewhere;

static void random_plays(rdpi_f32_play_t *play, size_t count)
{
    double r_um = 0;
    for (size_t i = 0; i < count; i++) {
        double slope = log_uniform(0.2, 2), kept = uniform(0.21, 1.2); /* of the slope, at rate 1 */
        play[i] = (rdpi_f32_play_t){(rdpi_real_t)r_um, (rdpi_real_t)slope, (rdpi_real_t)(slope * (kept - 1)), 0, 0};
        r_um += uniform(0.2, 1.8) * 0.5 / (double)count;
    }
    actuator_derive_intercepts(play, count);
}

/* What is output for the solution `x`, found from `before`: mostly that, else rounded, clipped or something else. */
static rdpi_real_t output(rdpi_real_t x, rdpi_real_t before)
{
    switch (choose(8)) {
    case 0:
    case 1: /* a DAC code */
        return (rdpi_real_t)(floor((double)x * 1024 + 0.5) / 1024);
    case 2: /* the range */
        return x > (rdpi_real_t)0.5 ? (rdpi_real_t)0.5 : (x < (rdpi_real_t)-0.5 ? (rdpi_real_t)-0.5 : x);
    case 3: /* the slew limit */
        return x > before ? fmin(x, before + (rdpi_real_t)0.01) : fmax(x, before - (rdpi_real_t)0.01);
    case 4:
        elsewhere++;
        return (rdpi_real_t)uniform(-1, 1);
    default:
        return x;
    }
}

static void compare_set(size_t count)
{
    rdpi_f32_play_t play[RDPI_MAX_PLAYS];
    rdpi_real_t rest[RDPI_MAX_PLAYS] = {0};
    rdpi_f32_bank_t bank;
    walk_t walk = {play, count, {0}};
    double x_um = 0, side = 1;

    random_plays(play, count);
    rdpi_f32_bank_set(&bank, play, count, rest);
    for (int k = 0; k < STEPS; k++) {
        rdpi_real_t rate = (rdpi_real_t)(choose(4) ? uniform(0, 1) : choose(2));
        if (choose(3) == 0) {
            side = -side;
            turns++;
        }
        x_um = fmax(-1, fmin(1, x_um + side * log_uniform(1e-6, 0.5)));
        walk_t ahead = walk; /* so that what is asked for can be reached within the stroke */
        walk_move(&ahead, x_um);

        rdpi_real_t before = bank.y_um[0], v = (rdpi_real_t)walk_sum(&ahead, rate);
        rdpi_f32_target_t target = rdpi_f32_bank_walk(&bank, play, count, rate, rdpi_f32_bank_climb(&bank, rate, v));
        long double x = walk_solve(&walk, rate, v);
        long double error_x = target.x_um - x;
        target.x_um = output(target.x_um, before);
        rdpi_f32_bank_move(&bank, play, count, target);
        walk_move(&walk, target.x_um);

        long double error_y = 0;
        for (size_t i = 0; i < count; i++) {
            long double error = fabsl(rdpi_f32_bank_state(&bank, play, i) - walk.y[i]);
            error_y = error > error_y ? error : error_y;
        }
        if (k < STEPS / 10) {
            worse(&first_x, error_x);
            worse(&first_y, error_y);
        } else if (k >= STEPS - STEPS / 10) {
            worse(&last_x, error_x);
            worse(&last_y, error_y);
        }
        require(fabsl(error_x) <= LIMIT_X, "the bank's solution is not that of the plain walk");
        require(error_y <= LIMIT_Y, "the bank's plays are not where those of the plain walk are");
        x_um = (double)bank.y_um[0];
    }
}

/* ---- the whole library ---- */

#define CASES 4000
#define SAMPLES 500
#define LIMIT_CHAIN (SINGLE ? 4e-6 : 1e-13) /* of the stroke */

/* The chain of f32.h in long double: nothing of it is the library's. */
typedef struct {
    const rdpi_f32_params_t *params;
    walk_t walk;
    long double z[SAMPLES], filtered, sample_time;
    int seen;
} chain_t;

static long double chain_rate(chain_t *self, long double z)
{
    const rdpi_f32_params_t *params = self->params;
    int k = self->seen++, window = (int)floorl(params->rate_window_s / self->sample_time + 0.5L);
    window = window < 1 ? 1 : window;
    self->z[k] = z;
    long double raw = fabsl(z - self->z[k < window ? 0 : k - window]) / (window * self->sample_time);
    self->filtered += (params->rate_filter_s > 0 ? -expm1l(-self->sample_time / params->rate_filter_s) : 1) *
                      (raw - self->filtered);
    return fminl(self->filtered, params->max_um_per_s);
}

/* S piece by piece: its inverse follows from no derived parameter. */
static long double chain_unsaturate(const rdpi_f32_params_t *params, long double z)
{
    long double slope = params->saturation[0].weight, v = 0, reached = 0;
    for (size_t j = 1; j < params->deadzones; j++) {
        long double corner = reached + slope * (params->saturation[j].d_um - v);
        if (z <= corner) {
            break;
        }
        v = params->saturation[j].d_um;
        reached = corner;
        slope += params->saturation[j].weight;
    }
    return v + (z - reached) / slope;
}

typedef struct {
    double drive, displacement; /* worst error, of the stroke; the drive's as the x that it makes */
} score_t;

/* The library's drive against the chain's, and what the actuator makes of both. */
static void compare_chain(const scenario_t *scenario, profile_t *profile, score_t *score)
{
    static chain_t chain;
    const rdpi_f32_params_t *params = &scenario->actuator.params;
    plant_t by_library = {params, {0}}, by_chain = {params, {0}};
    rdpi_f32_t axis;

    require(rdpi_f32_init(&axis, params, (rdpi_real_t)scenario->sample_time_s) == RDPI_OK, "init refused");
    chain = (chain_t){.params = params, .walk = {params->play, params->plays, {0}},
                      .sample_time = (rdpi_real_t)scenario->sample_time_s};
    for (size_t i = 0; i < params->plays; i++) {
        chain.walk.y[i] = by_library.y[i] = by_chain.y[i] = params->memory_um[i];
    }
    for (int k = 0; k < SAMPLES; k++) {
        rdpi_real_t reference_um = (rdpi_real_t)(profile_next(profile) + (double)params->offset_um);
        long double z = (long double)reference_um - params->offset_um, rate = chain_rate(&chain, z);
        long double x = walk_solve(&chain.walk, rate, chain_unsaturate(params, z));
        long double at_min = plant_x(&by_chain, params->min_V), at_max = plant_x(&by_chain, params->max_V);
        x = fmaxl(fminl(at_min, at_max), fminl(fmaxl(at_min, at_max), x));
        walk_move(&chain.walk, x);
        plant_move(&by_chain, x);
        long double x_library = plant_x(&by_library, rdpi_f32_step(&axis, reference_um));
        plant_move(&by_library, x_library);
        worse(&score->drive, (x_library - x) / scenario->stroke_um);
        worse(&score->displacement, (plant_z(&by_library, rate) - plant_z(&by_chain, rate)) / scenario->stroke_um);
    }
}

static void print(const char *what, score_t score)
{
    printf("  %-45s displacement %.1e, drive %.1e\n", what, 100 * score.displacement, 100 * score.drive);
}

int main(void)
{
    for (size_t set = 0; set < SETS; set++) {
        compare_set(1 + set % RDPI_MAX_PLAYS);
    }
    printf("Bank against plain walk: %.0e steps, %lu reversals, %lu moves elsewhere than to the solution\n"
           "worst error as share of half the stroke, in the first and in the last tenth of the steps:\n"
           "  x (limit %.1e) %.2e, %.2e; plays (limit %.1e) %.2e, %.2e\n",
           (double)SETS * STEPS, turns, elsewhere, LIMIT_X, first_x, last_x, LIMIT_Y, first_y, last_y);
    require(last_x <= DRIFT * first_x && last_y <= DRIFT * first_y, "the error grows");

    score_t laws[LAWS] = {{0, 0}}, short_filter = {0, 0};
    for (int number = 0; number < CASES; number++) {
        static scenario_t scenario;
        random_scenario(&scenario, (law_t)(number % LAWS));
        rdpi_f32_params_t *params = &scenario.actuator.params;
        params->dac_bits = 0;     /* a code more or less is no rounding error, */
        params->slew_V_per_s = 0; /* nor is a ramp that adds up its own */
        actuator_derive(&scenario.actuator);
        profile_t profile = {.stroke_um = scenario.stroke_um};
        bool short_one = params->rate_filter_s > 0 && (double)params->rate_filter_s < scenario.sample_time_s;
        compare_chain(&scenario, &profile, short_one ? &short_filter : &laws[scenario.law]);
    }
    printf("Library against the same chain in long double: %d actuators, %d samples each\n"
           "worst error in %% of the stroke (limit for displacement %.0e), the drive's as the x it makes:\n", CASES,
           SAMPLES, 100 * LIMIT_CHAIN);
    print("no rate law", laws[CONSTANT]);
    print("mild rate law", laws[MILD]);
    print("strong rate law", laws[STRONG]);
    print("no limit: rate filter shorter than a sample", short_filter);
    for (int law = 0; law < LAWS; law++) {
        require(laws[law].displacement <= LIMIT_CHAIN, "the library's rounding exceeds its limit");
    }
    return 0;
}
