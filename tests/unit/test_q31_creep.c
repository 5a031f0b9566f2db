/* rdpi_q31_chain: creep and relaxation. */
#include "unity.h"

#include "rdpi/q31_chain.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")
TEST_SOURCE_FILE("lib/src/rdpi_q31_chain.c")

#include "chain_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What creep and relaxation make of the drive, literally: straight between samples, in double. */
static double lag[RDPI_MAX_POLES], before;

static void plant_settles(void)
{
    before = chain.axis.drive;
    for (size_t i = 0; i < given.poles; i++) {
        lag[i] = before;
    }
}

static double displacement(double drive, double settled)
{
    double z = settled + ldexp(given.direct, -30) * (drive - settled);
    for (size_t i = 0; i < given.poles; i++) {
        double u = T_NS / (double)pole[i].time_constant_ns, keep = exp(-u), mean = -expm1(-u) / u;
        lag[i] = keep * lag[i] + (1 - mean) * drive + (mean - keep) * before;
        z += ldexp(pole[i].share, -30) * (lag[i] - settled);
    }
    before = drive;
    return z;
}

static double settled;

static void begin(void)
{
    start();
    plant_settles();
    settled = chain.axis.drive;
}

static void tracks(double within, int32_t reference)
{
    double z = displacement(rdpi_q31_chain_step(&chain, reference), settled);
    TEST_ASSERT_EQUAL_HEX32(0, chain.axis.flags & ~(uint32_t)RDPI_FLAG_MISSED);
    TEST_ASSERT_DOUBLE_WITHIN(within, reference, z);
}

static void fast_poles(void)
{
    given.direct = (int32_t)(0.75 * ONE);
    add_pole(0.125, 30);
    add_pole(0.25, 700);
    add_pole(-0.125, 3000);
}

void test_the_displacement_behind_creep_is_the_reference(void)
{
    fast_poles();
    begin();
    for (int k = 0; k < 10000; k++) {
        tracks(64, k < 10 ? 0 : k < 5000 ? 200 * U + k : -300 * U - k);
    }
}

/* One of the slow poles moves per sample: so what they add is constant for as many samples
 * as there are. */
void test_slow_poles_take_turns(void)
{
    fast_poles();
    for (int k = 0; k < 4; k++) {
        add_pole(1.0 / 32, 5000 << k);
    }
    begin();
    TEST_ASSERT_EQUAL_UINT(3, chain.creep.fast);
    for (int k = 0; k < 50000; k++) {
        tracks(k < 40 ? U : 100 * U * (4.0 / 32) * (2.5 / 5000), k < 10 ? 0 : 100 * U);
    }
}

void test_a_pole_is_slow_beyond_4096_samples(void)
{
    add_pole(0.125, 4096);
    start();
    TEST_ASSERT_EQUAL_UINT(1, chain.creep.fast);
    pole[0].time_constant_ns++;
    start();
    TEST_ASSERT_EQUAL_UINT(0, chain.creep.fast);
}

void test_the_order_of_fast_and_slow_poles_is_free(void)
{
    rdpi_q31_chain_t other;
    add_pole(0.125, 10000);
    add_pole(0.25, 20);
    add_pole(0.0625, 90000);
    add_pole(0.03125, 300);
    start();
    other = chain;
    const rdpi_q31_pole_t sorted[] = {pole[1], pole[3], pole[0], pole[2]};
    memcpy(pole, sorted, sizeof sorted);
    start();
    TEST_ASSERT_EQUAL_UINT(2, chain.creep.fast);
    TEST_ASSERT_EQUAL_MEMORY(&other.creep, &chain.creep, sizeof chain.creep);
}

void test_settled_creep_adds_nothing(void)
{
    fast_poles();
    add_pole(0.125, 1e6);
    actuator.memory[0] = 123456789;
    start();
    for (int k = 0; k < 20000; k++) {
        TEST_ASSERT_INT32_WITHIN(16, 123456789, rdpi_q31_chain_step(&chain, 123456789));
    }
}

/* Within a sample, a lag much faster comes at once; one much slower, not at all. */
void test_time_constants_of_any_size(void)
{
    given.direct = ONE / 2;
    add_pole(0.25, 1e-5);
    start();
    drives(100 * U / (0.75 - 0.25e-5), 100 * U);
    drives(100 * U / 0.75, 100 * U);
    pole[0].time_constant_ns = 1500; /* its lag is so late */
    start();
    drives(100 * U / (0.75 - 0.25 * 1500 / T_NS), 100 * U);
    pole[0].time_constant_ns = UINT64_MAX;
    start();
    for (int k = 0; k < 5000; k++) {
        drives(200 * U, 100 * U);
    }
    TEST_ASSERT_EQUAL_INT(RDPI_OK, init_for(1));
    for (int k = 0; k < 5000; k++) {
        drives(200 * U, 100 * U);
    }
    pole[0].time_constant_ns = 1;
    TEST_ASSERT_EQUAL_INT(RDPI_OK, init_for(UINT32_MAX));
    for (int k = 0; k < 10; k++) {
        drives(100 * U / 0.75, 100 * U);
    }
}

static void clips_and_comes_back(uint32_t flag)
{
    begin();
    for (int k = 0; k < 4000; k++) {
        displacement(rdpi_q31_chain_step(&chain, k < 1000 ? MAX / 8 * 7 : -ONE), settled);
        TEST_ASSERT_TRUE(k != 3999 || (chain.axis.flags & RDPI_FLAG_RANGE) != 0u);
    }
    for (int k = 0; k < 100; k++) {
        displacement(rdpi_q31_chain_step(&chain, 0), settled);
        TEST_ASSERT_TRUE(k != 0 || (chain.axis.flags & flag) == flag);
    }
    for (int k = 0; k < 4000; k++) {
        tracks(64, k < 50 ? k * U : 50 * U);
    }
}

void test_creep_follows_what_was_really_output(void)
{
    fast_poles();
    clips_and_comes_back(0);
    actuator.params.sweep_per_us /= 8u;
    actuator.params.slew_per_us = actuator.params.sweep_per_us;
    clips_and_comes_back(RDPI_FLAG_SLEW);
}

void test_creep_goes_on_without_references_and_in_missed_samples(void)
{
    fast_poles();
    add_pole(1.0 / 64, 8000);
    begin();
    for (int k = 0; k < 20; k++) {
        tracks(U / 4, 100 * U);
    }
    for (int n = 0; n < 50; n++) {
        for (int k = 0; k < 30; k++) {
            int32_t held = chain.axis.drive;
            TEST_ASSERT_EQUAL_INT32(held, rdpi_q31_chain_step(&chain, NONE));
            TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_INPUT, chain.axis.flags);
            displacement(held, settled);
        }
        rdpi_q31_chain_missed(&chain, RDPI_MAX_MISSED);
        for (unsigned k = 0; k < RDPI_MAX_MISSED; k++) {
            displacement(chain.axis.drive, settled);
        }
        tracks(U / 4, 100 * U);
    }
    TEST_ASSERT_EQUAL_UINT32(50 * RDPI_MAX_MISSED, chain.axis.missed_count);
    TEST_ASSERT_EQUAL_UINT32(1500, chain.axis.input_count);
}

/* The states after missed samples, at once, are those that as many samples one by one lead to. */
void test_creep_goes_on_for_the_time_of_any_number_of_missed_samples(void)
{
    const uint32_t ticks[] = {1, 5, 16, 100, 4321, 100000};
    for (size_t n = 0; n < 6; n++) {
        setUp();
        fast_poles();
        add_pole(1.0 / 16, 5000);
        add_pole(1.0 / 64, 1e6);
        start();
        for (int k = 0; k < 101; k++) {
            rdpi_q31_chain_step(&chain, 100 * U);
        }
        rdpi_q31_chain_t other = chain;
        rdpi_q31_chain_missed(&chain, ticks[n]);
        TEST_ASSERT_EQUAL_UINT32(ticks[n], chain.axis.missed_count);
        for (uint32_t k = 0; k < ticks[n]; k++) {
            rdpi_q31_chain_step(&other, NONE);
        }
        for (int i = 0; i < 5; i++) {
            int32_t state = (int32_t)(chain.creep.lag[i].state >> 32);
            TEST_ASSERT_INT32_WITHIN(U / 16, (int32_t)(other.creep.lag[i].state >> 32), state);
        }
        TEST_ASSERT_INT64_WITHIN((int64_t)ONE * (U / 16), other.creep.slow, chain.creep.slow);
        int32_t drive = rdpi_q31_chain_step(&other, 100 * U);
        TEST_ASSERT_INT32_WITHIN(U / 16, drive, rdpi_q31_chain_step(&chain, 100 * U));
    }
}

void test_missed_samples_without_number_or_end(void)
{
    fast_poles();
    add_pole(1.0 / 16, 5000);
    pole[3].time_constant_ns = UINT64_MAX;
    start();
    rdpi_q31_chain_step(&chain, 100 * U);
    rdpi_q31_creep_t before_them = chain.creep;
    rdpi_q31_chain_missed(&chain, 0);
    TEST_ASSERT_EQUAL_MEMORY(&before_them, &chain.creep, sizeof before_them);
    rdpi_q31_chain_missed(&chain, UINT32_MAX);
    for (int i = 0; i < 3; i++) {
        TEST_ASSERT_INT32_WITHIN(1, chain.creep.h, (int32_t)(chain.creep.lag[i].state >> 32));
    }
    TEST_ASSERT_INT32_WITHIN(U / 64, 0, (int32_t)(chain.creep.lag[3].state >> 32));
}

/* The largest shares, references and jumps: no state beyond the displacements, nothing wraps. */
void test_creep_saturates(void)
{
    for (int n = 0; n < 8; n++) {
        setUp();
        given.direct = n % 2 == 0 ? ONE : ONE / 4;
        double share = (2 - ldexp(given.direct, -30)) / 4;
        add_pole(share, 0.001);
        add_pole(share, 3);
        add_pole(n < 4 ? share : -1.0 / 2048, 4000);
        add_pole(n < 4 ? share : -1.0 / 2048, 5000);
        given.direct += n < 4 ? 0 : ONE / 1024;
        actuator.memory[0] = n % 4 < 2 ? MAX : -MAX;
        start();
        for (int k = 0; k < 40000; k++) {
            int32_t reference = k % 10000 < 2000 ? (k % 2 == 0 ? INT32_MAX : -INT32_MAX)
                                                 : (k / 10000 % 2 == 0 ? INT32_MAX : -INT32_MAX);
            int32_t drive = rdpi_q31_chain_step(&chain, reference);
            TEST_ASSERT_INT32_WITHIN(MAX, 0, drive);
            TEST_ASSERT_INT32_WITHIN(MAX, 0, chain.creep.h);
            for (size_t i = 0; i < 4; i++) {
                TEST_ASSERT_INT32_WITHIN(MAX, 0, (int32_t)(chain.creep.lag[i].state >> 32));
            }
        }
        TEST_ASSERT_EQUAL_INT32(-MAX, chain.axis.drive);
    }
}

/* Displacements up to the edge of the reach, and beyond. */
void test_displacements_saturate_at_the_reach(void)
{
    actuator.params.saturation_shift = 28;
    actuator.params.inverse_shift = 31; /* of weights 1: z = 4 v, v = z / 2 */
    fast_poles();
    for (int side = -1; side <= 1; side += 2) {
        start();
        TEST_ASSERT_INT32_WITHIN(16, side * MAX, rdpi_q31_chain_step(&chain, side < 0 ? -INT32_MAX : INT32_MAX));
        TEST_ASSERT_EQUAL_INT32(side * (ONE - 1), chain.creep.h);
        rdpi_q31_forward(&chain.axis, side * MAX, 0);
        rdpi_q31_chain_settle(&chain);
        TEST_ASSERT_EQUAL_INT32(side * (ONE - 1), chain.creep.h);
        for (int k = 0; k < 1000; k++) {
            rdpi_q31_chain_step(&chain, k % 2 == 0 ? -INT32_MAX : INT32_MAX);
        }
        TEST_ASSERT_INT32_WITHIN(ONE - 1, 0, (int32_t)(chain.creep.lag[0].state >> 32));
    }
}

void test_reset_is_power_up_again(void)
{
    rdpi_q31_chain_t fresh;
    fast_poles();
    add_pole(0.0625, 1e5);
    given.lead_ns = T_NS;
    start();
    fresh = chain;
    for (int k = 0; k < 100; k++) {
        rdpi_q31_chain_step(&chain, random_size(INT32_MAX, 8));
        rdpi_q31_chain_missed(&chain, (uint32_t)k % 3u);
    }
    rdpi_q31_chain_reset(&chain);
    for (int k = 0; k < 100; k++) {
        int32_t reference = random_size(INT32_MAX, 8);
        rdpi_q31_chain_step(&chain, reference);
        rdpi_q31_chain_step(&fresh, reference);
        TEST_ASSERT_EQUAL_INT32(fresh.axis.drive, chain.axis.drive);
        TEST_ASSERT_EQUAL_UINT32(fresh.axis.clip_count, chain.axis.clip_count);
        TEST_ASSERT_EQUAL_MEMORY(&fresh.creep, &chain.creep, sizeof fresh.creep);
    }
}

void test_settle_after_a_drive_of_someone_else(void)
{
    fast_poles();
    add_pole(0.0625, 1e5);
    start();
    rdpi_q31_chain_step(&chain, 100 * U);
    rdpi_q31_forward(&chain.axis, -300 * U, 0);
    rdpi_q31_chain_settle(&chain);
    for (int k = 0; k < 5000; k++) {
        drives(-300 * U, -300 * U);
    }
}

void test_settle_takes_the_displacement_at_rest(void)
{
    actuator.play[0].slope_rate = -ONE / 4;
    fast_poles();
    start();
    rdpi_q31_chain_step(&chain, 100 * U);
    rdpi_q31_chain_settle(&chain);
    TEST_ASSERT_EQUAL_INT32(rdpi_q31_predict(&chain.axis, chain.axis.drive, 0), chain.creep.h);
}

void test_a_step_in_the_middle_of_a_sweep_is_a_first_one(void)
{
    given.lead_ns = 4 * T_NS;
    start();
    for (int k = 0; k < 2; k++) {
        rdpi_q31_chain_step(&chain, 50 * U);
        rdpi_q31_chain_step(&chain, 51 * U);
        TEST_ASSERT_TRUE(rdpi_q31_chain_sweep(&chain));
        drives(50 * U, 50 * U);
    }
}

/* The middle of the range is 8 U. */
static void range_about_8(void)
{
    fast_poles();
    actuator.params.min_drive = 16 * U - MAX;
    actuator.params.sweep_end = MAX / 8 * 7;
}

static void settled_at_8(void)
{
    settled = before = 8 * U;
    for (size_t i = 0; i < given.poles; i++) {
        lag[i] = settled;
    }
}

void test_creep_follows_a_sweep_from_the_middle_of_the_range_on(void)
{
    range_about_8();
    actuator.params.sweep_per_us /= 16u;
    start();
    for (int k = 0; k < 40; k++) {
        rdpi_q31_chain_step(&chain, 100 * U);
    }
    settled_at_8();
    int samples = 1;
    for (; rdpi_q31_chain_sweep(&chain); samples++) {
        TEST_ASSERT_LESS_THAN_INT(10000, samples);
        displacement(chain.axis.drive, settled);
    }
    TEST_ASSERT_GREATER_THAN_INT(400, samples);
    displacement(chain.axis.drive, settled);
    for (int k = 0; k < 5000; k++) {
        tracks(64, MAX / 8 * 6 - k);
    }
}

void test_creep_follows_from_the_middle_of_the_range_for_the_time_since_a_sweep(void)
{
    const uint32_t ticks[] = {0, 1, 2, 100, 5000};
    for (size_t k = 0; k < sizeof ticks / sizeof ticks[0]; k++) {
        setUp();
        range_about_8();
        given.lead_ns = T_NS;
        start();
        rdpi_q31_chain_step(&chain, 0);
        rdpi_q31_chain_step(&chain, 100 * U);
        rdpi_q31_forward(&chain.axis, 300 * U, 0);
        rdpi_q31_chain_swept(&chain, ticks[k]);
        settled_at_8();
        for (uint32_t n = 0; n < ticks[k]; n++) {
            displacement(300 * U, settled);
        }
        for (int n = 0; n < 500; n++) {
            tracks(64, 300 * U);
        }
    }
}

void test_the_sweep_ends_with_its_share_forgotten(void)
{
    rdpi_q31_t alone;
    actuator.params.plays = 2;
    actuator.play[0].slope = ONE / 2;
    actuator.play[0].slope_rate = ONE / 4;
    actuator.play[1] = (rdpi_q31_play_t){10 * U, ONE, 0};
    actuator.params.sweep_forgotten = ONE / 4;
    actuator.params.min_drive = 16 * U - MAX;
    fast_poles();
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&alone, &actuator.params, T_NS));
    rdpi_q31_step(&alone, 100 * U / 2);
    for (int k = 0; k < 40; k++) {
        rdpi_q31_chain_step(&chain, 100 * U);
    }
    rdpi_q31_forward(&alone, chain.axis.drive, 0);
    rdpi_q31_forward(&chain.axis, chain.axis.drive, 0);
    bool goes_on = true;
    for (int samples = 0; goes_on && samples < 1000; samples++) {
        goes_on = rdpi_q31_sweep(&alone);
        TEST_ASSERT_EQUAL(goes_on, rdpi_q31_chain_sweep(&chain));
        TEST_ASSERT_EQUAL_INT32(alone.drive, chain.axis.drive);
    }
    TEST_ASSERT_FALSE(goes_on);
    rdpi_q31_forget_sweep(&alone);
    TEST_ASSERT_EQUAL_INT64(alone.bank.f_at_rest, chain.axis.bank.f_at_rest);
    TEST_ASSERT_EQUAL_INT32(rdpi_q31_predict(&alone, alone.drive, 0), chain.creep.h);
    /* Creep had settled in the middle of the range, where all plays are. */
    TEST_ASSERT_EQUAL_INT64((ONE - given.direct - pole[0].share - pole[1].share - pole[2].share) * (int64_t)(8 * U),
                            chain.creep.settled);
}
