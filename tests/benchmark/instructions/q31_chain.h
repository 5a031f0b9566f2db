/* The engine under measurement: rdpi_q31_chain. */
#ifndef RDPI_BENCHMARK_ENGINE_H
#define RDPI_BENCHMARK_ENGINE_H

#include "q31_chain_params.h"

typedef int32_t reference_t;
typedef rdpi_q31_chain_t state_t;

#define NO_REFERENCE RDPI_Q31_NO_REFERENCE
#define FLAGS(state) ((state).axis.flags)
#define ENGINE_STEP rdpi_q31_chain_step
#define ENGINE_MISSED rdpi_q31_chain_missed
#define ENGINE_BLOCK rdpi_q31_chain_block

static inline bool start(state_t *self)
{
    return rdpi_q31_chain_init(self, chain_params(), SAMPLE_TIME_NS) == RDPI_OK;
}

#endif
