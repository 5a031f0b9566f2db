#include "unity.h"

#include "q31_math.h"
#include "random_bits.h"

static const uint32_t words[] = {
    0, 1, 2, 3, 0x7FFF, 0x8000, 0xFFFF, 0x10000, 0x10001, 0x12345678, 0x7FFFFFFF, 0x80000000, 0x80000001,
    0xAAAAAAAA, 0xFFFF0000, 0xFFFFFFFE, 0xFFFFFFFF};
static const int64_t wide[] = {
    0, 1, -1, 2, -2, 0xFFFFFFFF, -0xFFFFFFFFLL, 0x100000000, -0x100000000LL, 0x100000001, -0x100000001LL,
    0x123456789ABCDEF, -0x123456789ABCDEF, INT64_MAX, INT64_MIN, INT64_MAX - 1, INT64_MIN + 1};
#define WORDS (sizeof words / sizeof words[0])
#define WIDE (sizeof wide / sizeof wide[0])

void setUp(void)
{
    random_state = 1;
}

void tearDown(void)
{
}

static uint64_t random_wide(void)
{
    uint64_t high = (uint64_t)random_bits() << 32;
    return high | random_bits();
}

/* ---- clamp ---- */

void test_clamp_passes_what_lies_between_its_ends_and_the_ends(void)
{
    TEST_ASSERT_EQUAL_INT32(7, rdpi_q31_clamp(7, -8, 9));
    TEST_ASSERT_EQUAL_INT32(-8, rdpi_q31_clamp(-8, -8, 9));
    TEST_ASSERT_EQUAL_INT32(9, rdpi_q31_clamp(9, -8, 9));
    TEST_ASSERT_EQUAL_INT32(INT32_MAX, rdpi_q31_clamp(INT32_MAX, INT32_MIN, INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(INT32_MIN, rdpi_q31_clamp(INT32_MIN, INT32_MIN, INT32_MAX));
}

void test_clamp_saturates_everything_beyond(void)
{
    TEST_ASSERT_EQUAL_INT32(-8, rdpi_q31_clamp(-9, -8, 9));
    TEST_ASSERT_EQUAL_INT32(9, rdpi_q31_clamp(10, -8, 9));
    TEST_ASSERT_EQUAL_INT32(INT32_MAX, rdpi_q31_clamp((int64_t)INT32_MAX + 1, INT32_MIN, INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(INT32_MIN, rdpi_q31_clamp((int64_t)INT32_MIN - 1, INT32_MIN, INT32_MAX));
    TEST_ASSERT_EQUAL_INT32(9, rdpi_q31_clamp(INT64_MAX, -8, 9));
    TEST_ASSERT_EQUAL_INT32(-8, rdpi_q31_clamp(INT64_MIN, -8, 9));
}

/* ---- products ---- */

void test_mulh_is_the_high_word_of_the_product(void)
{
    TEST_ASSERT_EQUAL_HEX32(0, rdpi_q31_mulh(0xFFFFFFFF, 1));
    TEST_ASSERT_EQUAL_HEX32(1, rdpi_q31_mulh(0x80000000, 2));
    TEST_ASSERT_EQUAL_HEX32(0xFFFFFFFE, rdpi_q31_mulh(0xFFFFFFFF, 0xFFFFFFFF));
    TEST_ASSERT_EQUAL_HEX32(0x40000000, rdpi_q31_mulh(0x80000000, 0x80000000));
    for (size_t i = 0; i < WORDS; i++) {
        for (size_t k = 0; k < WORDS; k++) {
            uint64_t product = (uint64_t)words[i] * words[k];
            TEST_ASSERT_EQUAL_HEX32((uint32_t)(product >> 32), rdpi_q31_mulh(words[i], words[k]));
        }
    }
}

void test_products_of_signed_words_are_exact(void)
{
    for (size_t i = 0; i < WORDS; i++) {
        for (size_t k = 0; k < WORDS; k++) {
            int64_t a = (int32_t)words[i], b = (int32_t)words[k];
            TEST_ASSERT_EQUAL_INT64(a * b, rdpi_q31_mul((int32_t)a, (int32_t)b));
        }
    }
    for (int k = 0; k < 20000; k++) {
        int64_t a = random_between(INT32_MIN, INT32_MAX), b = random_size(INT32_MAX, 31);
        TEST_ASSERT_EQUAL_INT64(a * b, rdpi_q31_mul((int32_t)a, (int32_t)b));
    }
}

void test_products_with_a_rate_are_exact_at_both_ends_and_in_between(void)
{
    const int32_t rates[] = {0, 1, RDPI_Q31_ONE / 3, RDPI_Q31_ONE - 1, RDPI_Q31_ONE};
    for (size_t i = 0; i < WORDS; i++) {
        for (size_t k = 0; k < 5; k++) {
            int32_t a = (int32_t)words[i];
            TEST_ASSERT_EQUAL_INT64((int64_t)a * rates[k], rdpi_q31_mul_rate(a, rates[k]));
        }
    }
}

/* In 32-bit halves, with nothing but sums that carry. */
static int64_t mul_wide_by_halves(int64_t a, uint32_t b)
{
    uint64_t size = a < 0 ? 0u - (uint64_t)a : (uint64_t)a;
    uint64_t low = (size & UINT32_MAX) * b;
    uint64_t whole = (size >> 32) * b + (low >> 32); /* of the magnitude, cut */
    bool rest = (low & UINT32_MAX) != 0;
    return a >= 0 ? (int64_t)whole : -(int64_t)whole - rest;
}

void test_mul_wide_is_the_product_over_2_to_the_32_rounded_down(void)
{
    TEST_ASSERT_EQUAL_INT64(3, rdpi_q31_mul_wide((int64_t)7 << 31, 1));
    TEST_ASSERT_EQUAL_INT64(-4, rdpi_q31_mul_wide(-((int64_t)7 << 31), 1));
    TEST_ASSERT_EQUAL_INT64(-1, rdpi_q31_mul_wide(-1, 1));
    TEST_ASSERT_EQUAL_INT64(0, rdpi_q31_mul_wide(-1, 0));
    for (size_t i = 0; i < WIDE; i++) {
        for (size_t k = 0; k < WORDS; k++) {
            TEST_ASSERT_EQUAL_INT64(mul_wide_by_halves(wide[i], words[k]), rdpi_q31_mul_wide(wide[i], words[k]));
        }
    }
}

void test_mul_wide_of_any_numbers_is_exact(void)
{
    for (int k = 0; k < 20000; k++) {
        int64_t a = (int64_t)random_wide();
        a >>= random_bits() % 64u;
        uint32_t b = random_length();
        TEST_ASSERT_EQUAL_INT64(mul_wide_by_halves(a, b), rdpi_q31_mul_wide(a, b));
    }
}

/* ---- leading zeros ---- */

static void leading_zeros_of(uint32_t value)
{
    unsigned zeros = rdpi_q31_clz(value);
    TEST_ASSERT_LESS_THAN_UINT(32, zeros);
    TEST_ASSERT_EQUAL_HEX32(1, value >> (31u - zeros));
}

void test_leading_zeros_of_every_length_of_word(void)
{
    for (unsigned bit = 0; bit < 32u; bit++) {
        uint32_t lowest = (uint32_t)1 << bit;
        TEST_ASSERT_EQUAL_UINT(31u - bit, rdpi_q31_clz(lowest));
        TEST_ASSERT_EQUAL_UINT(31u - bit, rdpi_q31_clz(lowest | (lowest - 1u)));
    }
    for (int k = 0; k < 10000; k++) {
        leading_zeros_of(random_length() | 1u);
    }
}

void test_leading_zeros_of_every_length_of_double_word(void)
{
    for (unsigned bit = 0; bit < 64u; bit++) {
        uint64_t lowest = (uint64_t)1 << bit;
        TEST_ASSERT_EQUAL_UINT(63u - bit, rdpi_q31_clz64(lowest));
        TEST_ASSERT_EQUAL_UINT(63u - bit, rdpi_q31_clz64(lowest | (lowest - 1u)));
    }
}

/* ---- division ---- */

/* 2^63 less the product of a divisor and its reciprocal: from 0 to less than 2^-25 of 2^63. */
static void reciprocal_of(uint32_t divisor)
{
    uint64_t product = (uint64_t)rdpi_q31_reciprocal(divisor) * divisor;
    TEST_ASSERT_TRUE(product <= (uint64_t)1 << 63);
    TEST_ASSERT_TRUE(((uint64_t)1 << 63) - product < (uint64_t)1 << 38);
}

void test_reciprocal_is_never_too_large_and_too_small_by_less_than_it_says(void)
{
    for (uint32_t k = 0; k < 0x8000; k++) { /* both ends of every entry of the table, and in between */
        reciprocal_of((0x8000 + k) << 16);
        reciprocal_of(((0x8000 + k) << 16) | 0xFFFF);
    }
    for (int k = 0; k < 50000; k++) {
        reciprocal_of(random_bits() | (uint32_t)1 << 31);
    }
}

static void quotient_of(int64_t dividend, int32_t divisor)
{
    int64_t exact = dividend / divisor, seen = rdpi_q31_divide(dividend, divisor);
    TEST_ASSERT_TRUE(seen <= exact);
    TEST_ASSERT_TRUE(seen >= exact - 2 - (exact >> 25));
    TEST_ASSERT_TRUE(seen >= 0);
}

void test_quotient_is_below_the_exact_one_by_what_it_says(void)
{
    for (int bit = 24; bit < 31; bit++) {
        const int32_t divisors[] = {(int32_t)1 << bit, (int32_t)(((uint32_t)1 << (bit + 1)) - 1u)};
        for (int k = 0; k < 2; k++) {
            int64_t largest = (int64_t)divisors[k] << 30;
            for (int shift = 0; shift < 62; shift++) {
                quotient_of(largest >> shift, divisors[k]);
                quotient_of((largest >> shift) / 3, divisors[k]);
            }
        }
    }
    for (int k = 0; k < 50000; k++) {
        int32_t divisor = random_between(1 << 24, INT32_MAX);
        quotient_of((int64_t)(random_wide() % ((uint64_t)divisor << 30)), divisor);
    }
}

void test_quotient_of_zero_is_zero(void)
{
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_divide(0, RDPI_Q31_MIN_SLOPE));
    TEST_ASSERT_EQUAL_INT32(0, rdpi_q31_divide(0, INT32_MAX));
}

void test_parts_are_whole_units(void)
{
    for (unsigned parts = 1; parts <= RDPI_MAX_MISSED + 1u; parts++) {
        for (size_t k = 0; k < WORDS; k++) {
            TEST_ASSERT_EQUAL_UINT32(words[k] / parts, rdpi_q31_part(words[k], parts));
        }
        for (int k = 0; k < 2000; k++) {
            uint32_t part = random_bits() / parts, whole = part * parts;
            TEST_ASSERT_EQUAL_UINT32(part, rdpi_q31_part(whole, parts));
            TEST_ASSERT_EQUAL_UINT32(part, rdpi_q31_part(whole + parts - 1u, parts));
        }
    }
}
