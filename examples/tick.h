/* The tick of an application, and how its samples are told to the host. For the one file that is the application: it
 * defines `advance` and `send_info`. */
#ifndef RDPI_EXAMPLE_TICK_H
#define RDPI_EXAMPLE_TICK_H

#include "rdpi_port.h"
#include "telemetry.h"

#ifndef TICK_MAX_OVERRUNS
#define TICK_MAX_OVERRUNS 0 /* go on, however many are lost */
#endif

#define INFO_EVERY 1000u    /* samples */
#define END_INFO_EVERY 100u /* after the last: the host waits for one to get through */

static rdpi_telemetry_t line;
static rdpi_telemetry_counts_t counts;
static rdpi_telemetry_sample_t sample; /* the latest; sent one tick later, with its reading */
static volatile bool finished;

/* Puts the next code, `ticks` after the one before, into `sample`. The reading belongs to the code before. False at the
 * end. */
static bool advance(uint32_t ticks, int32_t adc_counts);

static bool send_info(void);

/* Whether as many ticks were lost, with none in time between them, as the build allows. */
static bool too_many_lost(uint32_t ticks)
{
#if TICK_MAX_OVERRUNS > 0
    static uint32_t in_a_row;
    in_a_row = ticks > 1u ? in_a_row + (ticks - 1u) : 0u;
    return in_a_row >= TICK_MAX_OVERRUNS;
#else
    (void)ticks;
    return false;
#endif
}

/* Outputs the next code, and only then sends the sample before: no code is late for telemetry's sake. */
static void take_sample(uint32_t ticks, int32_t adc_counts)
{
    rdpi_telemetry_sample_t before = sample;
    if (too_many_lost(ticks)) {
        rdpi_port_safe();
        counts.state = RDPI_TELEMETRY_SAFE;
    } else if (!advance(ticks, adc_counts)) {
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

/* The timer interrupt. At the end the last code, or the safe one, stays, and the host is told so again and again. */
static void tick(void)
{
    uint32_t began = rdpi_port_cycles();
    int32_t adc_counts = rdpi_port_read_adc();
    uint32_t ticks = rdpi_port_overruns() - counts.overruns + 1u; /* since the sample before: 1 if none was lost */
    bool at_end = false;
    counts.overruns += ticks - 1u;
    if (!finished) {
        take_sample(ticks, adc_counts);
        at_end = finished = counts.state != RDPI_TELEMETRY_RUNNING;
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

/* Tells the host, outputs the first code and starts the timer. False, and the safe code is out, where it does not
 * run. */
static bool start_ticks(uint32_t rate_hz, uint32_t first_code)
{
    (void)send_info();
    if (rdpi_port_watchdog_reset()) {
        counts.state = RDPI_TELEMETRY_RESET;
    } else {
        (void)rdpi_port_write_dac(first_code);
        counts.state = RDPI_TELEMETRY_RUNNING;
        if (rdpi_port_start(rate_hz, tick)) {
            return true;
        }
        rdpi_port_safe();
        counts.state = RDPI_TELEMETRY_REFUSED; /* with status ok: no timer of that rate */
    }
    (void)send_info();
    return false;
}

#endif
