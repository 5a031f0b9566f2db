/* Property test: the chain in fixed point against the same chain in double, in ramps, jumps, clips, missed samples and
 * samples without a reference. Then the states of creep after hours of samples.
 *
 * The reference is written from the equations of rdpi/f32_chain.h and shares no code with the library. Its
 * displacements, rounded, go to a second instance of the operator, whose drives must be those of the chain. In every
 * other case all its poles move in every sample; in the others the slow ones take turns, as those of the library do,
 * and what is left is rounding alone. Also prints a checksum of every result, which must be the same for every
 * compiler, word size and processor.
 *
 *     chain_q31 [HOURS]     so many hours at 20 kHz */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "actuator_q31.h"
#include "checksum.h"
#include "random_bits.h"
#include "rdpi/q31.h"
#include "rdpi/q31_chain.h"

#include "q31_creep.h"

#ifndef CASES /* fewer for emulators */
#define CASES 300
#endif
#ifndef STEPS
#define STEPS 4000
#endif
#ifndef HOURS
#define HOURS 0.2
#endif
#define ROUNDING 128.0 /* reference units, 2^-23 of the reach: what rdpi/q31_chain.h promises where no pole is slow */

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
    chain.lag_ns = one_in(3) ? (uint32_t)(T * random_between(1, 2000) / 100) : 0u;
    chain.lead_ns = one_in(2) ? (uint32_t)(T * random_between(0, 2000) / 100) : 0u;
    chain.lead_ns2 = one_in(2) ? (uint64_t)(T * T / 10 * random_between(0, 2000)) : 0u;
    chain.max_lead = random_between(1 << 20, 1 << 28);
    chain.poles = (uint16_t)random_between(0, RDPI_MAX_POLES);
    int32_t left = RDPI_Q31_ONE / 2;
    for (int i = 0; i < chain.poles; i++) {
        int32_t share = random_between(-left / 8, left / 2);
        left -= abs(share);
        pole[i].share = share;
        pole[i].time_constant_ns = (uint64_t)T * (random_bits() | (uint64_t)1 << 31);
        pole[i].time_constant_ns >>= random_between(10, 34);
    }
    chain.direct = RDPI_Q31_ONE - random_between(0, RDPI_Q31_ONE / 4);
    chain.digest = rdpi_q31_chain_digest(&chain);
}

/* ---- the equations, in double ---- */

typedef struct {
    double blend, weight, m;
    bool slow;
} lag_t;

static struct {
    rdpi_q31_t axis;
    bool ideal;                                 /* no pole is slow */
    double per_sum, per_change, latest, before; /* the lead */
    double asked, asked_before;                 /* lag^-1 */
    bool no_drive;
    bool first;
    double within, h_0, h, slow, next, sum, mean; /* creep */
    lag_t lag[RDPI_MAX_POLES];
    int slow_poles, turn;
    double late; /* displacement that slow poles may add too late, reference units */
} reference;

static double limited(double value, double most)
{
    return fmax(-most, fmin(most, value));
}

static double samples_of(int i) /* of the time constant */
{
    return (double)pole[i].time_constant_ns / sample_time_ns;
}

static void reference_settle(void)
{
    reference.first = reference.no_drive = true;
    reference.h_0 = reference.h = rdpi_q31_predict(&reference.axis, reference.axis.drive, 0);
    reference.slow = reference.next = reference.sum = reference.mean = 0;
    reference.turn = 0;
    for (int i = 0; i < chain.poles; i++) {
        reference.lag[i].m = 0;
    }
}

static void reference_poles(void)
{
    int slow_poles = 0;
    double late = 0;
    for (int i = 0; i < chain.poles; i++) {
        slow_poles += samples_of(i) > 4096 ? 1 : 0;
    }
    reference.slow_poles = reference.ideal ? 0 : slow_poles;
    reference.within = chain.direct;
    for (int i = 0; i < chain.poles; i++) {
        lag_t *lag = &reference.lag[i];
        double u = 1 / samples_of(i);
        lag->slow = u < 1.0 / 4096 && !reference.ideal;
        lag->weight = pole[i].share * (-expm1(-u) / u);
        lag->blend = -expm1(lag->slow ? -u * slow_poles : -u);
        reference.within += pole[i].share - lag->weight;
        late += u < 1.0 / 4096 ? fabs(lag->weight) * 2.5 * slow_poles * u : 0;
    }
    reference.late = reference.ideal ? late / reference.within : 0;
}

static void reference_begin(bool ideal)
{
    double T = sample_time_ns, D = chain.delay_ns, alpha = chain.lead_ns, beta = (double)chain.lead_ns2;
    double left = chain.preview ? D - T * floor(D / T + 0.5) : D;
    double a = alpha + left, b = beta + alpha * left + left * left / 2;
    require(rdpi_q31_init(&reference.axis, &actuator.params, sample_time_ns) == RDPI_OK, "refused");
    reference.ideal = ideal;
    reference.per_sum = a / (2 * T);
    reference.per_change = b / (T * T) + (chain.preview ? 0 : a / T);
    reference_poles();
    reference_settle();
}

static void creep_turn(void)
{
    double h = limited(reference.h, RDPI_Q31_ONE) - reference.h_0;
    int slow = 0;
    for (int i = 0; i < chain.poles; i++) {
        lag_t *lag = &reference.lag[i];
        if (!lag->slow) {
            lag->m += lag->blend * (h - lag->m);
        } else if (slow++ == reference.turn) {
            double way = lag->blend * (reference.mean - lag->m);
            lag->m += way;
            reference.next += lag->weight * (lag->m + 1.5 * way);
        }
    }
    reference.sum += h;
    if (reference.slow_poles > 0 && ++reference.turn == reference.slow_poles) {
        reference.slow = reference.next;
        reference.mean = reference.sum / reference.slow_poles;
        reference.next = reference.sum = 0;
        reference.turn = 0;
    }
}

static void creep_wait(uint32_t ticks)
{
    double h = limited(reference.h, RDPI_Q31_ONE) - reference.h_0;
    int slow = 0;
    reference.slow = reference.next = 0;
    reference.mean = h;
    reference.sum = h * reference.turn;
    for (int i = 0; i < chain.poles; i++) {
        lag_t *lag = &reference.lag[i];
        lag->m -= expm1(-(double)ticks / samples_of(i)) * (h - lag->m);
        if (lag->slow) {
            reference.slow += lag->weight * lag->m;
            reference.next += slow++ < reference.turn ? lag->weight * lag->m : 0;
        }
    }
}

static double creep_solve(double z)
{
    double known = reference.slow;
    for (int i = 0; i < chain.poles; i++) {
        known += reference.lag[i].slow ? 0 : reference.lag[i].weight * reference.lag[i].m;
    }
    return reference.h_0 + (RDPI_Q31_ONE * (z - reference.h_0) - known) / reference.within;
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
    bool jumps = chain.lead_ns == 0 && chain.lead_ns2 == 0 && !(d * before > 0);
    *wish = jumps ? 0 : reference.per_sum * (d + before) + reference.per_change * (d - before);
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
    double worst_h, worst_late, worst_drive, squares;
    unsigned long steps, undone, clipped, led, held, missed, slow;
    uint32_t checksum;
} total;

static void sum_up(uint32_t number)
{
    total.checksum = checksum_number(total.checksum, number, sizeof number);
}

static void count(uint32_t flags)
{
    total.steps++;
    total.clipped += (flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0;
    total.led += (flags & RDPI_FLAG_LEAD) != 0;
    total.held += (flags & RDPI_FLAG_INPUT) != 0;
    total.missed += (flags & RDPI_FLAG_MISSED) != 0;
    total.slow += reference.late > 0;
}

/* What is output, `latest` before it, is what lag^-1 has to make of what the operator asked for. */
static void compare_output(int32_t latest, unsigned missed)
{
    double asked = (double)(axis.axis.ramp >> 32), lag = (double)chain.lag_ns / sample_time_ns, slope = 0;
    if ((axis.axis.flags & RDPI_FLAG_INPUT) != 0) {
        require(axis.axis.drive == latest, "not held");
        return;
    }
    if (reference.no_drive || missed > RDPI_MAX_MISSED) {
        reference.no_drive = false;
        reference.asked = asked;
        reference.asked_before = 0;
        missed = 0;
    }
    double d = trunc((asked - reference.asked) / (1 + missed)), before = missed > 0 ? d : reference.asked_before;
    if (d * before > 0) {
        slope = copysign(fmin(fabs(d + before) / 2, 2 * fmin(fabs(d), fabs(before))), d);
    }
    reference.asked = asked;
    reference.asked_before = d;
    double drive = asked - (chain.preview ? d : 0) + lag * slope, slew = (double)axis.axis.slew / 4294967296.0 + 1;
    drive = fmax(actuator.params.min_drive, fmin(drive, actuator.params.max_drive));
    if (axis.axis.slew > 0) {
        drive = fmax(latest - slew, fmin(drive, latest + slew));
    }
    require(fabs(axis.axis.drive - drive) <= 2 + lag * (1 + fabs(slope) / (1 << 28)), "the lag is not undone");
    total.undone++;
}

static void compare(int32_t u, double reach)
{
    double wish;
    int32_t latest = axis.axis.drive;
    unsigned missed = axis.axis.missed;
    int32_t drive = rdpi_q31_chain_step(&axis, u), ideal = reference_step(u, &wish);
    uint32_t flags = axis.axis.flags;
    bool lags = chain.lag_ns > 0;
    double late = reference.late * reach, error = fabs((double)(lags ? axis.unlag.followed : drive) - ideal);
    if (lags) {
        compare_output(latest, missed);
    }
    require(drive == axis.axis.drive, "another drive returned");
    require(drive >= actuator.params.min_drive && drive <= actuator.params.max_drive, "out of range");
    if (!lags && fabs(fabs(wish) - chain.max_lead) > ROUNDING) {
        require(((flags & RDPI_FLAG_LEAD) != 0) == (fabs(wish) > chain.max_lead), "lead wrongly flagged");
    }
    if (chain.poles > 0 && ((flags | reference.axis.flags) & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) == 0) {
        double off = fabs(axis.creep.h - reference.h);
        require(off <= ROUNDING + late, "displacement off");
        total.worst_h = fmax(total.worst_h, late > 0 ? 0 : off);
        total.worst_late = fmax(total.worst_late, late > 0 ? (off - ROUNDING) / late : 0);
    }
    require(error <= (ROUNDING + late) * steepest, "drive off");
    total.worst_drive = fmax(total.worst_drive, late > 0 ? 0 : error);
    total.squares += late > 0 ? 0 : error * error;
    count(flags);
    sum_up((uint32_t)drive);
    sum_up(flags);
    sum_up((uint32_t)axis.axis.rate);
    sum_up(axis.axis.clip_count);
}

static void run_case(void)
{
    random_actuator();
    random_chain();
    rdpi_status_t status = rdpi_q31_chain_init(&axis, &chain, sample_time_ns);
    require(status == RDPI_OK, rdpi_status_text(status));
    reference_begin(number % 2 == 0);
    double samples = floor((double)chain.delay_ns / sample_time_ns + 0.5) + 1;
    samples = (leads() ? samples : 0) + (chain.lag_ns > 0 ? 1 : 0);
    require(axis.preview_samples == (chain.preview ? samples : 0), "preview");
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
            ticks = one_in(8) ? random_length() : ticks;
            rdpi_q31_chain_missed(&axis, ticks);
            rdpi_q31_missed(&reference.axis, ticks);
            if (ticks > 0) {
                creep_wait(ticks);
            }
        }
        compare(one_in(300) ? RDPI_Q31_NO_REFERENCE : now, 4.0 * reach); /* no lag is further from h */
    }
}

/* ---- hours ---- */

/* The states of creep after hours of displacements that change once a second, against exact ones: within 1e-4 of the
 * stroke, with time constants from 10 ms to a day. */
static void run_hours(double hours)
{
    const int32_t samples = 20000, stroke = 1 << 29;
    const double time_constant_s[] = {0.01, 0.1, 1, 10, 100, 1000, 10000, 86400};
    double exact[8], worst = 0, slow = 0;
    memset(&chain, 0, sizeof chain);
    chain.direct = RDPI_Q31_ONE;
    chain.poles = 8;
    chain.pole = pole;
    for (int i = 0; i < 8; i++) {
        pole[i] = (rdpi_q31_pole_t){RDPI_Q31_ONE / 32, (uint64_t)(time_constant_s[i] * 1e9)};
        exact[i] = 0;
    }
    rdpi_q31_creep_t *creep = &axis.creep;
    rdpi_q31_creep_init(creep, &chain, 50000);
    rdpi_q31_creep_settle(creep, &chain, 0);
    for (int32_t second = 0; second < hours * 3600; second++) {
        creep->h = random_between(-stroke / 4, stroke / 2); /* with a mean */
        for (int32_t k = 0; k < samples; k++) {
            rdpi_q31_creep_move(creep);
        }
        for (int i = 0; i < 8; i++) {
            exact[i] -= expm1(-1 / time_constant_s[i]) * (creep->h - exact[i]);
            double error = fabs(ldexp((double)creep->lag[i].state, -32) - exact[i]);
            worst = fmax(worst, error / stroke);
        }
    }
    for (int i = creep->fast; i < 8; i++) {
        slow += exact[i] / 32;
    }
    double off = fabs(ldexp((double)creep->slow, -30) - slow) / stroke;
    printf("%.1f hours at 20 kHz: states off by %.1e of the stroke at most, what the slow poles add by %.1e\n", hours,
           worst, off);
    require(worst <= 1e-4 && off <= 1e-5, "drifts");
}

int main(int argc, char **argv)
{
    random_state = 20151;
    for (number = 0; number < CASES; number++) {
        run_case();
    }
    printf("checksum of all results: %08lx\n", (unsigned long)total.checksum);
    printf("%lu steps; lag undone %lu, clipped %lu, lead limited %lu, held %lu, after missed %lu, with slow poles exact "
           "%lu\n",
           total.steps, total.undone, total.clipped, total.led, total.held, total.missed, total.slow);
    printf("displacement off by %.0f units at most; slow poles late by %.2f of what they may be\n", total.worst_h,
           total.worst_late);
    printf("drive, of full scale: worst 2^%.2f, rms 2^%.2f\n", log2(total.worst_drive / RDPI_Q31_MAX_DRIVE),
           log2(sqrt(total.squares / (double)total.steps) / RDPI_Q31_MAX_DRIVE));
    require(total.undone > total.steps / 5 && total.clipped > total.steps / 100 && total.led > total.steps / 100 && total.held > total.steps / 1000 &&
                total.missed > total.steps / 1000 && total.slow > total.steps / 10 && total.worst_late > 0.1,
            "something hardly happened");
    run_hours(argc > 1 ? strtod(argv[1], NULL) : HOURS);
    return 0;
}
