#include "unity.h"

#include "rdpi/inverse.h"
#include "rdpi/play.h"

TEST_SOURCE_FILE("lib/src/inverse.c")
TEST_SOURCE_FILE("lib/src/play.c")

#define COUNT 4
#define EQUAL_REAL(expected, actual) TEST_ASSERT_FLOAT_WITHIN(1e-6f, (float)(expected), (float)(actual))

/* Loading curve: v = 0.5 at x = 1, 1.5 at 2, 5.5 at 4, and 4 per um from there. */
static const rdpi_real_t r_um[COUNT] = {0, 1, 2, 4};
static const rdpi_real_t hardening[COUNT] = {(rdpi_real_t)0.5, 1, 2, 4};
static const rdpi_real_t softening[COUNT] = {4, 2, 1, (rdpi_real_t)0.5}; /* every play weight but w_0 negative */
static rdpi_real_t y_um[COUNT];

static void move(rdpi_real_t x_um)
{
    rdpi_f32_plays_move(y_um, r_um, COUNT, x_um);
}

static void solves(rdpi_real_t x_um, rdpi_real_t v_um)
{
    EQUAL_REAL(x_um, rdpi_f32_plays_solve(y_um, r_um, hardening, COUNT, v_um));
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

void test_asking_for_the_present_output_gives_the_present_input(void)
{
    solves(0, 0);
    move(5);
    move(2);
    solves(2, rdpi_f32_plays_sum(y_um, hardening, COUNT));
}

void test_rising_from_rest_on_every_piece(void)
{
    solves((rdpi_real_t)0.5, (rdpi_real_t)0.25);
    solves((rdpi_real_t)1.5, 1);
    solves(3, (rdpi_real_t)3.5);
    solves(5, (rdpi_real_t)9.5);
}

void test_rising_to_each_corner_exactly(void)
{
    solves(1, (rdpi_real_t)0.5);
    solves(2, (rdpi_real_t)1.5);
    solves(4, (rdpi_real_t)5.5);
}

void test_falling_from_rest_mirrors_rising(void)
{
    solves((rdpi_real_t)-0.5, (rdpi_real_t)-0.25);
    solves((rdpi_real_t)-1.5, -1);
    solves(-3, (rdpi_real_t)-3.5);
    solves(-5, (rdpi_real_t)-9.5);
}

void test_falling_to_each_corner_exactly(void)
{
    solves(-1, (rdpi_real_t)-0.5);
    solves(-2, (rdpi_real_t)-1.5);
    solves(-4, (rdpi_real_t)-5.5);
}

/* At x = 5 the plays sit at 5, 4, 3, 1 and v = 9.5; falling, they engage at 5, 3, 1, -3. */
void test_after_a_reversal_falling_has_pieces_twice_as_long(void)
{
    move(5);
    solves(4, 9);
    solves(3, (rdpi_real_t)8.5);
    solves(2, (rdpi_real_t)7.5);
    solves(1, (rdpi_real_t)6.5);
    solves(-1, (rdpi_real_t)2.5);
    solves(-3, (rdpi_real_t)-1.5);
    solves(-4, (rdpi_real_t)-5.5);
}

void test_after_a_reversal_rising_has_pieces_twice_as_long(void)
{
    move(-5);
    solves(-4, -9);
    solves(-3, (rdpi_real_t)-8.5);
    solves(-1, (rdpi_real_t)-6.5);
    solves(1, (rdpi_real_t)-2.5);
    solves(3, (rdpi_real_t)1.5);
    solves(4, (rdpi_real_t)5.5);
}

void test_going_on_in_the_same_direction_all_engaged_plays_move_together(void)
{
    move(3);
    solves((rdpi_real_t)3.5, (rdpi_real_t)4.5);
    move(5);
    solves(6, (rdpi_real_t)13.5);
}

/* At 5, then 2: plays at 2, 3, 3, 1, v = 7.5; rising, they engage at 2, 4, and two of them at 5. */
void test_leaving_a_minor_loop_passes_a_corner_shared_by_two_plays(void)
{
    move(5);
    move(2);
    solves(3, 8);
    solves(4, (rdpi_real_t)8.5);
    solves(5, (rdpi_real_t)9.5);
    solves(6, (rdpi_real_t)13.5);
}

/* At (5, 4, 3, 1) half the slopes give 4.75. */
void test_slopes_that_changed_since_the_last_sample_are_solved_with_the_states_as_they_are(void)
{
    const rdpi_real_t halved[COUNT] = {(rdpi_real_t)0.25, (rdpi_real_t)0.5, 1, 2};
    move(5);
    EQUAL_REAL(5, rdpi_f32_plays_solve(y_um, r_um, halved, COUNT, (rdpi_real_t)4.75));
    EQUAL_REAL(7.375, rdpi_f32_plays_solve(y_um, r_um, halved, COUNT, (rdpi_real_t)9.5));
    EQUAL_REAL(3, rdpi_f32_plays_solve(y_um, r_um, halved, COUNT, (rdpi_real_t)4.25));
}

void test_slopes_that_fall_along_the_loading_curve(void)
{
    EQUAL_REAL(0.5, rdpi_f32_plays_solve(y_um, r_um, softening, COUNT, 2));
    EQUAL_REAL(3, rdpi_f32_plays_solve(y_um, r_um, softening, COUNT, 7));
    EQUAL_REAL(-6, rdpi_f32_plays_solve(y_um, r_um, softening, COUNT, -9));
}

void test_one_play_is_a_division(void)
{
    y_um[0] = 3;
    EQUAL_REAL(8, rdpi_f32_plays_solve(y_um, r_um, hardening, 1, 4));
    EQUAL_REAL(-8, rdpi_f32_plays_solve(y_um, r_um, hardening, 1, -4));
}

void test_solving_moves_no_play(void)
{
    const rdpi_real_t before[COUNT] = {5, 4, 3, 1};
    move(5);
    solves(-4, (rdpi_real_t)-5.5);
    TEST_ASSERT_EQUAL_MEMORY(before, y_um, sizeof before);
}

void test_the_solution_put_into_the_bank_gives_what_was_asked_through_reversals_and_changing_slopes(void)
{
    uint32_t seed = 1;
    for (int k = 0; k < 2000; k++) {
        seed = seed * 1664525u + 1013904223u;
        rdpi_real_t v_um = (rdpi_real_t)(seed >> 16) / 4096 - 8;
        const rdpi_real_t *slopes = k % 3 == 0 ? softening : hardening;
        rdpi_real_t x_um = rdpi_f32_plays_solve(y_um, r_um, slopes, COUNT, v_um);
        move(x_um);
        TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)v_um, (float)rdpi_f32_plays_sum(y_um, slopes, COUNT));
    }
}
