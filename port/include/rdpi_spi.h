/** @file
 * What a DAC driver in port/drivers needs of a board: an SPI master that sends frames and a way to ask whether it still
 * does. A board with a DAC of its own needs none of it. One DAC per board, so no handle: a second axis is the second
 * channel of a DAC8562 or MCP4922. tests/unit mocks this header.
 *
 * The bus, with room in it: each limit is at least as strict as that of the part (see its header for the sources).
 *
 *                          AD5683R, DAC8562                        MCP4922 and its siblings
 *     clocks per frame     24, no more, no less                    16, no fewer
 *     bits                 8 per byte, most significant first      the same
 *     mode                 1 (CPOL 0, CPHA 1) or 2 (CPOL 1,        0 (CPOL 0, CPHA 0) or 3 (CPOL 1, CPHA 1):
 *                          CPHA 0): sampled on the falling edge    sampled on the rising edge
 *     SCLK                 50 MHz at most, for logic of 2.7 V      20 MHz at most
 *                          and more; 20 MHz is a good value
 *                          where wires leave the board
 *     chip select          low >= 20 ns before the first edge      low >= 40 ns before the first edge that samples,
 *                          that samples, high >= 20 ns after       high >= 20 ns after the last, high >= 40 ns
 *                          the last, high >= 80 ns between frames  between frames
 *     MISO                 not used: no driver reads back
 *
 * In the other two modes every bit is taken half a clock early or late. A rising edge of chip select before the last
 * clock discards the frame.
 *
 * LDAC is not here: it is tied to a level, or a timer's output drives it and no software does (README.md). */
#ifndef RDPI_SPI_H
#define RDPI_SPI_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** Starts to send `frames` frames, one or two, of `frame_bytes` bytes each, two or three, in the order in which they are
 * in memory, and returns without waiting for them. Chip select goes low before each frame and high after it. The bytes
 * stay as they are until rdpi_spi_busy returns false, so they may be sent from where they are, by DMA too. On a core with
 * a data cache, a DMA reads memory that the bytes have not reached yet: clean the cache first (README.md, "Cache and
 * DMA").
 *
 * Called by the drivers, only while rdpi_spi_busy is false: from main before rdpi_port_start, then from the tick, in
 * interrupt context. Two frames must be out before the next tick: at 20 MHz they take 3 us. */
void rdpi_spi_write(const uint8_t *bytes, size_t frame_bytes, size_t frames);

/** True from rdpi_spi_write until chip select has been high for 80 ns after the last frame. Returns at once; any
 * context. A board that sends within rdpi_spi_write, because it has neither FIFO nor DMA, always returns false: its
 * tick is longer by the transfer. */
bool rdpi_spi_busy(void);

#ifdef __cplusplus
}
#endif
#endif
