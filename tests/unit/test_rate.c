#include "unity.h"

#include <math.h>

#include "rdpi/rate.h"

TEST_SOURCE_FILE("lib/src/rate.c")

#define T_S ((rdpi_real_t)1 / 1024)
#define EQUAL_REAL(expected, actual) TEST_ASSERT_FLOAT_WITHIN(1e-4f, (float)(expected), (float)(actual))

static rdpi_f32_rate_t rate;

static void init(rdpi_real_t samples, rdpi_real_t filter_s)
{
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_rate_init(&rate, samples * T_S, filter_s, T_S));
}

/* What the estimator says at the end of a ramp of `speed` um/s that begins after one sample at rest. */
static rdpi_real_t ramp(rdpi_real_t speed, rdpi_real_t sample_time_s, int samples)
{
    rdpi_real_t seen = rdpi_f32_rate_step(&rate, 0);
    for (int k = 1; k <= samples; k++) {
        seen = rdpi_f32_rate_step(&rate, (rdpi_real_t)k * speed * sample_time_s);
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

void test_filter_time_that_is_not_finite_is_refused(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_RATE, rdpi_f32_rate_init(&rate, 0, NAN, T_S));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_RATE, rdpi_f32_rate_init(&rate, 0, INFINITY, T_S));
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
    EQUAL_REAL(0, rdpi_f32_rate_step(&rate, 1000));
    init(5, 0);
    EQUAL_REAL(0, rdpi_f32_rate_step(&rate, -1000));
}

void test_window_of_one_sample_is_the_difference_of_neighbours(void)
{
    init(1, 0);
    rdpi_f32_rate_step(&rate, 2);
    EQUAL_REAL(1024, rdpi_f32_rate_step(&rate, 3));
    EQUAL_REAL(0, rdpi_f32_rate_step(&rate, 3));
    EQUAL_REAL(512, rdpi_f32_rate_step(&rate, (rdpi_real_t)3.5));
}

void test_window_shorter_than_a_sample_means_one_sample(void)
{
    init(0, 0);
    rdpi_f32_rate_step(&rate, 0);
    EQUAL_REAL(1024, rdpi_f32_rate_step(&rate, 1));
    EQUAL_REAL(0, rdpi_f32_rate_step(&rate, 1));
    init((rdpi_real_t)1.25, 0);
    rdpi_f32_rate_step(&rate, 0);
    EQUAL_REAL(1024, rdpi_f32_rate_step(&rate, 1));
    EQUAL_REAL(0, rdpi_f32_rate_step(&rate, 1));
}

void test_window_is_rounded_to_the_nearest_sample(void)
{
    init((rdpi_real_t)1.5, 0); /* N = 2 */
    rdpi_f32_rate_step(&rate, 0);
    EQUAL_REAL(512, rdpi_f32_rate_step(&rate, 1));
    EQUAL_REAL(512, rdpi_f32_rate_step(&rate, 1));
    EQUAL_REAL(0, rdpi_f32_rate_step(&rate, 1));
    init((rdpi_real_t)2.25, 0);
    rdpi_f32_rate_step(&rate, 0);
    EQUAL_REAL(512, rdpi_f32_rate_step(&rate, 1));
}

void test_a_falling_sample_has_a_positive_rate(void)
{
    init(1, 0);
    rdpi_f32_rate_step(&rate, 2);
    EQUAL_REAL(1024, rdpi_f32_rate_step(&rate, 1));
}

/* |z_k - z_(k-4)| / (4 T) of 0, 1, 3, 2, 7, 7, 1, 1, 1, with 0 for what was before the first. */
void test_window_of_several_samples_spans_them_all(void)
{
    const rdpi_real_t samples[] = {0, 1, 3, 2, 7, 7, 1, 1, 1}, moved[] = {0, 1, 3, 2, 7, 6, 2, 1, 6};
    init(4, 0);
    for (size_t k = 0; k < 9; k++) {
        EQUAL_REAL(moved[k] * 256, rdpi_f32_rate_step(&rate, samples[k]));
    }
}

void test_before_the_window_is_full_the_first_sample_stands_in(void)
{
    init(3, 0);
    rdpi_f32_rate_step(&rate, 10);
    EQUAL_REAL(1024.0 / 3, rdpi_f32_rate_step(&rate, 11));
    EQUAL_REAL(2 * 1024.0 / 3, rdpi_f32_rate_step(&rate, 12));
    EQUAL_REAL(1024, rdpi_f32_rate_step(&rate, 13));
    EQUAL_REAL(1024, rdpi_f32_rate_step(&rate, 14));
}

void test_filter_is_a_first_order_low_pass_that_starts_at_zero(void)
{
    const double tau_s = 8.0 / 1024, blend = 1 - exp(-1.0 / 8);
    double expected = 0;
    init(1, (rdpi_real_t)tau_s);
    EQUAL_REAL(0, rdpi_f32_rate_step(&rate, 0));
    for (int k = 1; k <= 30; k++) {
        expected += blend * ((k <= 15 ? 100 : 0) - expected); /* 15 samples of ramp, then rest */
        EQUAL_REAL(expected, rdpi_f32_rate_step(&rate, (rdpi_real_t)(k <= 15 ? k : 15) * 100 * T_S));
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

void test_window_spans_the_same_time_at_any_sample_rate(void)
{
    const rdpi_real_t window_s = (rdpi_real_t)0.0625;
    for (int samples = 1; samples <= RDPI_MAX_WINDOW; samples *= 2) {
        const rdpi_real_t sample_time_s = window_s / (rdpi_real_t)samples;
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_rate_init(&rate, window_s, 0, sample_time_s));
        rdpi_f32_rate_step(&rate, 0);
        for (int k = 0; k < samples; k++) { /* a step is seen for the time of the window */
            EQUAL_REAL(16, rdpi_f32_rate_step(&rate, 1));
        }
        EQUAL_REAL(0, rdpi_f32_rate_step(&rate, 1));
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
        rdpi_real_t fresh = rdpi_f32_rate_step(&rate, (rdpi_real_t)(5 + k * k));
        EQUAL_REAL(fresh, rdpi_f32_rate_step(&after_reset, (rdpi_real_t)(5 + k * k)));
    }
}
