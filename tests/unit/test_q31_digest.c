/* rdpi_q31: the digest over all parameters. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#include "axis_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What both siblings do. */
void test_digest_for_another_layout_is_0(void);
void test_digest_does_not_depend_on_addresses_schema_and_digest(void);
#include "axis_digest.inc"

static void one_bit_of(void *data, size_t size)
{
    unsigned char *bytes = data;
    for (size_t bit = 0; bit < 8u * size; bit++) {
        bytes[bit / 8u] ^= (unsigned char)(1u << bit % 8u);
        rdpi_status_t status = rdpi_q31_init(&axis, &given.params, T_NS);
        TEST_ASSERT_TRUE(status == RDPI_ERR_DIGEST || status == RDPI_ERR_COUNT || status == RDPI_ERR_CURVE);
        bytes[bit / 8u] ^= (unsigned char)(1u << bit % 8u);
    }
}

void test_init_refuses_one_wrong_bit_in_any_number_and_in_the_digest_itself(void)
{
    one_bit_of(&given.params.digest, sizeof given.params.digest);
    one_bit_of(&given.params.slew_per_us,
               offsetof(rdpi_q31_params_t, max_sample_time_ns) + sizeof(uint32_t) -
                   offsetof(rdpi_q31_params_t, slew_per_us));
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

void test_digest_is_the_checksum_of_everything_in_the_order_of_the_struct(void)
{
    const rdpi_q31_params_t *params = &given.params;
    uint32_t crc = 0;
#define ADD(field) crc = checksum_numbers(crc, &params->field, 1, sizeof params->field)
    ADD(slew_per_us);
    ADD(sweep_per_us);
    ADD(plays);
    ADD(deadzones);
    ADD(dac_bits);
    ADD(curve_pieces);
    ADD(noise_shaping);
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
    ADD(min_x);
    ADD(max_x);
    ADD(min_mV);
    ADD(max_mV);
    ADD(unit_mantissa);
    ADD(unit_exponent);
    ADD(drive_of_code_0);
    ADD(codes_per_drive);
    ADD(drive_per_code);
    ADD(sweep_end);
    ADD(sweep_forgotten);
    ADD(min_sample_time_ns);
    ADD(max_sample_time_ns);
#undef ADD
    crc = checksum_numbers(crc, given.play, PLAYS * sizeof given.play[0] / 4, 4);
    crc = checksum_numbers(crc, given.saturation, DEADZONES * sizeof given.saturation[0] / 4, 4);
    crc = checksum_numbers(crc, given.inverse_saturation, DEADZONES * sizeof given.inverse_saturation[0] / 4, 4);
    crc = checksum_numbers(crc, given.memory, PLAYS * sizeof given.memory[0] / 4, 4);
    TEST_ASSERT_EQUAL_HEX32(crc, rdpi_q31_digest(params));
}
