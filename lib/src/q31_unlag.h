/* lag^-1 in fixed point. f32_unlag.h says what it does and why. */
#ifndef RDPI_Q31_UNLAG_H
#define RDPI_Q31_UNLAG_H

#include "q31_code.h"
#include "q31_lead.h"
#include "rdpi/q31_chain.h"

/* Returns whether it fits: it must not multiply by 2^28 or more. */
static inline bool rdpi_q31_unlag_init(rdpi_q31_chain_t *self, const rdpi_q31_chain_params_t *params, uint32_t T)
{
    rdpi_q31_unlag_t *unlag = &self->unlag;
    rdpi_q31_scaled_t ratio = rdpi_q31_lead_ratio(params->lag_ns, T);
    int shift = rdpi_q31_lead_shift(ratio.exponent, ratio.exponent);
    unlag->shift = (uint8_t)shift;
    unlag->per_step = rdpi_q31_lead_factor(ratio, shift, params->lag_ns);
    self->preview_samples += unlag->per_step > 0 ? params->preview : 0u;
    return shift >= 1;
}

/* What the operator has followed is what it outputs now. */
static inline void rdpi_q31_unlag_settle(rdpi_q31_unlag_t *unlag, const rdpi_q31_t *axis)
{
    unlag->followed = axis->drive;
    unlag->dac_code = axis->dac_code;
    unlag->ramp = rdpi_q31_widen(axis->drive);
    unlag->carried = 0;
    unlag->asked = axis->drive;
    unlag->before = 0;
    unlag->first = true;
}

/* The operator gets its own drive back. */
static inline void rdpi_q31_unlag_give_back(const rdpi_q31_unlag_t *unlag, rdpi_q31_t *axis)
{
    if (unlag->per_step > 0) {
        axis->drive = unlag->followed;
        axis->dac_code = unlag->dac_code;
    }
}

/* s of two differences. */
static inline int32_t rdpi_q31_unlag_slope(int32_t a, int32_t b)
{
    if (!((a > 0 && b > 0) || (a < 0 && b < 0))) {
        return 0;
    }
    int64_t mean = ((int64_t)a + b) / 2, most = 2 * (int64_t)((a < b) == (a > 0) ? a : b);
    return (int32_t)((mean < most) == (a > 0) ? mean : most); /* within the larger of both */
}

/* The drive to output, before range and slew. Scaling and overflow: differences of drives saturate at +-INT32_MAX. */
static inline int64_t rdpi_q31_unlag_wish(rdpi_q31_unlag_t *unlag, const rdpi_q31_t *axis, bool preview, unsigned missed)
{
    int32_t asked = (int32_t)(axis->ramp >> 32);
    if (unlag->first || missed > RDPI_MAX_MISSED) {
        unlag->asked = asked;
        unlag->before = 0;
        missed = 0;
    }
    unlag->first = false;
    int32_t step = rdpi_q31_lead_narrow((int64_t)asked - unlag->asked);
    if (missed > 0u) {
        int32_t way = (int32_t)rdpi_q31_part(rdpi_q31_distance(asked, unlag->asked), missed + 1u);
        step = step < 0 ? -way : way; /* < 2^31: they are two at least */
        unlag->before = step;
    }
    int32_t slope = rdpi_q31_unlag_slope(step, unlag->before);
    unlag->asked = asked;
    unlag->before = step;
    return (preview ? (int64_t)asked - step : asked) + (rdpi_q31_mul(unlag->per_step, slope) >> unlag->shift);
}

/* Outputs a drive as near to `wish` as range and slew allow. Returns whether they allow it. */
static inline bool rdpi_q31_unlag_output(rdpi_q31_unlag_t *unlag, rdpi_q31_t *axis, int64_t wish)
{
    const rdpi_q31_params_t *params = axis->params;
    int32_t drive = rdpi_q31_clamp(wish, params->min_drive, params->max_drive);
    bool allowed = drive == wish;
    int64_t change = rdpi_q31_widen(drive) - unlag->ramp;
    if (axis->slew > 0 && (change > axis->slew || change < -axis->slew)) {
        change = change > 0 ? axis->slew : -axis->slew;
        allowed = false;
    }
    unlag->ramp += change;
    drive = rdpi_q31_clamp(unlag->ramp >> 32, params->min_drive, params->max_drive);
    axis->drive = drive;
    if (params->dac_bits > 0u) {
        int32_t shaped = rdpi_q31_clamp((int64_t)drive + unlag->carried, params->min_drive, params->max_drive);
        int64_t code = rdpi_q31_code_of_drive(params, shaped);
        axis->dac_code = (uint32_t)code;
        axis->drive = rdpi_q31_clamp(rdpi_q31_drive_of_code(params, code), params->min_drive, params->max_drive);
#if RDPI_NOISE_SHAPING
        unlag->carried = params->noise_shaping != 0u && allowed ? shaped - axis->drive : 0;
#endif
    }
    return allowed;
}

#endif
