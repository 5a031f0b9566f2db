/** @file
 * TI DAC8562: two channels of 16 bits, 0 V at power up, 2.5 V reference on board. Above rdpi_spi.h, which says what the
 * bus must be.
 *
 *     static rdpi_dac8562_t dac;
 *     static const rdpi_dac8562_config_t config = {.gain_2 = true};  // 0 .. 5 V from the internal reference
 *
 *     rdpi_dac8562_init(&dac, &config);             // in main, before the timer runs
 *     while (!rdpi_dac8562_start(&dac)) { ... }     // one frame per call: wait 1 ms in here, and give up some time
 *     rdpi_dac8562_write(&dac, code_x, code_y);     // in the tick: both outputs change together
 *
 * No function waits, allocates or keeps a static variable. One instance is used from one context at a time: from main
 * until start has returned true, then from the tick. The counters may be read anywhere.
 *
 * FRAMES, as sent, first byte first. The first byte is 0 0 C2 C1 C0 A2 A1 A0: command and address.
 *
 *     bytes     command                                     when                           source
 *     28 00 01  software reset, all registers               start, 1st                     [1] 8.4.3, [3] [4] [5]
 *     30 00 00  LDAC pin active for both channels           start, 2nd                     [1] 8.4.6, [3] [5] [6]
 *     38 00 01  internal reference on, gains become 2       start, 3rd                     [1] 8.4.4, [3] [4] [5]
 *     38 00 00  internal reference off, gains become 1        the same, external_reference [1] 8.4.4, [3] [4]
 *     02 00 03  gain of both channels 1                     start, 4th                     [1] 8.4.2, [3] [4] [5]
 *     02 00 00  gain of both channels 2                       the same, gain_2             [1] 8.4.2, [3] [4] [5]
 *     20 00 03  power up both channels                      start, 5th                     [2] table 16 and 17, [3] [5]
 *     00 aa aa  code to input register A, no output yet     write, 1st frame               [2] table 11, [4] [5]
 *     11 bb bb  code to input register B, update both       write, 2nd frame               [2] table 11, [4] [7]
 *     01 bb bb  code to input register B, no output yet       the same, ldac_driven        [2] table 11, [4] [5]
 *     18 aa aa  code to register A and output A             write_channel A                [2] table 11, [3] [4]
 *     19 bb bb  code to register B and output B             write_channel B                [2] table 11, [3] [4]
 *
 * [1] Data sheet SLAS719E, June 2015, sections; [2] its edition SLAS719D, August 2012, pages 32 and 35. At hand were
 * the pages of [2], of [1] only the contents, and the LDAC pin's description in SLASE61A (DAC8562T, October 2015). The
 * data words were checked against independent implementations instead: [3] github.com/k164v/DAC8562 (Arduino),
 * [4] dac8563.h of GMP by Javnson, a transcript of the command matrix, [5] github.com/darrenaw1/DAC8562-Driver (STM32),
 * in [3] and [5] a 1 switches the LDAC pin off; [6] TI's answer in e2e.ti.com thread 1331132: it is on by default;
 * [7] ADI's AD5624R/AD5644R/AD5664R, Rev. C, LDAC Function and table 8: same command bits, "write to input register n,
 * update all".
 *
 * Timing: SCLK 50 MHz (features of [1]); sampled on falling edges, mode 1 in [3]; SYNC low 13 ns before the first and
 * 10 ns after the last, high 80 ns ([1] 7.6 as quoted in a published board review; the same in the DAC8568, SBAS430F).
 *
 * LDAC. The two codes of rdpi_dac8562_write meet at the outputs in one of two ways:
 *     by command   LDAC tied high (AVDD). The first frame fills register A, the 24th falling edge of the second
 *                  updates both. The LDAC register stays at its default: with bits set ("pin inactive") [7] describes
 *                  the channel as transparent, and if so here, A would change one frame before B.
 *     by the pin   ldac_driven: a timer's output pulls LDAC low (>= 80 ns, and >= 40 ns after the last frame: values of
 *                  the sibling DAC8568, SBAS430F) and both outputs change at that edge, without the jitter of software.
 * With LDAC tied low every frame acts at once: one axis works, two change a frame apart.
 *
 * What the outputs do. Reset sends both to 0 V, at power up no news, after a warm start of the microcontroller a step:
 * bring the drive down first, or sweep afterwards (rdpi_f32_sweep). Not for the DAC8563, which resets to mid scale.
 * Logic levels: the data sheet wants 0.7 AVDD for a high, so a 5 V part needs a level shifter behind a 3.3 V core. */
#ifndef RDPI_DAC8562_H
#define RDPI_DAC8562_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** The largest code. */
#define RDPI_DAC8562_MAX_CODE 65535u

/** Bytes of one frame. */
#define RDPI_DAC8562_FRAME_BYTES 3u

/** The outputs. */
typedef enum {
    RDPI_DAC8562_A, /**< VOUTA */
    RDPI_DAC8562_B  /* VOUTB */
} rdpi_dac8562_channel_t;

/** How the board is wired. All false: internal reference, outputs 0 .. 2.5 V, LDAC tied high. */
typedef struct {
    bool external_reference; /**< VREFIN is driven from outside: the internal reference must stay off */
    bool gain_2;             /**< outputs 0 .. 2 Vref instead of 0 .. Vref; never above AVDD */
    bool ldac_driven;        /**< LDAC comes from a timer's output, and without its edge no output changes */
} rdpi_dac8562_config_t;

/** One DAC at work. */
typedef struct {
    /* result: counted since init, saturating */
    uint32_t busy_count; /**< writes refused because the one before was still being sent, or start was not done */
    uint32_t code_count; /**< writes refused because of a code above RDPI_DAC8562_MAX_CODE */
    /* private */
    rdpi_dac8562_config_t config;
    uint8_t step; /**< frames of start that were sent */
    bool ready;   /**< start has returned true */
    uint8_t bytes[2u * RDPI_DAC8562_FRAME_BYTES]; /**< what rdpi_spi_write may still be sending */
} rdpi_dac8562_t;

/** Prepares `self`, sends nothing. `config` is copied. From main. */
void rdpi_dac8562_init(rdpi_dac8562_t *self, const rdpi_dac8562_config_t *config);

/** Sends the next of the five frames of the start, in the order of the table, unless the bus is busy. Returns true when
 * all are out, and from then on. The data sheets give no time between the frames; about 1 ms between calls is what
 * drivers in the field leave after the reset, and it lets the reference settle. A bus that is always busy never returns
 * true, so bound the loop. From main, before rdpi_port_start. */
bool rdpi_dac8562_start(rdpi_dac8562_t *self);

/** Outputs a code on each channel, 0 .. RDPI_DAC8562_MAX_CODE over 0 .. Vref times gain, both at the same moment. Starts
 * the transfer of two frames and returns: true, or false if nothing is sent and both outputs hold: because the transfer
 * before is still running or start is not done (busy_count), or because a code is above the limit (code_count): it is
 * neither clipped nor wrapped, because such a code is no drive that anybody computed. Both at once counts as busy. From
 * the tick; time is bounded. */
bool rdpi_dac8562_write(rdpi_dac8562_t *self, uint32_t code_a, uint32_t code_b);

/** The same for one channel: one frame, the other output holds. */
bool rdpi_dac8562_write_channel(rdpi_dac8562_t *self, rdpi_dac8562_channel_t channel, uint32_t code);

/** Bytes that rdpi_dac8562_safe_frames writes. */
#define RDPI_DAC8562_SAFE_BYTES 6

/** The two frames of rdpi_dac8562_write, LDAC driven or not, for rdpi_port_safe, which sends them itself, because
 * after a fault neither an rdpi_dac8562_t nor an interrupt can be trusted; nothing is sent here. Before
 * rdpi_dac8562_start, after power up, the internal reference is off, and the outputs are 0 V whatever the code. Any
 * context. */
void rdpi_dac8562_safe_frames(uint32_t code_a, uint32_t code_b, uint8_t *bytes);

#ifdef __cplusplus
}
#endif
#endif
