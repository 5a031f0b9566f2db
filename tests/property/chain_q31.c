/* Property test: the chain in fixed point against the same chain in double, in steps, jumps, clips, missed samples and
 * samples without a reference; and ten hours at 20 kHz, shortened by what the time constants allow.
 *
 * The reference is written from the equations of rdpi/f32_chain.h. Its displacements, rounded, go to a second instance
 * of the operator, whose drives must be those of the chain. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "actuator_q31.h"
#include "random_bits.h"
#include "rdpi/q31.h"
#include "rdpi/q31_chain.h"

#ifndef CASES
#define CASES 300
#endif
#define STEPS 4000
#define LIMIT 2048 /* reference units, 2^-19 of the reach: what rdpi/q31_chain.h promises of the displacement */

static int number, step_number;

static void require(bool holds, const char *what)
{
    if (!holds) {
        printf("chain_q31: case %d, step %d: %s\n", number, step_number, what);
        exit(1);
    }
}

static bool one_in(int32_t count)
{
    return random_between(1, count) == 1;
}

/* ---- a random actuator and its chain ---- */

static actuator_q31_t actuator;
static rdpi_q31_pole_t pole[RDPI_MAX_POLES];
static rdpi_q31_chain_params_t chain;
static uint32_t sample_time_ns;
static double steepest; /* drive units per reference unit */

static void random_actuator(void)
{
    memset(&actuator, 0, sizeof actuator);
    rdpi_q31_params_t *params = &actuator.params;
    sample_time_ns = (uint32_t)random_between(5000, 500000);
    params->plays = (uint16_t)random_between(1, RDPI_MAX_PLAYS);
    params->deadzones = 1;
    params->min_drive = -(1 << 29);
    params->max_drive = 1 << 29;
    params->saturation_shift = params->inverse_shift = 30;
    actuator.saturation[0].weight = RDPI_Q31_ONE;
    actuator.inverse_saturation[0].weight = RDPI_Q31_ONE;
    int32_t least = RDPI_Q31_ONE;
    for (int i = 0; i < params->plays; i++) {
        rdpi_q31_play_t *play = &actuator.play[i];
        play->r = i * ((1 << 28) / RDPI_MAX_PLAYS);
        play->slope = random_between(1 << 29, 1 << 30);
        play->slope_rate = random_between(1 << 29, 1 << 30) - play->slope;
        least = play->slope < least ? play->slope : least;
    }
    steepest = 2;
    params->min_slope_ratio = 1;
    params->guard_mantissa = random_bits() | (uint32_t)1 << 31;
    params->guard_exponent = -20; /* from 2^11 a ns, 2^23 a sample */
    params->sweep_cycles = 3;
    params->sweep_per_us = ((uint64_t)1 << 58) / sample_time_ns * 1000u; /* 2^26 a sample */
    params->slew_per_us = one_in(4) ? params->sweep_per_us : 0u;
    actuator_q31_derive(&actuator);
}

static void random_chain(void)
{
    int64_t T = sample_time_ns;
    memset(&chain, 0, sizeof chain);
    chain.schema = RDPI_PARAMS_SCHEMA;
    chain.axis = &actuator.params;
    chain.pole = pole;
    chain.preview = one_in(2) ? 1 : 0;
    chain.delay_ns = one_in(2) ? (uint32_t)(T * random_between(0, 2000) / 100) : 0u;
    chain.lead_ns = one_in(2) ? (uint32_t)(T * random_between(0, 2000) / 100) : 0u;
    chain.lead_ns2 = one_in(2) ? (uint64_t)(T * T / 10 * random_between(0, 2000)) : 0u;
    chain.max_lead = random_between(1 << 20, 1 << 28);
    chain.poles = (uint16_t)random_between(0, RDPI_MAX_POLES);
    int32_t left = RDPI_Q31_ONE / 2;
    for (int i = 0; i < chain.poles; i++) {
        int32_t share = random_between(-left / 8, left / 2);
        left -= abs(share);
        pole[i].share = share;
        pole[i].time_constant_ns = (uint64_t)(T * exp(random_between(-1000, 14000) / 1000.0));
    }
    chain.direct = RDPI_Q31_ONE - random_between(0, RDPI_Q31_ONE / 4);
    chain.digest = rdpi_q31_chain_digest(&chain);
}

/* ---- the equations, in double ---- */

typedef struct {
    rdpi_q31_t axis;
    double per_sum, per_change, latest, before; /* the lead */
    bool first, forgets;
    double h_0, h, m[RDPI_MAX_POLES], slow, next;
    int slow_poles, turn;
} reference_t;

static reference_t reference;

static bool is_slow(int i)
{
    return (double)pole[i].time_constant_ns > 4096.0 * sample_time_ns;
}

static double mean(int i) /* (1 - exp(-u)) / u */
{
    double u = (double)sample_time_ns / (double)pole[i].time_constant_ns;
    return -expm1(-u) / u;
}

static double limited(double value, double most)
{
    return fmax(-most, fmin(most, value));
}

static void reference_settle(void)
{
    reference.first = true;
    reference.h_0 = reference.h = rdpi_q31_predict(&reference.axis, reference.axis.drive, 0);
    reference.slow = reference.next = 0;
    reference.turn = 0;
    memset(reference.m, 0, sizeof reference.m);
}

static void reference_begin(void)
{
    double T = sample_time_ns, D = chain.delay_ns, alpha = chain.lead_ns, beta = (double)chain.lead_ns2;
    double left = chain.preview ? D - T * floor(D / T + 0.5) : D;
    double a = alpha + left, b = beta + alpha * left + left * left / 2;
    require(rdpi_q31_init(&reference.axis, &actuator.params, sample_time_ns) == RDPI_OK, "refused");
    reference.per_sum = a / (2 * T);
    reference.per_change = b / (T * T) + (chain.preview ? 0 : a / T);
    reference.slow_poles = 0;
    for (int i = 0; i < chain.poles; i++) {
        reference.slow_poles += is_slow(i) ? 1 : 0;
    }
    reference_settle();
}

static void creep_turn(void)
{
    double h = limited(reference.h, RDPI_Q31_ONE) - reference.h_0;
    int slow = 0;
    for (int i = 0; i < chain.poles; i++) {
        if (!is_slow(i)) {
            reference.m[i] -= expm1(-(double)sample_time_ns / (double)pole[i].time_constant_ns) * (h - reference.m[i]);
        } else if (slow++ == reference.turn) {
            double time = (double)sample_time_ns * reference.slow_poles;
            reference.m[i] -= expm1(-time / (double)pole[i].time_constant_ns) * (h - reference.m[i]);
            reference.next += pole[i].share * mean(i) * reference.m[i];
        }
    }
    if (reference.slow_poles > 0 && ++reference.turn == reference.slow_poles) {
        reference.slow = reference.next;
        reference.next = 0;
        reference.turn = 0;
    }
}

static double creep_solve(double z)
{
    double at_once = chain.direct, known = reference.slow;
    for (int i = 0; i < chain.poles; i++) {
        at_once += pole[i].share * (1 - mean(i));
        known += is_slow(i) ? 0 : pole[i].share * mean(i) * reference.m[i];
    }
    return reference.h_0 + (RDPI_Q31_ONE * (z - reference.h_0) - known) / at_once;
}

static double lead(double u, unsigned missed, double *wish)
{
    if (reference.first || missed > RDPI_MAX_MISSED) {
        reference.first = false;
        reference.latest = u;
        reference.before = 0;
        missed = 0;
    }
    double d = trunc((u - reference.latest) / (1 + missed)); /* whole units, as the rate's */
    double before = missed > 0 ? d : reference.before;
    reference.latest = u;
    reference.before = d;
    *wish = reference.per_sum * (d + before) + reference.per_change * (d - before);
    return (chain.preview ? u - d : u) + limited(*wish, chain.max_lead);
}

static bool leads(void)
{
    return chain.delay_ns > 0 || chain.lead_ns > 0 || chain.lead_ns2 > 0;
}

static int32_t reference_step(int32_t u, double *wish)
{
    *wish = 0;
    if (u == RDPI_Q31_NO_REFERENCE) {
        rdpi_q31_step(&reference.axis, u);
        creep_turn();
        return reference.axis.drive;
    }
    double z = leads() ? lead(u, reference.axis.missed, wish) : u;
    if (chain.poles > 0) {
        z = limited(creep_solve(limited(z, INT32_MAX)), RDPI_Q31_ONE - 1);
    }
    reference.h = z;
    int32_t drive = rdpi_q31_step(&reference.axis, (int32_t)llround(limited(z, INT32_MAX)));
    if ((reference.axis.flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0) {
        reference.h = rdpi_q31_predict(&reference.axis, drive, reference.axis.rate);
    }
    creep_turn();
    return drive;
}

/* ---- both side by side ---- */

static rdpi_q31_chain_t axis;
static struct {
    double worst_h, worst_drive, squares;
    unsigned long steps, clipped, led, held, missed;
} total;

static void compare(int32_t u)
{
    double wish;
    int32_t drive = rdpi_q31_chain_step(&axis, u), ideal = reference_step(u, &wish);
    uint32_t flags = axis.axis.flags;
    require(drive == axis.axis.drive, "another drive returned");
    require(drive >= actuator.params.min_drive && drive <= actuator.params.max_drive, "out of range");
    double error = fabs((double)drive - ideal);
    total.steps++;
    total.squares += error * error;
    total.worst_drive = fmax(total.worst_drive, error);
    if (fabs(fabs(wish) - chain.max_lead) > 4096) {
        require(((flags & RDPI_FLAG_LEAD) != 0) == (fabs(wish) > chain.max_lead), "lead wrongly flagged");
    }
    if (chain.poles > 0 && ((flags | reference.axis.flags) & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) == 0) {
        double off = fabs(axis.creep.h - reference.h);
        total.worst_h = fmax(total.worst_h, off);
        if (off > LIMIT) { printf("h %d, ideal %.1f\n", axis.creep.h, reference.h); }
        require(off <= LIMIT, "displacement off");
    }
    if (error > LIMIT * steepest) { printf("drive %d, ideal %d\n", drive, ideal); }
    require(error <= LIMIT * steepest, "drive off");
    total.clipped += (flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0;
    total.led += (flags & RDPI_FLAG_LEAD) != 0;
    total.held += (flags & RDPI_FLAG_INPUT) != 0;
    total.missed += (flags & RDPI_FLAG_MISSED) != 0;
}

static void run_case(void)
{
    random_actuator();
    random_chain();
    rdpi_status_t status = rdpi_q31_chain_init(&axis, &chain, sample_time_ns);
    require(status == RDPI_OK, rdpi_status_text(status));
    reference_begin();
    require(axis.preview_samples == (leads() && chain.preview ? (uint32_t)floor((double)chain.delay_ns / sample_time_ns + 0.5) + 1u : 0u), "preview");
    int32_t reach = 1 << random_between(26, 29), now = 0, way = 0;
    for (step_number = 0; step_number < STEPS; step_number++) {
        if (one_in(50)) {
            way = random_size(reach / 64, 12);
        }
        if (one_in(500)) {
            now = random_between(-reach, reach);
        }
        now += way;
        if (now > reach || now < -reach) {
            way = -way;
            now += way;
        }
        if (one_in(200)) {
            uint32_t ticks = (uint32_t)random_between(0, 40);
            rdpi_q31_chain_missed(&axis, ticks);
            rdpi_q31_missed(&reference.axis, ticks);
            for (uint32_t k = 0; k < ticks && k < RDPI_MAX_MISSED; k++) {
                creep_turn();
            }
        }
        compare(one_in(300) ? RDPI_Q31_NO_REFERENCE : now);
    }
}

int main(void)
{
    random_state = 20151;
    for (number = 0; number < CASES; number++) {
        run_case();
    }
    printf("%lu steps; clipped %lu, lead limited %lu, held %lu, after missed %lu; displacement off by %.0f units at most, drive by "
           "2^%.2f of full scale at most, 2^%.2f rms\n",
           total.steps, total.clipped, total.led, total.held, total.missed, total.worst_h,
           log2(total.worst_drive / RDPI_Q31_MAX_DRIVE), log2(sqrt(total.squares / (double)total.steps) / RDPI_Q31_MAX_DRIVE));
    return 0;
}
