/* The step of the operator for lag^-1, which has to know more than the code. */
#ifndef RDPI_F32_STEP_H
#define RDPI_F32_STEP_H

#include "f32_math.h"

#if RDPI_QUICK_STEP > 0
/* As rdpi_f32_step, and keeps ramp_V, the drive before it is rounded to a code. A function of its own, because the quick
 * way of rdpi_f32_step must not pay for it. */
rdpi_real_t rdpi_f32_step_asking(rdpi_f32_t *self, rdpi_real_t reference_um);
#endif

#endif
