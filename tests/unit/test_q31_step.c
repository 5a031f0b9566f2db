/* rdpi_q31: the step, references that it cannot use, counters, several instances. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#include "axis_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What both siblings do. */
void test_first_step_is_solved_at_rate_zero(void);
void test_second_step_is_solved_with_the_slopes_of_its_rate(void);
void test_step_undoes_the_saturation_stage(void);
void test_step_returns_what_it_stores(void);
void test_rate_window_and_filter_act_in_the_chain(void);
void test_flags_are_those_of_the_latest_step_and_counts_stay(void);
void test_guard_count_stays_at_its_largest_value(void);
void test_clip_count_stays_at_its_largest_value(void);
void test_input_count_stays_at_its_largest_value(void);
void test_instances_in_turns_do_what_each_does_alone(void);
#include "axis_step.inc"

void test_drive_makes_the_actuator_follow_the_reference_at_every_rate(void)
{
    given.params.rate_window_ns = 3 * T_NS;
    given.params.rate_filter_ns = 5 * T_NS;
    start();
    plant_at_rest();
    int32_t reference = 0;
    for (int k = 0; k < 5000; k++) {
        int32_t step = random_size(U, 6);
        reference += reference + step > 8 * U || reference + step < -8 * U ? -step : step;
        follows(reference);
        TEST_ASSERT_EQUAL_UINT32(0, axis.flags & ~(uint32_t)RDPI_FLAG_GUARD);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(20, axis.guard_count);
    TEST_ASSERT_LESS_THAN_UINT32(4900, axis.guard_count);
}

void test_every_reference_but_one_is_usable(void)
{
    start();
    TEST_ASSERT_EQUAL_INT32(28 * U, rdpi_q31_step(&axis, INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(-32 * U, rdpi_q31_step(&axis, -INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(-32 * U, rdpi_q31_step(&axis, INT32_MIN + 1));
    TEST_ASSERT_EQUAL_UINT32(0, axis.input_count);
}

/* The steepest stage there is makes 2^62 of the largest reference. */
void test_a_sum_beyond_any_drive_saturates_either_way_and_does_not_wrap(void)
{
    one_slope(ONE);
    whole_format();
    given.params.inverse_shift = 0;
    given.inverse_saturation[0].weight = INT32_MAX;
    start();
    const int32_t references[] = {1, 2, 3, 1000, 0x40000001, INT32_MAX};
    for (size_t k = 0; k < 6; k++) {
        TEST_ASSERT_EQUAL_INT32(MAX, rdpi_q31_step(&axis, references[k]));
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags & RDPI_FLAG_RANGE);
        TEST_ASSERT_EQUAL_INT32(-MAX, rdpi_q31_step(&axis, -references[k]));
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags & RDPI_FLAG_RANGE);
    }
    TEST_ASSERT_EQUAL_UINT32(12, axis.clip_count);
}

void test_the_smallest_and_the_largest_slope_reach_both_ends_of_the_format(void)
{
    const int32_t slopes[] = {RDPI_Q31_MIN_SLOPE, ONE};
    for (size_t k = 0; k < 2; k++) {
        one_slope(slopes[k]);
        whole_format();
        start();
        int32_t last = slopes[k] / 2; /* what MAX needs */
        TEST_ASSERT_INT32_WITHIN(512, MAX - ONE / slopes[k], rdpi_q31_step(&axis, last - 1));
        TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
        TEST_ASSERT_INT32_WITHIN(512, -MAX, rdpi_q31_step(&axis, -last));
        rdpi_q31_step(&axis, -last - 1000);
        TEST_ASSERT_EQUAL_INT32(-MAX, axis.drive);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags & RDPI_FLAG_RANGE);
        TEST_ASSERT_EQUAL_INT32(MAX, rdpi_q31_step(&axis, FAR)); /* all the way in one step */
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags & RDPI_FLAG_RANGE);
    }
}

void test_the_largest_thresholds_and_jumps_stay_exact(void)
{
    whole_format();
    given.play[1].r = MAX - 1;
    given.play[2].r = MAX;
    start();
    plant_at_rest();
    const int32_t references[] = {FAR, -FAR, 0, FAR, 1, -1, -FAR, 123456789, -123456789};
    for (size_t k = 0; k < sizeof references / sizeof references[0]; k++) {
        plant(rdpi_q31_step(&axis, references[k]), 0);
        equal_plant_memory();
    }
}

/* The claim is 2^-20 of MAX, 512 units; x = 64 z, so that a unit of v is 64 of x. */
void test_no_rounding_adds_up_from_step_to_step(void)
{
    one_slope(RDPI_Q31_MIN_SLOPE);
    start();
    for (int k = 0; k < 20000; k++) {
        int32_t z = random_between(-20 * U / 64, 20 * U / 64);
        TEST_ASSERT_INT32_WITHIN(256, 64 * z, rdpi_q31_step(&axis, z));
    }
}

/* ---- no reference ---- */

/* But for a sample that counts as missed. */
void test_no_reference_changes_no_state_and_holds_the_drive(void)
{
    rdpi_q31_t twin;
    given.params.rate_window_ns = 3 * T_NS;
    given.params.rate_filter_ns = 2 * T_NS;
    given.params.sweep_end = 0;
    given.params.max_drive = 3 * U;
    actuator_q31_codes(&given, 12, false);
    start();
    for (int32_t k = 0; k < 5; k++) {
        rdpi_q31_step(&axis, k * k * U / 4);
    }
    memcpy(&twin, &axis, sizeof axis);

    TEST_ASSERT_EQUAL_INT32(twin.drive, rdpi_q31_step(&axis, NONE));

    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
    rdpi_q31_missed(&twin, 1);
    twin.missed_count = 0;
    twin.input_count = 1;
    twin.flags = RDPI_FLAG_INPUT;
    TEST_ASSERT_EQUAL_MEMORY(&twin, &axis, sizeof axis);
    for (int32_t k = 0; k < 20; k++) { /* and it goes on as if there had been no sample */
        TEST_ASSERT_EQUAL_INT32(rdpi_q31_step(&twin, (10 - k) * U / 3), rdpi_q31_step(&axis, (10 - k) * U / 3));
        TEST_ASSERT_EQUAL_UINT32(twin.flags, axis.flags);
    }
}

void test_no_reference_at_first_holds_the_drive_of_the_memory_and_starts_no_history(void)
{
    set3(given.memory, U / 4, 0, 0);
    start();
    TEST_ASSERT_EQUAL_INT32(U / 4, rdpi_q31_step(&axis, NONE));
    rdpi_q31_step(&axis, U / 2); /* as a first step: rate 0 */
    TEST_ASSERT_EQUAL_INT32(0, axis.rate);
    rdpi_q31_step(&axis, U / 8 * 5);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, axis.rate);
}
