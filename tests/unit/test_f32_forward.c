/* rdpi_f32: prediction, and the model with states that follow. */
#include "unity.h"

#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#include "axis_f32.inc"
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

void test_forward_is_the_actuator_by_definition(void)
{
    start();
    plant_at_rest();
    for (int k = 0; k < 500; k++) {
        double drive_V = 2 * sin(0.03 * k) + 3 * sin(0.2 * k) + 1, rate_um_per_s = 128 + 128 * sin(0.01 * k);
        EQUAL(plant((double)(rdpi_real_t)drive_V, rate_um_per_s),
                   rdpi_f32_forward(&axis, (rdpi_real_t)drive_V, (rdpi_real_t)rate_um_per_s));
    }
}

void test_forward_of_a_drive_that_is_not_finite_changes_no_state(void)
{
    forward_changes_nothing(NAN, 0);
    forward_changes_nothing(INFINITY, 0);
    forward_changes_nothing(-INFINITY, 0);
}

void test_forward_of_a_drive_so_large_that_the_displacement_overflows_changes_no_state(void)
{
    const rdpi_real_t large_V = (rdpi_real_t)(sizeof(rdpi_real_t) == sizeof(float) ? 3e38 : 1.5e308);
    forward_changes_nothing(large_V, 0);
    forward_changes_nothing(-large_V, 0);
}

void test_forward_of_a_drive_over_16_spans_outside_the_range_changes_no_state(void)
{
    rdpi_real_t reach_V = 16 * (given.params.max_V - given.params.min_V);
    forward_changes_nothing(given.params.max_V + reach_V + 1, 0);
    forward_changes_nothing(given.params.min_V - reach_V - 1, 0);
    rdpi_f32_forward(&axis, given.params.max_V + reach_V - 1, 0);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    rdpi_f32_forward(&axis, given.params.min_V - reach_V + 1, 0);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

void test_forward_at_a_rate_that_is_not_finite_changes_no_state(void)
{
    forward_changes_nothing(0, NAN);
    forward_changes_nothing(0, INFINITY);
}

void test_forward_at_a_negative_rate_changes_no_state(void)
{
    forward_changes_nothing(0, -1);
    forward_changes_nothing(0, -INFINITY);
}

/* Enabled anywhere along someone else's drive, the step begins with that drive. */
void test_a_step_to_the_displacement_that_forward_returned_goes_on_without_a_bump(void)
{
    start();
    for (int k = 0; k < 500; k++) {
        rdpi_real_t drive_V = (rdpi_real_t)(7 * sin(0.05 * k) + 6 * sin(0.31 * k));
        rdpi_real_t reference_um = rdpi_f32_forward(&axis, drive_V, 0);
        rdpi_f32_t enabled = axis;
        EQUAL(drive_V, rdpi_f32_step(&enabled, reference_um));
        EQUAL(0, enabled.rate_um_per_s);
        TEST_ASSERT_EQUAL_UINT32(0, enabled.flags);
    }
}

void test_enabling_at_a_dac_code_begins_with_that_code(void)
{
    five_bit_dac();
    start();
    for (uint32_t k = 0; k < 200; k++) {
        uint32_t code = k * k * 7 % 32;
        rdpi_real_t reference_um = rdpi_f32_forward(&axis, (rdpi_real_t)code / 2 - 8, 0);
        rdpi_f32_t enabled = axis;
        rdpi_f32_step(&enabled, reference_um);
        TEST_ASSERT_EQUAL_UINT32(code, enabled.dac_code);
    }
}

/* 20 V is x = 38; back at 15 V, x = 28, the plays hang behind. */
void test_forward_outside_the_range_moves_the_plays_and_keeps_the_drive_inside(void)
{
    start();
    rdpi_real_t reference_um = rdpi_f32_forward(&axis, 20, 0);
    SAME(given.params.max_V, axis.drive_V);
    equal_memory(38, 37, 35);
    SAME(given.params.max_V, *(const rdpi_real_t[]){rdpi_f32_step(&axis, reference_um)});
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags);
    equal_memory(28, 29, 31);
    rdpi_f32_forward(&axis, -20, 0);
    SAME(given.params.min_V, axis.drive_V);
    equal_memory(-42, -41, -39);
}

/* ---- prediction ---- */

void test_predict_says_what_forward_would_and_changes_no_bit(void)
{
    start();
    plant_at_rest();
    for (int k = 0; k < 500; k++) {
        rdpi_real_t drive_V = (rdpi_real_t)(9 * sin(0.05 * k) + 8 * sin(0.31 * k)), rate = (rdpi_real_t)(k % 7 * 50);
        rdpi_f32_t before;
        memcpy(&before, &axis, sizeof axis);
        rdpi_real_t predicted_um = rdpi_f32_predict(&axis, drive_V, rate);
        TEST_ASSERT_EQUAL_MEMORY(&before, &axis, sizeof axis);
        EQUAL(plant((double)drive_V, fmin((double)rate, 256)), predicted_um);
        rdpi_real_t displacement_um = rdpi_f32_forward(&axis, drive_V, rate);
        SAME(displacement_um, predicted_um);
    }
}

void test_predict_is_nan_for_an_input_that_is_nan_or_a_negative_rate(void)
{
    start();
    TEST_ASSERT_FLOAT_IS_NAN((float)rdpi_f32_predict(&axis, NAN, 0));
    TEST_ASSERT_FLOAT_IS_NAN((float)rdpi_f32_predict(&axis, 0, NAN));
    TEST_ASSERT_FLOAT_IS_NAN((float)rdpi_f32_predict(&axis, 0, -1));
}
