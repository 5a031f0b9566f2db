#include "unity.h"

#include <math.h>

#include "f32_rate.h"

#define T_S ((rdpi_real_t)1 / 1024)
#define EQUAL_REAL(expected, actual) TEST_ASSERT_FLOAT_WITHIN(1e-4f, (float)(expected), (float)(actual))

static rdpi_f32_rate_t rate;

static void init(rdpi_real_t samples, rdpi_real_t filter_s)
{
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_rate_init(&rate, samples * T_S, filter_s, T_S));
}

static rdpi_real_t sample(rdpi_real_t z_um)
{
    return rdpi_f32_rate_step(&rate, z_um, 0);
}

/* What the estimator says at the end of a ramp of `speed` um/s that begins after one sample at rest. */
static rdpi_real_t ramp(rdpi_real_t speed, rdpi_real_t sample_time_s, int samples)
{
    rdpi_real_t seen = sample(0);
    for (int k = 1; k <= samples; k++) {
        seen = sample((rdpi_real_t)k * speed * sample_time_s);
    }
    return seen;
}

void setUp(void)
{
}

void tearDown(void)
{
}

void test_sample_time_zero_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, rdpi_f32_rate_init(&rate, 0, 0, 0));
}

void test_sample_time_negative_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, rdpi_f32_rate_init(&rate, 0, 0, -T_S));
}

void test_sample_time_that_is_not_finite_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, rdpi_f32_rate_init(&rate, 0, 0, NAN));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, rdpi_f32_rate_init(&rate, 0, 0, INFINITY));
}

void test_sample_time_too_short_or_too_long_for_finite_rates_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, rdpi_f32_rate_init(&rate, 0, 0, RDPI_MIN_SAMPLE_TIME_S / 2));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, rdpi_f32_rate_init(&rate, 0, 0, 2 / RDPI_MIN_SAMPLE_TIME_S));
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_rate_init(&rate, 0, 0, RDPI_MIN_SAMPLE_TIME_S));
}

void test_negative_window_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_RATE, rdpi_f32_rate_init(&rate, -T_S, 0, T_S));
}

void test_window_that_is_not_a_number_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_RATE, rdpi_f32_rate_init(&rate, NAN, 0, T_S));
}

void test_negative_filter_time_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_RATE, rdpi_f32_rate_init(&rate, 0, -T_S, T_S));
}

void test_filter_time_that_is_not_a_number_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_RATE, rdpi_f32_rate_init(&rate, 0, NAN, T_S));
}

void test_window_of_more_samples_than_there_is_room_for_is_refused(void)
{
    const rdpi_real_t rounded_up = (rdpi_real_t)RDPI_MAX_WINDOW + (rdpi_real_t)0.5;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_WINDOW, rdpi_f32_rate_init(&rate, rounded_up * T_S, 0, T_S));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_WINDOW, rdpi_f32_rate_init(&rate, INFINITY, 0, T_S));
}

void test_window_that_rounds_to_the_room_there_is_is_accepted(void)
{
    init((rdpi_real_t)RDPI_MAX_WINDOW + (rdpi_real_t)0.25, 0);
    ramp(100, T_S, 1);
    EQUAL_REAL(100, ramp(100, T_S, 2 * RDPI_MAX_WINDOW));
}

void test_first_sample_has_no_rate_wherever_it_is(void)
{
    init(1, 0);
    EQUAL_REAL(0, sample(1000));
    init(5, 0);
    EQUAL_REAL(0, sample(-1000));
}

void test_window_of_one_sample_is_the_difference_of_neighbours(void)
{
    init(1, 0);
    sample(2);
    EQUAL_REAL(1024, sample(3));
    EQUAL_REAL(0, sample(3));
    EQUAL_REAL(512, sample((rdpi_real_t)3.5));
}

void test_in_the_direct_case_the_quick_way_gives_the_same_rate(void)
{
    const rdpi_real_t samples[] = {2, 3, 3, (rdpi_real_t)3.5, -7, 1000, 0};
    init(1, 0);
    sample(1);
    for (size_t k = 0; k < sizeof samples / sizeof samples[0]; k++) {
        rdpi_real_t direct = rdpi_f32_rate_direct(&rate, samples[k]);
        EQUAL_REAL(sample(samples[k]), direct);
    }
}

void test_window_shorter_than_a_sample_means_one_sample(void)
{
    init(0, 0);
    sample(0);
    EQUAL_REAL(1024, sample(1));
    EQUAL_REAL(0, sample(1));
    init((rdpi_real_t)1.25, 0);
    sample(0);
    EQUAL_REAL(1024, sample(1));
    EQUAL_REAL(0, sample(1));
}

void test_window_is_rounded_to_the_nearest_sample(void)
{
    init((rdpi_real_t)1.5, 0); /* N = 2 */
    sample(0);
    EQUAL_REAL(512, sample(1));
    EQUAL_REAL(512, sample(1));
    EQUAL_REAL(0, sample(1));
    init((rdpi_real_t)2.25, 0);
    sample(0);
    EQUAL_REAL(512, sample(1));
}

void test_a_falling_sample_has_a_positive_rate(void)
{
    init(1, 0);
    sample(2);
    EQUAL_REAL(1024, sample(1));
}

/* |z_k - z_(k-4)| / (4 T) of 0, 1, 3, 2, 7, 7, 1, 1, 1, with 0 for what was before the first. */
void test_window_of_several_samples_spans_them_all(void)
{
    const rdpi_real_t samples[] = {0, 1, 3, 2, 7, 7, 1, 1, 1}, moved[] = {0, 1, 3, 2, 7, 6, 2, 1, 6};
    init(4, 0);
    for (size_t k = 0; k < 9; k++) {
        EQUAL_REAL(moved[k] * 256, sample(samples[k]));
    }
}

void test_before_the_window_is_full_the_first_sample_stands_in(void)
{
    init(3, 0);
    sample(10);
    EQUAL_REAL(1024.0 / 3, sample(11));
    EQUAL_REAL(2 * 1024.0 / 3, sample(12));
    EQUAL_REAL(1024, sample(13));
    EQUAL_REAL(1024, sample(14));
}

void test_filter_is_a_first_order_low_pass_that_starts_at_zero(void)
{
    const double tau_s = 8.0 / 1024, blend = 1 - (exp)(-1.0 / 8);
    double expected = 0;
    init(1, (rdpi_real_t)tau_s);
    EQUAL_REAL(0, sample(0));
    for (int k = 1; k <= 30; k++) {
        expected += blend * ((k <= 15 ? 100 : 0) - expected); /* 15 samples of ramp, then rest */
        EQUAL_REAL(expected, sample((rdpi_real_t)(k <= 15 ? k : 15) * 100 * T_S));
    }
}

void test_without_filter_the_difference_comes_through_at_once(void)
{
    init(1, 0);
    EQUAL_REAL(100, ramp(100, T_S, 1));
}

void test_filter_reaches_63_percent_after_its_time_at_any_sample_rate(void)
{
    const rdpi_real_t filter_s = (rdpi_real_t)0.0625;
    for (int per_filter_time = 4; per_filter_time <= 4096; per_filter_time *= 4) {
        const rdpi_real_t sample_time_s = filter_s / (rdpi_real_t)per_filter_time;
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_rate_init(&rate, 0, filter_s, sample_time_s));
        TEST_ASSERT_FLOAT_WITHIN(0.05f, 63.2121f, (float)ramp(100, sample_time_s, per_filter_time));
    }
}

void test_filter_much_shorter_than_a_sample_is_none(void)
{
    init(1, T_S / 70);
    EQUAL_REAL(100, ramp(100, T_S, 1));
}

/* One sample after a jump its rate must not be left in the digits of the next. */
void test_without_filter_a_large_rate_leaves_no_rounding_behind(void)
{
    init(1, 0);
    sample(0);
    sample((rdpi_real_t)12345.678);
    rdpi_real_t seen = sample((rdpi_real_t)12345.678);
    TEST_ASSERT_EQUAL_FLOAT(0, (float)seen);
    sample(0);
    seen = sample((rdpi_real_t)0.0001);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.1024f, (float)seen);
}

void test_window_spans_the_same_time_at_any_sample_rate(void)
{
    const rdpi_real_t window_s = (rdpi_real_t)0.0625;
    for (int samples = 1; samples <= RDPI_MAX_WINDOW; samples *= 2) {
        const rdpi_real_t sample_time_s = window_s / (rdpi_real_t)samples;
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_rate_init(&rate, window_s, 0, sample_time_s));
        sample(0);
        for (int k = 0; k < samples; k++) { /* a step is seen for the time of the window */
            EQUAL_REAL(16, sample(1));
        }
        EQUAL_REAL(0, sample(1));
    }
}

void test_reset_forgets_samples_and_filter(void)
{
    init(3, 4 * T_S);
    ramp(1000, T_S, 20);
    rdpi_f32_rate_reset(&rate);
    rdpi_f32_rate_t after_reset = rate;
    init(3, 4 * T_S);
    for (int k = 0; k < 10; k++) {
        rdpi_real_t fresh = sample((rdpi_real_t)(5 + k * k));
        EQUAL_REAL(fresh, rdpi_f32_rate_step(&after_reset, (rdpi_real_t)(5 + k * k), 0));
    }
}

/* ---- 1 - exp(-u) without libm ---- */

void test_fraction_at_typed_values(void)
{
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.0951625820f, (float)rdpi_f32_rate_blend((rdpi_real_t)0.1));
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.632120559f, (float)rdpi_f32_rate_blend(1));
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.864664717f, (float)rdpi_f32_rate_blend(2));
    TEST_ASSERT_EQUAL_FLOAT(0, (float)rdpi_f32_rate_blend(0));
}

void test_fraction_is_exact_to_rounding_from_the_smallest_to_the_largest(void)
{
    const double rounding = sizeof(rdpi_real_t) == sizeof(float) ? 4 * 1.2e-7 : 1e-13;
    for (double u = 1e-18; u <= 64; u *= 1.07) {
        double exact = -expm1(-(double)(rdpi_real_t)u), share = (double)rdpi_f32_rate_blend((rdpi_real_t)u);
        TEST_ASSERT_TRUE(fabs(share - exact) <= rounding * exact);
        TEST_ASSERT_TRUE(share <= 1);
    }
}

/* ---- missed samples ---- */

void test_after_missed_samples_the_rate_is_that_over_the_true_time(void)
{
    init(1, 0);
    sample(1);
    EQUAL_REAL(2 * 1024, rdpi_f32_rate_step(&rate, 7, 2));
    EQUAL_REAL(1024, sample(8));
    EQUAL_REAL(512, rdpi_f32_rate_step(&rate, 7, 1));
}

void test_missed_samples_are_taken_to_lie_on_a_straight_line(void)
{
    const rdpi_real_t filters_s[] = {0, 5 * T_S};
    for (unsigned window = 1; window <= RDPI_MAX_WINDOW; window += 5) {
        for (unsigned missed = 1; missed <= RDPI_MAX_MISSED; missed++) {
            for (size_t filter = 0; filter < 2; filter++) {
                init((rdpi_real_t)window, filters_s[filter]);
                rdpi_real_t z_um = sample(2);
                for (int k = 1; k < 7; k++) {
                    z_um = (rdpi_real_t)(k * k % 5);
                    sample(z_um);
                }
                rdpi_f32_rate_t twin = rate;
                rdpi_real_t seen = 0;
                for (unsigned k = 1; k <= missed + 1; k++) {
                    seen = rdpi_f32_rate_step(&twin, z_um + (9 - z_um) * (rdpi_real_t)k / (rdpi_real_t)(missed + 1), 0);
                }
                TEST_ASSERT_FLOAT_WITHIN(0.01f, (float)seen, (float)rdpi_f32_rate_step(&rate, 9, missed));
                for (int k = 0; k < 20; k++) { /* also while the window still spans them */
                    seen = rdpi_f32_rate_step(&twin, (rdpi_real_t)k, 0);
                    TEST_ASSERT_FLOAT_WITHIN(0.01f, (float)seen, (float)sample((rdpi_real_t)k));
                }
            }
        }
    }
}

/* Far from 0, where a point of the line would be rounded to 4e-6 um, and the way is 16 times that. */
void test_after_missed_samples_the_rate_is_that_of_the_samples_and_not_of_rounded_points(void)
{
    const rdpi_real_t from_um = 60, to_um = from_um + (rdpi_real_t)1 / 16384;
    for (unsigned window = 1; window <= RDPI_MAX_WINDOW; window++) {
        for (unsigned missed = 0; missed <= RDPI_MAX_MISSED; missed++) {
            init((rdpi_real_t)window, 0);
            sample(from_um);
            double spanned = missed + 1 < window ? window : missed + 1; /* samples that the way is seen in */
            double expected = (double)(to_um - from_um) / (spanned * (double)T_S);
            rdpi_real_t seen = rdpi_f32_rate_step(&rate, to_um, missed);
            TEST_ASSERT_TRUE(fabs((double)seen - expected) <= 4e-7 * expected);
        }
    }
}

void test_as_many_missed_samples_as_allowed_keep_the_history(void)
{
    init(1, 0);
    sample(0);
    EQUAL_REAL(1024, rdpi_f32_rate_step(&rate, RDPI_MAX_MISSED + 1, RDPI_MAX_MISSED));
}

void test_after_more_missed_samples_the_rate_starts_afresh(void)
{
    init(3, 4 * T_S);
    ramp(1000, T_S, 20);
    EQUAL_REAL(0, rdpi_f32_rate_step(&rate, 5, RDPI_MAX_MISSED + 1));
    rdpi_f32_rate_t restarted = rate;
    init(3, 4 * T_S);
    sample(5);
    for (int k = 0; k < 10; k++) {
        EQUAL_REAL(sample((rdpi_real_t)(k * k)), rdpi_f32_rate_step(&restarted, (rdpi_real_t)(k * k), 0));
    }
}

void test_samples_missed_before_the_first_do_not_matter(void)
{
    init(2, 0);
    EQUAL_REAL(0, rdpi_f32_rate_step(&rate, 3, 5));
    EQUAL_REAL(512, sample(4));
}
