#include "unity.h"

#include <string.h>

#include "q31_inverse.h"
#include "random_bits.h"

#define COUNT 4
#define U ((int32_t)1 << 20) /* of x, r and y */
#define V (U / 4)            /* of v, or "1 V per U" would be a slope beyond the format */
#define ONE RDPI_Q31_ONE
#define MAX RDPI_Q31_MAX_DRIVE
#define NEAR(expected, actual) TEST_ASSERT_INT32_WITHIN(8, expected, actual)

/* Loading curve at rest: v = 0.5 V at x = 1 U, 1.5 at 2, 5.5 at 4, and 4 per U from there. At the guard every slope of
 * `halving` is half of that; those of `softening` have changed to 4, 2, 1, 0.5: every play weight but w_0 negative. */
static const rdpi_q31_play_t halving[COUNT] = {
    {0, ONE / 8, -ONE / 16}, {U, ONE / 4, -ONE / 8}, {2 * U, ONE / 2, -ONE / 4}, {4 * U, ONE, -ONE / 2}};
static const rdpi_q31_play_t softening[COUNT] = {
    {0, ONE / 8, ONE / 8 * 7}, {U, ONE / 4, ONE / 4}, {2 * U, ONE / 2, -ONE / 4}, {4 * U, ONE, -ONE / 8 * 7}};
static rdpi_q31_bank_t bank;
static int32_t plain[RDPI_MAX_PLAYS]; /* the same plays, each for itself (eq. 1) */

static void move_with_guess(int32_t x, size_t guess)
{
    const rdpi_q31_target_t target = {x, guess};
    rdpi_q31_bank_move(&bank, halving, COUNT, target);
    for (size_t i = 0; i < COUNT; i++) {
        plain[i] = rdpi_q31_play(x, halving[i].r, plain[i]);
    }
}

static void move(int32_t x)
{
    move_with_guess(x, 0);
}

/* Solved on a copy: nothing moves. */
static int32_t solution(const rdpi_q31_play_t *play, size_t count, int32_t rate, int32_t v)
{
    rdpi_q31_bank_t copy = bank;
    return rdpi_q31_bank_solve(&copy, play, count, rate, v).x;
}

static void solves(int32_t x, int32_t v)
{
    NEAR(x, solution(halving, COUNT, 0, v));
}

static int32_t output(void)
{
    return rdpi_q31_bank_at(&bank, halving, COUNT, 0, bank.y[0]);
}

static void equal_states(int32_t y0, int32_t y1, int32_t y2, int32_t y3)
{
    TEST_ASSERT_EQUAL_INT32(y0, rdpi_q31_bank_state(&bank, halving, 0));
    TEST_ASSERT_EQUAL_INT32(y1, rdpi_q31_bank_state(&bank, halving, 1));
    TEST_ASSERT_EQUAL_INT32(y2, rdpi_q31_bank_state(&bank, halving, 2));
    TEST_ASSERT_EQUAL_INT32(y3, rdpi_q31_bank_state(&bank, halving, 3));
}

static void equal_states_U(int32_t y0, int32_t y1, int32_t y2, int32_t y3)
{
    equal_states(y0 * U, y1 * U, y2 * U, y3 * U);
}

void setUp(void)
{
    const int32_t rest[COUNT] = {0, 0, 0, 0};
    random_state = 5;
    memset(plain, 0, sizeof plain);
    memset(&bank, 0, sizeof bank);
    rdpi_q31_bank_set(&bank, halving, COUNT, rest);
}

void tearDown(void)
{
}

/* ---- moving ---- */

void test_each_play_of_a_bank_lags_by_its_own_threshold(void)
{
    move(3 * U);
    equal_states_U(3, 2, 1, 0);
    move(-5 * U);
    equal_states_U(-5, -4, -3, -1);
}

void test_after_a_reversal_the_plays_let_go_one_by_one(void)
{
    move(5 * U);
    equal_states_U(5, 4, 3, 1);
    move(4 * U);
    equal_states_U(4, 4, 3, 1);
    move(2 * U);
    equal_states_U(2, 3, 3, 1);
    move(0);
    equal_states_U(0, 1, 2, 1);
}

void test_moving_to_where_the_bank_is_changes_nothing(void)
{
    move(5 * U);
    move(2 * U);
    rdpi_q31_bank_t before;
    memcpy(&before, &bank, sizeof bank);
    move(2 * U);
    TEST_ASSERT_EQUAL_MEMORY(&before, &bank, sizeof bank);
}

void test_a_closed_minor_loop_is_forgotten(void)
{
    move(5 * U);
    move(0);
    move(3 * U);
    move(0);
    equal_states_U(0, 1, 2, 1);
}

void test_move_touches_count_plays_and_no_more(void)
{
    const rdpi_q31_target_t target = {5 * U, 0};
    bank.y[2] = 77;
    rdpi_q31_bank_move(&bank, halving, 2, target);
    equal_states(5 * U, 4 * U, 77, 0);
}

void test_plays_that_move_with_the_input_are_counted(void)
{
    move(3 * U);
    TEST_ASSERT_EQUAL_UINT(2, bank.engaged);
    move(5 * U);
    TEST_ASSERT_EQUAL_UINT(3, bank.engaged);
    move(5 * U - U / 2);
    TEST_ASSERT_EQUAL_UINT(0, bank.engaged);
    move(2 * U);
    TEST_ASSERT_EQUAL_UINT(1, bank.engaged);
}

void test_a_play_reached_but_not_pushed_yet_is_not_engaged(void)
{
    move(2 * U);
    TEST_ASSERT_EQUAL_UINT(1, bank.engaged);
    move(2 * U + 1); /* by one unit */
    TEST_ASSERT_EQUAL_UINT(2, bank.engaged);
    equal_states(2 * U + 1, U + 1, 1, 0);
    move(0);
    TEST_ASSERT_EQUAL_UINT(1, bank.engaged);
    equal_states(0, U, 1, 0);
}

void test_the_guess_how_many_plays_engage_does_not_matter(void)
{
    const int32_t path[] = {3, 2, 5, 4, -1, -1, 0, -6, 6};
    for (size_t guess = 0; guess < COUNT; guess++) {
        setUp();
        for (size_t k = 0; k < sizeof path / sizeof path[0]; k++) {
            move_with_guess(path[k] * U, guess);
            equal_states(plain[0], plain[1], plain[2], plain[3]);
        }
    }
}

void test_turning_round_moves_no_play(void)
{
    move(5 * U);
    rdpi_q31_bank_turn(&bank, halving);
    TEST_ASSERT_TRUE(bank.falling);
    TEST_ASSERT_EQUAL_UINT(0, bank.engaged);
    equal_states_U(5, 4, 3, 1);
    rdpi_q31_bank_turn(&bank, halving);
    TEST_ASSERT_FALSE(bank.falling);
    equal_states_U(5, 4, 3, 1);
}

void test_states_taken_on_are_those_given(void)
{
    const int32_t y[COUNT] = {5 * U, 4 * U, 3 * U, U};
    move(-3 * U);
    rdpi_q31_bank_set(&bank, halving, COUNT, y);
    equal_states_U(5, 4, 3, 1);
    solves(4 * U, 9 * V);
    solves(6 * U, 27 * V / 2);
}

/* ---- the output ---- */

/* w = (0.5, 0.5, 1, 2) V per U */
void test_the_sum_weighs_each_play_by_the_difference_of_slopes(void)
{
    const int32_t y[COUNT] = {5 * U, 11 * U / 2, 5 * U, 6 * U};
    rdpi_q31_bank_set(&bank, halving, COUNT, y);
    TEST_ASSERT_EQUAL_INT32(5 * V / 2 + 11 * V / 4 + 5 * V + 12 * V, output());
    TEST_ASSERT_EQUAL_INT32(5 * V / 4 + 11 * V / 8 + 5 * V / 2 + 6 * V,
                            rdpi_q31_bank_at(&bank, halving, COUNT, ONE, 5 * U));
}

void test_the_sum_of_one_play_is_slope_times_state_rounded_down(void)
{
    TEST_ASSERT_EQUAL_INT32(-3 * V, rdpi_q31_bank_at(&bank, halving, 1, 0, -6 * U));
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_bank_at(&bank, halving, 1, 0, 7));
    TEST_ASSERT_EQUAL_INT32(-1, rdpi_q31_bank_at(&bank, halving, 1, 0, -1));
    const rdpi_q31_play_t nearly_one = {0, ONE - 1, 0};
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_bank_at(&bank, &nearly_one, 1, 0, 1));
}

/* Eq. 15: on the first rise the output climbs along the loading curve. */
void test_first_rise_follows_the_loading_curve(void)
{
    const int32_t corners[] = {0, U, 2 * U, 4 * U, 5 * U}, curve[] = {0, V / 2, 3 * V / 2, 11 * V / 2, 19 * V / 2};
    for (size_t k = 0; k < 5; k++) {
        TEST_ASSERT_EQUAL_INT32(curve[k], rdpi_q31_bank_at(&bank, halving, COUNT, 0, corners[k]));
        TEST_ASSERT_EQUAL_INT32(-curve[k], rdpi_q31_bank_at(&bank, halving, COUNT, 0, -corners[k]));
    }
    equal_states_U(0, 0, 0, 0);
    for (size_t k = 0; k < 5; k++) {
        move(corners[k]);
        TEST_ASSERT_EQUAL_INT32(curve[k], output());
    }
}

/* What the solution starts from: 2^30 f = W_k x + rest + rate / 2^30 rest_rate. */
void test_slope_and_rest_make_the_output_that_the_definition_gives(void)
{
    const int32_t path[] = {0, 2, 6, 10, 12, 10, 4, 8, -2, -12, -12, -10, 0, -1, 14};
    for (size_t k = 0; k < sizeof path / sizeof path[0]; k++) {
        move(path[k] * (U / 2));
        for (int64_t rate = 0; rate <= ONE; rate += ONE / 2) {
            int64_t sum = (int64_t)rdpi_q31_slope(&halving[bank.engaged], (int32_t)rate) * bank.y[0] + bank.rest +
                          rate * (bank.rest_rate / ONE);
            int32_t v = rdpi_q31_bank_at(&bank, halving, COUNT, (int32_t)rate, bank.y[0]);
            TEST_ASSERT_EQUAL_INT64((int64_t)v * ONE, sum);
        }
    }
}

/* ---- solving ---- */

void test_asking_for_the_present_output_gives_the_present_input(void)
{
    solves(0, 0);
    move(5 * U);
    move(2 * U);
    solves(2 * U, output());
}

void test_rising_from_rest_on_every_piece(void)
{
    solves(U / 2, V / 4);
    solves(3 * U / 2, V);
    solves(3 * U, 7 * V / 2);
    solves(5 * U, 19 * V / 2);
}

void test_rising_to_each_corner_exactly(void)
{
    solves(U, V / 2);
    solves(2 * U, 3 * V / 2);
    solves(4 * U, 11 * V / 2);
}

void test_falling_from_rest_mirrors_rising(void)
{
    solves(-U / 2, -V / 4);
    solves(-3 * U / 2, -V);
    solves(-3 * U, -7 * V / 2);
    solves(-5 * U, -19 * V / 2);
}

void test_falling_to_each_corner_exactly(void)
{
    solves(-U, -V / 2);
    solves(-2 * U, -3 * V / 2);
    solves(-4 * U, -11 * V / 2);
}

/* At x = 5 the plays sit at 5, 4, 3, 1 and v = 9.5; falling, they engage at 5, 3, 1, -3. */
void test_after_a_reversal_falling_has_pieces_twice_as_long(void)
{
    move(5 * U);
    solves(4 * U, 9 * V);
    solves(3 * U, 17 * V / 2);
    solves(2 * U, 15 * V / 2);
    solves(U, 13 * V / 2);
    solves(-U, 5 * V / 2);
    solves(-3 * U, -3 * V / 2);
    solves(-4 * U, -11 * V / 2);
}

void test_after_a_reversal_rising_has_pieces_twice_as_long(void)
{
    move(-5 * U);
    solves(-4 * U, -9 * V);
    solves(-3 * U, -17 * V / 2);
    solves(-U, -13 * V / 2);
    solves(U, -5 * V / 2);
    solves(3 * U, 3 * V / 2);
    solves(4 * U, 11 * V / 2);
}

void test_going_on_in_the_same_direction_all_engaged_plays_move_together(void)
{
    move(3 * U);
    solves(7 * U / 2, 9 * V / 2);
    move(5 * U);
    solves(6 * U, 27 * V / 2);
}

/* At 5, then 2: plays at 2, 3, 3, 1, v = 7.5; rising, they engage at 2, 4, and two of them at 5. */
void test_leaving_a_minor_loop_passes_a_corner_shared_by_two_plays(void)
{
    move(5 * U);
    move(2 * U);
    solves(3 * U, 8 * V);
    solves(4 * U, 17 * V / 2);
    solves(5 * U, 19 * V / 2);
    solves(6 * U, 27 * V / 2);
}

/* At (5, 4, 3, 1) half the slopes give 4.75. */
void test_slopes_that_changed_since_the_last_sample_are_solved_with_the_states_as_they_are(void)
{
    move(5 * U);
    NEAR(5 * U, solution(halving, COUNT, ONE, 19 * V / 4));
    NEAR(59 * U / 8, solution(halving, COUNT, ONE, 19 * V / 2));
    NEAR(3 * U, solution(halving, COUNT, ONE, 17 * V / 4));
}

void test_slopes_that_fall_along_the_loading_curve(void)
{
    NEAR(U / 2, solution(softening, COUNT, ONE, 2 * V));
    NEAR(3 * U, solution(softening, COUNT, ONE, 7 * V));
    NEAR(-6 * U, solution(softening, COUNT, ONE, -9 * V));
}

void test_one_play_is_a_division(void)
{
    const int32_t y[] = {3 * U};
    rdpi_q31_bank_set(&bank, halving, 1, y);
    NEAR(8 * U, solution(halving, 1, 0, 4 * V));
    NEAR(-8 * U, solution(halving, 1, 0, -4 * V));
}

void test_solving_moves_no_play(void)
{
    move(5 * U);
    rdpi_q31_bank_solve(&bank, halving, COUNT, 0, 37 * V / 4); /* down, with the first play alone */
    equal_states_U(5, 4, 3, 1);
    setUp();
    move(5 * U);
    rdpi_q31_bank_solve(&bank, halving, COUNT, 0, -11 * V / 2);
    equal_states_U(5, 4, 3, 1);
}

void test_solution_says_how_many_plays_it_engages(void)
{
    rdpi_q31_target_t target = rdpi_q31_bank_solve(&bank, halving, COUNT, 0, 7 * V / 2);
    TEST_ASSERT_EQUAL_UINT(2, target.engaged);
    TEST_ASSERT_FALSE(bank.falling);
    move(5 * U);
    target = rdpi_q31_bank_solve(&bank, halving, COUNT, 0, 15 * V / 2);
    TEST_ASSERT_EQUAL_UINT(1, target.engaged);
    TEST_ASSERT_TRUE(bank.falling);
}

/* ---- scaling and overflow ---- */

void test_solution_saturates_at_2_to_the_30_either_way(void)
{
    const rdpi_q31_play_t flattest[] = {{0, RDPI_Q31_MIN_SLOPE, 0}};
    const int32_t ends[] = {-MAX, 0, MAX};
    for (size_t k = 0; k < 3; k++) {
        rdpi_q31_bank_set(&bank, flattest, 1, &ends[k]);
        TEST_ASSERT_EQUAL_INT32(ONE, solution(flattest, 1, 0, ONE));
        TEST_ASSERT_EQUAL_INT32(-ONE, solution(flattest, 1, 0, -ONE));
        NEAR(MAX, solution(flattest, 1, 0, 1 << 23)); /* both ends of the format can be reached from the other */
        NEAR(-MAX, solution(flattest, 1, 0, -(1 << 23)));
    }
}

/* Thresholds and drives of the whole format, slopes from the smallest to the largest and back: |rest| is at its most
 * where every play lies as far from the next as it can, by turns up and down. */
void test_the_largest_numbers_of_the_format_do_not_overflow(void)
{
    rdpi_q31_play_t play[RDPI_MAX_PLAYS];
    const int32_t step = MAX / (RDPI_MAX_PLAYS - 1);
    for (int kind = 0; kind < 8; kind++) {
        int32_t y[RDPI_MAX_PLAYS], side = kind & 4 ? -1 : 1;
        for (int i = 0; i < RDPI_MAX_PLAYS; i++) {
            int32_t steep = (i + kind) % 2 ? ONE : RDPI_Q31_MIN_SLOPE;
            play[i].r = i * step;
            play[i].slope = steep;
            play[i].slope_rate = kind & 2 ? ONE + RDPI_Q31_MIN_SLOPE - 2 * steep : 0;
            y[i] = side * (i % 2 ? MAX - step : MAX);
        }
        play[RDPI_MAX_PLAYS - 1].r = MAX;
        const int32_t path[] = {MAX, -MAX, MAX, MAX - 2 * step, MAX - step, -MAX, 0, -1, MAX};
        rdpi_q31_bank_set(&bank, play, RDPI_MAX_PLAYS, y);
        memcpy(plain, y, sizeof plain);
        for (size_t k = 0; k < sizeof path / sizeof path[0]; k++) {
            for (int32_t rate = 0; rate <= ONE / 2; rate += ONE / 2) {
                int32_t v = rdpi_q31_bank_at(&bank, play, RDPI_MAX_PLAYS, 2 * rate, bank.y[0]);
                TEST_ASSERT_INT32_WITHIN(RDPI_Q31_ONE, 0, v);
                TEST_ASSERT_INT32_WITHIN(512, bank.y[0], solution(play, RDPI_MAX_PLAYS, 2 * rate, v));
                solution(play, RDPI_MAX_PLAYS, 2 * rate, ONE); /* the sanitizers listen */
                solution(play, RDPI_MAX_PLAYS, 2 * rate, -ONE);
            }
            TEST_ASSERT_TRUE(bank.rest <= (int64_t)3 << 59 && bank.rest >= -((int64_t)3 << 59));
            TEST_ASSERT_TRUE(bank.rest_rate <= (int64_t)3 << 59 && bank.rest_rate >= -((int64_t)3 << 59));
            const rdpi_q31_target_t target = {path[k], 0};
            rdpi_q31_bank_move(&bank, play, RDPI_MAX_PLAYS, target);
            for (size_t i = 0; i < RDPI_MAX_PLAYS; i++) {
                plain[i] = rdpi_q31_play(path[k], play[i].r, plain[i]);
                TEST_ASSERT_EQUAL_INT32(plain[i], rdpi_q31_bank_state(&bank, play, i));
            }
        }
    }
}

/* ---- any actuator ---- */

static rdpi_q31_play_t any_play[RDPI_MAX_PLAYS];
static size_t any_count;

static int32_t random_slope(void)
{
    int32_t steepest = ONE >> random_between(0, 5);
    return random_between(RDPI_Q31_MIN_SLOPE, steepest);
}

/* Slopes of the whole format, thresholds up to the largest, from rest. */
static void any_bank(void)
{
    any_count = (size_t)random_between(1, RDPI_MAX_PLAYS);
    for (size_t i = 0; i < any_count; i++) {
        any_play[i].r = i == 0 ? 0 : any_play[i - 1].r + random_between(1, MAX / (int32_t)any_count);
        any_play[i].slope = random_slope();
        any_play[i].slope_rate = random_slope() - any_play[i].slope;
    }
    memset(plain, 0, sizeof plain);
    rdpi_q31_bank_set(&bank, any_play, any_count, plain);
}

static void any_move(rdpi_q31_target_t target)
{
    rdpi_q31_bank_move(&bank, any_play, any_count, target);
    for (size_t i = 0; i < any_count; i++) {
        plain[i] = rdpi_q31_play(target.x, any_play[i].r, plain[i]);
    }
}

/* Every state where eq. 1 has it, and rest what they sum up to, to the last bit. */
static void exact_in_every_bit(void)
{
    int64_t rest = 0, rest_rate = 0;
    for (size_t i = 0; i < any_count; i++) {
        TEST_ASSERT_EQUAL_INT32(plain[i], rdpi_q31_bank_state(&bank, any_play, i));
    }
    for (size_t i = 1; i < any_count; i++) {
        int64_t summand = i > bank.engaged ? plain[i] : -(int64_t)rdpi_q31_bank_side(bank.falling) * any_play[i].r;
        rest += (any_play[i].slope - any_play[i - 1].slope) * summand;
        rest_rate += (any_play[i].slope_rate - any_play[i - 1].slope_rate) * summand;
    }
    TEST_ASSERT_EQUAL_INT64(rest, bank.rest);
    TEST_ASSERT_EQUAL_INT64(rest_rate, bank.rest_rate);
}

/* Far and near, so that long and short minor loops come about. */
static int32_t any_x(void)
{
    int32_t reach = MAX >> random_between(0, 20), x = plain[0] + random_between(-reach, reach);
    return rdpi_q31_clamp(x, -MAX, MAX);
}

void test_states_and_sums_stay_exact_through_any_moves(void)
{
    for (int number = 0; number < 50; number++) {
        any_bank();
        for (int k = 0; k < 500; k++) {
            size_t guess = (size_t)random_between(0, (int32_t)any_count - 1);
            const rdpi_q31_target_t target = {any_x(), guess};
            any_move(target);
            exact_in_every_bit();
        }
    }
}

/* Solving and moving elsewhere than solved for, as clipped drives do. */
void test_nothing_drifts_in_a_hundred_thousand_moves(void)
{
    any_count = 0;
    while (any_count < RDPI_MAX_PLAYS) {
        any_bank();
    }
    for (int k = 0; k < 100000; k++) {
        int32_t rate = random_between(0, ONE), v = random_size(ONE, 20);
        rdpi_q31_target_t target = rdpi_q31_bank_solve(&bank, any_play, any_count, rate, v);
        target.x = random_bits() % 2u ? any_x() : rdpi_q31_clamp(target.x, -MAX, MAX);
        any_move(target);
        if (k % 100 == 0) {
            exact_in_every_bit();
        }
    }
    exact_in_every_bit();
}

/* Any v that an x within the format has: a few units of v, whatever the slopes. */
void test_the_solution_put_into_any_bank_gives_what_was_asked(void)
{
    for (int number = 0; number < 100; number++) {
        any_bank();
        for (int k = 0; k < 500; k++) {
            int32_t rate = random_between(0, ONE);
            int32_t v = rdpi_q31_bank_at(&bank, any_play, any_count, rate, any_x());
            rdpi_q31_target_t target = rdpi_q31_bank_solve(&bank, any_play, any_count, rate, v);
            TEST_ASSERT_INT32_WITHIN(MAX + 512, 0, target.x);
            target.x = rdpi_q31_clamp(target.x, -MAX, MAX);
            any_move(target);
            TEST_ASSERT_INT32_WITHIN(6, v, rdpi_q31_bank_at(&bank, any_play, any_count, rate, bank.y[0]));
        }
    }
}

/* ---- solving, then moving ---- */

void test_after_solving_the_bank_can_move_anywhere(void)
{
    const int32_t asked[] = {9 * V, -9 * V, V, -V};
    for (int32_t from = -5; from <= 5; from++) {
        for (int32_t to = -6; to <= 6; to++) {
            for (size_t k = 0; k < 4; k++) {
                setUp();
                move(5 * U);
                move(from * U);
                rdpi_q31_target_t target = rdpi_q31_bank_solve(&bank, halving, COUNT, 0, output() + asked[k]);
                move_with_guess(to * U, target.engaged);
                equal_states(plain[0], plain[1], plain[2], plain[3]);
                TEST_ASSERT_EQUAL_INT64((int64_t)output() * ONE,
                                        (int64_t)halving[bank.engaged].slope * bank.y[0] + bank.rest);
            }
        }
    }
}
