/* The engine under measurement: rdpi_f32. */
#ifndef RDPI_BENCHMARK_ENGINE_H
#define RDPI_BENCHMARK_ENGINE_H

#include "rdpi/f32.h"
#include "rdpi_params.h"

typedef float reference_t;
typedef rdpi_f32_t state_t;

#define NO_REFERENCE (0.0f / 0.0f)
#define FLAGS(state) ((state).flags)
#define ENGINE_STEP rdpi_f32_step
#define ENGINE_MISSED rdpi_f32_missed

static inline bool start(state_t *self)
{
    return rdpi_f32_init(self, &rdpi_params, SAMPLE_TIME_NS * 1e-9f) == RDPI_OK;
}

#endif
