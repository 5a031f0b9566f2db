/* The parameters of one actuator for the tests. A test fills in what is identified and chosen; actuator_derive adds
 * what `rdpi header` would derive from it, and actuator_seal the addresses, schema and digest. So a test changes one
 * field, and derives or only seals again. */
#ifndef RDPI_TEST_ACTUATOR_H
#define RDPI_TEST_ACTUATOR_H

#include <math.h> /* not tgmath.h: some of what that refers to is not in newlib */

#include "rdpi/f32.h"

typedef struct {
    rdpi_f32_params_t params;
    rdpi_f32_play_t play[RDPI_MAX_PLAYS];
    rdpi_f32_deadzone_t saturation[RDPI_MAX_DEADZONES];
    rdpi_f32_piece_t inverse_saturation[RDPI_MAX_DEADZONES];
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

/* Eq. 13: S^-1 bends where S does, its slopes are the inverses of S's. Goes on straight where S has no inverse. */
static inline void actuator_derive_inverse(const rdpi_f32_deadzone_t *saturation, rdpi_real_t offset_um,
                                           rdpi_f32_piece_t *inverse, size_t count)
{
    long double z = 0, slope = 0;
    for (size_t j = 0; j < count; j++) {
        z += j == 0 ? 0 : slope * ((long double)saturation[j].d_um - saturation[j - 1].d_um);
        slope += slope + saturation[j].weight > 0 ? saturation[j].weight : 0;
        long double corner = z + offset_um, per_slope = slope > 0 ? 1 / slope : 1;
        inverse[j] = (rdpi_f32_piece_t){(rdpi_real_t)corner, RDPI_MAX_REFERENCE_UM, (rdpi_real_t)per_slope,
                                        (rdpi_real_t)(saturation[j].d_um - per_slope * z)};
        if (j > 0) {
            inverse[j - 1].to_um = inverse[j].from_um;
        }
    }
    inverse[0].from_um = -RDPI_MAX_REFERENCE_UM;
}

/* Codes 0 .. 2^dac_bits - 1 over the drive range, from x and back. */
static inline void actuator_derive_codes(rdpi_f32_params_t *params)
{
    long double gain = params->gain_um_per_V, span = (long double)params->max_V - params->min_V;
    bool codes = params->dac_bits > 0 && params->dac_bits <= RDPI_MAX_DAC_BITS && gain != 0 && span > 0;
    long double last = codes ? (long double)((1uL << params->dac_bits) - 1u) : 0, low = (long double)params->min_V;
    long double V_per_code = codes ? span / last : 0;
    params->last_code = (rdpi_real_t)last;
    params->um_per_code = (rdpi_real_t)(gain * V_per_code);
    params->x_of_code_0_um = codes ? (rdpi_real_t)(gain * (low - params->offset_V)) : 0;
    params->codes_per_um = codes ? (rdpi_real_t)(1 / (gain * V_per_code)) : 0;
    params->code_of_x_0 = codes ? (rdpi_real_t)((params->offset_V - low) / V_per_code + 0.5L) : 0;
    params->V_per_code = (rdpi_real_t)V_per_code;
    while (codes && (low + last * params->V_per_code > params->max_V ||
                     params->min_V + (rdpi_real_t)last * params->V_per_code > params->max_V)) {
        params->V_per_code = sizeof(rdpi_real_t) == sizeof(float)
                                 ? (rdpi_real_t)nextafterf((float)params->V_per_code, 0)
                                 : (rdpi_real_t)nextafter((double)params->V_per_code, 0);
    }
}

static inline void actuator_derive(actuator_t *self)
{
    rdpi_real_t gain = self->params.gain_um_per_V;
    self->params.V_per_um = gain == 0 ? 0 : 1 / gain;
    actuator_derive_intercepts(self->play, self->params.plays);
    actuator_derive_inverse(self->saturation, self->params.offset_um, self->inverse_saturation, self->params.deadzones);
    actuator_derive_codes(&self->params);
    actuator_seal(self);
}

#endif
