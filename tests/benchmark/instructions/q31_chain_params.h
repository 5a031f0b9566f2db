/* The parameters of the chain under measurement. With LEADS, its lead makes up for a converter that is 0.3 ms late and
 * resonances with an alpha of 0.5 ms. With LAGS, an amplifier lags by 0.5 ms. There are POLES poles of creep, from 0.1 s
 * on, one per decade. */
#ifndef RDPI_BENCHMARK_CHAIN_PARAMS_H
#define RDPI_BENCHMARK_CHAIN_PARAMS_H

#include "rdpi/q31_chain.h"
#include "rdpi_params.h"

static inline const rdpi_q31_chain_params_t *chain_params(void)
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
    return &params;
}

#endif
