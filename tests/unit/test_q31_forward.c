/* rdpi_q31: prediction, and the model with states that follow. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#include "axis_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What both siblings do. */
void test_predict_uses_the_slopes_of_the_rate_given_up_to_the_guard(void);
void test_predict_does_not_limit_the_drive(void);
void test_forward_predicts_the_displacement_of_a_drive(void);
void test_forward_uses_the_slopes_of_the_rate_given(void);
void test_forward_clamps_the_rate_at_the_guard(void);
void test_forward_clears_the_flags_of_the_call_before(void);
void test_forward_remembers(void);
void test_refused_forward_outside_the_range_predicts_for_the_drive_inside(void);
void test_forward_drive_has_the_nearest_code(void);
void test_forward_counts_no_clip(void);
void test_slew_starts_from_the_drive_of_forward(void);
void test_forward_forgets_rate_history_and_missed_samples(void);
void test_forward_counts_in_input_count_and_guard_count_up_to_their_largest_values(void);
#include "axis_forward.inc"

void test_predict_says_what_forward_would_and_changes_no_bit(void)
{
    start();
    plant_at_rest();
    for (int k = 0; k < 1000; k++) {
        int32_t drive = random_size(MAX, 10), rate = random_between(0, INT32_MAX);
        rdpi_q31_t before;
        memcpy(&before, &axis, sizeof axis);
        int32_t predicted = rdpi_q31_predict(&axis, drive, rate);
        TEST_ASSERT_EQUAL_MEMORY(&before, &axis, sizeof axis);
        TEST_ASSERT_DOUBLE_WITHIN(8, plant(drive, rate < ONE ? rate : ONE), predicted);
        TEST_ASSERT_EQUAL_INT32(predicted, rdpi_q31_forward(&axis, drive, rate));
        equal_plant_memory();
    }
}

void test_predict_has_no_displacement_for_a_negative_rate_or_a_drive_beyond_the_largest(void)
{
    const int32_t drives[] = {MAX + 1, -MAX - 1, INT32_MAX, INT32_MIN};
    start();
    TEST_ASSERT_EQUAL_INT32(NONE, rdpi_q31_predict(&axis, 0, -1));
    TEST_ASSERT_EQUAL_INT32(NONE, rdpi_q31_predict(&axis, 0, INT32_MIN));
    for (size_t k = 0; k < 4; k++) {
        TEST_ASSERT_EQUAL_INT32(NONE, rdpi_q31_predict(&axis, drives[k], 0));
    }
    TEST_ASSERT_NOT_EQUAL_INT32(NONE, rdpi_q31_predict(&axis, MAX, 0));
    TEST_ASSERT_NOT_EQUAL_INT32(NONE, rdpi_q31_predict(&axis, -MAX, 0));
}

/* Gain 4 at slope ONE: the largest drive makes 2^31. Gain 2^29 would make 2^59. */
void test_predict_saturates_either_way_and_never_at_no_reference(void)
{
    const uint8_t shifts[] = {0, 28, 27};
    one_slope(ONE);
    given.saturation[0].weight = 1 << 29;
    for (size_t k = 0; k < 3; k++) {
        given.params.saturation_shift = shifts[k];
        start();
        TEST_ASSERT_EQUAL_INT32(k == 1 ? ONE : INT32_MAX, rdpi_q31_predict(&axis, MAX, 0));
        TEST_ASSERT_EQUAL_INT32(k == 1 ? -ONE : -INT32_MAX, rdpi_q31_predict(&axis, -MAX, 0));
    }
    TEST_ASSERT_EQUAL_INT32(INT32_MAX - 3, rdpi_q31_predict(&axis, MAX - 1, 0));
    TEST_ASSERT_EQUAL_INT32(-INT32_MAX + 3, rdpi_q31_predict(&axis, -MAX + 1, 0));
}

/* ---- the forward model ---- */

void test_forward_of_an_unusable_input_changes_no_state(void)
{
    forward_changes_nothing(MAX + 1, 0);
    forward_changes_nothing(-MAX - 1, 0);
    forward_changes_nothing(NONE, 0);
    forward_changes_nothing(INT32_MAX, ONE);
    forward_changes_nothing(0, -1);
    forward_changes_nothing(0, INT32_MIN);
}

/* Enabled anywhere along someone else's drive, the step begins with that drive: z is rounded, W >= 1/4 and S >= 1. */
void test_a_step_to_the_displacement_that_forward_returned_goes_on_without_a_bump(void)
{
    start();
    for (int k = 0; k < 1000; k++) {
        int32_t drive = random_between(-27 * U, 27 * U);
        int32_t reference = rdpi_q31_forward(&axis, drive, 0);
        rdpi_q31_t enabled = axis;
        NEAR(drive, rdpi_q31_step(&enabled, reference));
        TEST_ASSERT_EQUAL_INT32(0, enabled.rate);
        TEST_ASSERT_EQUAL_UINT32(0, enabled.flags);
    }
}

void test_enabling_at_a_dac_code_begins_with_that_code(void)
{
    for (int falling = 0; falling < 2; falling++) {
        five_bit_dac();
        actuator_q31_codes(&given, 5, falling);
        start();
        for (int32_t k = 0; k < 200; k++) {
            int32_t code = k * k * 7 % 32;
            int32_t reference = rdpi_q31_forward(&axis, falling ? (15 - code) * U : (code - 16) * U, 0);
            rdpi_q31_t enabled = axis;
            rdpi_q31_step(&enabled, reference);
            TEST_ASSERT_EQUAL_INT32(code, (int32_t)enabled.dac_code);
        }
    }
}

/* From x = 40 back to 28 the plays hang behind. */
void test_forward_outside_the_range_moves_the_plays_and_keeps_the_drive_inside(void)
{
    start();
    int32_t reference = rdpi_q31_forward(&axis, 40 * U, 0);
    TEST_ASSERT_EQUAL_INT32(28 * U, axis.drive);
    equal_memory(40 * U, 39 * U, 37 * U);
    TEST_ASSERT_EQUAL_INT32(28 * U, rdpi_q31_step(&axis, reference));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags);
    equal_memory(28 * U, 29 * U, 31 * U);
    rdpi_q31_forward(&axis, -MAX, 0);
    TEST_ASSERT_EQUAL_INT32(-32 * U, axis.drive);
    equal_memory(-MAX, -MAX + U, -MAX + 3 * U);
    rdpi_q31_forward(&axis, MAX, 0);
    TEST_ASSERT_EQUAL_INT32(28 * U, axis.drive);
    equal_memory(MAX, MAX - U, MAX - 3 * U);
}
