/* rdpi_f32_chain: creep and relaxation, undone. */
#include "unity.h"

#include "rdpi/f32_chain.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")
TEST_SOURCE_FILE("lib/src/rdpi_f32_chain.c")

#include "chain_f32.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

#define STROKE_UM 128

/* Steps, and what the actuator makes of the drives. Returns the worst difference to the references, of the stroke. */
static double worst_of(int samples, double (*reference)(int))
{
    double worst = 0;
    for (int k = 0; k < samples; k++) {
        double reference_um = (double)(rdpi_real_t)reference(k);
        double error_um = crept(step(reference_um)) - reference_um;
        worst = fmax(worst, fabs(error_um));
        TEST_ASSERT_EQUAL_UINT32(0, chain.axis.flags);
    }
    return worst / STROKE_UM;
}

static double jumps_and_sines(int k)
{
    return (k / 500 % 2 == 0 ? 12 : -12) + 6 * sin(0.01 * k) + 6 * sin(0.7 * k);
}

static void start_at(double settled_um)
{
    start();
    creep_starts(settled_um);
}

/* ---- fast poles ---- */

void test_fast_poles_are_undone_to_rounding(void)
{
    params.direct = (rdpi_real_t)0.75;
    add_pole(0.125, 0.0625);
    add_pole(-0.25, 0.001);
    add_pole(0.0625, 1e-9);
    add_pole(0.25, 0.9);
    start_at(0);
    TEST_ASSERT_EQUAL_UINT32(0, chain.preview_samples);
    TEST_ASSERT_EQUAL_UINT(4, chain.creep.fast);
    /* Rounding of a state in 1000 samples of the slowest: see f32_creep.h. */
    WITHIN(6.2e-5 * 0.25 + 1e-6, 0, worst_of(5000, jumps_and_sines));
}

void test_creep_is_relative_to_where_it_has_settled(void)
{
    params.direct = (rdpi_real_t)0.75;
    add_pole(0.125, 0.0625);
    given.memory_um[0] = 16;
    given.params.offset_um = 4;
    start();
    creep_starts(20);
    for (int k = 0; k < 100; k++) {
        EQUAL(20, crept(step(20) + 4));
    }
    EQUAL(24, crept(step(24) + 4));
    EQUAL(24, crept(step(24) + 4));
}

/* ---- slow poles ---- */

/* A slow pole moves once in a round, so that its share of a jump is late. See the bound in f32_creep.h. */
void test_slow_poles_are_undone_to_the_share_that_they_move_in_two_rounds(void)
{
    add_pole(0.02, 1.5);
    add_pole(0.25, 0.5);
    add_pole(-0.01, 100);
    add_pole(0.02, 5);
    add_pole(0.02, 1000);
    start_at(0);
    TEST_ASSERT_EQUAL_UINT(1, chain.creep.fast);
    double share = 0.02 / 1.5 + 0.01 / 100 + 0.02 / 5 + 0.02 / 1000;
    WITHIN(6.2e-5 * 0.25 + 1e-6 + 2 * 4 * (double)T_S * share * 0.3, 0, worst_of(20000, jumps_and_sines));
}

/* Here single precision swallows what the pole moves in a turn. */
void test_the_slowest_pole_loses_nothing_to_rounding(void)
{
    add_pole(0.5, 1e6);
    start();
    (void)step(32);
    rdpi_f32_chain_missed(&chain, 1000000000);
    double begin_um = (double)chain.creep.lag[0].state_um, h_um = (double)chain.axis.drive_V;
    WITHIN(1e-4, h_um * -expm1(-1e9 / 1024 / 1e6), begin_um);
    for (int k = 0; k < 8192; k++) {
        chain.creep.h_um = (rdpi_real_t)h_um;
        chain.creep.mean_um = (rdpi_real_t)h_um;
        (void)rdpi_f32_chain_step(&chain, 32);
    }
    double moved_um = (double)chain.creep.lag[0].state_um - begin_um + (double)chain.creep.lag[0].rest_um;
    WITHIN(1e-3 * moved_um, (h_um - begin_um) * 8192 / 1024 / 1e6, moved_um);
    TEST_ASSERT_TRUE(moved_um > 0);
}

/* What alternates with the round of the slow poles has a mean of 0. */
static double alternates(int k)
{
    return k % 3 == 0 ? 20 : -10;
}

void test_slow_poles_follow_the_mean_of_a_reference_of_their_own_period(void)
{
    add_pole(0.05, 2);
    add_pole(0.05, 3);
    add_pole(0.05, 4);
    start_at(0);
    TEST_ASSERT_EQUAL_UINT(0, chain.creep.fast);
    double moved_um = 0.05 * (1 / 2.0 + 1 / 3.0 + 1 / 4.0) * 3 * (double)T_S * 20; /* in the first round */
    WITHIN(moved_um / STROKE_UM, 0, worst_of(20000, alternates));
}

/* ---- what was output, not what was asked for ---- */

/* The library's states, the fast ones first, against those of a staircase. The library moves them to a sample with the
 * next one. A slow one may be two rounds late, after steps of `largest_um`. */
static void equal_states(double largest_um)
{
    size_t i = 0;
    for (int slow = 0; slow < 2; slow++) {
        for (size_t k = 0; k < params.poles; k++) {
            if ((pole[k].time_constant_s > 1) == (slow != 0)) {
                double ratio = (double)T_S / (double)pole[k].time_constant_s;
                WITHIN(1e-4 + slow * (2 * (double)chain.creep.round + 2) * ratio * largest_um, creep.state_before_um[k],
                       chain.creep.lag[i].state_um);
                i++;
            }
        }
    }
}

/* What a slow pole that is two rounds late leaves out, `after_um` away from where it goes. */
static double late_um(double after_um)
{
    double sum_um = 0;
    for (size_t k = 0; k < params.poles; k++) {
        double per_s = pole[k].time_constant_s > 1 ? (double)(pole[k].share / pole[k].time_constant_s) : 0;
        sum_um += fabs(per_s) * (2 * (double)chain.creep.round + 2) * (double)T_S * after_um;
    }
    return sum_um;
}

static void one_fast_one_slow(void)
{
    params.direct = (rdpi_real_t)0.75;
    add_pole(0.125, 16);
    add_pole(0.125, 0.0625);
}

void test_states_follow_a_clipped_drive(void)
{
    one_fast_one_slow();
    given.params.max_V = 4;
    start_at(0);
    for (int k = 0; k < 1024; k++) {
        double drive_V = step(20);
        EQUAL(4, drive_V);
        (void)crept(drive_V);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, chain.axis.flags);
    }
    equal_states(4);
    WITHIN(1e-5 + late_um(4), 2, crept(step(2)));
}

void test_states_follow_a_drive_held_back_by_the_slew_limit(void)
{
    one_fast_one_slow();
    given.params.slew_V_per_s = 16;
    given.params.sweep_V_per_s = 16;
    start_at(0);
    for (int k = 0; k < 1024; k++) {
        double drive_V = step(40);
        (void)crept(drive_V);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_SLEW, chain.axis.flags);
    }
    EQUAL(16, chain.axis.drive_V);
    equal_states(16);
}

void test_creep_goes_on_while_references_are_refused(void)
{
    one_fast_one_slow();
    start_at(0);
    for (int k = 0; k < 1024; k++) {
        double drive_V = step(k < 10 ? 8 : NAN);
        (void)crept(drive_V);
        TEST_ASSERT_EQUAL_UINT32(k < 10 ? 0 : RDPI_FLAG_INPUT, chain.axis.flags);
    }
    equal_states(8);
    WITHIN(1e-5 + late_um(8), 8, crept(step(8)));
}

void test_references_that_cannot_be_used_are_refused_even_if_creep_would_bring_them_near(void)
{
    const rdpi_real_t bad[] = {NAN, INFINITY, -INFINITY, (rdpi_real_t)1000001};
    params.direct = 4;
    add_pole(0.5, 1);
    start();
    WITHIN(1e-3, 2, step(8));
    for (size_t k = 0; k < sizeof bad / sizeof bad[0]; k++) {
        WITHIN(1e-3, 2, step((double)bad[k]));
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, chain.axis.flags);
        (void)rdpi_f32_chain_sweep(&chain); /* in between */
        (void)rdpi_f32_forward(&chain.axis, 2, 0);
    }
    WITHIN(0.01, 2, step(8));
}

void test_a_reference_that_creep_brings_beyond_the_largest_is_refused(void)
{
    params.direct = (rdpi_real_t)0.5;
    add_pole(0.5, 1);
    start();
    EQUAL(0, step(900000));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, chain.axis.flags);
    EQUAL(0, chain.creep.lag[0].state_um);
}

/* ---- sweeps ---- */

/* The middle of the range is 16. */
void test_creep_follows_a_sweep_from_the_middle_of_the_range_on(void)
{
    one_fast_one_slow();
    given.params.min_V = -32;
    given.params.sweep_V_per_s = 1024;
    given.params.sweep_end_V = 40;
    given.params.sweep_cycles = 3;
    start();
    for (int k = 0; k < 200; k++) {
        (void)step(20 + 0.1 * k);
    }
    creep_starts(16);
    int samples = 1;
    for (; rdpi_f32_chain_sweep(&chain); samples++) {
        TEST_ASSERT_LESS_THAN_INT(1000, samples);
        (void)crept((double)chain.axis.drive_V);
    }
    TEST_ASSERT_GREATER_THAN_INT(200, samples);
    (void)crept((double)chain.axis.drive_V);
    for (int k = 0; k < 500; k++) {
        double reference_um = 40 + 0.01 * k;
        WITHIN(1e-5 + late_um(48), reference_um, crept(step(reference_um)));
    }
}

void test_creep_follows_from_the_middle_of_the_range_for_the_time_since_a_sweep(void)
{
    const uint32_t ticks[] = {0, 1, 2, 100, 5000, UINT32_MAX};
    for (size_t k = 0; k < sizeof ticks / sizeof ticks[0]; k++) {
        setUp();
        one_fast_one_slow();
        given.params.min_V = -32;
        params.lead_s = T_S;
        start();
        (void)step(0);
        (void)step(8);
        (void)rdpi_f32_forward(&chain.axis, 40, 0);
        rdpi_f32_chain_swept(&chain, ticks[k]);
        creep_starts(16);
        if (ticks[k] > 0) {
            (void)crept(40);
            crept_for(ticks[k] - 1.0, 40);
        }
        for (int n = 0; n < 50; n++) {
            WITHIN(1e-5 + late_um(32), 40, crept(step(40)));
        }
    }
}

/* ---- missed samples ---- */

void test_creep_goes_on_for_the_time_of_missed_samples(void)
{
    const uint32_t missed[] = {0, 1, 7, 16, 17, 300, 5000, 1000000};
    for (size_t k = 0; k < sizeof missed / sizeof missed[0]; k++) {
        setUp();
        one_fast_one_slow();
        add_pole(0.02, 20);
        start_at(0);
        for (int n = 0; n < 50; n++) {
            (void)crept(step(8));
        }
        double drive_V = (double)chain.axis.drive_V;
        crept_for(missed[k], drive_V);
        rdpi_f32_chain_missed(&chain, missed[k]);
        TEST_ASSERT_EQUAL_UINT32(missed[k], chain.axis.missed_count);
        equal_states(8);
        for (int n = 0; n < 50; n++) {
            WITHIN(1e-5 + late_um(8), 8, crept(step(8)));
        }
    }
}

/* In the middle of a round: the poles that have moved in it and those that have not. */
void test_missed_samples_may_come_anywhere_in_a_round(void)
{
    for (int before = 50; before < 55; before++) {
        setUp();
        for (int i = 0; i < 5; i++) {
            add_pole(0.1, 2 + i);
        }
        start_at(0);
        for (int n = 0; n < before; n++) {
            (void)crept(step(8));
        }
        double drive_V = (double)chain.axis.drive_V;
        crept_for(2000, drive_V);
        rdpi_f32_chain_missed(&chain, 2000);
        for (int n = 0; n < 50; n++) {
            WITHIN(0.02, 8, crept(step(8)));
        }
    }
}

/* In the middle of a round, slow poles have a mean, a sum and rests. */
void test_settling_forgets_the_round(void)
{
    add_pole(0.1, 100);
    add_pole(0.1, 1000);
    start();
    for (int k = 0; k < 5001; k++) {
        (void)step(16);
    }
    TEST_ASSERT_TRUE(chain.creep.mean_um > 1 && chain.creep.sum_um > 1 && fabs((double)chain.creep.lag[0].rest_um) > 0);
    rdpi_f32_chain_settle(&chain);
    TEST_ASSERT_TRUE(chain.creep.mean_um == 0 && chain.creep.sum_um == 0 && chain.creep.lag[0].rest_um == 0);
}

/* 1 um/V at rest, half as steep again at this rate: 8 um are 5.3 V. */
void test_creep_goes_on_from_the_displacement_at_the_rate(void)
{
    add_pole(0, 1);
    given.play[0].slope_rate_s_per_um = (rdpi_real_t)1 / 16384;
    start();
    (void)step(0);
    EQUAL(8 / 1.5, step(8)); /* 8192 um/s */
    (void)step(NAN);
    EQUAL(8, chain.creep.h_um);
}
