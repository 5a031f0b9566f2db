/* Plays a drive and tells the host what the displacement sensor reads: the recordings that `rdpi fit` identifies an
 * actuator from, made by the board that will drive it. The same file on every port. */
#include "rdpi_port.h"
#include "rdpi_profile.h" /* the drive as DAC codes, made by `rdpi profile DRIVE.csv --dac BITS:MIN_V:MAX_V` */
#include "telemetry.h"

#if defined(RDPI_PORT_DAC_BITS) && RDPI_PORT_DAC_BITS != RDPI_PROFILE_DAC_BITS
#error "this board's DAC has other bits than the drive: give them to `rdpi profile --dac`"
#endif

#define INFO_EVERY 1000u    /* samples */
#define END_INFO_EVERY 100u /* after the last: the host waits for one to get through */

static const rdpi_telemetry_run_t run = {
    .min_V = RDPI_PROFILE_MIN_V,
    .max_V = RDPI_PROFILE_MAX_V,
    .um_per_count = EXCITE_UM_PER_COUNT,
    .count_0_um = EXCITE_COUNT_0_UM,
    .rate_hz = RDPI_PROFILE_RATE_HZ,
    .dac_bits = RDPI_PROFILE_DAC_BITS,
    .numbers = RDPI_TELEMETRY_NO_REFERENCE,
};

static rdpi_telemetry_t line;
static rdpi_telemetry_counts_t counts;
static rdpi_telemetry_sample_t sample; /* the latest; sent one tick later, with its reading */
static const uint32_t swept = RDPI_PROFILE_SWEEP; /* may be 0 */
static uint32_t played;
static volatile bool finished;

static bool send_info(void)
{
    return rdpi_telemetry_info(&line, &run, &counts);
}

/* Outputs the next code, and only then sends the sample before: no code is late for telemetry's sake. */
static void take_sample(int32_t adc_counts)
{
    rdpi_telemetry_sample_t before = sample;
    if (played == RDPI_PROFILE_COUNT) {
        counts.state = RDPI_TELEMETRY_FINISHED;
    } else {
        sample.dac_code = rdpi_profile_codes[played];
        sample.flags = played < swept ? RDPI_TELEMETRY_SWEEP : 0u;
        played++;
        if (!rdpi_port_write_dac(sample.dac_code)) {
            sample.flags |= RDPI_TELEMETRY_HELD;
            counts.held_count++;
        }
    }
    if (before.tick > 0u) {
        before.adc_counts = adc_counts; /* what its code has led to: the reading after one period */
        (void)rdpi_telemetry_sample(&line, &before);
    }
}

/* The timer interrupt. Every code is played: where ticks are lost one is held for longer, and the host is told. At the
 * end the last code stays, and the host is told so again and again. */
static void tick(void)
{
    uint32_t began = rdpi_port_cycles();
    int32_t adc_counts = rdpi_port_read_adc();
    uint32_t ticks = rdpi_port_overruns() - counts.overruns + 1u;
    bool at_end = false;
    counts.overruns += ticks - 1u;
    if (!finished) {
        take_sample(adc_counts);
        at_end = finished = counts.state == RDPI_TELEMETRY_FINISHED;
    }
    sample.tick += ticks;
    if (at_end || sample.tick % (finished ? END_INFO_EVERY : INFO_EVERY) < ticks) {
        (void)send_info();
    }
    uint32_t took = rdpi_port_cycles() - began;
    if (took > counts.longest_tick_cycles) {
        counts.longest_tick_cycles = took;
    }
}

int main(void)
{
    (void)send_info();
    (void)rdpi_port_write_dac(rdpi_profile_codes[0]);
    counts.state = RDPI_TELEMETRY_RUNNING;
    if (!rdpi_port_start(RDPI_PROFILE_RATE_HZ, tick)) {
        counts.state = RDPI_TELEMETRY_REFUSED; /* with status ok: no timer of that rate */
        (void)send_info();
        return 1;
    }
    while (!finished) {
        rdpi_port_idle();
    }
    return 0;
}
