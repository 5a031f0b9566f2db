#include "rdpi/rdpi.h"

#include <tgmath.h> /* isfinite for whichever type rdpi_real_t is */

#include "rdpi/deadzone.h"
#include "rdpi/inverse.h"
#include "rdpi/play.h"

/* Relative: states and parameters that were printed, parsed or read back must pass although rounded. */
#define ROUNDING ((rdpi_real_t)1e-5)

static bool all_finite(const rdpi_real_t *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        if (!isfinite(values[i])) {
            return false;
        }
    }
    return true;
}

/* 0 = values_0 < values_1 < ... */
static bool ascends_from_zero(const rdpi_real_t *values, size_t count)
{
    if (values[0] < 0 || values[0] > 0) {
        return false;
    }
    for (size_t i = 1; i < count; i++) {
        if (!(values[i] > values[i - 1])) {
            return false;
        }
    }
    return true;
}

static rdpi_status_t check_pointers(const rdpi_f32_t *self, const rdpi_f32_params_t *params)
{
    if (self == NULL || params == NULL) {
        return RDPI_ERR_NULL;
    }
    if (params->schema != RDPI_PARAMS_SCHEMA) {
        return RDPI_ERR_SCHEMA;
    }
    if (params->plays < 1 || params->plays > RDPI_MAX_PLAYS || params->deadzones < 1 ||
        params->deadzones > RDPI_MAX_DEADZONES) {
        return RDPI_ERR_COUNT;
    }
    if (params->thresholds_um == NULL || params->slopes == NULL || params->slope_rate_s_per_um == NULL ||
        params->deadzones_um == NULL || params->deadzone_weights == NULL) {
        return RDPI_ERR_NULL;
    }
    return RDPI_OK;
}

static bool check_finite(const rdpi_f32_params_t *params)
{
    const rdpi_real_t scalars[] = {params->gain_um_per_V, params->offset_V,      params->offset_um,
                                   params->rate_window_s, params->rate_filter_s, params->max_um_per_s,
                                   params->min_slope_ratio, params->min_V,       params->max_V,
                                   params->slew_V_per_s};
    return all_finite(scalars, sizeof scalars / sizeof scalars[0]) &&
           all_finite(params->thresholds_um, params->plays) && all_finite(params->slopes, params->plays) &&
           all_finite(params->slope_rate_s_per_um, params->plays) &&
           all_finite(params->deadzones_um, params->deadzones) &&
           all_finite(params->deadzone_weights, params->deadzones);
}

static rdpi_status_t check_plays(const rdpi_f32_params_t *params)
{
    if (!ascends_from_zero(params->thresholds_um, params->plays)) {
        return RDPI_ERR_THRESHOLDS;
    }
    if (!(params->max_um_per_s > 0)) {
        return RDPI_ERR_RATE;
    }
    if (!(params->min_slope_ratio > 0) || !(params->min_slope_ratio < 1)) {
        return RDPI_ERR_GUARD;
    }
    for (size_t i = 0; i < params->plays; i++) {
        /* W_i is linear in the rate: both ends of the range decide. The ratio is compared to rounding. */
        rdpi_real_t rest = params->slopes[i];
        rdpi_real_t fastest = rest + params->slope_rate_s_per_um[i] * params->max_um_per_s;
        if (!(rest > 0)) {
            return RDPI_ERR_SLOPES;
        }
        if (!(fastest >= params->min_slope_ratio * rest * (1 - ROUNDING)) || !isfinite(fastest)) {
            return RDPI_ERR_GUARD;
        }
    }
    return RDPI_OK;
}

static rdpi_status_t check_saturation(const rdpi_f32_params_t *params)
{
    if (!ascends_from_zero(params->deadzones_um, params->deadzones)) {
        return RDPI_ERR_DEADZONES;
    }
    rdpi_real_t slope = 0;
    for (size_t j = 0; j < params->deadzones; j++) {
        slope += params->deadzone_weights[j];
        if (!(slope > 0)) {
            return RDPI_ERR_SATURATION;
        }
    }
    return RDPI_OK;
}

/* Whether a change of the drive per sample survives rounding anywhere in its range; 0 V/s means no limit. */
static bool slew_is_resolved(const rdpi_f32_params_t *params, rdpi_real_t slew_V)
{
    rdpi_real_t largest_V = params->max_V > -params->min_V ? params->max_V : -params->min_V;
    rdpi_real_t fine_V = slew_V / 16;
    return !(params->slew_V_per_s > 0) || largest_V + fine_V > largest_V;
}

static rdpi_status_t check_params(const rdpi_f32_params_t *params)
{
    if (!check_finite(params)) {
        return RDPI_ERR_NOT_FINITE;
    }
    if (!(params->gain_um_per_V < 0) && !(params->gain_um_per_V > 0)) {
        return RDPI_ERR_GAIN;
    }
    rdpi_status_t status = check_plays(params);
    if (status == RDPI_OK) {
        status = check_saturation(params);
    }
    if (status == RDPI_OK &&
        (!(params->min_V < params->max_V) || !isfinite(params->max_V - params->min_V) || params->slew_V_per_s < 0 ||
         params->dac_bits > RDPI_MAX_DAC_BITS)) {
        status = RDPI_ERR_DRIVE;
    }
    return status;
}

static rdpi_real_t clamp(rdpi_real_t value, rdpi_real_t low, rdpi_real_t high)
{
    return value < low ? low : (value > high ? high : value);
}

static rdpi_real_t x_of_drive(const rdpi_f32_params_t *params, rdpi_real_t drive_V)
{
    return params->gain_um_per_V * (drive_V - params->offset_V);
}

static rdpi_real_t drive_of_x(const rdpi_f32_params_t *params, rdpi_real_t x_um)
{
    return x_um / params->gain_um_per_V + params->offset_V;
}

/* The code nearest to a drive inside the range. */
static uint32_t code_of_drive(const rdpi_f32_t *self, rdpi_real_t drive_V)
{
    return (uint32_t)((drive_V - self->params->min_V) * self->codes_per_V + (rdpi_real_t)0.5);
}

/* Takes checked states, as they are: what rdpi_f32_get_memory gave comes back bit for bit. */
static void put_memory(rdpi_f32_t *self, const rdpi_real_t *y_um)
{
    const rdpi_f32_params_t *params = self->params;
    for (size_t i = 0; i < params->plays; i++) {
        self->y_um[i] = y_um != NULL ? y_um[i] : 0;
    }
    self->drive_V = clamp(drive_of_x(params, self->y_um[0]), params->min_V, params->max_V);
    self->ramp_V = self->drive_V;
    self->dac_code = code_of_drive(self, self->drive_V);
}

/* Whether one history can have left these states (NULL: all 0), with a drive inside the range. */
static rdpi_status_t check_memory(const rdpi_f32_params_t *params, const rdpi_real_t *y_um)
{
    rdpi_real_t x_um = 0;
    if (y_um != NULL) {
        if (!all_finite(y_um, params->plays)) {
            return RDPI_ERR_NOT_FINITE;
        }
        x_um = y_um[0];
        for (size_t i = 1; i < params->plays; i++) {
            rdpi_real_t gap_um = params->thresholds_um[i] - params->thresholds_um[i - 1];
            rdpi_real_t size_um = y_um[i] < 0 ? -y_um[i] : y_um[i];
            rdpi_real_t slack_um = ROUNDING * (params->thresholds_um[params->plays - 1] + size_um);
            if (rdpi_f32_play(y_um[i - 1], gap_um + slack_um, y_um[i]) != y_um[i]) {
                return RDPI_ERR_MEMORY;
            }
        }
    }
    rdpi_real_t drive_V = drive_of_x(params, x_um);
    rdpi_real_t slack_V = ROUNDING * (params->max_V - params->min_V);
    if (!(drive_V >= params->min_V - slack_V) || !(drive_V <= params->max_V + slack_V)) {
        return RDPI_ERR_MEMORY;
    }
    return RDPI_OK;
}

static void set_flag(rdpi_f32_t *self, uint32_t flag, uint32_t *count)
{
    self->flags |= flag;
    if (*count < UINT32_MAX) {
        (*count)++;
    }
}

/* The singularity guard. */
static void limit_rate(rdpi_f32_t *self, rdpi_real_t rate_um_per_s)
{
    if (rate_um_per_s > self->params->max_um_per_s) {
        rate_um_per_s = self->params->max_um_per_s;
        set_flag(self, RDPI_FLAG_GUARD, &self->guard_count);
    }
    self->rate_um_per_s = rate_um_per_s;
}

/* Range, slew and DAC: makes of the drive wished for the one that is output. Returns whether they left it alone. */
static bool limit_drive(rdpi_f32_t *self, rdpi_real_t wish_V)
{
    const rdpi_f32_params_t *params = self->params;
    uint32_t clipped = 0;
    rdpi_real_t drive_V = clamp(wish_V, params->min_V, params->max_V);
    if (drive_V != wish_V) {
        clipped |= RDPI_FLAG_RANGE;
    }
    if (self->slew_V > 0) {
        rdpi_real_t reached_V = clamp(drive_V, self->ramp_V - self->slew_V, self->ramp_V + self->slew_V);
        if (reached_V != drive_V) {
            clipped |= RDPI_FLAG_SLEW;
            drive_V = reached_V;
        }
    }
    self->ramp_V = drive_V;
    if (params->dac_bits > 0) {
        self->dac_code = code_of_drive(self, drive_V);
        /* clamped because the last code may round past the end of the range */
        drive_V = clamp(params->min_V + (rdpi_real_t)self->dac_code * self->V_per_code, params->min_V, params->max_V);
    }
    self->drive_V = drive_V;
    if (clipped != 0) {
        set_flag(self, clipped, &self->clip_count);
    }
    return drive_V == wish_V;
}

static void get_slopes(const rdpi_f32_t *self, rdpi_real_t *slopes)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_f32_slopes_at(slopes, params->slopes, params->slope_rate_s_per_um, params->plays, self->rate_um_per_s);
}

rdpi_status_t rdpi_f32_init(rdpi_f32_t *self, const rdpi_f32_params_t *params, rdpi_real_t sample_time_s)
{
    rdpi_status_t status = check_pointers(self, params);
    if (status == RDPI_OK) {
        status = check_params(params);
    }
    if (status == RDPI_OK) {
        status = check_memory(params, params->memory_um);
    }
    if (status == RDPI_OK) {
        status = rdpi_f32_rate_init(&self->rate, params->rate_window_s, params->rate_filter_s, sample_time_s);
    }
    if (status == RDPI_OK && !slew_is_resolved(params, params->slew_V_per_s * sample_time_s)) {
        status = RDPI_ERR_DRIVE;
    }
    if (status == RDPI_OK) {
        self->params = params;
        rdpi_real_t last_code = (rdpi_real_t)((1uL << params->dac_bits) - 1u);
        self->slew_V = params->slew_V_per_s * sample_time_s;
        self->codes_per_V = last_code / (params->max_V - params->min_V);
        self->V_per_code = last_code > 0 ? (params->max_V - params->min_V) / last_code : 0;
        rdpi_f32_reset(self);
    }
    return status;
}

void rdpi_f32_reset(rdpi_f32_t *self)
{
    put_memory(self, self->params->memory_um);
    rdpi_f32_rate_reset(&self->rate);
    self->rate_um_per_s = 0;
    self->flags = 0;
    self->guard_count = 0;
    self->clip_count = 0;
    self->input_count = 0;
}

rdpi_status_t rdpi_f32_set_memory(rdpi_f32_t *self, const rdpi_real_t *y_um)
{
    rdpi_status_t status = self == NULL || y_um == NULL ? RDPI_ERR_NULL : check_memory(self->params, y_um);
    if (status == RDPI_OK) {
        put_memory(self, y_um);
    }
    return status;
}

void rdpi_f32_get_memory(const rdpi_f32_t *self, rdpi_real_t *y_um)
{
    for (size_t i = 0; i < self->params->plays; i++) {
        y_um[i] = self->y_um[i];
    }
}

rdpi_real_t rdpi_f32_step(rdpi_f32_t *self, rdpi_real_t reference_um)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_real_t slopes[RDPI_MAX_PLAYS];

    self->flags = 0;
    if (!(reference_um <= RDPI_MAX_REFERENCE_UM) || !(reference_um >= -RDPI_MAX_REFERENCE_UM)) {
        set_flag(self, RDPI_FLAG_INPUT, &self->input_count);
        return self->drive_V;
    }
    rdpi_real_t z_um = reference_um - params->offset_um;
    limit_rate(self, rdpi_f32_rate_step(&self->rate, z_um));
    get_slopes(self, slopes);
    rdpi_real_t v_um = rdpi_f32_saturation_inverse(params->deadzones_um, params->deadzone_weights, params->deadzones,
                                                   z_um);
    rdpi_real_t x_um = rdpi_f32_plays_solve(self->y_um, params->thresholds_um, slopes, params->plays, v_um);
    if (!limit_drive(self, drive_of_x(params, x_um))) {
        x_um = x_of_drive(params, self->drive_V);
    }
    rdpi_f32_plays_move(self->y_um, params->thresholds_um, params->plays, x_um);
    return self->drive_V;
}

rdpi_real_t rdpi_f32_forward(rdpi_f32_t *self, rdpi_real_t drive_V, rdpi_real_t rate_um_per_s)
{
    const rdpi_f32_params_t *params = self->params;
    rdpi_real_t slopes[RDPI_MAX_PLAYS];

    self->flags = 0;
    if (isfinite(drive_V) && isfinite(rate_um_per_s) && rate_um_per_s >= 0) {
        limit_rate(self, rate_um_per_s);
        self->drive_V = drive_V;
        rdpi_f32_plays_move(self->y_um, params->thresholds_um, params->plays, x_of_drive(params, drive_V));
    } else {
        set_flag(self, RDPI_FLAG_INPUT, &self->input_count);
    }
    get_slopes(self, slopes);
    rdpi_real_t v_um = rdpi_f32_plays_sum(self->y_um, slopes, params->plays);
    return rdpi_f32_saturation(params->deadzones_um, params->deadzone_weights, params->deadzones, v_um) +
           params->offset_um;
}
