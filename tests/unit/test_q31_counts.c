/* rdpi_q31_of_counts: a sensor's counts as references, in integers. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

void setUp(void)
{
}

void tearDown(void)
{
}

/* 1000.5 units a count, reference 0 between counts 200 and 201. */
void test_a_count_is_the_nearest_reference(void)
{
    static const rdpi_q31_sensor_t sensor = RDPI_Q31_SENSOR(1000.5, 200.25);
    TEST_ASSERT_INT32_WITHIN(1, -250, rdpi_q31_of_counts(&sensor, 200));
    TEST_ASSERT_INT32_WITHIN(1, 750, rdpi_q31_of_counts(&sensor, 201));
    TEST_ASSERT_INT32_WITHIN(1, 99849650, rdpi_q31_of_counts(&sensor, 100000));
    TEST_ASSERT_INT32_WITHIN(1, -100250350, rdpi_q31_of_counts(&sensor, -100000));
}

void test_a_sensor_may_be_mounted_the_other_way_round(void)
{
    static const rdpi_q31_sensor_t sensor = RDPI_Q31_SENSOR(-1000.5, 200.25);
    TEST_ASSERT_INT32_WITHIN(1, 250, rdpi_q31_of_counts(&sensor, 200));
    TEST_ASSERT_INT32_WITHIN(1, -99849650, rdpi_q31_of_counts(&sensor, 100000));
}

/* 1.5 times 2^30, and nothing wraps beyond. */
void test_counts_beyond_all_reach_saturate(void)
{
    static const rdpi_q31_sensor_t rising = RDPI_Q31_SENSOR(1000.5, 200.25), falling = RDPI_Q31_SENSOR(-1000.5, 200.25);
    TEST_ASSERT_INT32_WITHIN(1001, 1610612736, rdpi_q31_of_counts(&rising, INT32_MAX));
    TEST_ASSERT_INT32_WITHIN(1001, -1610612736, rdpi_q31_of_counts(&rising, INT32_MIN));
    TEST_ASSERT_INT32_WITHIN(1001, -1610612736, rdpi_q31_of_counts(&falling, INT32_MAX));
    TEST_ASSERT_INT32_WITHIN(1001, 1610612736, rdpi_q31_of_counts(&falling, INT32_MIN));
}
