/* Codes that the processor writes and a DMA reads, on a core with a data cache (Cortex-M7, M55, M85) as on one without.
 *
 * The cache keeps what the processor has written; memory gets it some time later. A DMA reads memory: without care the
 * DAC outputs the codes of the round before. So declare the buffer with DMA_BUFFER, and call dma_publish for each part
 * that was written:
 *
 *     static uint32_t codes[32] DMA_BUFFER;
 *     codes[k] = ...;
 *     dma_publish(codes, sizeof codes);
 *
 * DMA_BUFFER begins a line of the cache. Let the size be a multiple of DMA_LINE bytes too: a line is written back whole,
 * and what another DMA has written beside the codes would be lost.
 *
 * Or switch the cache off for the buffer: in a region that the MPU makes non-cacheable dma_publish is not needed. Or put
 * the buffer into memory that is never cached; the DTCM of an M7 is such, but few DMAs reach it.
 *
 * Include the chip's CMSIS header first (stm32h7xx.h and the like). It defines __DCACHE_PRESENT where there is a cache,
 * and SCB_CleanDCache_by_Addr. Where there is neither CMSIS nor a cache, define __DCACHE_PRESENT as 0U. */
#ifndef DMA_H
#define DMA_H

#include <stddef.h>
#include <stdint.h>

#if (defined(__ARM_ARCH_7EM__) || defined(__ARM_ARCH_8_1M_MAIN__)) && !defined(__CORTEX_M) && !defined(__DCACHE_PRESENT)
#error "include the chip's CMSIS header before dma.h: it says whether the core has a data cache"
#endif

#define DMA_LINE 32u /* bytes of a line of the cache */
#define DMA_BUFFER __attribute__((aligned(32)))

/* Makes a DMA that reads from now on see what was written to these bytes. Any context. The time grows with the lines; on a core without a cache it is none. */
static inline void dma_publish(const void *start, size_t bytes)
{
#if defined(__DCACHE_PRESENT) && __DCACHE_PRESENT == 1U
    uintptr_t first = (uintptr_t)start & ~(uintptr_t)(DMA_LINE - 1u); /* older CMSIS wants the beginning of a line */
    SCB_CleanDCache_by_Addr((uint32_t *)first, (int32_t)((uintptr_t)start - first + bytes));
#else
    (void)start;
    (void)bytes;
#endif
}

#endif
