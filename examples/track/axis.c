/* One axis of track: its actuator, and in front of it its reference. In floating or, with TRACK_Q31, fixed point. The
 * build compiles this file once for each axis, with its headers. */
#include <string.h>

#include "axis.h"
#include "rdpi_port.h"
#include "rdpi/rdpi.h"
#include "rdpi_params.h"    /* the actuator, made by `rdpi header` */
#include "rdpi_reference.h" /* where the reference comes from */

#if RDPI_PARAMS_DAC_BITS == 0
#error "the actuator's model has no DAC: set drive.dac_bits, with `rdpi fit --dac-bits` or in the model file"
#endif
#if defined(RDPI_PORT_DAC_BITS) && RDPI_PORT_DAC_BITS != RDPI_PARAMS_DAC_BITS
#error "this board's DAC has other bits than the model: set drive.dac_bits, with `rdpi fit --dac-bits` or in the file"
#endif

#if TRACK_Q31
#if !RDPI_PARAMS_Q31
#error "this actuator has no parameters in fixed point; rdpi_params.h says why"
#endif
#define RDPI(verb) rdpi_q31_chain_##verb
#define CHAIN rdpi_chain_q31
#define SAMPLE_TIME ((1000000000u + TRACK_RATE_HZ / 2u) / TRACK_RATE_HZ) /* ns */
#define NEXT_REFERENCE rdpi_reference_q31
#define RATE chain.axis.rate
typedef int32_t number_t;
#else
#define RDPI(verb) rdpi_f32_chain_##verb
#define CHAIN rdpi_chain
#define SAMPLE_TIME (1.0f / TRACK_RATE_HZ)
#define NEXT_REFERENCE rdpi_reference_um
#define RATE chain.axis.rate_um_per_s
typedef float number_t;
#endif

static const rdpi_telemetry_run_t run = {
    .min_V = RDPI_PARAMS_MIN_V,
    .max_V = RDPI_PARAMS_MAX_V,
#if TRACK_Q31
    .um_per_reference = (RDPI_PARAMS_Q31_UM(1 << 30) - RDPI_PARAMS_Q31_UM(0)) / (1 << 30),
    .reference_0_um = RDPI_PARAMS_Q31_UM(0),
    .um_per_s_per_rate = RDPI_PARAMS_Q31_UM_PER_S(1),
    .numbers = RDPI_TELEMETRY_INT32,
#else
    .um_per_reference = 1,
    .um_per_s_per_rate = 1,
    .numbers = RDPI_TELEMETRY_FLOAT,
#endif
    .um_per_count = TRACK_UM_PER_COUNT,
    .count_0_um = TRACK_COUNT_0_UM,
    .rate_hz = TRACK_RATE_HZ,
    .dac_bits = RDPI_PARAMS_DAC_BITS,
};

static RDPI(t) chain; /* what stands around the actuator, and in it the actuator itself */

/* Same size, same place: the bits of a number. */
static uint32_t bits_of(number_t number)
{
    uint32_t bits;
    memcpy(&bits, &number, sizeof bits);
    return bits;
}

static rdpi_status_t axis_init(rdpi_telemetry_sample_t *sample)
{
    rdpi_status_t status = RDPI(init)(&chain, &CHAIN, SAMPLE_TIME);
    if (status == RDPI_OK && TRACK_SWEPT > 0u) {
        RDPI(swept)(&chain, TRACK_SWEPT);
    }
    sample->dac_code = chain.axis.dac_code;
    return status;
}

static void axis_count(rdpi_telemetry_counts_t *counts)
{
    counts->guard_count = chain.axis.guard_count;
    counts->clip_count = chain.axis.clip_count;
    counts->input_count = chain.axis.input_count;
    counts->missed_count = chain.axis.missed_count;
}

#if TRACK_LOOP
#define LOOP_Q31 TRACK_Q31
#include "loop.h"
#if LOOP_NO_READING != RDPI_PORT_NO_READING
#error "loop.h and the port must have the same value for no reading"
#endif

/* The loop is closed for the samples TRACK_CLOSE_AT .. TRACK_OPEN_AT - 1 of the reference, where there is a reading.
 * TRACK_OPEN_AT 0: to the end. Without TRACK_FEEDFORWARD the controller alone moves the actuator: it corrects the first
 * reference. */
static loop_t loop = LOOP_OF(TRACK_KP, TRACK_KI, TRACK_RATE_HZ, TRACK_UM_PER_COUNT, TRACK_COUNT_0_UM);
static uint32_t loop_sample;
static number_t first_reference;

static number_t closed_loop(number_t reference, number_t ahead, uint32_t ticks, int32_t adc_counts)
{
    if (loop_sample == 0u) {
        first_reference = reference;
    }
    bool close = loop_sample >= TRACK_CLOSE_AT && (TRACK_OPEN_AT == 0u || loop_sample < TRACK_OPEN_AT);
    loop_sample = ticks < UINT32_MAX - loop_sample ? loop_sample + ticks : UINT32_MAX;
    return loop_reference(&loop, reference, TRACK_FEEDFORWARD ? ahead : first_reference, adc_counts, close,
                          chain.axis.flags);
}
#endif
#if RDPI_AXES > 1
#include "coupling.h"
#else
#define couple NULL
#endif
#ifdef RDPI_PARAMS_BACKLASH_UM
#include "backlash.h"
#endif

static void tell(rdpi_telemetry_sample_t *sample, number_t reference)
{
    sample->reference = bits_of(reference);
    sample->rate = bits_of(RATE);
    sample->dac_code = chain.axis.dac_code;
    sample->flags |= (uint16_t)chain.axis.flags;
}

static bool axis_sweep(rdpi_telemetry_sample_t *sample)
{
    bool more = RDPI(sweep)(&chain);
    tell(sample, 0);
    return more;
}

static bool axis_advance(uint32_t ticks, int32_t adc_counts, const uint32_t *codes, rdpi_telemetry_sample_t *sample)
{
    number_t reference = 0, ahead = 0;
    if (!NEXT_REFERENCE(ticks, chain.preview_samples, &reference, &ahead)) {
        return false;
    }
#ifdef RDPI_PARAMS_BACKLASH_UM
    number_t asked = ahead; /* its reversals count, not those that the loop makes */
#endif
#if TRACK_LOOP
    ahead = closed_loop(reference, ahead, ticks, adc_counts);
#else
    (void)adc_counts;
#endif
#if RDPI_AXES > 1
    ahead = coupling_taken_off(ahead, codes);
#else
    (void)codes;
#endif
#ifdef RDPI_PARAMS_BACKLASH_UM
    ahead = backlash_crossed(ahead, asked, ticks);
#endif
    if (ticks > 1u) {
        RDPI(missed)(&chain, ticks - 1u);
    }
    (void)RDPI(step)(&chain, ahead);
    tell(sample, reference);
    return true;
}

const track_axis_t RDPI_AXIS_NAME(track_axis) = {
    &run, axis_init, couple, axis_sweep, axis_advance, axis_count,
};
