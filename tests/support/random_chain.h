/* A random chain around a random actuator, for the property tests. */
#ifndef RDPI_TEST_RANDOM_CHAIN_H
#define RDPI_TEST_RANDOM_CHAIN_H

#include "rdpi/f32_chain.h"
#include "scenario.h"

typedef struct {
    rdpi_f32_chain_params_t params;
    rdpi_f32_pole_t pole[RDPI_MAX_POLES];
} chain_t;

/* With or without lead, creep and lag. Call it after the last actuator_derive. */
static inline void random_chain(chain_t *self, const scenario_t *scenario)
{
    double T = scenario->sample_time_s;
    int what = choose(4); /* bit 0: a lead; bit 1: creep */
    double delay = what & 1 && choose(2) ? uniform(0, 50) : 0, lead = what & 1 && choose(2) ? uniform(0, 20) : 0;
    double bend = what & 1 ? (choose(2) ? log_uniform(0.01, 100) : 0) : 0, negative = 0;
    double limit_um = scenario->stroke_um * log_uniform(0.01, 10);
    int poles = what & 2 ? 1 + choose(RDPI_MAX_POLES) : 0;
    int preview = choose(2);
    double lag = choose(2) ? log_uniform(0.1, 50) : 0;
    self->params = (rdpi_f32_chain_params_t){
        .schema = RDPI_PARAMS_SCHEMA,
        .poles = (uint16_t)poles,
        .preview = (uint16_t)preview,
        .delay_s = (rdpi_real_t)(T * delay),
        .lag_s = (rdpi_real_t)(T * lag),
        .lead_s = (rdpi_real_t)(T * lead),
        .lead_s2 = (rdpi_real_t)(T * T * bend),
        .max_lead_um = (rdpi_real_t)limit_um,
        .axis = &scenario->actuator.params,
        .pole = self->pole,
    };
    for (int i = 0; i < poles; i++) {
        double share = uniform(-0.1, 0.2) / poles, samples = log_uniform(0.01, 1e8);
        self->pole[i] = (rdpi_f32_pole_t){(rdpi_real_t)share, (rdpi_real_t)(T * samples)};
        negative += fmin(share, 0);
    }
    self->params.direct = (rdpi_real_t)(poles > 0 ? uniform(0.3 - negative, 1) : 1);
    self->params.digest = rdpi_f32_chain_digest(&self->params);
}

#endif
