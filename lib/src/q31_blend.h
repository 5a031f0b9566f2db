/* The blend of a first-order low-pass, in integers. Only init and missed samples use it. */
#ifndef RDPI_Q31_BLEND_H
#define RDPI_Q31_BLEND_H

#include "q31_math.h"

/* mantissa 2^-exponent */
typedef struct {
    uint32_t mantissa;
    int exponent;
} rdpi_q31_scaled_t;

/* a / b for a > 0 and b > 0, within 2^-30 of itself. The mantissa is >= 2^30, the exponent -32 .. 94. */
static inline rdpi_q31_scaled_t rdpi_q31_ratio(uint64_t a, uint64_t b)
{
    unsigned zeros_a = rdpi_q31_clz64(a), zeros_b = rdpi_q31_clz64(b);
    uint32_t divisor = (uint32_t)((b << zeros_b) >> 32);
    rdpi_q31_scaled_t ratio = {(uint32_t)(((a << zeros_a) >> 1) / divisor), 31 + (int)zeros_a - (int)zeros_b};
    return ratio;
}

/* E = 1 - exp(-u) for a u > 0 whose mantissa is >= 2^30, within 2^-27 of itself: a series where u is small, then
 * E(2 u) = E (2 - E). The mantissa of 2 E is that of E, so a doubling of u is one subtraction. The exponent is that of
 * u, or 32 if that is less. The mantissa is 0 where E is 1. */
static inline rdpi_q31_scaled_t rdpi_q31_blend(rdpi_q31_scaled_t u)
{
    if (u.exponent < 25) { /* u >= 64 */
        rdpi_q31_scaled_t one = {0, 32};
        return one;
    }
    if (u.exponent > 63) { /* E differs from u by less than 2^-31 of itself */
        return u;
    }
    uint32_t mantissa = u.mantissa;
    unsigned last = (unsigned)u.exponent;
    unsigned exponent = last < 44u ? 44u : last; /* begin at u < 2^-12 */
    uint32_t inner = UINT32_MAX - ((mantissa / 3u) >> (exponent - 32u)); /* 1 - u / 3 */
    uint64_t half_square = ((uint64_t)mantissa * mantissa) >> 33;        /* u^2 / 2 */
    mantissa -= (uint32_t)(((half_square * inner) >> 32) >> (exponent - 32u));
    for (; exponent > last && exponent > 32u; exponent--) {
        mantissa -= (uint32_t)((((uint64_t)mantissa * mantissa) >> 1) >> exponent);
    }
    uint32_t kept = 0u - mantissa; /* if exponent is 32: exp(-u), whose error shrinks as it is squared */
    for (; exponent > last; last++) {
        kept = rdpi_q31_mulh(kept, kept);
        mantissa = 0u - kept; /* 0: kept is less than 2^-32 */
    }
    rdpi_q31_scaled_t blend = {mantissa, (int)exponent};
    return blend;
}

#endif
