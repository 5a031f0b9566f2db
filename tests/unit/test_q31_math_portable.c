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
    TEST_ASSERT_INT32_WITHIN(4, 333333, rdpi_q31_divide(1000000, 3));
    TEST_ASSERT_INT32_WITHIN(4, 1000000, rdpi_q31_divide(1000000, 1));
}
