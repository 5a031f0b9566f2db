/* rdpi_q31: the input curve, between x and drive. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#include "axis_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* Drives of -32 to 28 U: x is half the drive below 0, the drive up to 8 U, and then twice as steep. */
static void bend(void)
{
    given.params.curve_pieces = 3;
    given.params.min_x = -16 * U;
    given.params.max_x = 48 * U;
    given.curve[0] = (rdpi_q31_line_t){.from_drive = -32 * U, .from_x = -16 * U};
    given.curve[1] = (rdpi_q31_line_t){.from_drive = 0, .from_x = 0};
    given.curve[2] = (rdpi_q31_line_t){.from_drive = 8 * U, .from_x = 8 * U};
    actuator_q31_derive(&given);
}

static int32_t x_of(int32_t drive)
{
    return drive < 0 ? drive / 2 : (drive < 8 * U ? drive : 2 * drive - 8 * U);
}

static int32_t x_of_axis(void)
{
    int32_t y[RDPI_MAX_PLAYS];
    rdpi_q31_get_memory(&axis, y);
    return y[0];
}

void test_predict_follows_every_piece_and_goes_on_beyond_the_ends(void)
{
    const int32_t drive[] = {-40 * U, -32 * U, -8 * U, 0, 4 * U, 8 * U, 20 * U, 28 * U, 30 * U};
    bend();
    start();
    for (size_t k = 0; k < sizeof drive / sizeof drive[0]; k++) {
        memset(plant_y, 0, sizeof plant_y);
        TRACKS(plant(x_of(drive[k]), 0), rdpi_q31_predict(&axis, drive[k], 0));
    }
}

void test_half_a_unit_is_rounded_up(void)
{
    bend();
    start();
    rdpi_q31_forward(&axis, -32 * U + 1, 0);
    TEST_ASSERT_EQUAL_INT32(-16 * U + 1, x_of_axis());
    rdpi_q31_forward(&axis, -32 * U + 2, 0);
    TEST_ASSERT_EQUAL_INT32(-16 * U + 1, x_of_axis());
}

void test_x_beyond_its_format_saturates(void)
{
    bend();
    start();
    memset(plant_y, 0, sizeof plant_y);
    TRACKS(plant(MAX, 0), rdpi_q31_predict(&axis, MAX, 0)); /* 2 MAX - 8 U otherwise */
    rdpi_q31_forward(&axis, MAX, 0);
    EQUAL(MAX, x_of_axis());
    EQUAL(28 * U, axis.drive);
    rdpi_q31_step(&axis, INT32_MAX);
    EQUAL(28 * U, axis.drive);
    EQUAL(48 * U, x_of_axis());
}

void test_the_step_gives_the_drive_that_the_curve_leads_to_the_reference(void)
{
    without_rate_law();
    bend();
    start();
    memset(plant_y, 0, sizeof plant_y);
    for (int k = 0; k < 400; k++) {
        int32_t reference = (int32_t)(8 * U * sin(0.02 * k)) + 3 * U;
        int32_t drive = rdpi_q31_step(&axis, reference);
        TRACKS(reference, plant(x_of(drive), 0));
        TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
    }
}

void test_codes_are_those_of_the_drive(void)
{
    without_rate_law();
    five_bit_dac();
    given.params.curve_pieces = 2;
    given.params.min_x = -8 * U;
    given.params.max_x = 30 * U;
    given.curve[0] = (rdpi_q31_line_t){.from_drive = -16 * U, .from_x = -8 * U};
    given.curve[1] = (rdpi_q31_line_t){.from_drive = 0, .from_x = 0};
    start();
    for (int code = 1; code < 31; code++) {
        int32_t drive = (code - 16) * U;
        for (int side = -1; side <= 1; side++) {
            rdpi_q31_reset(&axis);
            rdpi_q31_step(&axis, rdpi_q31_predict(&axis, drive + side * (U / 4), 0));
            TEST_ASSERT_EQUAL_UINT32(code, axis.dac_code);
            NEAR(drive, axis.drive);
            NEAR(drive < 0 ? drive / 2 : 2 * drive, x_of_axis());
        }
    }
}

void test_the_slew_limit_is_that_of_the_drive(void)
{
    without_rate_law();
    given.params.slew_per_us = PER_SAMPLE(4 * U);
    bend();
    start();
    const int32_t drive[] = {4 * U, 8 * U, 12 * U, 16 * U, 20 * U, 24 * U, 28 * U};
    for (size_t k = 0; k < sizeof drive / sizeof drive[0]; k++) {
        rdpi_q31_step(&axis, INT32_MAX);
        NEAR(drive[k], axis.drive);
        NEAR(x_of(drive[k]), x_of_axis());
        TEST_ASSERT_EQUAL_UINT32(k < 6 ? RDPI_FLAG_RANGE | RDPI_FLAG_SLEW : RDPI_FLAG_RANGE, axis.flags);
    }
}

void test_memory_forward_and_sweep_follow_the_curve(void)
{
    int32_t y[RDPI_MAX_PLAYS];
    bend();
    start();
    EQUAL(0, axis.drive);
    set3(y, 40 * U, 40 * U, 40 * U);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, y));
    NEAR(24 * U, axis.drive);
    set3(y, 49 * U, 49 * U, 49 * U);
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, rdpi_q31_set_memory(&axis, y));
    set3(y, -17 * U, -17 * U, -17 * U);
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, rdpi_q31_set_memory(&axis, y));
    rdpi_q31_forward(&axis, -10 * U, 0);
    NEAR(-5 * U, x_of_axis());
    while (rdpi_q31_sweep(&axis)) {
    }
    EQUAL(4 * U, axis.drive);
    NEAR(4 * U, x_of_axis());
}

/* The plays go from where they are, although the drive of a memory is rounded. */
void test_steps_after_a_memory_between_two_drives_go_on_from_it(void)
{
    int32_t y[RDPI_MAX_PLAYS];
    without_rate_law();
    bend();
    start();
    set3(y, 20 * U + 1, 20 * U, 19 * U);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, y));
    rdpi_q31_step(&axis, rdpi_q31_predict(&axis, axis.drive, 0));
    rdpi_q31_get_memory(&axis, y);
    NEAR(20 * U, y[0]);
    NEAR(20 * U, y[1]);
    NEAR(19 * U, y[2]);
}

void test_init_refuses_no_pieces_and_too_many(void)
{
    given.params.curve_pieces = 0;
    actuator_q31_seal(&given);
    refused_as_they_are(RDPI_ERR_CURVE);
    given.params.curve_pieces = RDPI_MAX_CURVE_PIECES + 1;
    refused_as_they_are(RDPI_ERR_CURVE);
}

void test_init_needs_an_array_of_pieces_only_if_there_are_several(void)
{
    start();
    given.params.curve = NULL;
    given.params.digest = rdpi_q31_digest(&given.params);
    refused_as_they_are(RDPI_OK);
    bend();
    given.params.curve = NULL;
    refused_as_they_are(RDPI_ERR_NULL);
}

void test_one_wrong_bit_in_the_pieces_is_refused(void)
{
    bend();
    unsigned char *bytes = (unsigned char *)given.curve;
    for (size_t bit = 0; bit < 8 * 3 * sizeof given.curve[0]; bit++) {
        bytes[bit / 8] ^= (unsigned char)(1u << bit % 8);
        refused_as_they_are(RDPI_ERR_DIGEST);
        bytes[bit / 8] ^= (unsigned char)(1u << bit % 8);
    }
    refused_as_they_are(RDPI_OK);
}

static void refused_with(int32_t *number, int32_t wrong)
{
    int32_t right = *number;
    *number = wrong;
    actuator_q31_seal(&given);
    refused_as_they_are(RDPI_ERR_CURVE);
    *number = right;
    actuator_q31_seal(&given);
    refused_as_they_are(RDPI_OK);
}

void test_init_refuses_another_range_of_x_where_the_curve_is_straight(void)
{
    start();
    refused_with(&given.params.min_x, -31 * U);
    refused_with(&given.params.max_x, 27 * U);
    refused_with(&given.params.max_x, -32 * U);
}

void test_init_refuses_pieces_out_of_order_or_with_a_gap(void)
{
    bend();
    refused_with(&given.params.min_x, -MAX - 1);
    refused_with(&given.params.max_x, MAX + 1);
    refused_with(&given.curve[0].from_drive, -31 * U);
    refused_with(&given.curve[0].from_x, -15 * U);
    refused_with(&given.curve[1].from_drive, -32 * U);
    refused_with(&given.curve[2].from_drive, 29 * U);
    refused_with(&given.curve[1].from_x, -16 * U);
    refused_with(&given.curve[2].from_x, 49 * U);
    for (size_t k = 0; k < 3; k++) {
        refused_with(&given.curve[k].x_per_drive, 0);
        refused_with(&given.curve[k].drive_per_x, 0);
        refused_with(&given.curve[k].x_per_drive, given.curve[k].x_per_drive / 1000 * 999);
        refused_with(&given.curve[k].x_per_drive, given.curve[k].x_per_drive / 1000 * 1001);
        refused_with(&given.curve[k].drive_per_x, given.curve[k].drive_per_x / 1000 * 999);
        refused_with(&given.curve[k].drive_per_x, given.curve[k].drive_per_x / 1000 * 1001);
        refused_with((int32_t *)&given.curve[k].x_shift, 0);
        refused_with((int32_t *)&given.curve[k].x_shift, 63);
        refused_with((int32_t *)&given.curve[k].drive_shift, 0);
        refused_with((int32_t *)&given.curve[k].drive_shift, 63);
    }
}
