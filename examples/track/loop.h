/* A PI controller around the open loop. It adds to the reference, so that the inverse, the limits and the flags of the
 * library stay what they are:
 *
 *     correction = KP error + KI (time integral of the error)
 *
 * A loop_t is one controller; a program may have several. LOOP_Q31 is 1 for fixed point and 0 for single precision, as
 * AXIS_Q31 and TRACK_Q31 are. Include it behind the header of the actuator, for LOOP_CONFIG. Copy this file.
 *
 * - Hand-over changes no correction: closing begins with the one that there is, opening holds it.
 * - The integral does not grow while the library limits the drive. It would wind up.
 * - A sample without a reading opens the loop.
 *
 * Each sample:
 *
 *     static loop_t loop = LOOP_OF(KP, LOOP_KI(RATE_HZ, LOOP_WAIT_SAMPLE, LATENCY_S), RATE_HZ, UM_PER_COUNT, COUNT_0_UM);
 *     axis_reference_t followed = loop_reference(&loop, reference, ahead, counts, true, axis.life.flags);
 *
 * For blocks, as a DMA fetches them, with one reading when a block of HALF samples is computed:
 *
 *     static loop_t loop = LOOP_OF(KP, LOOP_KI(RATE_HZ, LOOP_WAIT_BLOCK(HALF), LATENCY_S), RATE_HZ, ...);
 *     loop_reading(&loop, reference_of_the_code_that_is_output_now, counts, true, flags, HALF);
 *     followed[k] = loop_corrected(&loop, ahead[k]); // of each sample of the block
 */
#ifndef LOOP_H
#define LOOP_H

#include <stdbool.h>
#include <stdint.h>

#include "rdpi/rdpi.h"

#define LOOP_NO_READING INT32_MIN /* in place of counts: there is none */

/* The largest integral gain that leaves a gain margin of 5, um per um and second. `wait_samples` is the mean time from a
 * reading to the middle of the sample that it changes. `latency_s` is delay and lags, the sensor's included. */
#define LOOP_KI(rate_hz, wait_samples, latency_s) (0.3 / ((double)(latency_s) + (double)(wait_samples) / (rate_hz)))
#define LOOP_WAIT_SAMPLE 1.5                              /* each code is output with the next tick */
#define LOOP_WAIT_BLOCK(half) (1.5 * (half))              /* halves of a buffer, one reading when a half is computed */
#define LOOP_WAIT_BLOCK_OF_READINGS(half) (2.0 * (half)) /* ... a reading for each sample, from the half before */

#if LOOP_Q31
typedef int32_t loop_number_t; /* reference units */
typedef int64_t loop_wide_t;   /* ... times 2^24 */
#define LOOP_WIDE(number) ((loop_wide_t)((number) * (1 << 24)))
#define LOOP_NARROW(wide) ((loop_number_t)((wide) / (1 << 24)))
#define LOOP_LARGEST (((loop_wide_t)1 << 30) * (1 << 24)) /* the reach of the actuator */
#define LOOP_UNIT_UM (RDPI_PARAMS_Q31_UM(1) - RDPI_PARAMS_Q31_UM(0))
#define LOOP_PER_COUNT(um) ((int64_t)((um) / LOOP_UNIT_UM * 1024))
#define LOOP_COUNT_0(um) ((int64_t)(((um) - RDPI_PARAMS_Q31_UM(0)) / LOOP_UNIT_UM))
typedef int64_t loop_scale_t;
#else
typedef float loop_number_t; /* um */
typedef float loop_wide_t;
#define LOOP_WIDE(number) ((loop_wide_t)(number))
#define LOOP_NARROW(wide) (wide)
#define LOOP_LARGEST ((float)RDPI_MAX_REFERENCE_UM)
#define LOOP_PER_COUNT(um) ((float)(um))
#define LOOP_COUNT_0(um) ((float)(um))
typedef float loop_scale_t;
#endif

typedef struct {
    loop_wide_t kp, ki;               /* per error; KI of a sample */
    loop_scale_t per_count, count_0; /* of the sensor; fixed point: per_count times 1024 */
} loop_config_t;

typedef struct {
    loop_config_t config;
    /* result */
    loop_number_t correction; /* what is added to the reference; um or reference units */
    bool closed;              /* the latest reading was used */
    bool limited;             /* ... and did not move the integral, because the library limits the drive */
    /* private */
    loop_wide_t sum, integral;
    loop_number_t before; /* the reference that the next reading belongs to */
    bool begun;           /* there is one */
} loop_t;

/* KP in um per um, 0 .. 100; KI in um per um and second, at most 100 times the rate; the sensor's displacement is count_0_um +
 * um_per_count counts. A macro, so that the compiler makes the numbers of fixed point. */
#define LOOP_CONFIG(kp_, ki_, rate_hz, um_per_count, count_0_um)                                                       \
    {                                                                                                                  \
        .kp = LOOP_WIDE(kp_), .ki = LOOP_WIDE((double)(ki_) / (rate_hz)), .per_count = LOOP_PER_COUNT(um_per_count),   \
        .count_0 = LOOP_COUNT_0(count_0_um)                                                                            \
    }
#define LOOP_OF(kp_, ki_, rate_hz, um_per_count, count_0_um)                                                           \
    {                                                                                                                  \
        .config = LOOP_CONFIG(kp_, ki_, rate_hz, um_per_count, count_0_um)                                             \
    }

static inline bool loop_is_reference(loop_number_t reference)
{
#if LOOP_Q31
    return reference != RDPI_Q31_NO_REFERENCE;
#else
    return reference >= -LOOP_LARGEST && reference <= LOOP_LARGEST; /* NaN is not */
#endif
}

/* A reference less a reading. */
static inline loop_number_t loop_error(const loop_t *self, loop_number_t reference, int32_t counts)
{
#if LOOP_Q31
    int64_t error = reference - (counts * self->config.per_count / 1024 + self->config.count_0);
    return (loop_number_t)(error > INT32_MAX ? INT32_MAX : error < -INT32_MAX ? -INT32_MAX : error);
#else
    return reference - (self->config.count_0 + self->config.per_count * (float)counts);
#endif
}

static inline loop_wide_t loop_limited(loop_wide_t value)
{
    return value > LOOP_LARGEST ? LOOP_LARGEST : value < -LOOP_LARGEST ? -LOOP_LARGEST : value;
}

static inline loop_wide_t loop_magnitude(loop_wide_t value)
{
    return value < 0 ? -value : value;
}

/* A reference with the correction. None stays none. */
static inline loop_number_t loop_corrected(const loop_t *self, loop_number_t reference)
{
#if LOOP_Q31
    int64_t sum = (int64_t)reference + self->correction;
    if (reference == RDPI_Q31_NO_REFERENCE) {
        return reference;
    }
    return (loop_number_t)(sum > INT32_MAX ? INT32_MAX : sum < -INT32_MAX ? -INT32_MAX : sum);
#else
    return reference + self->correction;
#endif
}

/* A reading: `counts` of the sensor, taken while the code of `reference` was output. The loop is closed if `close`, and if
 * there are both. `flags` are the library's of the latest sample, or of the latest block. The correction stays for
 * `samples`, 1 .. 256, until the next reading. */
static inline void loop_reading(loop_t *self, loop_number_t reference, int32_t counts, bool close, uint32_t flags,
                                uint32_t samples)
{
    bool usable = close && counts != LOOP_NO_READING && loop_is_reference(reference);
    self->limited = false;
    if (usable) {
        loop_number_t error = loop_error(self, reference, counts);
        loop_wide_t proportional = self->config.kp * error;
        if (!self->closed) {
            self->integral = loop_limited(self->sum - proportional);
        } else {
            loop_wide_t moved = loop_limited(self->config.ki * error);
            loop_wide_t integral = loop_limited(self->integral + moved * (loop_wide_t)(samples < 256u ? samples : 256u));
            self->limited = (flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0u &&
                            loop_magnitude(integral) >= loop_magnitude(self->integral);
            self->integral = self->limited ? self->integral : integral;
            self->sum = loop_limited(proportional + self->integral);
            self->correction = LOOP_NARROW(self->sum);
        }
    }
    self->closed = usable;
}

/* What the library is to follow in place of `ahead`, in the sample with this reference. The reading belongs to the sample
 * before. */
static inline loop_number_t loop_reference(loop_t *self, loop_number_t reference, loop_number_t ahead, int32_t counts,
                                           bool close, uint32_t flags)
{
    loop_reading(self, self->before, counts, close && self->begun, flags, 1);
    self->before = reference;
    self->begun = true;
    return loop_corrected(self, ahead);
}

#endif
