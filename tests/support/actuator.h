/* The parameters of one actuator for the tests. A test fills in what is identified and chosen; actuator_derive adds
 * what `rdpi header` would derive from it, and actuator_seal the addresses, schema and digest. So a test changes one
 * field, and derives or only seals again. */
#ifndef RDPI_TEST_ACTUATOR_H
#define RDPI_TEST_ACTUATOR_H

#include "rdpi/f32.h"

typedef struct {
    rdpi_f32_params_t params;
    rdpi_f32_play_t play[RDPI_MAX_PLAYS];
    rdpi_f32_deadzone_t saturation[RDPI_MAX_DEADZONES], inverse_saturation[RDPI_MAX_DEADZONES];
    rdpi_real_t memory_um[RDPI_MAX_PLAYS];
} actuator_t;

static inline void actuator_seal(actuator_t *self)
{
    self->params.schema = RDPI_PARAMS_SCHEMA;
    self->params.play = self->play;
    self->params.saturation = self->saturation;
    self->params.inverse_saturation = self->inverse_saturation;
    self->params.memory_um = self->memory_um;
    self->params.digest = rdpi_f32_digest(&self->params);
}

/* Eq. 15: the curve goes on without a jump where W_(i-1) gives way to W_i. */
static inline void actuator_derive_intercepts(rdpi_f32_play_t *play, size_t count)
{
    long double at_rest = 0, per_rate = 0;
    play[0].intercept_um = play[0].intercept_rate_s = 0;
    for (size_t i = 1; i < count; i++) {
        long double r = play[i].r_um;
        at_rest += ((long double)play[i].slope - play[i - 1].slope) * r;
        per_rate += ((long double)play[i].slope_rate_s_per_um - play[i - 1].slope_rate_s_per_um) * r;
        play[i].intercept_um = (rdpi_real_t)at_rest;
        play[i].intercept_rate_s = (rdpi_real_t)per_rate;
    }
}

/* Eq. 13: thresholds are where S bends, slopes the inverses of its slopes. Leaves 0 from where S has no inverse on. */
static inline void actuator_derive_inverse(const rdpi_f32_deadzone_t *saturation, rdpi_f32_deadzone_t *inverse,
                                           size_t count)
{
    long double z = 0, slope = 0, per_slope_before = 0;
    for (size_t j = 0; j < count; j++) {
        z += j == 0 ? 0 : slope * ((long double)saturation[j].d_um - saturation[j - 1].d_um);
        slope += saturation[j].weight;
        long double per_slope = slope > 0 ? 1 / slope : per_slope_before;
        inverse[j].d_um = (rdpi_real_t)z;
        inverse[j].weight = (rdpi_real_t)(per_slope - per_slope_before);
        per_slope_before = per_slope;
    }
}

static inline void actuator_derive(actuator_t *self)
{
    rdpi_real_t gain = self->params.gain_um_per_V;
    self->params.V_per_um = gain == 0 ? 0 : 1 / gain;
    actuator_derive_intercepts(self->play, self->params.plays);
    actuator_derive_inverse(self->saturation, self->inverse_saturation, self->params.deadzones);
    actuator_seal(self);
}

#endif
