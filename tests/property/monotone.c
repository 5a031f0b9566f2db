/* Property test: from the same state, the higher of two references leads to the same code or to one that is further on,
 * wherever no flag is set and no slope depends on the rate. Any chain with codes.
 *
 *     monotone [CHAINS [SEED]] */
#include <stdio.h>
#include <stdlib.h>

#include "random_chain.h"

#define CHAINS 1500
#define STEPS 400
#define SEED 1u

static unsigned long compared, behind_lag, shaped, steps;

static void random_codes(scenario_t *scenario)
{
    rdpi_f32_params_t *params = &scenario->actuator.params;
    double rest_V = (double)params->sweep_end_V;
    double reach_V = uniform(0.3, 1.5) * scenario->stroke_um / fabs((double)scenario->actuator.curve[0].gain_um_per_V);
    params->dac_bits = (uint8_t)(4 + choose(13));
    params->min_V = (rdpi_real_t)(rest_V - reach_V);
    params->max_V = (rdpi_real_t)(rest_V + reach_V);
    do {
        random_curve(&scenario->actuator, rest_V, (double)params->min_V, (double)params->max_V);
    } while (params->curve_pieces >= 1u << params->dac_bits);
    params->sweep_V_per_s = (rdpi_real_t)(reach_V * 0.01 / scenario->sample_time_s);
    params->slew_V_per_s = choose(4) ? 0 : 8 * params->sweep_V_per_s;
    params->noise_shaping = RDPI_NOISE_SHAPING && choose(4) == 0;
    for (size_t i = 0; i < params->plays; i++) {
        scenario->actuator.memory_um[i] = 0;
    }
    actuator_derive(&scenario->actuator);
}

/* Whether what the lead makes of the latest reference rises with it. Without resonances, a jump has no lead; and what
 * interpolates between two references need not rise with the later one. */
static bool lead_rises(const rdpi_f32_chain_t *self)
{
    const rdpi_f32_chain_params_t *params = self->params;
    bool leads = params->delay_s > 0 || params->lead_s > 0 || params->lead_s2 > 0;
    return !leads || (self->lead.rings && self->lead.per_step >= 0);
}

static void run_chain(int number)
{
    static scenario_t scenario;
    static chain_t chain;
    static rdpi_f32_chain_t self, higher;
    random_scenario(&scenario, CONSTANT); /* no slope depends on the rate */
    random_codes(&scenario);
    random_chain(&chain, &scenario);
    const rdpi_f32_params_t *params = &scenario.actuator.params;
    rdpi_status_t status = rdpi_f32_chain_init(&self, &chain.params, (rdpi_real_t)scenario.sample_time_s);
    if (status != RDPI_OK) {
        printf("monotone: chain %d: init refuses: %d\n", number, (int)status);
        exit(1);
    }
    double side = (double)params->curve[0].gain_um_per_V > 0 ? 1 : -1;
    profile_t profile = {.stroke_um = scenario.stroke_um};
    for (int k = 0; k < STEPS; k++) {
        double reference_um = profile_next(&profile) + (double)params->offset_um;
        double higher_um = reference_um + scenario.stroke_um * log_uniform(1e-5, 1);
        if (choose(100) == 0) {
            rdpi_f32_chain_missed(&self, 1u + (unsigned)choose(4));
        }
        higher = self;
        (void)rdpi_f32_chain_step(&self, (rdpi_real_t)reference_um);
        (void)rdpi_f32_chain_step(&higher, (rdpi_real_t)higher_um);
        steps++;
        if (self.axis.flags != 0u || higher.axis.flags != 0u || !lead_rises(&self)) {
            continue;
        }
        compared++;
        behind_lag += chain.params.lag_s > 0;
        shaped += chain.params.lag_s > 0 && params->noise_shaping != 0u;
        double codes = (double)higher.axis.dac_code - (double)self.axis.dac_code;
        if (side * codes < 0 || side * (double)(higher.axis.drive_V - self.axis.drive_V) < 0) {
            printf("monotone: chain %d, step %d: references %.9g %.9g, codes %lu %lu, %d bits, gain %g, lag %g samples, "
                   "preview %d, %d poles, noise shaping %d\n",
                   number, k, reference_um, higher_um, (unsigned long)self.axis.dac_code,
                   (unsigned long)higher.axis.dac_code, params->dac_bits, (double)params->curve[0].gain_um_per_V,
                   (double)chain.params.lag_s / scenario.sample_time_s, chain.params.preview, chain.params.poles,
                   params->noise_shaping);
            exit(1);
        }
    }
}

int main(int argc, char **argv)
{
    int chains = argc > 1 ? atoi(argv[1]) : CHAINS;
    random_state += argc > 2 ? (uint64_t)atoi(argv[2]) : SEED;
    for (int number = 0; number < chains; number++) {
        run_chain(number);
    }
    printf("%d chains: %lu pairs of references in order, %lu of them ahead of a lag, %lu of these with noise shaping; of "
           "%lu steps\n",
           chains, compared, behind_lag, shaped, steps);
    if (compared < steps / 8 || behind_lag < steps / 20 || (RDPI_NOISE_SHAPING && shaped < steps / 200)) {
        printf("monotone: hardly any pair, lag or noise shaping\n");
        return 1;
    }
    return 0;
}
