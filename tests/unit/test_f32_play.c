#include "unity.h"

#include "f32_play.h"

#define EQUAL_REAL(expected, actual) TEST_ASSERT_FLOAT_WITHIN(1e-6f, (float)(expected), (float)(actual))

void setUp(void)
{
}

void tearDown(void)
{
}

void test_a_play_holds_while_the_input_stays_inside_its_gap(void)
{
    EQUAL_REAL(5, rdpi_f32_play((rdpi_real_t)5.75, 1, 5));
    EQUAL_REAL(5, rdpi_f32_play((rdpi_real_t)4.25, 1, 5));
}

void test_a_play_holds_at_either_end_of_its_gap(void)
{
    EQUAL_REAL(5, rdpi_f32_play(6, 1, 5));
    EQUAL_REAL(5, rdpi_f32_play(4, 1, 5));
}

void test_a_rising_input_pushes_the_play_one_threshold_behind_it(void)
{
    EQUAL_REAL(7, rdpi_f32_play(8, 1, 5));
}

void test_a_falling_input_pulls_the_play_one_threshold_behind_it(void)
{
    EQUAL_REAL(-2, rdpi_f32_play(-3, 1, 5));
}

void test_a_play_of_threshold_zero_is_the_identity(void)
{
    EQUAL_REAL(8, rdpi_f32_play(8, 0, 5));
    EQUAL_REAL(-8, rdpi_f32_play(-8, 0, 5));
}

void test_slopes_at_rest_are_the_slopes_given(void)
{
    const rdpi_f32_play_t play = {.slope = (rdpi_real_t)0.5, .slope_rate_s_per_um = -1};
    EQUAL_REAL(0.5, rdpi_f32_slope(&play, 0));
}

void test_slopes_change_linearly_with_the_rate(void)
{
    const rdpi_f32_play_t softer = {.slope = (rdpi_real_t)0.5, .slope_rate_s_per_um = (rdpi_real_t)-0.0625};
    const rdpi_f32_play_t harder = {.slope = 2, .slope_rate_s_per_um = (rdpi_real_t)0.125};
    EQUAL_REAL(0.25, rdpi_f32_slope(&softer, 4));
    EQUAL_REAL(2.5, rdpi_f32_slope(&harder, 4));
    EQUAL_REAL(3, rdpi_f32_slope(&harder, 8));
}
