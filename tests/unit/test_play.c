#include "unity.h"

#include "rdpi/play.h"

TEST_SOURCE_FILE("lib/src/play.c")

#define COUNT 4
#define EQUAL_REAL(expected, actual) TEST_ASSERT_FLOAT_WITHIN(1e-6f, (float)(expected), (float)(actual))

static const rdpi_real_t r_um[COUNT] = {0, 1, 2, 4};
static rdpi_real_t y_um[COUNT];

static void equal_states(rdpi_real_t y0, rdpi_real_t y1, rdpi_real_t y2, rdpi_real_t y3)
{
    EQUAL_REAL(y0, y_um[0]);
    EQUAL_REAL(y1, y_um[1]);
    EQUAL_REAL(y2, y_um[2]);
    EQUAL_REAL(y3, y_um[3]);
}

static void move(rdpi_real_t x_um)
{
    rdpi_f32_plays_move(y_um, r_um, COUNT, x_um);
}

void setUp(void)
{
    for (size_t i = 0; i < COUNT; i++) {
        y_um[i] = 0;
    }
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

void test_each_play_of_a_bank_lags_by_its_own_threshold(void)
{
    move(3);
    equal_states(3, 2, 1, 0);
    move(-5);
    equal_states(-5, -4, -3, -1);
}

void test_after_a_reversal_the_plays_let_go_one_by_one(void)
{
    move(5);
    equal_states(5, 4, 3, 1);
    move(4);
    equal_states(4, 4, 3, 1);
    move(2);
    equal_states(2, 3, 3, 1);
    move(0);
    equal_states(0, 1, 2, 1);
}

void test_moving_to_where_the_bank_is_changes_nothing(void)
{
    move(5);
    move(2);
    move(2);
    equal_states(2, 3, 3, 1);
}

void test_a_closed_minor_loop_is_forgotten(void)
{
    move(5);
    move(0);
    move(3);
    move(0);
    equal_states(0, 1, 2, 1);
}

void test_move_touches_count_plays_and_no_more(void)
{
    rdpi_f32_plays_move(y_um, r_um, 2, 5);
    equal_states(5, 4, 0, 0);
}

void test_slopes_at_rest_are_the_slopes_given(void)
{
    const rdpi_real_t slopes[2] = {(rdpi_real_t)0.5, 2}, per_rate[2] = {-1, 1};
    rdpi_real_t out[2] = {9, 9};
    rdpi_f32_slopes_at(out, slopes, per_rate, 2, 0);
    EQUAL_REAL(0.5, out[0]);
    EQUAL_REAL(2, out[1]);
}

void test_slopes_change_linearly_with_the_rate(void)
{
    const rdpi_real_t slopes[2] = {(rdpi_real_t)0.5, 2}, per_rate[2] = {(rdpi_real_t)-0.0625, (rdpi_real_t)0.125};
    rdpi_real_t out[2];
    rdpi_f32_slopes_at(out, slopes, per_rate, 2, 4);
    EQUAL_REAL(0.25, out[0]);
    EQUAL_REAL(2.5, out[1]);
}

void test_slopes_touches_count_slopes_and_no_more(void)
{
    const rdpi_real_t slopes[2] = {1, 1}, per_rate[2] = {0, 0};
    rdpi_real_t out[2] = {9, 9};
    rdpi_f32_slopes_at(out, slopes, per_rate, 1, 0);
    EQUAL_REAL(1, out[0]);
    EQUAL_REAL(9, out[1]);
}

/* w = (0.5, 0.25, 1.25, -0.5) */
void test_the_sum_weighs_each_play_by_the_difference_of_slopes(void)
{
    const rdpi_real_t slopes[COUNT] = {(rdpi_real_t)0.5, (rdpi_real_t)0.75, 2, (rdpi_real_t)1.5};
    const rdpi_real_t y[COUNT] = {5, 7, -3, 11};
    EQUAL_REAL(0.5 * 5 + 0.25 * 7 + 1.25 * -3 - 0.5 * 11, rdpi_f32_plays_sum(y, slopes, COUNT));
}

void test_the_sum_of_one_play_is_slope_times_state(void)
{
    const rdpi_real_t slopes[1] = {(rdpi_real_t)0.75}, y[1] = {-6};
    EQUAL_REAL(-4.5, rdpi_f32_plays_sum(y, slopes, 1));
}

/* Eq. 15: on the first rise the output climbs along the loading curve. */
void test_first_rise_follows_the_loading_curve(void)
{
    const rdpi_real_t slopes[COUNT] = {(rdpi_real_t)0.5, 1, 2, 4};
    const rdpi_real_t corners[] = {0, 1, 2, 4, 5}, curve[] = {0, (rdpi_real_t)0.5, (rdpi_real_t)1.5, (rdpi_real_t)5.5,
                                                              (rdpi_real_t)9.5};
    for (size_t k = 0; k < 5; k++) {
        move(corners[k]);
        EQUAL_REAL(curve[k], rdpi_f32_plays_sum(y_um, slopes, COUNT));
    }
}
