/* Bytes on their way from one context to another, in order, without a lock: one context puts, one takes, and either may
 * interrupt the other. One core: what one has written the other reads in this order. All 0 at start. */
#ifndef RDPI_RING_H
#define RDPI_RING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifndef RING_BYTES
#define RING_BYTES 1024u /* a power of two; some thirty samples of telemetry */
#endif

typedef struct {
    volatile uint32_t put_count, taken_count; /* bytes since the start, wrapping; each written by one side only */
    volatile uint8_t bytes[RING_BYTES];
} ring_t;

typedef char ring_bytes_check[(RING_BYTES & (RING_BYTES - 1u)) == 0u ? 1 : -1];

/* All of them or none; returns whether there was room. */
static inline bool ring_put(ring_t *self, const uint8_t *bytes, size_t count)
{
    uint32_t end = self->put_count;
    if (count > RING_BYTES - (end - self->taken_count)) {
        return false;
    }
    for (size_t k = 0; k < count; k++) {
        self->bytes[end++ % RING_BYTES] = bytes[k];
    }
    self->put_count = end;
    return true;
}

static inline bool ring_empty(const ring_t *self)
{
    return self->put_count == self->taken_count;
}

/* The oldest byte; false if there is none. */
static inline bool ring_take(ring_t *self, uint8_t *byte)
{
    uint32_t begin = self->taken_count;
    if (begin == self->put_count) {
        return false;
    }
    *byte = self->bytes[begin % RING_BYTES];
    self->taken_count = begin + 1u;
    return true;
}

#endif
