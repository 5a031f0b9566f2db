// rdpi_q31_reciprocal for every divisor that there is, 2^31 of them, and what follows for rdpi_q31_divide.
//
// With R the reciprocal of D = divisor 2^shift, the loop shows R D <= 2^63 and 2^63 - R D < 2^38. That is all that a
// quotient q = dividend / divisor needs. Let 0 <= dividend < divisor 2^31.
//   head = floor(q D / 2^31) < 2^32, so no bit is lost.
//   head R / 2^32 <= (q D / 2^31) (2^63 / D) / 2^32 = q: the result is never above the quotient.
//   head > q D / 2^31 - 1 and R > (1 - 2^-25) 2^63 / D, so head R / 2^32 > q - 2^-25 q - 1, and its floor is above
//   q - 2^-25 q - 2: the error is below 2 and 2^-25 of the quotient.
// Random dividends, and those at the ends, are put to rdpi_q31_divide itself.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <random>

#include "q31_math.h"

static void fail(const char *what, unsigned long long a, unsigned long long b)
{
    std::printf("q31_divide: %s: %llu, %llu\n", what, a, b);
    std::exit(1);
}

static void divide(std::int64_t dividend, std::int32_t divisor)
{
    using Wide = __int128;
    const std::int32_t quotient = rdpi_q31_divide(dividend, divisor);
    const Wide left = dividend - Wide(quotient) * divisor; // of the dividend
    if (left < 0) {
        fail("above the quotient", dividend, divisor);
    }
    if (left * (1 << 25) >= Wide(divisor) * (2 << 25) + dividend) {
        fail("too far below the quotient", dividend, divisor);
    }
}

int main()
{
    const std::uint64_t whole = std::uint64_t(1) << 63, off = std::uint64_t(1) << 38;
    std::uint32_t divisor = std::uint32_t(1) << 31;
    do {
        const std::uint64_t missing = whole - std::uint64_t(rdpi_q31_reciprocal(divisor)) * divisor;
        if (missing >= off) { // also where it is above: then it wraps
            fail("reciprocal of", divisor, missing);
        }
    } while (++divisor != 0);
    std::mt19937_64 random(1);
    for (int k = 0; k < 10000000; k++) {
        const std::int32_t bits = 24 + std::int32_t(random() % 7);
        const std::int32_t slope = (1 << bits) + std::int32_t(random() % (std::uint64_t(1) << bits));
        const std::uint64_t most = std::uint64_t(slope) << 31, any = random() % most, small = any >> random() % 62;
        for (std::uint64_t dividend : {any, small, most - 1 - small, any / slope * slope, any / slope * slope + slope - 1}) {
            divide(std::int64_t(dividend), slope);
        }
    }
    std::printf("q31_divide: 2^31 reciprocals, 5 10^7 quotients\n");
    return 0;
}
