/* rdpi_f32: what init refuses and accepts, and the state that it leaves. */
#include "unity.h"

#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#include "axis_f32.inc"
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

void test_init_refuses_gain_zero(void)
{
    given.curve[0].gain_um_per_V = 0;
    refused(RDPI_ERR_GAIN);
}

void test_init_refuses_a_first_threshold_above_zero(void)
{
    given.play[0].r_um = (rdpi_real_t)0.5;
    refused(RDPI_ERR_THRESHOLDS);
}

void test_init_refuses_a_first_threshold_below_zero(void)
{
    given.play[0].r_um = (rdpi_real_t)-0.5;
    refused(RDPI_ERR_THRESHOLDS);
}

void test_init_refuses_equal_thresholds(void)
{
    given.play[2].r_um = 1;
    refused(RDPI_ERR_THRESHOLDS);
}

void test_init_refuses_thresholds_out_of_order(void)
{
    given.play[2].r_um = (rdpi_real_t)0.5;
    refused(RDPI_ERR_THRESHOLDS);
}

void test_init_refuses_a_slope_of_zero(void)
{
    given.play[2].slope = 0;
    refused(RDPI_ERR_SLOPES);
}

void test_init_refuses_a_slope_too_small_to_divide_by(void)
{
    given.play[0].slope_rate_s_per_um = 0;
    given.play[0].slope = (rdpi_real_t)0.9e-7;
    refused(RDPI_ERR_SLOPES);
    given.play[0].slope = (rdpi_real_t)1.1e-7;
    start();
}

void test_init_refuses_a_slope_too_small_to_divide_by_at_the_guard(void)
{
    given.params.min_slope_ratio = (rdpi_real_t)1e-30;
    given.play[0].slope = (rdpi_real_t)1e-3;
    given.play[0].slope_rate_s_per_um = (rdpi_real_t)(-0.99995e-3 / 256);
    refused(RDPI_ERR_GUARD);
    given.play[0].slope_rate_s_per_um = (rdpi_real_t)(-0.99e-3 / 256);
    start();
}

void test_init_refuses_a_negative_slope(void)
{
    given.play[1].slope = (rdpi_real_t)-0.5;
    refused(RDPI_ERR_SLOPES);
}

void test_init_refuses_a_guard_rate_of_zero(void)
{
    given.params.max_um_per_s = 0;
    refused(RDPI_ERR_RATE);
}

void test_init_refuses_a_negative_guard_rate(void)
{
    given.params.max_um_per_s = -256;
    refused(RDPI_ERR_RATE);
}

void test_init_refuses_a_negative_rate_window(void)
{
    given.params.rate_window_s = -T_S;
    refused(RDPI_ERR_RATE);
}

void test_init_refuses_a_negative_rate_filter(void)
{
    given.params.rate_filter_s = -T_S;
    refused(RDPI_ERR_RATE);
}

void test_init_refuses_a_slope_ratio_of_zero(void)
{
    given.params.min_slope_ratio = 0;
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_slope_ratio_of_one(void)
{
    without_rate_law();
    given.params.min_slope_ratio = 1;
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_slope_that_falls_below_its_ratio_within_the_guard(void)
{
    given.params.max_um_per_s = (rdpi_real_t)256.125;
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_slope_that_crosses_zero_within_the_guard(void)
{
    given.play[2].slope_rate_s_per_um = (rdpi_real_t)-1 / 16;
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_first_dead_zone_that_is_not_zero(void)
{
    given.saturation[0].d_um = 1;
    refused(RDPI_ERR_DEADZONES);
}

void test_init_refuses_equal_dead_zones(void)
{
    given.saturation[1].d_um = 0;
    refused(RDPI_ERR_DEADZONES);
}

void test_init_refuses_saturation_that_is_flat_at_the_origin(void)
{
    given.saturation[0].weight = 0;
    given.saturation[1].weight = 1;
    refused(RDPI_ERR_SATURATION);
}

void test_init_refuses_saturation_with_a_flat_piece(void)
{
    given.saturation[1].weight = -1;
    refused(RDPI_ERR_SATURATION);
}

void test_init_refuses_saturation_that_turns_back(void)
{
    given.saturation[1].weight = (rdpi_real_t)-1.5;
    refused(RDPI_ERR_SATURATION);
}

void test_init_refuses_a_sample_time_that_is_not_positive_and_finite(void)
{
    const rdpi_real_t bad[] = {0, -1, NAN, INFINITY};
    for (size_t k = 0; k < 4; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, rdpi_f32_init(&axis, &given.params, bad[k]));
    }
}

void test_init_refuses_an_empty_drive_range(void)
{
    given.params.min_V = given.params.max_V;
    refused(RDPI_ERR_DRIVE);
}

void test_init_refuses_a_drive_range_narrower_than_a_nanovolt(void)
{
    given.curve[0].offset_V = 0;
    given.params.min_V = 0;
    given.params.max_V = (rdpi_real_t)0.9e-9;
    refused(RDPI_ERR_DRIVE);
    given.params.max_V = (rdpi_real_t)1.1e-9;
    start();
}

void test_init_refuses_a_drive_range_upside_down(void)
{
    given.params.min_V = 15;
    given.params.max_V = -16;
    refused(RDPI_ERR_DRIVE);
}

void test_init_refuses_a_negative_slew(void)
{
    given.params.slew_V_per_s = -1;
    refused(RDPI_ERR_DRIVE);
}

void test_init_refuses_more_dac_bits_than_single_precision_resolves(void)
{
    given.params.dac_bits = RDPI_MAX_DAC_BITS + 1;
    refused(RDPI_ERR_DRIVE);
}

void test_init_refuses_memory_that_one_history_cannot_leave(void)
{
    set3(given.memory_um, 3, (rdpi_real_t)1.875, 0);
    refused(RDPI_ERR_MEMORY);
    set3(given.memory_um, 3, 2, (rdpi_real_t)4.125);
    refused(RDPI_ERR_MEMORY);
}

void test_init_refuses_memory_held_by_a_drive_above_the_range(void)
{
    set3(given.memory_um, (rdpi_real_t)28.125, 28, 28);
    refused(RDPI_ERR_MEMORY);
}

void test_init_refuses_memory_held_by_a_drive_below_the_range(void)
{
    set3(given.memory_um, (rdpi_real_t)-34.125, -34, -34);
    refused(RDPI_ERR_MEMORY);
}

void test_init_refuses_rest_outside_the_drive_range(void)
{
    given.curve[0].offset_V = (rdpi_real_t)15.125;
    refused(RDPI_ERR_MEMORY);
}

void test_init_refuses_a_slew_slower_than_the_sweep(void)
{
    given.params.slew_V_per_s = (rdpi_real_t)63.5;
    refused(RDPI_ERR_SWEEP);
    given.params.slew_V_per_s = (rdpi_real_t)1e-30;
    refused(RDPI_ERR_SWEEP);
}

void test_init_refuses_a_sweep_of_no_cycles(void)
{
    given.params.sweep_cycles = 0;
    refused(RDPI_ERR_SWEEP);
}

void test_init_refuses_a_sweep_of_too_many_cycles(void)
{
    given.params.sweep_cycles = 10001;
    refused(RDPI_ERR_SWEEP);
    given.params.sweep_cycles = UINT16_MAX;
    refused(RDPI_ERR_SWEEP);
}

void test_init_refuses_a_sweep_that_ends_outside_the_drive_range(void)
{
    given.params.sweep_end_V = (rdpi_real_t)15.125;
    refused(RDPI_ERR_SWEEP);
    given.params.sweep_end_V = (rdpi_real_t)-16.125;
    refused(RDPI_ERR_SWEEP);
}

void test_init_refuses_a_sweep_that_does_not_move(void)
{
    given.params.sweep_V_per_s = 0;
    refused(RDPI_ERR_SWEEP);
    given.params.sweep_V_per_s = -64;
    refused(RDPI_ERR_SWEEP);
}

void test_init_refuses_a_sweep_whose_share_of_one_sample_is_lost_in_rounding(void)
{
    given.params.sweep_V_per_s = (rdpi_real_t)(sizeof(rdpi_real_t) == sizeof(float) ? 1e-3 : 1e-12);
    refused(RDPI_ERR_SWEEP);
}

void test_init_accepts_a_slew_as_fast_as_the_sweep_or_none(void)
{
    given.params.slew_V_per_s = 64;
    start();
    given.params.slew_V_per_s = 0;
    start();
}

void test_init_accepts_a_sweep_of_the_most_cycles_to_either_end_of_the_range(void)
{
    given.params.sweep_cycles = 10000;
    given.params.sweep_end_V = given.params.max_V;
    start();
    given.params.sweep_end_V = given.params.min_V;
    start();
}

void test_init_accepts_as_many_plays_and_dead_zones_as_the_maxima(void)
{
    rdpi_real_t y_um[RDPI_MAX_PLAYS];
    for (size_t i = 0; i < RDPI_MAX_PLAYS; i++) {
        given.play[i] = (rdpi_f32_play_t){.r_um = (rdpi_real_t)i / 16, .slope = 1};
    }
    for (size_t j = 0; j < RDPI_MAX_DEADZONES; j++) {
        given.saturation[j] = (rdpi_f32_deadzone_t){(rdpi_real_t)j, 1};
    }
    given.params.plays = RDPI_MAX_PLAYS;
    given.params.deadzones = RDPI_MAX_DEADZONES;
    start();
    EQUAL(2, rdpi_f32_step(&axis, (rdpi_real_t)3.25)); /* z = 3 = 2 + (2 - 1), x = v = 2 */
    rdpi_f32_get_memory(&axis, y_um);
    EQUAL(2 - (RDPI_MAX_PLAYS - 1) / 16.0, y_um[RDPI_MAX_PLAYS - 1]);
}

void test_nothing_beyond_the_counts_is_read(void)
{
    rdpi_real_t y_um[RDPI_MAX_PLAYS];
    for (size_t i = PLAYS; i < RDPI_MAX_PLAYS; i++) {
        given.play[i] = (rdpi_f32_play_t){NAN, NAN, NAN, NAN, NAN};
        given.memory_um[i] = y_um[i] = NAN;
    }
    for (size_t j = DEADZONES; j < RDPI_MAX_DEADZONES; j++) {
        given.saturation[j] = (rdpi_f32_deadzone_t){NAN, NAN};
        given.inverse_saturation[j] = (rdpi_f32_piece_t){NAN, NAN, NAN, NAN};
    }
    start();
    EQUAL(3, rdpi_f32_step(&axis, (rdpi_real_t)3.25)); /* as without */
    EQUAL(3.25, rdpi_f32_predict(&axis, 3, 0));
    rdpi_f32_sweep(&axis);
    rdpi_f32_get_memory(&axis, y_um);
    TEST_ASSERT_FLOAT_IS_NAN((float)y_um[PLAYS]);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, y_um));
}

void test_init_accepts_memory_at_the_limits_one_history_can_reach(void)
{
    set3(given.memory_um, 3, 2, 0);
    start();
    set3(given.memory_um, 28, 28, 28);
    start();
    set3(given.memory_um, -34, -33, -31);
    start();
}

void test_init_accepts_rest_at_the_end_of_the_drive_range(void)
{
    given.curve[0].offset_V = given.params.max_V;
    start();
    EQUAL(15, axis.drive_V);
}

void test_init_accepts_a_small_gain_and_a_low_guard_rate(void)
{
    given.curve[0].gain_um_per_V = (rdpi_real_t)0.0625;
    given.params.max_um_per_s = (rdpi_real_t)0.0625;
    start();
}
