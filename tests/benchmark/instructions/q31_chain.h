/* The engine under measurement: rdpi_q31_chain. With LEADS, its lead makes up for a converter that is 0.3 ms late and
 * resonances with an alpha of 0.5 ms. With LAGS, an amplifier lags by 0.5 ms. There are POLES poles of creep, from 0.1 s
 * on, one per decade. */
#ifndef RDPI_BENCHMARK_ENGINE_H
#define RDPI_BENCHMARK_ENGINE_H

#include "rdpi/q31_chain.h"
#include "rdpi_params.h"

typedef int32_t reference_t;
typedef rdpi_q31_chain_t state_t;

#define NO_REFERENCE RDPI_Q31_NO_REFERENCE
#define FLAGS(state) ((state).axis.flags)
#define ENGINE_STEP rdpi_q31_chain_step
#define ENGINE_MISSED rdpi_q31_chain_missed
#define ENGINE_BLOCK rdpi_q31_chain_block

static inline bool start(state_t *self)
{
    static rdpi_q31_pole_t pole[RDPI_MAX_POLES];
    static rdpi_q31_chain_params_t params;
    uint64_t time_constant_ns = 100000000u;
    for (int i = 0; i < POLES; i++) {
        pole[i].share = RDPI_Q31_ONE / 100;
        pole[i].time_constant_ns = time_constant_ns;
        time_constant_ns *= 10u;
    }
    params = (rdpi_q31_chain_params_t){
        .schema = RDPI_PARAMS_SCHEMA, .poles = POLES, .preview = 1, .direct = RDPI_Q31_ONE, .axis = &rdpi_params_q31,
        .pole = pole, .max_lead = RDPI_Q31_ONE / 16};
    if (LEADS) {
        params.delay_ns = 300000;
        params.lead_ns = 500000;
    }
    params.lag_ns = LAGS ? 500000u : 0u;
    params.digest = rdpi_q31_chain_digest(&params);
    return rdpi_q31_chain_init(self, &params, SAMPLE_TIME_NS) == RDPI_OK;
}

#endif
