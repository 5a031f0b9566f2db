#include "unity.h"

#include <string.h>

#include "q31_bank.h"
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
static rdpi_q31_params_t params; /* of what is tested: plays and range */
static rdpi_q31_bank_t bank;
static int32_t plain[RDPI_MAX_PLAYS]; /* the same plays, each for itself (eq. 1) */
static bool beyond;                   /* whether the latest solution was beyond the range */

static void use(const rdpi_q31_play_t *play, size_t count)
{
    params.play = play;
    params.plays = (uint16_t)count;
}

static void set(const int32_t *y)
{
    rdpi_q31_bank_set(&bank, &params, y);
    memcpy(plain, y, params.plays * sizeof *y);
}

/* From where a solution was looked for, or nothing has happened since. */
static void move_from(int32_t from, int32_t x)
{
    if (!rdpi_q31_bank_try_slide(&bank, x)) {
        rdpi_q31_bank_move(&bank, &params, from, x);
    }
    for (size_t i = 0; i < params.plays; i++) {
        plain[i] = rdpi_q31_play(x, params.play[i].r, plain[i]);
    }
}

static void move(int32_t x)
{
    move_from(bank.y[0], x);
}

static int32_t solve(int32_t rate, int32_t v)
{
    beyond = false;
    return rdpi_q31_bank_solve(&bank, &params, rate, (int64_t)v * ONE, &beyond);
}

/* On a copy: nothing moves. */
static int32_t solution(int32_t rate, int32_t v)
{
    rdpi_q31_bank_t before = bank;
    int32_t x = solve(rate, v);
    bank = before;
    return x;
}

/* With other plays, where these stand. */
static int32_t solution_of(const rdpi_q31_play_t *play, int32_t rate, int32_t v)
{
    int32_t y[COUNT];
    rdpi_q31_params_t before = params;
    rdpi_q31_bank_t bank_before = bank;
    for (size_t i = 0; i < COUNT; i++) {
        y[i] = rdpi_q31_bank_state(&bank, &params, i);
    }
    use(play, COUNT);
    rdpi_q31_bank_set(&bank, &params, y);
    int32_t x = solution(rate, v);
    params = before;
    bank = bank_before;
    return x;
}

static void solves(int32_t x, int32_t v)
{
    NEAR(x, solution(0, v));
    TEST_ASSERT_FALSE(beyond);
}

static int32_t output(void)
{
    return rdpi_q31_bank_at(&bank, &params, 0, bank.y[0]);
}

static void equal_states(int32_t y0, int32_t y1, int32_t y2, int32_t y3)
{
    TEST_ASSERT_EQUAL_INT32(y0, rdpi_q31_bank_state(&bank, &params, 0));
    TEST_ASSERT_EQUAL_INT32(y1, rdpi_q31_bank_state(&bank, &params, 1));
    TEST_ASSERT_EQUAL_INT32(y2, rdpi_q31_bank_state(&bank, &params, 2));
    TEST_ASSERT_EQUAL_INT32(y3, rdpi_q31_bank_state(&bank, &params, 3));
}

static void equal_states_U(int32_t y0, int32_t y1, int32_t y2, int32_t y3)
{
    equal_states(y0 * U, y1 * U, y2 * U, y3 * U);
}

void setUp(void)
{
    const int32_t rest[COUNT] = {0, 0, 0, 0};
    random_state = 5;
    memset(&bank, 0, sizeof bank);
    params = (rdpi_q31_params_t){.min_x = -MAX, .max_x = MAX};
    use(halving, COUNT);
    set(rest);
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
    use(halving, 2);
    bank.y[2] = 77;
    rdpi_q31_bank_move(&bank, &params, 0, 5 * U);
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

void test_turning_round_moves_no_play(void)
{
    move(5 * U);
    rdpi_q31_bank_turn(&bank, &params);
    TEST_ASSERT_TRUE(bank.falling);
    TEST_ASSERT_EQUAL_UINT(0, bank.engaged);
    equal_states_U(5, 4, 3, 1);
    rdpi_q31_bank_turn(&bank, &params);
    TEST_ASSERT_FALSE(bank.falling);
    equal_states_U(5, 4, 3, 1);
}

void test_states_taken_on_are_those_given(void)
{
    const int32_t y[COUNT] = {5 * U, 4 * U, 3 * U, U};
    move(-3 * U);
    set(y);
    equal_states_U(5, 4, 3, 1);
    solves(4 * U, 9 * V);
    solves(6 * U, 27 * V / 2);
}

/* ---- the output ---- */

/* w = (0.5, 0.5, 1, 2) V per U */
void test_the_sum_weighs_each_play_by_the_difference_of_slopes(void)
{
    const int32_t y[COUNT] = {5 * U, 11 * U / 2, 5 * U, 6 * U};
    set(y);
    TEST_ASSERT_EQUAL_INT32(5 * V / 2 + 11 * V / 4 + 5 * V + 12 * V, output());
    TEST_ASSERT_EQUAL_INT32(5 * V / 4 + 11 * V / 8 + 5 * V / 2 + 6 * V,
                            rdpi_q31_bank_at(&bank, &params, ONE, 5 * U));
}

void test_the_sum_of_one_play_is_slope_times_state_rounded_down(void)
{
    use(halving, 1);
    TEST_ASSERT_EQUAL_INT32(-3 * V, rdpi_q31_bank_at(&bank, &params, 0, -6 * U));
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_bank_at(&bank, &params, 0, 7));
    TEST_ASSERT_EQUAL_INT32(-1, rdpi_q31_bank_at(&bank, &params, 0, -1));
    const rdpi_q31_play_t nearly_one = {0, ONE - 1, 0};
    use(&nearly_one, 1);
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_bank_at(&bank, &params, 0, 1));
}

/* Eq. 15: on the first rise the output climbs along the loading curve. */
void test_first_rise_follows_the_loading_curve(void)
{
    const int32_t corners[] = {0, U, 2 * U, 4 * U, 5 * U}, curve[] = {0, V / 2, 3 * V / 2, 11 * V / 2, 19 * V / 2};
    for (size_t k = 0; k < 5; k++) {
        TEST_ASSERT_EQUAL_INT32(curve[k], rdpi_q31_bank_at(&bank, &params, 0, corners[k]));
        TEST_ASSERT_EQUAL_INT32(-curve[k], rdpi_q31_bank_at(&bank, &params, 0, -corners[k]));
    }
    equal_states_U(0, 0, 0, 0);
    for (size_t k = 0; k < 5; k++) {
        move(corners[k]);
        TEST_ASSERT_EQUAL_INT32(curve[k], output());
    }
}

/* What the solution starts from: 2^30 f = f_at_rest + rate / 2^30 f_rate. */
void test_both_parts_make_the_output_that_the_definition_gives(void)
{
    const int32_t path[] = {0, 2, 6, 10, 12, 10, 4, 8, -2, -12, -12, -10, 0, -1, 14};
    for (size_t k = 0; k < sizeof path / sizeof path[0]; k++) {
        move(path[k] * (U / 2));
        for (int64_t rate = 0; rate <= ONE; rate += ONE / 2) {
            int64_t sum = bank.f_at_rest + rate * (bank.f_rate / ONE);
            int32_t v = rdpi_q31_bank_at(&bank, &params, (int32_t)rate, bank.y[0]);
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
    NEAR(5 * U, solution(ONE, 19 * V / 4));
    NEAR(59 * U / 8, solution(ONE, 19 * V / 2));
    NEAR(3 * U, solution(ONE, 17 * V / 4));
}

void test_slopes_that_fall_along_the_loading_curve(void)
{
    NEAR(U / 2, solution_of(softening, ONE, 2 * V));
    NEAR(3 * U, solution_of(softening, ONE, 7 * V));
    NEAR(-6 * U, solution_of(softening, ONE, -9 * V));
}

void test_one_play_is_a_division(void)
{
    const int32_t y[] = {3 * U};
    use(halving, 1);
    set(y);
    solves(8 * U, 4 * V);
    solves(-8 * U, -4 * V);
}

void test_solving_takes_x_to_the_last_corner_before_the_solution(void)
{
    NEAR(3 * U, solve(0, 7 * V / 2));
    TEST_ASSERT_FALSE(bank.falling);
    TEST_ASSERT_EQUAL_UINT(2, bank.engaged);
    equal_states_U(2, 1, 0, 0);
    setUp();
    move(5 * U);
    NEAR(4 * U, solve(0, 9 * V)); /* down, with the first play alone */
    TEST_ASSERT_TRUE(bank.falling);
    TEST_ASSERT_EQUAL_UINT(0, bank.engaged);
    equal_states_U(5, 4, 3, 1);
    NEAR(2 * U, solve(0, 15 * V / 2));
    TEST_ASSERT_EQUAL_UINT(1, bank.engaged);
    equal_states_U(3, 4, 3, 1);
}

void test_room_is_the_way_to_where_the_next_play_engages(void)
{
    TEST_ASSERT_EQUAL_INT32(U, bank.room);
    move(U / 4);
    TEST_ASSERT_EQUAL_INT32(U / 4 * 3, bank.room);
    move(3 * U);
    TEST_ASSERT_EQUAL_INT32(U, bank.room);
    move(2 * U); /* the first engages at U */
    TEST_ASSERT_EQUAL_INT32(U, bank.room);
    move(-U);
    TEST_ASSERT_EQUAL_INT32(0, bank.room); /* the second */
    move(5 * U);
    TEST_ASSERT_EQUAL_INT32(MAX - 5 * U, bank.room);
}

void test_room_ends_with_the_range_if_no_play_engages_before(void)
{
    params.max_x = 3 * U / 2;
    params.min_x = -U / 2;
    move(U / 4 * 5);
    TEST_ASSERT_EQUAL_INT32(U / 4, bank.room);
    move(U);
    TEST_ASSERT_EQUAL_INT32(3 * U / 4 + 3 * U / 4, bank.room);
    move(2 * U); /* someone else's drive */
    TEST_ASSERT_EQUAL_INT32(0, bank.room);
    move(-2 * U);
    TEST_ASSERT_EQUAL_INT32(0, bank.room);
}

/* At 5, then 2: rising, plays engage at 2, 4, and two of them at 5. */
void test_a_solution_beyond_the_range_is_its_end(void)
{
    params.max_x = 9 * U / 2;
    params.min_x = -U;
    move(5 * U);
    move(2 * U);
    TEST_ASSERT_EQUAL_INT32(9 * U / 2, solve(0, 10 * V));
    TEST_ASSERT_TRUE(beyond);
    TEST_ASSERT_EQUAL_UINT(1, bank.engaged);
    move_from(2 * U, 9 * U / 2);
    equal_states(9 * U / 2, 7 * U / 2, 3 * U, U);
    NEAR(7 * U / 2, solve(0, 17 * V / 2));
    TEST_ASSERT_FALSE(beyond);
    TEST_ASSERT_EQUAL_INT32(-U, solve(0, -9 * V));
    TEST_ASSERT_TRUE(beyond);
}

/* All of them engage at once, and there is none left. */
void test_beyond_the_last_corner_the_range_ends_the_room(void)
{
    params.max_x = 6 * U;
    TEST_ASSERT_EQUAL_INT32(6 * U, solve(0, 14 * V));
    TEST_ASSERT_TRUE(beyond);
    TEST_ASSERT_EQUAL_UINT(3, bank.engaged);
    TEST_ASSERT_EQUAL_INT32(2 * U, bank.room);
    solves(11 * U / 2, 23 * V / 2);
}

/* ---- scaling and overflow ---- */

void test_solution_saturates_at_the_ends_of_the_format(void)
{
    const rdpi_q31_play_t flattest[] = {{0, RDPI_Q31_MIN_SLOPE, 0}};
    const int32_t ends[] = {-MAX, 0, MAX};
    use(flattest, 1);
    for (size_t k = 0; k < 3; k++) {
        set(&ends[k]);
        TEST_ASSERT_EQUAL_INT32(MAX, solution(0, ONE));
        TEST_ASSERT_TRUE(beyond);
        TEST_ASSERT_EQUAL_INT32(-MAX, solution(0, -ONE));
        TEST_ASSERT_TRUE(beyond);
        NEAR(MAX - 64, solution(0, (1 << 23) - 1)); /* from one end of the format to the other */
        NEAR(64 - MAX, solution(0, 1 - (1 << 23)));
    }
}

/* Thresholds and drives of the whole format, slopes from the smallest to the largest and back: |f| is at its most
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
        use(play, RDPI_MAX_PLAYS);
        set(y);
        for (size_t k = 0; k < sizeof path / sizeof path[0]; k++) {
            for (int32_t rate = 0; rate <= ONE / 2; rate += ONE / 2) {
                int32_t v = rdpi_q31_bank_at(&bank, &params, 2 * rate, bank.y[0]);
                TEST_ASSERT_INT32_WITHIN(RDPI_Q31_ONE, 0, v);
                TEST_ASSERT_INT32_WITHIN(512, bank.y[0], solution(2 * rate, v));
                solution(2 * rate, ONE); /* the sanitizers listen */
                solution(2 * rate, -ONE);
            }
            TEST_ASSERT_TRUE(bank.f_at_rest <= (int64_t)1 << 60 && bank.f_at_rest >= -((int64_t)1 << 60));
            TEST_ASSERT_TRUE(bank.f_rate <= (int64_t)1 << 60 && bank.f_rate >= -((int64_t)1 << 60));
            move(path[k]);
            for (size_t i = 0; i < RDPI_MAX_PLAYS; i++) {
                TEST_ASSERT_EQUAL_INT32(plain[i], rdpi_q31_bank_state(&bank, &params, i));
            }
        }
    }
}

/* ---- any actuator ---- */

static rdpi_q31_play_t any_play[RDPI_MAX_PLAYS];

static int32_t random_slope(void)
{
    int32_t steepest = ONE >> random_between(0, 5);
    return random_between(RDPI_Q31_MIN_SLOPE, steepest);
}

/* Slopes of the whole format, thresholds up to the largest, from rest. */
static void any_bank(int32_t fewest)
{
    const int32_t rest[RDPI_MAX_PLAYS] = {0};
    int32_t count = random_between(fewest, RDPI_MAX_PLAYS);
    for (int32_t i = 0; i < count; i++) {
        any_play[i].r = i == 0 ? 0 : any_play[i - 1].r + random_between(1, MAX / count);
        any_play[i].slope = random_slope();
        any_play[i].slope_rate = random_slope() - any_play[i].slope;
    }
    use(any_play, (size_t)count);
    params.max_x = random_between(MAX / 2, MAX);
    params.min_x = random_between(-MAX, -MAX / 2);
    set(rest);
}

/* Every state where eq. 1 has it, and f what they sum up to, to the last bit; no more room than there is. */
static void exact_in_every_bit(void)
{
    int64_t f_at_rest = (int64_t)any_play[0].slope * plain[0], f_rate = (int64_t)any_play[0].slope_rate * plain[0];
    for (size_t i = 0; i < params.plays; i++) {
        TEST_ASSERT_EQUAL_INT32(plain[i], rdpi_q31_bank_state(&bank, &params, i));
    }
    for (size_t i = 1; i < params.plays; i++) {
        f_at_rest += (int64_t)(any_play[i].slope - any_play[i - 1].slope) * plain[i];
        f_rate += (int64_t)(any_play[i].slope_rate - any_play[i - 1].slope_rate) * plain[i];
    }
    TEST_ASSERT_EQUAL_INT64(f_at_rest, bank.f_at_rest);
    TEST_ASSERT_EQUAL_INT64(f_rate, bank.f_rate);
    TEST_ASSERT_EQUAL_PTR(&any_play[bank.engaged], bank.last_engaged);
    int32_t room = bank.falling ? plain[0] - params.min_x : params.max_x - plain[0];
    if (bank.engaged + 1u < params.plays) {
        int32_t y = plain[bank.engaged + 1], r = any_play[bank.engaged + 1].r;
        int32_t way = bank.falling ? plain[0] - (y - r) : y + r - plain[0];
        room = way < room ? way : room;
    }
    TEST_ASSERT_EQUAL_INT32(room > 0 ? room : 0, bank.room);
}

/* Far and near, so that long and short minor loops come about. */
static int32_t any_x(void)
{
    int32_t reach = MAX >> random_between(0, 20), x = plain[0] + random_between(-reach, reach);
    return rdpi_q31_clamp(x, -MAX, MAX);
}

static int32_t any_x_in_range(void)
{
    return rdpi_q31_clamp(any_x(), params.min_x, params.max_x);
}

void test_states_and_sums_stay_exact_through_any_moves(void)
{
    for (int number = 0; number < 50; number++) {
        any_bank(1);
        for (int k = 0; k < 500; k++) {
            move(any_x());
            exact_in_every_bit();
        }
    }
}

/* Solving and moving elsewhere than solved for, as clipped drives do, or near to it, as codes do. */
void test_nothing_drifts_in_a_hundred_thousand_moves(void)
{
    any_bank(RDPI_MAX_PLAYS);
    for (int k = 0; k < 100000; k++) {
        int32_t rate = random_between(0, ONE), v = random_size(ONE, 20), from = bank.y[0], x = solve(rate, v);
        switch (random_bits() % 4u) {
        case 0:
            x = any_x_in_range();
            break;
        case 1:
            x = rdpi_q31_clamp(x + random_size(MAX / 2, 20), params.min_x, params.max_x);
            break;
        default:
            break;
        }
        move_from(from, x);
        if (k % 100 == 0) {
            exact_in_every_bit();
        }
    }
    exact_in_every_bit();
}

/* Or where a play engages. */
static int32_t any_x_or_corner(void)
{
    int32_t i = random_between(0, params.plays - 1), side = random_bits() % 2u ? 1 : -1;
    int32_t x = random_bits() % 2u ? any_x() : plain[i] + side * any_play[i].r;
    return rdpi_q31_clamp(x, params.min_x, params.max_x);
}

/* Any v that an x within the range has: a few units of v, whatever the slopes. */
void test_the_solution_put_into_any_bank_gives_what_was_asked(void)
{
    for (int number = 0; number < 100; number++) {
        any_bank(1);
        for (int k = 0; k < 500; k++) {
            int32_t rate = random_bits() % 4u ? random_between(0, ONE) : (int32_t)(random_bits() % 2u) * ONE;
            int32_t v = rdpi_q31_bank_at(&bank, &params, rate, any_x_or_corner());
            int32_t from = bank.y[0], x = solve(rate, v);
            TEST_ASSERT_TRUE(x >= params.min_x && x <= params.max_x);
            TEST_ASSERT_TRUE(!beyond || x == params.min_x || x == params.max_x);
            move_from(from, x);
            TEST_ASSERT_INT32_WITHIN(8, v, rdpi_q31_bank_at(&bank, &params, rate, bank.y[0]));
            exact_in_every_bit();
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
                solve(0, output() + asked[k]);
                move_from(from * U, to * U);
                equal_states(plain[0], plain[1], plain[2], plain[3]);
                TEST_ASSERT_EQUAL_INT64((int64_t)output() * ONE, bank.f_at_rest);
            }
        }
    }
}

/* As a code does: the solution is a little past the corner, and what is output not. */
void test_back_over_corners_that_the_solution_has_passed(void)
{
    solve(0, 12 * V);
    TEST_ASSERT_EQUAL_UINT(3, bank.engaged);
    move_from(0, 4 * U - 1);
    TEST_ASSERT_EQUAL_UINT(2, bank.engaged);
    TEST_ASSERT_EQUAL_INT32(1, bank.room);
    equal_states(4 * U - 1, 3 * U - 1, 2 * U - 1, 0);
    setUp();
    solve(0, 12 * V);
    move_from(0, U / 2);
    TEST_ASSERT_EQUAL_UINT(0, bank.engaged);
    TEST_ASSERT_EQUAL_INT32(U / 2, bank.room);
    equal_states(U / 2, 0, 0, 0);
    setUp();
    move(3 * U / 2);
    solve(0, 12 * V);
    move_from(3 * U / 2, 3 * U / 2);
    TEST_ASSERT_FALSE(bank.falling);
    equal_states(3 * U / 2, U / 2, 0, 0);
    solve(0, 12 * V);
    move_from(3 * U / 2, 5 * U / 4); /* even behind where it was */
    TEST_ASSERT_TRUE(bank.falling);
    equal_states(5 * U / 4, U / 2, 0, 0);
}
