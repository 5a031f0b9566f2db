/* A PI controller around the open loop, for main.c. It adds to the reference, so that the inverse, the limits and the
 * flags of the library stay what they are:
 *
 *     correction = KP error + KI (time integral of the error)
 *
 * - The loop is closed for the samples TRACK_CLOSE_AT .. TRACK_OPEN_AT - 1 of the reference, where there is a reading.
 *   The first sample that can be is 1: a reading belongs to the sample before. TRACK_OPEN_AT 0: to the end.
 * - Hand-over changes no correction: closing begins with the one that there is, opening holds it.
 * - The integral does not grow while the library limits the drive. It would wind up.
 * - Without TRACK_FEEDFORWARD the controller alone moves the actuator: it corrects the first reference. */
#ifndef TRACK_LOOP_H
#define TRACK_LOOP_H

#if TRACK_Q31
typedef int64_t loop_wide_t; /* reference units times 2^24 */
#define LOOP_WIDE(number) ((loop_wide_t)((number) * (1 << 24)))
#define LOOP_NARROW(wide) ((number_t)((wide) / (1 << 24)))
#define LOOP_LARGEST (((loop_wide_t)1 << 30) * (1 << 24)) /* the reach of the actuator */
#else
typedef float loop_wide_t; /* um */
#define LOOP_WIDE(number) ((loop_wide_t)(number))
#define LOOP_NARROW(wide) (wide)
#define LOOP_LARGEST ((float)RDPI_MAX_REFERENCE_UM)
#endif

static struct {
    loop_wide_t correction, integral;
    bool closed;
    uint32_t sample;                 /* of the reference */
    number_t first_reference, before; /* the reading belongs to the latter */
} loop;

static bool loop_is_reference(number_t reference)
{
#if TRACK_Q31
    return reference != RDPI_Q31_NO_REFERENCE;
#else
    return reference == reference; /* not NaN */
#endif
}

/* A reference less a reading. */
static number_t loop_error(number_t reference, int32_t adc_counts)
{
#if TRACK_Q31
    const double um_per_reference = RDPI_PARAMS_Q31_UM(1) - RDPI_PARAMS_Q31_UM(0);
    const int64_t per_count = (int64_t)(TRACK_UM_PER_COUNT / um_per_reference * 1024);
    const int64_t count_0 = (int64_t)((TRACK_COUNT_0_UM - RDPI_PARAMS_Q31_UM(0)) / um_per_reference);
    int64_t error = reference - (adc_counts * per_count / 1024 + count_0);
    return (number_t)(error > INT32_MAX ? INT32_MAX : error < -INT32_MAX ? -INT32_MAX : error);
#else
    return reference - ((number_t)TRACK_COUNT_0_UM + (number_t)TRACK_UM_PER_COUNT * (number_t)adc_counts);
#endif
}

/* A reference with the correction. None stays none. */
static number_t loop_corrected(number_t reference)
{
#if TRACK_Q31
    int64_t sum = (int64_t)reference + LOOP_NARROW(loop.correction);
    if (reference == RDPI_Q31_NO_REFERENCE) {
        return reference;
    }
    return (number_t)(sum > INT32_MAX ? INT32_MAX : sum < -INT32_MAX ? -INT32_MAX : sum);
#else
    return reference + loop.correction;
#endif
}

static loop_wide_t loop_limited(loop_wide_t value)
{
    return value > LOOP_LARGEST ? LOOP_LARGEST : value < -LOOP_LARGEST ? -LOOP_LARGEST : value;
}

static loop_wide_t loop_magnitude(loop_wide_t value)
{
    return value < 0 ? -value : value;
}

static void loop_control(number_t error)
{
    loop_wide_t proportional = LOOP_WIDE(TRACK_KP) * error;
    if (!loop.closed) {
        loop.integral = loop_limited(loop.correction - proportional);
        return;
    }
    loop_wide_t integral = loop_limited(loop.integral + LOOP_WIDE((double)TRACK_KI / TRACK_RATE_HZ) * error);
    if ((chain.axis.flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) == 0u
        || loop_magnitude(integral) < loop_magnitude(loop.integral)) {
        loop.integral = integral;
    }
    loop.correction = loop_limited(proportional + loop.integral);
}

/* What the library is to follow in place of `ahead`, in the sample with this reference. */
static number_t loop_reference(number_t reference, number_t ahead, uint32_t ticks, int32_t adc_counts)
{
    bool close = loop.sample >= TRACK_CLOSE_AT && (TRACK_OPEN_AT == 0u || loop.sample < TRACK_OPEN_AT)
                 && adc_counts != RDPI_PORT_NO_READING && loop_is_reference(loop.before);
    if (loop.sample == 0u) {
        loop.first_reference = reference;
        close = false;
    }
    if (close) {
        loop_control(loop_error(loop.before, adc_counts));
    }
    loop.closed = close;
    loop.before = reference;
    loop.sample += ticks;
    return loop_corrected(TRACK_FEEDFORWARD ? ahead : loop.first_reference);
}

#endif
