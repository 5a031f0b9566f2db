#include "rdpi/q31_axis.h"

#include "q31_code.h"
#include "q31_drive.h"
#include "q31_math.h"

#define AXIS(name) rdpi_q31_axis_##name
#define CHAIN(name) rdpi_q31_chain_##name
#define REQUEST rdpi_q31_request_t
#define NUMBER int32_t
#define SPEED uint64_t
#define NO_DISPLACEMENT RDPI_Q31_NO_REFERENCE
#define DRIVE drive
#define PER_TIME per_us

static bool drive_is_good(const rdpi_q31_axis_t *self, int32_t drive)
{
    const rdpi_q31_params_t *params = self->chain.params->axis;
    return drive >= params->min_drive && drive <= params->max_drive;
}

/* The parameters of the chain that runs are in force, whatever they are. */
static void own_limits(rdpi_q31_axis_t *self)
{
    self->own_slew = self->chain.axis.slew;
    self->own_direct_output = self->chain.axis.direct_output;
}

static bool own_limits_are_sane(const rdpi_q31_axis_t *self)
{
    return self->own_slew >= 0;
}

/* How far a drive may go in a sample at a speed, times 2^32; 0 for that of the sweep. */
static int64_t step_at(const rdpi_q31_axis_t *self, uint64_t per_us)
{
    int64_t step = per_us > 0u ? rdpi_q31_per_sample(per_us, self->chain.sample_time_ns) : self->chain.axis.sweep_step;
    return self->own_slew > 0 && self->own_slew < step ? self->own_slew : step;
}

static bool speed_is_good(const rdpi_q31_axis_t *self, uint64_t per_us)
{
    return step_at(self, per_us) >= 1;
}

/* The limit of a ramp is a slew limit. The direct way to a code knows none. */
static void limit(rdpi_q31_axis_t *self, bool ramps)
{
    rdpi_q31_t *axis = &self->chain.axis;
    axis->slew = ramps ? step_at(self, 0) : self->own_slew;
    axis->direct_output = self->own_direct_output && !ramps;
}

static bool is_reached(rdpi_q31_axis_t *self, int32_t ahead)
{
    const rdpi_q31_unlag_t *unlag = &self->chain.unlag;
    int64_t before = unlag->ramp;
    (void)rdpi_q31_chain_step(&self->chain, ahead);
    int64_t moved = unlag->ramp - before;
    /* lag^-1 has no flag of its own for the limit: a drive that went less far was not held back */
    bool free = unlag->per_step == 0 || (moved < self->chain.axis.slew && moved > -self->chain.axis.slew);
    return (self->chain.axis.flags & (RDPI_FLAG_SLEW | RDPI_FLAG_INPUT)) == 0u && free;
}

static void put_on_ramp(rdpi_q31_axis_t *self)
{
    self->at = rdpi_q31_widen(self->drive);
}

static void begin_ramp(rdpi_q31_axis_t *self, int32_t drive, uint64_t per_us)
{
    put_on_ramp(self);
    self->target = drive;
    self->step = step_at(self, per_us);
}

static bool drive_of_code(const rdpi_q31_params_t *params, uint32_t code, int32_t *drive)
{
    if (params->dac_bits == 0u || code >> params->dac_bits != 0u) {
        return false;
    }
    *drive = rdpi_q31_clamp(rdpi_q31_drive_of_code(params, (int64_t)code), params->min_drive, params->max_drive);
    return true;
}

/* The drive of the nearest code, if there are codes: the plays follow what is really output. */
static int32_t rounded(const rdpi_q31_params_t *params, int32_t drive)
{
    if (params->dac_bits == 0u) {
        return drive;
    }
    int32_t nearest = drive;
    (void)drive_of_code(params, (uint32_t)rdpi_q31_code_of_drive(params, drive), &nearest);
    return nearest;
}

static bool go_on(rdpi_q31_axis_t *self)
{
    const int64_t target = rdpi_q31_widen(self->target), left = target - self->at;
    if (left > self->step) {
        self->at += self->step;
    } else if (left < -self->step) {
        self->at -= self->step;
    } else {
        self->at = target;
    }
    (void)rdpi_q31_chain_forward(&self->chain, rounded(self->chain.params->axis, (int32_t)(self->at >> 32)));
    return self->at == target;
}

#include "axis_life.h"

rdpi_status_t rdpi_q31_axis_init_layout(uint64_t layout, rdpi_q31_axis_t *self, const rdpi_q31_chain_params_t *params,
                                        uint32_t sample_time_ns, int32_t drive)
{
    rdpi_status_t status = layout != RDPI_Q31_CHAIN_LAYOUT ? RDPI_ERR_SIZE : (self == NULL ? RDPI_ERR_NULL : RDPI_OK);
    if (status != RDPI_OK) {
        return status;
    }
    self->mode = RDPI_AXIS_OFF;
    status = rdpi_q31_chain_init_layout(layout, &self->chain, params, sample_time_ns);
    if (status == RDPI_OK) {
        own_limits(self);
        status = accept(self, drive);
    }
    return status;
}
