#include "unity.h"

#include <math.h>
#include <string.h>

#include "rdpi/rdpi.h"

TEST_SOURCE_FILE("lib/src/rdpi.c")
TEST_SOURCE_FILE("lib/src/rate.c")
TEST_SOURCE_FILE("lib/src/inverse.c")
TEST_SOURCE_FILE("lib/src/deadzone.c")
TEST_SOURCE_FILE("lib/src/play.c")

#define PLAYS 3
#define DEADZONES 2
#define T_S ((rdpi_real_t)1 / 1024)
#define EQUAL_REAL(expected, actual) TEST_ASSERT_FLOAT_WITHIN(2e-5f, (float)(expected), (float)(actual))

/* At rest v = 0.5 at x = 1, 2.5 at 3, then 1.5 per um; at the guard, 256 um/s, W_0 and W_1 have lost 0.25.
 * z = v up to 2, half as steep beyond. */
static rdpi_real_t thresholds_um[PLAYS], slopes[PLAYS], slope_rate[PLAYS], memory_um[PLAYS];
static rdpi_real_t deadzones_um[DEADZONES], weights[DEADZONES];
static rdpi_f32_params_t params;
static rdpi_f32_t axis;

static void set3(rdpi_real_t *values, rdpi_real_t a, rdpi_real_t b, rdpi_real_t c)
{
    values[0] = a;
    values[1] = b;
    values[2] = c;
}

void setUp(void)
{
    set3(thresholds_um, 0, 1, 3);
    set3(slopes, (rdpi_real_t)0.5, 1, (rdpi_real_t)1.5);
    set3(slope_rate, (rdpi_real_t)-1 / 1024, (rdpi_real_t)-1 / 1024, 0);
    set3(memory_um, 0, 0, 0);
    deadzones_um[0] = 0;
    deadzones_um[1] = 2;
    weights[0] = 1;
    weights[1] = (rdpi_real_t)-0.5;
    memset(&axis, 0, sizeof axis);
    params = (rdpi_f32_params_t){
        .schema = RDPI_PARAMS_SCHEMA,
        .plays = PLAYS,
        .deadzones = DEADZONES,
        .thresholds_um = thresholds_um,
        .slopes = slopes,
        .slope_rate_s_per_um = slope_rate,
        .deadzones_um = deadzones_um,
        .deadzone_weights = weights,
        .gain_um_per_V = 2,
        .offset_V = 1,
        .offset_um = (rdpi_real_t)0.25,
        .max_um_per_s = 256,
        .min_slope_ratio = (rdpi_real_t)0.5, /* W_0 just keeps it */
        .min_V = -16,
        .max_V = 15,
    };
}

void tearDown(void)
{
}

static rdpi_status_t init(void)
{
    return rdpi_f32_init(&axis, &params, T_S);
}

static void start(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_OK, init());
}

static void refused(rdpi_status_t status)
{
    TEST_ASSERT_EQUAL_INT(status, init());
}

static void without_rate_law(void)
{
    set3(slope_rate, 0, 0, 0);
}

static void equal_memory(rdpi_real_t y0, rdpi_real_t y1, rdpi_real_t y2)
{
    rdpi_real_t y_um[PLAYS];
    rdpi_f32_get_memory(&axis, y_um);
    EQUAL_REAL(y0, y_um[0]);
    EQUAL_REAL(y1, y_um[1]);
    EQUAL_REAL(y2, y_um[2]);
}

/* The actuator of these parameters, literally by eq. 1, 7, 8, 9 and 16, in double; it shares nothing with the library. */
static double plant_y[PLAYS];

static double plant(double drive_V, double rate_um_per_s)
{
    double x = (double)params.gain_um_per_V * (drive_V - (double)params.offset_V), v = 0, below = 0;
    for (size_t i = 0; i < PLAYS; i++) {
        double r = (double)thresholds_um[i], slope = (double)slopes[i] + (double)slope_rate[i] * rate_um_per_s;
        plant_y[i] = fmax(x - r, fmin(x + r, plant_y[i]));
        v += (slope - below) * plant_y[i];
        below = slope;
    }
    double z = (double)weights[0] * v;
    return z + (double)weights[1] * fmax(v - (double)deadzones_um[1], 0) + (double)params.offset_um;
}

static void plant_at_rest(void)
{
    plant_y[0] = plant_y[1] = plant_y[2] = 0;
}

/* ---- init: what it refuses ---- */

void test_init_refuses_no_instance(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_init(NULL, &params, T_S));
}

void test_init_refuses_no_parameters(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_init(&axis, NULL, T_S));
}

void test_init_refuses_no_thresholds(void)
{
    params.thresholds_um = NULL;
    refused(RDPI_ERR_NULL);
}

void test_init_refuses_no_slopes(void)
{
    params.slopes = NULL;
    refused(RDPI_ERR_NULL);
}

void test_init_refuses_no_slope_rates(void)
{
    params.slope_rate_s_per_um = NULL;
    refused(RDPI_ERR_NULL);
}

void test_init_refuses_no_dead_zones(void)
{
    params.deadzones_um = NULL;
    refused(RDPI_ERR_NULL);
}

void test_init_refuses_no_dead_zone_weights(void)
{
    params.deadzone_weights = NULL;
    refused(RDPI_ERR_NULL);
}

void test_init_refuses_another_schema(void)
{
    params.schema = RDPI_PARAMS_SCHEMA + 1u;
    refused(RDPI_ERR_SCHEMA);
}

void test_init_refuses_no_plays(void)
{
    params.plays = 0;
    refused(RDPI_ERR_COUNT);
}

void test_init_refuses_more_plays_than_the_maximum(void)
{
    params.plays = RDPI_MAX_PLAYS + 1;
    refused(RDPI_ERR_COUNT);
}

void test_init_refuses_no_pieces_of_saturation(void)
{
    params.deadzones = 0;
    refused(RDPI_ERR_COUNT);
}

void test_init_refuses_more_dead_zones_than_the_maximum(void)
{
    params.deadzones = RDPI_MAX_DEADZONES + 1;
    refused(RDPI_ERR_COUNT);
}

void test_init_refuses_each_number_that_is_not_finite(void)
{
    rdpi_real_t *const numbers[] = {
        &params.gain_um_per_V,   &params.offset_V, &params.offset_um, &params.rate_window_s, &params.rate_filter_s,
        &params.max_um_per_s,    &params.min_V,    &params.max_V,     &params.slew_V_per_s,  &params.min_slope_ratio,
        &thresholds_um[PLAYS - 1], &slopes[PLAYS - 1], &slope_rate[PLAYS - 1], &memory_um[PLAYS - 1],
        &deadzones_um[DEADZONES - 1], &weights[DEADZONES - 1]};
    const rdpi_real_t bad[] = {NAN, INFINITY, -INFINITY};
    params.memory_um = memory_um;
    for (size_t i = 0; i < sizeof numbers / sizeof numbers[0]; i++) {
        rdpi_real_t good = *numbers[i];
        for (size_t k = 0; k < 3; k++) {
            *numbers[i] = bad[k];
            TEST_ASSERT_EQUAL_INT(RDPI_ERR_NOT_FINITE, init());
        }
        *numbers[i] = good;
    }
    start();
}

void test_init_refuses_gain_zero(void)
{
    params.gain_um_per_V = 0;
    refused(RDPI_ERR_GAIN);
}

void test_init_refuses_a_first_threshold_above_zero(void)
{
    thresholds_um[0] = (rdpi_real_t)0.5;
    refused(RDPI_ERR_THRESHOLDS);
}

void test_init_refuses_a_first_threshold_below_zero(void)
{
    thresholds_um[0] = (rdpi_real_t)-0.5;
    refused(RDPI_ERR_THRESHOLDS);
}

void test_init_refuses_equal_thresholds(void)
{
    thresholds_um[2] = 1;
    refused(RDPI_ERR_THRESHOLDS);
}

void test_init_refuses_thresholds_out_of_order(void)
{
    thresholds_um[2] = (rdpi_real_t)0.5;
    refused(RDPI_ERR_THRESHOLDS);
}

void test_init_refuses_a_slope_of_zero(void)
{
    slopes[2] = 0;
    refused(RDPI_ERR_SLOPES);
}

void test_init_refuses_a_negative_slope(void)
{
    slopes[1] = (rdpi_real_t)-0.5;
    refused(RDPI_ERR_SLOPES);
}

void test_init_refuses_a_guard_rate_of_zero(void)
{
    params.max_um_per_s = 0;
    refused(RDPI_ERR_RATE);
}

void test_init_refuses_a_negative_guard_rate(void)
{
    params.max_um_per_s = -256;
    refused(RDPI_ERR_RATE);
}

void test_init_refuses_a_negative_rate_window(void)
{
    params.rate_window_s = -T_S;
    refused(RDPI_ERR_RATE);
}

void test_init_refuses_a_negative_rate_filter(void)
{
    params.rate_filter_s = -T_S;
    refused(RDPI_ERR_RATE);
}

void test_init_refuses_a_slope_ratio_of_zero(void)
{
    params.min_slope_ratio = 0;
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_slope_ratio_of_one(void)
{
    without_rate_law();
    params.min_slope_ratio = 1;
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_slope_that_falls_below_its_ratio_within_the_guard(void)
{
    params.max_um_per_s = (rdpi_real_t)256.125;
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_slope_that_crosses_zero_within_the_guard(void)
{
    slope_rate[2] = (rdpi_real_t)-1 / 16;
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_slope_that_overflows_within_the_guard(void)
{
    slope_rate[2] = (rdpi_real_t)(sizeof(rdpi_real_t) == sizeof(float) ? 3e38 : 1e308);
    refused(RDPI_ERR_GUARD);
}

void test_init_refuses_a_first_dead_zone_that_is_not_zero(void)
{
    deadzones_um[0] = 1;
    refused(RDPI_ERR_DEADZONES);
}

void test_init_refuses_equal_dead_zones(void)
{
    deadzones_um[1] = 0;
    refused(RDPI_ERR_DEADZONES);
}

void test_init_refuses_saturation_that_is_flat_at_the_origin(void)
{
    weights[0] = 0;
    weights[1] = 1;
    refused(RDPI_ERR_SATURATION);
}

void test_init_refuses_saturation_with_a_flat_piece(void)
{
    weights[1] = -1;
    refused(RDPI_ERR_SATURATION);
}

void test_init_refuses_saturation_that_turns_back(void)
{
    weights[1] = (rdpi_real_t)-1.5;
    refused(RDPI_ERR_SATURATION);
}

void test_init_refuses_a_sample_time_that_is_not_positive_and_finite(void)
{
    const rdpi_real_t bad[] = {0, -1, NAN, INFINITY};
    for (size_t k = 0; k < 4; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, rdpi_f32_init(&axis, &params, bad[k]));
    }
}

void test_init_refuses_a_rate_window_of_too_many_samples(void)
{
    params.rate_window_s = (RDPI_MAX_WINDOW + 1) * T_S;
    refused(RDPI_ERR_WINDOW);
}

void test_init_refuses_an_empty_drive_range(void)
{
    params.min_V = params.max_V;
    refused(RDPI_ERR_DRIVE);
}

void test_init_refuses_a_drive_range_upside_down(void)
{
    params.min_V = 15;
    params.max_V = -16;
    refused(RDPI_ERR_DRIVE);
}

void test_init_refuses_a_negative_slew(void)
{
    params.slew_V_per_s = -1;
    refused(RDPI_ERR_DRIVE);
}

void test_init_refuses_more_dac_bits_than_single_precision_resolves(void)
{
    params.dac_bits = RDPI_MAX_DAC_BITS + 1;
    refused(RDPI_ERR_DRIVE);
}

void test_init_refuses_memory_that_one_history_cannot_leave(void)
{
    set3(memory_um, 3, (rdpi_real_t)1.875, 0);
    params.memory_um = memory_um;
    refused(RDPI_ERR_MEMORY);
    set3(memory_um, 3, 2, (rdpi_real_t)4.125);
    refused(RDPI_ERR_MEMORY);
}

void test_init_refuses_memory_held_by_a_drive_above_the_range(void)
{
    set3(memory_um, (rdpi_real_t)28.125, 28, 28);
    params.memory_um = memory_um;
    refused(RDPI_ERR_MEMORY);
}

void test_init_refuses_memory_held_by_a_drive_below_the_range(void)
{
    set3(memory_um, (rdpi_real_t)-34.125, -34, -34);
    params.memory_um = memory_um;
    refused(RDPI_ERR_MEMORY);
}

void test_init_refuses_rest_outside_the_drive_range_when_no_memory_is_given(void)
{
    params.offset_V = (rdpi_real_t)15.125;
    refused(RDPI_ERR_MEMORY);
}

/* ---- init: what it accepts ---- */

void test_init_accepts_as_many_plays_and_dead_zones_as_the_maxima(void)
{
    rdpi_real_t r[RDPI_MAX_PLAYS], w[RDPI_MAX_PLAYS], c[RDPI_MAX_PLAYS], d[RDPI_MAX_DEADZONES], ws[RDPI_MAX_DEADZONES];
    rdpi_real_t y_um[RDPI_MAX_PLAYS];
    for (size_t i = 0; i < RDPI_MAX_PLAYS; i++) {
        r[i] = (rdpi_real_t)i / 16;
        w[i] = 1;
        c[i] = 0;
    }
    for (size_t j = 0; j < RDPI_MAX_DEADZONES; j++) {
        d[j] = (rdpi_real_t)j;
        ws[j] = 1;
    }
    params.plays = RDPI_MAX_PLAYS;
    params.deadzones = RDPI_MAX_DEADZONES;
    params.thresholds_um = r;
    params.slopes = w;
    params.slope_rate_s_per_um = c;
    params.deadzones_um = d;
    params.deadzone_weights = ws;
    start();
    EQUAL_REAL(2, rdpi_f32_step(&axis, (rdpi_real_t)3.25)); /* z = 3 = 2 + (2 - 1), x = v = 2 */
    rdpi_f32_get_memory(&axis, y_um);
    EQUAL_REAL(2 - (RDPI_MAX_PLAYS - 1) / 16.0, y_um[RDPI_MAX_PLAYS - 1]);
}

void test_init_accepts_memory_at_the_limits_one_history_can_reach(void)
{
    set3(memory_um, 3, 2, 0);
    params.memory_um = memory_um;
    start();
    set3(memory_um, 28, 28, 28);
    start();
    set3(memory_um, -34, -33, -31);
    start();
}

void test_init_accepts_rest_at_the_end_of_the_drive_range(void)
{
    params.offset_V = params.max_V;
    start();
    EQUAL_REAL(15, axis.drive_V);
}

void test_init_accepts_a_small_gain_and_a_low_guard_rate(void)
{
    params.gain_um_per_V = (rdpi_real_t)0.0625;
    params.max_um_per_s = (rdpi_real_t)0.0625;
    start();
}

void test_init_leaves_the_drive_that_holds_the_memory(void)
{
    set3(memory_um, 3, 2, (rdpi_real_t)0.5);
    params.memory_um = memory_um;
    start();
    EQUAL_REAL(2.5, axis.drive_V);
    equal_memory(3, 2, (rdpi_real_t)0.5);
}

void test_init_without_memory_starts_at_rest(void)
{
    start();
    EQUAL_REAL(1, axis.drive_V);
    equal_memory(0, 0, 0);
    EQUAL_REAL(0, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.dac_code);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(0, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(0, axis.input_count);
}

/* ---- the step ---- */

void test_first_step_is_solved_at_rate_zero(void)
{
    start();
    EQUAL_REAL(1.25, rdpi_f32_step(&axis, (rdpi_real_t)0.5)); /* z = 0.25, x = 0.25 / 0.5 */
    EQUAL_REAL(0, axis.rate_um_per_s);
    EQUAL_REAL(1.25, axis.drive_V);
    equal_memory((rdpi_real_t)0.5, 0, 0);
}

void test_second_step_is_solved_with_the_slopes_of_its_rate(void)
{
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)0.5);
    /* 128 um/s: W_0 = 0.375, v = 0.1875 where the plays are, z = 0.375, x = 0.5 + 0.1875 / 0.375 */
    EQUAL_REAL(1.5, rdpi_f32_step(&axis, (rdpi_real_t)0.625));
    EQUAL_REAL(128, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

void test_step_undoes_the_saturation_stage(void)
{
    start();
    EQUAL_REAL(3, rdpi_f32_step(&axis, (rdpi_real_t)3.25)); /* z = 3, v = 4, x = 3 + 1.5 / 1.5 */
    equal_memory(4, 3, 1);
}

void test_step_returns_what_it_stores(void)
{
    start();
    rdpi_real_t drive_V = rdpi_f32_step(&axis, (rdpi_real_t)-1.75);
    TEST_ASSERT_EQUAL_MEMORY(&drive_V, &axis.drive_V, sizeof drive_V);
}

void test_negative_gain_turns_the_drive_over(void)
{
    params.gain_um_per_V = -2;
    start();
    EQUAL_REAL(-1, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    equal_memory(4, 3, 1);
}

void test_one_play_and_one_piece_make_a_gain(void)
{
    params.plays = 1;
    params.deadzones = 1;
    start();
    EQUAL_REAL(4, rdpi_f32_step(&axis, (rdpi_real_t)3.25)); /* x = 3 / 0.5 */
    EQUAL_REAL(-0.5, rdpi_f32_step(&axis, (rdpi_real_t)-0.5)); /* at the guard: x = -0.75 / 0.25 */
}

void test_rate_window_and_filter_act_in_the_chain(void)
{
    params.rate_window_s = 2 * T_S;
    params.rate_filter_s = 4 * T_S;
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_step(&axis, (rdpi_real_t)0.25);
    EQUAL_REAL(128 * (1 - exp(-0.25)), axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

void test_drive_makes_the_actuator_follow_the_reference_at_every_rate(void)
{
    params.rate_window_s = 3 * T_S;
    params.rate_filter_s = 5 * T_S;
    start();
    plant_at_rest();
    for (int k = 0; k < 2000; k++) {
        double t = k / 1024.0, reference_um = 4 * sin(6 * t) + 1.5 * sin(40 * t + 1) + (k > 1000 ? 2 : 0);
        double drive_V = (double)rdpi_f32_step(&axis, (rdpi_real_t)reference_um);
        EQUAL_REAL(reference_um, plant(drive_V, (double)axis.rate_um_per_s));
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
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&other, &params, 2 * T_S));
    for (int k = 0; k < 50; k++) {
        rdpi_real_t drive_V = rdpi_f32_step(&axis, (rdpi_real_t)(k % 7));
        rdpi_f32_step(&other, (rdpi_real_t)(k % 5 - 2));
        TEST_ASSERT_EQUAL_MEMORY(&alone[k], &drive_V, sizeof drive_V);
    }
}

/* ---- guard ---- */

void test_guard_clamps_the_rate_flags_and_counts(void)
{
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)0.25);
    EQUAL_REAL(1.75, rdpi_f32_step(&axis, (rdpi_real_t)0.875)); /* z = 0.625, 640 um/s; x = 1 + (z - 0.25) / 0.75 */
    EQUAL_REAL(256, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_GUARD, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
}

void test_a_rate_just_at_the_guard_is_not_flagged(void)
{
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)0.25);
    rdpi_f32_step(&axis, (rdpi_real_t)0.5);
    EQUAL_REAL(256, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.guard_count);
}

void test_flags_are_those_of_the_latest_step_and_counts_stay(void)
{
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_step(&axis, 1);
    rdpi_f32_step(&axis, 1);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
}

/* ---- clipping ---- */

void test_drive_above_the_range_is_clipped_flagged_and_counted(void)
{
    start();
    EQUAL_REAL(15, rdpi_f32_step(&axis, 1000));
    EQUAL_REAL(15, axis.drive_V);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
}

void test_drive_below_the_range_is_clipped_flagged_and_counted(void)
{
    start();
    EQUAL_REAL(-16, rdpi_f32_step(&axis, -1000));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
}

void test_drive_just_at_the_end_of_the_range_is_not_clipped(void)
{
    params.max_V = 3;
    start();
    EQUAL_REAL(3, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* Up to x = 2 (v = 1.5) instead of the x = 3 asked for; from there down to v = 1.25 at 0.5 per um. Plays that had
 * followed the wish would stand at 3, 2, 0 and answer with another drive. */
void test_after_a_range_clip_the_plays_stand_where_the_actuator_does(void)
{
    without_rate_law();
    params.max_V = 2;
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)2.5);
    equal_memory(2, 1, 0);
    EQUAL_REAL(1.75, rdpi_f32_step(&axis, (rdpi_real_t)1.5));
    equal_memory((rdpi_real_t)1.5, 1, 0);
}

void test_slew_limits_the_change_flags_and_counts(void)
{
    params.slew_V_per_s = 512; /* 0.5 V a sample */
    start();
    EQUAL_REAL(1.5, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_SLEW, axis.flags);
    EQUAL_REAL(2, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    EQUAL_REAL(1.5, rdpi_f32_step(&axis, (rdpi_real_t)-3));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_SLEW, axis.flags & RDPI_FLAG_SLEW);
    TEST_ASSERT_EQUAL_UINT32(3, axis.clip_count);
}

void test_slew_starts_from_the_drive_of_the_memory(void)
{
    set3(memory_um, 8, 8, 8);
    params.memory_um = memory_um;
    params.slew_V_per_s = 512;
    start();
    EQUAL_REAL(4.5, rdpi_f32_step(&axis, (rdpi_real_t)0.25));
}

void test_a_change_just_at_the_slew_limit_is_not_clipped(void)
{
    params.slew_V_per_s = 2048;
    start();
    EQUAL_REAL(3, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* x = 1, 2 where 4 was asked for; then z = 1 is met by falling 1 um at 0.5 per um from v = 1.5. */
void test_after_a_slew_clip_the_plays_stand_where_the_actuator_does(void)
{
    without_rate_law();
    params.slew_V_per_s = 512;
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)3.25);
    rdpi_f32_step(&axis, (rdpi_real_t)3.25);
    equal_memory(2, 1, 0);
    EQUAL_REAL(1.5, rdpi_f32_step(&axis, (rdpi_real_t)1.25));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags & RDPI_FLAG_SLEW);
}

void test_a_drive_clipped_by_range_and_slew_has_both_flags_and_one_count(void)
{
    params.slew_V_per_s = 512;
    start();
    EQUAL_REAL(1.5, rdpi_f32_step(&axis, 1000));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE | RDPI_FLAG_SLEW, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
}

void test_guard_and_clip_in_one_step_are_both_flagged(void)
{
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_step(&axis, 1000);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_GUARD | RDPI_FLAG_RANGE, axis.flags);
}

void test_slew_zero_means_unlimited(void)
{
    start();
    rdpi_f32_step(&axis, -1000);
    EQUAL_REAL(15, rdpi_f32_step(&axis, 1000));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags & RDPI_FLAG_SLEW);
}

/* After clips of every kind the drive makes the actuator follow again, because the states never left it. */
void test_tracking_is_exact_again_as_soon_as_clipping_ends(void)
{
    int clipped = 0, exact = 0;
    params.min_V = (rdpi_real_t)-1.5;
    params.max_V = (rdpi_real_t)3.25;
    params.slew_V_per_s = 200;
    start();
    plant_at_rest();
    for (int k = 0; k < 2000; k++) {
        double reference_um = 6 * sin(0.02 * k) + 2 * sin(0.13 * k);
        double drive_V = (double)rdpi_f32_step(&axis, (rdpi_real_t)reference_um);
        double displacement_um = plant(drive_V, (double)axis.rate_um_per_s);
        if ((axis.flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0) {
            clipped++;
        } else {
            EQUAL_REAL(reference_um, displacement_um);
            exact++;
        }
    }
    TEST_ASSERT_EQUAL_UINT32((uint32_t)clipped, axis.clip_count);
    TEST_ASSERT_GREATER_THAN_INT(200, clipped);
    TEST_ASSERT_GREATER_THAN_INT(200, exact);
}

/* ---- DAC ---- */

void test_without_dac_bits_the_code_stays_zero(void)
{
    start();
    rdpi_f32_step(&axis, 3);
    TEST_ASSERT_EQUAL_UINT32(0, axis.dac_code);
}

/* Half a volt a code, code 16 at 0 V. */
static void five_bit_dac(void)
{
    params.dac_bits = 5;
    params.min_V = -8;
    params.max_V = (rdpi_real_t)7.5;
}

void test_dac_rounds_the_drive_to_the_nearest_code(void)
{
    without_rate_law();
    five_bit_dac();
    start();
    EQUAL_REAL(1, rdpi_f32_step(&axis, (rdpi_real_t)0.4375)); /* wish 1.1875 V */
    TEST_ASSERT_EQUAL_UINT32(18, axis.dac_code);
    EQUAL_REAL(2, rdpi_f32_step(&axis, (rdpi_real_t)1.375)); /* wish 1.8125 V */
    TEST_ASSERT_EQUAL_UINT32(20, axis.dac_code);
    EQUAL_REAL(2, axis.drive_V);
}

void test_dac_rounding_alone_is_not_a_clip(void)
{
    five_bit_dac();
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)0.4375);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.clip_count);
}

void test_plays_follow_the_rounded_drive(void)
{
    without_rate_law();
    five_bit_dac();
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)0.4375);
    equal_memory(0, 0, 0);
    rdpi_f32_step(&axis, (rdpi_real_t)1.375);
    equal_memory(2, 1, 0);
}

void test_memory_has_the_nearest_code(void)
{
    five_bit_dac();
    set3(memory_um, (rdpi_real_t)3.25, 3, 1); /* 2.625 V */
    params.memory_um = memory_um;
    start();
    TEST_ASSERT_EQUAL_UINT32(21, axis.dac_code);
}

void test_ends_of_the_range_are_the_first_and_the_last_code_for_any_resolution(void)
{
    const rdpi_real_t ranges_V[][2] = {{-16, 15}, {0, 1}, {-20, 120}, {0, 100}, {(rdpi_real_t)-3.3, (rdpi_real_t)150.7}};
    for (size_t k = 0; k < sizeof ranges_V / sizeof ranges_V[0]; k++) {
        params.min_V = ranges_V[k][0];
        params.max_V = ranges_V[k][1];
        for (params.dac_bits = 1; params.dac_bits <= RDPI_MAX_DAC_BITS; params.dac_bits++) {
            start();
            rdpi_real_t highest_V = rdpi_f32_step(&axis, 1000);
            TEST_ASSERT_EQUAL_HEX32((1uL << params.dac_bits) - 1, axis.dac_code);
            EQUAL_REAL(params.max_V, highest_V);
            TEST_ASSERT_TRUE(highest_V <= params.max_V);
            rdpi_real_t lowest_V = rdpi_f32_step(&axis, -1000);
            TEST_ASSERT_EQUAL_HEX32(0, axis.dac_code);
            EQUAL_REAL(params.min_V, lowest_V);
        }
    }
}

/* 0.125 V a sample, a quarter of a code: the output goes more slowly, and does not freeze. */
void test_slew_finer_than_a_dac_code_still_arrives(void)
{
    five_bit_dac();
    params.slew_V_per_s = 128;
    start();
    for (int k = 0; k < 100; k++) {
        rdpi_f32_step(&axis, (rdpi_real_t)3.25);
    }
    EQUAL_REAL(3, axis.drive_V);
}

/* ---- input that cannot be used ---- */

static void input_changes_nothing(rdpi_real_t reference_um)
{
    rdpi_f32_t twin;
    rdpi_real_t before[PLAYS], after[PLAYS];
    params.rate_window_s = 3 * T_S;
    params.rate_filter_s = 2 * T_S;
    params.max_V = (rdpi_real_t)2.5;
    params.dac_bits = 12;
    start();
    for (int k = 0; k < 5; k++) {
        rdpi_f32_step(&axis, (rdpi_real_t)(k * k) / 4);
    }
    memcpy(&twin, &axis, sizeof axis);
    rdpi_f32_get_memory(&axis, before);

    rdpi_real_t drive_V = rdpi_f32_step(&axis, reference_um);

    rdpi_f32_get_memory(&axis, after);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
    TEST_ASSERT_EQUAL_MEMORY(&twin.drive_V, &drive_V, sizeof drive_V);
    TEST_ASSERT_EQUAL_MEMORY(&twin.drive_V, &axis.drive_V, sizeof drive_V);
    TEST_ASSERT_EQUAL_MEMORY(&twin.rate_um_per_s, &axis.rate_um_per_s, sizeof axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_MEMORY(&twin.rate, &axis.rate, sizeof axis.rate);
    TEST_ASSERT_EQUAL_MEMORY(before, after, sizeof before);
    TEST_ASSERT_EQUAL_UINT32(twin.dac_code, axis.dac_code);
    TEST_ASSERT_EQUAL_UINT32(twin.guard_count, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(twin.clip_count, axis.clip_count);
    for (int k = 0; k < 20; k++) { /* and it goes on as if nothing had been asked */
        rdpi_real_t expected_V = rdpi_f32_step(&twin, (rdpi_real_t)(10 - k) / 3);
        drive_V = rdpi_f32_step(&axis, (rdpi_real_t)(10 - k) / 3);
        TEST_ASSERT_EQUAL_MEMORY(&expected_V, &drive_V, sizeof drive_V);
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
    EQUAL_REAL(15, rdpi_f32_step(&axis, RDPI_MAX_REFERENCE_UM));
    EQUAL_REAL(-16, rdpi_f32_step(&axis, -RDPI_MAX_REFERENCE_UM));
    TEST_ASSERT_EQUAL_UINT32(0, axis.input_count);
}

void test_an_unusable_first_reference_holds_the_drive_of_the_memory_and_starts_no_history(void)
{
    start();
    EQUAL_REAL(1, rdpi_f32_step(&axis, NAN));
    EQUAL_REAL(1.25, rdpi_f32_step(&axis, (rdpi_real_t)0.5)); /* as a first step: rate 0 */
    EQUAL_REAL(0, axis.rate_um_per_s);
}

/* ---- counters ---- */

void test_guard_count_stays_at_its_largest_value(void)
{
    start();
    axis.guard_count = UINT32_MAX - 1;
    for (int k = 0; k < 4; k++) {
        rdpi_f32_step(&axis, (rdpi_real_t)(k % 2));
    }
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_GUARD, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.guard_count);
}

void test_clip_count_stays_at_its_largest_value(void)
{
    start();
    axis.clip_count = UINT32_MAX - 1;
    for (int k = 0; k < 3; k++) {
        rdpi_f32_step(&axis, 1000);
    }
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.clip_count);
}

void test_input_count_stays_at_its_largest_value(void)
{
    start();
    axis.input_count = UINT32_MAX - 1;
    for (int k = 0; k < 3; k++) {
        rdpi_f32_step(&axis, NAN);
    }
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.input_count);
}

/* ---- reset and memory ---- */

void test_reset_is_power_up_again(void)
{
    rdpi_f32_t fresh;
    set3(memory_um, 3, 2, (rdpi_real_t)0.5);
    params.memory_um = memory_um;
    params.rate_window_s = 4 * T_S;
    params.rate_filter_s = 4 * T_S;
    params.dac_bits = 10;
    start();
    fresh = axis;
    rdpi_f32_step(&axis, 1);
    rdpi_f32_step(&axis, 1000);
    rdpi_f32_step(&axis, NAN);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);

    rdpi_f32_reset(&axis);

    EQUAL_REAL(2.5, axis.drive_V);
    equal_memory(3, 2, (rdpi_real_t)0.5);
    EQUAL_REAL(0, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(fresh.dac_code, axis.dac_code);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(0, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(0, axis.input_count);
    for (int k = 0; k < 20; k++) {
        rdpi_real_t expected_V = rdpi_f32_step(&fresh, (rdpi_real_t)(k % 6));
        rdpi_real_t drive_V = rdpi_f32_step(&axis, (rdpi_real_t)(k % 6));
        TEST_ASSERT_EQUAL_MEMORY(&expected_V, &drive_V, sizeof drive_V);
    }
}

void test_set_memory_moves_plays_and_drive(void)
{
    const rdpi_real_t y_um[PLAYS] = {3, 2, (rdpi_real_t)0.5};
    five_bit_dac();
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, y_um));
    EQUAL_REAL(2.5, axis.drive_V);
    TEST_ASSERT_EQUAL_UINT32(21, axis.dac_code);
    equal_memory(3, 2, (rdpi_real_t)0.5);
}

/* At (5, 4, 2) with W = (0.5, 1, 1.5): v = 0.5 + 2 + 3; falling 1 um takes 0.5. */
void test_step_goes_on_from_the_memory_set(void)
{
    const rdpi_real_t y_um[PLAYS] = {5, 4, 2};
    params.deadzones = 1;
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, y_um));
    EQUAL_REAL(3.5, axis.drive_V);
    EQUAL_REAL(3, rdpi_f32_step(&axis, (rdpi_real_t)5.25));
    equal_memory(4, 4, 2);
}

void test_set_memory_leaves_rate_history_and_counters(void)
{
    const rdpi_real_t y_um[PLAYS] = {0, 0, 0};
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)0.25);
    rdpi_f32_step(&axis, 1000);
    rdpi_f32_step(&axis, NAN);
    rdpi_f32_step(&axis, 1000);
    rdpi_f32_step(&axis, (rdpi_real_t)0.25);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, y_um));
    TEST_ASSERT_EQUAL_UINT32(2, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(2, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
    rdpi_f32_step(&axis, (rdpi_real_t)0.375);
    EQUAL_REAL(128, axis.rate_um_per_s);
}

void test_get_memory_gives_what_set_memory_takes(void)
{
    rdpi_real_t y_um[PLAYS], again[PLAYS];
    rdpi_f32_t other;
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&other, &params, T_S));
    for (int k = 0; k < 200; k++) {
        rdpi_f32_step(&axis, (rdpi_real_t)(3 * sin(0.3 * k) + 2 * sin(1.7 * k)));
        rdpi_f32_get_memory(&axis, y_um);
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&other, y_um));
        rdpi_f32_get_memory(&other, again);
        TEST_ASSERT_EQUAL_MEMORY(y_um, again, sizeof y_um);
    }
}

void test_memory_rounded_in_print_is_accepted_and_the_drive_kept_in_range(void)
{
    const rdpi_real_t above[PLAYS] = {(rdpi_real_t)28.0001, (rdpi_real_t)27.00011, (rdpi_real_t)25.00009};
    const rdpi_real_t below[PLAYS] = {(rdpi_real_t)-34.0001, -34, -34};
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, above));
    TEST_ASSERT_EQUAL_MEMORY(&params.max_V, &axis.drive_V, sizeof axis.drive_V);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, below));
    TEST_ASSERT_EQUAL_MEMORY(&params.min_V, &axis.drive_V, sizeof axis.drive_V);
}

static void memory_refused(rdpi_status_t status, const rdpi_real_t *y_um)
{
    rdpi_f32_t before;
    start();
    rdpi_f32_step(&axis, 1);
    rdpi_f32_step(&axis, 3);
    memcpy(&before, &axis, sizeof axis);
    TEST_ASSERT_EQUAL_INT(status, rdpi_f32_set_memory(&axis, y_um));
    TEST_ASSERT_EQUAL_MEMORY(&before, &axis, sizeof axis);
}

void test_set_memory_refuses_no_states_and_changes_nothing(void)
{
    memory_refused(RDPI_ERR_NULL, NULL);
}

void test_set_memory_refuses_no_instance(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_set_memory(NULL, memory_um));
}

void test_set_memory_refuses_states_that_are_not_finite_and_changes_nothing(void)
{
    set3(memory_um, 0, 0, NAN);
    memory_refused(RDPI_ERR_NOT_FINITE, memory_um);
    set3(memory_um, INFINITY, 0, 0);
    memory_refused(RDPI_ERR_NOT_FINITE, memory_um);
}

void test_set_memory_refuses_states_too_far_apart_and_changes_nothing(void)
{
    set3(memory_um, 3, (rdpi_real_t)1.9375, 0);
    memory_refused(RDPI_ERR_MEMORY, memory_um);
    set3(memory_um, 3, (rdpi_real_t)4.0625, 4);
    memory_refused(RDPI_ERR_MEMORY, memory_um);
    set3(memory_um, 3, 2, (rdpi_real_t)-0.0625);
    memory_refused(RDPI_ERR_MEMORY, memory_um);
}

void test_set_memory_refuses_a_drive_outside_the_range_and_changes_nothing(void)
{
    set3(memory_um, (rdpi_real_t)28.0625, 28, 28);
    memory_refused(RDPI_ERR_MEMORY, memory_um);
    set3(memory_um, (rdpi_real_t)-34.0625, -34, -34);
    memory_refused(RDPI_ERR_MEMORY, memory_um);
}

/* ---- the forward model ---- */

void test_forward_predicts_the_displacement_of_a_drive(void)
{
    start();
    EQUAL_REAL(3.25, rdpi_f32_forward(&axis, 3, 0));
    equal_memory(4, 3, 1);
    EQUAL_REAL(3, axis.drive_V);
}

/* At (4, 3, 1) with W = (0.25, 0.75, 1.5): v = 0.25 + 1.5 + 1.5. */
void test_forward_uses_the_slopes_of_the_rate_given(void)
{
    start();
    EQUAL_REAL(2.875, rdpi_f32_forward(&axis, 3, 256));
    EQUAL_REAL(256, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

void test_forward_clamps_the_rate_at_the_guard(void)
{
    start();
    EQUAL_REAL(2.875, rdpi_f32_forward(&axis, 3, 1000));
    EQUAL_REAL(256, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_GUARD, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
}

void test_forward_clears_the_flags_of_the_call_before(void)
{
    start();
    rdpi_f32_forward(&axis, 3, 1000);
    rdpi_f32_forward(&axis, 3, 100);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
}

void test_forward_remembers(void)
{
    start();
    rdpi_f32_forward(&axis, 3, 0);
    EQUAL_REAL(1.25, rdpi_f32_forward(&axis, 1, 0)); /* plays at 0, 1, 1: v = -0.5 + 0 + 1.5 */
}

void test_forward_is_the_actuator_by_definition(void)
{
    start();
    plant_at_rest();
    for (int k = 0; k < 500; k++) {
        double drive_V = 2 * sin(0.03 * k) + 3 * sin(0.2 * k) + 1, rate_um_per_s = 128 + 128 * sin(0.01 * k);
        EQUAL_REAL(plant((double)(rdpi_real_t)drive_V, rate_um_per_s),
                   rdpi_f32_forward(&axis, (rdpi_real_t)drive_V, (rdpi_real_t)rate_um_per_s));
    }
}

static void forward_changes_nothing(rdpi_real_t drive_V, rdpi_real_t rate_um_per_s)
{
    start();
    rdpi_f32_forward(&axis, 3, 256);
    EQUAL_REAL(2.875, rdpi_f32_forward(&axis, drive_V, rate_um_per_s));
    equal_memory(4, 3, 1);
    EQUAL_REAL(3, axis.drive_V);
    EQUAL_REAL(256, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
}

void test_forward_of_a_drive_that_is_not_finite_changes_no_state(void)
{
    forward_changes_nothing(NAN, 0);
    forward_changes_nothing(INFINITY, 0);
    forward_changes_nothing(-INFINITY, 0);
}

void test_forward_at_a_rate_that_is_not_finite_changes_no_state(void)
{
    forward_changes_nothing(0, NAN);
    forward_changes_nothing(0, INFINITY);
}

void test_init_refuses_a_slew_whose_share_of_one_sample_is_lost_in_rounding(void)
{
    params.slew_V_per_s = 1000 * (params.max_V - params.min_V);
    TEST_ASSERT_EQUAL(RDPI_OK, rdpi_f32_init(&axis, &params, T_S));
    params.slew_V_per_s = (rdpi_real_t)1e-30;
    refused(RDPI_ERR_DRIVE);
}
