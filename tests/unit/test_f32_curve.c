/* rdpi_f32: the input curve, between x and drive. */
#include "unity.h"

#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#include "axis_f32.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* Drives of -16 to 15 V: 2 um/V up to 1 V, where x is 0; 1 um/V up to 5 V; then 4 um/V. */
static void bend(void)
{
    given.params.curve_pieces = 3;
    given.curve[0] = (rdpi_f32_line_t){.gain_um_per_V = 2, .offset_V = 1, .to_V = 1};
    given.curve[1] = (rdpi_f32_line_t){.gain_um_per_V = 1, .to_V = 5};
    given.curve[2] = (rdpi_f32_line_t){.gain_um_per_V = 4};
}

/* The same seen in a mirror: x falls where the drive rises. */
static void bend_down(void)
{
    bend();
    for (size_t k = 0; k < 3; k++) {
        given.curve[k].gain_um_per_V *= -1;
    }
}

static void start_bent(void (*how)(void))
{
    how();
    start();
}

void test_predict_follows_every_piece_and_goes_on_beyond_the_ends(void)
{
    const double drive_V[] = {-20, -16, -4, 1, 3, 5, 6, 15, 18};
    void (*const ways[])(void) = {bend, bend_down};
    for (size_t way = 0; way < 2; way++) {
        setUp();
        start_bent(ways[way]);
        for (size_t k = 0; k < sizeof drive_V / sizeof drive_V[0]; k++) {
            memset(plant_y, 0, sizeof plant_y);
            EQUAL(plant(drive_V[k], 0), rdpi_f32_predict(&axis, (rdpi_real_t)drive_V[k], 0));
        }
    }
}

void test_the_step_gives_the_drive_that_the_curve_leads_to_the_reference(void)
{
    void (*const ways[])(void) = {bend, bend_down};
    for (size_t way = 0; way < 2; way++) {
        setUp();
        without_rate_law();
        start_bent(ways[way]);
        memset(plant_y, 0, sizeof plant_y);
        for (int k = 0; k < 400; k++) {
            rdpi_real_t reference_um = (rdpi_real_t)(5 * sin(0.05 * k));
            EQUAL(reference_um, plant((double)rdpi_f32_step(&axis, reference_um), 0));
            TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
        }
    }
}

void test_a_drive_clipped_by_the_range_or_the_slew_limit_moves_the_plays_along_the_curve(void)
{
    rdpi_real_t y_um[PLAYS];
    without_rate_law();
    given.params.slew_V_per_s = 4 * 1024;
    start_bent(bend);
    rdpi_f32_step(&axis, FAR); /* from 1 V: 4 V a sample */
    EQUAL(5, axis.drive_V);
    rdpi_f32_get_memory(&axis, y_um);
    EQUAL(4, y_um[0]);
    rdpi_f32_step(&axis, FAR);
    EQUAL(9, axis.drive_V);
    rdpi_f32_get_memory(&axis, y_um);
    EQUAL(20, y_um[0]);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE | RDPI_FLAG_SLEW, axis.flags);
    rdpi_f32_step(&axis, FAR);
    rdpi_f32_step(&axis, FAR);
    EQUAL(15, axis.drive_V);
    rdpi_f32_get_memory(&axis, y_um);
    EQUAL(44, y_um[0]);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags);
}

void test_memory_forward_and_sweep_follow_the_curve(void)
{
    rdpi_real_t y_um[PLAYS];
    start_bent(bend);
    EQUAL(1, axis.drive_V); /* x = 0 */
    set3(y_um, 12, 12, 12);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, y_um));
    EQUAL(7, axis.drive_V);
    set3(y_um, -10, -10, -10);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, y_um));
    EQUAL(-4, axis.drive_V);
    rdpi_f32_forward(&axis, 3, 0);
    rdpi_f32_get_memory(&axis, y_um);
    EQUAL(2, y_um[0]);
    while (rdpi_f32_sweep(&axis)) {
    }
    EQUAL(0, axis.drive_V);
    rdpi_f32_get_memory(&axis, y_um);
    EQUAL(-2, y_um[0]);
}

void test_memory_beyond_the_last_piece_is_refused(void)
{
    bend();
    set3(given.memory_um, 44, 44, 44); /* 15 V */
    start();
    set3(given.memory_um, (rdpi_real_t)44.25, 44, 44);
    refused(RDPI_ERR_MEMORY);
}

/* The reference that a code is nearest to, from either side of the corner. */
void test_a_corner_lies_on_one_code_seen_from_either_piece(void)
{
    void (*const ways[])(void) = {bend, bend_down};
    for (size_t way = 0; way < 2; way++) {
        setUp();
        without_rate_law();
        ways[way]();
        five_bit_dac(); /* half a volt a code: 1 V is 18, 5 V is 26 */
        given.params.offset_um = 0;
        start();
        TEST_ASSERT_EQUAL_FLOAT(18, (float)given.curve[0].to_code);
        TEST_ASSERT_EQUAL_FLOAT(26, (float)given.curve[1].to_code);
        for (unsigned corner = 18; corner <= 26; corner += 8) {
            for (int k = -24; k <= 24; k++) {
                rdpi_f32_reset(&axis);
                double drive_V = (corner - 16) / 2.0 + k / 100.0;
                rdpi_f32_step(&axis, rdpi_f32_predict(&axis, (rdpi_real_t)drive_V, 0));
                TEST_ASSERT_EQUAL_UINT32(corner, axis.dac_code);
                EQUAL((corner - 16) / 2.0, axis.drive_V);
            }
        }
    }
}

/* A quarter of a code below the corner is the code of the corner, three quarters are not: the piece below tells, not that
 * on which the corner's code lies. */
void test_a_turn_at_a_corner_is_rounded_on_the_piece_below(void)
{
    void (*const ways[])(void) = {bend, bend_down};
    for (size_t way = 0; way < 2; way++) {
        for (unsigned quarters = 1; quarters <= 3; quarters += 2) {
            setUp();
            without_rate_law();
            ways[way]();
            five_bit_dac();
            given.params.offset_um = 0;
            start();
            for (int k = 0; k <= 16; k++) { /* up to 5 V, where plays move with x */
                rdpi_f32_step(&axis, rdpi_f32_predict(&axis, (rdpi_real_t)(1 + k / 4.0), 0));
            }
            TEST_ASSERT_EQUAL_UINT32(26, axis.dac_code);
            TEST_ASSERT_TRUE(axis.bank.engaged > 0);
            rdpi_f32_step(&axis, rdpi_f32_predict(&axis, (rdpi_real_t)(5 - quarters / 8.0), 0));
            TEST_ASSERT_EQUAL_UINT32(quarters == 1 ? 26 : 25, axis.dac_code);
        }
    }
}

/* As the library rounds it. */
static rdpi_real_t x_of_code(const rdpi_f32_line_t *line, rdpi_real_t code)
{
#if defined(__FP_FAST_FMAF)
    return fmaf(code, line->um_per_code, line->x_of_code_0_um);
#else
    volatile rdpi_real_t product = code * line->um_per_code;
    return product + line->x_of_code_0_um;
#endif
}

/* To the last bit: so the quick way, which goes on from there, and the long way have the same states. */
void test_the_code_of_a_corner_has_the_x_of_the_piece_above(void)
{
    unsigned differ = 0;
    for (int k = 1; k <= 30; k++) {
        rdpi_real_t y_um[PLAYS];
        setUp();
        without_rate_law();
        bend();
        given.curve[1].gain_um_per_V += (rdpi_real_t)k / 77;
        given.curve[2].gain_um_per_V -= (rdpi_real_t)k / 33;
        five_bit_dac();
        given.params.offset_um = 0;
        start();
        rdpi_f32_step(&axis, rdpi_f32_predict(&axis, 5, 0));
        TEST_ASSERT_EQUAL_UINT32(26, axis.dac_code);
        rdpi_f32_get_memory(&axis, y_um);
        rdpi_real_t below_um = x_of_code(&given.curve[1], 26), above_um = x_of_code(&given.curve[2], 26);
        SAME(above_um, y_um[0]);
        differ += below_um != above_um;
    }
    TEST_ASSERT_TRUE(differ > 0);
}

void test_init_refuses_no_pieces_and_too_many(void)
{
    given.params.curve_pieces = 0;
    actuator_seal(&given);
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_CURVE, rdpi_f32_init(&axis, &given.params, T_S));
    given.params.curve_pieces = RDPI_MAX_CURVE_PIECES + 1;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_CURVE, rdpi_f32_init(&axis, &given.params, T_S));
}

void test_init_refuses_no_array_of_pieces(void)
{
    given.params.curve = NULL;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_init(&axis, &given.params, T_S));
}

void test_init_refuses_a_gain_of_zero_in_any_piece(void)
{
    for (size_t k = 0; k < 3; k++) {
        bend();
        actuator_derive(&given);
        given.curve[k].gain_um_per_V = 0;
        actuator_seal(&given);
        refused_as_they_are(RDPI_ERR_GAIN);
    }
}

static void refused_with(rdpi_real_t *number, double wrong)
{
    rdpi_real_t right = *number;
    *number = (rdpi_real_t)wrong;
    actuator_seal(&given);
    refused_as_they_are(RDPI_ERR_CURVE);
    *number = right;
    actuator_seal(&given);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&axis, &given.params, T_S));
}

void test_init_refuses_pieces_out_of_order_or_with_a_gap(void)
{
    bend();
    five_bit_dac();
    actuator_derive(&given);
    refused_with(&given.curve[0].to_V, -8);   /* the first has no length */
    refused_with(&given.curve[1].to_V, 1);
    refused_with(&given.curve[1].to_V, 8);    /* beyond the last */
    refused_with(&given.curve[2].to_V, 7.25); /* not to the end */
    refused_with(&given.curve[1].offset_V, 1.125);
    refused_with(&given.curve[2].offset_V, 3.875);
    refused_with(&given.curve[1].gain_um_per_V, -1);
    refused_with(&given.curve[0].from_code, 1);
    refused_with(&given.curve[1].from_code, 17);
    refused_with(&given.curve[1].to_code, 18);
    refused_with(&given.curve[2].to_code, 30);
}

void test_init_refuses_a_curve_that_rises_and_falls(void)
{
    given.params.curve_pieces = 2; /* without a gap */
    given.curve[0] = (rdpi_f32_line_t){.gain_um_per_V = 2, .offset_V = 1, .to_V = 1};
    given.curve[1] = (rdpi_f32_line_t){.gain_um_per_V = 1};
    actuator_derive(&given);
    refused_with(&given.curve[1].gain_um_per_V, -1);
}

void test_a_gap_as_small_as_rounding_is_accepted(void)
{
    bend();
    actuator_derive(&given);
    given.curve[1].offset_V += (rdpi_real_t)1e-6;
    actuator_seal(&given);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&axis, &given.params, T_S));
}

/* From a twin that is made to take the long way: the same codes, drives and states. */
void test_quick_and_long_way_are_the_same_over_corners_of_the_curve(void)
{
    void (*const ways[])(void) = {bend, bend_down};
    for (size_t way = 0; way < 2; way++) {
        for (size_t plays = 1; plays <= PLAYS; plays++) {
            setUp();
            ways[way]();
            given.params.plays = (uint16_t)plays;
            given.params.dac_bits = 8;
            start();
            rdpi_f32_t twin = axis;
            uint32_t seed = 3;
            double reference_um = 0;
            for (int k = 0; k < 20000; k++) {
                seed = seed * 1664525u + 1013904223u;
                double change = (double)(seed >> 8) / (1 << 23) - 1;
                reference_um = fmax(-20, fmin(30, reference_um + change / (k / 100 % 2 == 0 ? 1 : 16)));
                twin.quick = false;
                rdpi_real_t long_V = rdpi_f32_step(&twin, (rdpi_real_t)reference_um);
                rdpi_real_t quick_V = rdpi_f32_step(&axis, (rdpi_real_t)reference_um);
                SAME(long_V, quick_V);
                SAME(twin.bank.y_um[0], axis.bank.y_um[0]);
                TEST_ASSERT_EQUAL_UINT32(twin.dac_code, axis.dac_code);
                TEST_ASSERT_EQUAL_UINT32(twin.flags, axis.flags);
            }
        }
    }
}
