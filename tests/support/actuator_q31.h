/* The parameters of one actuator in fixed point for the tests. A test changes a field and derives or only seals
 * again: addresses, schema and digest. */
#ifndef RDPI_TEST_ACTUATOR_Q31_H
#define RDPI_TEST_ACTUATOR_Q31_H

#include "rdpi/q31.h"

/* One unit of x, r and y in these tests ("um"), and of displacement. */
#define U ((int32_t)1 << 20)

typedef struct {
    rdpi_q31_params_t params;
    rdpi_q31_play_t play[RDPI_MAX_PLAYS];
    rdpi_q31_deadzone_t saturation[RDPI_MAX_DEADZONES], inverse_saturation[RDPI_MAX_DEADZONES];
    rdpi_q31_line_t curve[RDPI_MAX_CURVE_PIECES]; /* given: where each begins */
    int32_t memory[RDPI_MAX_PLAYS];
} actuator_q31_t;

static inline void actuator_q31_seal(actuator_q31_t *self)
{
    self->params.schema = RDPI_PARAMS_SCHEMA;
    self->params.play = self->play;
    self->params.saturation = self->saturation;
    self->params.inverse_saturation = self->inverse_saturation;
    self->params.curve = self->curve;
    self->params.memory = self->memory;
    self->params.digest = rdpi_q31_digest(&self->params);
}

/* A quotient as the codes need it: dividend / divisor = result / 2^shift, 2^30 .. 2^31; both > 0. */
static inline int64_t actuator_q31_quotient(int64_t dividend, int64_t divisor, uint8_t *shift)
{
    for (*shift = 1; (dividend << *shift) / divisor < (int64_t)1 << 30; (*shift)++) {
    }
    return ((dividend << *shift) + divisor / 2) / divisor;
}

/* The slopes of the pieces, from where they begin and where the range ends. */
static inline void actuator_q31_curve(const rdpi_q31_params_t *params, rdpi_q31_line_t *curve)
{
    for (size_t k = 0; k < params->curve_pieces; k++) {
        bool last = k + 1 == params->curve_pieces;
        int64_t drives = (int64_t)(last ? params->max_drive : curve[k + 1].from_drive) - curve[k].from_drive;
        int64_t x = (int64_t)(last ? params->max_x : curve[k + 1].from_x) - curve[k].from_x;
        uint8_t shift;
        int64_t slope = actuator_q31_quotient(x, drives, &shift);
        curve[k].x_per_drive = (int32_t)(slope < INT32_MAX ? slope : INT32_MAX);
        curve[k].x_shift = shift;
        slope = actuator_q31_quotient(drives, x, &shift);
        curve[k].drive_per_x = (int32_t)(slope < INT32_MAX ? slope : INT32_MAX);
        curve[k].drive_shift = shift;
    }
}

/* What follows from other fields where there are no codes, and the seal. */
static inline void actuator_q31_derive(actuator_q31_t *self)
{
    if (self->params.dac_bits == 0u) {
        self->params.drive_of_code_0 = self->params.min_drive;
    }
    if (self->params.curve_pieces < 2u) { /* a test does not speak of it */
        self->params.curve_pieces = 1;
        self->params.min_x = self->params.min_drive;
        self->params.max_x = self->params.max_drive;
    } else {
        actuator_q31_curve(&self->params, self->curve);
    }
    actuator_q31_seal(self);
}

/* Codes of `bits` bits over the range, rising with the drive or falling. */
static inline void actuator_q31_codes(actuator_q31_t *self, unsigned bits, bool falling)
{
    rdpi_q31_params_t *params = &self->params;
    int64_t span = (int64_t)params->max_drive - params->min_drive, last = ((int64_t)1 << bits) - 1;
    params->dac_bits = (uint8_t)bits;
    params->drive_of_code_0 = falling ? params->max_drive : params->min_drive;
    int64_t codes = actuator_q31_quotient(last, span, &params->code_shift);
    int64_t drives = actuator_q31_quotient(span, last, &params->drive_shift);
    params->codes_per_drive = (int32_t)(falling ? -codes : (codes < INT32_MAX ? codes : INT32_MAX));
    params->drive_per_code = (int32_t)(falling ? -drives : (drives < INT32_MAX ? drives : INT32_MAX));
}

#endif
