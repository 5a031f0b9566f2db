#include "axis.h"

#if AXIS_Q31
#define SAMPLE_TIME(rate_hz) ((1000000000u + (rate_hz) / 2u) / (rate_hz)) /* ns */
#else
#define SAMPLE_TIME(rate_hz) (1.0f / (float)(rate_hz))
#endif

static rdpi_status_t start_one(axis_t *self, uint32_t rate_hz)
{
    rdpi_status_t status = RDPI_ERR_SAMPLE_TIME;
    if (rate_hz > 0u && self->life.mode == RDPI_AXIS_OFF) {
        self->rate_hz = rate_hz;
        status = AXIS_LIFE(init)(&self->life, self->params, SAMPLE_TIME(rate_hz), self->safe);
    } else if (rate_hz > 0u && rate_hz == self->rate_hz) {
        status = RDPI_OK;
    } else {
        /* another rate would need another init, while the timer runs */
    }
    return status == RDPI_OK ? AXIS_LIFE(start)(&self->life) : status;
}

rdpi_status_t axis_start(axis_t *self, uint32_t rate_hz)
{
    rdpi_status_t first = RDPI_OK;
    for (axis_t *axis = self; axis != NULL; axis = axis->with) {
        rdpi_status_t status = start_one(axis, rate_hz);
        first = first == RDPI_OK ? status : first;
    }
    return first;
}

/* The sample of the reference so many samples from now. */
static uint32_t later(const axis_t *self, uint32_t samples)
{
    uint32_t at = self->sample, period = self->period;
    if (period == 0u) {
        return samples < UINT32_MAX - at ? at + samples : UINT32_MAX;
    }
    uint32_t rest = samples < period ? samples : samples % period;
    return rest < period - at ? at + rest : rest - (period - at);
}

static bool is_under_way(const axis_t *self)
{
    rdpi_axis_mode_t mode = self->life.mode;
    return mode == RDPI_AXIS_RAMP || mode == RDPI_AXIS_RUN || mode == RDPI_AXIS_MANUAL;
}

/* After a sample. The references begin when all axes have reached theirs, and go on until none is under way. */
static void count(axis_t *self)
{
    bool all = true, any = false;
    for (const axis_t *axis = self; axis != NULL; axis = axis->with) {
        all = all && axis->life.mode == RDPI_AXIS_RUN;
        any = any || is_under_way(axis);
    }
    self->counts = any && (self->counts || all);
    for (axis_t *axis = self; axis != NULL; axis = axis->with) {
        axis->sample = self->counts ? later(axis, 1) : 0u;
    }
}

uint32_t axis_next(axis_t *self, uint32_t lost)
{
    axis_lost(self, lost);
    for (axis_t *axis = self; axis != NULL; axis = axis->with) {
        if (axis->life.mode == RDPI_AXIS_MANUAL && axis->other != NULL) {
            (void)AXIS_LIFE(follow)(&axis->life, axis->other());
        } else {
            (void)AXIS_LIFE(step)(&axis->life, axis->source(later(axis, axis->life.chain.preview_samples)));
        }
    }
    count(self);
    return self->life.dac_code;
}

void axis_fault(axis_t *self)
{
    for (axis_t *axis = self; axis != NULL; axis = axis->with) {
        (void)AXIS_LIFE(fault)(&axis->life, axis->safe); /* refused in OFF, where the safe code is output anyway */
    }
}

void axis_replayed(axis_t *self, const uint32_t *codes)
{
    for (axis_t *axis = self; axis != NULL; axis = axis->with, codes++) {
        (void)AXIS_LIFE(replayed)(&axis->life, *codes);
    }
    count(self);
}

void axis_lost(axis_t *self, uint32_t samples)
{
    for (axis_t *axis = self; samples > 0u && axis != NULL; axis = axis->with) {
        AXIS_LIFE(missed)(&axis->life, samples);
        axis->sample = self->counts ? later(axis, samples) : 0u;
    }
}

axis_look_t axis_look(const axis_t *self)
{
    const volatile axis_life_t *life = &self->life;
    return (axis_look_t){
        .mode = life->mode,
        .dac_code = life->dac_code,
        .flags = life->flags,
        .guard_count = life->chain.axis.guard_count,
        .clip_count = life->chain.axis.clip_count,
        .input_count = life->chain.axis.input_count,
        .missed_count = life->chain.axis.missed_count,
    };
}
