#include "unity.h"

#include "f32_saturation.h"

#define COUNT 3
#define EQUAL_REAL(expected, actual) TEST_ASSERT_FLOAT_WITHIN(1e-6f, (float)(expected), (float)(actual))

/* Slopes of the pieces: 1 up to v = 2, 0.5 up to v = 4, 2 beyond; S bends at z = 2 and 3. */
static const rdpi_f32_deadzone_t stage[COUNT] = {{0, 1}, {2, (rdpi_real_t)-0.5}, {4, (rdpi_real_t)1.5}};
static const rdpi_f32_piece_t inverse_stage[COUNT] = {{-9, 2, 1, 0}, {2, 3, 2, -2}, {3, 9, (rdpi_real_t)0.5, (rdpi_real_t)2.5}};

static rdpi_real_t saturation(rdpi_real_t v_um)
{
    return rdpi_f32_saturation(stage, COUNT, v_um);
}

static rdpi_real_t inverse(rdpi_real_t reference_um)
{
    return rdpi_f32_piece_at(rdpi_f32_piece_find(inverse_stage, COUNT, reference_um), reference_um);
}

void setUp(void)
{
}

void tearDown(void)
{
}

void test_a_dead_zone_is_zero_up_to_its_threshold(void)
{
    EQUAL_REAL(0, rdpi_f32_deadzone(-7, 2));
    EQUAL_REAL(0, rdpi_f32_deadzone((rdpi_real_t)1.5, 2));
    EQUAL_REAL(0, rdpi_f32_deadzone(2, 2));
}

void test_a_dead_zone_passes_what_exceeds_its_threshold(void)
{
    EQUAL_REAL(0.5, rdpi_f32_deadzone((rdpi_real_t)2.5, 2));
}

void test_saturation_is_proportional_below_the_first_threshold(void)
{
    EQUAL_REAL(-10, saturation(-10));
    EQUAL_REAL(0, saturation(0));
    EQUAL_REAL(1.5, saturation((rdpi_real_t)1.5));
}

void test_saturation_bends_at_each_threshold(void)
{
    EQUAL_REAL(2, saturation(2));
    EQUAL_REAL(2.5, saturation(3));
    EQUAL_REAL(3, saturation(4));
    EQUAL_REAL(7, saturation(6));
}

void test_saturation_of_one_piece_is_a_gain(void)
{
    const rdpi_f32_deadzone_t gain = {0, (rdpi_real_t)-0.5};
    EQUAL_REAL(-1.5, rdpi_f32_saturation(&gain, 1, 3));
}

/* The first term has no max: its threshold is not read. */
void test_the_first_term_is_linear_on_both_sides_of_zero(void)
{
    const rdpi_f32_deadzone_t gain = {9, 2};
    EQUAL_REAL(-6, rdpi_f32_saturation(&gain, 1, -3));
    EQUAL_REAL(6, rdpi_f32_saturation(&gain, 1, 3));
}

void test_inverse_on_the_first_piece(void)
{
    EQUAL_REAL(0, inverse(0));
    EQUAL_REAL(1.5, inverse((rdpi_real_t)1.5));
}

void test_inverse_of_a_negative_displacement_stays_on_the_first_piece(void)
{
    EQUAL_REAL(-10, inverse(-10));
}

void test_inverse_on_a_middle_piece(void)
{
    EQUAL_REAL(3, inverse((rdpi_real_t)2.5));
}

void test_inverse_on_the_last_piece(void)
{
    EQUAL_REAL(6, inverse(7));
    EQUAL_REAL(504, inverse(1003));
}

void test_the_first_and_last_piece_of_the_inverse_go_on_beyond_their_ends(void)
{
    TEST_ASSERT_EQUAL_PTR(&inverse_stage[0], rdpi_f32_piece_find(inverse_stage, COUNT, -1000));
    TEST_ASSERT_EQUAL_PTR(&inverse_stage[2], rdpi_f32_piece_find(inverse_stage, COUNT, 1000));
    TEST_ASSERT_EQUAL_PTR(&inverse_stage[0], rdpi_f32_piece_find(inverse_stage, 1, 1000));
}

void test_inverse_at_each_corner_is_the_threshold(void)
{
    EQUAL_REAL(2, inverse(2));
    EQUAL_REAL(4, inverse(3));
}

void test_inverse_undoes_saturation_on_every_piece(void)
{
    for (int k = -40; k <= 80; k++) {
        rdpi_real_t v_um = (rdpi_real_t)k / 8;
        EQUAL_REAL(v_um, inverse(saturation(v_um)));
    }
}
