/** @file
 * Microchip MCP4725: one channel of 12 bits on the I2C, 0 .. VDD, with a memory (EEPROM) for the code at power up. Above
 * rdpi_i2c.h, which says what the bus must be.
 *
 *     static rdpi_mcp4725_t dac;
 *     static const rdpi_mcp4725_config_t config = {.address = 0x62};
 *
 *     rdpi_mcp4725_init(&dac, &config);                  // in main, before the timer runs
 *     while (!rdpi_mcp4725_start(&dac, code)) { ... }    // the first code: wait 1 ms in here, and give up some time
 *     rdpi_mcp4725_write(&dac, code);                    // in the tick; of an Arduino: in loop, never in an interrupt
 *
 * No function waits, allocates or keeps a static variable; but a board that sends within rdpi_i2c_write makes start and
 * write longer by the transfer. One instance is used from one context at a time: from main until start has returned true,
 * then from the tick. The counters may be read anywhere.
 *
 * FRAMES, as sent behind the address, first byte first. ccc is the code.
 *
 *     bytes      command                                           when                        source
 *     0c cc      fast write: code to the output, power-down off    start, write, safe_frames   [1] 6.1.1, [4] [5] [6]
 *     60 cc c0   code to the output and to the EEPROM              power_up_frame only         [2] [4]
 *
 * The first four bits of a fast write are C2 = C1 = 0, PD1 = PD0 = 0: the output is on. The output changes at the
 * acknowledge bit of the second byte ([3], the same command; [1] has it in a figure that was not at hand).
 * ADDRESS: 1 1 0 0 A2 A1 A0, 0x60 to 0x67. A2 and A1 are set in the factory (MCP4725A0: 0x60, A1: 0x62, A2: 0x64,
 * A3: 0x66), A0 is a pin ([1] 6.0, [7]). Breakout boards have 0x60 or 0x62, and one more with A0 at VDD.
 *
 * [1] Data sheet DS22039D, 2009: pages 21, 23 and 26 were at hand;
 * [2] the same, page 25, figure 6-2;
 * [3] DS22272C, MCP4706/4716/4726, 2012: page 50, figure 6-1. An MCP4726 takes the same two bytes; its reference and gain
 *     stay as its EEPROM has them;
 * [4] Linux, drivers/iio/dac/mcp4725.c: {code >> 8, code} without power-down bits; {0x60, code >> 4, code << 4};
 * [5] github.com/wayoda/micropython-mcp4725: the same two bytes;
 * [6] crate mcp4725 0.4.3 (docs.rs), "two byte fast command", and its register write 40 ff f0 for code fff;
 * [7] github.com/RobTillaart/Arduino, libraries/MCP4725/I2C_Address.md.
 *
 * POWER UP. The output is what the EEPROM holds, and in a new part that is half of VDD ([1] table 5-3: code 800). For a
 * piezo that may be half of its range, at each switching on. rdpi_mcp4725_power_up_frame is there for the one time that
 * the EEPROM is written, on the bench.
 *
 * EEPROM. Neither start nor write touches it. It bears a million writes [3], page 6, and while one runs, up to 50 ms, the
 * part ignores every code ([1] page 21). A loop that writes it holds the output and wears the part out within a day.
 *
 * What the output does. A warm start of the microcontroller changes nothing: the last code stays. Code c is c / 4096 of
 * VDD, which is also the reference: noise of the supply is noise of the drive. */
#ifndef RDPI_MCP4725_H
#define RDPI_MCP4725_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** The largest code. */
#define RDPI_MCP4725_MAX_CODE 4095u

/** Bytes of one frame. */
#define RDPI_MCP4725_FRAME_BYTES 2u

/** How the board is wired. */
typedef struct {
    uint8_t address; /**< 0x60 to 0x67, 7 bits. With any other, start sends nothing and returns false: at address 0 a code
                        could be a command to all parts on the bus */
} rdpi_mcp4725_config_t;

/** One DAC at work. */
typedef struct {
    /* result: counted since init, saturating */
    uint32_t busy_count; /**< writes refused because the one before was still being sent, or start was not done */
    uint32_t code_count; /**< writes refused because of a code above RDPI_MCP4725_MAX_CODE */
    uint32_t fail_count; /**< transfers, of start too, that the DAC has not acknowledged: the output held */
    /* private */
    rdpi_mcp4725_config_t config;
    bool sent;  /**< of the latest transfer it is not known yet how it ended */
    bool ready; /**< start has returned true */
    uint8_t bytes[RDPI_MCP4725_FRAME_BYTES]; /**< what rdpi_i2c_write may still be sending */
} rdpi_mcp4725_t;

/** Prepares `self`, sends nothing. `config` is copied. From main. */
void rdpi_mcp4725_init(rdpi_mcp4725_t *self, const rdpi_mcp4725_config_t *config);

/** Outputs the first code, and sends it again in the next call if the DAC has not acknowledged it. Returns true when it
 * has, and from then on. A DAC that is not there, a code above the limit (code_count) or an address that no MCP4725 has
 * never returns true, so bound the loop. From main, before rdpi_port_start; of an Arduino: in setup. */
bool rdpi_mcp4725_start(rdpi_mcp4725_t *self, uint32_t code);

/** Outputs a code, 0 .. RDPI_MCP4725_MAX_CODE. Starts the transfer of two bytes and returns: true, or false if the output
 * holds: because the transfer before is still running or start is not done (busy_count), because the code is above the
 * limit (code_count): it is neither clipped nor wrapped, because such a code is no drive that anybody computed, or because
 * the DAC has not acknowledged it (fail_count). Busy goes before code. A board that sends after rdpi_i2c_write has
 * returned learns of a failure one write later: that write is sent, and fail_count has gone up. Time is bounded. */
bool rdpi_mcp4725_write(rdpi_mcp4725_t *self, uint32_t code);

/** Bytes that rdpi_mcp4725_safe_frames writes. */
#define RDPI_MCP4725_SAFE_BYTES 2

/** The frame of a code, for rdpi_port_safe, which sends it itself, because after a fault neither an rdpi_mcp4725_t nor an
 * interrupt can be trusted; nothing is sent here. A transfer that the fault has cut must be ended first: clock SCL until
 * SDA is high, nine times at most, then STOP. Any context. */
void rdpi_mcp4725_safe_frames(uint32_t code, uint8_t *bytes);

/** Bytes that rdpi_mcp4725_power_up_frame writes. */
#define RDPI_MCP4725_POWER_UP_BYTES 3

/** The frame that makes a code that of power up, now and whenever VDD comes back; nothing is sent here. Send it once, on
 * the bench, by a program that does nothing else, with the amplifier off: rdpi_i2c_write(address, bytes,
 * RDPI_MCP4725_POWER_UP_BYTES). The part needs up to 50 ms and ignores everything meanwhile. */
void rdpi_mcp4725_power_up_frame(uint32_t code, uint8_t *bytes);

#ifdef __cplusplus
}
#endif
#endif
