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
    rdpi_f32_line_t curve[RDPI_MAX_CURVE_PIECES]; /* given: gains, ends within the range, first offset */
    rdpi_real_t memory_um[RDPI_MAX_PLAYS];
} actuator_t;

static inline void actuator_seal(actuator_t *self)
{
    self->params.schema = RDPI_PARAMS_SCHEMA;
    self->params.play = self->play;
    self->params.saturation = self->saturation;
    self->params.inverse_saturation = self->inverse_saturation;
    self->params.curve = self->curve;
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

/* Codes 0 .. 2^dac_bits - 1 over the drive range, and the input curve, from x and codes and back. Of its pieces are
 * given: the gain; to_V, which moves to the next code if there are codes; and the offset of the first. */
static inline void actuator_derive_curve(rdpi_f32_params_t *params, rdpi_f32_line_t *curve)
{
    long double span = (long double)params->max_V - params->min_V, low = (long double)params->min_V;
    bool codes = params->dac_bits > 0 && params->dac_bits <= RDPI_MAX_DAC_BITS && curve[0].gain_um_per_V != 0 && span > 0;
    long double last = codes ? (long double)((1uL << params->dac_bits) - 1u) : 0;
    long double V_per_code = codes ? span / last : 0;
    params->last_code = (rdpi_real_t)last;
    params->V_per_code = (rdpi_real_t)V_per_code;
    while (codes && (low + last * params->V_per_code > params->max_V ||
                     params->min_V + (rdpi_real_t)last * params->V_per_code > params->max_V)) {
        params->V_per_code = sizeof(rdpi_real_t) == sizeof(float)
                                 ? (rdpi_real_t)nextafterf((float)params->V_per_code, 0)
                                 : (rdpi_real_t)nextafter((double)params->V_per_code, 0);
    }
    long double from_V = low, from_code = 0;
    for (size_t i = 0; i < params->curve_pieces; i++) {
        rdpi_f32_line_t *line = &curve[i], *next = &curve[i + 1];
        long double gain = line->gain_um_per_V, offset = line->offset_V, to_V = params->max_V, to_code = last;
        if (i + 1 < params->curve_pieces) {
            to_V = line->to_V;
            if (codes) {
                long double most = last - (long double)(params->curve_pieces - 1u - i); /* leaves the others a code */
                to_code = fminl(most, fmaxl(from_code + 1, roundl((to_V - low) / V_per_code)));
                to_V = low + to_code * V_per_code;
            }
            next->offset_V = (rdpi_real_t)(to_V - gain * (to_V - offset) / next->gain_um_per_V);
        }
        *line = (rdpi_f32_line_t){
            .to_V = (rdpi_real_t)to_V,
            .to_um = (rdpi_real_t)(gain * (to_V - offset)),
            .middle_um = (rdpi_real_t)(gain * ((from_V + to_V) / 2 - offset)),
            .reach_um = (rdpi_real_t)fabsl(gain * (to_V - from_V) / 2),
            .gain_um_per_V = line->gain_um_per_V,
            .V_per_um = gain == 0 ? 0 : 1 / line->gain_um_per_V,
            .offset_V = line->offset_V,
            .from_code = (rdpi_real_t)from_code,
            .to_code = (rdpi_real_t)to_code,
            .codes_per_um = codes ? (rdpi_real_t)(1 / (gain * V_per_code)) : 0,
            .code_of_x_0 = codes ? (rdpi_real_t)((offset - low) / V_per_code + 0.5L) : 0,
            .um_per_code = (rdpi_real_t)(gain * V_per_code),
            .x_of_code_0_um = codes ? (rdpi_real_t)(gain * (low - offset)) : 0,
        };
        from_V = to_V;
        from_code = to_code;
    }
}

static inline void actuator_derive(actuator_t *self)
{
    if (self->params.curve_pieces == 0) { /* a test does not speak of it */
        self->params.curve_pieces = 1;
    }
    actuator_derive_curve(&self->params, self->curve);
    actuator_derive_intercepts(self->play, self->params.plays);
    actuator_derive_inverse(self->saturation, self->params.offset_um, self->inverse_saturation, self->params.deadzones);
    actuator_seal(self);
}

#endif
