#include "unity.h"

#include <math.h>
#include <string.h>

#include "q31_rate.h"
#include "random_bits.h"

#define T_NS ((uint32_t)1 << 20)
#define GUARD ((int32_t)1 << 18) /* distance per sample at the guard */
#define ONE RDPI_Q31_ONE
#define BEYOND INT32_MAX

static rdpi_q31_params_t params;
static rdpi_q31_rate_t rate;

void setUp(void)
{
    random_state = 6;
    memset(&rate, 0, sizeof rate);
    params = (rdpi_q31_params_t){.guard_mantissa = (uint32_t)1 << 31, .guard_exponent = -33}; /* 2^(31 - 33 + 20) */
}

void tearDown(void)
{
}

static void gives(rdpi_status_t status, uint32_t sample_time_ns)
{
    TEST_ASSERT_EQUAL_INT(status, rdpi_q31_rate_init(&rate, &params, sample_time_ns));
}

/* In samples; the guard is the same distance per sample. */
static void init(uint32_t window, uint32_t filter)
{
    params.rate_window_ns = window * T_NS;
    params.rate_filter_ns = filter * T_NS;
    gives(RDPI_OK, T_NS);
}

static int32_t sample(int32_t z)
{
    return rdpi_q31_rate_step(&rate, z, 0);
}

/* A guard of mantissa 2^exponent per window of one sample of 1 ns. */
static void guard(uint32_t mantissa, int exponent)
{
    params.guard_mantissa = mantissa;
    params.guard_exponent = (int16_t)exponent;
}

/* ---- init ---- */

void test_sample_time_zero_is_refused_and_the_shortest_and_longest_accepted(void)
{
    gives(RDPI_ERR_SAMPLE_TIME, 0);
    guard((uint32_t)1 << 31, -31);
    gives(RDPI_OK, 1);
    gives(RDPI_OK, UINT32_MAX);
}

void test_window_is_rounded_to_the_nearest_sample(void)
{
    params.rate_window_ns = 2 * T_NS + T_NS / 2 - 1;
    gives(RDPI_OK, T_NS);
    TEST_ASSERT_EQUAL_UINT(2, rate.window);
    params.rate_window_ns++;
    gives(RDPI_OK, T_NS);
    TEST_ASSERT_EQUAL_UINT(3, rate.window);
}

void test_window_shorter_than_a_sample_means_one_sample(void)
{
    const uint32_t windows_ns[] = {0, 1, T_NS / 2 - 1, T_NS, T_NS + T_NS / 2 - 1};
    for (size_t k = 0; k < 5; k++) {
        params.rate_window_ns = windows_ns[k];
        gives(RDPI_OK, T_NS);
        TEST_ASSERT_EQUAL_UINT(1, rate.window);
    }
}

void test_window_of_more_samples_than_there_is_room_for_is_refused(void)
{
    params.rate_window_ns = RDPI_MAX_WINDOW * T_NS + T_NS / 2 - 1;
    gives(RDPI_OK, T_NS);
    TEST_ASSERT_EQUAL_UINT(RDPI_MAX_WINDOW, rate.window);
    params.rate_window_ns++;
    gives(RDPI_ERR_WINDOW, T_NS);
    params.rate_window_ns = UINT32_MAX;
    gives(RDPI_ERR_WINDOW, T_NS);
    gives(RDPI_ERR_WINDOW, 1);
}

void test_window_of_4_29_seconds_is_refused_and_just_below_accepted(void)
{
    params.rate_window_ns = UINT32_MAX;
    gives(RDPI_ERR_WINDOW, (uint32_t)1 << 31); /* two samples: 2^32 ns */
    gives(RDPI_OK, ((uint32_t)1 << 31) - 1u);
    TEST_ASSERT_EQUAL_UINT(2, rate.window);
    gives(RDPI_OK, UINT32_MAX);
    TEST_ASSERT_EQUAL_UINT(1, rate.window);
}

void test_guard_of_one_unit_per_window_is_accepted_and_less_refused(void)
{
    guard((uint32_t)1 << 31, -31);
    gives(RDPI_OK, 1);
    guard(UINT32_MAX, -32);
    gives(RDPI_ERR_RATE, 1);
    gives(RDPI_OK, 2); /* twice the distance */
    guard((uint32_t)1 << 31, -33);
    gives(RDPI_ERR_RATE, 3);
    gives(RDPI_OK, 4);
    params.rate_window_ns = 4; /* of samples of 1 ns */
    gives(RDPI_OK, 1);
    params.rate_window_ns = 3;
    gives(RDPI_ERR_RATE, 1);
    guard((uint32_t)1 << 31, INT16_MIN);
    gives(RDPI_ERR_RATE, UINT32_MAX);
}

void test_guard_of_2_to_the_63_per_window_is_refused_and_less_accepted(void)
{
    guard((uint32_t)1 << 31, 32);
    gives(RDPI_ERR_RATE, 1);
    guard(UINT32_MAX, 31);
    gives(RDPI_OK, 1);
    gives(RDPI_ERR_RATE, 2);
    guard(UINT32_MAX, 0);
    gives(RDPI_ERR_RATE, UINT32_MAX); /* 2^64 - 2^33 + 1 */
    guard(UINT32_MAX, -1);
    gives(RDPI_OK, UINT32_MAX);
    guard((uint32_t)1 << 31, INT16_MAX);
    gives(RDPI_ERR_RATE, 1);
}

void test_guard_of_any_mantissa_is_kept_to_32_bits(void)
{
    for (int k = 0; k < 2000; k++) {
        uint32_t time_ns = random_length();
        uint32_t mantissa = random_bits() | (uint32_t)1 << 31;
        guard(mantissa, random_between(-31, -1));
        if (time_ns > 0u && rdpi_q31_rate_init(&rate, &params, time_ns) == RDPI_OK) {
            double distance = ldexp((double)params.guard_mantissa * time_ns, params.guard_exponent);
            double kept = ldexp(rate.guard, rate.guard_shift - 31);
            TEST_ASSERT_TRUE(rate.guard >= (uint32_t)1 << 31 && rate.guard_shift <= 62);
            TEST_ASSERT_TRUE(kept <= distance && kept > distance * (1 - ldexp(1, -30)));
        }
    }
}

/* ---- the rate ---- */

void test_first_sample_has_no_rate_wherever_it_is(void)
{
    const int32_t samples[] = {0, INT32_MAX, -INT32_MAX, 12345};
    for (size_t k = 0; k < 4; k++) {
        init(3, 2);
        TEST_ASSERT_EQUAL_INT32(0, sample(samples[k]));
    }
}

void test_window_of_one_sample_is_the_difference_of_neighbours(void)
{
    init(1, 0);
    sample(1000);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, sample(1000 + GUARD / 2));
    TEST_ASSERT_EQUAL_INT32(ONE / 4, sample(1000 + GUARD / 4 * 3));
    TEST_ASSERT_EQUAL_INT32(0, sample(1000 + GUARD / 4 * 3));
}

void test_a_falling_sample_has_a_positive_rate(void)
{
    init(1, 0);
    sample(0);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, sample(-GUARD / 2));
}

void test_the_guard_itself_is_one_and_a_unit_more_is_beyond(void)
{
    init(1, 0);
    sample(0);
    TEST_ASSERT_EQUAL_INT32(ONE, sample(GUARD));
    TEST_ASSERT_EQUAL_INT32(BEYOND, sample(-1));
    TEST_ASSERT_LESS_THAN_INT32(ONE, sample(GUARD - 2));
}

void test_guard_of_one_unit_tells_rest_guard_and_beyond(void)
{
    guard((uint32_t)1 << 31, -31);
    gives(RDPI_OK, 1);
    sample(7);
    TEST_ASSERT_EQUAL_INT32(0, sample(7));
    TEST_ASSERT_EQUAL_INT32(ONE, sample(8));
    TEST_ASSERT_EQUAL_INT32(ONE, sample(7));
    TEST_ASSERT_EQUAL_INT32(BEYOND, sample(9));
    TEST_ASSERT_EQUAL_INT32(BEYOND, sample(INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(BEYOND, sample(-INT32_MAX));
}

void test_the_largest_guard_makes_every_distance_small(void)
{
    guard(UINT32_MAX, 31);
    gives(RDPI_OK, 1);
    sample(-INT32_MAX);
    TEST_ASSERT_EQUAL_INT32(0, sample(INT32_MAX)); /* 2^32 of 2^63 */
}

void test_a_rate_is_never_above_the_true_one_and_two_units_below_at_most(void)
{
    for (int k = 0; k < 20000; k++) {
        uint32_t distance = random_length();
        uint32_t mantissa = random_bits() | (uint32_t)1 << 31;
        guard(mantissa, random_between(-31, 1));
        gives(RDPI_OK, 1);
        sample(-INT32_MAX);
        int32_t seen = sample((int32_t)(distance - (uint32_t)INT32_MAX));
        double exact = distance / ldexp(rate.guard, rate.guard_shift - 31) * ONE;
        if (exact > ONE) {
            TEST_ASSERT_TRUE(seen == BEYOND || seen >= ONE - 2);
        } else {
            TEST_ASSERT_TRUE(seen <= exact && seen > exact - 2);
        }
    }
}

void test_a_jump_across_the_whole_range_is_measured_exactly(void)
{
    guard((uint32_t)1 << 31, 2); /* 2^33 */
    gives(RDPI_OK, 1);
    sample(-INT32_MAX);
    TEST_ASSERT_EQUAL_INT32(ONE / 2 - 1, sample(INT32_MAX)); /* (2^32 - 2) / 2^33 of 2^30, rounded down */
    TEST_ASSERT_EQUAL_INT32(ONE / 2 - 1, sample(-INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(0, sample(-INT32_MAX));
}

void test_window_of_several_samples_spans_them_all(void)
{
    init(3, 0);
    for (int32_t k = 0; k < 8; k++) {
        int32_t seen = sample(k * (GUARD / 2)), full = k < 3 ? k : 3;
        TEST_ASSERT_INT32_WITHIN(2, ONE / 6 * full, seen); /* before it is full, the first sample stands in */
    }
    TEST_ASSERT_INT32_WITHIN(2, ONE / 3, sample(7 * (GUARD / 2)));
}

void test_the_longest_window_works(void)
{
    init(RDPI_MAX_WINDOW, 0);
    sample(0);
    for (int k = 0; k < RDPI_MAX_WINDOW; k++) { /* a step is seen for the time of the window */
        TEST_ASSERT_EQUAL_INT32(ONE / RDPI_MAX_WINDOW, sample(GUARD));
    }
    TEST_ASSERT_EQUAL_INT32(0, sample(GUARD));
}

void test_reset_forgets_samples_and_filter(void)
{
    init(3, 4);
    for (int k = 0; k < 20; k++) {
        sample(k * 1000);
    }
    rdpi_q31_rate_reset(&rate);
    rdpi_q31_rate_t after_reset = rate;
    TEST_ASSERT_EQUAL_INT64(0, after_reset.filtered);
    init(3, 4);
    for (int k = 0; k < 10; k++) {
        TEST_ASSERT_EQUAL_INT32(sample(500 + k * k * 100), rdpi_q31_rate_step(&after_reset, 500 + k * k * 100, 0));
    }
}

/* ---- the low-pass ---- */

void test_filter_is_a_first_order_low_pass_that_starts_at_zero(void)
{
    init(1, 4);
    sample(0);
    for (int k = 1; k < 40; k++) {
        TEST_ASSERT_INT32_WITHIN(8, (int32_t)(ONE / 2 * (1 - exp(-k / 4.0))), sample(k * (GUARD / 2)));
    }
}

void test_filter_reaches_63_percent_after_its_time_at_any_sample_rate(void)
{
    params.rate_filter_ns = 1000000;
    for (uint32_t samples = 1; samples <= 500000; samples = samples * 3 + 1) {
        guard((uint32_t)1 << 31, -25);
        gives(RDPI_OK, params.rate_filter_ns / samples);
        int32_t step = (int32_t)(rate.guard / 4 >> (31 - rate.guard_shift)), seen = sample(0);
        double time = samples * (double)(params.rate_filter_ns / samples) / params.rate_filter_ns;
        for (uint32_t k = 1; k <= samples; k++) {
            seen = sample((int32_t)(k % 2u) * step);
        }
        TEST_ASSERT_INT32_WITHIN(ONE / 1000, (int32_t)(ONE / 4 * (1 - exp(-time))), seen);
    }
}

void test_without_filter_a_large_rate_leaves_nothing_behind(void)
{
    init(1, 0);
    sample(0);
    sample(INT32_MAX);
    TEST_ASSERT_EQUAL_INT32(0, sample(INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(ONE / GUARD, sample(INT32_MAX - 1));
}

void test_the_low_pass_holds_jumps_far_beyond_the_guard_undistorted(void)
{
    init(1, 8);
    double filtered = 0, blend = -expm1(-1 / 8.0);
    int32_t z = -INT32_MAX;
    sample(z);
    for (int k = 0; k < 400; k++) {
        int32_t next = k % 7 < 3 ? -INT32_MAX : (k % 7 < 5 ? INT32_MAX : z); /* back and forth, and resting */
        next = k > 200 ? z : next;
        filtered += blend * (fabs((double)next - z) - filtered);
        z = next;
        int32_t seen = sample(z);
        TEST_ASSERT_TRUE(rate.filtered >= 0);
        TEST_ASSERT_TRUE(fabs(ldexp((double)rate.filtered, -31) - filtered) <= 8 * ldexp(filtered, -28) + 1e-6);
        if (filtered > GUARD * 1.0001) {
            TEST_ASSERT_EQUAL_INT32(BEYOND, seen);
        } else {
            TEST_ASSERT_INT32_WITHIN(64, (int32_t)(filtered / GUARD * ONE), seen);
        }
    }
    TEST_ASSERT_LESS_THAN_INT32(ONE, sample(z));
}

void test_the_low_pass_comes_to_rest_at_zero(void)
{
    init(1, 2);
    sample(0);
    sample(GUARD / 2);
    for (int k = 0; k < 200; k++) {
        sample(GUARD / 2);
    }
    TEST_ASSERT_EQUAL_INT64(0, rate.filtered);
}

void test_a_filter_far_shorter_than_a_sample_is_none(void)
{
    params.rate_filter_ns = T_NS / 64u;
    gives(RDPI_OK, T_NS);
    TEST_ASSERT_EQUAL_UINT32(0, rate.blend);
    params.rate_filter_ns = T_NS / 64u + 1u; /* exp(-64) is no more than 32 bits resolve, either */
    gives(RDPI_OK, T_NS);
    TEST_ASSERT_EQUAL_UINT32(0, rate.blend);
    params.rate_filter_ns = T_NS / 16u;
    gives(RDPI_OK, T_NS);
    TEST_ASSERT_NOT_EQUAL_UINT32(0, rate.blend);
}

/* ---- 1 - exp(-u) without libm ---- */

/* Within 2^-27 of itself; a mantissa of 0 stands for 1. */
static void blend_of(uint32_t time_ns, uint32_t filter_ns)
{
    rdpi_q31_rate_blend(&rate, time_ns, filter_ns);
    double exact = -expm1(-(double)time_ns / filter_ns);
    double seen = rate.blend == 0u ? 1 : ldexp(rate.blend, -32 - rate.blend_shift);
    TEST_ASSERT_LESS_OR_EQUAL_UINT(30, rate.blend_shift);
    TEST_ASSERT_DOUBLE_WITHIN(ldexp(1, -27), 0, seen / exact - 1);
}

void test_blend_at_typed_values(void)
{
    rdpi_q31_rate_blend(&rate, 1000, 10000);
    TEST_ASSERT_DOUBLE_WITHIN(5e-9, 0.0951625820, ldexp(rate.blend, -32 - rate.blend_shift));
    rdpi_q31_rate_blend(&rate, 1000, 1000);
    TEST_ASSERT_DOUBLE_WITHIN(5e-9, 0.6321205588, ldexp(rate.blend, -32 - rate.blend_shift));
    rdpi_q31_rate_blend(&rate, 2000, 1000);
    TEST_ASSERT_DOUBLE_WITHIN(5e-9, 0.8646647168, ldexp(rate.blend, -32 - rate.blend_shift));
}

void test_blend_is_accurate_to_27_bits_from_the_smallest_to_the_largest(void)
{
    for (double u = 2.4e-10; u <= 70; u *= 1.01) {
        uint32_t filter_ns = u < 1e-3 ? UINT32_MAX : 10000019u, time_ns = (uint32_t)(u * filter_ns);
        blend_of(time_ns > 0u ? time_ns : 1u, filter_ns);
    }
    blend_of(1, UINT32_MAX);
    blend_of(1, 1);
    blend_of(70, 1);
    blend_of(UINT32_MAX, UINT32_MAX);
    blend_of(UINT32_MAX, UINT32_MAX / 70u);
    for (int k = 0; k < 20000; k++) {
        uint32_t time_ns = random_length() | 1u, filter_ns = random_length();
        if (filter_ns > time_ns / 64u) {
            blend_of(time_ns, filter_ns);
        }
    }
}

/* Around every power of two, where the normalisation changes. */
void test_blend_does_not_jump_where_its_exponent_changes(void)
{
    for (unsigned bit = 0; bit < 32u; bit++) {
        const uint32_t times_ns[] = {((uint32_t)1 << bit) - 1u, (uint32_t)1 << bit, ((uint32_t)1 << bit) + 1u};
        for (size_t k = 0; k < 3; k++) {
            for (uint32_t filter_ns = 1; filter_ns < UINT32_MAX / 3u; filter_ns = filter_ns * 3u + 1u) {
                if (times_ns[k] > 0u && filter_ns > times_ns[k] / 64u) {
                    blend_of(times_ns[k], filter_ns);
                }
            }
        }
    }
}

/* ---- missed samples ---- */

void test_after_missed_samples_the_rate_is_that_over_the_true_time(void)
{
    init(1, 0);
    sample(GUARD);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, rdpi_q31_rate_step(&rate, GUARD / 2 * 5, 2));
    TEST_ASSERT_EQUAL_INT32(ONE / 2, sample(GUARD * 2));
    TEST_ASSERT_EQUAL_INT32(ONE / 4, rdpi_q31_rate_step(&rate, GUARD / 2 * 3, 1));
}

/* All numbers of samples divide the way, so that no reference is rounded. */
void test_missed_samples_are_taken_to_lie_on_a_straight_line(void)
{
    const int32_t way = 12252240; /* 1 .. 18 divide it */
    for (uint32_t window = 1; window <= RDPI_MAX_WINDOW; window += 5) {
        for (int32_t missed = 1; missed <= (int32_t)RDPI_MAX_MISSED; missed++) {
            for (uint32_t filter = 0; filter < 6; filter += 5) {
                params.guard_exponent = -26;
                init(window, filter);
                int32_t z = 0, seen = 0, steps = missed + 1;
                for (int32_t k = 0; k < 7; k++) {
                    z = k * k % 5 * 720720;
                    sample(z);
                }
                rdpi_q31_rate_t twin = rate;
                for (int32_t k = 1; k <= steps; k++) {
                    seen = rdpi_q31_rate_step(&twin, z + way / steps * k, 0);
                }
                TEST_ASSERT_EQUAL_INT32(seen, rdpi_q31_rate_step(&rate, z + way, (unsigned)missed));
                for (int32_t k = 0; k < 20; k++) { /* also while the window still spans them */
                    seen = rdpi_q31_rate_step(&twin, k * 720720, 0);
                    TEST_ASSERT_EQUAL_INT32(seen, sample(k * 720720));
                }
            }
        }
    }
}

void test_missed_samples_across_the_whole_range_do_not_overflow(void)
{
    guard((uint32_t)1 << 31, 2); /* 2^33 */
    gives(RDPI_OK, 1);
    sample(-INT32_MAX);
    TEST_ASSERT_INT32_WITHIN(1, ONE / 4, rdpi_q31_rate_step(&rate, INT32_MAX, 1));
    int32_t seen = rdpi_q31_rate_step(&rate, -INT32_MAX, RDPI_MAX_MISSED);
    TEST_ASSERT_INT32_WITHIN(1, ONE / 2 / (RDPI_MAX_MISSED + 1), seen);
}

void test_missed_references_are_whole_units_rounded_towards_the_one_before(void)
{
    guard((uint32_t)1 << 31, -29);
    params.rate_window_ns = 2;
    gives(RDPI_OK, 1); /* 8 units per window */
    sample(0);
    sample(0);
    TEST_ASSERT_EQUAL_INT32(ONE / 8 * 4, rdpi_q31_rate_step(&rate, 5, 2)); /* 0, 1, 3, 5 */
    TEST_ASSERT_EQUAL_INT32(ONE / 8 * 2, sample(5));
    TEST_ASSERT_EQUAL_INT32(ONE / 8 * 4, rdpi_q31_rate_step(&rate, 0, 2)); /* 5, 4, 2, 0 */
}

void test_as_many_missed_samples_as_allowed_keep_the_history(void)
{
    init(1, 0);
    sample(0);
    TEST_ASSERT_EQUAL_INT32(ONE / 2, rdpi_q31_rate_step(&rate, (RDPI_MAX_MISSED + 1) * (GUARD / 2), RDPI_MAX_MISSED));
}

void test_after_more_missed_samples_the_rate_starts_afresh(void)
{
    init(3, 4);
    sample(0);
    sample(GUARD);
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_rate_step(&rate, 5 * GUARD, RDPI_MAX_MISSED + 1));
    TEST_ASSERT_EQUAL_INT64(0, rate.filtered);
    rdpi_q31_rate_t fresh;
    memcpy(&fresh, &rate, sizeof fresh);
    init(3, 4);
    sample(5 * GUARD);
    for (int32_t k = 0; k < 10; k++) {
        TEST_ASSERT_EQUAL_INT32(sample(k * k * 1000), rdpi_q31_rate_step(&fresh, k * k * 1000, 0));
    }
}

void test_samples_missed_before_the_first_do_not_matter(void)
{
    init(1, 0);
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_rate_step(&rate, 1000, 5));
    TEST_ASSERT_EQUAL_INT32(ONE / 2, sample(1000 + GUARD / 2));
}
