/* rdpi_q31: the start-up sweep. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#include "axis_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* A whole sweep, its plant moving along: each sample goes `step` towards the next of `count` turning points and stops
 * there, and the last sample alone returns false. */
static void sweeps_through(const int32_t *turns, size_t count, int32_t step)
{
    int32_t drive = axis.drive;
    for (size_t turn = 0; turn < count;) {
        int64_t left = (int64_t)turns[turn] - drive;
        bool arrives = left <= step && left >= -step;
        drive = arrives ? turns[turn] : (left > 0 ? drive + step : drive - step);
        turn += arrives;
        TEST_ASSERT_EQUAL(turn < count, rdpi_q31_sweep(&axis));
        TEST_ASSERT_EQUAL_INT32(drive, axis.drive);
        TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
        TEST_ASSERT_EQUAL_INT32(0, axis.rate);
        plant(drive, 0);
        equal_plant_memory();
    }
}

static const int32_t four_cycles_to_4[] = {28 * U, -32 * U, 22 * U, -23 * U, 16 * U, -14 * U, 10 * U, -5 * U, 4 * U};
static const int32_t four_cycles_to_the_end[] = {28 * U, -32 * U, 28 * U, -17 * U, 28 * U, -2 * U, 28 * U,
                                                 13 * U, 28 * U};

/* What both siblings do. */
void test_sweep_closes_in_on_its_end_in_cycles_of_equal_decrements(void);
void test_sweep_of_one_cycle_goes_up_down_and_to_its_end(void);
void test_sweep_stops_at_turning_points_that_its_steps_do_not_meet(void);
void test_sweep_to_the_end_of_the_range_returns_there_after_every_cycle(void);
void test_sweep_after_the_last_is_another_whole_one(void);
void test_sweep_begins_from_the_present_drive_without_a_jump(void);
void test_sweep_wipes_out_what_the_plays_remember(void);
void test_sweep_leaves_what_is_not_forgotten(void);
void test_sweep_forgets_nothing_by_itself(void);
void test_sweep_forgets_no_less_than_nothing_and_no_more_than_all(void);
void test_sweep_ignores_the_slew_limit_it_cannot_exceed(void);
void test_reset_makes_the_next_sweep_begin_anew(void);
void test_memory_set_makes_the_next_sweep_begin_anew(void);
void test_forward_makes_the_next_sweep_begin_anew(void);
void test_sweep_given_up_half_way_leaves_states_that_steps_go_on_from(void);
void test_sweep_forgets_rate_history_and_missed_samples(void);
void test_sweep_clears_the_flags_of_the_step_before(void);
#include "axis_sweep.inc"

void test_a_sweep_after_steps_starts_from_the_drive(void)
{
    actuator_q31_codes(&given, 5, false);
    start();
    rdpi_q31_step(&axis, U / 4);
    int64_t drive = (int64_t)axis.drive * ((int64_t)1 << 32);
    TEST_ASSERT_TRUE(axis.ramp != drive); /* the wish is no code */
    rdpi_q31_sweep(&axis);
    TEST_ASSERT_EQUAL_INT64(drive + axis.sweep_step, axis.ramp);
}

void test_a_sweep_after_slewing_goes_on_from_the_drive_before_rounding(void)
{
    actuator_q31_codes(&given, 5, false);
    given.params.slew_per_us = given.params.sweep_per_us;
    start();
    rdpi_q31_step(&axis, U);
    int64_t ramp = axis.ramp;
    TEST_ASSERT_TRUE(ramp != (int64_t)axis.drive * ((int64_t)1 << 32));
    rdpi_q31_sweep(&axis);
    TEST_ASSERT_EQUAL_INT64(ramp + axis.sweep_step, axis.ramp);
}

/* Its highest voltage is where x is lowest. */
void test_sweep_with_a_negative_gain_goes_down_first(void)
{
    const int32_t turns[] = {-32 * U, 28 * U, -23 * U, 22 * U, -14 * U, 16 * U, -5 * U, 10 * U, 4 * U};
    given.params.drive_of_code_0 = 28 * U;
    actuator_q31_seal(&given);
    refused_as_they_are(RDPI_OK);
    plant_at_rest();
    sweeps_through(turns, 9, U / 8);
}

void test_sweep_over_the_whole_format_does_not_overflow(void)
{
    const int32_t turns[] = {MAX, -MAX, MAX, 0, MAX};
    const int32_t turned[] = {MAX, -MAX, 0, -MAX, -MAX};
    whole_format();
    given.params.sweep_cycles = 2;
    given.params.sweep_end = MAX;
    given.params.sweep_per_us = PER_SAMPLE(12345678);
    start();
    plant_at_rest();
    sweeps_through(turns, 5, 12345678);
    given.params.sweep_end = -MAX;
    start();
    plant_at_rest();
    sweeps_through(turned, 5, 12345678);
}

void test_the_fastest_sweep_takes_one_sample_from_turn_to_turn(void)
{
    const int32_t turns[] = {MAX, -MAX, MAX / 2, -MAX / 2, 0};
    whole_format();
    given.params.sweep_cycles = 2;
    given.params.sweep_end = 0;
    given.params.sweep_per_us = UINT64_MAX;
    start();
    plant_at_rest();
    for (size_t k = 0; k < 5; k++) {
        TEST_ASSERT_EQUAL(k < 4, rdpi_q31_sweep(&axis));
        TEST_ASSERT_EQUAL_INT32(turns[k], axis.drive);
    }
}

void test_the_slowest_sweep_goes_a_2_to_the_minus_32nd_of_a_unit_a_sample(void)
{
    given.params.guard_exponent = -31;
    given.params.sweep_per_us = 1000;
    starts_with_sample_time(1);
    for (int64_t k = 1; k <= 10; k++) {
        TEST_ASSERT_TRUE(rdpi_q31_sweep(&axis));
        TEST_ASSERT_EQUAL_INT32(0, axis.drive);
        TEST_ASSERT_EQUAL_INT64(k, axis.ramp);
    }
}

/* Decrements of 60 U / 10000 and less: each turn is where the definition has it, to a unit. */
void test_sweep_of_the_most_cycles_closes_in_to_the_end(void)
{
    given.params.sweep_cycles = 10000;
    given.params.sweep_end = 0;
    given.params.sweep_per_us = UINT64_MAX;
    start();
    for (int32_t turns = 20001; turns > 0; turns--) {
        TEST_ASSERT_EQUAL(turns > 1, rdpi_q31_sweep(&axis));
        double limit = turns % 2 ? 28 * U : -32 * U;
        TEST_ASSERT_DOUBLE_WITHIN(1, limit * (turns / 2) / 10000, axis.drive);
    }
    TEST_ASSERT_EQUAL_INT32(0, axis.drive);
}

/* An eighth of a code a sample: it must not get stuck. */
void test_sweep_outputs_dac_codes_from_end_to_end_and_the_plays_follow_them(void)
{
    for (int falling = 0; falling < 2; falling++) {
        uint32_t lowest = 31, highest = 0;
        bool goes_on = true;
        five_bit_dac();
        actuator_q31_codes(&given, 5, falling);
        given.params.sweep_end = U / 5 * 2; /* nearest: 0 */
        start();
        plant_at_rest();
        for (int k = 0; goes_on; k++) {
            TEST_ASSERT_LESS_THAN_INT(3000, k);
            goes_on = rdpi_q31_sweep(&axis);
            int32_t code = (int32_t)axis.dac_code;
            TEST_ASSERT_EQUAL_INT32(falling ? (15 - code) * U : (code - 16) * U, axis.drive);
            lowest = axis.dac_code < lowest ? axis.dac_code : lowest;
            highest = axis.dac_code > highest ? axis.dac_code : highest;
            plant(axis.drive, 0);
            equal_plant_memory();
        }
        TEST_ASSERT_EQUAL_INT32(0, axis.drive);
        TEST_ASSERT_EQUAL_UINT32(0, lowest);
        TEST_ASSERT_EQUAL_UINT32(31, highest);
    }
}

void test_sweep_leaves_states_within_reach_whatever_is_forgotten(void)
{
    int32_t all[PLAYS], left[PLAYS];
    for (int32_t end = -32; end <= 28; end += 60) { /* plays above x, plays below */
        for (int32_t one_of = 2; one_of < 1000; one_of += 7) {
            given.params.sweep_end = end * U;
            given.params.sweep_forgotten = RDPI_Q31_ONE / one_of;
            start();
            while (rdpi_q31_sweep(&axis)) {
            }
            rdpi_q31_get_memory(&axis, all);
            rdpi_q31_forget_sweep(&axis);
            rdpi_q31_get_memory(&axis, left);
            for (size_t i = 0; i < PLAYS; i++) {
                double kept = 1 - (double)given.params.sweep_forgotten / RDPI_Q31_ONE;
                TEST_ASSERT_INT_WITHIN(1, (int)(all[0] + kept * (all[i] - all[0])), left[i]);
                TEST_ASSERT_TRUE(end < 0 ? left[i] <= all[i] : left[i] >= all[i]);
            }
            TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, left));
        }
    }
}
