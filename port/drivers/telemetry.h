/** @file
 * Telemetry: one frame per sample to the host, which `rdpi record` and `rdpi import --telemetry` turn into a recording.
 * Above rdpi_port_send; what that does not take is counted, and the host sees the gap.
 *
 * On the line a frame is its body and a CRC-16, COBS encoded, and a zero byte:
 *
 *   COBS        Cheshire and Baker, IEEE/ACM Trans. Networking 7 (2), 1999: no zero inside a frame
 *   CRC         CRC-16/IBM-3740 over the body: polynomial 0x1021, start 0xFFFF, not reflected, no final XOR; its low
 *               byte first. 0x29B1 for "123456789"
 *   numbers     little endian; floats IEEE 754
 *
 *   sample      byte  0  u8   1, and 16 times the axis
 *                     1  u16  sequence: samples offered to rdpi_port_send before this one, taken or not
 *                     3  u32  tick: samples since the start, lost ones included
 *                     7  u32  reference: a float in um, or an int32 in reference units (info, byte 9)
 *                    11  u32  rate used: a float in um/s, or an int32 in rate units
 *                    15  u32  DAC code
 *                    19  i32  displacement sensor's reading, counts, after one period of this code; INT32_MIN: none
 *                    23  u16  flags: RDPI_FLAG_..., RDPI_TELEMETRY_...
 *
 *   info        byte  0  u8   2, and 16 times the axis
 *                     1  u8   version of this layout, RDPI_TELEMETRY_VERSION
 *                     2  u8   state, rdpi_telemetry_state_t
 *                     3  i8   rdpi_status_t of init
 *                     4  u32  samples per second
 *                     8  u8   DAC bits
 *                     9  u8   references: 0 none, 1 float, 2 int32
 *                    10  f64  x 7: min_V and max_V of the codes; um per reference unit, um at reference 0; um/s per
 *                             rate unit; um per count, um at count 0 of the sensor
 *                    66  u32  x 10: samples offered to rdpi_port_send, and of those not taken; ticks lost; samples
 *                             flagged guard, clipped (range, slew or lead), flagged input; samples missed; codes that
 *                             the DAC did not take; longest tick so far, cycles; cycles per second or 0
 *
 * Several axes, 16 at most, share the line. Each has its own sequence and its own infos: without the frames of the
 * others it is what a board with one axis sends.
 */
#ifndef RDPI_TELEMETRY_H
#define RDPI_TELEMETRY_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** Version of the layout above. */
#define RDPI_TELEMETRY_VERSION 1u

/** Among a sample's flags: the start-up sweep was running. */
#define RDPI_TELEMETRY_SWEEP 0x100u

/** Likewise: the DAC did not take the code; it held the one before. The next sample has the same code and reference. */
#define RDPI_TELEMETRY_HELD 0x200u

/** Longest frame on the line, bytes: an info. A sample takes 29. */
#define RDPI_TELEMETRY_MAX_BYTES 110

/** What an info says of the run. */
typedef enum {
    RDPI_TELEMETRY_STARTING = 0, /**< before the first tick */
    RDPI_TELEMETRY_RUNNING = 1,
    RDPI_TELEMETRY_FINISHED = 2, /**< the reference is at its end; no sample follows */
    RDPI_TELEMETRY_REFUSED = 3,  /**< the parameters, see the status; with RDPI_OK the rate or, where a code was not
                                      taken, the DAC; no sample follows */
    RDPI_TELEMETRY_SAFE = 4,     /**< too many ticks in a row were lost, or found no DAC: the safe code is out; no sample
                                      follows */
    RDPI_TELEMETRY_RESET = 5     /* the watchdog has reset the board: the safe code is out; no sample follows */
} rdpi_telemetry_state_t;

/** What `reference` and `rate` of a sample are. */
typedef enum {
    RDPI_TELEMETRY_NO_REFERENCE = 0,
    RDPI_TELEMETRY_FLOAT = 1,
    RDPI_TELEMETRY_INT32 = 2
} rdpi_telemetry_number_t;

/** Constants of a run, in flash. */
typedef struct {
    double min_V;             /**< drive at code 0 */
    double max_V;             /**< drive at the last code */
    double um_per_reference;  /**< 1 for references in um */
    double reference_0_um;    /**< 0 for references in um */
    double um_per_s_per_rate; /**< 1 for rates in um/s */
    double um_per_count;      /**< of the displacement sensor */
    double count_0_um;        /**< displacement at count 0 */
    uint32_t rate_hz;
    uint32_t cycles_per_s; /**< of rdpi_port_cycles; 0: not known */
    uint8_t dac_bits;
    uint8_t numbers; /**< rdpi_telemetry_number_t */
} rdpi_telemetry_run_t;

/** What changes during a run. */
typedef struct {
    uint32_t overruns, guard_count, clip_count, input_count, missed_count, held_count, longest_tick_cycles;
    uint8_t state; /**< rdpi_telemetry_state_t */
    int8_t status; /**< rdpi_status_t */
} rdpi_telemetry_counts_t;

/** One sample; the table above has the fields. */
typedef struct {
    uint32_t tick;
    uint32_t reference; /**< bits of the float or int32 */
    uint32_t rate;      /**< likewise */
    uint32_t dac_code;
    int32_t adc_counts;
    uint16_t flags;
} rdpi_telemetry_sample_t;

/** One axis on the line to the host. All 0 at start, but for the axis. */
typedef struct {
    uint8_t axis;           /**< from 0 */
    uint32_t offered_count; /**< samples; wraps */
    uint32_t refused_count; /**< of those, what rdpi_port_send did not take; saturates */
} rdpi_telemetry_t;

/** Offers a sample to rdpi_port_send and returns whether it was taken. From the context in which rdpi_port_send may be
 * called. Some 15 instructions per byte on a Cortex-M4. */
bool rdpi_telemetry_sample(rdpi_telemetry_t *self, const rdpi_telemetry_sample_t *sample);

/** Offers an info to rdpi_port_send and returns whether it was taken. Context and cost as of rdpi_telemetry_sample. */
bool rdpi_telemetry_info(const rdpi_telemetry_t *self, const rdpi_telemetry_run_t *run,
                         const rdpi_telemetry_counts_t *counts);

#ifdef __cplusplus
}
#endif
#endif
