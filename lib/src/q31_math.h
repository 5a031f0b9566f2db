/* Arithmetic of the library in fixed point, and how its functions are compiled. Sibling: f32_math.h. Each line is one
 * to three instructions on cores with a long multiply, and some twenty on others. Nothing is divided. Right shifts of
 * negative numbers are arithmetic, as on every compiler for the targets; rdpi_q31.c asserts it. */
#ifndef RDPI_Q31_MATH_H
#define RDPI_Q31_MATH_H

#include "rdpi/q31.h"

/* Cores that multiply 32 by 32 bits to 32 bits only. Their compilers call a routine for 64 by 64. */
#if defined(RDPI_Q31_PORTABLE) || defined(__ARM_ARCH_6M__) || defined(__ARM_ARCH_8M_BASE__)
#define RDPI_Q31_HALVES 1
#else
#define RDPI_Q31_HALVES 0
#endif

/* SELDOM: code that most steps do not need, kept apart from its callers. */
#if defined(__GNUC__)
#define RDPI_Q31_SELDOM __attribute__((noinline, unused))
#else
#define RDPI_Q31_SELDOM inline
#endif

/* HOT: code that gains from what the compiler knows where it is used; within its callers unless size counts. */
#if defined(__GNUC__) && !defined(__OPTIMIZE_SIZE__)
#define RDPI_Q31_HOT inline __attribute__((always_inline))
#else
#define RDPI_Q31_HOT inline
#endif

static inline int32_t rdpi_q31_clamp(int64_t value, int32_t low, int32_t high)
{
    return value < low ? low : (value > high ? high : (int32_t)value);
}

/* A drive times 2^32: slopes need the fractions. */
static inline int64_t rdpi_q31_widen(int32_t drive)
{
    return drive * ((int64_t)1 << 32);
}

/* The same number, as one of which the compiler knows nothing. On cores with a long multiply, gcc would widen a factor
 * early, share it between products, and then multiply 64 by 64 bits. It does not do so with a new number. */
static inline int32_t rdpi_q31_fresh(int32_t number)
{
#if defined(__ARM_ARCH) && defined(__GNUC__)
    __asm__("" : "+r"(number));
#endif
    return number;
}

/* a b */
static inline int64_t rdpi_q31_mul(int32_t a, int32_t b)
{
#if RDPI_Q31_HALVES
    int32_t a_low = a & 0xFFFF, a_high = a >> 16;
    int32_t b_low = b & 0xFFFF, b_high = b >> 16;
    int32_t middle = a_high * b_low + (int32_t)(((uint32_t)a_low * (uint32_t)b_low) >> 16);
    int32_t other = a_low * b_high + (middle & 0xFFFF);
    int32_t high = a_high * b_high + (middle >> 16) + (other >> 16);
    return (int64_t)(((uint64_t)(uint32_t)high << 32) | ((uint32_t)a * (uint32_t)b));
#else
    return (int64_t)rdpi_q31_fresh(a) * b;
#endif
}

/* a rate, for rates 0 .. RDPI_Q31_ONE. Both ends are common. */
static inline int64_t rdpi_q31_mul_rate(int32_t a, int32_t rate)
{
#if RDPI_Q31_HALVES
    if (rate == 0) {
        return 0;
    }
    if (rate == RDPI_Q31_ONE) {
        return (int64_t)a * ((int64_t)1 << 30);
    }
#endif
    return rdpi_q31_mul(a, rate);
}

/* The high word of a product. */
static inline uint32_t rdpi_q31_mulh(uint32_t a, uint32_t b)
{
#if RDPI_Q31_HALVES
    uint32_t a_low = a & 0xFFFFu, a_high = a >> 16;
    uint32_t b_low = b & 0xFFFFu, b_high = b >> 16;
    uint32_t middle = a_high * b_low + ((a_low * b_low) >> 16);
    uint32_t other = a_low * b_high + (middle & 0xFFFFu);
    return a_high * b_high + (middle >> 16) + (other >> 16);
#else
    return (uint32_t)(((uint64_t)a * b) >> 32);
#endif
}

/* floor(whole / parts), parts 1 .. RDPI_MAX_MISSED + 1. */
static inline uint32_t rdpi_q31_part(uint32_t whole, unsigned parts)
{
#if RDPI_Q31_HALVES
#define RDPI_Q31_PER(parts) (UINT32_MAX / (parts) + 1u) /* 2^32 / parts, rounded up */
    static const uint32_t per[RDPI_MAX_MISSED + 2u] = {
        0, 0, RDPI_Q31_PER(2u), RDPI_Q31_PER(3u), RDPI_Q31_PER(4u), RDPI_Q31_PER(5u), RDPI_Q31_PER(6u),
        RDPI_Q31_PER(7u), RDPI_Q31_PER(8u), RDPI_Q31_PER(9u), RDPI_Q31_PER(10u), RDPI_Q31_PER(11u), RDPI_Q31_PER(12u),
        RDPI_Q31_PER(13u), RDPI_Q31_PER(14u), RDPI_Q31_PER(15u), RDPI_Q31_PER(16u), RDPI_Q31_PER(17u)};
    if (parts == 1u) {
        return whole;
    }
    uint32_t part = rdpi_q31_mulh(whole, per[parts]); /* or 1 too large */
    return whole - part * parts < parts ? part : part - 1u;
#else
    return whole / parts;
#endif
}

/* floor(a b / 2^32) for a 64-bit a. */
static inline int64_t rdpi_q31_mul_wide(int64_t a, uint32_t b)
{
    return (a >> 32) * (int64_t)b + (int64_t)(((uint64_t)(uint32_t)a * b) >> 32);
}

/* The number of leading zeros of a value > 0. */
static inline unsigned rdpi_q31_clz(uint32_t value)
{
#if defined(__GNUC__) && !defined(RDPI_Q31_PORTABLE) && __SIZEOF_INT__ == 4 /* an unsigned, of 16 bits on an AVR */
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

/* 2^63 / divisor for divisor >= 2^31, too small by less than 2^-25 of itself. Seven bits come from a table; each of two
 * steps of Newton's iteration doubles them. */
static inline uint32_t rdpi_q31_reciprocal(uint32_t divisor)
{
    /* 2^40 / divisor - 256, in the middle of each of 64 intervals */
    static const uint8_t table[64] = {
        252, 244, 237, 229, 222, 215, 209, 202, 196, 190, 184, 178, 172, 167, 161, 156, 151, 146, 141, 136, 132,
        127, 123, 118, 114, 110, 106, 102, 98, 94, 91, 87, 84, 80, 77, 73, 70, 67, 64, 61, 58, 55, 52, 49, 46, 43,
        41, 38, 35, 33, 30, 28, 25, 23, 21, 18, 16, 14, 11, 9, 7, 5, 3, 1};
    uint32_t guess = 256u + table[(divisor >> 25) & 63u];
    int32_t missing = (int32_t)(~(guess * ((divisor >> 9) + 1u)) ^ (uint32_t)1 << 31); /* of 2^31 */
    guess = (guess << 23) + ((uint32_t)(((int32_t)guess * (missing >> 9)) >> 15) << 16);
    uint32_t still = ~rdpi_q31_mulh(divisor, guess) ^ (uint32_t)1 << 31; /* of 2^31, never too much */
    return guess + rdpi_q31_mulh(guess, still << 1);
}

/* dividend / divisor for 0 <= dividend <= divisor 2^30 and divisor >= 2^24. Below the quotient by less than 2 and 2^-25
 * of itself. */
static inline int32_t rdpi_q31_divide(int64_t dividend, int32_t divisor)
{
    unsigned shift = rdpi_q31_clz((uint32_t)divisor); /* 1 .. 7 */
    uint32_t high = (uint32_t)((uint64_t)dividend >> 32), low = (uint32_t)dividend;
    uint32_t head = (high << (shift + 1u)) | (low >> (31u - shift)); /* <= 2^31 */
    return (int32_t)rdpi_q31_mulh(head, rdpi_q31_reciprocal((uint32_t)divisor << shift));
}

#endif
