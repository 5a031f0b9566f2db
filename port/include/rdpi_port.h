/* The port contract: what an application needs of a board to run rdpi. One folder beside this one per board; the same
 * application links against every one of them. See port/README.md.
 *
 * The board samples at a fixed rate. At every sample its timer calls the application's tick; the tick reads the
 * reference, computes and writes a code to the DAC. Everything else happens in main. */
#ifndef RDPI_PORT_H
#define RDPI_PORT_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What the timer calls once per sample; on a microcontroller in interrupt context. */
typedef void (*rdpi_port_tick_t)(void);

/* Starts the timer: from now on `tick` is called `rate_hz` times a second. Returns true, or false if the board cannot
 * keep this rate to 0.1 %; the timer is then not running. Call it once, from main. */
bool rdpi_port_start(uint32_t rate_hz, rdpi_port_tick_t tick);

/* The reference of the present sample: a displacement in um. NaN when the source has none to give, which
 * rdpi_f32_step answers by holding the drive. Call it from the tick; returns at once. */
float rdpi_port_reference_um(void);

/* Outputs a code of the DAC, 0 .. 2^bits - 1, which is held until the next. Higher bits are ignored. From the tick, or
 * from main before rdpi_port_start; does not wait for the transfer to end. */
void rdpi_port_write_dac(uint32_t code);

/* Ticks lost since the start because the one before had not returned: 0 in a healthy system. Saturates. Any context. */
uint32_t rdpi_port_overruns(void);

/* What main does between ticks: sleeps until something has happened and returns true, or false when the reference is
 * at its end and no tick follows. Boards that run for ever never return false. From main, after rdpi_port_start. */
bool rdpi_port_idle(void);

#ifdef __cplusplus
}
#endif
#endif
