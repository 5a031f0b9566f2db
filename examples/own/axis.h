/* One actuator, between your timer and your DAC: start-up sweep, then your reference. Copy this file and axis.c.
 *
 * AXIS_Q31 is 1 for fixed point and 0 for single precision. By default it follows from the core: single precision if it
 * has a floating-point unit. On a PC it is 1. */
#ifndef AXIS_H
#define AXIS_H

#include <stdbool.h>
#include <stdint.h>

#include "rdpi/rdpi.h"
#include "rdpi_params.h" /* the actuator, made by `rdpi header` */

#ifndef AXIS_Q31
#if defined(__ARM_FP) || defined(__riscv_flen)
#define AXIS_Q31 0
#else
#define AXIS_Q31 1
#endif
#endif

/* AXIS_UM: a displacement in um as a reference. Of a constant, in fixed point too, the compiler makes a number. There it
 * takes off the offset of the sensor: a step from a to b is AXIS_UM(b) - AXIS_UM(a), and not AXIS_UM(b - a). */
#if AXIS_Q31
typedef int32_t axis_reference_t;
#define AXIS_UM(um) RDPI_PARAMS_Q31_REFERENCE(um)
#else
typedef float axis_reference_t;
#define AXIS_UM(um) ((float)(um))
#endif

/* Yours: the reference of a sample, counted from 0 at the end of the start-up sweep. A source that does not know the
 * future returns the present reference whatever `sample` is, and the header is made with `rdpi header --no-preview`. */
axis_reference_t axis_reference(uint32_t sample);

/* Once, before the timer runs. Anything but RDPI_OK: the parameters are damaged or of another version, or the rate does
 * not suit them; do not start the timer. */
rdpi_status_t axis_start(uint32_t rate_hz);

/* The code at which the model's memory begins: for the DAC, after axis_start and before the timer runs. */
uint32_t axis_first_code(void);

/* The code of the next sample. Call it at the rate given to axis_start, from one context. `lost` is how many samples
 * since the previous call had no call of their own. */
uint32_t axis_next(uint32_t lost);

#endif
