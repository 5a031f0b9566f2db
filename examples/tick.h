/* The tick of an application, and how its samples are told to the host. For the one file that is the application: it
 * defines `advance` and `send_info`. */
#ifndef RDPI_EXAMPLE_TICK_H
#define RDPI_EXAMPLE_TICK_H

#include <string.h>

#include "rdpi_port.h"
#include "telemetry.h"

#ifndef TICK_MAX_OVERRUNS
#define TICK_MAX_OVERRUNS 0 /* go on, however many are lost */
#endif

#ifndef TICK_MAX_HELD
#define TICK_MAX_HELD 10u /* ticks in a row without the DAC: the reference goes on, and what then gets through is a step */
#endif

#define INFO_EVERY 1000u    /* samples */
#define END_INFO_EVERY 100u /* after the last: the host waits for one to get through */

#define LINE_OF(number) {.axis = (number)},
static rdpi_telemetry_t line[] = {RDPI_EACH_AXIS(LINE_OF)};
static rdpi_telemetry_counts_t counts;            /* of the board; an application adds those of an axis */
static rdpi_telemetry_sample_t sample[RDPI_AXES]; /* the latest; sent one tick later, with its reading */
static volatile bool finished;
static uint32_t held;   /* ticks in a row in which the DAC has not taken the codes of `sample` */
static uint32_t waited; /* ticks in which no codes were computed for that */

/* Puts the next code of each axis, `ticks` after the one before, into `sample`. The readings belong to the codes before.
 * False at the end. */
static bool advance(uint32_t ticks, const int32_t *adc_counts);

/* Of one axis. */
static bool send_info(uint32_t axis);

static void send_infos(void)
{
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        (void)send_info(k);
    }
}

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

static bool write_codes(void)
{
    uint32_t codes[RDPI_AXES];
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        codes[k] = sample[k].dac_code;
    }
    return rdpi_port_write_dac(codes);
}

/* The next codes. Those that the DAC has not taken are the next ones once more: an axis counts on every code that it has
 * returned, and two steps at once could be more than its slew limit. */
static bool next_codes(uint32_t ticks, const int32_t *adc_counts)
{
    if (held > 0u) {
        waited += ticks;
        for (uint32_t k = 0; k < RDPI_AXES; k++) {
            sample[k].flags &= (uint16_t)~RDPI_TELEMETRY_HELD;
        }
        return true;
    }
    ticks += waited;
    waited = 0;
    return advance(ticks, adc_counts);
}

/* Whether the DAC takes the codes, or is given another try. */
static bool output_codes(void)
{
    if (write_codes()) {
        held = 0;
        return true;
    }
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        sample[k].flags |= RDPI_TELEMETRY_HELD;
    }
    counts.held_count++;
    held++;
    return held < TICK_MAX_HELD;
}

/* Outputs the next codes, and only then sends the samples before: no code is late for telemetry's sake. */
static void take_sample(uint32_t ticks, const int32_t *adc_counts)
{
    rdpi_telemetry_sample_t before[RDPI_AXES];
    memcpy(before, sample, sizeof before);
    bool safe = too_many_lost(ticks);
    if (!safe && !next_codes(ticks, adc_counts)) {
        counts.state = RDPI_TELEMETRY_FINISHED;
    } else if (safe || !output_codes()) {
        rdpi_port_safe();
        counts.state = RDPI_TELEMETRY_SAFE;
    } else {
        /* the codes are on their way, or are tried again in the next tick */
    }
    for (uint32_t k = 0; k < RDPI_AXES && before[k].tick > 0u; k++) {
        before[k].adc_counts = adc_counts[k]; /* what its code has led to: the reading after one period */
        (void)rdpi_telemetry_sample(&line[k], &before[k]);
    }
}

/* The infos that are due in this tick; not those of all axes in one. */
static void send_due_infos(uint32_t ticks)
{
    uint32_t every = finished ? END_INFO_EVERY : INFO_EVERY;
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        if ((sample[k].tick + k) % every < ticks) {
            (void)send_info(k);
        }
    }
}

/* The timer interrupt. At the end the last codes, or the safe one, stay, and the host is told so again and again. */
static void tick(void)
{
    uint32_t began = rdpi_port_cycles();
    int32_t adc_counts[RDPI_AXES];
    rdpi_port_read_adc(adc_counts);
    uint32_t ticks = rdpi_port_overruns() - counts.overruns + 1u; /* since the sample before: 1 if none was lost */
    bool at_end = false;
    counts.overruns += ticks - 1u;
    if (!finished) {
        take_sample(ticks, adc_counts);
        at_end = finished = counts.state != RDPI_TELEMETRY_RUNNING;
    }
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        sample[k].tick += ticks;
    }
    if (at_end) {
        send_infos();
    } else {
        send_due_infos(ticks);
    }
    uint32_t took = rdpi_port_cycles() - began;
    if (took > counts.longest_tick_cycles) {
        counts.longest_tick_cycles = took;
    }
}

/* Tells the host, outputs the codes of `sample` and starts the timer. False, and the safe code is out, where it does
 * not run. */
static bool start_ticks(uint32_t rate_hz)
{
    send_infos();
    if (rdpi_port_watchdog_reset()) {
        counts.state = RDPI_TELEMETRY_RESET;
    } else {
        bool taken = write_codes(); /* if not, nobody knows where the actuator is: it must not be driven from here */
        counts.held_count += taken ? 0u : 1u;
        counts.state = RDPI_TELEMETRY_RUNNING;
        if (taken && rdpi_port_start(rate_hz, tick)) {
            return true;
        }
        rdpi_port_safe();
        counts.state = RDPI_TELEMETRY_REFUSED; /* with status ok: no timer of that rate or, with a code held, no DAC */
    }
    send_infos();
    return false;
}

#endif
