#include "unity.h"

#include <math.h>
#include <string.h>

#include "actuator.h"
#include "crc.h"
#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#define PLAYS 3
#define DEADZONES 2
#define T_S ((rdpi_real_t)1 / 1024)
#define EQUAL_REAL(expected, actual) TEST_ASSERT_FLOAT_WITHIN(2e-5f, (float)(expected), (float)(actual))
#define SAME_REAL(expected, actual) TEST_ASSERT_EQUAL_MEMORY(&(expected), &(actual), sizeof(rdpi_real_t))

/* As f32_math.h has it, whose tgmath.h newlib's double functions do not bear. */
#if !defined(RDPI_QUICK_STEP) && defined(__OPTIMIZE_SIZE__)
#define RDPI_QUICK_STEP 0
#elif !defined(RDPI_QUICK_STEP)
#define RDPI_QUICK_STEP 1
#endif

/* Whether the next step may take the quick way, in a build that has one. */
#define ASSERT_QUICK(expected) TEST_ASSERT_EQUAL(RDPI_QUICK_STEP && (expected), axis.quick)

/* At rest v = 0.5 at x = 1, 2.5 at 3, then 1.5 per um; at the guard, 256 um/s, W_0 and W_1 have lost 0.25.
 * z = v up to 2, half as steep beyond. */
static actuator_t given;
static rdpi_f32_t axis;

static void set3(rdpi_real_t *values, rdpi_real_t a, rdpi_real_t b, rdpi_real_t c)
{
    values[0] = a;
    values[1] = b;
    values[2] = c;
}

void setUp(void)
{
    memset(&axis, 0, sizeof axis);
    given = (actuator_t){
        .play = {{.r_um = 0, .slope = (rdpi_real_t)0.5, .slope_rate_s_per_um = (rdpi_real_t)-1 / 1024},
                 {.r_um = 1, .slope = 1, .slope_rate_s_per_um = (rdpi_real_t)-1 / 1024},
                 {.r_um = 3, .slope = (rdpi_real_t)1.5}},
        .saturation = {{0, 1}, {2, (rdpi_real_t)-0.5}},
        .params = {
            .plays = PLAYS,
            .deadzones = DEADZONES,
            .gain_um_per_V = 2,
            .offset_V = 1,
            .offset_um = (rdpi_real_t)0.25,
            .max_um_per_s = 256,
            .min_slope_ratio = (rdpi_real_t)0.5, /* W_0 just keeps it */
            .min_V = -16,
            .max_V = 15,
            .sweep_V_per_s = 64, /* 1 / 16 V a sample */
            .sweep_cycles = 4,
        },
    };
    actuator_derive(&given);
}

void tearDown(void)
{
}

/* Whatever a test has changed: what follows from it, then init. */
static rdpi_status_t init(void)
{
    actuator_derive(&given);
    return rdpi_f32_init(&axis, &given.params, T_S);
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
    TEST_ASSERT_EQUAL_INT(status, rdpi_f32_init(&axis, &given.params, T_S));
}

static void without_rate_law(void)
{
    for (size_t i = 0; i < PLAYS; i++) {
        given.play[i].slope_rate_s_per_um = 0;
    }
}

static void equal_memory(rdpi_real_t y0, rdpi_real_t y1, rdpi_real_t y2)
{
    rdpi_real_t y_um[PLAYS];
    rdpi_f32_get_memory(&axis, y_um);
    EQUAL_REAL(y0, y_um[0]);
    EQUAL_REAL(y1, y_um[1]);
    EQUAL_REAL(y2, y_um[2]);
}

/* The actuator of these parameters, literally by eq. 1, 7, 8, 9 and 16, in double: nothing of it is the library's. */
static double plant_y[PLAYS];

static double plant(double drive_V, double rate_um_per_s)
{
    double x = (double)given.params.gain_um_per_V * (drive_V - (double)given.params.offset_V), v = 0, below = 0;
    for (size_t i = 0; i < PLAYS; i++) {
        const rdpi_f32_play_t *play = &given.play[i];
        double r = (double)play->r_um, slope = (double)play->slope + (double)play->slope_rate_s_per_um * rate_um_per_s;
        plant_y[i] = fmax(x - r, fmin(x + r, plant_y[i]));
        v += (slope - below) * plant_y[i];
        below = slope;
    }
    double z = (double)given.saturation[0].weight * v;
    z += (double)given.saturation[1].weight * fmax(v - (double)given.saturation[1].d_um, 0);
    return z + (double)given.params.offset_um;
}

static void plant_at_rest(void)
{
    plant_y[0] = plant_y[1] = plant_y[2] = 0;
}

/* The library's plays stand where the drive has put the actuator's. */
static void equal_plant_memory(void)
{
    equal_memory((rdpi_real_t)plant_y[0], (rdpi_real_t)plant_y[1], (rdpi_real_t)plant_y[2]);
}

/* ---- init: what it refuses ---- */

/* Compiled with other settings than the library: nothing of the caller's is looked at. tests/consumer/settings.sh links
 * such callers. */
void test_init_refuses_a_caller_of_another_layout_before_all_else(void)
{
    const uint64_t others[] = {RDPI_F32_LAYOUT + 1u, RDPI_F32_LAYOUT ^ (uint64_t)1 << 63, 0};
    for (size_t k = 0; k < sizeof others / sizeof others[0]; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_SIZE, rdpi_f32_init_layout(others[k], NULL, NULL, T_S));
    }
}

void test_digest_for_another_layout_is_0(void)
{
    TEST_ASSERT_EQUAL_HEX32(0, rdpi_f32_digest_layout(RDPI_F32_LAYOUT + 1u, NULL));
}

void test_init_refuses_no_instance(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_init(NULL, &given.params, T_S));
}

void test_init_refuses_no_parameters(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_init(&axis, NULL, T_S));
}

void test_init_refuses_no_array_of_plays(void)
{
    given.params.play = NULL;
    refused_as_they_are(RDPI_ERR_NULL);
}

void test_init_refuses_no_saturation(void)
{
    given.params.saturation = NULL;
    refused_as_they_are(RDPI_ERR_NULL);
}

void test_init_refuses_no_inverse_of_the_saturation(void)
{
    given.params.inverse_saturation = NULL;
    refused_as_they_are(RDPI_ERR_NULL);
}

void test_init_refuses_no_memory(void)
{
    given.params.memory_um = NULL;
    refused_as_they_are(RDPI_ERR_NULL);
}

void test_init_refuses_another_schema(void)
{
    given.params.schema = RDPI_PARAMS_SCHEMA + 1u;
    refused_as_they_are(RDPI_ERR_SCHEMA);
    given.params.schema = RDPI_PARAMS_SCHEMA - 1u;
    refused_as_they_are(RDPI_ERR_SCHEMA);
}

void test_init_refuses_no_plays(void)
{
    given.params.plays = 0;
    refused_as_they_are(RDPI_ERR_COUNT);
}

void test_init_refuses_more_plays_than_the_maximum(void)
{
    given.params.plays = RDPI_MAX_PLAYS + 1;
    refused_as_they_are(RDPI_ERR_COUNT);
}

void test_init_refuses_no_pieces_of_saturation(void)
{
    given.params.deadzones = 0;
    refused_as_they_are(RDPI_ERR_COUNT);
}

void test_init_refuses_more_dead_zones_than_the_maximum(void)
{
    given.params.deadzones = RDPI_MAX_DEADZONES + 1;
    refused_as_they_are(RDPI_ERR_COUNT);
}

/* Every number but the memory, the last of each array standing for all of it. */
#define NUMBERS 30
#define CODE_NUMBERS 6 /* the last of them: what makes codes */

static rdpi_real_t *number(size_t k)
{
    rdpi_real_t *const numbers[NUMBERS] = {
        &given.params.gain_um_per_V, &given.params.V_per_um, &given.params.offset_V, &given.params.offset_um,
        &given.params.rate_window_s, &given.params.rate_filter_s, &given.params.max_um_per_s,
        &given.params.min_slope_ratio, &given.params.min_V, &given.params.max_V, &given.params.slew_V_per_s,
        &given.params.sweep_V_per_s, &given.params.sweep_end_V,
        &given.play[PLAYS - 1].r_um, &given.play[PLAYS - 1].slope, &given.play[PLAYS - 1].slope_rate_s_per_um,
        &given.play[PLAYS - 1].intercept_um, &given.play[PLAYS - 1].intercept_rate_s,
        &given.saturation[DEADZONES - 1].d_um, &given.saturation[DEADZONES - 1].weight,
        &given.inverse_saturation[DEADZONES - 1].from_um, &given.inverse_saturation[DEADZONES - 1].to_um,
        &given.inverse_saturation[DEADZONES - 1].slope, &given.inverse_saturation[DEADZONES - 1].intercept_um,
        &given.params.last_code,
        &given.params.codes_per_um,
        &given.params.code_of_x_0, &given.params.um_per_code, &given.params.x_of_code_0_um, &given.params.V_per_code};
    return numbers[k];
}

void test_init_refuses_each_number_that_is_not_finite(void)
{
    const rdpi_real_t bad[] = {NAN, INFINITY, -INFINITY};
    for (size_t i = 0; i < NUMBERS; i++) {
        rdpi_real_t good = *number(i);
        for (size_t k = 0; k < 3; k++) {
            *number(i) = bad[k];
            actuator_seal(&given);
            refused_as_they_are(RDPI_ERR_NOT_FINITE);
        }
        *number(i) = good;
    }
    start();
}

void test_init_refuses_each_number_that_is_too_large(void)
{
    for (size_t i = 0; i < NUMBERS; i++) {
        const rdpi_real_t good = *number(i);
        const rdpi_real_t bad = i < NUMBERS - CODE_NUMBERS ? (rdpi_real_t)1.00001e7 : (rdpi_real_t)1.00001e15;
        *number(i) = bad;
        actuator_seal(&given);
        refused_as_they_are(RDPI_ERR_NOT_FINITE);
        *number(i) = -bad;
        actuator_seal(&given);
        refused_as_they_are(RDPI_ERR_NOT_FINITE);
        *number(i) = good;
    }
}

void test_init_accepts_ten_million(void)
{
    given.params.slew_V_per_s = (rdpi_real_t)1e7;
    start();
}

void test_init_refuses_gain_zero(void)
{
    given.params.gain_um_per_V = 0;
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

void test_init_refuses_a_rate_window_of_too_many_samples(void)
{
    given.params.rate_window_s = (RDPI_MAX_WINDOW + 1) * T_S;
    refused(RDPI_ERR_WINDOW);
}

void test_init_refuses_an_empty_drive_range(void)
{
    given.params.min_V = given.params.max_V;
    refused(RDPI_ERR_DRIVE);
}

void test_init_refuses_a_drive_range_narrower_than_a_nanovolt(void)
{
    given.params.offset_V = 0;
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
    given.params.offset_V = (rdpi_real_t)15.125;
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

/* ---- init: the digest ---- */

static void each_bit_counts(void *block, size_t size)
{
    for (size_t bit = 0; bit < 8 * size; bit++) {
        unsigned char *byte = (unsigned char *)block + bit / 8, mask = (unsigned char)(1u << bit % 8);
        *byte ^= mask;
        rdpi_status_t status = rdpi_f32_init(&axis, &given.params, T_S);
        *byte ^= mask;
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_DIGEST, status);
    }
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&axis, &given.params, T_S));
}

void test_init_refuses_one_wrong_bit_in_any_number(void)
{
    for (size_t k = 0; k < NUMBERS; k++) {
        each_bit_counts(number(k), sizeof(rdpi_real_t));
    }
}

void test_init_refuses_one_wrong_bit_in_bits_cycles_or_the_digest_itself(void)
{
    each_bit_counts(&given.params.dac_bits, sizeof given.params.dac_bits);
    each_bit_counts(&given.params.sweep_cycles, sizeof given.params.sweep_cycles);
    each_bit_counts(&given.params.digest, sizeof given.params.digest);
}

void test_init_refuses_one_wrong_bit_in_any_array(void)
{
    each_bit_counts(given.play, PLAYS * sizeof given.play[0]);
    each_bit_counts(given.saturation, DEADZONES * sizeof given.saturation[0]);
    each_bit_counts(given.inverse_saturation, DEADZONES * sizeof given.inverse_saturation[0]);
    each_bit_counts(given.memory_um, PLAYS * sizeof given.memory_um[0]);
}

void test_init_refuses_counts_that_were_not_generated(void)
{
    given.params.plays = PLAYS - 1;
    refused_as_they_are(RDPI_ERR_DIGEST);
    given.params.plays = PLAYS;
    given.params.deadzones = DEADZONES - 1;
    refused_as_they_are(RDPI_ERR_DIGEST);
}

void test_digest_does_not_depend_on_addresses_schema_and_digest(void)
{
    static actuator_t elsewhere;
    const uint32_t digest = given.params.digest;
    elsewhere = given;
    actuator_seal(&elsewhere);
    TEST_ASSERT_EQUAL_HEX32(digest, elsewhere.params.digest);
    given.params.schema++;
    given.params.digest = 0;
    TEST_ASSERT_EQUAL_HEX32(digest, rdpi_f32_digest(&given.params));
}

void test_digest_is_the_checksum_of_everything_in_the_order_of_the_struct(void)
{
    const rdpi_f32_params_t *from = &given.params;
    const uint16_t counts[] = {from->plays, from->deadzones, from->dac_bits, from->sweep_cycles};
    const rdpi_real_t numbers[] = {
        from->gain_um_per_V, from->V_per_um, from->offset_V, from->offset_um, from->rate_window_s, from->rate_filter_s,
        from->max_um_per_s, from->min_slope_ratio, from->min_V, from->max_V, from->slew_V_per_s, from->sweep_V_per_s,
        from->sweep_end_V, from->last_code, from->codes_per_um, from->code_of_x_0, from->um_per_code,
        from->x_of_code_0_um, from->V_per_code};
    uint32_t crc = rdpi_crc32(0, counts, sizeof counts);
    crc = rdpi_crc32(crc, numbers, sizeof numbers);
    for (size_t i = 0; i < PLAYS; i++) {
        const rdpi_real_t play[] = {given.play[i].r_um, given.play[i].slope, given.play[i].slope_rate_s_per_um,
                                    given.play[i].intercept_um, given.play[i].intercept_rate_s};
        crc = rdpi_crc32(crc, play, sizeof play);
    }
    for (size_t j = 0; j < DEADZONES; j++) {
        const rdpi_real_t term[] = {given.saturation[j].d_um, given.saturation[j].weight};
        crc = rdpi_crc32(crc, term, sizeof term);
    }
    for (size_t j = 0; j < DEADZONES; j++) {
        const rdpi_real_t piece[] = {given.inverse_saturation[j].from_um, given.inverse_saturation[j].to_um,
                                     given.inverse_saturation[j].slope,
                                     given.inverse_saturation[j].intercept_um};
        crc = rdpi_crc32(crc, piece, sizeof piece);
    }
    crc = rdpi_crc32(crc, given.memory_um, PLAYS * sizeof(rdpi_real_t));
    TEST_ASSERT_EQUAL_HEX32(crc, rdpi_f32_digest(from));
}

void test_init_refuses_memory_that_is_not_finite(void)
{
    const rdpi_real_t bad[] = {NAN, INFINITY, -INFINITY};
    for (size_t i = 0; i < PLAYS; i++) {
        for (size_t k = 0; k < 3; k++) {
            given.memory_um[i] = bad[k];
            refused(RDPI_ERR_MEMORY);
        }
        given.memory_um[i] = 0;
    }
    start();
}

/* ---- init: what it accepts ---- */

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
    EQUAL_REAL(2, rdpi_f32_step(&axis, (rdpi_real_t)3.25)); /* z = 3 = 2 + (2 - 1), x = v = 2 */
    rdpi_f32_get_memory(&axis, y_um);
    EQUAL_REAL(2 - (RDPI_MAX_PLAYS - 1) / 16.0, y_um[RDPI_MAX_PLAYS - 1]);
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
    EQUAL_REAL(3, rdpi_f32_step(&axis, (rdpi_real_t)3.25)); /* as without */
    EQUAL_REAL(3.25, rdpi_f32_predict(&axis, 3, 0));
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
    given.params.offset_V = given.params.max_V;
    start();
    EQUAL_REAL(15, axis.drive_V);
}

void test_init_accepts_a_small_gain_and_a_low_guard_rate(void)
{
    given.params.gain_um_per_V = (rdpi_real_t)0.0625;
    given.params.max_um_per_s = (rdpi_real_t)0.0625;
    start();
}

void test_init_leaves_the_drive_that_holds_the_memory(void)
{
    set3(given.memory_um, 3, 2, (rdpi_real_t)0.5);
    start();
    EQUAL_REAL(2.5, axis.drive_V);
    equal_memory(3, 2, (rdpi_real_t)0.5);
}

void test_init_with_memory_zero_starts_at_rest(void)
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
    TEST_ASSERT_EQUAL_UINT32(0, axis.missed_count);
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
    SAME_REAL(drive_V, axis.drive_V);
}

void test_negative_gain_turns_the_drive_over(void)
{
    given.params.gain_um_per_V = -2;
    start();
    EQUAL_REAL(-1, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    equal_memory(4, 3, 1);
}

void test_one_play_and_one_piece_make_a_gain(void)
{
    given.params.plays = 1;
    given.params.deadzones = 1;
    start();
    EQUAL_REAL(4, rdpi_f32_step(&axis, (rdpi_real_t)3.25)); /* x = 3 / 0.5 */
    EQUAL_REAL(-0.5, rdpi_f32_step(&axis, (rdpi_real_t)-0.5)); /* at the guard: x = -0.75 / 0.25 */
}

void test_rate_window_and_filter_act_in_the_chain(void)
{
    given.params.rate_window_s = 2 * T_S;
    given.params.rate_filter_s = 4 * T_S;
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_step(&axis, (rdpi_real_t)0.25);
    EQUAL_REAL(128 * (1 - exp(-0.25)), axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
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
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&other, &given.params, 2 * T_S));
    for (int k = 0; k < 50; k++) {
        rdpi_real_t drive_V = rdpi_f32_step(&axis, (rdpi_real_t)(k % 7));
        rdpi_f32_step(&other, (rdpi_real_t)(k % 5 - 2));
        SAME_REAL(alone[k], drive_V);
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
    given.params.max_V = 3;
    start();
    EQUAL_REAL(3, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* Up to x = 2 (v = 1.5) instead of the x = 3 asked for; from there down to v = 1.25 at 0.5 per um. Plays that had
 * followed the wish would stand at 3, 2, 0 and answer with another drive. */
void test_after_a_range_clip_the_plays_stand_where_the_actuator_does(void)
{
    without_rate_law();
    given.params.max_V = 2;
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)2.5);
    equal_memory(2, 1, 0);
    EQUAL_REAL(1.75, rdpi_f32_step(&axis, (rdpi_real_t)1.5));
    equal_memory((rdpi_real_t)1.5, 1, 0);
}

void test_slew_limits_the_change_flags_and_counts(void)
{
    given.params.slew_V_per_s = 512; /* 0.5 V a sample */
    start();
    EQUAL_REAL(1.5, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_SLEW, axis.flags);
    EQUAL_REAL(2, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    EQUAL_REAL(1.5, rdpi_f32_step(&axis, (rdpi_real_t)-3));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_SLEW, axis.flags & RDPI_FLAG_SLEW);
    TEST_ASSERT_EQUAL_UINT32(3, axis.clip_count);
}

void test_slew_may_be_as_slow_as_the_sweep_can_be(void)
{
    given.params.slew_V_per_s = given.params.sweep_V_per_s = (rdpi_real_t)0.5;
    start();
    rdpi_real_t before_V = axis.drive_V;
    rdpi_f32_step(&axis, (rdpi_real_t)3.25);
    EQUAL_REAL(0.5 * T_S, axis.drive_V - before_V);
}

void test_slew_starts_from_the_drive_of_the_memory(void)
{
    set3(given.memory_um, 8, 8, 8);
    given.params.slew_V_per_s = 512;
    start();
    EQUAL_REAL(4.5, rdpi_f32_step(&axis, (rdpi_real_t)0.25));
}

void test_a_change_just_at_the_slew_limit_is_not_clipped(void)
{
    given.params.slew_V_per_s = 2048;
    start();
    EQUAL_REAL(3, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* x = 1, 2 where 4 was asked for; then z = 1 is met by falling 1 um at 0.5 per um from v = 1.5. */
void test_after_a_slew_clip_the_plays_stand_where_the_actuator_does(void)
{
    without_rate_law();
    given.params.slew_V_per_s = 512;
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)3.25);
    rdpi_f32_step(&axis, (rdpi_real_t)3.25);
    equal_memory(2, 1, 0);
    EQUAL_REAL(1.5, rdpi_f32_step(&axis, (rdpi_real_t)1.25));
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags & RDPI_FLAG_SLEW);
}

void test_a_drive_clipped_by_range_and_slew_has_both_flags_and_one_count(void)
{
    given.params.slew_V_per_s = 512;
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
    given.params.min_V = (rdpi_real_t)-1.5;
    given.params.max_V = (rdpi_real_t)3.25;
    given.params.slew_V_per_s = 200;
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
    given.params.dac_bits = 5;
    given.params.min_V = -8;
    given.params.max_V = (rdpi_real_t)7.5;
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
            EQUAL_REAL(given.params.max_V, highest_V);
            TEST_ASSERT_TRUE(highest_V <= given.params.max_V);
            rdpi_real_t lowest_V = rdpi_f32_step(&axis, -1000);
            TEST_ASSERT_EQUAL_HEX32(0, axis.dac_code);
            EQUAL_REAL(given.params.min_V, lowest_V);
        }
    }
}

/* 0.125 V a sample, a quarter of a code: the output goes more slowly, and does not freeze. */
void test_slew_finer_than_a_dac_code_still_arrives(void)
{
    five_bit_dac();
    given.params.slew_V_per_s = 128;
    start();
    for (int k = 0; k < 100; k++) {
        rdpi_f32_step(&axis, (rdpi_real_t)3.25);
    }
    EQUAL_REAL(3, axis.drive_V);
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
    SAME_REAL(twin.drive_V, drive_V);
    SAME_REAL(twin.drive_V, axis.drive_V);
    SAME_REAL(twin.rate_um_per_s, axis.rate_um_per_s);
    SAME_REAL(twin.ramp_V, axis.ramp_V);
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
        SAME_REAL(expected_V, drive_V);
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
    EQUAL_REAL(1.5, rdpi_f32_step(&axis, (rdpi_real_t)0.625));
    EQUAL_REAL(128, axis.rate_um_per_s);
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
    set3(given.memory_um, 3, 2, (rdpi_real_t)0.5);
    given.params.rate_window_s = 4 * T_S;
    given.params.rate_filter_s = 4 * T_S;
    given.params.dac_bits = 10;
    start();
    fresh = axis;
    rdpi_f32_step(&axis, 1);
    rdpi_f32_step(&axis, 1000);
    rdpi_f32_step(&axis, NAN);
    rdpi_f32_missed(&axis, 3);
    TEST_ASSERT_EQUAL_UINT32(1, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
    TEST_ASSERT_EQUAL_UINT32(3, axis.missed_count);

    rdpi_f32_reset(&axis);

    EQUAL_REAL(2.5, axis.drive_V);
    equal_memory(3, 2, (rdpi_real_t)0.5);
    EQUAL_REAL(0, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(fresh.dac_code, axis.dac_code);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(0, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(0, axis.input_count);
    TEST_ASSERT_EQUAL_UINT32(0, axis.missed_count);
    for (int k = 0; k < 20; k++) {
        rdpi_real_t expected_V = rdpi_f32_step(&fresh, (rdpi_real_t)(k % 6));
        rdpi_real_t drive_V = rdpi_f32_step(&axis, (rdpi_real_t)(k % 6));
        SAME_REAL(expected_V, drive_V);
        TEST_ASSERT_EQUAL_UINT32(fresh.flags, axis.flags);
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
    given.params.deadzones = 1;
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
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&other, &given.params, T_S));
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
    SAME_REAL(given.params.max_V, axis.drive_V);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, below));
    SAME_REAL(given.params.min_V, axis.drive_V);
}

/* 1e-5 of the largest threshold and of the state before. */
void test_memory_may_depart_by_as_much_as_rounding_leaves(void)
{
    const rdpi_real_t at_zero[PLAYS] = {0, (rdpi_real_t)1.000025, 1}, beyond[PLAYS] = {0, (rdpi_real_t)1.00004, 1};
    const rdpi_real_t at_20[PLAYS] = {20, (rdpi_real_t)21.0002, 20}, beyond_20[PLAYS] = {20, (rdpi_real_t)21.0003, 20};
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, at_zero));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, rdpi_f32_set_memory(&axis, beyond));
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, at_20));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, rdpi_f32_set_memory(&axis, beyond_20));
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
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_set_memory(NULL, given.memory_um));
}

void test_set_memory_refuses_states_that_are_not_finite_and_changes_nothing(void)
{
    rdpi_real_t y_um[PLAYS];
    set3(y_um, NAN, 0, 0);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, 0, 0, NAN);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, INFINITY, 0, 0);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, 0, -INFINITY, 0);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, 0, 0, INFINITY);
    memory_refused(RDPI_ERR_MEMORY, y_um);
}

void test_set_memory_refuses_states_too_far_apart_and_changes_nothing(void)
{
    rdpi_real_t y_um[PLAYS];
    set3(y_um, 3, (rdpi_real_t)1.9375, 0);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, 3, (rdpi_real_t)4.0625, 4);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, 3, 2, (rdpi_real_t)-0.0625);
    memory_refused(RDPI_ERR_MEMORY, y_um);
}

void test_set_memory_refuses_a_drive_outside_the_range_and_changes_nothing(void)
{
    rdpi_real_t y_um[PLAYS];
    set3(y_um, (rdpi_real_t)28.0625, 28, 28);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, (rdpi_real_t)-34.0625, -34, -34);
    memory_refused(RDPI_ERR_MEMORY, y_um);
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

/* But for a sample that counts as missed. Returns the prediction for what is output still. */
static void forward_changes_nothing(rdpi_real_t drive_V, rdpi_real_t rate_um_per_s)
{
    rdpi_f32_t before;
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_forward(&axis, 3, 256);
    memcpy(&before, &axis, sizeof axis);
    EQUAL_REAL(2.875, rdpi_f32_forward(&axis, drive_V, rate_um_per_s));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
    rdpi_f32_step(&axis, 3);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    rdpi_f32_step(&before, 3);
    before.flags |= RDPI_FLAG_MISSED;
    before.input_count = 1;
    TEST_ASSERT_EQUAL_MEMORY(&before, &axis, sizeof axis);
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

void test_refused_forward_outside_the_range_predicts_for_the_drive_inside(void)
{
    start();
    rdpi_f32_forward(&axis, 20, 100);
    rdpi_real_t expected_um = rdpi_f32_predict(&axis, 15, 100);
    rdpi_real_t displacement_um = rdpi_f32_forward(&axis, NAN, 0);
    SAME_REAL(expected_um, displacement_um);
}

void test_forward_drive_has_the_nearest_code(void)
{
    five_bit_dac();
    start();
    rdpi_f32_forward(&axis, (rdpi_real_t)2.625, 0);
    TEST_ASSERT_EQUAL_UINT32(21, axis.dac_code);
    EQUAL_REAL(2.625, axis.drive_V);
    rdpi_f32_forward(&axis, 100, 0);
    TEST_ASSERT_EQUAL_UINT32(31, axis.dac_code);
}

/* Enabled anywhere along someone else's drive, the step begins with that drive. */
void test_a_step_to_the_displacement_that_forward_returned_goes_on_without_a_bump(void)
{
    start();
    for (int k = 0; k < 500; k++) {
        rdpi_real_t drive_V = (rdpi_real_t)(7 * sin(0.05 * k) + 6 * sin(0.31 * k));
        rdpi_real_t reference_um = rdpi_f32_forward(&axis, drive_V, 0);
        rdpi_f32_t enabled = axis;
        EQUAL_REAL(drive_V, rdpi_f32_step(&enabled, reference_um));
        EQUAL_REAL(0, enabled.rate_um_per_s);
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
    SAME_REAL(given.params.max_V, axis.drive_V);
    equal_memory(38, 37, 35);
    SAME_REAL(given.params.max_V, *(const rdpi_real_t[]){rdpi_f32_step(&axis, reference_um)});
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags);
    equal_memory(28, 29, 31);
    rdpi_f32_forward(&axis, -20, 0);
    SAME_REAL(given.params.min_V, axis.drive_V);
    equal_memory(-42, -41, -39);
}

void test_forward_counts_no_clip(void)
{
    given.params.slew_V_per_s = 512;
    start();
    rdpi_f32_forward(&axis, 14, 0);
    rdpi_f32_forward(&axis, -14, 0);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(0, axis.clip_count);
}

void test_slew_starts_from_the_drive_of_forward(void)
{
    given.params.slew_V_per_s = 512;
    start();
    rdpi_f32_forward(&axis, 10, 0);
    EQUAL_REAL(9.5, rdpi_f32_step(&axis, 0));
    rdpi_f32_forward(&axis, 20, 0);
    EQUAL_REAL(14.5, rdpi_f32_step(&axis, 0));
}

void test_forward_forgets_rate_history_and_missed_samples(void)
{
    given.params.rate_window_s = 3 * T_S;
    given.params.rate_filter_s = 4 * T_S;
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_step(&axis, 1);
    rdpi_f32_missed(&axis, 2);
    rdpi_f32_forward(&axis, 3, 0);
    rdpi_f32_step(&axis, 2);
    EQUAL_REAL(0, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

void test_forward_counts_in_input_count_and_guard_count_up_to_their_largest_values(void)
{
    start();
    axis.guard_count = axis.input_count = UINT32_MAX - 1;
    for (int k = 0; k < 3; k++) {
        rdpi_f32_forward(&axis, 0, 1000);
        rdpi_f32_forward(&axis, NAN, 0);
    }
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.guard_count);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.input_count);
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
        EQUAL_REAL(plant((double)drive_V, fmin((double)rate, 256)), predicted_um);
        rdpi_real_t displacement_um = rdpi_f32_forward(&axis, drive_V, rate);
        SAME_REAL(displacement_um, predicted_um);
    }
}

void test_predict_uses_the_slopes_of_the_rate_given_up_to_the_guard(void)
{
    start();
    EQUAL_REAL(3.25, rdpi_f32_predict(&axis, 3, 0));
    EQUAL_REAL(2.875, rdpi_f32_predict(&axis, 3, 256));
    EQUAL_REAL(2.875, rdpi_f32_predict(&axis, 3, 1000));
    EQUAL_REAL(2.875, rdpi_f32_predict(&axis, 3, INFINITY));
}

void test_predict_does_not_limit_the_drive(void)
{
    start();
    EQUAL_REAL(28.75, rdpi_f32_predict(&axis, 20, 0)); /* x = 38: v = 55, z = 2 + 53 / 2 */
}

void test_predict_is_nan_for_an_input_that_is_nan_or_a_negative_rate(void)
{
    start();
    TEST_ASSERT_FLOAT_IS_NAN((float)rdpi_f32_predict(&axis, NAN, 0));
    TEST_ASSERT_FLOAT_IS_NAN((float)rdpi_f32_predict(&axis, 0, NAN));
    TEST_ASSERT_FLOAT_IS_NAN((float)rdpi_f32_predict(&axis, 0, -1));
}

/* ---- missed samples ---- */

void test_after_a_missed_sample_the_rate_is_that_over_the_true_time(void)
{
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)0.25);
    rdpi_f32_missed(&axis, 3);
    rdpi_f32_step(&axis, (rdpi_real_t)0.75);
    EQUAL_REAL(128, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(3, axis.missed_count);
}

void test_missed_is_flagged_once(void)
{
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_missed(&axis, 1);
    rdpi_f32_step(&axis, 0);
    rdpi_f32_step(&axis, (rdpi_real_t)0.125);
    EQUAL_REAL(128, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.missed_count);
}

void test_no_ticks_missed_change_nothing(void)
{
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_missed(&axis, 0);
    rdpi_f32_step(&axis, (rdpi_real_t)0.125);
    EQUAL_REAL(128, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* With window and filter: as if the references on the straight line had been seen. */
void test_missed_references_are_taken_to_lie_on_a_straight_line(void)
{
    rdpi_f32_t twin;
    given.params.rate_window_s = 5 * T_S;
    given.params.rate_filter_s = 4 * T_S;
    start();
    for (int k = 0; k < 8; k++) {
        rdpi_f32_step(&axis, (rdpi_real_t)(k % 3) / 8);
    }
    twin = axis;
    for (int k = 1; k <= 4; k++) {
        rdpi_f32_step(&twin, (rdpi_real_t)0.125 + (rdpi_real_t)k / 16);
    }
    rdpi_f32_missed(&axis, 2);
    rdpi_f32_missed(&axis, 1);
    rdpi_f32_step(&axis, (rdpi_real_t)0.375);
    for (int k = 0; k < 10; k++) {
        TEST_ASSERT_TRUE(axis.rate_um_per_s > 1 && axis.rate_um_per_s < 256);
        TEST_ASSERT_FLOAT_WITHIN(1e-3f, (float)twin.rate_um_per_s, (float)axis.rate_um_per_s);
        rdpi_f32_step(&twin, (rdpi_real_t)(k * k % 5) / 16);
        rdpi_f32_step(&axis, (rdpi_real_t)(k * k % 5) / 16);
    }
}

void test_as_many_missed_samples_as_allowed_keep_the_rate(void)
{
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_missed(&axis, RDPI_MAX_MISSED);
    rdpi_f32_step(&axis, (RDPI_MAX_MISSED + 1) * (rdpi_real_t)0.125);
    EQUAL_REAL(128, axis.rate_um_per_s);
}

void test_after_more_missed_samples_the_rate_starts_afresh_from_zero(void)
{
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_missed(&axis, RDPI_MAX_MISSED + 1);
    rdpi_f32_step(&axis, 1);
    EQUAL_REAL(0, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    rdpi_f32_step(&axis, (rdpi_real_t)1.125);
    EQUAL_REAL(128, axis.rate_um_per_s);
}

/* The sum of ticks must not come round to a small number. */
void test_however_many_ticks_are_missed_the_rate_starts_afresh(void)
{
    const uint32_t ticks[][2] = {{UINT16_MAX, 1}, {UINT16_MAX, 2}, {UINT32_MAX, 1}, {UINT32_MAX, UINT32_MAX},
                                 {65536, 0}, {1, 65535}};
    for (size_t k = 0; k < sizeof ticks / sizeof ticks[0]; k++) {
        start();
        rdpi_f32_step(&axis, 0);
        rdpi_f32_missed(&axis, ticks[k][0]);
        rdpi_f32_missed(&axis, ticks[k][1]);
        rdpi_f32_step(&axis, 1);
        EQUAL_REAL(0, axis.rate_um_per_s);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    }
}

void test_missed_count_stays_at_its_largest_value(void)
{
    start();
    rdpi_f32_missed(&axis, UINT32_MAX - 1);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX - 1, axis.missed_count);
    rdpi_f32_missed(&axis, 1);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.missed_count);
    rdpi_f32_missed(&axis, 5);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, axis.missed_count);
}

void test_a_refused_reference_counts_as_a_missed_sample(void)
{
    start();
    rdpi_f32_step(&axis, (rdpi_real_t)0.25);
    rdpi_f32_step(&axis, NAN);
    rdpi_f32_missed(&axis, 1);
    rdpi_f32_step(&axis, INFINITY);
    rdpi_f32_step(&axis, (rdpi_real_t)0.75);
    EQUAL_REAL(128, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.missed_count);
    TEST_ASSERT_EQUAL_UINT32(2, axis.input_count);
}

void test_however_many_references_are_refused_the_rate_starts_afresh(void)
{
    start();
    rdpi_f32_step(&axis, 0);
    for (unsigned k = 0; k < UINT16_MAX + 2u; k++) {
        rdpi_f32_step(&axis, NAN);
    }
    rdpi_f32_step(&axis, 1);
    EQUAL_REAL(0, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
}

void test_missed_samples_do_not_widen_the_slew_limit(void)
{
    given.params.slew_V_per_s = 512;
    start();
    rdpi_f32_missed(&axis, 10);
    EQUAL_REAL(1.5, rdpi_f32_step(&axis, (rdpi_real_t)3.25));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_SLEW | RDPI_FLAG_MISSED, axis.flags);
}

void test_missed_samples_move_neither_drive_nor_plays(void)
{
    rdpi_f32_t before;
    start();
    rdpi_f32_step(&axis, 2);
    memcpy(&before, &axis, sizeof axis);
    rdpi_f32_missed(&axis, 7);
    SAME_REAL(before.drive_V, axis.drive_V);
    TEST_ASSERT_EQUAL_MEMORY(&before.bank, &axis.bank, sizeof axis.bank);
    TEST_ASSERT_EQUAL_UINT32(before.flags, axis.flags);
}

void test_missed_samples_do_not_survive_a_reset(void)
{
    start();
    rdpi_f32_missed(&axis, 7);
    rdpi_f32_reset(&axis);
    rdpi_f32_step(&axis, 2);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

/* ---- the quick way ---- */

/* Steps through references of all kinds, beside a twin that is made to take the long way: the same, bit for bit. */
static void equals_the_long_way(size_t plays)
{
    given.params.plays = (uint16_t)plays;
    start();
    rdpi_f32_t twin = axis;
    uint32_t seed = 5;
    double reference_um = 0;
    unsigned quick_ways = 0;
    for (int k = 0; k < 20000; k++) {
        seed = seed * 1664525u + 1013904223u;
        double change = (double)(seed >> 8) / (1 << 23) - 1;
        switch (k / 50 % 4) {
        case 0: /* jumps, also beyond the range */
            reference_um = k % 7 == 0 ? 24 * change : reference_um;
            break;
        case 1:
            reference_um += change;
            break;
        case 2:
            reference_um += change / 64;
            break;
        default:
            reference_um = 4 * sin(0.02 * k);
            break;
        }
        bool quick = axis.quick;
        twin.quick = false;
        rdpi_real_t drive_V = rdpi_f32_step(&twin, (rdpi_real_t)reference_um);
        rdpi_real_t quick_V = rdpi_f32_step(&axis, (rdpi_real_t)reference_um);
        SAME_REAL(drive_V, quick_V);
        SAME_REAL(quick_V, axis.drive_V);
        SAME_REAL(twin.rate_um_per_s, axis.rate_um_per_s);
        TEST_ASSERT_EQUAL_UINT32(twin.dac_code, axis.dac_code);
        TEST_ASSERT_EQUAL_UINT32(twin.flags, axis.flags);
        rdpi_real_t y_um[RDPI_MAX_PLAYS], twin_y_um[RDPI_MAX_PLAYS];
        rdpi_f32_get_memory(&axis, y_um);
        rdpi_f32_get_memory(&twin, twin_y_um);
        for (size_t i = 0; i < plays; i++) {
            SAME_REAL(twin_y_um[i], y_um[i]);
        }
        quick_ways += quick;
    }
    TEST_ASSERT_TRUE(RDPI_QUICK_STEP ? quick_ways > 15000 : quick_ways == 0);
    TEST_ASSERT_EQUAL_UINT32(twin.clip_count, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(twin.guard_count, axis.guard_count);
    TEST_ASSERT_TRUE(axis.clip_count > 100 && axis.guard_count > 100);
}

void test_quick_and_long_way_lead_to_the_same_drive(void)
{
    for (size_t plays = 1; plays <= PLAYS; plays++) {
        given.params.dac_bits = 20; /* codes of 3e-5 V, which single precision just resolves */
        equals_the_long_way(plays);
    }
}

void test_quick_and_long_way_lead_to_the_same_code(void)
{
    five_bit_dac();
    equals_the_long_way(PLAYS);
    given.params.gain_um_per_V = (rdpi_real_t)-1.5; /* corners between codes: rounding alone can reach one */
    equals_the_long_way(PLAYS);
}

void test_quick_and_long_way_are_the_same_where_half_a_code_leads_past_a_corner(void)
{
    given.play[0].slope = 2; /* steeper than beyond r_1: W_0 alone would hold back what gets to the next code */
    given.params.min_V = -15;
    for (unsigned bits = 3; bits <= 5; bits++) { /* 8.6 um, 4 r_1 and 1.9 um a code */
        given.params.dac_bits = (uint16_t)bits;
        equals_the_long_way(PLAYS);
    }
}

void test_back_from_beyond_the_range_half_a_code_the_other_way_is_clipped(void)
{
    without_rate_law();
    five_bit_dac();
    for (int side = -1; side <= 1; side += 2) {
        start();
        rdpi_real_t end_V = side > 0 ? given.params.max_V : given.params.min_V;
        rdpi_f32_forward(&axis, end_V + (rdpi_real_t)side * 20, 0); /* and back: all plays are engaged */
        rdpi_real_t end_um = rdpi_f32_predict(&axis, end_V, 0);
        for (int k = 0; k < 4; k++) {
            rdpi_real_t drive_V = rdpi_f32_step(&axis, end_um + (rdpi_real_t)(side * (k % 2 == 0 ? -1 : 1)) / 32);
            EQUAL_REAL(end_V, drive_V);
            TEST_ASSERT_EQUAL_UINT32(k % 2 == 0 ? 0 : RDPI_FLAG_RANGE, axis.flags);
        }
    }
}

void test_the_quick_way_refuses_what_is_no_reference(void)
{
    const rdpi_real_t bad_um[] = {(rdpi_real_t)NAN, (rdpi_real_t)INFINITY, (rdpi_real_t)-INFINITY,
                                  (rdpi_real_t)1.001e6, (rdpi_real_t)-1.001e6};
    given.params.dac_bits = 16;
    for (size_t k = 0; k < sizeof bad_um / sizeof bad_um[0]; k++) {
        start();
        rdpi_f32_step(&axis, 1);
        rdpi_real_t drive_V = rdpi_f32_step(&axis, 2); /* above the guard: flagged */
        ASSERT_QUICK(true);
        rdpi_real_t held_V = rdpi_f32_step(&axis, bad_um[k]);
        SAME_REAL(drive_V, held_V);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, axis.flags);
        TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
        rdpi_f32_step(&axis, (rdpi_real_t)2.25);
        EQUAL_REAL(0.25 / 2 / T_S, axis.rate_um_per_s);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    }
}

void test_a_sweep_after_the_quick_way_starts_from_the_drive(void)
{
    given.params.dac_bits = 16;
    start();
    rdpi_f32_step(&axis, 0);
    for (int k = 1; k < 20; k++) {
        rdpi_f32_step(&axis, (rdpi_real_t)k / 32);
    }
    rdpi_real_t drive_V = axis.drive_V;
    rdpi_f32_sweep(&axis);
    TEST_ASSERT_FLOAT_WITHIN(1e-3f, (float)drive_V + 0.0625f, (float)axis.drive_V);
    rdpi_f32_step(&axis, (rdpi_real_t)20 / 32); /* goes on, but from nothing */
    EQUAL_REAL(0, axis.rate_um_per_s);
}

/* Such a sample ends the quick way, which is then no sign of where the drive comes from. */
void test_a_sweep_after_an_unusable_or_missed_sample_starts_from_the_drive(void)
{
    given.params.dac_bits = 16;
    for (int missed = 0; missed <= 1; missed++) {
        start();
        for (int k = 0; k < 20; k++) {
            rdpi_f32_step(&axis, (rdpi_real_t)k / 32);
        }
        rdpi_real_t drive_V = axis.drive_V;
        if (missed != 0) {
            rdpi_f32_missed(&axis, 1);
        } else {
            rdpi_f32_step(&axis, (rdpi_real_t)NAN);
        }
        rdpi_f32_sweep(&axis);
        TEST_ASSERT_FLOAT_WITHIN(1e-3f, (float)drive_V + 0.0625f, (float)axis.drive_V);
    }
}

void test_a_sweep_after_steps_that_take_the_long_way_starts_from_the_drive(void)
{
    five_bit_dac();
    given.params.rate_window_s = 2 * T_S;
    start();
    rdpi_f32_step(&axis, 1);
    rdpi_f32_step(&axis, (rdpi_real_t)1.25);
    rdpi_real_t drive_V = axis.drive_V;
    TEST_ASSERT_TRUE(axis.ramp_V != drive_V); /* the wish is no code */
    rdpi_f32_sweep(&axis); /* 1/16 V a sample */
    EQUAL_REAL(drive_V + (rdpi_real_t)0.0625, axis.ramp_V);
}

/* Half a step of codes is no change that the limit allows. */
void test_a_sweep_after_slewing_goes_on_from_the_drive_before_rounding(void)
{
    five_bit_dac();
    given.params.slew_V_per_s = 64;
    start();
    for (int k = 0; k < 2; k++) {
        rdpi_f32_step(&axis, 3); /* 1 V, and 1/16 V a sample */
    }
    EQUAL_REAL(1, axis.drive_V);
    rdpi_f32_sweep(&axis);
    EQUAL_REAL(1, axis.drive_V);
    rdpi_f32_sweep(&axis); /* 1.25 V */
    rdpi_f32_sweep(&axis);
    EQUAL_REAL(1.5, axis.drive_V);
}

void test_the_range_ends_the_quick_way_while_no_play_is_engaged(void)
{
    rdpi_real_t y_um[PLAYS];
    given.params.dac_bits = 16;
    for (int side = -1; side <= 1; side += 2) {
        start();
        rdpi_real_t end_V = side > 0 ? given.params.max_V : given.params.min_V;
        rdpi_real_t x_um = 2 * (end_V - 1) - (rdpi_real_t)side / 2; /* and r_1 = 1 */
        set3(y_um, x_um, x_um, x_um);
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, y_um));
        rdpi_real_t from_um = rdpi_f32_predict(&axis, axis.drive_V, 0);
        for (int k = 0; k < 50; k++) {
            rdpi_f32_step(&axis, from_um + (rdpi_real_t)(side * k) / 128);
            TEST_ASSERT_TRUE(side * axis.drive_V <= side * end_V);
            TEST_ASSERT_TRUE(axis.dac_code <= 65535u);
        }
        EQUAL_REAL(end_V, axis.drive_V);
        TEST_ASSERT_EQUAL_UINT32(side > 0 ? 65535u : 0u, axis.dac_code);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags & RDPI_FLAG_RANGE);
    }
}

void test_states_that_were_set_are_heeded_by_the_next_step(void)
{
    rdpi_real_t y_um[PLAYS];
    given.params.dac_bits = 16;
    start();
    rdpi_f32_step(&axis, 2);
    rdpi_f32_step(&axis, (rdpi_real_t)2.125);
    set3(y_um, (rdpi_real_t)0.25, (rdpi_real_t)1.25, (rdpi_real_t)2.25); /* the same output, but other corners */
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, y_um));
    rdpi_f32_t twin = axis;
    twin.quick = false;
    for (int k = 0; k < 20; k++) {
        rdpi_real_t reference_um = (rdpi_real_t)2.125 - (rdpi_real_t)k / 64;
        rdpi_real_t drive_V = rdpi_f32_step(&twin, reference_um);
        TEST_ASSERT_FLOAT_WITHIN(1e-3f, (float)drive_V, (float)rdpi_f32_step(&axis, reference_um));
        rdpi_f32_get_memory(&twin, y_um);
        equal_memory(y_um[0], y_um[1], y_um[2]);
    }
}

void test_windows_filters_slew_limits_and_drives_without_codes_take_the_long_way(void)
{
    start();
    rdpi_f32_step(&axis, 0);
    ASSERT_QUICK(false);
    five_bit_dac();
    start();
    rdpi_f32_step(&axis, 0);
    ASSERT_QUICK(true);
    given.params.rate_window_s = 2 * T_S;
    start();
    rdpi_f32_step(&axis, 0);
    ASSERT_QUICK(false);
    given.params.rate_window_s = 0;
    given.params.rate_filter_s = T_S;
    start();
    rdpi_f32_step(&axis, 0);
    ASSERT_QUICK(false);
    given.params.rate_filter_s = 0;
    given.params.slew_V_per_s = 512;
    start();
    rdpi_f32_step(&axis, 0);
    ASSERT_QUICK(false);
}

void test_codes_too_far_from_x_0_for_single_precision_take_the_long_way(void)
{
    given.params.dac_bits = RDPI_MAX_DAC_BITS;
    for (int k = 0; k < 2; k++) {
        given.params.offset_V = k == 0 ? (rdpi_real_t)-77.5 : (rdpi_real_t)-78.5; /* 1.98 and 2.02 ranges below it */
        set3(given.memory_um, 160, 160, 160);
        start();
        rdpi_f32_step(&axis, 100);
        ASSERT_QUICK(k == 0);
    }
}

/* ---- the start-up sweep ---- */

/* A whole sweep, its plant moving along: each sample goes `step_V` towards the next of `count` turning points and stops
 * there, and the last sample alone returns false. */
static void sweeps_through(const rdpi_real_t *turns_V, size_t count, double step_V)
{
    double drive_V = (double)axis.drive_V;
    for (size_t turn = 0; turn < count;) {
        double left_V = (double)turns_V[turn] - drive_V;
        drive_V = fabs(left_V) > step_V ? drive_V + copysign(step_V, left_V) : (double)turns_V[turn];
        turn += fabs(left_V) <= step_V;
        TEST_ASSERT_EQUAL(turn < count, rdpi_f32_sweep(&axis));
        EQUAL_REAL(drive_V, axis.drive_V);
        TEST_ASSERT_TRUE(axis.drive_V >= given.params.min_V && axis.drive_V <= given.params.max_V);
        TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
        EQUAL_REAL(0, axis.rate_um_per_s);
        plant((double)axis.drive_V, 0);
        equal_plant_memory();
    }
    SAME_REAL(turns_V[count - 1], axis.drive_V);
}

static void run_sweep(void)
{
    for (int k = 0; k < 100000; k++) {
        if (!rdpi_f32_sweep(&axis)) {
            return;
        }
    }
    TEST_FAIL_MESSAGE("the sweep does not end");
}

static const rdpi_real_t four_cycles_to_3_V[] = {15, -16, 12, (rdpi_real_t)-11.25, 9, (rdpi_real_t)-6.5, 6,
                                                 (rdpi_real_t)-1.75, 3};

void test_sweep_closes_in_on_its_end_in_cycles_of_equal_decrements(void)
{
    given.params.sweep_end_V = 3;
    start();
    plant_at_rest();
    sweeps_through(four_cycles_to_3_V, 9, 0.0625);
}

void test_sweep_of_one_cycle_goes_up_down_and_to_its_end(void)
{
    const rdpi_real_t turns_V[] = {15, -16, (rdpi_real_t)0.5};
    given.params.sweep_cycles = 1;
    given.params.sweep_end_V = (rdpi_real_t)0.5;
    start();
    plant_at_rest();
    sweeps_through(turns_V, 3, 0.0625);
}

void test_sweep_stops_at_turning_points_that_its_steps_do_not_meet(void)
{
    given.params.sweep_end_V = 3;
    given.params.sweep_V_per_s = 300;
    start();
    plant_at_rest();
    sweeps_through(four_cycles_to_3_V, 9, 300.0 / 1024);
}

void test_sweep_to_the_end_of_the_range_returns_there_after_every_cycle(void)
{
    const rdpi_real_t turns_V[] = {15, -16, 15, (rdpi_real_t)-8.25, 15, (rdpi_real_t)-0.5, 15, (rdpi_real_t)7.25, 15};
    given.params.sweep_end_V = 15;
    start();
    plant_at_rest();
    sweeps_through(turns_V, 9, 0.0625);
}

void test_sweep_after_the_last_is_another_whole_one(void)
{
    given.params.sweep_end_V = 3;
    start();
    plant_at_rest();
    sweeps_through(four_cycles_to_3_V, 9, 0.0625);
    sweeps_through(four_cycles_to_3_V, 9, 0.0625);
}

void test_sweep_begins_from_the_present_drive_without_a_jump(void)
{
    start();
    rdpi_f32_step(&axis, 4);
    rdpi_real_t drive_V = axis.drive_V;
    rdpi_f32_sweep(&axis);
    EQUAL_REAL(drive_V + (rdpi_real_t)0.0625, axis.drive_V);
    rdpi_f32_forward(&axis, -7, 0);
    rdpi_f32_sweep(&axis);
    EQUAL_REAL(-6.9375, axis.drive_V);
}

void test_sweep_wipes_out_what_the_plays_remember(void)
{
    const rdpi_real_t histories[][3] = {{0, 0, 0}, {28, 27, 25}, {-34, -33, -31}, {5, 6, 4}, {-1, 0, 2}};
    rdpi_real_t first[PLAYS], after[PLAYS];
    start();
    for (size_t k = 0; k < 5; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, histories[k]));
        run_sweep();
        rdpi_f32_get_memory(&axis, k == 0 ? first : after);
        if (k > 0) {
            TEST_ASSERT_EQUAL_MEMORY(first, after, sizeof after);
        }
    }
}

void test_sweep_outputs_dac_codes_and_the_plays_follow_them(void)
{
    five_bit_dac();
    given.params.sweep_end_V = (rdpi_real_t)0.2; /* nearest: 0 V */
    start();
    plant_at_rest();
    bool goes_on = true;
    for (int k = 0; goes_on; k++) { /* an eighth of a code a sample: it must not get stuck */
        TEST_ASSERT_LESS_THAN_INT(2000, k);
        goes_on = rdpi_f32_sweep(&axis);
        EQUAL_REAL((rdpi_real_t)axis.dac_code / 2 - 8, axis.drive_V);
        TEST_ASSERT_LESS_OR_EQUAL_UINT32(31, axis.dac_code);
        plant((double)axis.drive_V, 0);
        equal_plant_memory();
    }
    TEST_ASSERT_EQUAL_UINT32(16, axis.dac_code);
    EQUAL_REAL(0, axis.drive_V);
}

void test_sweep_reaches_both_ends_of_a_range_of_codes(void)
{
    uint32_t lowest = 31, highest = 0;
    five_bit_dac();
    start();
    while (rdpi_f32_sweep(&axis)) {
        lowest = axis.dac_code < lowest ? axis.dac_code : lowest;
        highest = axis.dac_code > highest ? axis.dac_code : highest;
    }
    TEST_ASSERT_EQUAL_UINT32(0, lowest);
    TEST_ASSERT_EQUAL_UINT32(31, highest);
}

void test_sweep_ignores_the_slew_limit_it_cannot_exceed(void)
{
    given.params.slew_V_per_s = 64;
    given.params.sweep_end_V = 3;
    start();
    plant_at_rest();
    sweeps_through(four_cycles_to_3_V, 9, 0.0625);
    TEST_ASSERT_EQUAL_UINT32(0, axis.clip_count);
}

static void half_a_sweep(void)
{
    given.params.sweep_end_V = 3;
    start();
    for (int k = 0; k < 1000; k++) {
        TEST_ASSERT_TRUE(rdpi_f32_sweep(&axis));
    }
}

void test_reset_makes_the_next_sweep_begin_anew(void)
{
    half_a_sweep();
    rdpi_f32_reset(&axis);
    plant_at_rest();
    sweeps_through(four_cycles_to_3_V, 9, 0.0625);
}

void test_memory_set_makes_the_next_sweep_begin_anew(void)
{
    half_a_sweep();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, given.memory_um));
    plant_at_rest();
    sweeps_through(four_cycles_to_3_V, 9, 0.0625);
}

void test_forward_makes_the_next_sweep_begin_anew(void)
{
    half_a_sweep();
    rdpi_f32_forward(&axis, 100, 0); /* everything engaged, as the plant below */
    rdpi_f32_forward(&axis, 0, 0);
    plant(100, 0);
    plant(0, 0);
    sweeps_through(four_cycles_to_3_V, 9, 0.0625);
}

void test_sweep_given_up_half_way_leaves_states_that_steps_go_on_from(void)
{
    given.params.sweep_end_V = 3;
    start();
    plant_at_rest();
    for (int k = 0; k < 777; k++) {
        rdpi_f32_sweep(&axis);
        plant((double)axis.drive_V, 0);
    }
    for (int k = 0; k < 100; k++) {
        double reference_um = 3 * sin(0.05 * k), drive_V = (double)rdpi_f32_step(&axis, (rdpi_real_t)reference_um);
        EQUAL_REAL(reference_um, plant(drive_V, (double)axis.rate_um_per_s));
    }
}

void test_sweep_forgets_rate_history_and_missed_samples(void)
{
    given.params.rate_window_s = 3 * T_S;
    given.params.rate_filter_s = 4 * T_S;
    start();
    rdpi_f32_step(&axis, 0);
    rdpi_f32_step(&axis, (rdpi_real_t)0.125);
    rdpi_f32_missed(&axis, 2);
    rdpi_f32_sweep(&axis);
    EQUAL_REAL(0, axis.rate_um_per_s);
    rdpi_f32_step(&axis, 1);
    EQUAL_REAL(0, axis.rate_um_per_s);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
}

void test_sweep_clears_the_flags_of_the_step_before(void)
{
    start();
    rdpi_f32_step(&axis, 1000);
    rdpi_f32_sweep(&axis);
    TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, axis.clip_count);
}

/* ---- several instances ---- */

/* One call of every kind, by turns; how it goes depends on `kind`. */
static void call(rdpi_f32_t *self, int k, int kind)
{
    switch ((k * k + kind) % 11) {
    case 0:
        rdpi_f32_missed(self, (uint32_t)k % 3);
        break;
    case 1:
        rdpi_f32_sweep(self);
        break;
    case 4:
        rdpi_f32_forward(self, (rdpi_real_t)(k % 9), (rdpi_real_t)k);
        break;
    case 5:
        rdpi_f32_predict(self, (rdpi_real_t)k, 0);
        break;
    case 9:
        rdpi_f32_set_memory(self, given.memory_um);
        break;
    default:
        rdpi_f32_step(self, (rdpi_real_t)((k + kind) % 13) / 8);
        break;
    }
}

void test_instances_in_turns_do_what_each_does_alone(void)
{
    static rdpi_f32_t alone[3], mixed[3];
    given.params.rate_window_s = 3 * T_S;
    actuator_derive(&given);
    memset(alone, 0, sizeof alone);
    memset(mixed, 0, sizeof mixed);
    for (int kind = 0; kind < 3; kind++) {
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&alone[kind], &given.params, T_S));
        for (int k = 0; k < 300; k++) {
            call(&alone[kind], k, kind);
        }
    }
    for (int kind = 0; kind < 3; kind++) {
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&mixed[kind], &given.params, T_S));
    }
    for (int k = 0; k < 300; k++) {
        for (int kind = 0; kind < 3; kind++) {
            call(&mixed[kind], k, kind);
        }
    }
    TEST_ASSERT_EQUAL_MEMORY(alone, mixed, sizeof alone);
}
