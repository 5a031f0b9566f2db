#include "rdpi/f32_chain.h"

#include <math.h> /* NAN */

#include "crc.h"
#include "f32_creep.h"
#include "f32_drive.h"
#include "f32_lead.h"
#include "f32_math.h"
#include "f32_output.h"
#include "f32_saturation.h"
#include "f32_step.h"
#include "f32_unlag.h"
#include "f32_way.h"

/* ---- init ---- */

static uint32_t checksum(const rdpi_f32_chain_params_t *params)
{
    const rdpi_real_t numbers[] = {params->delay_s, params->lag_s,       params->lead_s,
                                   params->lead_s2, params->max_lead_um, params->direct};
    uint32_t crc = rdpi_crc32(0, params->poles | (uint32_t)params->preview << 16);
    for (size_t k = 0; k < sizeof numbers / sizeof *numbers; k++) {
        crc = rdpi_f32_crc32(crc, numbers[k]);
    }
    for (size_t i = 0; i < params->poles; i++) {
        crc = rdpi_f32_crc32(crc, params->pole[i].share);
        crc = rdpi_f32_crc32(crc, params->pole[i].time_constant_s);
    }
    return crc;
}

uint32_t rdpi_f32_chain_digest_layout(uint64_t layout, const rdpi_f32_chain_params_t *params)
{
    return layout == RDPI_F32_CHAIN_LAYOUT ? checksum(params) : 0u;
}

static bool is_number(rdpi_real_t value)
{
    return fabs(value) <= MAX_NUMBER;
}

static bool are_numbers(const rdpi_f32_chain_params_t *params)
{
    bool good = is_number(params->delay_s) && is_number(params->lag_s) && is_number(params->lead_s) &&
                is_number(params->lead_s2) && is_number(params->max_lead_um) && is_number(params->direct);
    for (size_t i = 0; i < params->poles; i++) {
        good = good && is_number(params->pole[i].share) && is_number(params->pole[i].time_constant_s);
    }
    return good;
}

/* Whether numbers are in their ranges, as far as that does not depend on the sample time. */
static bool in_ranges(const rdpi_f32_chain_params_t *params)
{
    bool good = params->preview <= 1u && params->delay_s >= 0 && params->lag_s >= 0 && params->lead_s >= 0 &&
                params->lead_s2 >= 0 && params->max_lead_um > 0;
    for (size_t i = 0; i < params->poles; i++) {
        good = good && params->pole[i].time_constant_s > 0;
    }
    return good;
}

/* All that needs valid pointers and counts. */
static rdpi_status_t check(const rdpi_f32_chain_params_t *params)
{
    if (params->digest != checksum(params)) {
        return RDPI_ERR_DIGEST;
    }
    if (!are_numbers(params)) {
        return RDPI_ERR_NOT_FINITE;
    }
    return in_ranges(params) ? RDPI_OK : RDPI_ERR_CHAIN;
}

/* Sets up lead and creep of `self`. */
static rdpi_status_t set_up(rdpi_f32_chain_t *self, const rdpi_f32_chain_params_t *params, rdpi_real_t sample_time_s)
{
    bool leads = rdpi_f32_lead_wanted(params);
    self->params = params;
    self->preview_samples = 0;
    self->usual = (uint8_t)((leads ? LEAD : PLAIN) + (params->poles > 0u ? CREEP : PLAIN));
    if (leads && !rdpi_f32_lead_init(&self->lead, params, sample_time_s, &self->preview_samples)) {
        return RDPI_ERR_CHAIN;
    }
    rdpi_f32_unlag_init(&self->unlag, params, sample_time_s);
    if (has_lag(self)) {
        self->preview_samples += params->preview;
    }
    return rdpi_f32_creep_init(&self->creep, params, sample_time_s) ? RDPI_OK : RDPI_ERR_CHAIN;
}

rdpi_status_t rdpi_f32_chain_init_layout(uint64_t layout, rdpi_f32_chain_t *self,
                                         const rdpi_f32_chain_params_t *params, rdpi_real_t sample_time_s)
{
    if (layout != RDPI_F32_CHAIN_LAYOUT) {
        return RDPI_ERR_SIZE;
    }
    if (self == NULL || params == NULL) {
        return RDPI_ERR_NULL;
    }
    if (params->schema != RDPI_PARAMS_SCHEMA) {
        return RDPI_ERR_SCHEMA;
    }
    if (params->poles > RDPI_MAX_POLES) {
        return RDPI_ERR_COUNT;
    }
    if (params->poles > 0u && params->pole == NULL) {
        return RDPI_ERR_NULL;
    }
    rdpi_status_t status = check(params);
    if (status == RDPI_OK) {
        status = rdpi_f32_init(&self->axis, params->axis, sample_time_s);
    }
    if (status == RDPI_OK) {
        status = set_up(self, params, sample_time_s);
    }
    if (status == RDPI_OK) {
        rdpi_f32_chain_settle(self);
    }
    return status;
}

/* ---- memory ---- */

static bool has_creep(const rdpi_f32_chain_t *self)
{
    return self->usual == CREEP || self->usual == LEAD_CREEP;
}

/* The next step goes where lag^-1 is behind it. After whatever has changed the way. */
static void lead_to_lag(rdpi_f32_chain_t *self)
{
    if (has_lag(self) && self->way != LAG) {
        self->unlag.way = self->way;
        self->way = LAG;
    }
}

/* The usual way of the lead does not serve the next reference. */
static void end_usual(rdpi_f32_chain_t *self)
{
    if (self->usual == LEAD || self->usual == LEAD_CREEP) {
        self->way = GENERAL;
    }
    lead_to_lag(self);
}

static void forget_references(rdpi_f32_chain_t *self)
{
    self->first = true;
    end_usual(self);
}

void rdpi_f32_chain_settle(rdpi_f32_chain_t *self)
{
    self->way = self->usual;
    forget_references(self);
    rdpi_f32_unlag_settle(&self->unlag, &self->axis);
    rdpi_f32_creep_settle(&self->creep, rdpi_f32_predict(&self->axis, self->axis.drive_V, 0));
}

void rdpi_f32_chain_reset(rdpi_f32_chain_t *self)
{
    rdpi_f32_reset(&self->axis);
    self->creep.poles = self->params->poles; /* whatever has become of it: the poles are as many as are settled */
    rdpi_f32_chain_settle(self);
}

/* The displacement after a sweep that ended in the middle of the range: all plays are there. */
static rdpi_real_t swept_um(const rdpi_f32_params_t *params)
{
    const rdpi_f32_line_t *last = &params->curve[rdpi_f32_pieces(params) - 1u];
    rdpi_real_t ends_um =
        rdpi_f32_x_of_drive(params->curve, params->min_V) + rdpi_f32_x_of_drive(last, params->max_V);
    rdpi_real_t v_um = params->play[params->plays - 1u].slope * (ends_um / 2);
    return rdpi_f32_saturation(params->saturation, params->deadzones, v_um) + params->offset_um;
}

void rdpi_f32_chain_swept(rdpi_f32_chain_t *self, uint32_t ticks)
{
    rdpi_f32_creep_t *creep = &self->creep;
    self->way = self->usual;
    forget_references(self);
    rdpi_f32_unlag_settle(&self->unlag, &self->axis);
    rdpi_f32_creep_settle(creep, swept_um(self->axis.params));
    if (ticks > 0u) { /* the last of them is moved by the next step */
        creep->h_um = output_um(self);
        creep->mean_um = creep->h_um;
        rdpi_f32_creep_wait(creep, (rdpi_real_t)(ticks - 1u), creep->h_um);
    }
}

/* ---- the step ---- */

static bool is_usable(rdpi_real_t reference_um)
{
    return fabs(reference_um) <= RDPI_MAX_REFERENCE_UM;
}

/* The operator. `lags`, which the compiler knows here and below: lag^-1 comes behind it. */
static RDPI_F32_HOT rdpi_real_t operate(rdpi_f32_chain_t *self, rdpi_real_t h_um, const bool lags)
{
#if RDPI_QUICK_STEP > 0
    if (lags) {
        return rdpi_f32_step_asking(&self->axis, h_um);
    }
#else
    (void)lags; /* the long way always keeps what was asked for */
#endif
    return rdpi_f32_step(&self->axis, h_um);
}

/* Creep^-1 and the operator, for what the lead has made of a reference. The states move only now to the sample before:
 * so nothing has to be done after the step of the operator. */
static RDPI_F32_SHARED rdpi_real_t move_and_step(rdpi_f32_chain_t *self, rdpi_real_t z_um, const bool lags)
{
    rdpi_real_t adds_um = rdpi_f32_creep_move(&self->creep);
    return operate(self, rdpi_f32_creep_solve(&self->creep, adds_um, z_um), lags);
}

/* The operator has not output what the step before asked for: creep follows what it has. */
static RDPI_F32_SELDOM rdpi_real_t step_after_clip(rdpi_f32_chain_t *self, rdpi_real_t z_um)
{
    self->creep.h_um = output_um(self);
    return move_and_step(self, z_um, has_lag(self));
}

static RDPI_F32_HOT rdpi_real_t move_or_clip(rdpi_f32_chain_t *self, rdpi_real_t z_um, const bool lags)
{
    return was_clipped(&self->axis) ? step_after_clip(self, z_um) : move_and_step(self, z_um, lags);
}

static RDPI_F32_SELDOM rdpi_real_t step_creep(rdpi_f32_chain_t *self, rdpi_real_t z_um)
{
    return move_or_clip(self, z_um, false);
}

static RDPI_F32_SELDOM rdpi_real_t step_creep_lag(rdpi_f32_chain_t *self, rdpi_real_t z_um)
{
    return move_or_clip(self, z_um, true);
}

/* A reference that cannot be used. Creep goes on where the drive is held. */
static RDPI_F32_SELDOM rdpi_real_t refuse(rdpi_f32_chain_t *self)
{
    if (has_creep(self)) {
        self->creep.h_um = output_um(self);
        (void)rdpi_f32_creep_move(&self->creep);
    }
    end_usual(self);
    return rdpi_f32_step(&self->axis, (rdpi_real_t)NAN);
}

static rdpi_real_t step_behind_lead(rdpi_f32_chain_t *self, rdpi_real_t z_um)
{
    if (has_creep(self)) {
        return has_lag(self) ? step_creep_lag(self, z_um) : step_creep(self, z_um);
    }
    return operate(self, z_um, has_lag(self));
}

/* A lead has reached its limit in this step. A sample counts once, whatever clipped it. */
static void flag_lead(rdpi_f32_t *axis)
{
    bool counted = (axis->flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW | RDPI_FLAG_LEAD)) != 0u;
    axis->flags |= RDPI_FLAG_LEAD;
    if (!counted && axis->clip_count < UINT32_MAX) {
        axis->clip_count++;
    }
}

/* All behind the lead, which wishes to add `wish_um` to `base_um`. */
static RDPI_F32_SELDOM rdpi_real_t step_limited(rdpi_f32_chain_t *self, rdpi_real_t base_um, rdpi_real_t wish_um)
{
    const rdpi_f32_lead_t *lead = &self->lead;
    rdpi_real_t add_um = rdpi_f32_clamp(wish_um, -lead->max_um, lead->max_um);
    rdpi_real_t drive_V = step_behind_lead(self, base_um + add_um);
    if (add_um != wish_um) {
        flag_lead(&self->axis);
    }
    return drive_V;
}

/* Any reference of a chain with a lead. After a reference that cannot be used or missed samples, the references lie on
 * a straight line. */
static RDPI_F32_SELDOM rdpi_real_t step_general(rdpi_f32_chain_t *self, rdpi_real_t ahead_um)
{
    rdpi_f32_lead_t *lead = &self->lead;
    unsigned missed = self->axis.missed;
    if (!is_usable(ahead_um)) {
        return refuse(self);
    }
    self->way = self->params->preview != 0u && lead->rings ? self->usual : GENERAL;
    if (self->first || missed > RDPI_MAX_MISSED) {
        self->first = false;
        rdpi_f32_lead_take(lead, ahead_um, 0);
    }
    rdpi_real_t step_um = (ahead_um - lead->latest_um) / (rdpi_real_t)(missed + 1u);
    if (missed > 0u) {
        lead->before_um = step_um;
    }
    rdpi_real_t wish_um = rdpi_f32_lead_jumps(lead, step_um) ? 0 : rdpi_f32_lead_at(lead, step_um);
    rdpi_f32_lead_take(lead, ahead_um, step_um);
    return step_limited(self, self->params->preview != 0u ? ahead_um - step_um : ahead_um, wish_um);
}

/* The usual lead, with preview. `creeps`: creep comes behind it. */
static RDPI_F32_HOT rdpi_real_t step_usually(rdpi_f32_chain_t *self, rdpi_real_t ahead_um, const bool creeps,
                                             const bool lags)
{
    rdpi_f32_lead_t *lead = &self->lead;
    rdpi_real_t latest_um = lead->latest_um, step_um = ahead_um - latest_um;
    rdpi_real_t add_um = rdpi_f32_lead_at(lead, step_um);
    if (!is_usable(ahead_um)) {
        return refuse(self);
    }
    rdpi_f32_lead_take(lead, ahead_um, step_um);
    if (!(fabs(add_um) <= lead->max_um)) {
        return step_limited(self, ahead_um - step_um, add_um);
    }
    if (creeps) {
        return lags ? step_creep_lag(self, latest_um + add_um) : step_creep(self, latest_um + add_um);
    }
    return operate(self, latest_um + add_um, lags);
}

static RDPI_F32_SELDOM rdpi_real_t step_lead(rdpi_f32_chain_t *self, rdpi_real_t ahead_um)
{
    return step_usually(self, ahead_um, false, false);
}

static RDPI_F32_SELDOM rdpi_real_t step_creep_alone(rdpi_f32_chain_t *self, rdpi_real_t reference_um)
{
    return is_usable(reference_um) ? step_creep(self, reference_um) : refuse(self);
}

static RDPI_F32_SELDOM rdpi_real_t step_lead_creep(rdpi_f32_chain_t *self, rdpi_real_t ahead_um)
{
    return step_usually(self, ahead_um, true, false);
}

/* All ahead of lag^-1. */
static RDPI_F32_HOT rdpi_real_t step_before_lag(rdpi_f32_chain_t *self, rdpi_real_t ahead_um)
{
    unsigned way = self->unlag.way;
    if (way == PLAIN) {
        return operate(self, ahead_um, true);
    }
    if (way == LEAD || way == LEAD_CREEP) {
        return step_usually(self, ahead_um, way == LEAD_CREEP, true);
    }
    if (way == CREEP) {
        return is_usable(ahead_um) ? step_creep_lag(self, ahead_um) : refuse(self);
    }
    rdpi_real_t drive_V = step_general(self, ahead_um);
    lead_to_lag(self);
    return drive_V;
}

/* A step with lag^-1 behind it. A reference that is not usable holds what was output. */
static RDPI_F32_SELDOM rdpi_real_t step_lag(rdpi_f32_chain_t *self, rdpi_real_t ahead_um)
{
    rdpi_f32_t *axis = &self->axis;
    rdpi_f32_unlag_t *unlag = &self->unlag;
    rdpi_real_t latest_V = axis->drive_V;
    uint32_t latest_code = axis->dac_code;
    unsigned missed = axis->missed;
    rdpi_f32_unlag_give_back(unlag, axis);
    (void)step_before_lag(self, ahead_um);
    unlag->followed_V = axis->drive_V;
    unlag->dac_code = axis->dac_code;
    if ((axis->flags & RDPI_FLAG_INPUT) != 0u) {
        axis->drive_V = latest_V;
        axis->dac_code = latest_code;
        return latest_V;
    }
    rdpi_real_t wish_V = rdpi_f32_unlag_wish(unlag, axis, self->params->preview != 0u, missed);
    if (!rdpi_f32_unlag_output(unlag, axis, wish_V)) {
        flag_lead(axis);
    }
    return axis->drive_V;
}

/* Apart, so that no compiler makes a table of all ways, which costs the usual ones more. */
static RDPI_F32_SELDOM rdpi_real_t step_other_ways(rdpi_f32_chain_t *self, rdpi_real_t ahead_um)
{
    return self->way == LAG ? step_lag(self, ahead_um) : step_general(self, ahead_um);
}

rdpi_real_t rdpi_f32_chain_step(rdpi_f32_chain_t *self, rdpi_real_t ahead_um)
{
    unsigned way = self->way;
    if (way == PLAIN) {
        return rdpi_f32_step(&self->axis, ahead_um);
    }
    if (way == LEAD) {
        return step_lead(self, ahead_um);
    }
    if (way == LEAD_CREEP) {
        return step_lead_creep(self, ahead_um);
    }
    return way == CREEP ? step_creep_alone(self, ahead_um) : step_other_ways(self, ahead_um);
}

void rdpi_f32_chain_missed(rdpi_f32_chain_t *self, uint32_t ticks)
{
    rdpi_f32_missed(&self->axis, ticks);
    end_usual(self);
    if (has_creep(self)) {
        rdpi_f32_creep_wait(&self->creep, (rdpi_real_t)ticks, output_um(self));
    }
}

rdpi_real_t rdpi_f32_chain_forward(rdpi_f32_chain_t *self, rdpi_real_t drive_V)
{
    rdpi_f32_t *axis = &self->axis;
    rdpi_f32_creep_t *creep = &self->creep;
    rdpi_real_t adds_um = 0;
    if (has_creep(self)) { /* as a step: to the sample before, and to what it has really output */
        if (was_clipped(axis)) {
            creep->h_um = output_um(self);
        }
        adds_um = rdpi_f32_creep_move(creep);
    }
    rdpi_real_t displacement_um = rdpi_f32_forward(axis, drive_V, 0);
    if ((axis->flags & RDPI_FLAG_INPUT) == 0u) {
        rdpi_f32_unlag_settle(&self->unlag, axis);
        self->first = true;
    } else {
        displacement_um = output_um(self) + creep->settled_um;
    }
    end_usual(self);
    if (has_creep(self)) {
        creep->h_um = displacement_um - creep->settled_um;
        displacement_um = creep->h_um / creep->per_direct + adds_um;
    }
    return displacement_um;
}

uint32_t rdpi_f32_chain_block(rdpi_f32_chain_t *self, const rdpi_real_t *reference_um, uint32_t *codes, uint32_t n)
{
    uint32_t flags = 0;
    if (self == NULL || reference_um == NULL || codes == NULL) {
        return RDPI_FLAG_INPUT;
    }
    const rdpi_real_t *ahead_um = &reference_um[self->preview_samples];
    for (uint32_t k = 0; k < n; k++) {
        (void)rdpi_f32_chain_step(self, ahead_um[k]);
        codes[k] = self->axis.dac_code;
        flags |= self->axis.flags;
    }
    return flags;
}

bool rdpi_f32_chain_sweep(rdpi_f32_chain_t *self)
{
    if (self->axis.sweep_turns == 0u) { /* it begins, at what was output */
        if (has_lag(self)) {
            self->axis.ramp_V = self->unlag.ramp_V;
        }
        rdpi_f32_chain_swept(self, 0);
    }
    bool goes_on = rdpi_f32_sweep(&self->axis);
    if (!goes_on) {
        rdpi_f32_forget_sweep(&self->axis);
    }
    rdpi_f32_unlag_settle(&self->unlag, &self->axis);
    forget_references(self);
    (void)rdpi_f32_creep_move(&self->creep);
    self->creep.h_um = output_um(self);
    return goes_on;
}
