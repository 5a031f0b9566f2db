/** @file
 * Analog Devices AD5683R: one channel of 16 bits, 0 V at power up, 2.5 V reference on board, on by default. Above
 * rdpi_spi.h, which says what the bus must be.
 *
 *     static rdpi_ad5683r_t dac;
 *     static const rdpi_ad5683r_config_t config = {.gain_2 = true};  // 0 .. 5 V from the internal reference
 *
 *     rdpi_ad5683r_init(&dac, &config);             // in main, before the timer runs
 *     while (!rdpi_ad5683r_start(&dac)) { ... }     // one frame per call: wait 1 ms in here, and give up some time
 *     rdpi_ad5683r_write(&dac, code);               // in the tick
 *
 * No function waits, allocates or keeps a static variable. One instance is used from one context at a time: from main
 * until start has returned true, then from the tick. The counters may be read anywhere.
 *
 * FRAMES, as sent, first byte first. 24 bits: DB23 .. DB20 are the command, DB19 .. DB4 the code or the control bits,
 * DB3 .. DB0 are ignored. cccc is the code.
 *
 *     bytes     command                                       when                            source
 *     48 00 00  control register, DB19 = 1: software reset    start, 1st                      [2] [5]
 *     40 00 00  control register: internal reference, gain 1, start, 2nd                      [1] [2] [3] [4] [5]
 *               powered up, no daisy chain
 *     40 80 00    DB15 = 1: gain 2                              the same, gain_2              [1] [2] [3] [5]
 *     41 00 00    DB16 = 1: internal reference off              the same, external_reference  [1] [2] [5]
 *     41 80 00    both                                          the same, both                [1] [2] [5]
 *     3c cc c0  code to the input register and the output     write                           [1] [2] [3] [4] [5]
 *     1c cc c0  code to the input register, no output yet       the same, ldac_driven         [1] [2] [5]
 *
 * The data sheet is AD5683R/AD5682R/AD5681R/AD5683, Rev. D, 2016; only its first page (reference, spans, 0 V at power
 * up) was at hand, so no table numbers here. The words are those in which these agree:
 * [1] Linux, drivers/iio/dac/ad5686.h and ad5686-spi.c, with the commit that added the part ("in the write control
 *     register, DB18 and DB17 are used for setting the power mode, while DB16 is the REF bit");
 * [2] ADI's own AD5683.c and AD5683.h for EVAL-ADICUP360 with CN0411;
 * [3] github.com/enjoy-digital/litex_wr_nic: 0x400000, 0x408000, 0x3a53c0 in its test; runs on SPEC-A7;
 * [4] github.com/viperleed/viperleed, DAC_AD5683 (Arduino, mode 1);
 * [5] github.com/PatrickBaus/AD568xR (Arduino, mode 1, "maximum clock frequency 50 MHz").
 *
 * Timing: falling edges of SCLK in [3]; 50 MHz after [5] and the features of the AD5686R, the family's quad. SYNC 20 ns
 * low before and 10 ns after the clocks, 30 ns high: the AD5686R's (Rev. B, table 5, daisy chain) for VLOGIC of 2.7 V
 * and more; below that 33, 15, 60 ns and 15 MHz. The AD5683R's own table was not at hand. Power modes (DB18, DB17),
 * read-back (command 5) and daisy chain (DB14) are not used.
 *
 * LDAC. `write` outputs at the end of its frame whatever LDAC is, so tie it low or high, but do not leave it open. With
 * ldac_driven the code waits in the input register for a falling edge of LDAC, from a timer's output: the output then
 * changes without the jitter of software. Not every package brings LDAC out.
 *
 * What the output does. Reset sends it to 0 V, at power up no news, after a warm start of the microcontroller a step:
 * bring the drive down first, or sweep afterwards (rdpi_f32_sweep). */
#ifndef RDPI_AD5683R_H
#define RDPI_AD5683R_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** The largest code. */
#define RDPI_AD5683R_MAX_CODE 65535u

/** Bytes of one frame. */
#define RDPI_AD5683R_FRAME_BYTES 3u

/** How the board is wired. All false: internal reference, output 0 .. 2.5 V, LDAC tied to a level. */
typedef struct {
    bool external_reference; /**< VREF is driven from outside: the internal reference is switched off. It is on from power
                                up until then, against the external one: see the README */
    bool gain_2;             /**< output 0 .. 2 Vref instead of 0 .. Vref; never above VDD */
    bool ldac_driven;        /**< LDAC comes from a timer's output, and without its edge the output does not change */
} rdpi_ad5683r_config_t;

/** One DAC at work. */
typedef struct {
    /* result: counted since init, saturating */
    uint32_t busy_count; /**< writes refused because the one before was still being sent, or start was not done */
    uint32_t code_count; /**< writes refused because of a code above RDPI_AD5683R_MAX_CODE */
    /* private */
    rdpi_ad5683r_config_t config;
    uint8_t step; /**< frames of start that were sent */
    bool ready;   /**< start has returned true */
    uint8_t bytes[RDPI_AD5683R_FRAME_BYTES]; /**< what rdpi_spi_write may still be sending */
} rdpi_ad5683r_t;

/** Prepares `self`, sends nothing. `config` is copied. From main. */
void rdpi_ad5683r_init(rdpi_ad5683r_t *self, const rdpi_ad5683r_config_t *config);

/** Sends the next of the two frames of the start, in the order of the table, unless the bus is busy. Returns true when
 * both are out, and from then on. Leave about 1 ms between calls; no source names a time, and the drivers it was
 * compared with leave less. A bus that is always busy never returns true, so bound the loop. From main, before
 * rdpi_port_start. */
bool rdpi_ad5683r_start(rdpi_ad5683r_t *self);

/** Outputs a code, 0 .. RDPI_AD5683R_MAX_CODE over 0 .. Vref times gain. Starts the transfer of one frame and returns:
 * true, or false if nothing is sent and the output holds: because the transfer before is still running or start is not
 * done (busy_count), or because the code is above the limit (code_count): it is neither clipped nor wrapped, because
 * such a code is no drive that anybody computed. Both at once counts as busy. From the tick; time is bounded. */
bool rdpi_ad5683r_write(rdpi_ad5683r_t *self, uint32_t code);

/** Bytes that rdpi_ad5683r_safe_frames writes. */
#define RDPI_AD5683R_SAFE_BYTES 6

/** Two frames that bring the output to a code whatever the DAC got before, LDAC or not: control register, then code. For
 * rdpi_port_safe, which sends them itself, because after a fault neither an rdpi_ad5683r_t nor an interrupt can be
 * trusted; nothing is sent here. Any context. */
void rdpi_ad5683r_safe_frames(const rdpi_ad5683r_config_t *config, uint32_t code, uint8_t *bytes);

#ifdef __cplusplus
}
#endif
#endif
