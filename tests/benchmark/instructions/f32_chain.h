/* The engine under measurement: rdpi_f32_chain. */
#ifndef RDPI_BENCHMARK_ENGINE_H
#define RDPI_BENCHMARK_ENGINE_H

#include "f32_chain_params.h"

typedef float reference_t;
typedef rdpi_f32_chain_t state_t;

#define NO_REFERENCE (0.0f / 0.0f)
#define FLAGS(state) ((state).axis.flags)
#define ENGINE_STEP rdpi_f32_chain_step
#define ENGINE_MISSED rdpi_f32_chain_missed
#define ENGINE_BLOCK rdpi_f32_chain_block

static inline bool start(state_t *self)
{
    return rdpi_f32_chain_init(self, chain_params(), SAMPLE_TIME_NS * 1e-9f) == RDPI_OK;
}

#endif
