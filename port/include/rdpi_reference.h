/** @file
 * Where an application gets its reference from, sample by sample: a profile in flash (port/profile), a CSV file
 * (port/sim) or your own source, an ADC for instance. Only the function for the number format of the application is needed. */
#ifndef RDPI_REFERENCE_H
#define RDPI_REFERENCE_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/** The reference of the present sample, `ticks` samples after the one before, or after the start (1, and more where
 * ticks were lost): a displacement in um, or NaN if there is none at the moment, which rdpi_f32_step answers by holding
 * the drive. Returns false, and leaves `reference_um`, when the source is at its end. Called from the tick; returns at
 * once. */
bool rdpi_reference_um(uint32_t ticks, float *reference_um);

/** The same for rdpi_q31_step: in the reference units of the parameters, RDPI_Q31_NO_REFERENCE in place of NaN. */
bool rdpi_reference_q31(uint32_t ticks, int32_t *reference);

#ifdef __cplusplus
}
#endif
#endif
