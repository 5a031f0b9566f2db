/* rdpi_q31: guard, range and slew limit. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#include "axis_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What both siblings do. */
void test_guard_clamps_the_rate_flags_and_counts(void);
void test_drive_above_the_range_is_clipped_flagged_and_counted(void);
void test_drive_below_the_range_is_clipped_flagged_and_counted(void);
void test_drive_just_inside_the_range_is_not_clipped(void);
void test_after_a_range_clip_the_plays_stand_where_the_actuator_does(void);
void test_slew_limits_the_change_flags_and_counts(void);
void test_slew_starts_from_the_drive_of_the_memory(void);
void test_a_change_within_the_slew_limit_is_not_clipped(void);
void test_after_a_slew_clip_the_plays_stand_where_the_actuator_does(void);
void test_a_drive_clipped_by_range_and_slew_has_both_flags_and_one_count(void);
void test_guard_and_clip_in_one_step_are_both_flagged(void);
void test_slew_zero_means_unlimited(void);
void test_tracking_is_exact_again_as_soon_as_clipping_ends(void);
void test_without_dac_bits_the_code_stays_zero(void);
void test_dac_rounds_the_drive_to_the_nearest_code(void);
void test_dac_rounding_alone_is_not_a_clip(void);
void test_plays_follow_the_rounded_drive(void);
void test_slew_finer_than_a_dac_code_still_arrives(void);
#include "axis_limits.inc"

void test_a_rate_just_at_the_guard_is_not_flagged_and_one_unit_more_is(void)
{
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_step(&axis, U / 4);
    TEST_ASSERT_EQUAL_INT32(ONE, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    rdpi_q31_step(&axis, -1);
    TEST_ASSERT_EQUAL_INT32(ONE, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_GUARD, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
}

/* ---- clipping ---- */

/* To the ends of the range, whose wish is clamped and so exact. */
void test_a_change_just_at_the_slew_limit_is_not_clipped_and_a_unit_more_is(void)
{
    const int32_t references[] = {FAR, -FAR}, ends[] = {28 * U, -32 * U};
    for (int32_t less = 0; less < 2; less++) {
        for (size_t k = 0; k < 2; k++) {
            int32_t way = (k == 0 ? 28 * U : 32 * U) - less;
            given.params.slew_per_us = PER_SAMPLE(way);
            start();
            TEST_ASSERT_EQUAL_INT32(k == 0 ? ends[k] - less : ends[k] + less, rdpi_q31_step(&axis, references[k]));
            TEST_ASSERT_EQUAL_UINT32(less ? RDPI_FLAG_RANGE | RDPI_FLAG_SLEW : RDPI_FLAG_RANGE, axis.flags);
        }
    }
}

/* From one end of the format to the other, 2^62 of the slew's unit. */
static bool slew_clips_the_whole_way(void)
{
    rdpi_q31_step(&axis, -FAR);
    rdpi_q31_step(&axis, -FAR);
    TEST_ASSERT_EQUAL_INT32(-MAX, axis.drive);
    rdpi_q31_step(&axis, FAR);
    return (axis.flags & RDPI_FLAG_SLEW) != 0u;
}

void test_speeds_whose_product_with_the_sample_time_overflows_64_bits_are_no_limit(void)
{
    const uint64_t speeds[] = {UINT64_MAX, UINT64_MAX / 3u, (uint64_t)1 << 62, ((uint64_t)1 << 62) + 1u};
    const uint32_t times_ns[] = {1000, 1001, T_NS, UINT32_MAX};
    whole_format();
    given.params.guard_exponent = -31;
    for (size_t k = 0; k < 4; k++) {
        for (size_t i = 0; i < 4; i++) {
            given.params.slew_per_us = speeds[k];
            starts_with_sample_time(times_ns[i]);
            TEST_ASSERT_FALSE(slew_clips_the_whole_way());
            TEST_ASSERT_EQUAL_INT32(MAX, axis.drive);
        }
    }
}

void test_the_fastest_slew_that_still_limits_stops_one_unit_short(void)
{
    whole_format();
    given.params.slew_per_us = ((uint64_t)1 << 62) - 1000u;
    starts_with_sample_time(1000);
    TEST_ASSERT_TRUE(slew_clips_the_whole_way());
    TEST_ASSERT_EQUAL_INT32(MAX - 1, axis.drive);
}

/* 2^32 samples for one unit: what does not show yet is kept. */
void test_the_slowest_slew_goes_a_2_to_the_minus_32nd_of_a_unit_a_sample(void)
{
    given.params.guard_exponent = -31;
    given.params.sweep_per_us = given.params.slew_per_us = 1000;
    starts_with_sample_time(1);
    for (int64_t k = 1; k <= 100; k++) {
        TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_step(&axis, U));
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_SLEW, axis.flags & RDPI_FLAG_SLEW);
        TEST_ASSERT_EQUAL_INT64(k, axis.ramp);
    }
    axis.ramp = ((int64_t)1 << 32) - 1;
    TEST_ASSERT_EQUAL_INT32(1, rdpi_q31_step(&axis, U));
}

void test_slew_per_sample_is_the_speed_times_the_sample_time_rounded_down(void)
{
    const uint64_t speeds[] = {1000000, 1234567, 999999999999, ((uint64_t)1 << 50) + 12345};
    const uint32_t times_ns[] = {1, 7, 1000, 123457, UINT32_MAX};
    given.params.guard_exponent = -31;
    for (size_t k = 0; k < 4; k++) {
        for (size_t i = 0; i < 5; i++) {
            uint64_t high = (speeds[k] >> 32) * times_ns[i], low = (speeds[k] & UINT32_MAX) * times_ns[i];
            high += low >> 32; /* 96 bits of product over 1000, in two divisions */
            low = (high % 1000u << 32 | (low & UINT32_MAX)) / 1000u;
            uint64_t share = high / 1000u < (uint64_t)1 << 30 ? (high / 1000u << 32) + low : (uint64_t)1 << 62;
            given.params.slew_per_us = given.params.sweep_per_us = speeds[k];
            starts_with_sample_time(times_ns[i]);
            TEST_ASSERT_EQUAL_INT64((int64_t)share, axis.slew);
            TEST_ASSERT_EQUAL_INT64((int64_t)share, axis.sweep_step);
        }
    }
}
