/* The tick of an application, and how its samples are told to the host. For the one file that is the application: it
 * defines `advance` and `send_info`. */
#ifndef RDPI_EXAMPLE_TICK_H
#define RDPI_EXAMPLE_TICK_H

#include "rdpi_port.h"
#include "telemetry.h"

#define INFO_EVERY 1000u    /* samples */
#define END_INFO_EVERY 100u /* after the last: the host waits for one to get through */

static rdpi_telemetry_t line;
static rdpi_telemetry_counts_t counts;
static rdpi_telemetry_sample_t sample; /* the latest; sent one tick later, with its reading */
static volatile bool finished;

/* Puts the next code, `ticks` after the one before, into `sample`. False at the end. */
static bool advance(uint32_t ticks);

static bool send_info(void);

/* Outputs the next code, and only then sends the sample before: no code is late for telemetry's sake. */
static void take_sample(uint32_t ticks, int32_t adc_counts)
{
    rdpi_telemetry_sample_t before = sample;
    if (!advance(ticks)) {
        counts.state = RDPI_TELEMETRY_FINISHED;
    } else if (!rdpi_port_write_dac(sample.dac_code)) {
        sample.flags |= RDPI_TELEMETRY_HELD; /* taken as output all the same; the next brings both together */
        counts.held_count++;
    }
    if (before.tick > 0u) {
        before.adc_counts = adc_counts; /* what its code has led to: the reading after one period */
        (void)rdpi_telemetry_sample(&line, &before);
    }
}

/* The timer interrupt. At the end the last code stays, and the host is told so again and again. */
static void tick(void)
{
    uint32_t began = rdpi_port_cycles();
    int32_t adc_counts = rdpi_port_read_adc();
    uint32_t ticks = rdpi_port_overruns() - counts.overruns + 1u; /* since the sample before: 1 if none was lost */
    bool at_end = false;
    counts.overruns += ticks - 1u;
    if (!finished) {
        take_sample(ticks, adc_counts);
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

#endif
