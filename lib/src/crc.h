/* The checksum of parameters in flash: CRC-32 as in zlib, Ethernet and PNG. It is computed bit by bit: it runs once,
 * and a table would take more flash than all of init. */
#ifndef RDPI_CRC_H
#define RDPI_CRC_H

#include <stddef.h>
#include <stdint.h>

/* Continues `crc`, the result so far (0 at the beginning), over `size` bytes. */
static inline uint32_t rdpi_crc32(uint32_t crc, const void *data, size_t size)
{
    const unsigned char *bytes = data;
    crc = ~crc;
    for (size_t k = 0; k < size; k++) {
        crc ^= bytes[k];
        for (unsigned bit = 0; bit < 8u; bit++) {
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
        }
    }
    return ~crc;
}

#endif
