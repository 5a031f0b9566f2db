/* Makes an actuator follow a reference: start-up sweep, then the reference to its end, every sample told to the host. In
 * open loop or, with TRACK_LOOP, with a PI controller around it. The same file on every port, in floating or, with
 * TRACK_Q31, fixed point; see port/README.md. */
#include <string.h>

#include "../tick.h"
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

#if RDPI_PORT_STDERR /* a board that is a computer */
#include <stdio.h>
#define SAY(...) ((void)fprintf(stderr, __VA_ARGS__))
#else
#define SAY(...) ((void)0)
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
static bool sweeping = TRACK_SWEEP;

/* Same size, same place: the bits of a number. */
static uint32_t bits_of(number_t number)
{
    uint32_t bits;
    memcpy(&bits, &number, sizeof bits);
    return bits;
}

static bool send_info(void)
{
    counts.guard_count = chain.axis.guard_count;
    counts.clip_count = chain.axis.clip_count;
    counts.input_count = chain.axis.input_count;
    counts.missed_count = chain.axis.missed_count;
    return rdpi_telemetry_info(&line, &run, &counts);
}

#if TRACK_LOOP
#include "loop.h"
#endif

/* Computes the next code. False when the reference is at its end. */
static bool advance(uint32_t ticks, int32_t adc_counts)
{
    number_t reference = 0, ahead = 0;
    sample.flags = 0;
    if (sweeping) {
        sweeping = RDPI(sweep)(&chain);
        sample.flags = RDPI_TELEMETRY_SWEEP;
    } else if (NEXT_REFERENCE(ticks, chain.preview_samples, &reference, &ahead)) {
#if TRACK_LOOP
        ahead = loop_reference(reference, ahead, ticks, adc_counts);
#else
        (void)adc_counts;
#endif
        if (ticks > 1u) {
            RDPI(missed)(&chain, ticks - 1u);
        }
        (void)RDPI(step)(&chain, ahead);
    } else {
        return false;
    }
    sample.reference = bits_of(reference);
    sample.rate = bits_of(RATE);
    sample.dac_code = chain.axis.dac_code;
    sample.flags |= (uint16_t)chain.axis.flags;
    return true;
}

int main(void)
{
    rdpi_status_t status = RDPI(init)(&chain, &CHAIN, SAMPLE_TIME);
    if (status != RDPI_OK) { /* the DAC stays at the safe code of the board's start-up */
        counts.state = RDPI_TELEMETRY_REFUSED;
        counts.status = (int8_t)status;
        (void)send_info();
        SAY("track: %s\n", rdpi_status_text(status));
        return 1;
    }
    if (!start_ticks(TRACK_RATE_HZ, chain.axis.dac_code)) { /* the drive at which the model's memory begins */
        SAY("track: this board has no timer of that rate\n");
        return 1;
    }
    while (!finished) {
        rdpi_port_idle();
    }
    SAY("track: rate clamped %lu times, drive or lead clipped %lu, reference refused %lu, ticks lost %lu\n",
        (unsigned long)chain.axis.guard_count, (unsigned long)chain.axis.clip_count,
        (unsigned long)chain.axis.input_count, (unsigned long)rdpi_port_overruns());
    return 0;
}
