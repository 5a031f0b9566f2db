/* rdpi_f32: the step, references that it cannot use, counters, several instances. */
#include "unity.h"

#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#include "axis_f32.inc"
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

void test_negative_gain_turns_the_drive_over(void)
{
    given.curve[0].gain_um_per_V = -2;
    start();
    EQUAL(-1, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    equal_memory(4, 3, 1);
}

void test_one_play_and_one_piece_make_a_gain(void)
{
    given.params.plays = 1;
    given.params.deadzones = 1;
    start();
    EQUAL(4, rdpi_f32_step(&axis, (rdpi_real_t)3.25)); /* x = 3 / 0.5 */
    EQUAL(-0.5, rdpi_f32_step(&axis, (rdpi_real_t)-0.5)); /* at the guard: x = -0.75 / 0.25 */
}

void test_drive_makes_the_actuator_follow_the_reference_at_every_rate(void)
{
    given.params.rate_window_s = 3 * T_S;
    given.params.rate_filter_s = 5 * T_S;
    start();
    plant_at_rest();
    for (int k = 0; k < 2000; k++) {
        double t = k / 1024.0, reference_um = 4 * sin(6 * t) + 1.5 * sin(40 * t + 1) + (k > 1000 ? 2 : 0);
        double drive_V = (double)rdpi_f32_step(&axis, (rdpi_real_t)reference_um);
        EQUAL(reference_um, plant(drive_V, (double)axis.rate_um_per_s));
        TEST_ASSERT_EQUAL_UINT32(0, axis.flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW | RDPI_FLAG_INPUT));
    }
    TEST_ASSERT_GREATER_THAN_UINT32(0, axis.guard_count);
    TEST_ASSERT_LESS_THAN_UINT32(1000, axis.guard_count);
}

void test_instances_that_share_parameters_do_not_disturb_each_other(void)
{
    rdpi_f32_t other;
    rdpi_real_t alone[50];
    start();
    for (int k = 0; k < 50; k++) {
        alone[k] = rdpi_f32_step(&axis, (rdpi_real_t)(k % 7));
    }
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&other, &given.params, 2 * T_S));
    for (int k = 0; k < 50; k++) {
        rdpi_real_t drive_V = rdpi_f32_step(&axis, (rdpi_real_t)(k % 7));
        rdpi_f32_step(&other, (rdpi_real_t)(k % 5 - 2));
        SAME(alone[k], drive_V);
    }
}

/* ---- input that cannot be used ---- */

/* But for a sample that counts as missed. */
static void input_changes_nothing(rdpi_real_t reference_um)
{
    rdpi_f32_t twin;
    setUp();
    given.params.rate_window_s = 3 * T_S;
    given.params.rate_filter_s = 2 * T_S;
    given.params.max_V = (rdpi_real_t)2.5;
    given.params.dac_bits = 12;
    start();
    for (int k = 0; k < 5; k++) {
        rdpi_f32_step(&axis, (rdpi_real_t)(k * k) / 4);
    }
    memcpy(&twin, &axis, sizeof axis);

    rdpi_real_t drive_V = rdpi_f32_step(&axis, reference_um);

    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
    SAME(twin.drive_V, drive_V);
    SAME(twin.drive_V, axis.drive_V);
    SAME(twin.rate_um_per_s, axis.rate_um_per_s);
    SAME(twin.ramp_V, axis.ramp_V);
    TEST_ASSERT_EQUAL_MEMORY(&twin.rate_estimator, &axis.rate_estimator, sizeof axis.rate_estimator);
    TEST_ASSERT_EQUAL_MEMORY(&twin.bank, &axis.bank, sizeof axis.bank);
    TEST_ASSERT_EQUAL_UINT32(twin.dac_code, axis.dac_code);
    TEST_ASSERT_EQUAL_UINT32(twin.guard_count, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(twin.clip_count, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(twin.missed_count, axis.missed_count);
    rdpi_f32_missed(&twin, 1);
    for (int k = 0; k < 20; k++) { /* and it goes on as if there had been no sample */
        rdpi_real_t expected_V = rdpi_f32_step(&twin, (rdpi_real_t)(10 - k) / 3);
        drive_V = rdpi_f32_step(&axis, (rdpi_real_t)(10 - k) / 3);
        SAME(expected_V, drive_V);
        TEST_ASSERT_EQUAL_UINT32(twin.flags, axis.flags);
    }
}

void test_a_reference_that_is_not_a_number_changes_no_state_and_holds_the_drive(void)
{
    input_changes_nothing(NAN);
}

void test_an_infinite_reference_changes_no_state_and_holds_the_drive(void)
{
    input_changes_nothing(INFINITY);
    input_changes_nothing(-INFINITY);
}

void test_a_reference_beyond_the_largest_changes_no_state_and_holds_the_drive(void)
{
    input_changes_nothing((rdpi_real_t)RDPI_MAX_REFERENCE_UM + 1);
    input_changes_nothing(-(rdpi_real_t)RDPI_MAX_REFERENCE_UM - 1);
}

void test_the_largest_reference_is_still_used(void)
{
    start();
    EQUAL(15, rdpi_f32_step(&axis, RDPI_MAX_REFERENCE_UM));
    EQUAL(-16, rdpi_f32_step(&axis, -RDPI_MAX_REFERENCE_UM));
    TEST_ASSERT_EQUAL_UINT32(0, axis.input_count);
}

void test_an_unusable_first_reference_holds_the_drive_of_the_memory_and_starts_no_history(void)
{
    start();
    EQUAL(1, rdpi_f32_step(&axis, NAN));
    EQUAL(1.25, rdpi_f32_step(&axis, (rdpi_real_t)0.5)); /* as a first step: rate 0 */
    EQUAL(0, axis.rate_um_per_s);
    EQUAL(1.5, rdpi_f32_step(&axis, (rdpi_real_t)0.625));
    EQUAL(128, axis.rate_um_per_s);
}
