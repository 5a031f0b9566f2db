#include "rdpi/f32_axis.h"

#include <math.h> /* NAN */

#include "f32_math.h"

#define AXIS(name) rdpi_f32_axis_##name
#define CHAIN(name) rdpi_f32_chain_##name
#define REQUEST rdpi_f32_request_t
#define NUMBER rdpi_real_t
#define SPEED rdpi_real_t
#define NO_DISPLACEMENT ((rdpi_real_t)NAN)
#define DRIVE drive_V
#define PER_TIME V_per_s

static bool drive_is_good(const rdpi_f32_axis_t *self, rdpi_real_t drive_V)
{
    const rdpi_f32_params_t *params = self->chain.params->axis;
    return drive_V >= params->min_V && drive_V <= params->max_V;
}

/* The parameters of the chain that runs are in force, whatever they are. */
static void own_limits(rdpi_f32_axis_t *self)
{
    self->slow = *self->chain.params->axis;
    self->slow.slew_V_per_s = self->slow.sweep_V_per_s; /* init has checked that it is not above the slew limit */
}

/* Of the copy, which is in RAM, what bounds the output. */
static bool own_limits_are_sane(const rdpi_f32_axis_t *self)
{
    const rdpi_f32_params_t *params = self->chain.params->axis, *slow = &self->slow;
    return slow->min_V == params->min_V && slow->max_V == params->max_V && slow->slew_V_per_s == params->sweep_V_per_s;
}

/* How far a drive may go in a sample at a speed, 0 for that of the sweep. */
static rdpi_real_t step_at(const rdpi_f32_axis_t *self, rdpi_real_t V_per_s)
{
    const rdpi_f32_params_t *params = self->chain.params->axis;
    rdpi_real_t speed = V_per_s > 0 ? V_per_s : params->sweep_V_per_s;
    speed = params->slew_V_per_s > 0 && params->slew_V_per_s < speed ? params->slew_V_per_s : speed;
    return speed * self->sample_time_s;
}

/* It must survive rounding anywhere in the range, or the ramp would never arrive: as f32_check.h has it of the sweep. */
static bool speed_is_good(const rdpi_f32_axis_t *self, rdpi_real_t V_per_s)
{
    const rdpi_f32_params_t *params = self->chain.params->axis;
    rdpi_real_t largest_V = fabs(params->min_V) + fabs(params->max_V);
    rdpi_real_t moved_V = largest_V + step_at(self, V_per_s) / 16;
    return V_per_s >= 0 && isfinite(V_per_s) && moved_V > largest_V;
}

/* The limit of a ramp is a slew limit: the operator reads it in its parameters, of which `slow` is a copy. What it has
 * output is where the limit counts from; the operator's own drive, where there is a lag. */
static void limit(rdpi_f32_axis_t *self, bool ramps)
{
    rdpi_f32_t *axis = &self->chain.axis;
    rdpi_f32_unlag_t *unlag = &self->chain.unlag;
    bool ramped = axis->params == &self->slow;
    axis->params = ramps ? &self->slow : self->chain.params->axis;
    unlag->max_step_V = axis->params->slew_V_per_s * self->sample_time_s;
    if (ramps && !ramped) {
        rdpi_f32_missed(axis, 0); /* ends the quick way, which knows no slew limit */
        if (self->chain.params->axis->slew_V_per_s <= 0) {
            axis->ramp_V = unlag->per_step > 0 ? unlag->followed_V : axis->drive_V;
        }
    }
}

static bool is_reached(rdpi_f32_axis_t *self, rdpi_real_t ahead_um)
{
    const rdpi_f32_unlag_t *unlag = &self->chain.unlag;
    rdpi_real_t before_V = unlag->ramp_V;
    (void)rdpi_f32_chain_step(&self->chain, ahead_um);
    rdpi_real_t moved_V = fabs(unlag->ramp_V - before_V);
    /* lag^-1 has no flag of its own for the limit: a drive that went less far was not held back, but for rounding */
    bool free = !(unlag->per_step > 0) || moved_V < unlag->max_step_V * (rdpi_real_t)0.999;
    return (self->chain.axis.flags & (RDPI_FLAG_SLEW | RDPI_FLAG_INPUT)) == 0u && free;
}

static void put_on_ramp(rdpi_f32_axis_t *self)
{
    self->at_V = self->drive_V;
}

static void begin_ramp(rdpi_f32_axis_t *self, rdpi_real_t drive_V, rdpi_real_t V_per_s)
{
    put_on_ramp(self);
    self->target_V = drive_V;
    self->step_V = step_at(self, V_per_s);
}

static bool drive_of_code(const rdpi_f32_params_t *params, uint32_t code, rdpi_real_t *drive_V)
{
    if (params->dac_bits == 0u || code > (uint32_t)params->last_code) {
        return false;
    }
    *drive_V = rdpi_f32_clamp(rdpi_f32_fma((rdpi_real_t)code, params->V_per_code, params->min_V), params->min_V,
                              params->max_V);
    return true;
}

/* The drive of the nearest code, if there are codes: the plays follow what is really output. */
static rdpi_real_t rounded(const rdpi_f32_params_t *params, rdpi_real_t drive_V)
{
    if (params->dac_bits == 0u) {
        return drive_V;
    }
    uint32_t code = (uint32_t)rdpi_f32_clamp((drive_V - params->min_V) / params->V_per_code + (rdpi_real_t)0.5, 0,
                                             params->last_code);
    (void)drive_of_code(params, code, &drive_V);
    return drive_V;
}

static bool go_on(rdpi_f32_axis_t *self)
{
    self->at_V = rdpi_f32_clamp(self->target_V, self->at_V - self->step_V, self->at_V + self->step_V);
    (void)rdpi_f32_chain_forward(&self->chain, rounded(self->chain.params->axis, self->at_V));
    return self->at_V == self->target_V;
}

#include "axis_life.h"

rdpi_status_t rdpi_f32_axis_init_layout(uint64_t layout, rdpi_f32_axis_t *self, const rdpi_f32_chain_params_t *params,
                                        rdpi_real_t sample_time_s, rdpi_real_t drive_V)
{
    rdpi_status_t status = layout != RDPI_F32_CHAIN_LAYOUT ? RDPI_ERR_SIZE : (self == NULL ? RDPI_ERR_NULL : RDPI_OK);
    if (status != RDPI_OK) {
        return status;
    }
    self->mode = RDPI_AXIS_OFF;
    status = rdpi_f32_chain_init_layout(layout, &self->chain, params, sample_time_s);
    if (status == RDPI_OK) {
        self->sample_time_s = sample_time_s;
        own_limits(self);
        status = accept(self, drive_V);
    }
    return status;
}
