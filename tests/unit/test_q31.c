#include "unity.h"

#include <math.h>
#include <string.h>

#include "actuator_q31.h"
#include "crc.h"
#include "random_bits.h"
#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#define PLAYS 3
#define DEADZONES 2
#define T_NS ((uint32_t)1 << 20)
#define ONE RDPI_Q31_ONE
#define MAX RDPI_Q31_MAX_DRIVE
#define NONE RDPI_Q31_NO_REFERENCE
#define FAR INT32_MAX                                                 /* a reference out of reach */
#define PER_SAMPLE(drive) ((uint64_t)(drive) * ((uint64_t)1000 << 12)) /* as a speed per us, times 2^32 */
#define NEAR(expected, actual) TEST_ASSERT_INT32_WITHIN(16, expected, actual)

/* z = 2 v, half as steep beyond z = 2 U. On the first rise z is 0.5 U at x = U, 2.5 at 3 U if S did not bend, then 1.5
 * per U. At the guard, U / 4 a sample, W_0 and W_1 have lost what makes 0.25 of z per U. */
static actuator_q31_t given;
static rdpi_q31_t axis;

static void set3(int32_t *values, int32_t a, int32_t b, int32_t c)
{
    values[0] = a;
    values[1] = b;
    values[2] = c;
}

void setUp(void)
{
    random_state = 7;
    memset(&axis, 0, sizeof axis);
    given = (actuator_q31_t){
        .play = {{0, ONE / 4, -ONE / 8}, {U, ONE / 2, -ONE / 8}, {3 * U, ONE / 4 * 3, 0}},
        .saturation = {{0, 1 << 30}, {U, -(1 << 29)}},         /* over 2^29: 2, then 1 */
        .inverse_saturation = {{0, 1 << 29}, {2 * U, 1 << 29}}, /* 1/2, then 1 */
        .params = {
            .plays = PLAYS,
            .deadzones = DEADZONES,
            .saturation_shift = 29,
            .inverse_shift = 30,
            .guard_mantissa = (uint32_t)1 << 31,
            .guard_exponent = -33, /* 2^(31 - 33 + 20) = U / 4 a sample */
            .min_slope_ratio = 32768, /* W_0 just keeps it */
            .min_drive = -32 * U,
            .max_drive = 28 * U,
            .sweep_end = 4 * U,
            .sweep_per_us = PER_SAMPLE(U / 8),
            .sweep_cycles = 4,
        },
    };
    actuator_q31_derive(&given);
}

void tearDown(void)
{
}

/* Whatever a test has changed: what follows from it, then init. */
static rdpi_status_t init(void)
{
    actuator_q31_derive(&given);
    return rdpi_q31_init(&axis, &given.params, T_NS);
}

static void start(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_OK, init());
}

static void refused(rdpi_status_t status)
{
    TEST_ASSERT_EQUAL_INT(status, init());
}

/* Parameters as they are, their digest too. */
static void refused_as_they_are(rdpi_status_t status)
{
    TEST_ASSERT_EQUAL_INT(status, rdpi_q31_init(&axis, &given.params, T_NS));
}

static void without_rate_law(void)
{
    for (size_t i = 0; i < PLAYS; i++) {
        given.play[i].slope_rate = 0;
    }
}

/* One play of slope `slope` and one piece that passes references as they are: x = z 2^30 / slope. */
static void one_slope(int32_t slope)
{
    given.params.plays = given.params.deadzones = 1;
    given.play[0] = (rdpi_q31_play_t){0, slope, 0};
    given.saturation[0].weight = 1 << 29;
    given.inverse_saturation[0].weight = 1 << 30;
}

static void whole_format(void)
{
    given.params.min_drive = -MAX;
    given.params.max_drive = MAX;
}

static void near_memory(int32_t y0, int32_t y1, int32_t y2)
{
    int32_t y[PLAYS];
    rdpi_q31_get_memory(&axis, y);
    NEAR(y0, y[0]);
    NEAR(y1, y[1]);
    NEAR(y2, y[2]);
}

static void equal_memory(int32_t y0, int32_t y1, int32_t y2)
{
    int32_t y[PLAYS];
    rdpi_q31_get_memory(&axis, y);
    TEST_ASSERT_EQUAL_INT32(y0, y[0]);
    TEST_ASSERT_EQUAL_INT32(y1, y[1]);
    TEST_ASSERT_EQUAL_INT32(y2, y[2]);
}

/* The actuator of these parameters, literally by eq. 1, 7, 8, 9 and 16, in double. */
static double plant_y[PLAYS];

static double plant(double drive, double rate)
{
    double v = 0, below = 0;
    for (size_t i = 0; i < PLAYS; i++) {
        const rdpi_q31_play_t *play = &given.play[i];
        double slope = ldexp(play->slope + ldexp(play->slope_rate * rate, -30), -30);
        plant_y[i] = fmax(drive - play->r, fmin(drive + play->r, plant_y[i]));
        v += (slope - below) * plant_y[i];
        below = slope;
    }
    double sum = given.saturation[0].weight * v + given.saturation[1].weight * fmax(v - given.saturation[1].d, 0);
    return ldexp(sum, -given.params.saturation_shift);
}

static void plant_at_rest(void)
{
    plant_y[0] = plant_y[1] = plant_y[2] = 0;
}

/* The library's plays stand where the drive has put the actuator's, to the last bit. */
static void equal_plant_memory(void)
{
    equal_memory((int32_t)plant_y[0], (int32_t)plant_y[1], (int32_t)plant_y[2]);
}

/* ---- init: what it refuses, and beside it what it accepts ---- */

/* Compiled with other settings than the library: nothing of the caller's is looked at. tests/consumer/settings.sh links
 * such callers. */
void test_init_refuses_a_caller_of_another_layout_before_all_else(void)
{
    const uint64_t others[] = {RDPI_Q31_LAYOUT + 1u, RDPI_Q31_LAYOUT ^ (uint64_t)1 << 63, 0};
    for (size_t k = 0; k < sizeof others / sizeof others[0]; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_SIZE, rdpi_q31_init_layout(others[k], NULL, NULL, T_NS));
    }
}

void test_digest_for_another_layout_is_0(void)
{
    TEST_ASSERT_EQUAL_HEX32(0, rdpi_q31_digest_layout(RDPI_Q31_LAYOUT + 1u, NULL));
}

void test_init_refuses_no_instance_and_no_parameters(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_q31_init(NULL, &given.params, T_NS));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_q31_init(&axis, NULL, T_NS));
}

void test_init_refuses_each_array_that_is_not_there(void)
{
    given.params.play = NULL;
    refused_as_they_are(RDPI_ERR_NULL);
    actuator_q31_seal(&given);
    given.params.saturation = NULL;
    refused_as_they_are(RDPI_ERR_NULL);
    actuator_q31_seal(&given);
    given.params.inverse_saturation = NULL;
    refused_as_they_are(RDPI_ERR_NULL);
    actuator_q31_seal(&given);
    given.params.memory = NULL;
    refused_as_they_are(RDPI_ERR_NULL);
    start();
}

void test_init_refuses_another_schema(void)
{
    given.params.schema = RDPI_PARAMS_SCHEMA + 1u;
    refused_as_they_are(RDPI_ERR_SCHEMA);
    given.params.schema = RDPI_PARAMS_SCHEMA - 1u;
    refused_as_they_are(RDPI_ERR_SCHEMA);
    given.params.schema = RDPI_PARAMS_SCHEMA;
    refused_as_they_are(RDPI_OK);
}

void test_init_refuses_no_plays_and_more_than_the_maximum(void)
{
    given.params.plays = 0;
    refused_as_they_are(RDPI_ERR_COUNT);
    given.params.plays = RDPI_MAX_PLAYS + 1;
    refused_as_they_are(RDPI_ERR_COUNT);
}

void test_init_refuses_no_dead_zones_and_more_than_the_maximum(void)
{
    given.params.deadzones = 0;
    refused_as_they_are(RDPI_ERR_COUNT);
    given.params.deadzones = RDPI_MAX_DEADZONES + 1;
    refused_as_they_are(RDPI_ERR_COUNT);
}

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

void test_init_refuses_a_rate_window_of_too_many_samples(void)
{
    given.params.rate_window_ns = (RDPI_MAX_WINDOW + 1) * T_NS;
    refused(RDPI_ERR_WINDOW);
    given.params.rate_window_ns = RDPI_MAX_WINDOW * T_NS;
    start();
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

/* ---- init: codes ---- */

/* One U a code, code 16 at 0. */
static void five_bit_dac(void)
{
    given.params.min_drive = -16 * U;
    given.params.max_drive = 15 * U;
    actuator_q31_codes(&given, 5, false);
}

void test_init_refuses_more_than_20_dac_bits(void)
{
    actuator_q31_codes(&given, 21, false);
    refused(RDPI_ERR_DRIVE);
    actuator_q31_codes(&given, 20, false);
    start();
    actuator_q31_codes(&given, 1, false);
    start();
}

void test_init_refuses_shifts_of_codes_outside_1_to_62(void)
{
    const uint8_t bad[] = {0, 63, 64, 255};
    for (size_t k = 0; k < 4; k++) {
        five_bit_dac();
        given.params.code_shift = bad[k];
        refused(RDPI_ERR_DRIVE);
        five_bit_dac();
        given.params.drive_shift = bad[k];
        refused(RDPI_ERR_DRIVE);
    }
}

void test_init_accepts_the_smallest_and_the_largest_shifts_of_codes(void)
{
    given.params.min_drive = 0;
    given.params.max_drive = 31;
    given.params.sweep_end = 0;
    actuator_q31_codes(&given, 5, false);
    given.params.code_shift = given.params.drive_shift = 1;
    given.params.codes_per_drive = given.params.drive_per_code = 2;
    start();
    rdpi_q31_step(&axis, FAR);
    TEST_ASSERT_EQUAL_UINT32(31, axis.dac_code);

    whole_format();
    actuator_q31_codes(&given, 1, true);
    given.params.code_shift = 62;
    given.params.codes_per_drive = INT32_MIN; /* 2^30 / 2^31 of a code, rounded up */
    start();
    rdpi_q31_step(&axis, -FAR);
    TEST_ASSERT_EQUAL_UINT32(1, axis.dac_code);
    TEST_ASSERT_EQUAL_INT32(-MAX, axis.drive);
    rdpi_q31_forward(&axis, 1 - MAX, 0);
    TEST_ASSERT_EQUAL_UINT32(0, axis.dac_code);

    given.params.min_drive = given.params.sweep_end = 0;
    given.params.max_drive = 2;
    actuator_q31_codes(&given, 1, false);
    given.params.drive_shift = 62; /* of 31 bits nothing is left, and two drives is what may be missing */
    start();
}

void test_init_refuses_a_code_0_that_is_at_neither_end(void)
{
    five_bit_dac();
    given.params.drive_of_code_0++;
    refused(RDPI_ERR_DRIVE);
    actuator_q31_codes(&given, 5, true);
    given.params.drive_of_code_0++;
    refused(RDPI_ERR_DRIVE);
    given.params.drive_of_code_0--;
    start();
}

void test_init_refuses_codes_that_run_away_from_the_range(void)
{
    five_bit_dac();
    given.params.codes_per_drive *= -1;
    refused(RDPI_ERR_DRIVE);
    five_bit_dac();
    given.params.drive_per_code *= -1;
    refused(RDPI_ERR_DRIVE);
    five_bit_dac();
    given.params.drive_of_code_0 = given.params.max_drive;
    refused(RDPI_ERR_DRIVE);
    actuator_q31_codes(&given, 5, true);
    given.params.codes_per_drive *= -1;
    refused(RDPI_ERR_DRIVE);
    actuator_q31_codes(&given, 5, true);
    given.params.drive_per_code *= -1;
    refused(RDPI_ERR_DRIVE);
    actuator_q31_codes(&given, 5, true);
    given.params.codes_per_drive = 0;
    refused(RDPI_ERR_DRIVE);
}

/* Half a code at the other end is what rounding allows, and two drives what 31 bits resolve. */
void test_init_refuses_steps_of_codes_that_do_not_fit_the_range(void)
{
    for (int falling = 0; falling < 2; falling++) {
        for (int change = -1; change <= 1; change += 2) {
            five_bit_dac();
            actuator_q31_codes(&given, 5, falling);
            int32_t fits = given.params.codes_per_drive, unit = given.params.drive_per_code / (31 * U);
            given.params.codes_per_drive = fits + change * (fits / 61);
            refused(RDPI_ERR_DRIVE);
            given.params.codes_per_drive = fits + change * (fits / 63);
            start();
            given.params.codes_per_drive = fits;
            given.params.drive_per_code += 3 * change * unit;
            refused(RDPI_ERR_DRIVE);
            given.params.drive_per_code -= change * unit;
            start();
        }
    }
}

/* Codes that would go on beyond the range are as wrong as those that do not reach it. */
void test_init_refuses_steps_of_codes_twice_and_half_as_large(void)
{
    const unsigned bits[] = {1, 5, 20};
    for (unsigned k = 0; k < 4; k++) {
        bool twice = (k & 1u) != 0u, falling = (k & 2u) != 0u;
        for (size_t i = 0; i < 3; i++) {
            actuator_q31_codes(&given, bits[i], falling);
            given.params.code_shift = (uint8_t)(given.params.code_shift + (twice ? -1 : 1));
            refused(RDPI_ERR_DRIVE);
            actuator_q31_codes(&given, bits[i], falling);
            given.params.drive_shift = (uint8_t)(given.params.drive_shift + (twice ? -1 : 1));
            refused(RDPI_ERR_DRIVE);
        }
    }
}

void test_init_refuses_a_code_0_at_neither_end_even_where_there_are_no_codes(void)
{
    given.params.drive_of_code_0 = -32 * U + 1;
    actuator_q31_seal(&given);
    refused_as_they_are(RDPI_ERR_DRIVE);
    given.params.drive_of_code_0 = 28 * U;
    actuator_q31_seal(&given);
    refused_as_they_are(RDPI_OK);
}

void test_init_does_not_read_the_steps_of_codes_where_there_are_no_codes(void)
{
    const uint8_t shifts[] = {1, 255};
    for (size_t k = 0; k < 2; k++) {
        given.params.code_shift = given.params.drive_shift = shifts[k];
        given.params.codes_per_drive = given.params.drive_per_code = 1;
        start();
        TEST_ASSERT_EQUAL_UINT32(0, axis.dac_code);
        rdpi_q31_step(&axis, 3 * U);
        TEST_ASSERT_EQUAL_UINT32(0, axis.dac_code);
    }
}

/* ---- init: the digest ---- */

static void one_bit_of(void *data, size_t size)
{
    unsigned char *bytes = data;
    for (size_t bit = 0; bit < 8u * size; bit++) {
        bytes[bit / 8u] ^= (unsigned char)(1u << bit % 8u);
        rdpi_status_t status = rdpi_q31_init(&axis, &given.params, T_NS);
        TEST_ASSERT_TRUE(status == RDPI_ERR_DIGEST || status == RDPI_ERR_COUNT);
        bytes[bit / 8u] ^= (unsigned char)(1u << bit % 8u);
    }
}

void test_init_refuses_one_wrong_bit_in_any_number_and_in_the_digest_itself(void)
{
    one_bit_of(&given.params.digest, sizeof given.params.digest);
    one_bit_of(&given.params.slew_per_us,
               offsetof(rdpi_q31_params_t, sweep_end) + sizeof(int32_t) - offsetof(rdpi_q31_params_t, slew_per_us));
    refused_as_they_are(RDPI_OK);
}

void test_init_refuses_one_wrong_bit_in_any_array(void)
{
    one_bit_of(given.play, PLAYS * sizeof given.play[0]);
    one_bit_of(given.saturation, DEADZONES * sizeof given.saturation[0]);
    one_bit_of(given.inverse_saturation, DEADZONES * sizeof given.inverse_saturation[0]);
    one_bit_of(given.memory, PLAYS * sizeof given.memory[0]);
    refused_as_they_are(RDPI_OK);
}

void test_digest_does_not_depend_on_addresses_schema_and_digest(void)
{
    actuator_q31_t copy = given;
    actuator_q31_seal(&copy);
    TEST_ASSERT_EQUAL_HEX32(given.params.digest, copy.params.digest);
    copy.params.schema = 77;
    copy.params.digest = 77;
    TEST_ASSERT_EQUAL_HEX32(given.params.digest, rdpi_q31_digest(&copy.params));
}

/* Field after field: the struct has no gaps. */
void test_digest_is_the_checksum_of_everything_in_the_order_of_the_struct(void)
{
    const rdpi_q31_params_t *params = &given.params;
    uint32_t crc = 0;
#define ADD(field) crc = rdpi_crc32(crc, &params->field, sizeof params->field)
    ADD(slew_per_us);
    ADD(sweep_per_us);
    ADD(plays);
    ADD(deadzones);
    ADD(dac_bits);
    ADD(sweep_cycles);
    ADD(saturation_shift);
    ADD(inverse_shift);
    ADD(code_shift);
    ADD(drive_shift);
    ADD(guard_exponent);
    ADD(min_slope_ratio);
    ADD(guard_mantissa);
    ADD(rate_window_ns);
    ADD(rate_filter_ns);
    ADD(min_drive);
    ADD(max_drive);
    ADD(drive_of_code_0);
    ADD(codes_per_drive);
    ADD(drive_per_code);
    ADD(sweep_end);
#undef ADD
    crc = rdpi_crc32(crc, given.play, PLAYS * sizeof given.play[0]);
    crc = rdpi_crc32(crc, given.saturation, DEADZONES * sizeof given.saturation[0]);
    crc = rdpi_crc32(crc, given.inverse_saturation, DEADZONES * sizeof given.inverse_saturation[0]);
    crc = rdpi_crc32(crc, given.memory, PLAYS * sizeof given.memory[0]);
    TEST_ASSERT_EQUAL_HEX32(crc, rdpi_q31_digest(params));
}

/* ---- what init leaves ---- */

void test_init_leaves_the_drive_that_holds_the_memory(void)
{
    set3(given.memory, 3 * U, 2 * U, U / 2);
    start();
    TEST_ASSERT_EQUAL_INT32(3 * U, axis.drive);
    equal_memory(3 * U, 2 * U, U / 2);
    TEST_ASSERT_EQUAL_INT32(0, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(0, axis.dac_code);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.guard_count | axis.clip_count | axis.input_count | axis.missed_count);
}

/* ---- the step ---- */

void test_first_step_is_solved_at_rate_zero(void)
{
    start();
    NEAR(4 * U, rdpi_q31_step(&axis, 3 * U));
    TEST_ASSERT_EQUAL_INT32(0, axis.rate);
    near_memory(4 * U, 3 * U, U);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* At half the guard W_0 is 0.1875. */
void test_second_step_is_solved_with_the_slopes_of_its_rate(void)
{
    start();
    NEAR(U / 2, rdpi_q31_step(&axis, U / 4));
    NEAR(U, rdpi_q31_step(&axis, U / 8 * 3));
    TEST_ASSERT_EQUAL_INT32(ONE / 2, axis.rate);
}

void test_step_undoes_the_saturation_stage(void)
{
    start();
    NEAR(7 * U / 3, rdpi_q31_step(&axis, 2 * U - U / 6)); /* v = 11 / 12 U: z = 2 v */
    start();
    NEAR(5 * U, rdpi_q31_step(&axis, 3 * U + U / 4 * 3)); /* v = 2.75 U: z = 2 U + (v - U) */
}

void test_step_returns_what_it_stores(void)
{
    start();
    for (int32_t k = 0; k < 20; k++) {
        int32_t drive = rdpi_q31_step(&axis, k * k % 7 * U);
        TEST_ASSERT_EQUAL_INT32(axis.drive, drive);
    }
}

/* Rounded by no more than the saturation of references does to the model. */
static void follows(int32_t reference)
{
    int32_t drive = rdpi_q31_step(&axis, reference);
    TEST_ASSERT_DOUBLE_WITHIN(32, reference, plant(drive, axis.rate));
    equal_plant_memory();
}

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

void test_rate_window_and_filter_act_in_the_chain(void)
{
    given.params.rate_window_ns = 2 * T_NS;
    given.params.rate_filter_ns = 4 * T_NS;
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_step(&axis, U / 4); /* half of the guard's distance per window */
    TEST_ASSERT_INT32_WITHIN(16, (int32_t)(ONE / 2 * (1 - exp(-0.25))), axis.rate);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* ---- guard ---- */

void test_guard_clamps_the_rate_flags_and_counts(void)
{
    start();
    rdpi_q31_step(&axis, 0);
    NEAR(U / 2 * 3, rdpi_q31_step(&axis, U / 8 * 5)); /* two and a half times the guard; v = 5 / 16 U */
    TEST_ASSERT_EQUAL_INT32(ONE, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_GUARD, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
}

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

void test_flags_are_those_of_the_latest_step_and_counts_stay(void)
{
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_step(&axis, U);
    rdpi_q31_step(&axis, U);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
}

/* ---- clipping ---- */

void test_drive_outside_the_range_is_clipped_flagged_and_counted(void)
{
    start();
    TEST_ASSERT_EQUAL_INT32(28 * U, rdpi_q31_step(&axis, FAR));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
    start();
    TEST_ASSERT_EQUAL_INT32(-32 * U, rdpi_q31_step(&axis, -FAR));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
}

void test_drive_just_inside_the_range_is_not_clipped(void)
{
    given.params.sweep_end = 0;
    given.params.max_drive = 4 * U;
    start();
    NEAR(4 * U, rdpi_q31_step(&axis, 3 * U));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* Up to x = 2 (z = 1.5) instead of the x = 3 asked for; from there down to z = 1.25 at 0.5 per U. Plays that had
 * followed the wish would stand at 3, 2, 0 and answer with another drive. */
void test_after_a_range_clip_the_plays_stand_where_the_actuator_does(void)
{
    without_rate_law();
    given.params.sweep_end = 0;
    given.params.max_drive = 2 * U;
    start();
    rdpi_q31_step(&axis, 9 * U / 4);
    equal_memory(2 * U, U, 0);
    NEAR(3 * U / 2, rdpi_q31_step(&axis, 5 * U / 4));
    near_memory(3 * U / 2, U, 0);
}

void test_slew_limits_the_change_flags_and_counts(void)
{
    given.params.slew_per_us = PER_SAMPLE(U);
    start();
    TEST_ASSERT_EQUAL_INT32(U, rdpi_q31_step(&axis, 3 * U));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_SLEW, axis.flags);
    TEST_ASSERT_EQUAL_INT32(2 * U, rdpi_q31_step(&axis, 3 * U));
    TEST_ASSERT_EQUAL_INT32(U, rdpi_q31_step(&axis, -3 * U));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_SLEW, axis.flags & RDPI_FLAG_SLEW);
    TEST_ASSERT_EQUAL_UINT32(3, axis.clip_count);
}

void test_slew_starts_from_the_drive_of_the_memory(void)
{
    set3(given.memory, 8 * U, 8 * U, 8 * U);
    given.params.slew_per_us = PER_SAMPLE(U);
    start();
    TEST_ASSERT_EQUAL_INT32(7 * U, rdpi_q31_step(&axis, 0));
}

void test_a_change_within_the_slew_limit_is_not_clipped(void)
{
    given.params.slew_per_us = PER_SAMPLE(4 * U);
    start();
    NEAR(4 * U, rdpi_q31_step(&axis, 3 * U));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

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

/* x = 1, 2 where 4 was asked for; then z = 1 is met by falling 1 U at 0.5 per U from z = 1.5. */
void test_after_a_slew_clip_the_plays_stand_where_the_actuator_does(void)
{
    without_rate_law();
    given.params.slew_per_us = PER_SAMPLE(U + U / 8);
    start();
    rdpi_q31_step(&axis, 3 * U);
    equal_memory(U + U / 8, U / 8, 0);
    given.params.slew_per_us = PER_SAMPLE(U);
    start();
    rdpi_q31_step(&axis, 3 * U);
    rdpi_q31_step(&axis, 3 * U);
    equal_memory(2 * U, U, 0);
    NEAR(U + 8, rdpi_q31_step(&axis, U + 4));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags & RDPI_FLAG_SLEW);
}

void test_a_drive_clipped_by_range_and_slew_has_both_flags_and_one_count(void)
{
    given.params.slew_per_us = PER_SAMPLE(U);
    start();
    TEST_ASSERT_EQUAL_INT32(U, rdpi_q31_step(&axis, FAR));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE | RDPI_FLAG_SLEW, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
}

void test_guard_and_clip_in_one_step_are_both_flagged(void)
{
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_step(&axis, FAR);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_GUARD | RDPI_FLAG_RANGE, axis.flags);
}

void test_slew_zero_means_unlimited(void)
{
    start();
    rdpi_q31_step(&axis, -FAR);
    TEST_ASSERT_EQUAL_INT32(28 * U, rdpi_q31_step(&axis, FAR));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags & RDPI_FLAG_SLEW);
}

static void starts_with_sample_time(uint32_t sample_time_ns)
{
    actuator_q31_derive(&given);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&axis, &given.params, sample_time_ns));
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

/* After clips of every kind the drive makes the actuator follow again, because the states never left it. */
void test_tracking_is_exact_again_as_soon_as_clipping_ends(void)
{
    uint32_t clipped = 0, exact = 0;
    given.params.min_drive = -5 * U;
    given.params.max_drive = 9 * U / 2;
    given.params.slew_per_us = PER_SAMPLE(2 * U / 5);
    start();
    plant_at_rest();
    for (int k = 0; k < 3000; k++) {
        int32_t reference = (int32_t)(6 * U * sin(0.02 * k) + 2 * U * sin(0.13 * k));
        int32_t drive = rdpi_q31_step(&axis, reference);
        double displacement = plant(drive, axis.rate);
        equal_plant_memory();
        if ((axis.flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0) {
            clipped++;
        } else {
            TEST_ASSERT_DOUBLE_WITHIN(32, reference, displacement);
            exact++;
        }
    }
    TEST_ASSERT_EQUAL_UINT32(clipped, axis.clip_count);
    TEST_ASSERT_GREATER_THAN_UINT32(200, clipped);
    TEST_ASSERT_GREATER_THAN_UINT32(200, exact);
}

/* ---- DAC ---- */

void test_without_dac_bits_the_code_stays_zero(void)
{
    start();
    rdpi_q31_step(&axis, 3 * U);
    TEST_ASSERT_EQUAL_UINT32(0, axis.dac_code);
}

void test_dac_rounds_the_drive_to_the_nearest_code(void)
{
    without_rate_law();
    five_bit_dac();
    start();
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_step(&axis, U / 16 * 3)); /* wish 3/8 U */
    TEST_ASSERT_EQUAL_UINT32(16, axis.dac_code);
    TEST_ASSERT_EQUAL_INT32(2 * U, rdpi_q31_step(&axis, U / 8 * 9)); /* wish 13/8 U */
    TEST_ASSERT_EQUAL_UINT32(18, axis.dac_code);
    TEST_ASSERT_EQUAL_INT32(2 * U, axis.drive);
}

void test_dac_rounding_alone_is_not_a_clip(void)
{
    five_bit_dac();
    start();
    rdpi_q31_step(&axis, U / 16 * 3);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.clip_count);
}

void test_plays_follow_the_rounded_drive(void)
{
    without_rate_law();
    five_bit_dac();
    start();
    rdpi_q31_step(&axis, U / 16 * 3);
    equal_memory(0, 0, 0);
    rdpi_q31_step(&axis, U / 8 * 9);
    equal_memory(2 * U, U, 0);
}

void test_memory_has_the_nearest_code(void)
{
    five_bit_dac();
    set3(given.memory, 5 * U + U / 2, 5 * U, 3 * U); /* half way: the upper one */
    start();
    TEST_ASSERT_EQUAL_UINT32(22, axis.dac_code);
    given.memory[0]--;
    start();
    TEST_ASSERT_EQUAL_UINT32(21, axis.dac_code);
}

/* With a negative gain the highest voltage, the last code, is at the lowest x. */
void test_falling_codes_turn_the_drive_over(void)
{
    five_bit_dac();
    actuator_q31_codes(&given, 5, true);
    start();
    TEST_ASSERT_EQUAL_UINT32(15, axis.dac_code);
    TEST_ASSERT_EQUAL_INT32(4 * U, rdpi_q31_step(&axis, 3 * U));
    TEST_ASSERT_EQUAL_UINT32(11, axis.dac_code);
    TEST_ASSERT_EQUAL_INT32(15 * U, rdpi_q31_step(&axis, FAR));
    TEST_ASSERT_EQUAL_UINT32(0, axis.dac_code);
    TEST_ASSERT_EQUAL_INT32(-16 * U, rdpi_q31_step(&axis, -FAR));
    TEST_ASSERT_EQUAL_UINT32(31, axis.dac_code);
}

void test_ends_of_the_range_are_the_first_and_the_last_code_for_any_resolution(void)
{
    const int32_t ranges[][2] = {{-MAX, MAX},   {-MAX, -MAX + 1}, {0, MAX},  {-32 * U, 28 * U},
                                 {-7, 1234567}, {MAX - 1, MAX},   {-MAX, 3}};
    for (size_t k = 0; k < sizeof ranges / sizeof ranges[0]; k++) {
        given.params.min_drive = given.params.sweep_end = ranges[k][0];
        given.params.max_drive = ranges[k][1];
        set3(given.memory, ranges[k][0], ranges[k][0], ranges[k][0]);
        for (unsigned bits = 1; bits <= RDPI_MAX_DAC_BITS; bits++) {
            for (int falling = 0; falling < 2; falling++) {
                uint32_t last = ((uint32_t)1 << bits) - 1u;
                actuator_q31_codes(&given, bits, falling);
                start();
                TEST_ASSERT_EQUAL_HEX32(falling ? last : 0, axis.dac_code);
                TEST_ASSERT_EQUAL_INT32(ranges[k][1], rdpi_q31_step(&axis, FAR));
                TEST_ASSERT_EQUAL_HEX32(falling ? 0 : last, axis.dac_code);
                TEST_ASSERT_EQUAL_INT32(ranges[k][0], rdpi_q31_step(&axis, -FAR));
                TEST_ASSERT_EQUAL_HEX32(falling ? last : 0, axis.dac_code);
            }
        }
    }
}

/* Between codes by the definition; a drive of the code then has that code, where codes are not closer than drives. */
void test_codes_are_the_nearest_over_the_whole_range(void)
{
    whole_format();
    for (unsigned bits = 1; bits <= RDPI_MAX_DAC_BITS; bits++) {
        bool falling = bits % 2u;
        double last = ldexp(1, (int)bits) - 1, code = ldexp(1, 30) / last;
        actuator_q31_codes(&given, bits, falling);
        start();
        for (int k = 0; k < 500; k++) {
            int32_t drive = random_between(-MAX, MAX);
            rdpi_q31_forward(&axis, drive, 0);
            double nearest = falling ? MAX - axis.dac_code * code : axis.dac_code * code - MAX;
            TEST_ASSERT_DOUBLE_WITHIN(code / 2 + 1, drive, nearest);
            uint32_t seen = axis.dac_code;
            rdpi_q31_forward(&axis, (int32_t)floor(nearest + 0.5), 0);
            TEST_ASSERT_EQUAL_UINT32(seen, axis.dac_code);
        }
    }
}

/* Without a slew limit, and with one that never limits: the same codes and drives, coarse or fine. */
void test_codes_do_not_depend_on_how_they_are_found(void)
{
    whole_format();
    for (unsigned bits = 1; bits <= RDPI_MAX_DAC_BITS; bits++) {
        for (int falling = 0; falling < 2; falling++) {
            for (unsigned shift = 0; shift < 26u; shift += 5u) { /* down to steps of less than one drive unit */
                rdpi_q31_t twin;
                given.params.max_drive = (MAX >> shift) - 3;
                given.params.min_drive = -(MAX >> shift);
                given.params.sweep_end = 0;
                given.params.slew_per_us = 0;
                actuator_q31_codes(&given, bits, falling);
                start();
                twin = axis;
                given.params.slew_per_us = UINT64_MAX;
                start();
                TEST_ASSERT_TRUE(twin.slew == 0 && axis.slew > 0);
                actuator_q31_t limited = given;
                given.params.slew_per_us = 0;
                actuator_q31_derive(&given);
                actuator_q31_seal(&limited);
                axis.params = &limited.params;
                rdpi_q31_reset(&axis); /* its plays are elsewhere */
                for (int k = 0; k < 200; k++) {
                    int32_t reference = random_size(MAX >> shift, 3);
                    rdpi_q31_step(&twin, reference);
                    rdpi_q31_step(&axis, reference);
                    TEST_ASSERT_EQUAL_INT32(axis.drive, twin.drive);
                    TEST_ASSERT_EQUAL_HEX32(axis.dac_code, twin.dac_code);
                    TEST_ASSERT_EQUAL_INT64(axis.ramp, twin.ramp);
                    TEST_ASSERT_EQUAL_HEX32(axis.flags, twin.flags);
                }
            }
        }
    }
}

/* Within what init allows: the range ends before the last code. */
void test_the_last_code_s_drive_ends_with_the_range(void)
{
    int32_t y[PLAYS];
    given.params.max_drive = MAX - 10;
    given.params.min_drive = -MAX + 10;
    actuator_q31_codes(&given, 20, false);
    given.params.drive_per_code++; /* a unit of 2^30, and so is the last drive */
    start();
    TEST_ASSERT_TRUE(axis.direct_output);
    TEST_ASSERT_EQUAL_INT32(MAX - 10, rdpi_q31_step(&axis, FAR));
    TEST_ASSERT_EQUAL_INT32((1 << 20) - 1, axis.dac_code);
    rdpi_q31_get_memory(&axis, y);
    TEST_ASSERT_EQUAL_INT32(MAX - 10, y[0]);
}

/* Within what init allows: the last code's drive is some units beyond the range. For codes that `output` makes, of which
 * the highest voltage is at either end. */
static void ends_with_the_range(bool falling)
{
    const rdpi_q31_params_t *params = &given.params;
    int32_t end = falling ? params->min_drive : params->max_drive;
    int64_t last = ((int64_t)1 << params->dac_bits) - 1, unit = ((int64_t)1 << params->drive_shift) / last + 1;
    given.params.drive_per_code += (int32_t)(falling ? -unit : unit);
    start();
    TEST_ASSERT_FALSE(axis.direct_output);
    TEST_ASSERT_EQUAL_INT32(end, rdpi_q31_step(&axis, falling ? -FAR : FAR));
    TEST_ASSERT_EQUAL_INT32(last, axis.dac_code);
    rdpi_q31_reset(&axis);
    bool more, reached = false;
    do {
        more = rdpi_q31_sweep(&axis);
        TEST_ASSERT_TRUE(axis.drive >= params->min_drive && axis.drive <= params->max_drive);
        reached = reached || axis.dac_code == last;
    } while (more);
    TEST_ASSERT_TRUE(reached);
}

void test_the_last_code_s_drive_ends_with_the_range_behind_a_slew_limit(void)
{
    given.params.slew_per_us = UINT64_MAX;
    for (int falling = 0; falling < 2; falling++) {
        actuator_q31_codes(&given, 12, falling);
        ends_with_the_range(falling);
    }
}

void test_the_last_code_s_drive_ends_with_the_range_where_codes_are_fine(void)
{
    given.params.max_drive = given.params.min_drive + (3 << 20);
    given.params.sweep_end = given.params.min_drive;
    given.params.sweep_per_us = PER_SAMPLE(1 << 18);
    for (int falling = 0; falling < 2; falling++) {
        set3(given.memory, given.params.min_drive, given.params.min_drive, given.params.min_drive);
        actuator_q31_codes(&given, 20, falling);
        ends_with_the_range(falling);
    }
}

/* The same quotients with fewer digits. */
void test_codes_do_not_depend_on_how_their_steps_are_written(void)
{
    rdpi_q31_t twin;
    given.params.dac_bits = 16;
    given.params.min_drive = given.params.drive_of_code_0 = -(1 << 28);
    given.params.max_drive = given.params.min_drive + (65535 << 13);
    given.params.codes_per_drive = given.params.drive_per_code = 1 << 30;
    given.params.code_shift = 43;
    given.params.drive_shift = 17;
    start();
    twin = axis;
    actuator_q31_t long_steps = given;
    actuator_q31_seal(&long_steps);
    twin.params = &long_steps.params;
    rdpi_q31_reset(&twin); /* its plays are elsewhere */
    given.params.drive_per_code = 1 << 14;
    given.params.drive_shift = 1;
    start();
    for (int k = 0; k < 1000; k++) {
        int32_t reference = random_size(MAX / 2, 3);
        TEST_ASSERT_EQUAL_INT32(rdpi_q31_step(&twin, reference), rdpi_q31_step(&axis, reference));
        TEST_ASSERT_EQUAL_HEX32(twin.dac_code, axis.dac_code);
    }
}

void test_clipped_by_range_and_slew_counts_once(void)
{
    given.params.slew_per_us = PER_SAMPLE(U);
    start();
    rdpi_q31_step(&axis, FAR);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE | RDPI_FLAG_SLEW, axis.flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW));
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
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

/* An eighth of a code a sample: the output goes more slowly, and does not freeze. */
void test_slew_finer_than_a_dac_code_still_arrives(void)
{
    five_bit_dac();
    given.params.slew_per_us = PER_SAMPLE(U / 8);
    start();
    for (int k = 0; k < 100; k++) {
        rdpi_q31_step(&axis, 3 * U);
    }
    TEST_ASSERT_EQUAL_INT32(4 * U, axis.drive);
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

/* ---- counters ---- */

void test_guard_count_stays_at_its_largest_value(void)
{
    start();
    axis.guard_count = UINT32_MAX - 1;
    for (int32_t k = 0; k < 4; k++) {
        rdpi_q31_step(&axis, k % 2 * U);
    }
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_GUARD, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.guard_count);
}

void test_clip_count_stays_at_its_largest_value(void)
{
    start();
    axis.clip_count = UINT32_MAX - 1;
    for (int k = 0; k < 3; k++) {
        rdpi_q31_step(&axis, FAR);
    }
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.clip_count);
}

void test_input_count_stays_at_its_largest_value(void)
{
    start();
    axis.input_count = UINT32_MAX - 1;
    for (int k = 0; k < 3; k++) {
        rdpi_q31_step(&axis, NONE);
    }
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.input_count);
}

/* ---- reset and memory ---- */

void test_reset_is_power_up_again(void)
{
    rdpi_q31_t fresh;
    set3(given.memory, 3 * U, 2 * U, U / 2);
    given.params.rate_window_ns = 4 * T_NS;
    given.params.rate_filter_ns = 4 * T_NS;
    actuator_q31_codes(&given, 10, false);
    start();
    memcpy(&fresh, &axis, sizeof axis);
    rdpi_q31_step(&axis, U);
    rdpi_q31_step(&axis, FAR);
    rdpi_q31_step(&axis, NONE);
    rdpi_q31_missed(&axis, 3);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
    TEST_ASSERT_EQUAL_UINT32(3, axis.missed_count);

    rdpi_q31_reset(&axis);

    TEST_ASSERT_EQUAL_INT32(3 * U, axis.drive);
    equal_memory(3 * U, 2 * U, U / 2);
    TEST_ASSERT_EQUAL_INT32(0, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(fresh.dac_code, axis.dac_code);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(0, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(0, axis.input_count);
    TEST_ASSERT_EQUAL_UINT32(0, axis.missed_count);
    for (int32_t k = 0; k < 20; k++) {
        TEST_ASSERT_EQUAL_INT32(rdpi_q31_step(&fresh, k % 6 * U), rdpi_q31_step(&axis, k % 6 * U));
        TEST_ASSERT_EQUAL_INT32(fresh.rate, axis.rate);
        TEST_ASSERT_EQUAL_UINT32(fresh.flags, axis.flags);
    }
}

void test_set_memory_moves_plays_and_drive(void)
{
    const int32_t y[PLAYS] = {5 * U, 4 * U, 5 * U / 2};
    five_bit_dac();
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, y));
    TEST_ASSERT_EQUAL_INT32(5 * U, axis.drive);
    TEST_ASSERT_EQUAL_UINT32(21, axis.dac_code);
    equal_memory(5 * U, 4 * U, 5 * U / 2);
}

/* At (5, 4, 2) with 0.5, 1, 1.5 of z per U: z = 5.5 without S's bend; falling 1 U takes 0.5. */
void test_step_goes_on_from_the_memory_set(void)
{
    const int32_t y[PLAYS] = {5 * U, 4 * U, 2 * U};
    given.params.deadzones = 1;
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, y));
    NEAR(4 * U, rdpi_q31_step(&axis, 5 * U));
    near_memory(4 * U, 4 * U, 2 * U);
}

void test_set_memory_leaves_rate_history_and_counters(void)
{
    const int32_t y[PLAYS] = {0, 0, 0};
    start();
    rdpi_q31_step(&axis, U / 4);
    rdpi_q31_step(&axis, FAR);
    rdpi_q31_step(&axis, NONE);
    rdpi_q31_step(&axis, FAR);
    rdpi_q31_step(&axis, U / 4);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, y));
    TEST_ASSERT_EQUAL_UINT32(2, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(2, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
    rdpi_q31_step(&axis, U / 8 * 3);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, axis.rate);
}

void test_get_memory_gives_what_set_memory_takes(void)
{
    int32_t y[PLAYS], again[PLAYS];
    rdpi_q31_t other;
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&other, &given.params, T_NS));
    for (int k = 0; k < 1000; k++) {
        rdpi_q31_step(&axis, random_size(FAR, 12));
        rdpi_q31_get_memory(&axis, y);
        TEST_ASSERT_EQUAL_INT32(axis.drive, y[0]);
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&other, y));
        rdpi_q31_get_memory(&other, again);
        TEST_ASSERT_EQUAL_MEMORY(y, again, sizeof y);
        TEST_ASSERT_EQUAL_INT32(axis.drive, other.drive);
    }
}

static void memory_refused(rdpi_status_t status, const int32_t *y)
{
    rdpi_q31_t before;
    start();
    rdpi_q31_step(&axis, U);
    rdpi_q31_step(&axis, 3 * U);
    memcpy(&before, &axis, sizeof axis);
    TEST_ASSERT_EQUAL_INT(status, rdpi_q31_set_memory(&axis, y));
    TEST_ASSERT_EQUAL_MEMORY(&before, &axis, sizeof axis);
}

void test_set_memory_refuses_no_states_and_changes_nothing(void)
{
    memory_refused(RDPI_ERR_NULL, NULL);
}

void test_set_memory_refuses_no_instance(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_q31_set_memory(NULL, given.memory));
}

/* No slack: one unit too far apart, or outside. */
void test_set_memory_refuses_states_one_unit_out_of_place_and_changes_nothing(void)
{
    const int32_t bad[][PLAYS] = {{3 * U, 2 * U - 1, 0}, {3 * U, 4 * U + 1, 4 * U}, {3 * U, 2 * U, 4 * U + 1},
                                  {28 * U + 1, 28 * U, 28 * U}, {-32 * U - 1, -32 * U, -32 * U}};
    const int32_t good[][PLAYS] = {{3 * U, 2 * U, 0}, {3 * U, 4 * U, 4 * U}, {3 * U, 2 * U, 4 * U},
                                   {28 * U, 29 * U, 31 * U}, {-32 * U, -33 * U, -35 * U}};
    for (size_t k = 0; k < 5; k++) {
        memory_refused(RDPI_ERR_MEMORY, bad[k]);
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, good[k]));
        equal_memory(good[k][0], good[k][1], good[k][2]);
    }
}

void test_set_memory_refuses_states_beyond_the_largest_drive(void)
{
    const int32_t bad[][PLAYS] = {{MAX, MAX + 1, MAX}, {-MAX, -MAX, -MAX - 1}, {INT32_MIN, INT32_MAX, 0}};
    const int32_t good[][PLAYS] = {{MAX, MAX, MAX}, {-MAX, -MAX, -MAX}};
    whole_format();
    for (size_t k = 0; k < 3; k++) {
        memory_refused(RDPI_ERR_MEMORY, bad[k]);
    }
    for (size_t k = 0; k < 2; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, good[k]));
        TEST_ASSERT_EQUAL_INT32(good[k][0], axis.drive);
    }
}

/* ---- prediction ---- */

/* At (4, 3, 1) with W = (1/4, 1/2, 3/4): v = 2 U; at the guard, (1/8, 3/8, 3/4): 13/8 U. There z = v + U. */
void test_predict_uses_the_slopes_of_the_rate_given_up_to_the_guard(void)
{
    start();
    TEST_ASSERT_EQUAL_INT32(3 * U, rdpi_q31_predict(&axis, 4 * U, 0));
    TEST_ASSERT_EQUAL_INT32(2 * U + 13 * U / 16, rdpi_q31_predict(&axis, 4 * U, ONE / 2));
    TEST_ASSERT_EQUAL_INT32(2 * U + 5 * U / 8, rdpi_q31_predict(&axis, 4 * U, ONE));
    TEST_ASSERT_EQUAL_INT32(2 * U + 5 * U / 8, rdpi_q31_predict(&axis, 4 * U, ONE + 1));
    TEST_ASSERT_EQUAL_INT32(2 * U + 5 * U / 8, rdpi_q31_predict(&axis, 4 * U, INT32_MAX));
}

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

void test_predict_does_not_limit_the_drive(void)
{
    start();
    TEST_ASSERT_EQUAL_INT32(30 * U, rdpi_q31_predict(&axis, 40 * U, 0)); /* v = 2 U + 36 * 3/4 U */
    TEST_ASSERT_EQUAL_INT32(-58 * U, rdpi_q31_predict(&axis, -40 * U, 0));
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

void test_forward_predicts_the_displacement_of_a_drive_and_remembers_it(void)
{
    start();
    TEST_ASSERT_EQUAL_INT32(3 * U, rdpi_q31_forward(&axis, 4 * U, 0));
    equal_memory(4 * U, 3 * U, U);
    TEST_ASSERT_EQUAL_INT32(4 * U, axis.drive);
    TEST_ASSERT_EQUAL_INT32(U, rdpi_q31_forward(&axis, 0, 0)); /* plays at 0, 1, 1: v = U / 2 */
}

void test_forward_stores_the_rate_given(void)
{
    start();
    rdpi_q31_forward(&axis, 4 * U, ONE);
    TEST_ASSERT_EQUAL_INT32(ONE, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

void test_forward_clamps_the_rate_at_the_guard(void)
{
    start();
    TEST_ASSERT_EQUAL_INT32(2 * U + 5 * U / 8, rdpi_q31_forward(&axis, 4 * U, ONE + 1));
    TEST_ASSERT_EQUAL_INT32(ONE, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_GUARD, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
    rdpi_q31_forward(&axis, 4 * U, 100);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
}

/* But for a sample that counts as missed. Returns the prediction for what is output still. */
static void forward_changes_nothing(int32_t drive, int32_t rate)
{
    rdpi_q31_t before;
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_forward(&axis, 4 * U, ONE);
    memcpy(&before, &axis, sizeof axis);
    TEST_ASSERT_EQUAL_INT32(2 * U + 5 * U / 8, rdpi_q31_forward(&axis, drive, rate));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
    rdpi_q31_step(&axis, 3 * U);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    rdpi_q31_step(&before, 3 * U);
    before.flags |= RDPI_FLAG_MISSED;
    before.input_count = 1;
    TEST_ASSERT_EQUAL_MEMORY(&before, &axis, sizeof axis);
}

void test_forward_of_an_unusable_input_changes_no_state(void)
{
    forward_changes_nothing(MAX + 1, 0);
    forward_changes_nothing(-MAX - 1, 0);
    forward_changes_nothing(NONE, 0);
    forward_changes_nothing(INT32_MAX, ONE);
    forward_changes_nothing(0, -1);
    forward_changes_nothing(0, INT32_MIN);
}

void test_refused_forward_outside_the_range_predicts_for_the_drive_inside(void)
{
    start();
    rdpi_q31_forward(&axis, 40 * U, 100);
    int32_t expected = rdpi_q31_predict(&axis, 28 * U, 100);
    TEST_ASSERT_EQUAL_INT32(expected, rdpi_q31_forward(&axis, INT32_MAX, 0));
}

void test_forward_drive_has_the_nearest_code(void)
{
    five_bit_dac();
    start();
    rdpi_q31_forward(&axis, 4 * U + U / 4, 0);
    TEST_ASSERT_EQUAL_UINT32(20, axis.dac_code);
    TEST_ASSERT_EQUAL_INT32(4 * U + U / 4, axis.drive);
    rdpi_q31_forward(&axis, MAX, 0);
    TEST_ASSERT_EQUAL_UINT32(31, axis.dac_code);
    rdpi_q31_forward(&axis, -MAX, 0);
    TEST_ASSERT_EQUAL_UINT32(0, axis.dac_code);
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

void test_forward_counts_no_clip(void)
{
    given.params.slew_per_us = PER_SAMPLE(U);
    start();
    rdpi_q31_forward(&axis, 40 * U, 0);
    rdpi_q31_forward(&axis, -40 * U, 0);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.clip_count);
}

void test_slew_starts_from_the_drive_of_forward(void)
{
    given.params.slew_per_us = PER_SAMPLE(U);
    start();
    rdpi_q31_forward(&axis, 10 * U, 0);
    TEST_ASSERT_EQUAL_INT32(9 * U, rdpi_q31_step(&axis, -3 * U));
    rdpi_q31_forward(&axis, 40 * U, 0);
    TEST_ASSERT_EQUAL_INT32(27 * U, rdpi_q31_step(&axis, -3 * U));
}

void test_forward_forgets_rate_history_and_missed_samples(void)
{
    given.params.rate_window_ns = 3 * T_NS;
    given.params.rate_filter_ns = 4 * T_NS;
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_step(&axis, U);
    rdpi_q31_missed(&axis, 2);
    rdpi_q31_forward(&axis, 3 * U, 0);
    rdpi_q31_step(&axis, 2 * U);
    TEST_ASSERT_EQUAL_INT32(0, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

void test_forward_counts_in_input_count_and_guard_count_up_to_their_largest_values(void)
{
    start();
    axis.guard_count = axis.input_count = UINT32_MAX - 1;
    for (int k = 0; k < 3; k++) {
        rdpi_q31_forward(&axis, 0, INT32_MAX);
        rdpi_q31_forward(&axis, 0, -1);
    }
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.input_count);
}

/* ---- missed samples ---- */

void test_after_missed_samples_the_rate_is_that_over_the_true_time(void)
{
    start();
    rdpi_q31_step(&axis, U / 4);
    rdpi_q31_missed(&axis, 3);
    rdpi_q31_step(&axis, U / 4 * 3);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(3, axis.missed_count);
}

void test_missed_is_flagged_once(void)
{
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_missed(&axis, 1);
    rdpi_q31_step(&axis, 0);
    rdpi_q31_step(&axis, U / 8);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.missed_count);
}

void test_no_ticks_missed_change_nothing(void)
{
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_missed(&axis, 0);
    rdpi_q31_step(&axis, U / 8);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* With window and filter: as if the references on the straight line had been seen. */
void test_missed_references_are_taken_to_lie_on_a_straight_line(void)
{
    rdpi_q31_t twin;
    given.params.rate_window_ns = 5 * T_NS;
    given.params.rate_filter_ns = 4 * T_NS;
    start();
    for (int32_t k = 0; k < 8; k++) {
        rdpi_q31_step(&axis, k % 3 * U / 8);
    }
    memcpy(&twin, &axis, sizeof axis);
    for (int32_t k = 1; k <= 4; k++) {
        rdpi_q31_step(&twin, U / 8 + k * U / 16);
    }
    rdpi_q31_missed(&axis, 2);
    rdpi_q31_missed(&axis, 1);
    rdpi_q31_step(&axis, U / 8 * 3);
    for (int32_t k = 0; k < 10; k++) {
        TEST_ASSERT_TRUE(axis.rate > ONE / 100 && axis.rate < ONE);
        TEST_ASSERT_EQUAL_INT32(twin.rate, axis.rate);
        rdpi_q31_step(&twin, k * k % 5 * U / 16);
        rdpi_q31_step(&axis, k * k % 5 * U / 16);
    }
}

void test_as_many_missed_samples_as_allowed_keep_the_rate(void)
{
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_missed(&axis, RDPI_MAX_MISSED);
    rdpi_q31_step(&axis, (RDPI_MAX_MISSED + 1) * (U / 8));
    TEST_ASSERT_EQUAL_INT32(ONE / 2, axis.rate);
}

void test_after_more_missed_samples_the_rate_starts_afresh_from_zero(void)
{
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_missed(&axis, RDPI_MAX_MISSED + 1);
    rdpi_q31_step(&axis, U);
    TEST_ASSERT_EQUAL_INT32(0, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    rdpi_q31_step(&axis, U / 8 * 9);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, axis.rate);
}

/* The sum of ticks must not come round to a small number. */
void test_however_many_ticks_are_missed_the_rate_starts_afresh(void)
{
    const uint32_t ticks[][2] = {{UINT16_MAX, 1}, {UINT16_MAX, 2}, {UINT32_MAX, 1}, {UINT32_MAX, UINT32_MAX},
                                 {65536, 0}, {1, 65535}};
    for (size_t k = 0; k < sizeof ticks / sizeof ticks[0]; k++) {
        start();
        rdpi_q31_step(&axis, 0);
        rdpi_q31_missed(&axis, ticks[k][0]);
        rdpi_q31_missed(&axis, ticks[k][1]);
        rdpi_q31_step(&axis, U);
        TEST_ASSERT_EQUAL_INT32(0, axis.rate);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    }
}

void test_missed_count_stays_at_its_largest_value(void)
{
    start();
    rdpi_q31_missed(&axis, UINT32_MAX - 1);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX - 1, axis.missed_count);
    rdpi_q31_missed(&axis, 1);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.missed_count);
    rdpi_q31_missed(&axis, 5);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.missed_count);
}

void test_a_sample_without_reference_counts_as_missed(void)
{
    start();
    rdpi_q31_step(&axis, U / 4);
    rdpi_q31_step(&axis, NONE);
    rdpi_q31_missed(&axis, 1);
    rdpi_q31_step(&axis, NONE);
    rdpi_q31_step(&axis, U / 4 * 3);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.missed_count);
    TEST_ASSERT_EQUAL_UINT32(2, axis.input_count);
}

void test_however_many_samples_lack_a_reference_the_rate_starts_afresh(void)
{
    start();
    rdpi_q31_step(&axis, 0);
    for (unsigned k = 0; k < UINT16_MAX + 2u; k++) {
        rdpi_q31_step(&axis, NONE);
    }
    rdpi_q31_step(&axis, U);
    TEST_ASSERT_EQUAL_INT32(0, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
}

void test_missed_samples_do_not_widen_the_slew_limit(void)
{
    given.params.slew_per_us = PER_SAMPLE(U);
    start();
    rdpi_q31_missed(&axis, 10);
    TEST_ASSERT_EQUAL_INT32(U, rdpi_q31_step(&axis, 3 * U));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_SLEW | RDPI_FLAG_MISSED, axis.flags);
}

void test_missed_samples_move_neither_drive_nor_plays(void)
{
    rdpi_q31_t before;
    start();
    rdpi_q31_step(&axis, 2 * U);
    memcpy(&before, &axis, sizeof axis);
    rdpi_q31_missed(&axis, 7);
    before.missed = 7;
    before.missed_count = 7;
    before.rate_estimator.direct = false; /* the next rate counts them */
    TEST_ASSERT_EQUAL_MEMORY(&before, &axis, sizeof axis);
}

void test_missed_samples_do_not_survive_a_reset(void)
{
    start();
    rdpi_q31_missed(&axis, 7);
    rdpi_q31_reset(&axis);
    rdpi_q31_step(&axis, 2 * U);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* ---- the start-up sweep ---- */

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

static void run_sweep(void)
{
    for (int k = 0; k < 100000; k++) {
        if (!rdpi_q31_sweep(&axis)) {
            return;
        }
    }
    TEST_FAIL_MESSAGE("the sweep does not end");
}

static const int32_t four_cycles_to_4[] = {28 * U, -32 * U, 22 * U, -23 * U, 16 * U, -14 * U, 10 * U, -5 * U, 4 * U};

void test_sweep_closes_in_on_its_end_in_cycles_of_equal_decrements(void)
{
    start();
    plant_at_rest();
    sweeps_through(four_cycles_to_4, 9, U / 8);
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

void test_sweep_of_one_cycle_goes_up_down_and_to_its_end(void)
{
    const int32_t turns[] = {28 * U, -32 * U, U / 2};
    given.params.sweep_cycles = 1;
    given.params.sweep_end = U / 2;
    start();
    plant_at_rest();
    sweeps_through(turns, 3, U / 8);
}

void test_sweep_stops_at_turning_points_that_its_steps_do_not_meet(void)
{
    given.params.sweep_per_us = PER_SAMPLE(314159);
    start();
    plant_at_rest();
    sweeps_through(four_cycles_to_4, 9, 314159);
}

void test_sweep_to_the_end_of_the_range_returns_there_after_every_cycle(void)
{
    const int32_t turns[] = {28 * U, -32 * U, 28 * U, -17 * U, 28 * U, -2 * U, 28 * U, 13 * U, 28 * U};
    given.params.sweep_end = 28 * U;
    start();
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

void test_sweep_after_the_last_is_another_whole_one(void)
{
    start();
    plant_at_rest();
    sweeps_through(four_cycles_to_4, 9, U / 8);
    sweeps_through(four_cycles_to_4, 9, U / 8);
}

void test_sweep_begins_from_the_present_drive_without_a_jump(void)
{
    start();
    rdpi_q31_step(&axis, 4 * U);
    int32_t drive = axis.drive;
    rdpi_q31_sweep(&axis);
    TEST_ASSERT_EQUAL_INT32(drive + U / 8, axis.drive);
    rdpi_q31_forward(&axis, -7 * U, 0);
    rdpi_q31_sweep(&axis);
    TEST_ASSERT_EQUAL_INT32(-7 * U + U / 8, axis.drive);
    rdpi_q31_forward(&axis, 40 * U, 0); /* outside: from the end of the range */
    rdpi_q31_sweep(&axis);
    TEST_ASSERT_EQUAL_INT32(28 * U, axis.drive);
}

void test_sweep_wipes_out_what_the_plays_remember(void)
{
    const int32_t histories[][3] = {{0, 0, 0}, {28 * U, 27 * U, 25 * U}, {-32 * U, -31 * U, -29 * U},
                                    {5 * U, 6 * U, 4 * U}, {-U, 0, 2 * U}};
    int32_t first[PLAYS], after[PLAYS];
    start();
    for (size_t k = 0; k < 5; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, histories[k]));
        run_sweep();
        rdpi_q31_get_memory(&axis, k == 0 ? first : after);
        if (k > 0) {
            TEST_ASSERT_EQUAL_MEMORY(first, after, sizeof after);
        }
    }
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

void test_sweep_ignores_the_slew_limit_it_cannot_exceed(void)
{
    given.params.slew_per_us = given.params.sweep_per_us;
    start();
    plant_at_rest();
    sweeps_through(four_cycles_to_4, 9, U / 8);
    TEST_ASSERT_EQUAL_UINT32(0, axis.clip_count);
}

static void half_a_sweep(void)
{
    start();
    for (int k = 0; k < 1000; k++) {
        TEST_ASSERT_TRUE(rdpi_q31_sweep(&axis));
    }
}

void test_reset_makes_the_next_sweep_begin_anew(void)
{
    half_a_sweep();
    rdpi_q31_reset(&axis);
    plant_at_rest();
    sweeps_through(four_cycles_to_4, 9, U / 8);
}

void test_memory_set_makes_the_next_sweep_begin_anew(void)
{
    half_a_sweep();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, given.memory));
    plant_at_rest();
    sweeps_through(four_cycles_to_4, 9, U / 8);
}

void test_forward_makes_the_next_sweep_begin_anew(void)
{
    half_a_sweep();
    rdpi_q31_forward(&axis, MAX, 0); /* everything engaged, as the plant below */
    rdpi_q31_forward(&axis, 0, 0);
    plant(MAX, 0);
    plant(0, 0);
    sweeps_through(four_cycles_to_4, 9, U / 8);
}

void test_sweep_given_up_half_way_leaves_states_that_steps_go_on_from(void)
{
    start();
    plant_at_rest();
    for (int k = 0; k < 777; k++) {
        rdpi_q31_sweep(&axis);
        plant(axis.drive, 0);
    }
    for (int k = 0; k < 100; k++) {
        follows((int32_t)(3 * U * sin(0.05 * k)));
    }
}

void test_sweep_forgets_rate_history_and_missed_samples(void)
{
    given.params.rate_window_ns = 3 * T_NS;
    given.params.rate_filter_ns = 4 * T_NS;
    start();
    rdpi_q31_step(&axis, 0);
    rdpi_q31_step(&axis, U / 8);
    rdpi_q31_missed(&axis, 2);
    rdpi_q31_sweep(&axis);
    TEST_ASSERT_EQUAL_INT32(0, axis.rate);
    rdpi_q31_step(&axis, U);
    TEST_ASSERT_EQUAL_INT32(0, axis.rate);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

void test_sweep_clears_the_flags_of_the_step_before(void)
{
    start();
    rdpi_q31_step(&axis, FAR);
    rdpi_q31_sweep(&axis);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
}

/* ---- several instances ---- */

/* One call of every kind, by turns; how it goes depends on `kind`. */
static void call(rdpi_q31_t *self, int32_t k, int32_t kind)
{
    switch ((k * k + kind) % 11) {
    case 0:
        rdpi_q31_missed(self, (uint32_t)k % 3u);
        break;
    case 1:
        rdpi_q31_sweep(self);
        break;
    case 4:
        rdpi_q31_forward(self, k % 9 * U, k);
        break;
    case 5:
        rdpi_q31_predict(self, k * U, 0);
        break;
    case 9:
        rdpi_q31_set_memory(self, given.memory);
        break;
    default:
        rdpi_q31_step(self, (k + kind) % 13 * U / 8);
        break;
    }
}

void test_instances_in_turns_do_what_each_does_alone(void)
{
    enum { INSTANCES = 3, CALLS = 200 };
    static rdpi_q31_t alone[INSTANCES], together[INSTANCES];
    given.params.slew_per_us = PER_SAMPLE(3 * U);
    given.params.rate_window_ns = 3 * T_NS;
    start();
    for (int32_t i = 0; i < INSTANCES; i++) {
        memcpy(&alone[i], &axis, sizeof axis);
        memcpy(&together[i], &axis, sizeof axis);
        for (int32_t k = 0; k < CALLS; k++) {
            call(&alone[i], k, i);
        }
    }
    for (int32_t k = 0; k < CALLS; k++) {
        for (int32_t i = 0; i < INSTANCES; i++) {
            call(&together[i], k, i);
        }
    }
    TEST_ASSERT_EQUAL_MEMORY(alone, together, sizeof alone);
    TEST_ASSERT_TRUE(memcmp(&alone[0], &alone[1], sizeof alone[0]) != 0);
}
