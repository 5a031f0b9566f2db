/* Arithmetic of the library in single precision, and how its functions are compiled. Sibling: q31_math.h. */
#ifndef RDPI_F32_MATH_H
#define RDPI_F32_MATH_H

#if defined(__AVR__) /* avr-libc has no tgmath.h */
#include <math.h>
#else
#include <tgmath.h> /* fabs, isfinite and fma of whichever type rdpi_real_t is; compilers inline them */
#endif

#include <string.h>

#include "crc.h"
#include "rdpi/f32.h"

/* Options that change what the equations mean. Sums that carry what rounding leaves lose all of it when a compiler takes
 * sums for associative: a pole of creep is then wrong by 7 % after ten hours. */
#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "rdpi tells NaN from numbers: compile it without -ffast-math and -ffinite-math-only"
#endif
#if defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__)
#error "rdpi needs sums and quotients as written: compile it without -funsafe-math-optimizations and -freciprocal-math"
#endif
#if defined(__clang__) /* does not say which options it was given, but leaves them out on request */
#if __clang_major__ >= 11
#pragma clang diagnostic push
#pragma clang diagnostic ignored "-Wignored-pragmas" /* some targets know the last one only */
#pragma float_control(precise, on)
#pragma STDC FP_CONTRACT DEFAULT /* as the options say: the line above turned it on */
#pragma clang fp reassociate(off)
#pragma clang diagnostic pop
#endif
#elif defined(__GNUC__) && __GNUC__ < 12 /* likewise */
#pragma GCC optimize("no-associative-math,no-reciprocal-math")
#endif

#if defined(__AVR__) && __SIZEOF_DOUBLE__ != __SIZEOF_FLOAT__
#error "compile it without -mdouble=64: fabs of math.h would compute in double precision"
#endif

/* How much of the quick way of the step is compiled: see rdpi/f32.h.
 *
 * - 0: none.
 * - 1: a step that the quick way does not serve takes the long way, as if there were no other.
 * - 2: such a step goes on from what is known already, in functions of its own. */
#if !defined(RDPI_QUICK_STEP)
#if defined(__OPTIMIZE_SIZE__)
#define RDPI_QUICK_STEP 1
#else
#define RDPI_QUICK_STEP 2
#endif
#endif

/* Relative. States and parameters that were printed, parsed or read back are rounded, and must pass. */
#define ROUNDING ((rdpi_real_t)1e-5)

/* The largest magnitude of a number. Below it, no sum or product of the step can overflow. */
#define MAX_NUMBER ((rdpi_real_t)1e7)

/* How a function is compiled:
 *
 * - SELDOM: apart from its callers, whose usual way must not pay for it;
 * - HOT: within its callers;
 * - SHARED: once in the program if size counts, within its callers if time does. */
#if !defined(__GNUC__) || !defined(__OPTIMIZE__)
#define RDPI_F32_SELDOM
#define RDPI_F32_HOT inline
#define RDPI_F32_SHARED inline
#elif RDPI_QUICK_STEP > 1
#define RDPI_F32_SELDOM __attribute__((noinline))
#define RDPI_F32_HOT inline __attribute__((always_inline))
#define RDPI_F32_SHARED RDPI_F32_HOT
#else
#if RDPI_QUICK_STEP > 0
#define RDPI_F32_SELDOM __attribute__((noinline))
#else
#define RDPI_F32_SELDOM
#endif
#define RDPI_F32_HOT inline
#define RDPI_F32_SHARED __attribute__((noinline, unused))
#endif

/* A condition that seldom holds: the compiler puts what follows aside. */
#if defined(__GNUC__)
#define RDPI_F32_RARE(condition) (__builtin_expect((condition), 0) != 0)
#else
#define RDPI_F32_RARE(condition) (condition)
#endif

/* a b + c, in one instruction if the core has one. Never a call of libm, which compilers make of it unless they
 * optimise. */
static inline rdpi_real_t rdpi_f32_fma(rdpi_real_t a, rdpi_real_t b, rdpi_real_t c)
{
#if defined(__FP_FAST_FMAF) && defined(__OPTIMIZE__)
    return fma(a, b, c);
#else
    return a * b + c;
#endif
}

/* Continues the checksum `crc` over the bits of a number, the lowest first. */
static inline uint32_t rdpi_f32_crc32(uint32_t crc, rdpi_real_t value)
{
    uint32_t word;
    uint64_t words = 0;
    const void *bits = &value;
    if (sizeof value == sizeof word) {
        (void)memcpy(&word, bits, sizeof word);
        return rdpi_crc32(crc, word);
    }
    (void)memcpy(&words, bits, sizeof value < sizeof words ? sizeof value : sizeof words);
    return rdpi_crc32_wide(crc, words);
}

static RDPI_F32_SHARED rdpi_real_t rdpi_f32_clamp(rdpi_real_t value, rdpi_real_t low, rdpi_real_t high)
{
    return value > low ? (value < high ? value : high) : low;
}

#endif
