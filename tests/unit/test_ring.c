#define RING_BYTES 16u
#include "ring.h"

#include "unity.h"

static ring_t ring;

void setUp(void)
{
    ring = (ring_t){.put_count = 0};
}

void tearDown(void)
{
}

void test_what_is_put_is_taken_in_order_and_then_there_is_none(void)
{
    uint8_t byte = 99;
    TEST_ASSERT_TRUE(ring_empty(&ring));
    TEST_ASSERT_FALSE(ring_take(&ring, &byte));
    TEST_ASSERT_EQUAL_UINT8(99, byte);
    TEST_ASSERT_TRUE(ring_put(&ring, (const uint8_t[]){1, 2}, 2));
    TEST_ASSERT_TRUE(ring_put(&ring, (const uint8_t[]){3}, 1));
    for (uint8_t expected = 1; expected <= 3; expected++) {
        TEST_ASSERT_FALSE(ring_empty(&ring));
        TEST_ASSERT_TRUE(ring_take(&ring, &byte));
        TEST_ASSERT_EQUAL_UINT8(expected, byte);
    }
    TEST_ASSERT_TRUE(ring_empty(&ring));
    TEST_ASSERT_FALSE(ring_take(&ring, &byte));
}

void test_takes_all_bytes_or_none(void)
{
    uint8_t byte, bytes[RING_BYTES + 1] = {7};
    TEST_ASSERT_FALSE(ring_put(&ring, bytes, RING_BYTES + 1));
    TEST_ASSERT_TRUE(ring_empty(&ring));
    TEST_ASSERT_TRUE(ring_put(&ring, bytes, RING_BYTES));
    TEST_ASSERT_FALSE(ring_put(&ring, bytes, 1));
    TEST_ASSERT_TRUE(ring_put(&ring, bytes, 0));
    TEST_ASSERT_TRUE(ring_take(&ring, &byte));
    TEST_ASSERT_FALSE(ring_put(&ring, bytes, 2));
    TEST_ASSERT_TRUE(ring_put(&ring, bytes, 1));
    for (unsigned k = 0; k < RING_BYTES; k++) {
        TEST_ASSERT_TRUE(ring_take(&ring, &byte));
    }
    TEST_ASSERT_TRUE(ring_empty(&ring));
}

void test_goes_on_where_the_counts_wrap(void)
{
    uint8_t byte, bytes[11];
    ring.put_count = ring.taken_count = UINT32_MAX - 20u;
    for (unsigned turn = 0; turn < 5; turn++) {
        for (unsigned k = 0; k < sizeof bytes; k++) {
            bytes[k] = (uint8_t)(turn * sizeof bytes + k);
        }
        TEST_ASSERT_TRUE(ring_put(&ring, bytes, sizeof bytes));
        TEST_ASSERT_FALSE(ring_put(&ring, bytes, sizeof bytes));
        for (unsigned k = 0; k < sizeof bytes; k++) {
            TEST_ASSERT_TRUE(ring_take(&ring, &byte));
            TEST_ASSERT_EQUAL_UINT8(bytes[k], byte);
        }
        TEST_ASSERT_TRUE(ring_empty(&ring));
    }
    TEST_ASSERT_TRUE(ring.put_count < 40u);
}
