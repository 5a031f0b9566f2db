#include "unity.h"

#include "q31_play.h"
#include "random_bits.h"

#define MAX RDPI_Q31_MAX_DRIVE

void setUp(void)
{
    random_state = 3;
}

void tearDown(void)
{
}

/* ---- the play ---- */

void test_a_play_holds_while_the_input_stays_inside_its_gap(void)
{
    TEST_ASSERT_EQUAL_INT32(500, rdpi_q31_play(575, 100, 500));
    TEST_ASSERT_EQUAL_INT32(500, rdpi_q31_play(425, 100, 500));
}

void test_a_play_holds_at_either_end_of_its_gap(void)
{
    TEST_ASSERT_EQUAL_INT32(500, rdpi_q31_play(600, 100, 500));
    TEST_ASSERT_EQUAL_INT32(500, rdpi_q31_play(400, 100, 500));
}

void test_one_unit_beyond_its_gap_moves_a_play_by_one_unit(void)
{
    TEST_ASSERT_EQUAL_INT32(501, rdpi_q31_play(601, 100, 500));
    TEST_ASSERT_EQUAL_INT32(499, rdpi_q31_play(399, 100, 500));
}

void test_an_input_pushes_or_pulls_the_play_one_threshold_behind_it(void)
{
    TEST_ASSERT_EQUAL_INT32(700, rdpi_q31_play(800, 100, 500));
    TEST_ASSERT_EQUAL_INT32(-200, rdpi_q31_play(-300, 100, 500));
}

void test_a_play_of_threshold_zero_is_the_identity(void)
{
    TEST_ASSERT_EQUAL_INT32(MAX, rdpi_q31_play(MAX, 0, -MAX));
    TEST_ASSERT_EQUAL_INT32(-MAX, rdpi_q31_play(-MAX, 0, MAX));
}

void test_the_largest_inputs_thresholds_and_states_do_not_overflow(void)
{
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_play(MAX, MAX, -MAX));
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_play(-MAX, MAX, MAX));
    TEST_ASSERT_EQUAL_INT32(MAX, rdpi_q31_play(MAX, MAX, MAX));
    TEST_ASSERT_EQUAL_INT32(-MAX, rdpi_q31_play(-MAX, MAX, -MAX));
    TEST_ASSERT_EQUAL_INT32(1, rdpi_q31_play(MAX, MAX - 1, -MAX));
}

/* ---- slopes that depend on the rate ---- */

void test_slopes_at_rest_and_at_the_guard_are_exact(void)
{
    const rdpi_q31_play_t plays[] = {
        {0, RDPI_Q31_ONE, RDPI_Q31_MIN_SLOPE - RDPI_Q31_ONE},
        {0, RDPI_Q31_MIN_SLOPE, RDPI_Q31_ONE - RDPI_Q31_MIN_SLOPE},
        {0, 123456789, -98765432},
        {0, RDPI_Q31_MIN_SLOPE, 0}};
    for (size_t k = 0; k < 4; k++) {
        TEST_ASSERT_EQUAL_INT32(plays[k].slope, rdpi_q31_slope(&plays[k], 0));
        TEST_ASSERT_EQUAL_INT32(plays[k].slope + plays[k].slope_rate, rdpi_q31_slope(&plays[k], RDPI_Q31_ONE));
    }
}

void test_slopes_change_linearly_with_the_rate(void)
{
    const rdpi_q31_play_t softer = {0, 1 << 28, -(1 << 27)}, harder = {0, 1 << 28, 3 << 27};
    TEST_ASSERT_EQUAL_INT32((1 << 28) - (1 << 25), rdpi_q31_slope(&softer, 1 << 28));
    TEST_ASSERT_EQUAL_INT32((1 << 28) + (3 << 26), rdpi_q31_slope(&harder, 1 << 29));
}

void test_slopes_are_rounded_down_whichever_way_they_change(void)
{
    const rdpi_q31_play_t up = {0, RDPI_Q31_MIN_SLOPE, 3}, down = {0, RDPI_Q31_MIN_SLOPE + 3, -3};
    TEST_ASSERT_EQUAL_INT32(RDPI_Q31_MIN_SLOPE, rdpi_q31_slope(&up, 1));
    TEST_ASSERT_EQUAL_INT32(RDPI_Q31_MIN_SLOPE + 1, rdpi_q31_slope(&up, 1 << 29)); /* 1.5 */
    TEST_ASSERT_EQUAL_INT32(RDPI_Q31_MIN_SLOPE + 2, rdpi_q31_slope(&down, 1));
    TEST_ASSERT_EQUAL_INT32(RDPI_Q31_MIN_SLOPE + 1, rdpi_q31_slope(&down, 1 << 29));
}

void test_slopes_stay_between_those_at_both_ends(void)
{
    for (int k = 0; k < 20000; k++) {
        int32_t at_rest = random_between(RDPI_Q31_MIN_SLOPE, RDPI_Q31_ONE);
        int32_t at_guard = random_between(RDPI_Q31_MIN_SLOPE, RDPI_Q31_ONE);
        const rdpi_q31_play_t play = {0, at_rest, at_guard - at_rest};
        int32_t slope = rdpi_q31_slope(&play, random_between(0, RDPI_Q31_ONE));
        TEST_ASSERT_GREATER_OR_EQUAL_INT32(at_rest < at_guard ? at_rest : at_guard, slope);
        TEST_ASSERT_LESS_OR_EQUAL_INT32(at_rest < at_guard ? at_guard : at_rest, slope);
    }
}
