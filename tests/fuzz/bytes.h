/* What the fuzzers share: the input as a stream of values, and a check that stops with file and line. */
#ifndef BYTES_H
#define BYTES_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(condition) \
    ((condition) ? (void)0 \
                 : (fprintf(stderr, "%s:%d: error: not true: %s\n", __FILE__, __LINE__, #condition), abort()))

/* Inputs that init has accepted: where there are none, nothing else has been fuzzed. run.sh looks for the line. */
static unsigned long accepted;

static inline void print_accepted(void)
{
    fprintf(stderr, "accepted: %lu\n", accepted);
}

static inline void count_accepted(void)
{
    if (accepted++ == 0) {
        (void)atexit(print_accepted);
    }
}

static const uint8_t *input;
static size_t input_left;

/* The next bytes of the input; zeros when it is used up. */
static void take(void *value, size_t size)
{
    size_t available = size < input_left ? size : input_left;
    memset(value, 0, size);
    if (available > 0) {
        memcpy(value, input, available);
        input += available;
        input_left -= available;
    }
}

static inline uint8_t take_u8(void)
{
    uint8_t value;
    take(&value, sizeof value);
    return value;
}

static inline uint16_t take_u16(void)
{
    uint16_t value;
    take(&value, sizeof value);
    return value;
}

static inline uint32_t take_u32(void)
{
    uint32_t value;
    take(&value, sizeof value);
    return value;
}

/* Evenly from 0 to 1, both included. */
static inline double take_share(void)
{
    return take_u16() / 65535.0;
}

static inline double take_between(double low, double high)
{
    return low + (high - low) * take_share();
}

#endif
