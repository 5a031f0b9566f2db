/* The CRC-32 of zlib for the tests, byte by byte, as the standard writes it: what the digests of the library are compared
 * with, and a fingerprint of results. Shares nothing with lib/src/crc.h. */
#ifndef RDPI_TEST_CHECKSUM_H
#define RDPI_TEST_CHECKSUM_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* Continues `crc` over `bytes` bytes of a number, the lowest first, whatever the order in memory is. */
static inline uint32_t checksum_number(uint32_t crc, uint64_t number, size_t bytes)
{
    crc ^= UINT32_MAX;
    for (; bytes > 0; bytes--) {
        for (unsigned bit = 0; bit < 8; bit++) {
            uint32_t odd = (crc ^ (uint32_t)number) & 1u;
            crc = odd != 0 ? (crc >> 1) ^ 0xEDB88320u : crc >> 1;
            number >>= 1;
        }
    }
    return crc ^ UINT32_MAX;
}

/* ... over the bits of `count` numbers in memory, of `size` bytes each: 1, 2, 4 or 8. */
static inline uint32_t checksum_numbers(uint32_t crc, const void *numbers, size_t count, size_t size)
{
    const unsigned char *at = numbers;
    for (; count > 0; count--) {
        uint8_t one = 0;
        uint16_t two = 0;
        uint32_t four = 0;
        uint64_t eight = 0;
        memcpy(size == 1 ? (void *)&one : size == 2 ? (void *)&two : size == 4 ? (void *)&four : (void *)&eight, at, size);
        crc = checksum_number(crc, size == 1 ? one : size == 2 ? two : size == 4 ? four : eight, size);
        at += size;
    }
    return crc;
}

#endif
