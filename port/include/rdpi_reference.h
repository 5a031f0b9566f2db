/** @file
 * Where an application gets its reference from, sample by sample: a profile in flash (port/profile), a CSV file
 * (port/sim) or your own source, an ADC for instance. Only the function for the number format of the application is
 * needed.
 *
 * With several axes the build compiles the source of references once for each, and says which, RDPI_AXIS, from 0: the
 * functions of the others have their axis behind the name, so that the source is written as for one. */
#ifndef RDPI_REFERENCE_H
#define RDPI_REFERENCE_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef RDPI_AXIS
#define RDPI_AXIS 0
#endif

/** A name with this axis behind it. */
#define RDPI_AXIS_NAME(name) RDPI_AXIS_NAME_OF(name, RDPI_AXIS)
#define RDPI_AXIS_NAME_OF(name, axis) RDPI_AXIS_PASTE(name, axis)
#define RDPI_AXIS_PASTE(name, axis) name##_##axis

#if RDPI_AXIS > 0
#define rdpi_reference_um RDPI_AXIS_NAME(rdpi_reference_um)
#define rdpi_reference_q31 RDPI_AXIS_NAME(rdpi_reference_q31)
#endif

/** The reference of the present sample, and the one `ahead` samples later: displacements in um, or NaN where there is
 * none, which rdpi_f32_chain_step answers by holding the drive. Called from the tick; returns at once.
 *
 * - The present sample is `ticks` samples after the one before, or after the start: 1, and more where ticks were lost.
 * - `ahead` is preview_samples of the chain, the same in every call.
 * - A source that knows its end holds the last reference beyond it.
 * - A source that does not know the future gives the present reference twice. Its parameters then need
 *   `rdpi header --no-preview`: the library extrapolates, and `ahead` is 0.
 *
 * Returns false, and leaves both, when the present sample is beyond the source's end. */
bool rdpi_reference_um(uint32_t ticks, uint32_t ahead, float *reference_um, float *ahead_um);

/** The same for rdpi_q31_chain_step: in the reference units of the parameters, RDPI_Q31_NO_REFERENCE in place of
 * NaN. */
bool rdpi_reference_q31(uint32_t ticks, uint32_t ahead, int32_t *reference, int32_t *ahead_reference);

#ifdef __cplusplus
}
#endif
#endif
