#include "unity.h"

#include <string.h>

#include "rdpi/types.h"

TEST_SOURCE_FILE("lib/src/status.c")

static const rdpi_status_t statuses[] = {
    RDPI_OK,             RDPI_ERR_NULL,      RDPI_ERR_SCHEMA,     RDPI_ERR_NOT_FINITE, RDPI_ERR_COUNT,
    RDPI_ERR_GAIN,       RDPI_ERR_THRESHOLDS, RDPI_ERR_SLOPES,    RDPI_ERR_GUARD,      RDPI_ERR_DEADZONES,
    RDPI_ERR_SATURATION, RDPI_ERR_SAMPLE_TIME, RDPI_ERR_RATE,     RDPI_ERR_WINDOW,     RDPI_ERR_DRIVE,
    RDPI_ERR_MEMORY,     RDPI_ERR_SWEEP,     RDPI_ERR_DIGEST,     RDPI_ERR_SIZE,
    RDPI_ERR_CHAIN,      RDPI_ERR_CURVE,    RDPI_ERR_SAMPLE_RANGE,
    RDPI_ERR_STATE,      RDPI_ERR_MODE};
#define STATUSES (sizeof statuses / sizeof statuses[0])

void setUp(void)
{
}

void tearDown(void)
{
}

/* Host tools and log files hold these numbers. */
void test_ok_is_zero_and_every_error_is_negative(void)
{
    for (size_t i = 0; i < STATUSES; i++) {
        TEST_ASSERT_EQUAL_INT(-(int)i, statuses[i]);
    }
}

void test_every_status_has_a_text_of_its_own(void)
{
    const char *unknown = rdpi_status_text((rdpi_status_t)1);
    for (size_t i = 0; i < STATUSES; i++) {
        const char *text = rdpi_status_text(statuses[i]);
        TEST_ASSERT_NOT_NULL(text);
        TEST_ASSERT_TRUE_MESSAGE(strcmp(text, unknown) != 0, text);
        for (size_t j = 0; j < i; j++) {
            TEST_ASSERT_TRUE_MESSAGE(strcmp(text, rdpi_status_text(statuses[j])) != 0, text);
        }
    }
}

void test_a_number_that_is_no_status_has_a_text_too(void)
{
    TEST_ASSERT_EQUAL_STRING("unknown status", rdpi_status_text((rdpi_status_t)1));
    TEST_ASSERT_EQUAL_STRING("unknown status", rdpi_status_text((rdpi_status_t)RDPI_ERR_MODE - 1));
}

/* Drive files hold these numbers. */
void test_each_flag_is_one_bit_of_its_own(void)
{
    TEST_ASSERT_EQUAL_UINT32(1, RDPI_FLAG_GUARD);
    TEST_ASSERT_EQUAL_UINT32(2, RDPI_FLAG_RANGE);
    TEST_ASSERT_EQUAL_UINT32(4, RDPI_FLAG_SLEW);
    TEST_ASSERT_EQUAL_UINT32(8, RDPI_FLAG_INPUT);
    TEST_ASSERT_EQUAL_UINT32(16, RDPI_FLAG_MISSED);
    TEST_ASSERT_EQUAL_UINT32(32, RDPI_FLAG_LEAD);
}
