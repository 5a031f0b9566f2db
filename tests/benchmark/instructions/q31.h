/* The engine under measurement: rdpi_q31. */
#ifndef RDPI_BENCHMARK_ENGINE_H
#define RDPI_BENCHMARK_ENGINE_H

#include "rdpi/q31.h"
#include "rdpi_params.h"

typedef int32_t reference_t;
typedef rdpi_q31_t state_t;

#define NO_REFERENCE RDPI_Q31_NO_REFERENCE
#define FLAGS(state) ((state).flags)
#define ENGINE_STEP rdpi_q31_step
#define ENGINE_MISSED rdpi_q31_missed

static inline bool start(state_t *self)
{
    return rdpi_q31_init(self, &rdpi_params_q31, SAMPLE_TIME_NS) == RDPI_OK;
}

#endif
