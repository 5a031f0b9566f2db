/* The checksum of parameters in flash: CRC-32 as in zlib, Ethernet and PNG. It takes whole words by value, the lowest
 * byte first. So it is the same on every machine, whatever the order of bytes in memory and the padding of structs. It is
 * computed bit by bit: it runs once, and a table would take more flash than all of init. */
#ifndef RDPI_CRC_H
#define RDPI_CRC_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* Continues `crc`, the result so far (0 at the beginning), over four bytes. */
static inline uint32_t rdpi_crc32(uint32_t crc, uint32_t word)
{
    crc = ~(crc ^ word);
    for (unsigned bit = 0; bit < 32u; bit++) {
        crc = (crc & 1u) != 0u ? (crc >> 1) ^ 0xEDB88320u : crc >> 1;
    }
    return ~crc;
}

/* Continues `crc` over eight bytes. */
static inline uint32_t rdpi_crc32_wide(uint32_t crc, uint64_t words)
{
    return rdpi_crc32(rdpi_crc32(crc, (uint32_t)words), (uint32_t)(words >> 32));
}

/* Continues `crc` over a block of memory that holds nothing but numbers of 32 bits. */
static inline uint32_t rdpi_crc32_block(uint32_t crc, const void *block, size_t bytes)
{
    for (size_t offset = 0; offset < bytes; offset += sizeof(uint32_t)) {
        uint32_t word;
        memcpy(&word, (const unsigned char *)block + offset, sizeof word);
        crc = rdpi_crc32(crc, word);
    }
    return crc;
}

#endif
