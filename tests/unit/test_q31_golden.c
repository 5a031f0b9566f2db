/* The same bits on every machine: replays tests/golden/q31_vectors.h. */
#include "unity.h"

#include "../golden/q31_vectors.h"
#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#define GOLDEN (sizeof golden_q31 / sizeof golden_q31[0])

void setUp(void)
{
}

void tearDown(void)
{
}

void test_golden_digests_are_those_of_any_machine(void)
{
    for (size_t k = 0; k < GOLDEN; k++) {
        TEST_ASSERT_EQUAL_HEX32(golden_q31[k].params.digest, rdpi_q31_digest(&golden_q31[k].params));
    }
}

void test_golden_samples_come_out_to_the_last_bit(void)
{
    for (size_t k = 0; k < GOLDEN; k++) {
        rdpi_q31_t axis;
        TEST_ASSERT_EQUAL_INT_MESSAGE(RDPI_OK, rdpi_q31_init(&axis, &golden_q31[k].params, golden_q31[k].sample_time_ns),
                                      golden_q31[k].name);
        for (size_t i = 0; i < golden_q31[k].samples; i++) {
            const golden_q31_sample_t *sample = &golden_q31[k].sample[i];
            rdpi_q31_missed(&axis, sample->missed);
            int32_t drive = rdpi_q31_step(&axis, sample->reference);
            TEST_ASSERT_EQUAL_INT32_MESSAGE(sample->drive, drive, golden_q31[k].name);
            TEST_ASSERT_EQUAL_INT32_MESSAGE(sample->drive, axis.drive, golden_q31[k].name);
            TEST_ASSERT_EQUAL_INT32_MESSAGE(sample->rate, axis.rate, golden_q31[k].name);
            TEST_ASSERT_EQUAL_UINT32_MESSAGE(sample->dac_code, axis.dac_code, golden_q31[k].name);
            TEST_ASSERT_EQUAL_HEX32_MESSAGE(sample->flags, axis.flags, golden_q31[k].name);
        }
    }
}
