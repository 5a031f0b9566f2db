/** @file
 * What the driver of a DAC on the I2C needs of a board: a master that sends some bytes to an address and a way to ask
 * what became of them. A board with a DAC of its own, or with one on the SPI, needs none of it. tests/unit mocks this
 * header.
 *
 *     bits      7 of address, then the bytes, most significant first; the master sends START, address and write bit, the
 *               bytes, STOP, and looks at the acknowledge bit of each
 *     SCL       400 kHz at most, if the board does not set up the high-speed mode of the bus (3.4 MHz)
 *     pull-ups  SDA and SCL need resistors; many breakout boards have them
 *
 * A sample costs 29 clocks: 73 us at 400 kHz, 0.29 ms at the 100 kHz that an Arduino's Wire begins with.
 *
 * An Arduino implements both functions with Wire (lib/packaging/README.md has them). Wire waits for interrupts of its own:
 * IN AN INTERRUPT IT HANGS FOR EVER. There the driver is called from loop, when a timer's interrupt has set a flag. */
#ifndef RDPI_I2C_H
#define RDPI_I2C_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** What became of the latest transfer. */
typedef enum {
    RDPI_I2C_DONE,  /**< every byte was acknowledged, or there was no transfer yet */
    RDPI_I2C_BUSY,  /**< it is still running */
    RDPI_I2C_FAILED /**< no acknowledge, another master, or a bus that did not become free in time */
} rdpi_i2c_state_t;

/** Starts to send `count` bytes, one to three, to a 7-bit address. The bytes stay as they are while rdpi_i2c_state returns
 * RDPI_I2C_BUSY, so they may be sent from where they are, by DMA too. On a core with a data cache, clean the cache first
 * (README.md, "Cache and DMA"). A board without interrupt or DMA for it returns when the transfer has ended; every wait
 * must have a limit.
 *
 * Called by the driver, only while rdpi_i2c_state does not return RDPI_I2C_BUSY, in the context in which the driver is
 * called. */
void rdpi_i2c_write(uint8_t address, const uint8_t *bytes, size_t count);

/** What became of the latest transfer; the same answer until the next begins. Returns at once; any context. */
rdpi_i2c_state_t rdpi_i2c_state(void);

#ifdef __cplusplus
}
#endif
#endif
