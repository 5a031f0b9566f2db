/* Arithmetic of the fixed-point library. On cores with a long multiply these lines are one to three instructions each.
 * Right shifts of negative numbers are arithmetic, as every compiler for the targets has it and rdpi_q31.c asserts. */
#ifndef RDPI_Q31_MATH_H
#define RDPI_Q31_MATH_H

#include "rdpi/q31.h"

static inline int32_t rdpi_q31_clamp(int64_t value, int32_t low, int32_t high)
{
    return value < low ? low : (value > high ? high : (int32_t)value);
}

/* High word of a product. */
static inline uint32_t rdpi_q31_mulh(uint32_t a, uint32_t b)
{
    return (uint32_t)(((uint64_t)a * b) >> 32);
}

/* floor(a b / 2^32) for a 64-bit a. */
static inline int64_t rdpi_q31_mul_wide(int64_t a, uint32_t b)
{
    return (a >> 32) * (int64_t)b + (int64_t)(((uint64_t)(uint32_t)a * b) >> 32);
}

/* Leading zeros of value > 0. */
static inline unsigned rdpi_q31_clz(uint32_t value)
{
#if defined(__GNUC__) && !defined(RDPI_Q31_PORTABLE)
    return (unsigned)__builtin_clz(value);
#else
    unsigned zeros = 0;
    for (unsigned half = 16; half > 0u; half /= 2u) {
        if (value < (uint32_t)1 << (32u - half)) {
            value <<= half;
            zeros += half;
        }
    }
    return zeros;
#endif
}

static inline unsigned rdpi_q31_clz64(uint64_t value)
{
    uint32_t high = (uint32_t)(value >> 32);
    return high != 0u ? rdpi_q31_clz(high) : 32u + rdpi_q31_clz((uint32_t)value);
}

/* 2^63 / divisor for divisor >= 2^31, too small by less than 2^-28 of itself: 16 bits by the division that cores
 * have, doubled by one step of Newton's iteration. */
static inline uint32_t rdpi_q31_reciprocal(uint32_t divisor)
{
    uint32_t guess = (UINT32_MAX / ((divisor >> 16) + 1u)) << 15;
    uint32_t missing = INT32_MAX - rdpi_q31_mulh(divisor, guess); /* of 2^31, and not too much */
    return guess + rdpi_q31_mulh(guess, missing << 1);
}

/* dividend / divisor, dividend >= 0, divisor > 0: within 4 below the quotient; INT32_MAX if that is more than 2^30. */
static inline int32_t rdpi_q31_divide(int64_t dividend, int32_t divisor)
{
    if (dividend > (int64_t)divisor << 30) {
        return INT32_MAX;
    }
    unsigned shift = rdpi_q31_clz((uint32_t)divisor);
    uint32_t reciprocal = rdpi_q31_reciprocal((uint32_t)divisor << shift);
    uint32_t head = (uint32_t)((uint64_t)dividend >> (31u - shift)); /* <= 2^31 */
    return (int32_t)rdpi_q31_mulh(head, reciprocal);
}

#endif
