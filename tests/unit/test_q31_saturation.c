#include "unity.h"

#include "q31_saturation.h"
#include "random_bits.h"

#define COUNT 3
#define SHIFT 20
#define ONE ((int32_t)1 << SHIFT)

/* Slopes of the pieces: 1 up to v = 200, 0.5 up to v = 400, 2 beyond; S bends at z = 200 and 300. */
static const rdpi_q31_deadzone_t stage[COUNT] = {{0, ONE}, {200, -ONE / 2}, {400, ONE / 2 * 3}};
static const rdpi_q31_deadzone_t inverse_stage[COUNT] = {{0, ONE}, {200, ONE}, {300, -ONE / 2 * 3}};

static int32_t saturation(int32_t v)
{
    return rdpi_q31_saturation(stage, COUNT, SHIFT, INT32_MAX, v);
}

static int32_t inverse(int32_t z)
{
    return rdpi_q31_saturation(inverse_stage, COUNT, SHIFT, INT32_MAX, z);
}

void setUp(void)
{
    random_state = 4;
}

void tearDown(void)
{
}

/* ---- one dead zone ---- */

void test_a_dead_zone_is_zero_up_to_its_threshold(void)
{
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_deadzone(-7, 2));
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_deadzone(1, 2));
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_deadzone(2, 2));
}

void test_a_dead_zone_passes_what_exceeds_its_threshold(void)
{
    TEST_ASSERT_EQUAL_INT32(1, rdpi_q31_deadzone(3, 2));
}

void test_a_dead_zone_cannot_overflow(void)
{
    TEST_ASSERT_EQUAL_INT32(INT32_MAX - 1, rdpi_q31_deadzone(INT32_MAX, 1));
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_deadzone(INT32_MAX, INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_deadzone(INT32_MIN, 1));
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_deadzone(INT32_MIN, INT32_MAX));
}

/* ---- the stage ---- */

void test_saturation_is_proportional_below_the_first_threshold(void)
{
    TEST_ASSERT_EQUAL_INT32(-1000, saturation(-1000));
    TEST_ASSERT_EQUAL_INT32(0, saturation(0));
    TEST_ASSERT_EQUAL_INT32(150, saturation(150));
}

void test_saturation_bends_at_each_threshold(void)
{
    TEST_ASSERT_EQUAL_INT32(200, saturation(200));
    TEST_ASSERT_EQUAL_INT32(250, saturation(300));
    TEST_ASSERT_EQUAL_INT32(300, saturation(400));
    TEST_ASSERT_EQUAL_INT32(700, saturation(600));
}

void test_inverse_on_every_piece_and_at_each_corner(void)
{
    TEST_ASSERT_EQUAL_INT32(-1000, inverse(-1000));
    TEST_ASSERT_EQUAL_INT32(150, inverse(150));
    TEST_ASSERT_EQUAL_INT32(200, inverse(200));
    TEST_ASSERT_EQUAL_INT32(300, inverse(250));
    TEST_ASSERT_EQUAL_INT32(400, inverse(300));
    TEST_ASSERT_EQUAL_INT32(600, inverse(700));
}

void test_inverse_undoes_saturation_to_a_unit(void)
{
    for (int32_t v = -500; v < 1000; v++) {
        TEST_ASSERT_INT32_WITHIN(1, v, inverse(saturation(v)));
    }
}

void test_saturation_of_one_piece_is_a_gain(void)
{
    const rdpi_q31_deadzone_t gain = {0, -ONE / 2};
    TEST_ASSERT_EQUAL_INT32(-150, rdpi_q31_saturation(&gain, 1, SHIFT, INT32_MAX, 300));
}

void test_the_sum_is_rounded_down_once(void)
{
    const rdpi_q31_deadzone_t thirds[] = {{0, 3}, {5, 2}};
    TEST_ASSERT_EQUAL_INT32(2, rdpi_q31_saturation(thirds, 2, 3, INT32_MAX, 6)); /* 20 / 8 */
    TEST_ASSERT_EQUAL_INT32(-1, rdpi_q31_saturation(thirds, 2, 3, INT32_MAX, -1));
    TEST_ASSERT_EQUAL_INT32(-3, rdpi_q31_saturation(thirds, 2, 3, INT32_MAX, -7)); /* -21 / 8 */
}

void test_a_shift_of_zero_leaves_the_sum_as_it_is(void)
{
    const rdpi_q31_deadzone_t terms[] = {{0, 3}, {5, 2}};
    TEST_ASSERT_EQUAL_INT32(20, rdpi_q31_saturation(terms, 2, 0, INT32_MAX, 6));
}

void test_the_sum_saturates_at_either_limit(void)
{
    const rdpi_q31_deadzone_t gain = {0, INT32_MAX};
    const int32_t limits[] = {1, RDPI_Q31_ONE, INT32_MAX};
    for (size_t k = 0; k < 3; k++) {
        TEST_ASSERT_EQUAL_INT32(limits[k], rdpi_q31_saturation(&gain, 1, 0, limits[k], INT32_MAX));
        TEST_ASSERT_EQUAL_INT32(-limits[k], rdpi_q31_saturation(&gain, 1, 0, limits[k], -INT32_MAX));
        TEST_ASSERT_EQUAL_INT32(-limits[k], rdpi_q31_saturation(&gain, 1, 0, limits[k], INT32_MIN));
    }
}

void test_the_limits_themselves_and_their_neighbours_pass(void)
{
    const rdpi_q31_deadzone_t gain = {0, 1};
    TEST_ASSERT_EQUAL_INT32(99, rdpi_q31_saturation(&gain, 1, 0, 100, 99));
    TEST_ASSERT_EQUAL_INT32(100, rdpi_q31_saturation(&gain, 1, 0, 100, 100));
    TEST_ASSERT_EQUAL_INT32(100, rdpi_q31_saturation(&gain, 1, 0, 100, 101));
    TEST_ASSERT_EQUAL_INT32(-99, rdpi_q31_saturation(&gain, 1, 0, 100, -99));
    TEST_ASSERT_EQUAL_INT32(-100, rdpi_q31_saturation(&gain, 1, 0, 100, -100));
    TEST_ASSERT_EQUAL_INT32(-100, rdpi_q31_saturation(&gain, 1, 0, 100, -101));
    TEST_ASSERT_EQUAL_INT32(-INT32_MAX, rdpi_q31_saturation(&gain, 1, 0, INT32_MAX, INT32_MIN));
}

/* Of 2^62, which does not overflow, a 2^31st is all but INT32_MAX. */
void test_weights_that_add_up_to_2_to_the_31_do_not_overflow(void)
{
    const rdpi_q31_deadzone_t both[] = {{0, 1 << 30}, {1, 1 << 30}};
    const rdpi_q31_deadzone_t against[] = {{0, 1 << 30}, {1, -(1 << 30)}};
    TEST_ASSERT_EQUAL_INT32(INT32_MAX - 1, rdpi_q31_saturation(both, 2, 31, INT32_MAX, INT32_MAX)); /* - 3 / 2 */
    TEST_ASSERT_EQUAL_INT32(-(1 << 30), rdpi_q31_saturation(both, 2, 31, INT32_MAX, INT32_MIN));
    TEST_ASSERT_EQUAL_INT32(1 << 30, rdpi_q31_saturation(against, 2, 0, INT32_MAX, INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_saturation(both, 2, 62, INT32_MAX, INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(-1, rdpi_q31_saturation(both, 2, 62, INT32_MAX, INT32_MIN));
}

/* The definition with every product by itself in 64 bits, cut only where they are summed. */
void test_any_stage_of_legal_weights_is_exact_for_any_input(void)
{
    for (int k = 0; k < 20000; k++) {
        rdpi_q31_deadzone_t term[RDPI_MAX_DEADZONES];
        int64_t left = (int64_t)1 << 31, sum = 0;
        unsigned shift = (unsigned)random_between(0, 62);
        int32_t v = random_between(INT32_MIN, INT32_MAX), limit = random_between(0, INT32_MAX);
        for (int j = 0; j < RDPI_MAX_DEADZONES; j++) {
            int32_t size = random_between(0, left > INT32_MAX ? INT32_MAX : (int32_t)left);
            left -= size;
            term[j].d = j == 0 ? 0 : term[j - 1].d + random_between(1, INT32_MAX / RDPI_MAX_DEADZONES);
            term[j].weight = random_bits() % 2u ? size : -size;
            if (j == 0 || v > term[j].d) {
                sum += term[j].weight * ((int64_t)v - term[j].d);
            }
        }
        int64_t exact = sum >> shift;
        exact = exact > limit ? limit : (exact < -limit ? -limit : exact);
        TEST_ASSERT_EQUAL_INT32((int32_t)exact, rdpi_q31_saturation(term, RDPI_MAX_DEADZONES, shift, limit, v));
    }
}

/* ---- one piece of it ---- */

/* The stages above with numbers that fit. */
#define FINE 30
static const rdpi_q31_deadzone_t fine[COUNT] = {
    {0, RDPI_Q31_ONE}, {200, -RDPI_Q31_ONE / 2}, {400, RDPI_Q31_ONE / 4 * 5}};

static rdpi_q31_piece_t piece;

static void found(int32_t v, int32_t begin, int32_t end)
{
    TEST_ASSERT_TRUE(rdpi_q31_piece_find(&piece, fine, COUNT, FINE, v));
    TEST_ASSERT_TRUE(rdpi_q31_piece_holds(&piece, begin));
    TEST_ASSERT_TRUE(rdpi_q31_piece_holds(&piece, end - 1));
    TEST_ASSERT_FALSE(rdpi_q31_piece_holds(&piece, end));
    TEST_ASSERT_FALSE(rdpi_q31_piece_holds(&piece, begin - 1));
    int32_t last = end < 900 ? end : 900; /* the end of one is the beginning of the next */
    for (int32_t at = begin > -500 ? begin : -500; at <= last; at++) {
        TEST_ASSERT_EQUAL_INT32(rdpi_q31_saturation(fine, COUNT, FINE, INT32_MAX, at),
                                (int32_t)(rdpi_q31_piece_at(&piece, at) >> 30));
    }
}

void test_a_piece_lasts_from_threshold_to_threshold(void)
{
    found(-77, -INT32_MAX, 200);
    found(0, -INT32_MAX, 200);
    found(199, -INT32_MAX, 200);
    found(200, 200, 400);
    found(399, 200, 400);
    found(400, 400, INT32_MAX);
    found(INT32_MAX, 400, INT32_MAX);
}

void test_no_reference_lies_on_no_piece(void)
{
    found(-INT32_MAX, -INT32_MAX, 200);
    TEST_ASSERT_FALSE(rdpi_q31_piece_holds(&piece, RDPI_Q31_NO_REFERENCE));
}

void test_a_stage_of_one_piece_has_no_other(void)
{
    const rdpi_q31_deadzone_t gain = {0, RDPI_Q31_ONE / 2};
    TEST_ASSERT_TRUE(rdpi_q31_piece_find(&piece, &gain, 1, FINE, 12345));
    TEST_ASSERT_TRUE(rdpi_q31_piece_holds(&piece, -INT32_MAX) && rdpi_q31_piece_holds(&piece, INT32_MAX - 1));
    TEST_ASSERT_EQUAL_INT64((int64_t)1000 * RDPI_Q31_ONE, rdpi_q31_piece_at(&piece, 2000));
}

void test_pieces_of_slopes_from_2_or_other_shifts_do_not_fit(void)
{
    const rdpi_q31_deadzone_t steep[] = {{0, 1 << 30}, {5, 1 << 30}, {9, -1}};
    TEST_ASSERT_TRUE(rdpi_q31_piece_find(&piece, steep, 3, 30, 4));
    TEST_ASSERT_FALSE(rdpi_q31_piece_find(&piece, steep, 3, 30, 5));
    TEST_ASSERT_FALSE(rdpi_q31_piece_holds(&piece, 5));
    TEST_ASSERT_TRUE(rdpi_q31_piece_find(&piece, steep, 3, 30, 9));
    TEST_ASSERT_TRUE(rdpi_q31_piece_find(&piece, steep, 3, 31, 5));
    TEST_ASSERT_FALSE(rdpi_q31_piece_find(&piece, steep, 3, 29, 4));
    TEST_ASSERT_FALSE(rdpi_q31_piece_find(&piece, steep, 3, 0, 4));
    TEST_ASSERT_TRUE(rdpi_q31_piece_find(&piece, steep, 3, 61, 4));
    TEST_ASSERT_FALSE(rdpi_q31_piece_find(&piece, steep, 3, 62, 4));
    TEST_ASSERT_FALSE(rdpi_q31_piece_holds(&piece, 4));
}

/* As far off as its slope and its offset are rounded. */
void test_any_piece_is_as_accurate_as_it_says(void)
{
    for (int k = 0; k < 20000; k++) {
        rdpi_q31_deadzone_t term[RDPI_MAX_DEADZONES];
        int64_t slope = 0, sum = 0;
        unsigned shift = (unsigned)random_between(30, 61);
        int32_t v = random_between(-INT32_MAX, INT32_MAX);
        for (int j = 0; j < RDPI_MAX_DEADZONES; j++) {
            term[j].d = j == 0 ? 0 : term[j - 1].d + random_between(1, INT32_MAX / RDPI_MAX_DEADZONES);
            term[j].weight = random_between(j == 0 ? 1 : (int32_t)(1 - slope), 1 << 27);
            slope += term[j].weight;
            if (j == 0 || v > term[j].d) {
                sum += term[j].weight * ((int64_t)v - term[j].d);
            }
        }
        TEST_ASSERT_TRUE(rdpi_q31_piece_find(&piece, term, RDPI_MAX_DEADZONES, shift, v));
        TEST_ASSERT_TRUE(v == INT32_MAX || rdpi_q31_piece_holds(&piece, v));
        int64_t off = (sum >> (shift - 30u)) - rdpi_q31_piece_at(&piece, v), size = v < 0 ? -(int64_t)v : v;
        TEST_ASSERT_TRUE(off <= size + 1 && off >= -size - 1);
    }
}
