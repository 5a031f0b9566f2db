/* Property test: whatever the chain, the drives that rdpi_f32_chain_step outputs, put into the actuator and its creep by
 * their definitions, give what the lead has to make of the reference, wherever nothing was limited. With a lag, these
 * are the operator's own drives, and what is output is what lag^-1 has to make of them.
 *
 * The operator is plant_t, creep is the low_pass of host_tools/rdpi/simulate/effects/base.py, lead and lag^-1 are the
 * formulas in lib/src/f32_lead.h and f32_unlag.h, all in double; nothing of them is the library's. Then creep for a long
 * time:
 *
 *     chain [SAMPLES]    so many at 20 kHz; 720000000 are ten hours */
#include <float.h>
#include <stdio.h>
#include <stdlib.h>

#include "random_chain.h"

#define CASES 3000
#define STEPS 400
#define SINGLE (sizeof(rdpi_real_t) == sizeof(float))
#define EPSILON (SINGLE ? (double)FLT_EPSILON : DBL_EPSILON)

static void require(bool holds, const char *what, int number, int step)
{
    if (!holds) {
        printf("chain: case %d, step %d: %s\n", number, step, what);
        exit(1);
    }
}

static chain_t chosen;
static rdpi_f32_chain_params_t *const params = &chosen.params;
static double T; /* the sample time */

/* ---- lead and creep by definition ---- */

static struct {
    double latest_um, before_um;
    bool any;
} lead;

/* What the lead makes of a reference after `missed` samples; how far that may be off in `*tolerance_um`. */
static double lead_of(double ahead_um, unsigned missed, bool *limited, double *tolerance_um)
{
    double D = (double)params->delay_s, alpha = (double)params->lead_s, beta = (double)params->lead_s2;
    *limited = false;
    *tolerance_um = 0;
    if (D <= 0 && alpha <= 0 && beta <= 0) {
        return ahead_um;
    }
    if (!lead.any || missed > RDPI_MAX_MISSED) {
        lead.latest_um = ahead_um;
        lead.before_um = 0;
        lead.any = true;
    }
    double step_um = (ahead_um - lead.latest_um) / (missed + 1), before_um = missed > 0 ? step_um : lead.before_um;
    double f = params->preview ? D - floor(D / T + 0.5) * T : D;
    double a = (alpha + f) / T, b = (beta + alpha * f + f * f / 2) / (T * T);
    double first = params->preview ? (step_um + before_um) / 2 : (3 * step_um - before_um) / 2;
    double add_um = a * first + b * (step_um - before_um), limit_um = (double)params->max_lead_um;
    if (alpha <= 0 && beta <= 0 && !(step_um * before_um > 0)) { /* a jump */
        add_um = 0;
    }
    *limited = fabs(add_um) > limit_um;
    *tolerance_um = 16 * EPSILON * (1 + D / T + fabs(a) + fabs(b)) * (fabs(step_um) + fabs(before_um));
    *tolerance_um *= 1 + (alpha + D) / T; /* f is the difference of two times, b has alpha f in it */
    lead.latest_um = ahead_um;
    lead.before_um = step_um;
    add_um = fmax(-limit_um, fmin(add_um, limit_um));
    return (params->preview ? ahead_um - step_um : ahead_um) + add_um;
}

static struct {
    double latest_V, before_V;
    bool any;
} unlag;

/* What lag^-1 makes of the operator's drive, without limits; how far that may be off in `*tolerance_V`. */
static double undone_lag_of(double drive_V, unsigned missed, double *tolerance_V)
{
    double per_step = (double)params->lag_s / T;
    if (!unlag.any || missed > RDPI_MAX_MISSED) {
        unlag.latest_V = drive_V;
        unlag.before_V = 0;
        unlag.any = true;
        missed = 0;
    }
    double step_V = (drive_V - unlag.latest_V) / (missed + 1), before_V = missed > 0 ? step_V : unlag.before_V;
    double slope_V = 0;
    if (step_V * before_V > 0) {
        double mean = fabs(step_V + before_V) / 2, most = 2 * fmin(fabs(step_V), fabs(before_V));
        slope_V = copysign(fmin(mean, most), step_V);
    }
    *tolerance_V = 16 * EPSILON * (1 + per_step) * (1 + fabs(drive_V) + fabs(unlag.latest_V));
    unlag.latest_V = drive_V;
    unlag.before_V = step_V;
    return (params->preview ? drive_V - step_V : drive_V) + per_step * slope_V;
}

static struct {
    double a[RDPI_MAX_POLES], g[RDPI_MAX_POLES], lag_um[RDPI_MAX_POLES], before_um, settled_um, farthest_um;
} creep;

static void creep_start(double settled_um)
{
    for (size_t i = 0; i < params->poles; i++) {
        double ratio = T / (double)chosen.pole[i].time_constant_s;
        creep.a[i] = exp(-ratio);
        creep.g[i] = -expm1(-ratio) / ratio;
        creep.lag_um[i] = settled_um;
    }
    creep.before_um = creep.settled_um = settled_um;
    creep.farthest_um = 0;
}

static double creep_move(double h_um)
{
    double z_um = creep.settled_um + (double)params->direct * (h_um - creep.settled_um);
    for (size_t i = 0; i < params->poles; i++) {
        double a = creep.a[i], g = creep.g[i];
        creep.lag_um[i] = a * creep.lag_um[i] + (1 - g) * h_um + (g - a) * creep.before_um;
        z_um += (double)chosen.pole[i].share * (creep.lag_um[i] - creep.settled_um);
    }
    creep.before_um = h_um;
    creep.farthest_um = fmax(creep.farthest_um, fabs(h_um - creep.settled_um));
    return z_um;
}

/* How far creep may be off in single precision: see f32_creep.h. A fast pole is off by the rounding of its state in one
 * time constant, 2^-24 of it per sample. A slow one is two rounds late. */
static double creep_tolerance(const rdpi_f32_creep_t *state)
{
    double sum = 0;
    for (size_t i = 0; i < params->poles; i++) {
        double samples = (double)chosen.pole[i].time_constant_s / T;
        double fast = EPSILON * (1 + samples), slow = (2 * (double)state->round + 2) / samples;
        sum += fabs((double)chosen.pole[i].share) * (SINGLE && samples > 1024 ? slow : fast);
    }
    return 2 * sum * creep.farthest_um;
}

/* ---- the property ---- */

static double worst, worst_of_tolerance;
static unsigned long compared, undone, limited_leads, clipped, held, gaps;

static void run_case(int number)
{
    scenario_t scenario;
    random_scenario(&scenario, (law_t)(number % LAWS));
    T = scenario.sample_time_s;
    scenario.actuator.params.dac_bits = 0; /* creep follows what was asked for, not its code */
    actuator_derive(&scenario.actuator);
    random_chain(&chosen, &scenario);
    const rdpi_f32_params_t *axis = &scenario.actuator.params;
    static rdpi_f32_chain_t chain;
    plant_t plant = {axis, {0}};
    profile_t profile = {.stroke_um = scenario.stroke_um};
    double offset_um = (double)axis->offset_um;
    unsigned missed = 0;

    require(rdpi_f32_chain_init(&chain, params, (rdpi_real_t)T) == RDPI_OK, "init refused", number, -1);
    for (size_t i = 0; i < axis->plays; i++) {
        plant.y[i] = axis->memory_um[i];
    }
    creep_start((double)plant_z(&plant, 0) + offset_um);
    lead.any = unlag.any = false;
    for (int k = 0; k < STEPS; k++) {
        rdpi_real_t ahead_um = (rdpi_real_t)(profile_next(&profile) + offset_um);
        if (choose(200) == 0) {
            ahead_um = NAN;
        }
        if (choose(200) == 0) {
            unsigned ticks = 1u + (unsigned)choose(RDPI_MAX_MISSED + 4);
            rdpi_f32_chain_missed(&chain, ticks);
            missed += ticks;
            for (unsigned tick = 0; tick < ticks; tick++) {
                (void)creep_move((double)plant_z(&plant, chain.axis.rate_um_per_s) + offset_um);
            }
        }
        double before_V = (double)chain.axis.drive_V, tolerance_um = 0, expected_um = 0;
        bool limited = false, usable = ahead_um == ahead_um;
        if (usable) {
            expected_um = lead_of((double)ahead_um, missed, &limited, &tolerance_um);
        }
        rdpi_real_t drive_V = rdpi_f32_chain_step(&chain, ahead_um);
        bool lags = params->lag_s > 0;
        plant_move(&plant, plant_x(&plant, lags ? chain.unlag.followed_V : drive_V));
        double z_um = creep_move((double)plant_z(&plant, chain.axis.rate_um_per_s) + offset_um);

        uint32_t flags = chain.axis.flags;
        require(drive_V >= axis->min_V && drive_V <= axis->max_V, "drive outside its range", number, k);
        double slew_V = (double)axis->slew_V_per_s * T, moved_V = fabs((double)drive_V - before_V);
        require(slew_V <= 0 || moved_V <= slew_V + 1e-6 * (1 + fabs(before_V) + fabs((double)drive_V)),
                "moved more than the slew allows", number, k);
        require(((flags & RDPI_FLAG_INPUT) != 0) == !usable, "flag of an unusable reference", number, k);
        if (!usable) {
            require((double)drive_V == before_V, "not held", number, k);
            missed++;
            held++;
            continue;
        }
        require(((flags & RDPI_FLAG_MISSED) != 0) == (missed > 0), "flag of missed samples", number, k);
        gaps += missed > 0;
        if (lags) {
            double off_V, wish_V = undone_lag_of((double)chain.unlag.followed_V, missed, &off_V);
            double allowed_V = fmax((double)axis->min_V, fmin(wish_V, (double)axis->max_V));
            if (slew_V > 0) {
                allowed_V = fmax(before_V - slew_V, fmin(allowed_V, before_V + slew_V));
            }
            require(fabs((double)drive_V - allowed_V) <= off_V, "the lag is not undone", number, k);
            bool limited_V = fabs(wish_V - allowed_V) > 0;
            limited = limited || limited_V;
            tolerance_um += fabs(wish_V - allowed_V) < off_V ? DBL_MIN : 0; /* the flag may differ */
            undone++;
        }
        missed = 0;
        bool flagged = (flags & RDPI_FLAG_LEAD) != 0;
        require(flagged == limited || tolerance_um > 0, "flag of the lead", number, k);
        limited_leads += flagged;
        if (flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) {
            clipped++;
            continue;
        }
        /* 1e-5 and 1e-12 of the stroke are those of the operator, in roundtrip.c. */
        double reach_um = scenario.stroke_um + fabs(offset_um) + creep.farthest_um; /* which the plays remember */
        tolerance_um += (SINGLE ? 1e-5 : 1e-12) * reach_um + creep_tolerance(&chain.creep);
        double error_um = fabs(z_um - expected_um);
        worst = fmax(worst, error_um / scenario.stroke_um);
        worst_of_tolerance = fmax(worst_of_tolerance, error_um / tolerance_um);
        compared++;
        require(error_um <= tolerance_um, "the chain is not inverted", number, k);
    }
}

/* ---- a long time ---- */

#define LONG_POLES 5
#define STROKE_UM 100

/* Every half minute to another place, as in a scan that stops and goes. */
static double place_um(unsigned long k)
{
    return STROKE_UM * (double)(k / 600000u * 7u % 11u) / 10;
}

static void run_long(unsigned long samples)
{
    static rdpi_f32_chain_t chain;
    actuator_t identity = {
        .play = {{.r_um = 0, .slope = 1}},
        .saturation = {{0, 1}},
        .curve = {{.gain_um_per_V = 1}},
        .params = {.plays = 1, .deadzones = 1, .curve_pieces = 1, .max_um_per_s = 10000000,
                   .min_slope_ratio = (rdpi_real_t)0.5, .min_V = -300, .max_V = 300, .sweep_V_per_s = 1000,
                   .sweep_cycles = 1},
    };
    actuator_derive(&identity);
    *params = (rdpi_f32_chain_params_t){.schema = RDPI_PARAMS_SCHEMA, .poles = LONG_POLES, .max_lead_um = 1,
                                       .direct = 1, .axis = &identity.params, .pole = chosen.pole};
    double blend[LONG_POLES], weight[LONG_POLES], state_um[LONG_POLES] = {0}, within = 1, h_um = 0;
    T = (double)(rdpi_real_t)5e-5;
    for (int i = 0; i < LONG_POLES; i++) {
        chosen.pole[i] = (rdpi_f32_pole_t){(rdpi_real_t)0.02, (rdpi_real_t)pow(10, i - 1)};
        double ratio = T / (double)chosen.pole[i].time_constant_s, g = -expm1(-ratio) / ratio;
        blend[i] = -expm1(-ratio);
        weight[i] = (double)chosen.pole[i].share * g;
        within += (double)chosen.pole[i].share * (1 - g);
    }
    params->digest = rdpi_f32_chain_digest(params);
    require(rdpi_f32_chain_init(&chain, params, (rdpi_real_t)T) == RDPI_OK, "init refused", -1, -1);
    double worst_state = 0, worst_drive = 0;
    for (unsigned long k = 0; k < samples; k++) {
        double reference_um = place_um(k), sum_um = 0;
        rdpi_real_t drive_V = rdpi_f32_chain_step(&chain, (rdpi_real_t)reference_um);
        for (int i = 0; i < LONG_POLES; i++) { /* one sample behind, as the library's */
            state_um[i] += blend[i] * (h_um - state_um[i]);
            sum_um += weight[i] * state_um[i];
        }
        h_um = (reference_um - sum_um) / within;
        if (k % 600000u == 599999u) { /* the library's first turn is the last pole's; fast ones come first */
            for (int i = 0; i < LONG_POLES; i++) {
                worst_state = fmax(worst_state, fabs((double)chain.creep.lag[i].state_um - state_um[i]) / STROKE_UM);
            }
            worst_drive = fmax(worst_drive, fabs((double)drive_V - h_um) / STROKE_UM);
        }
    }
    printf("%lu samples at 20 kHz, %.1f h: states of creep off by %.1e of the stroke at most, drive by %.1e\n", samples,
           (double)samples * T / 3600, worst_state, worst_drive);
    require(worst_state <= 1e-4, "creep has lost something", -1, -1);
    require(worst_drive <= 1e-5, "creep has lost something", -1, -1);
}

int main(int argc, char **argv)
{
    if (argc > 1) {
        run_long(strtoul(argv[1], NULL, 10));
        return 0;
    }
    for (int number = 0; number < CASES; number++) {
        run_case(number);
    }
    printf("%d chains: worst error %.1e of the stroke, %.2f of its bound, over %lu steps; %lu lags undone, %lu leads "
           "limited, %lu clipped, %lu held, %lu after a gap\n",
           CASES, worst, worst_of_tolerance, compared, undone, limited_leads, clipped, held, gaps);
    require(compared > 300000 && undone > 300000 && limited_leads > 10000 && clipped > 10000 && held > 1000 && gaps > 1000,
            "too little of something", -1, -1);
    require(SINGLE || worst < 1e-8, "not to rounding", -1, -1);
    run_long(6000000);
    return 0;
}
