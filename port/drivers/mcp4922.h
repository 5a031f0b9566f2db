/** @file
 * Microchip MCP4922: two channels of 12 bits, external reference, outputs off at power up. Above rdpi_spi.h, which says
 * what the bus must be: SPI mode 0 or 3, 16 clocks per frame.
 *
 *     static rdpi_mcp4922_t dac;
 *     static const rdpi_mcp4922_config_t config = {.gain_2 = false};  // 0 .. Vref
 *
 *     rdpi_mcp4922_init(&dac, &config);             // in main, before the timer runs
 *     rdpi_mcp4922_write(&dac, code_x, code_y);     // in main once, then in the tick
 *
 * There is no start: every frame holds the whole configuration, and the part has no reset. No function waits, allocates
 * or keeps a static variable. One instance is used from one context at a time: from main until the timer runs, then from
 * the tick. The counters may be read anywhere.
 *
 * FRAMES, as sent, first byte first. 16 bits: bit 15 is the channel (0: A), 14 the buffer of the reference input (1: on),
 * 13 the gain (1: 1, 0: 2), 12 the output (1: on, 0: off), 11 .. 0 the code. ccc is the code.
 *
 *     bytes   channel  reference   gain   when                            source
 *     3c cc   A        unbuffered  1      write 1st, write_channel A      [1] [3] [4] [5]
 *     bc cc   B        unbuffered  1      write 2nd, write_channel B      [1] [4] [5]
 *     1c cc   A        unbuffered  2      the same, gain_2                [3] [5] [6]
 *     9c cc   B        unbuffered  2      the same, gain_2                [3] [5] [6]
 *     7c cc   A        buffered    1      the same, buffered              [3] [5] [6]
 *     fc cc   B        buffered    1      the same, buffered              [3] [5] [6]
 *     5c cc   A        buffered    2      the same, both                  [3] [5] [6]
 *     dc cc   B        buffered    2      the same, both                  [3] [5] [6]
 *
 * [1] Data sheet DS21897A, MCP4921/4922, 2004: page 18 (16 bits, four of configuration first; fewer than 16 clocks load
 *     nothing; modes 0,0 and 1,1) and page 6 (timing). The page with register 5-1 was not at hand;
 * [2] DS22250A, MCP4902/4912/4922, 2010: page 7, the same timing;
 * [3] DS22248A, MCP4901/4911/4921, 2010: page 20 (GA 1: gain 1, 0: gain 2; BUF 0: unbuffered);
 * [4] Linux, drivers/iio/dac/mcp4922.c: first byte 0x30 or 0xb0, with the upper four bits of the code;
 * [5] github.com/nonolith/CEE, firmware/hardware.h: channel 8, buffer 4, gain 1 2, enable 1, of the upper four bits;
 * [6] github.com/shimamoo/MCP492X (Arduino): the order !A/B, BUF, !GA, !SHDN;
 * [7] DS22244B, MCP4801/4811/4821, 2010: page 22, register 5-1, and DS22249A, MCP4802/4812/4822, 2010: page 21.
 *
 * SIBLINGS. An MCP4921 has channel A only: rdpi_mcp4922_write_channel with RDPI_MCP4922_A. It ignores frames with bit 15
 * set ([7] of the MCP4821). MCP4821 and MCP4822 have a reference of 2.048 V inside and ignore bit 14: the same frames,
 * 0 .. 2.048 V or, with gain_2, 0 .. 4.096 V [7].
 *
 * Timing [1] [2]: SCK 20 MHz; high and low 15 ns each; CS low 40 ns before the first rising edge if it fell while SCK was
 * high, high 15 ns after the last, high 15 ns; SCK idle 40 ns before CS falls; LDAC low 100 ns, 40 ns after CS has risen.
 *
 * LDAC. No frame updates both outputs. Tied low, each output changes at the end of its frame: one axis works, two change
 * a frame apart. Driven by a timer's output, both change at its falling edge, without the jitter of software. The frames
 * are the same.
 *
 * What the outputs do. A channel is off at power up, 500 kohm to ground, until its first frame (as drivers of the
 * siblings say, such as github.com/SteveGdvs/MCP48xx; the data sheet's own words were not at hand). A warm start of the
 * microcontroller changes nothing: the last code stays. SHDN, where there is a pin, is tied high. Code c is
 * c / 4096 of Vref times gain: the largest, 4095, is one step below. A high is 0.7 VDD at least [1]: a part at 5 V needs
 * a level shifter behind a 3.3 V core. */
#ifndef RDPI_MCP4922_H
#define RDPI_MCP4922_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** The largest code. */
#define RDPI_MCP4922_MAX_CODE 4095u

/** Bytes of one frame. */
#define RDPI_MCP4922_FRAME_BYTES 2u

/** The outputs. */
typedef enum {
    RDPI_MCP4922_A, /**< VOUTA; the only one of an MCP4921 or MCP4821 */
    RDPI_MCP4922_B  /* VOUTB */
} rdpi_mcp4922_channel_t;

/** How the board is wired, for both channels. All false: outputs 0 .. Vref, Vref may be up to VDD. */
typedef struct {
    bool buffered; /**< the reference comes from a source that cannot drive 165 kohm; it must then stay away from 0 and
                      VDD */
    bool gain_2;   /**< outputs 0 .. 2 Vref instead of 0 .. Vref; never above VDD */
} rdpi_mcp4922_config_t;

/** One DAC at work. */
typedef struct {
    /* result: counted since init, saturating */
    uint32_t busy_count; /**< writes refused because the one before was still being sent */
    uint32_t code_count; /**< writes refused because of a code above RDPI_MCP4922_MAX_CODE */
    /* private */
    rdpi_mcp4922_config_t config;
    uint8_t bytes[2u * RDPI_MCP4922_FRAME_BYTES]; /**< what rdpi_spi_write may still be sending */
} rdpi_mcp4922_t;

/** Prepares `self`, sends nothing. `config` is copied. From main. */
void rdpi_mcp4922_init(rdpi_mcp4922_t *self, const rdpi_mcp4922_config_t *config);

/** Outputs a code on each channel, 0 .. RDPI_MCP4922_MAX_CODE, channel A first. Starts the transfer of two frames and
 * returns: true, or false if nothing is sent and both outputs hold: because the transfer before is still running
 * (busy_count), or because a code is above the limit (code_count): it is neither clipped nor wrapped, because such a code
 * is no drive that anybody computed. Both at once counts as busy. From the tick, or from main before the timer runs; time
 * is bounded. */
bool rdpi_mcp4922_write(rdpi_mcp4922_t *self, uint32_t code_a, uint32_t code_b);

/** The same for one channel: one frame, the other output holds. */
bool rdpi_mcp4922_write_channel(rdpi_mcp4922_t *self, rdpi_mcp4922_channel_t channel, uint32_t code);

/** Bytes that rdpi_mcp4922_safe_frames writes. */
#define RDPI_MCP4922_SAFE_BYTES 4

/** The two frames of rdpi_mcp4922_write, channel A first, for rdpi_port_safe, which sends them itself, because after a
 * fault neither an rdpi_mcp4922_t nor an interrupt can be trusted; nothing is sent here. With LDAC driven, rdpi_port_safe
 * must pull LDAC low behind them. With one channel, it sends the first frame only. Any context. */
void rdpi_mcp4922_safe_frames(const rdpi_mcp4922_config_t *config, uint32_t code_a, uint32_t code_b, uint8_t *bytes);

#ifdef __cplusplus
}
#endif
#endif
