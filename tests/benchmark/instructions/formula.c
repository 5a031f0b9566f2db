#include <math.h>

#include "formula.h"

#include "f32_rate.h"
#include "f32_saturation.h"

static float clamp(float value, float low, float high)
{
    return value > low ? (value < high ? value : high) : low;
}

static void set_flag(state_t *self, uint32_t flag, uint32_t *count)
{
    self->flags |= flag;
    if (*count < UINT32_MAX) {
        (*count)++;
    }
}

#if defined(FORMULA_LINEAR)
#define INVERSE formula_inverse_step
#else
#define INVERSE as_printed
/* r'_i = sum over j <= i of w_j (r_i - r_j), w'_0 = 1 / w_0 and
 * w'_i = -w_i / ((w_0 + ... + w_i) (w_0 + ... + w_(i-1))). */
static float as_printed(formula_inverse_t *self, const rdpi_f32_play_t *play, size_t count, float rate_um_per_s,
                        float v_um)
{
    float weight[RDPI_MAX_PLAYS], slope = 0, x_um = 0;
    for (size_t i = 0; i < count; i++) { /* eq. 14 and 16 */
        float slope_i = rdpi_f32_slope(&play[i], rate_um_per_s);
        weight[i] = slope_i - slope;
        slope = slope_i;
    }
    for (size_t i = 0; i < count; i++) {
        float threshold_um = 0, below = 0;
        for (size_t j = 0; j < i; j++) {
            threshold_um += weight[j] * (play[i].r_um - play[j].r_um);
            below += weight[j];
        }
        self->y_um[i] = rdpi_f32_play(v_um, threshold_um, self->y_um[i]);
        x_um += (i > 0u ? -weight[i] / ((below + weight[i]) * below) : 1 / weight[i]) * self->y_um[i];
    }
    return x_um;
}
#endif

bool formula_start(state_t *self, const rdpi_f32_params_t *params, float sample_time_s)
{
    *self = (state_t){.params = params, .sample_time_s = sample_time_s};
    self->codes_per_V = (float)((1uL << params->dac_bits) - 1u) / (params->max_V - params->min_V);
    self->V_per_code = 1 / self->codes_per_V;
    self->drive_V = self->ramp_V = params->curve->offset_V;
    return rdpi_f32_rate_init(&self->rate, params->rate_window_s, params->rate_filter_s, sample_time_s) == RDPI_OK;
}

float formula_step(state_t *self, float reference_um)
{
    const rdpi_f32_params_t *params = self->params;

    self->flags = 0;
    if (!(fabsf(reference_um) <= RDPI_MAX_REFERENCE_UM)) {
        set_flag(self, RDPI_FLAG_INPUT, &self->input_count);
        if (self->missed < UINT16_MAX) {
            self->missed++;
        }
        return self->drive_V;
    }
    if (self->missed > 0u) {
        self->flags = RDPI_FLAG_MISSED;
    }
    float rate_um_per_s = rdpi_f32_rate_step(&self->rate, reference_um, self->missed);
    self->missed = 0;
    if (rate_um_per_s > params->max_um_per_s) {
        rate_um_per_s = params->max_um_per_s;
        set_flag(self, RDPI_FLAG_GUARD, &self->guard_count);
    }
    self->rate_um_per_s = rate_um_per_s;

    const rdpi_f32_piece_t *piece = rdpi_f32_piece_find(params->inverse_saturation, params->deadzones, reference_um);
    float v_um = rdpi_f32_piece_at(piece, reference_um - params->offset_um);
    float x_um = INVERSE(&self->bank, params->play, params->plays, rate_um_per_s, v_um);

    float wish_V = x_um * params->curve->V_per_um + params->curve->offset_V;
    float drive_V = clamp(wish_V, params->min_V, params->max_V);
    uint32_t clipped = drive_V != wish_V ? RDPI_FLAG_RANGE : 0u;
    if (params->slew_V_per_s > 0) {
        float slew_V = params->slew_V_per_s * self->sample_time_s;
        float reached_V = clamp(drive_V, self->ramp_V - slew_V, self->ramp_V + slew_V);
        if (reached_V != drive_V) {
            clipped |= RDPI_FLAG_SLEW;
            drive_V = reached_V;
        }
    }
    if (clipped != 0u) {
        set_flag(self, clipped, &self->clip_count);
    }
    self->ramp_V = drive_V;
    if (params->dac_bits > 0u) {
        self->dac_code = (uint32_t)((drive_V - params->min_V) * self->codes_per_V + 0.5f);
        drive_V = clamp(params->min_V + (float)self->dac_code * self->V_per_code, params->min_V, params->max_V);
    }
    self->drive_V = drive_V;
    return drive_V;
}

void formula_missed(state_t *self, uint32_t ticks)
{
    self->missed = (uint16_t)(self->missed + ticks);
    self->missed_count += ticks;
}
