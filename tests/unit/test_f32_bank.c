#include "unity.h"

#include <math.h>
#include <string.h>

#include "actuator.h"
#include "f32_bank.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#define COUNT 4
#define EQUAL_REAL(expected, actual) TEST_ASSERT_FLOAT_WITHIN(1e-6f, (float)(expected), (float)(actual))

/* Loading curve at rate 0: v = 0.5 at x = 1, 1.5 at 2, 5.5 at 4, and 4 per um from there. At rate 1 every slope of
 * `halving` is half of that; those of `softening` have changed to 4, 2, 1, 0.5: every play weight but w_0 negative. */
static rdpi_f32_play_t halving[COUNT], softening[COUNT];
static rdpi_f32_bank_t bank;
static rdpi_real_t plain_um[COUNT]; /* the same plays, each for itself (eq. 1) */

static void fill(rdpi_f32_play_t *play, const rdpi_real_t *at_rate_1)
{
    const rdpi_real_t r_um[COUNT] = {0, 1, 2, 4}, slopes[COUNT] = {(rdpi_real_t)0.5, 1, 2, 4};
    for (size_t i = 0; i < COUNT; i++) {
        play[i] = (rdpi_f32_play_t){r_um[i], slopes[i], at_rate_1[i] - slopes[i], 0, 0};
    }
    actuator_derive_intercepts(play, COUNT);
}

static void move(rdpi_real_t x_um)
{
    rdpi_f32_bank_move(&bank, halving, COUNT, rdpi_f32_bank_target(x_um));
    for (size_t i = 0; i < COUNT; i++) {
        plain_um[i] = rdpi_f32_play(x_um, halving[i].r_um, plain_um[i]);
    }
}

/* The x at which f is `v_um`. */
static rdpi_f32_target_t solve(rdpi_f32_bank_t *any, const rdpi_f32_play_t *play, size_t count,
                               rdpi_real_t rate_um_per_s, rdpi_real_t v_um)
{
    return rdpi_f32_bank_walk(any, play, count, rate_um_per_s, rdpi_f32_bank_climb(any, rate_um_per_s, v_um));
}

/* Solved on a copy: nothing moves. */
static rdpi_real_t solution(const rdpi_f32_play_t *play, size_t count, rdpi_real_t rate_um_per_s, rdpi_real_t v_um)
{
    rdpi_f32_bank_t copy = bank;
    copy.last_engaged = &play[copy.engaged];
    return solve(&copy, play, count, rate_um_per_s, v_um).x_um;
}

static void solves(rdpi_real_t x_um, rdpi_real_t v_um)
{
    EQUAL_REAL(x_um, solution(halving, COUNT, 0, v_um));
}

static rdpi_real_t output(void)
{
    return rdpi_f32_bank_at(&bank, halving, COUNT, 0, bank.y_um[0]);
}

static void equal_states(rdpi_real_t y0, rdpi_real_t y1, rdpi_real_t y2, rdpi_real_t y3)
{
    EQUAL_REAL(y0, rdpi_f32_bank_state(&bank, halving, 0));
    EQUAL_REAL(y1, rdpi_f32_bank_state(&bank, halving, 1));
    EQUAL_REAL(y2, rdpi_f32_bank_state(&bank, halving, 2));
    EQUAL_REAL(y3, rdpi_f32_bank_state(&bank, halving, 3));
}

void setUp(void)
{
    const rdpi_real_t halves[COUNT] = {(rdpi_real_t)0.25, (rdpi_real_t)0.5, 1, 2};
    const rdpi_real_t falling[COUNT] = {4, 2, 1, (rdpi_real_t)0.5};
    const rdpi_real_t rest[COUNT] = {0, 0, 0, 0};
    fill(halving, halves);
    fill(softening, falling);
    memset(plain_um, 0, sizeof plain_um);
    rdpi_f32_bank_set(&bank, halving, COUNT, rest);
}

void tearDown(void)
{
}

/* ---- moving ---- */

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
    rdpi_f32_bank_t before = bank;
    move(2);
    TEST_ASSERT_EQUAL_MEMORY(&before, &bank, sizeof bank);
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
    bank.y_um[2] = 77;
    rdpi_f32_bank_move(&bank, halving, 2, rdpi_f32_bank_target(5));
    equal_states(5, 4, 77, 0);
}

void test_plays_that_move_with_the_input_are_counted(void)
{
    move(3);
    TEST_ASSERT_EQUAL_UINT(2, bank.engaged);
    move(5);
    TEST_ASSERT_EQUAL_UINT(3, bank.engaged);
    move((rdpi_real_t)4.5);
    TEST_ASSERT_EQUAL_UINT(0, bank.engaged);
    move(2);
    TEST_ASSERT_EQUAL_UINT(1, bank.engaged);
}

void test_a_play_reached_but_not_pushed_yet_is_not_engaged(void)
{
    move(2);
    TEST_ASSERT_EQUAL_UINT(1, bank.engaged);
    equal_states(2, 1, 0, 0);
    move(5);
    move(3);
    TEST_ASSERT_EQUAL_UINT(0, bank.engaged);
    equal_states(3, 4, 3, 1);
}

void test_noting_the_engaged_plays_moves_none(void)
{
    move(5);
    rdpi_f32_bank_store(&bank, halving, 1);
    equal_states(5, 4, 3, 1);
    EQUAL_REAL(4, bank.y_um[1]);
    EQUAL_REAL(3, bank.y_um[2]);
    EQUAL_REAL(1, bank.y_um[3]);
}

void test_what_turns_back_only_to_stay_where_it_was_has_not_turned(void)
{
    move(5);
    rdpi_f32_bank_t before = bank;
    rdpi_f32_target_t target = solve(&bank, halving, COUNT, 0, output() - (rdpi_real_t)0.5);
    TEST_ASSERT_TRUE(target.turned);
    target.x_um = 5;
    EQUAL_REAL(1, rdpi_f32_bank_move(&bank, halving, COUNT, target));
    TEST_ASSERT_EQUAL_UINT(before.engaged, bank.engaged);
    TEST_ASSERT_EQUAL(before.falling, bank.falling);
    EQUAL_REAL(before.remainder_um, bank.remainder_um);
    equal_states(5, 4, 3, 1);
}

void test_states_taken_on_are_those_given(void)
{
    const rdpi_real_t y_um[COUNT] = {5, 4, 3, 1};
    move(-3);
    rdpi_f32_bank_set(&bank, halving, COUNT, y_um);
    equal_states(5, 4, 3, 1);
    solves(4, 9);
    solves(6, (rdpi_real_t)13.5);
}

/* Each y_i so far below x - r_i that the play would be engaged, were they not rounded. */
void test_states_taken_on_are_those_given_also_where_they_are_rounded(void)
{
    const rdpi_real_t y_um[COUNT] = {5, (rdpi_real_t)3.9999, (rdpi_real_t)2.9998, (rdpi_real_t)0.9997};
    rdpi_f32_bank_set(&bank, halving, COUNT, y_um);
    for (size_t i = 0; i < COUNT; i++) {
        rdpi_real_t state_um = rdpi_f32_bank_state(&bank, halving, i);
        TEST_ASSERT_EQUAL_MEMORY(&y_um[i], &state_um, sizeof state_um);
    }
}

/* ---- the output ---- */

/* w = (0.5, 0.5, 1, 2) */
void test_the_sum_weighs_each_play_by_the_difference_of_slopes(void)
{
    const rdpi_real_t y_um[COUNT] = {5, (rdpi_real_t)5.5, 4, 6};
    rdpi_f32_bank_set(&bank, halving, COUNT, y_um);
    EQUAL_REAL(0.5 * 5 + 0.5 * 5.5 + 1 * 4 + 2 * 6, output());
    EQUAL_REAL(0.25 * 5 + 0.25 * 5.5 + 0.5 * 4 + 1 * 6, rdpi_f32_bank_at(&bank, halving, COUNT, 1, 5));
}

void test_the_sum_of_one_play_is_slope_times_state(void)
{
    EQUAL_REAL(-3, rdpi_f32_bank_at(&bank, halving, 1, 0, -6));
}

/* Eq. 15: on the first rise the output climbs along the loading curve. */
void test_first_rise_follows_the_loading_curve(void)
{
    const rdpi_real_t corners[] = {0, 1, 2, 4, 5}, curve[] = {0, (rdpi_real_t)0.5, (rdpi_real_t)1.5, (rdpi_real_t)5.5,
                                                              (rdpi_real_t)9.5};
    for (size_t k = 0; k < 5; k++) {
        EQUAL_REAL(curve[k], rdpi_f32_bank_at(&bank, halving, COUNT, 0, corners[k]));
        EQUAL_REAL(-curve[k], rdpi_f32_bank_at(&bank, halving, COUNT, 0, -corners[k]));
    }
    equal_states(0, 0, 0, 0);
    for (size_t k = 0; k < 5; k++) {
        move(corners[k]);
        EQUAL_REAL(curve[k], output());
    }
}

/* What the solution starts from: W_k x + rest + rate * (change of rest per rate), kept up from move to move. */
void test_slope_and_rest_make_the_output_that_the_definition_gives(void)
{
    const rdpi_real_t path_um[] = {0, 1, 3, 5, 6, 5, 2, 4, -1, -6, -6, -5, 0, (rdpi_real_t)-0.5, 7};
    for (size_t k = 0; k < sizeof path_um / sizeof path_um[0]; k++) {
        move(path_um[k]);
        for (int rate = 0; rate < 2; rate++) {
            rdpi_real_t slope = rdpi_f32_slope(&halving[bank.engaged], (rdpi_real_t)rate);
            rdpi_real_t v_um = slope * path_um[k] + bank.remainder_um + (rdpi_real_t)rate * bank.remainder_rate_s;
            EQUAL_REAL(rdpi_f32_bank_at(&bank, halving, COUNT, (rdpi_real_t)rate, path_um[k]), v_um);
        }
    }
}

/* ---- solving ---- */

void test_asking_for_the_present_output_gives_the_present_input(void)
{
    solves(0, 0);
    move(5);
    move(2);
    solves(2, output());
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
    move(5);
    EQUAL_REAL(5, solution(halving, COUNT, 1, (rdpi_real_t)4.75));
    EQUAL_REAL(7.375, solution(halving, COUNT, 1, (rdpi_real_t)9.5));
    EQUAL_REAL(3, solution(halving, COUNT, 1, (rdpi_real_t)4.25));
}

void test_slopes_that_fall_along_the_loading_curve(void)
{
    EQUAL_REAL(0.5, solution(softening, COUNT, 1, 2));
    EQUAL_REAL(3, solution(softening, COUNT, 1, 7));
    EQUAL_REAL(-6, solution(softening, COUNT, 1, -9));
}

void test_one_play_is_a_division(void)
{
    move(3);
    rdpi_f32_bank_set(&bank, halving, 1, bank.y_um);
    EQUAL_REAL(8, solution(halving, 1, 0, 4));
    EQUAL_REAL(-8, solution(halving, 1, 0, -4));
}

void test_solving_moves_no_play(void)
{
    move(5);
    solve(&bank, halving, COUNT, 0, (rdpi_real_t)9.25); /* down, with the first play alone */
    equal_states(5, 4, 3, 1);
    setUp();
    move(5);
    solve(&bank, halving, COUNT, 0, (rdpi_real_t)-5.5);
    equal_states(5, 4, 3, 1);
}

void test_solution_says_whether_x_has_turned(void)
{
    move(5);
    TEST_ASSERT_FALSE(solve(&bank, halving, COUNT, 0, 12).turned);
    TEST_ASSERT_TRUE(solve(&bank, halving, COUNT, 0, (rdpi_real_t)7.5).turned);
}

/* ---- the quick way ---- */

/* Whether a play engages or lets go on the way to `x_um`. */
static bool happens(rdpi_real_t x_um)
{
    bool falling = x_um < bank.y_um[0];
    rdpi_real_t way_um = fabs(x_um - bank.y_um[0]), side = rdpi_f32_bank_side(falling);
    if (falling != bank.falling && bank.engaged > 0u && way_um > 0) {
        return true;
    }
    size_t next = bank.engaged + 1u;
    return next < COUNT && side * (x_um - bank.y_um[next]) > halving[next].r_um;
}

/* And x alone need be noted: the states follow. */
void test_where_no_play_engages_or_lets_go_the_quick_way_leads_to_the_solution(void)
{
    const rdpi_real_t path_um[] = {0, (rdpi_real_t)0.5, 3, 5, 4, 2, -1, -4, -5, -4, 1};
    unsigned found = 0;
    for (size_t k = 0; k < sizeof path_um / sizeof path_um[0]; k++) {
        move(path_um[k]);
        for (int step = -16; step <= 16; step++) {
            rdpi_f32_bank_t before = bank;
            rdpi_real_t x_um = path_um[k] + (rdpi_real_t)step / 8, rate = (rdpi_real_t)(step & 1);
            rdpi_real_t v_um = rdpi_f32_bank_at(&bank, halving, COUNT, rate, x_um);
            rdpi_real_t way_um = rdpi_f32_bank_way(&bank, rate, rdpi_f32_bank_climb(&bank, rate, v_um));
            rdpi_real_t near_um = way_um + bank.y_um[0];
            if (!happens(x_um)) {
                rdpi_real_t solved_um = solution(halving, COUNT, rate, v_um);
                found++;
                EQUAL_REAL(solved_um, near_um);
                rdpi_real_t states_um[COUNT];
                for (size_t i = 0; i < COUNT; i++) {
                    states_um[i] = rdpi_f32_play(near_um, halving[i].r_um, rdpi_f32_bank_state(&bank, halving, i));
                }
                bank.y_um[0] = near_um;
                equal_states(states_um[0], states_um[1], states_um[2], states_um[3]);
                bank = before;
            } else {
                TEST_ASSERT_TRUE(step != 0);
            }
        }
    }
    TEST_ASSERT_TRUE(found > 50);
}

/* ---- solving, then moving ---- */

void test_after_solving_the_bank_can_move_anywhere(void)
{
    const rdpi_real_t asked_um[] = {9, -9, 1, -1};
    for (int from = -5; from <= 5; from++) {
        for (int to = -6; to <= 6; to++) {
            for (size_t k = 0; k < 4; k++) {
                setUp();
                move(5);
                move((rdpi_real_t)from);
                rdpi_f32_target_t target = solve(&bank, halving, COUNT, 0, output() + asked_um[k]);
                target.x_um = (rdpi_real_t)to;
                rdpi_f32_bank_move(&bank, halving, COUNT, target);
                for (size_t i = 0; i < COUNT; i++) {
                    plain_um[i] = rdpi_f32_play((rdpi_real_t)to, halving[i].r_um, plain_um[i]);
                }
                equal_states(plain_um[0], plain_um[1], plain_um[2], plain_um[3]);
                EQUAL_REAL(rdpi_f32_bank_at(&bank, halving, COUNT, 0, bank.y_um[0]),
                           rdpi_f32_slope(&halving[bank.engaged], 0) * bank.y_um[0] + bank.remainder_um);
            }
        }
    }
}

void test_the_solution_put_into_the_bank_gives_what_was_asked_through_reversals_and_changing_slopes(void)
{
    uint32_t seed = 1;
    rdpi_f32_bank_set(&bank, softening, COUNT, plain_um);
    for (int k = 0; k < 2000; k++) {
        seed = seed * 1664525u + 1013904223u;
        rdpi_real_t v_um = (rdpi_real_t)(seed >> 16) / 4096 - 8, rate = k % 3 == 0;
        rdpi_f32_target_t target = solve(&bank, softening, COUNT, rate, v_um);
        rdpi_f32_bank_move(&bank, softening, COUNT, target);
        TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)v_um,
                                 (float)rdpi_f32_bank_at(&bank, softening, COUNT, rate, bank.y_um[0]));
    }
}
