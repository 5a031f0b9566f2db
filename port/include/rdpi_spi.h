/** @file
 * What a DAC driver in port/drivers needs of a board: an SPI master that sends frames and a way to ask whether it still
 * does. A board with a DAC of its own needs none of it. One DAC per board, so no handle: a second axis is the second
 * channel of a DAC8562. tests/unit mocks this header.
 *
 * Both parts take the same bus, with room in it: each limit is the stricter of the two (see dac8562.h and ad5683r.h for
 * the sources).
 *
 *     bits            8 per byte, most significant first; 24 clocks per frame, no more, no less
 *     mode            1 (CPOL 0, CPHA 1) or 2 (CPOL 1, CPHA 0): the DAC samples on the falling edge of SCLK. In
 *                     mode 0 or 3 every bit is taken half a clock early or late
 *     SCLK            50 MHz at most, for logic of 2.7 V and more; 20 MHz is a good value where wires leave the board
 *     chip select     the DAC's SYNC pin: low >= 20 ns before the first falling edge, high >= 20 ns after the last,
 *                     high >= 80 ns between frames. A rising edge before the 24th falling one discards the frame
 *     MISO            not used: neither driver reads back
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

/** Bytes of one frame. */
#define RDPI_SPI_FRAME_BYTES 3

/** Starts to send `frames` frames, one or two, of RDPI_SPI_FRAME_BYTES bytes each, in the order in which they are in
 * memory, and returns without waiting for them. Chip select goes low before each frame and high after it. The bytes
 * stay as they are until rdpi_spi_busy returns false, so they may be sent from where they are, by DMA too.
 *
 * Called by the drivers, only while rdpi_spi_busy is false: from main before rdpi_port_start, then from the tick, in
 * interrupt context. Two frames must be out before the next tick: at 20 MHz they take 3 us. */
void rdpi_spi_write(const uint8_t *bytes, size_t frames);

/** True from rdpi_spi_write until chip select has been high for 80 ns after the last frame. Returns at once; any
 * context. A board that sends within rdpi_spi_write, because it has neither FIFO nor DMA, always returns false: its
 * tick is longer by the transfer. */
bool rdpi_spi_busy(void);

#ifdef __cplusplus
}
#endif
#endif
