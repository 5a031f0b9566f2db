/* q31_blend.h against libm. */
#include "unity.h"

#include <math.h>

#include "q31_blend.h"
#include "random_bits.h"

void setUp(void)
{
    random_state = 7;
}

void tearDown(void)
{
}

static double value(rdpi_q31_scaled_t scaled)
{
    return ldexp(scaled.mantissa > 0u ? scaled.mantissa : ldexp(1, 32), -scaled.exponent);
}

static void ratio_is_near(uint64_t a, uint64_t b)
{
    rdpi_q31_scaled_t ratio = rdpi_q31_ratio(a, b);
    double exact = (double)a / (double)b;
    TEST_ASSERT_DOUBLE_WITHIN(ldexp(exact, -30), exact, value(ratio));
    TEST_ASSERT_TRUE(ratio.mantissa >= (uint32_t)1 << 30);
}

void test_ratio(void)
{
    ratio_is_near(1, 1);
    ratio_is_near(1, UINT64_MAX);
    ratio_is_near(UINT64_MAX, 1);
    ratio_is_near(UINT64_MAX, UINT64_MAX);
    for (int k = 0; k < 10000; k++) {
        uint64_t a = ((uint64_t)random_bits() << 32 | random_bits()) >> random_between(0, 63);
        uint64_t b = ((uint64_t)random_bits() << 32 | random_bits()) >> random_between(0, 63);
        ratio_is_near(a | 1u, b | 1u);
    }
}

void test_blend_is_that_of_libm(void)
{
    for (int exponent = -32; exponent <= 94; exponent++) {
        for (int k = 0; k < 100; k++) {
            rdpi_q31_scaled_t u = {(uint32_t)1 << 30 | random_bits(), exponent};
            double exact = -expm1(-value(u));
            TEST_ASSERT_DOUBLE_WITHIN(ldexp(exact, -27), exact, value(rdpi_q31_blend(u)));
        }
    }
}
