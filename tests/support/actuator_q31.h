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
    int32_t memory[RDPI_MAX_PLAYS];
} actuator_q31_t;

static inline void actuator_q31_seal(actuator_q31_t *self)
{
    self->params.schema = RDPI_PARAMS_SCHEMA;
    self->params.play = self->play;
    self->params.saturation = self->saturation;
    self->params.inverse_saturation = self->inverse_saturation;
    self->params.memory = self->memory;
    self->params.digest = rdpi_q31_digest(&self->params);
}

/* What follows from other fields where there are no codes, and the seal. */
static inline void actuator_q31_derive(actuator_q31_t *self)
{
    if (self->params.dac_bits == 0u) {
        self->params.drive_of_code_0 = self->params.min_drive;
    }
    actuator_q31_seal(self);
}

/* A quotient as the codes need it: dividend / divisor = result / 2^shift, 2^30 .. 2^31; both > 0. */
static inline int64_t actuator_q31_quotient(int64_t dividend, int64_t divisor, uint8_t *shift)
{
    for (*shift = 1; (dividend << *shift) / divisor < (int64_t)1 << 30; (*shift)++) {
    }
    return ((dividend << *shift) + divisor / 2) / divisor;
}

/* Codes of `bits` bits over the range, rising with the drive or falling. */
static inline void actuator_q31_codes(actuator_q31_t *self, unsigned bits, bool falling)
{
    rdpi_q31_params_t *params = &self->params;
    int64_t span = (int64_t)params->max_drive - params->min_drive, last = ((int64_t)1 << bits) - 1;
    params->dac_bits = (uint16_t)bits;
    params->drive_of_code_0 = falling ? params->max_drive : params->min_drive;
    int64_t codes = actuator_q31_quotient(last, span, &params->code_shift);
    int64_t drives = actuator_q31_quotient(span, last, &params->drive_shift);
    params->codes_per_drive = (int32_t)(falling ? -codes : (codes < INT32_MAX ? codes : INT32_MAX));
    params->drive_per_code = (int32_t)(falling ? -drives : (drives < INT32_MAX ? drives : INT32_MAX));
}

#endif
