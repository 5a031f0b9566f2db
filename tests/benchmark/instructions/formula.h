/* The engine under measurement: the published inverse (eq. 10, 12, 13 and 18 of Ang et al., IROS 2003) as a complete
 * step, all else as in rdpi_f32_step: rate, guard, S^-1, limits, code, flags and counts. As printed it is O(n^2); with
 * FORMULA_LINEAR it is tests/property/formula_inverse.h, which saves what can be saved. */
#ifndef RDPI_BENCHMARK_ENGINE_H
#define RDPI_BENCHMARK_ENGINE_H

#include "rdpi/f32.h"
#include "rdpi_params.h"

#include "formula_inverse.h"

typedef float reference_t;

typedef struct {
    float drive_V, rate_um_per_s;
    uint32_t dac_code, flags, guard_count, clip_count, input_count, missed_count;
    const rdpi_f32_params_t *params;
    float sample_time_s, codes_per_V, V_per_code, ramp_V;
    uint16_t missed;
    rdpi_f32_rate_t rate;
    formula_inverse_t bank;
} state_t;

#define NO_REFERENCE (0.0f / 0.0f)
#define FLAGS(state) ((state).flags)
#define ENGINE_STEP formula_step
#define ENGINE_MISSED formula_missed

bool formula_start(state_t *self, const rdpi_f32_params_t *params, float sample_time_s);
float formula_step(state_t *self, float reference_um);
void formula_missed(state_t *self, uint32_t ticks);

static inline bool start(state_t *self)
{
    return formula_start(self, &rdpi_params, SAMPLE_TIME_NS * 1e-9f);
}

#endif
