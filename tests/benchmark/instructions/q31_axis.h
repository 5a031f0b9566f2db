/* The engine under measurement: rdpi_q31_axis while it runs. */
#ifndef RDPI_BENCHMARK_ENGINE_H
#define RDPI_BENCHMARK_ENGINE_H

#include "q31_chain_params.h"
#include "rdpi/q31_axis.h"

typedef int32_t reference_t;
typedef rdpi_q31_axis_t state_t;

#define NO_REFERENCE RDPI_Q31_NO_REFERENCE
#define FLAGS(state) ((state).flags)
#define ENGINE_STEP rdpi_q31_axis_step
#define ENGINE_MISSED rdpi_q31_axis_missed
#define RAMP_SAMPLES 100000u /* more than a ramp over the whole range takes */

static inline bool start(state_t *self)
{
    if (rdpi_q31_axis_init(self, chain_params(), SAMPLE_TIME_NS, rdpi_params_q31.sweep_end) != RDPI_OK
        || rdpi_q31_axis_restart(self) != RDPI_OK) {
        return false;
    }
    for (uint32_t k = 0; k < RAMP_SAMPLES && self->mode != RDPI_AXIS_RUN; k++) {
        (void)rdpi_q31_axis_step(self, profile[0]);
    }
    return self->mode == RDPI_AXIS_RUN;
}

#endif
