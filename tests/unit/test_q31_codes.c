/* rdpi_q31: codes of the DAC. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#include "axis_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

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

/* ---- DAC ---- */

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
