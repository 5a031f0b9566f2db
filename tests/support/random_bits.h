/* Random integers for the tests, the same everywhere, if no expression asks for two of them. A test seeds them with
 * random_state before it begins. */
#ifndef RDPI_TEST_RANDOM_BITS_H
#define RDPI_TEST_RANDOM_BITS_H

#include <stdint.h>

static uint64_t random_state = 1;

/* xorshift64*, the upper half. */
static inline uint32_t random_bits(void)
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return (uint32_t)((random_state * 2685821657736338717u) >> 32);
}

/* low .. high */
static inline int32_t random_between(int32_t low, int32_t high)
{
    uint64_t count = (uint64_t)((int64_t)high - low) + 1u;
    return (int32_t)(low + (int64_t)((random_bits() * count) >> 32));
}

/* Every length of word alike. */
static inline uint32_t random_length(void)
{
    uint32_t bits = random_bits();
    return bits >> random_bits() % 32u;
}

/* Within +-limit, and within +-limit / 2, limit / 4, ... limit / 2^shifts alike. */
static inline int32_t random_size(int32_t limit, int32_t shifts)
{
    int32_t size = random_between(-limit, limit);
    return size >> random_between(0, shifts);
}

#endif
