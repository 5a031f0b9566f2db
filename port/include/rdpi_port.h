/** @file
 * The port contract: what an application needs of a board to run rdpi. One folder beside this one per board; the same
 * application links against every one of them. See port/README.md.
 *
 * The board samples at a fixed rate. At every sample its timer calls the application's tick; the tick takes the
 * reference (rdpi_reference.h), computes and writes a code to the DAC. Everything else happens in main.
 *
 * A board moves one axis or several, RDPI_AXES: each is an output of the DAC and a displacement sensor. All of them
 * share the timer. */
#ifndef RDPI_PORT_H
#define RDPI_PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** Axes of the board, 1 to 6. The build sets it, -DRDPI_AXES=, up to what the port can do; 1 unless it does. */
#ifndef RDPI_AXES
#define RDPI_AXES 1
#endif

/** of(0) of(1) ... : once for every axis. */
#if RDPI_AXES == 1
#define RDPI_EACH_AXIS(of) of(0)
#elif RDPI_AXES == 2
#define RDPI_EACH_AXIS(of) of(0) of(1)
#elif RDPI_AXES == 3
#define RDPI_EACH_AXIS(of) of(0) of(1) of(2)
#elif RDPI_AXES == 4
#define RDPI_EACH_AXIS(of) of(0) of(1) of(2) of(3)
#elif RDPI_AXES == 5
#define RDPI_EACH_AXIS(of) of(0) of(1) of(2) of(3) of(4)
#elif RDPI_AXES == 6
#define RDPI_EACH_AXIS(of) of(0) of(1) of(2) of(3) of(4) of(5)
#else
#error "RDPI_AXES: 1 to 6"
#endif

/** In place of a reading of the displacement sensor: there is none. */
#define RDPI_PORT_NO_READING INT32_MIN

/** The safe state: the DAC's code where the firmware cannot go on, the same for every axis. The build sets it,
 * -DRDPI_SAFE_CODE=; 0 unless it does, which is also what a DAC outputs after its own reset. */
#ifndef RDPI_SAFE_CODE
#define RDPI_SAFE_CODE 0u
#endif

/** What the timer calls once per sample; on a microcontroller in interrupt context. */
typedef void (*rdpi_port_tick_t)(void);

/** Starts the timer: from now on `tick` is called `rate_hz` times a second. Returns true, or false if the board cannot
 * keep this rate to 0.1 %; the timer is then not running. Call it once, from main. */
bool rdpi_port_start(uint32_t rate_hz, rdpi_port_tick_t tick);

/** Outputs RDPI_AXES codes of the DAC, each 0 .. 2^bits - 1, which are held until the next; does not wait for the
 * transfer to end. The outputs change together. Returns false, and all outputs hold what they had, for a code beyond
 * that or while the DAC takes none. The codes may change once it has returned. From the tick, or from main before
 * rdpi_port_start. */
bool rdpi_port_write_dac(const uint32_t *codes);

/** Outputs RDPI_SAFE_CODE on every axis and returns when the DAC has it, whatever was going on: a frame half sent is
 * given up first. Takes a limited time, no interrupt and no variable's value, so that it also serves before variables
 * have values and after they are lost. The port calls it first of all after reset, and after a fault, when nothing else
 * runs any more. Any context; the next rdpi_port_write_dac ends the safe state. */
void rdpi_port_safe(void);

/** Whether the board's watchdog has reset it; false where there is none, or none was asked for. The safe code is out
 * then; an application that goes on would move the actuator, and perhaps meet the same fault again and again. From
 * main. */
bool rdpi_port_watchdog_reset(void);

/** The latest readings of RDPI_AXES displacement sensors, in counts, or RDPI_PORT_NO_READING. From the tick; returns at
 * once. */
void rdpi_port_read_adc(int32_t *counts);

/** Ticks lost since the start because the one before had not returned: 0 in a healthy system. Saturates. Any context. */
uint32_t rdpi_port_overruns(void);

/** A free-running count of processor cycles, or whatever the board has that is near, for measuring a tick; wraps. Any
 * context. */
uint32_t rdpi_port_cycles(void);

/** Takes `count` bytes to be sent to the host, up to 128, all of them or none. Returns whether it took them; does not
 * wait. From the tick, or from main while no tick sends. */
bool rdpi_port_send(const uint8_t *bytes, size_t count);

/** What main does between ticks: sleeps until something has happened. After rdpi_port_start, from main, again and
 * again: a watchdog takes it as the sign that main is alive. */
void rdpi_port_idle(void);

#ifdef __cplusplus
}
#endif
#endif
