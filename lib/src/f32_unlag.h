/* lag^-1: the lead of the drive that makes up for the lag of an amplifier, y' = (u - y) / lag_s.
 *
 * The plays follow y, so y is the drive x that the operator asks for, and u = x + lag_s x'. With d the latest difference
 * of two such drives and d' the one before it:
 *
 *   u = x + (lag_s / T) s,  s: the mean of d and d', at most twice the smaller one; 0 unless both have the same sign.
 *
 * With preview, x is the drive of the step before the latest, which lies between d' and d; else it is the latest. s is
 * the monotonized central slope of van Leer (J. Comput. Phys. 23, 1977). The mean alone would lead a jump, or the end of
 * a ramp, too: y would go beyond x, and turn plays that x does not turn.
 *
 * The operator keeps its own drive: what is output replaces it in rdpi_f32_t between two steps. */
#ifndef RDPI_F32_UNLAG_H
#define RDPI_F32_UNLAG_H

#include "f32_math.h"
#include "rdpi/f32_chain.h"

static inline void rdpi_f32_unlag_init(rdpi_f32_unlag_t *unlag, const rdpi_f32_chain_params_t *params,
                                       rdpi_real_t sample_time_s)
{
    const rdpi_f32_params_t *axis = params->axis;
    unlag->per_step = params->lag_s / sample_time_s;
    unlag->way = 0;
    unlag->codes_per_V = axis->V_per_code > 0 ? 1 / axis->V_per_code : 0;
    unlag->max_step_V = axis->slew_V_per_s * sample_time_s;
}

/* What the operator has followed is what it outputs now. */
static inline void rdpi_f32_unlag_settle(rdpi_f32_unlag_t *unlag, const rdpi_f32_t *axis)
{
    unlag->followed_V = axis->drive_V;
    unlag->dac_code = axis->dac_code;
    unlag->ramp_V = axis->drive_V;
    unlag->carried_V = 0;
    unlag->first = true;
}

/* The operator gets its own drive back. */
static inline void rdpi_f32_unlag_give_back(const rdpi_f32_unlag_t *unlag, rdpi_f32_t *axis)
{
    axis->drive_V = unlag->followed_V;
    axis->dac_code = unlag->dac_code;
}

/* s of two differences. */
static inline rdpi_real_t rdpi_f32_unlag_slope(rdpi_real_t a, rdpi_real_t b)
{
    if (!(a * b > 0)) {
        return 0;
    }
    rdpi_real_t mean = (a + b) / 2, most = 2 * (fabs(a) < fabs(b) ? a : b);
    return fabs(mean) < fabs(most) ? mean : most;
}

/* The drive to output, before range and slew, after a step of the operator before which `missed` samples were missed. */
static inline rdpi_real_t rdpi_f32_unlag_wish(rdpi_f32_unlag_t *unlag, const rdpi_f32_t *axis, bool preview,
                                              unsigned missed)
{
    rdpi_real_t asked_V = axis->ramp_V, latest_V = unlag->asked_V, before_V = unlag->before_V;
    if (unlag->first || missed > RDPI_MAX_MISSED) {
        latest_V = asked_V;
        before_V = 0;
        missed = 0;
    }
    rdpi_real_t step_V = asked_V - latest_V;
    if (missed > 0u) { /* they lie on a straight line */
        step_V /= (rdpi_real_t)(missed + 1u);
        before_V = step_V;
    }
    unlag->first = false;
    unlag->asked_V = asked_V;
    unlag->before_V = step_V;
    rdpi_real_t now_V = preview ? asked_V - step_V : asked_V;
    return rdpi_f32_fma(unlag->per_step, rdpi_f32_unlag_slope(step_V, before_V), now_V);
}

/* Outputs a drive as near to `wish_V` as range and slew allow. Returns whether they allow it. */
static inline bool rdpi_f32_unlag_output(rdpi_f32_unlag_t *unlag, rdpi_f32_t *axis, rdpi_real_t wish_V)
{
    const rdpi_f32_params_t *params = axis->params;
    rdpi_real_t drive_V = rdpi_f32_clamp(wish_V, params->min_V, params->max_V);
    if (unlag->max_step_V > 0) {
        drive_V = rdpi_f32_clamp(drive_V, unlag->ramp_V - unlag->max_step_V, unlag->ramp_V + unlag->max_step_V);
        drive_V = rdpi_f32_clamp(drive_V, params->min_V, params->max_V); /* whatever the ramp has become */
    }
    bool allowed = drive_V == wish_V;
    unlag->ramp_V = drive_V;
    axis->drive_V = drive_V;
    if (params->dac_bits > 0u) {
#if RDPI_NOISE_SHAPING
        bool shapes = params->noise_shaping != 0u;
        if (shapes) {
            drive_V += unlag->carried_V;
        }
#endif
        rdpi_real_t code = rdpi_f32_fma(drive_V - params->min_V, unlag->codes_per_V, (rdpi_real_t)0.5);
        axis->dac_code = (uint32_t)rdpi_f32_clamp(code, 0, params->last_code);
        axis->drive_V = rdpi_f32_fma((rdpi_real_t)axis->dac_code, params->V_per_code, params->min_V);
#if RDPI_NOISE_SHAPING
        if (shapes) {
            unlag->carried_V = allowed ? drive_V - axis->drive_V : 0;
        }
#endif
    }
    return allowed;
}

#endif
