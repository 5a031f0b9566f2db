/* What a compiler without the builtin for leading zeros makes of q31_math.h. */
#define RDPI_Q31_PORTABLE

#include "unity.h"

#include "q31_math.h"
#include "random_bits.h"

void setUp(void)
{
    random_state = 2;
}

void tearDown(void)
{
}

/* The builtin where there is one. */
static unsigned zeros_before(uint32_t value)
{
#ifdef __GNUC__
    return (unsigned)__builtin_clz(value);
#else
    unsigned zeros = 0;
    for (; value < (uint32_t)1 << 31; value <<= 1) {
        zeros++;
    }
    return zeros;
#endif
}

void test_portable_leading_zeros_of_every_length_of_word(void)
{
    for (unsigned bit = 0; bit < 32u; bit++) {
        uint32_t lowest = (uint32_t)1 << bit;
        TEST_ASSERT_EQUAL_UINT(31u - bit, rdpi_q31_clz(lowest));
        TEST_ASSERT_EQUAL_UINT(31u - bit, rdpi_q31_clz(lowest | (lowest - 1u)));
    }
}

void test_portable_leading_zeros_are_those_of_the_builtin(void)
{
    for (int k = 0; k < 20000; k++) {
        uint32_t value = random_length() | 1u;
        TEST_ASSERT_EQUAL_UINT(zeros_before(value), rdpi_q31_clz(value));
        value &= ~(uint32_t)1;
        if (value > 0u) {
            TEST_ASSERT_EQUAL_UINT(zeros_before(value), rdpi_q31_clz(value));
        }
    }
}

void test_portable_leading_zeros_of_every_length_of_double_word(void)
{
    for (unsigned bit = 0; bit < 64u; bit++) {
        uint64_t lowest = (uint64_t)1 << bit;
        TEST_ASSERT_EQUAL_UINT(63u - bit, rdpi_q31_clz64(lowest));
        TEST_ASSERT_EQUAL_UINT(63u - bit, rdpi_q31_clz64(lowest | (lowest - 1u)));
    }
}

void test_division_does_not_depend_on_how_zeros_are_counted(void)
{
    TEST_ASSERT_INT32_WITHIN(4, 1000, rdpi_q31_divide((int64_t)1000 << 30, (int32_t)1 << 30));
    TEST_ASSERT_INT32_WITHIN(4, 333333, rdpi_q31_divide((int64_t)1000000 << 23, 3 << 23));
    TEST_ASSERT_INT32_WITHIN(4, 1000000, rdpi_q31_divide((int64_t)1000000 << 24, (int32_t)1 << 24));
}

void test_portable_products_are_those_of_64_bits(void)
{
    for (int k = 0; k < 50000; k++) {
        uint32_t a = random_length(), b = random_length();
        int32_t c = random_size(INT32_MAX, 31), d = random_size(INT32_MAX, 31);
        TEST_ASSERT_EQUAL_HEX32((uint32_t)(((uint64_t)a * b) >> 32), rdpi_q31_mulh(a, b));
        TEST_ASSERT_EQUAL_INT64((int64_t)c * d, rdpi_q31_mul(c, d));
    }
}

void test_portable_products_of_the_ends_of_the_format(void)
{
    const int32_t ends[] = {INT32_MIN, INT32_MIN + 1, -0x10000, -0xFFFF, -1, 0, 1, 0xFFFF, 0x10000, INT32_MAX};
    for (size_t i = 0; i < 10; i++) {
        for (size_t k = 0; k < 10; k++) {
            uint64_t product = (uint64_t)(uint32_t)ends[i] * (uint32_t)ends[k];
            TEST_ASSERT_EQUAL_INT64((int64_t)ends[i] * ends[k], rdpi_q31_mul(ends[i], ends[k]));
            TEST_ASSERT_EQUAL_HEX32((uint32_t)(product >> 32), rdpi_q31_mulh((uint32_t)ends[i], (uint32_t)ends[k]));
        }
        TEST_ASSERT_EQUAL_INT64(0, rdpi_q31_mul_rate(ends[i], 0));
        TEST_ASSERT_EQUAL_INT64(ends[i], rdpi_q31_mul_rate(ends[i], 1));
        TEST_ASSERT_EQUAL_INT64((int64_t)ends[i] * RDPI_Q31_ONE, rdpi_q31_mul_rate(ends[i], RDPI_Q31_ONE));
    }
}

void test_portable_parts_are_whole_units(void)
{
    for (unsigned parts = 1; parts <= RDPI_MAX_MISSED + 1u; parts++) {
        TEST_ASSERT_EQUAL_UINT32(0, rdpi_q31_part(0, parts));
        TEST_ASSERT_EQUAL_UINT32(UINT32_MAX / parts, rdpi_q31_part(UINT32_MAX, parts));
        for (int k = 0; k < 2000; k++) {
            uint32_t part = random_bits() / parts, whole = part * parts;
            TEST_ASSERT_EQUAL_UINT32(part, rdpi_q31_part(whole, parts));
            TEST_ASSERT_EQUAL_UINT32(part, rdpi_q31_part(whole + parts - 1u, parts));
        }
    }
}
