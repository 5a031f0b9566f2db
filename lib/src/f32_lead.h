/* The lead: a filter on the reference r that makes up for delay and resonances,
 *
 *   z(t) = r + alpha r' + beta r'', at the time t + D.
 *
 * With T the sample time, n = round(D / T) and f = D - n T, the time t + D is f after a sample. Taylor's series around
 * that sample moves f into the factors: a = alpha + f and b = beta + alpha f + f^2 / 2. With d the latest difference of
 * two references and d' the one before it:
 *
 *   preview, the latest reference u is n + 1 samples ahead:  z = u - d + a (d + d') / (2 T) + b (d - d') / T^2
 *   no preview, n = 0 and f = D:                             z = u + a (3 d - d') / (2 T) + b (d - d') / T^2
 *
 * What comes after u - d or u is per_step d + per_before d'. It is limited. Without resonances it is 0 unless d and d'
 * have the same sign: a jump would overshoot. */
#ifndef RDPI_F32_LEAD_H
#define RDPI_F32_LEAD_H

#include "f32_math.h"
#include "rdpi/f32_chain.h"

/* The longest delay, in samples. Single precision counts them up to here. */
#define MAX_DELAY 16777215

/* Whether the chain has a lead. */
static inline bool rdpi_f32_lead_wanted(const rdpi_f32_chain_params_t *params)
{
    return params->delay_s > 0 || params->lead_s > 0 || params->lead_s2 > 0;
}

/* Sets up the lead, and the samples of preview that it needs. Returns false if the delay is too long. */
static inline bool rdpi_f32_lead_init(rdpi_f32_lead_t *lead, const rdpi_f32_chain_params_t *params,
                                      rdpi_real_t sample_time_s, uint32_t *preview_samples)
{
    rdpi_real_t delay = params->delay_s / sample_time_s + (rdpi_real_t)0.5, part_s = params->delay_s;
    *preview_samples = 0;
    if (!(delay <= MAX_DELAY)) {
        return false;
    }
    if (params->preview != 0u) {
        uint32_t whole = (uint32_t)delay;
        part_s -= (rdpi_real_t)whole * sample_time_s;
        *preview_samples = whole + 1u;
    }
    rdpi_real_t per_s = 1 / sample_time_s;
    rdpi_real_t slope = (params->lead_s + part_s) * per_s;
    rdpi_real_t bend_s2 = params->lead_s2 + part_s * (params->lead_s + part_s / 2);
    rdpi_real_t bend = bend_s2 * per_s * per_s;
    if (params->preview == 0u) {
        bend += slope; /* (3 d - d') / 2 = (d + d') / 2 + (d - d') */
    }
    lead->per_step = slope / 2 + bend;
    lead->per_before = slope / 2 - bend;
    lead->rings = params->lead_s > 0 || params->lead_s2 > 0;
    lead->max_um = params->max_lead_um;
    return true;
}

/* What the lead adds, before it is limited, if `step_um` is the latest difference. */
static inline rdpi_real_t rdpi_f32_lead_at(const rdpi_f32_lead_t *lead, rdpi_real_t step_um)
{
    return rdpi_f32_fma(lead->per_step, step_um, lead->per_before * lead->before_um);
}

/* Whether the reference jumps, or turns round, where there are no resonances. */
static inline bool rdpi_f32_lead_jumps(const rdpi_f32_lead_t *lead, rdpi_real_t step_um)
{
    return !lead->rings && !(step_um * lead->before_um > 0);
}

/* Takes the reference `ahead_um`, `step_um` above the one before it. */
static inline void rdpi_f32_lead_take(rdpi_f32_lead_t *lead, rdpi_real_t ahead_um, rdpi_real_t step_um)
{
    lead->latest_um = ahead_um;
    lead->before_um = step_um;
}

#endif
