/* The engine under measurement: rdpi_f32_axis while it runs. */
#ifndef RDPI_BENCHMARK_ENGINE_H
#define RDPI_BENCHMARK_ENGINE_H

#include "f32_chain_params.h"
#include "rdpi/f32_axis.h"

typedef float reference_t;
typedef rdpi_f32_axis_t state_t;

#define NO_REFERENCE (0.0f / 0.0f)
#define FLAGS(state) ((state).flags)
#define ENGINE_STEP rdpi_f32_axis_step
#define ENGINE_MISSED rdpi_f32_axis_missed
#define RAMP_SAMPLES 100000u /* more than a ramp over the whole range takes */

static inline bool start(state_t *self)
{
    if (rdpi_f32_axis_init(self, chain_params(), SAMPLE_TIME_NS * 1e-9f, rdpi_params.sweep_end_V) != RDPI_OK
        || rdpi_f32_axis_restart(self) != RDPI_OK) {
        return false;
    }
    for (uint32_t k = 0; k < RAMP_SAMPLES && self->mode != RDPI_AXIS_RUN; k++) {
        (void)rdpi_f32_axis_step(self, profile[0]);
    }
    return self->mode == RDPI_AXIS_RUN;
}

#endif
