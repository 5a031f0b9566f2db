/* rdpi_f32: what each number of the parameters may be, and the digest over all of them. */
#include "unity.h"

#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#include "axis_f32.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What both siblings do. */
void test_digest_for_another_layout_is_0(void);
void test_digest_does_not_depend_on_addresses_schema_and_digest(void);
#include "axis_digest.inc"

/* Every number but the memory, the last of each array standing for all of it. */
#define NUMBERS 39
#define CODE_NUMBERS 4 /* the last of them: what makes codes */

static rdpi_real_t *number(size_t k)
{
    rdpi_real_t *const numbers[NUMBERS] = {
        &given.curve[0].to_V, &given.curve[0].to_um, &given.curve[0].middle_um, &given.curve[0].reach_um,
        &given.curve[0].gain_um_per_V, &given.curve[0].V_per_um, &given.curve[0].offset_V,
        &given.curve[0].from_code, &given.curve[0].to_code, &given.params.offset_um,
        &given.params.rate_window_s, &given.params.rate_filter_s, &given.params.max_um_per_s,
        &given.params.min_slope_ratio, &given.params.min_V, &given.params.max_V, &given.params.slew_V_per_s,
        &given.params.sweep_V_per_s, &given.params.sweep_end_V, &given.params.sweep_forgotten,
        &given.params.min_sample_time_s, &given.params.max_sample_time_s,
        &given.play[PLAYS - 1].r_um, &given.play[PLAYS - 1].slope, &given.play[PLAYS - 1].slope_rate_s_per_um,
        &given.play[PLAYS - 1].intercept_um, &given.play[PLAYS - 1].intercept_rate_s,
        &given.saturation[DEADZONES - 1].d_um, &given.saturation[DEADZONES - 1].weight,
        &given.inverse_saturation[DEADZONES - 1].from_um, &given.inverse_saturation[DEADZONES - 1].to_um,
        &given.inverse_saturation[DEADZONES - 1].slope, &given.inverse_saturation[DEADZONES - 1].intercept_um,
        &given.params.last_code, &given.params.V_per_code,
        &given.curve[0].codes_per_um,
        &given.curve[0].code_of_x_0, &given.curve[0].um_per_code, &given.curve[0].x_of_code_0_um};
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
    each_bit_counts(given.curve, sizeof given.curve[0]);
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

#define REALS(crc, numbers) checksum_numbers(crc, numbers, sizeof numbers / sizeof *numbers, sizeof *numbers)

void test_digest_is_the_checksum_of_everything_in_the_order_of_the_struct(void)
{
    const rdpi_f32_params_t *from = &given.params;
    const uint8_t small[] = {from->deadzones, from->dac_bits, from->curve_pieces, from->noise_shaping};
    const rdpi_real_t numbers[] = {
        from->offset_um, from->rate_window_s, from->rate_filter_s, from->max_um_per_s, from->min_slope_ratio,
        from->min_V, from->max_V, from->slew_V_per_s, from->sweep_V_per_s, from->sweep_end_V, from->sweep_forgotten,
        from->min_sample_time_s, from->max_sample_time_s,
        from->last_code, from->V_per_code};
    uint32_t crc = checksum_number(0, from->plays, 2);
    crc = checksum_numbers(crc, small, sizeof small, 1);
    crc = checksum_number(crc, from->sweep_cycles, 2);
    crc = REALS(crc, numbers);
    for (size_t i = 0; i < PLAYS; i++) {
        const rdpi_real_t play[] = {given.play[i].r_um, given.play[i].slope, given.play[i].slope_rate_s_per_um,
                                    given.play[i].intercept_um, given.play[i].intercept_rate_s};
        crc = REALS(crc, play);
    }
    for (size_t j = 0; j < DEADZONES; j++) {
        const rdpi_real_t term[] = {given.saturation[j].d_um, given.saturation[j].weight};
        crc = REALS(crc, term);
    }
    for (size_t j = 0; j < DEADZONES; j++) {
        const rdpi_real_t piece[] = {given.inverse_saturation[j].from_um, given.inverse_saturation[j].to_um,
                                     given.inverse_saturation[j].slope, given.inverse_saturation[j].intercept_um};
        crc = REALS(crc, piece);
    }
    for (size_t k = 0; k < given.params.curve_pieces; k++) {
        const rdpi_f32_line_t *line = &given.curve[k];
        const rdpi_real_t numbers_of[] = {line->to_V, line->to_um, line->middle_um, line->reach_um, line->gain_um_per_V,
                                      line->V_per_um, line->offset_V, line->from_code, line->to_code,
                                      line->codes_per_um, line->code_of_x_0, line->um_per_code, line->x_of_code_0_um};
        crc = REALS(crc, numbers_of);
    }
    crc = checksum_numbers(crc, given.memory_um, PLAYS, sizeof(rdpi_real_t));
    TEST_ASSERT_EQUAL_HEX32(crc, rdpi_f32_digest(from));
}

void test_init_refuses_memory_that_is_not_finite(void)
{
    const rdpi_real_t bad[] = {NAN, INFINITY, -INFINITY};
    for (size_t i = 0; i < PLAYS; i++) {
        for (size_t k = 0; k < 3; k++) {
            given.memory_um[i] = bad[k];
            refused(RDPI_ERR_NOT_FINITE);
        }
        given.memory_um[i] = 0;
    }
    start();
}
