/* rdpi_q31: what init refuses and accepts, and the state that it leaves. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#include "axis_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What both siblings do. */
void test_init_refuses_a_caller_of_another_layout_before_all_else(void);
void test_init_refuses_no_instance(void);
void test_init_refuses_no_parameters(void);
void test_init_refuses_no_array_of_plays(void);
void test_init_refuses_no_saturation(void);
void test_init_refuses_no_inverse_of_the_saturation(void);
void test_init_refuses_no_memory(void);
void test_init_refuses_another_schema(void);
void test_init_refuses_no_plays(void);
void test_init_refuses_more_plays_than_the_maximum(void);
void test_init_refuses_no_pieces_of_saturation(void);
void test_init_refuses_more_dead_zones_than_the_maximum(void);
void test_init_refuses_a_rate_window_of_too_many_samples(void);
void test_init_leaves_the_drive_that_holds_the_memory(void);
void test_init_with_memory_zero_starts_at_rest(void);
void test_init_refuses_noise_shaping_that_the_library_does_not_have(void);
void test_init_takes_the_shortest_and_the_longest_sample_time_of_the_parameters(void);
void test_init_refuses_a_shorter_sample_time_than_the_parameters_allow(void);
void test_init_refuses_a_longer_sample_time_than_the_parameters_allow(void);
void test_init_takes_any_sample_time_if_the_parameters_say_nothing(void);
void test_init_names_the_range_of_sample_times_before_what_follows_from_a_wrong_one(void);
void test_init_refuses_no_sample_time_whatever_their_range(void);
#include "axis_init.inc"

void test_init_accepts_as_many_plays_and_dead_zones_as_the_maxima(void)
{
    given.params.plays = RDPI_MAX_PLAYS;
    given.params.deadzones = RDPI_MAX_DEADZONES;
    for (int32_t i = PLAYS; i < RDPI_MAX_PLAYS; i++) {
        given.play[i] = (rdpi_q31_play_t){(i + 1) * U, ONE / 2 + i, i};
    }
    for (int32_t j = DEADZONES; j < RDPI_MAX_DEADZONES; j++) {
        given.saturation[j] = (rdpi_q31_deadzone_t){j * U, 1000};
        given.inverse_saturation[j] = (rdpi_q31_deadzone_t){(j + 1) * U, -1000};
    }
    start();
    NEAR(4 * U, rdpi_q31_step(&axis, 3 * U));
}

void test_init_accepts_one_play_and_one_piece(void)
{
    one_slope(ONE);
    start();
    NEAR(3 * U, rdpi_q31_step(&axis, 3 * U));
}

void test_init_refuses_a_first_threshold_that_is_not_zero(void)
{
    given.play[0].r = 1;
    refused(RDPI_ERR_THRESHOLDS);
    given.play[0].r = -1;
    refused(RDPI_ERR_THRESHOLDS);
}

void test_init_refuses_thresholds_that_do_not_rise(void)
{
    given.play[2].r = U;
    refused(RDPI_ERR_THRESHOLDS);
    given.play[2].r = U - 1;
    refused(RDPI_ERR_THRESHOLDS);
    given.play[2].r = U + 1;
    start();
}

void test_init_refuses_thresholds_beyond_the_largest_drive(void)
{
    given.play[2].r = MAX + 1;
    refused(RDPI_ERR_THRESHOLDS);
    given.play[2].r = MAX;
    start();
}

void test_init_refuses_slopes_outside_the_format_at_rest(void)
{
    const int32_t bad[] = {RDPI_Q31_MIN_SLOPE - 1, 0, -1, INT32_MIN, ONE + 1, INT32_MAX};
    const int32_t good[] = {RDPI_Q31_MIN_SLOPE, ONE};
    for (size_t k = 0; k < sizeof bad / sizeof bad[0]; k++) {
        given.play[2].slope = bad[k];
        refused(RDPI_ERR_SLOPES);
    }
    for (size_t k = 0; k < 2; k++) {
        given.play[2].slope = good[k];
        start();
    }
}

void test_init_refuses_slopes_outside_the_format_at_the_guard(void)
{
    given.params.min_slope_ratio = 1;
    given.play[2].slope_rate = ONE - given.play[2].slope + 1;
    refused(RDPI_ERR_GUARD);
    given.play[2].slope_rate--;
    start();
    given.play[2].slope_rate = RDPI_Q31_MIN_SLOPE - given.play[2].slope - 1;
    refused(RDPI_ERR_GUARD);
    given.play[2].slope_rate++;
    start();
    given.play[2].slope_rate = INT32_MIN;
    refused(RDPI_ERR_GUARD);
    given.play[2].slope_rate = INT32_MAX;
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_slope_that_falls_below_its_ratio_at_the_guard(void)
{
    given.play[0].slope_rate = -ONE / 8 - 1;
    refused(RDPI_ERR_GUARD);
    given.play[0].slope_rate = -ONE / 8;
    start();
    given.params.min_slope_ratio = 32769;
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_slope_ratio_of_zero_and_accepts_the_smallest_and_the_largest(void)
{
    given.params.min_slope_ratio = 0;
    refused(RDPI_ERR_GUARD);
    given.params.min_slope_ratio = 1;
    start();
    without_rate_law();
    given.params.min_slope_ratio = UINT16_MAX;
    start();
}

void test_init_refuses_a_first_dead_zone_that_is_not_zero_in_either_stage(void)
{
    given.saturation[0].d = 1;
    refused(RDPI_ERR_DEADZONES);
    given.saturation[0].d = 0;
    given.inverse_saturation[0].d = -1;
    refused(RDPI_ERR_DEADZONES);
}

void test_init_refuses_dead_zones_that_do_not_rise_in_either_stage(void)
{
    given.saturation[1].d = 0;
    refused(RDPI_ERR_DEADZONES);
    given.saturation[1].d = 1;
    start();
    given.inverse_saturation[1].d = -5;
    refused(RDPI_ERR_DEADZONES);
    given.inverse_saturation[1].d = INT32_MAX;
    start();
}

void test_init_refuses_pieces_that_do_not_rise_in_either_stage(void)
{
    given.saturation[1].weight = -(1 << 30);
    refused(RDPI_ERR_SATURATION);
    given.saturation[1].weight++;
    start();
    given.inverse_saturation[0].weight = 0;
    refused(RDPI_ERR_SATURATION);
    given.inverse_saturation[0].weight = -1;
    refused(RDPI_ERR_SATURATION);
    given.inverse_saturation[0].weight = 1;
    start();
}

void test_init_refuses_weights_that_add_up_to_more_than_2_to_the_31(void)
{
    given.saturation[0].weight = 1 << 30;
    given.saturation[1].weight = (1 << 30) + 1;
    refused(RDPI_ERR_SATURATION);
    given.saturation[1].weight = 1 << 30;
    start();
    given.inverse_saturation[0].weight = INT32_MAX;
    given.inverse_saturation[1].weight = -2;
    refused(RDPI_ERR_SATURATION);
    given.inverse_saturation[1].weight = -1; /* magnitudes */
    start();
    given.inverse_saturation[1].weight = INT32_MIN;
    refused(RDPI_ERR_SATURATION);
}

void test_init_refuses_shifts_of_more_than_62_in_either_stage(void)
{
    given.params.saturation_shift = 63;
    refused(RDPI_ERR_SATURATION);
    given.params.saturation_shift = 62;
    start();
    given.params.saturation_shift = 0;
    start();
    given.params.inverse_shift = 63;
    refused(RDPI_ERR_SATURATION);
    given.params.inverse_shift = 62;
    start();
    given.params.inverse_shift = 0;
    start();
}

void test_init_refuses_sample_time_zero(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, rdpi_q31_init(&axis, &given.params, 0));
}

/* 4.29 s a sample, the guard as far per sample as before. */
void test_init_accepts_the_longest_sample_time(void)
{
    given.params.guard_exponent = -45;
    actuator_q31_seal(&given);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&axis, &given.params, UINT32_MAX));
    NEAR(4 * U, rdpi_q31_step(&axis, 3 * U));
}

/* 1 ns: the sweep needs to make a 2^-32nd of a unit in it, the guard one unit. */
void test_init_accepts_the_shortest_sample_time(void)
{
    given.params.guard_exponent = -31;
    given.params.sweep_per_us = 1000;
    actuator_q31_seal(&given);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&axis, &given.params, 1));
    NEAR(4 * U, rdpi_q31_step(&axis, 3 * U));
}

void test_init_refuses_a_guard_mantissa_that_is_not_normalised(void)
{
    given.params.guard_mantissa = INT32_MAX;
    refused(RDPI_ERR_RATE);
    given.params.guard_mantissa = 0;
    refused(RDPI_ERR_RATE);
    given.params.guard_mantissa = UINT32_MAX;
    start();
}

/* 2^31 2^exponent 2^20 units a sample */
void test_init_refuses_a_guard_below_one_unit_and_from_2_to_the_63_on(void)
{
    given.params.guard_exponent = -52;
    refused(RDPI_ERR_RATE);
    given.params.guard_exponent = -51;
    start();
    given.params.guard_exponent = 12;
    refused(RDPI_ERR_RATE);
    given.params.guard_exponent = 11;
    start();
    given.params.guard_mantissa = UINT32_MAX;
    start();
    given.params.guard_exponent = -52;
    refused(RDPI_ERR_RATE);
}

void test_init_refuses_a_rate_window_of_4_29_seconds(void)
{
    const uint32_t half = (uint32_t)1 << 31;
    given.params.guard_exponent = -45;
    given.params.rate_window_ns = UINT32_MAX;
    actuator_q31_seal(&given);
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_WINDOW, rdpi_q31_init(&axis, &given.params, half));
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&axis, &given.params, half - 1u));
}

void test_init_refuses_a_drive_range_that_is_empty_or_upside_down(void)
{
    given.params.sweep_end = given.params.min_drive = given.params.max_drive;
    set3(given.memory, 28 * U, 28 * U, 28 * U);
    refused(RDPI_ERR_DRIVE);
    given.params.min_drive++;
    refused(RDPI_ERR_DRIVE);
    given.params.min_drive -= 2; /* two drives */
    start();
}

void test_init_refuses_a_drive_range_beyond_the_largest_drive(void)
{
    whole_format();
    start();
    given.params.max_drive = MAX + 1;
    refused(RDPI_ERR_DRIVE);
    given.params.max_drive = INT32_MAX;
    refused(RDPI_ERR_DRIVE);
    given.params.max_drive = MAX;
    given.params.min_drive = -MAX - 1;
    refused(RDPI_ERR_DRIVE);
    given.params.min_drive = INT32_MIN;
    refused(RDPI_ERR_DRIVE);
}

void test_init_refuses_memory_that_one_history_cannot_leave(void)
{
    set3(given.memory, 3 * U, 2 * U - 1, 0);
    refused(RDPI_ERR_MEMORY);
    set3(given.memory, 3 * U, 4 * U + 1, 4 * U);
    refused(RDPI_ERR_MEMORY);
    set3(given.memory, 3 * U, 2 * U, 4 * U + 1);
    refused(RDPI_ERR_MEMORY);
    set3(given.memory, 3 * U, 2 * U, 0);
    start();
    set3(given.memory, 3 * U, 4 * U, 2 * U);
    start();
    set3(given.memory, 3 * U, 2 * U, 4 * U);
    start();
    set3(given.memory, INT32_MAX, INT32_MIN, 0); /* a difference that 32 bits do not hold */
    refused(RDPI_ERR_MEMORY);
}

void test_init_refuses_memory_held_by_a_drive_outside_the_range(void)
{
    set3(given.memory, 28 * U + 1, 28 * U, 28 * U);
    refused(RDPI_ERR_MEMORY);
    set3(given.memory, -32 * U - 1, -32 * U, -32 * U);
    refused(RDPI_ERR_MEMORY);
    set3(given.memory, 28 * U, 28 * U, 28 * U);
    start();
    set3(given.memory, -32 * U, -32 * U, -32 * U);
    start();
}

void test_init_refuses_memory_beyond_the_largest_drive(void)
{
    whole_format();
    set3(given.memory, MAX, MAX + 1, MAX);
    refused(RDPI_ERR_MEMORY);
    set3(given.memory, -MAX, -MAX, -MAX - 1);
    refused(RDPI_ERR_MEMORY);
    set3(given.memory, MAX, MAX, MAX);
    start();
    set3(given.memory, -MAX, -MAX, -MAX);
    start();
}

void test_init_refuses_a_sweep_of_no_and_of_too_many_cycles(void)
{
    given.params.sweep_cycles = 0;
    refused(RDPI_ERR_SWEEP);
    given.params.sweep_cycles = 10001;
    refused(RDPI_ERR_SWEEP);
    given.params.sweep_cycles = 10000;
    start();
    given.params.sweep_cycles = 1;
    start();
}

void test_init_refuses_a_sweep_that_ends_outside_the_range(void)
{
    given.params.sweep_end = 28 * U + 1;
    refused(RDPI_ERR_SWEEP);
    given.params.sweep_end = 28 * U;
    start();
    given.params.sweep_end = -32 * U - 1;
    refused(RDPI_ERR_SWEEP);
    given.params.sweep_end = -32 * U;
    start();
}

void test_init_refuses_a_sweep_faster_than_the_slew_limit(void)
{
    given.params.slew_per_us = given.params.sweep_per_us - 1u;
    refused(RDPI_ERR_SWEEP);
    given.params.slew_per_us++;
    start();
    given.params.slew_per_us = 1;
    refused(RDPI_ERR_SWEEP);
    given.params.slew_per_us = 0;
    start();
}

void test_init_refuses_a_sweep_whose_share_of_one_sample_is_lost_in_rounding(void)
{
    given.params.guard_exponent = -31;
    const uint32_t times_ns[] = {1, 10, 100, 999}, slowest[] = {1000, 100, 10, 2};
    for (size_t k = 0; k < 4; k++) {
        given.params.sweep_per_us = slowest[k] - 1u;
        actuator_q31_seal(&given);
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_SWEEP, rdpi_q31_init(&axis, &given.params, times_ns[k]));
        given.params.sweep_per_us++;
        actuator_q31_seal(&given);
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&axis, &given.params, times_ns[k]));
    }
    given.params.sweep_per_us = 0;
    refused(RDPI_ERR_SWEEP);
    given.params.sweep_per_us = 1;
    start(); /* in a millisecond */
}

void test_init_forgets_another_actuators_saturation(void)
{
    start();
    rdpi_q31_step(&axis, U);
    given.inverse_saturation[0].weight = 1 << 28; /* z is 4 v: half the drive */
    start();
    rdpi_q31_t fresh;
    memset(&fresh, 0, sizeof fresh);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&fresh, &given.params, T_NS));
    TEST_ASSERT_EQUAL_INT32(rdpi_q31_step(&fresh, U), rdpi_q31_step(&axis, U));
}
