/* rdpi_f32: guard, range, slew limit and codes of the DAC. */
#include "unity.h"

#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#include "axis_f32.inc"
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

void test_a_rate_just_at_the_guard_is_not_flagged(void)
{
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)0.25);
    rdpi_f32_step(&axis, (rdpi_real_t)0.5);
    EQUAL(256, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.guard_count);
}

/* ---- clipping ---- */

void test_slew_may_be_as_slow_as_the_sweep_can_be(void)
{
    given.params.slew_V_per_s = given.params.sweep_V_per_s = (rdpi_real_t)0.5;
    start();
    rdpi_real_t before_V = axis.drive_V;
    rdpi_f32_step(&axis, (rdpi_real_t)3.25);
    EQUAL(0.5 * T_S, axis.drive_V - before_V);
}

/* ---- DAC ---- */

void test_memory_has_the_nearest_code(void)
{
    five_bit_dac();
    set3(given.memory_um, (rdpi_real_t)3.25, 3, 1); /* 2.625 V */
    start();
    TEST_ASSERT_EQUAL_UINT32(21, axis.dac_code);
}

void test_ends_of_the_range_are_the_first_and_the_last_code_for_any_resolution(void)
{
    const rdpi_real_t ranges_V[][2] = {
        {-16, 15}, {0, 1}, {-20, 120}, {0, 100}, {(rdpi_real_t)-3.3, (rdpi_real_t)150.7},
        {0, (rdpi_real_t)3.3}}; /* with 2 bits the last code, rounded, is beyond 3.3 V */
    for (size_t k = 0; k < sizeof ranges_V / sizeof ranges_V[0]; k++) {
        given.params.min_V = ranges_V[k][0];
        given.params.max_V = ranges_V[k][1];
        for (given.params.dac_bits = 1; given.params.dac_bits <= RDPI_MAX_DAC_BITS; given.params.dac_bits++) {
            start();
            rdpi_real_t highest_V = rdpi_f32_step(&axis, 1000);
            TEST_ASSERT_EQUAL_HEX32((1uL << given.params.dac_bits) - 1, axis.dac_code);
            EQUAL(given.params.max_V, highest_V);
            TEST_ASSERT_TRUE(highest_V <= given.params.max_V);
            rdpi_real_t lowest_V = rdpi_f32_step(&axis, -1000);
            TEST_ASSERT_EQUAL_HEX32(0, axis.dac_code);
            EQUAL(given.params.min_V, lowest_V);
        }
    }
}
