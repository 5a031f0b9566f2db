/* The parameters of the chain under measurement. With LEADS, its lead makes up for a converter that is 0.3 ms late and
 * resonances with an alpha of 0.5 ms. With LAGS, an amplifier lags by 0.5 ms. There are POLES poles of creep, from 0.1 s
 * on, one per decade. */
#ifndef RDPI_BENCHMARK_CHAIN_PARAMS_H
#define RDPI_BENCHMARK_CHAIN_PARAMS_H

#include "rdpi/f32_chain.h"
#include "rdpi_params.h"

static inline const rdpi_f32_chain_params_t *chain_params(void)
{
    static const rdpi_f32_pole_t pole[] = {{0.01f, 0.1f}, {0.01f, 1}, {0.01f, 10}, {0.01f, 100}, {0.01f, 1000}};
    static rdpi_f32_chain_params_t params;
    params = (rdpi_f32_chain_params_t){
        .schema = RDPI_PARAMS_SCHEMA, .poles = POLES, .preview = 1, .direct = 1, .axis = &rdpi_params, .pole = pole,
        .max_lead_um = 1e-3f * rdpi_params.max_um_per_s};
    if (LEADS) {
        params.delay_s = 0.3e-3f;
        params.lead_s = 0.5e-3f;
    }
    params.lag_s = LAGS ? 0.5e-3f : 0;
    params.digest = rdpi_f32_chain_digest(&params);
    return &params;
}

#endif
