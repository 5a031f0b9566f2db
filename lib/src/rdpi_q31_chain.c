#include "rdpi/q31_chain.h"

#include "crc.h"
#include "q31_creep.h"
#include "q31_lead.h"
#include "q31_saturation.h"
#include "q31_unlag.h"

/* rdpi_q31_chain_digest, whatever the layout of the caller. */
static uint32_t checksum(const rdpi_q31_chain_params_t *params)
{
    const uint32_t numbers[] = {
        (uint32_t)params->lead_ns2, (uint32_t)(params->lead_ns2 >> 32), params->delay_ns, params->lag_ns,
        params->lead_ns, (uint32_t)params->max_lead, (uint32_t)params->direct,
        params->poles | (uint32_t)params->preview << 16};
    uint32_t crc = rdpi_crc32_block(0, numbers, sizeof numbers);
    for (size_t i = 0; i < params->poles; i++) {
        crc = rdpi_crc32(crc, (uint32_t)params->pole[i].share);
        crc = rdpi_crc32_wide(crc, params->pole[i].time_constant_ns);
    }
    return crc;
}

uint32_t rdpi_q31_chain_digest_layout(uint64_t layout, const rdpi_q31_chain_params_t *params)
{
    return layout == RDPI_Q31_CHAIN_LAYOUT ? checksum(params) : 0u;
}

/* What must hold before any other check may read. */
static rdpi_status_t check_pointers(uint64_t layout, const rdpi_q31_chain_t *self,
                                    const rdpi_q31_chain_params_t *params)
{
    if (layout != RDPI_Q31_CHAIN_LAYOUT) {
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
    return params->poles > 0u && params->pole == NULL ? RDPI_ERR_NULL : RDPI_OK;
}

/* Whether what comes at once and the shares of the poles fit. */
static bool shares_fit(const rdpi_q31_chain_params_t *params)
{
    int64_t positive = 0, negative = 0;
    for (size_t i = 0; i < params->poles; i++) {
        int32_t share = params->pole[i].share;
        positive += share > 0 ? share : 0;
        negative += share < 0 ? share : 0;
        if (params->pole[i].time_constant_ns < 1u) {
            return false;
        }
    }
    return params->direct + positive - negative <= (int64_t)1 << 31 && params->direct + negative >= RDPI_Q31_MIN_DIRECT;
}

static rdpi_status_t check_params(const rdpi_q31_chain_params_t *params)
{
    if (params->digest != checksum(params)) {
        return RDPI_ERR_DIGEST;
    }
    bool fits = params->delay_ns <= RDPI_Q31_MAX_LEAD_NS && params->lag_ns <= RDPI_Q31_MAX_LEAD_NS &&
                params->lead_ns <= RDPI_Q31_MAX_LEAD_NS &&
                params->lead_ns2 <= RDPI_Q31_MAX_LEAD_NS2 && params->max_lead > 0 && params->preview <= 1u;
    return fits && shares_fit(params) ? RDPI_OK : RDPI_ERR_CHAIN;
}

rdpi_status_t rdpi_q31_chain_init_layout(uint64_t layout, rdpi_q31_chain_t *self,
                                         const rdpi_q31_chain_params_t *params, uint32_t sample_time_ns)
{
    rdpi_status_t status = check_pointers(layout, self, params);
    if (status == RDPI_OK) {
        status = check_params(params);
    }
    if (status == RDPI_OK) {
        status = rdpi_q31_init(&self->axis, params->axis, sample_time_ns);
    }
    if (status == RDPI_OK && !(rdpi_q31_lead_init(self, params, sample_time_ns) &&
                               rdpi_q31_unlag_init(self, params, sample_time_ns))) {
        status = RDPI_ERR_CHAIN;
    }
    if (status == RDPI_OK) {
        self->params = params;
        self->sample_time_ns = sample_time_ns;
        self->plain = !self->leads && params->lag_ns == 0u && params->poles == 0u;
        rdpi_q31_creep_init(&self->creep, params, sample_time_ns);
        rdpi_q31_chain_settle(self);
    }
    return status;
}

void rdpi_q31_chain_settle(rdpi_q31_chain_t *self)
{
    self->first = true;
    self->lead.latest = 0;
    self->lead.before = 0;
    rdpi_q31_unlag_settle(&self->unlag, &self->axis);
    rdpi_q31_creep_settle(&self->creep, self->params, rdpi_q31_predict(&self->axis, self->axis.drive, 0));
}

void rdpi_q31_chain_reset(rdpi_q31_chain_t *self)
{
    rdpi_q31_reset(&self->axis);
    self->creep.poles = self->params->poles; /* whatever has become of it: the poles are as many as are settled */
    rdpi_q31_chain_settle(self);
}

/* The displacement of the operator at the present drive. */
static int32_t output(const rdpi_q31_t *axis)
{
    return rdpi_q31_clamp(rdpi_q31_predict(axis, axis->drive, axis->rate), -MAX_H, MAX_H);
}

/* The displacement after a sweep that ended in the middle of the range: all plays are there. Scaling and overflow: the
 * ends of x are within 2^29. */
static int32_t middle_of(const rdpi_q31_params_t *params)
{
    int64_t v = rdpi_q31_mul(params->play[params->plays - 1u].slope, params->min_x + params->max_x) >> 31;
    return rdpi_q31_saturation(params->saturation, params->deadzones, params->saturation_shift, INT32_MAX, (int32_t)v);
}

void rdpi_q31_chain_swept(rdpi_q31_chain_t *self, uint32_t ticks)
{
    self->first = true;
    rdpi_q31_unlag_settle(&self->unlag, &self->axis);
    rdpi_q31_creep_settle(&self->creep, self->params, middle_of(self->axis.params));
    self->creep.h = output(&self->axis);
    if (ticks > 0u) {
        rdpi_q31_creep_wait(&self->creep, ticks);
    }
}

/* A lead was limited. A sample counts once, whatever clipped it. */
static void report_lead(rdpi_q31_t *axis)
{
    if ((axis->flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW | RDPI_FLAG_LEAD)) == 0u && axis->clip_count < UINT32_MAX) {
        axis->clip_count++;
    }
    axis->flags |= RDPI_FLAG_LEAD;
}

/* Behind the step of the operator, before which `latest` was output. A reference that is not usable holds it. */
static void undo_lag(rdpi_q31_chain_t *self, int32_t latest, uint32_t latest_code, unsigned missed)
{
    rdpi_q31_t *axis = &self->axis;
    rdpi_q31_unlag_t *unlag = &self->unlag;
    unlag->followed = axis->drive;
    unlag->dac_code = axis->dac_code;
    if ((axis->flags & RDPI_FLAG_INPUT) != 0u) {
        axis->drive = latest;
        axis->dac_code = latest_code;
        return;
    }
    int64_t wish = rdpi_q31_unlag_wish(unlag, axis, self->params->preview > 0u, missed);
    if (!rdpi_q31_unlag_output(unlag, axis, wish)) {
        report_lead(axis);
    }
}

/* The step of a chain that does something. */
static RDPI_Q31_SELDOM int32_t step_chain(rdpi_q31_chain_t *self, int32_t ahead)
{
    rdpi_q31_t *axis = &self->axis;
    rdpi_q31_creep_t *creep = &self->creep;
    bool usable = ahead != RDPI_Q31_NO_REFERENCE, limited = false;
    int32_t latest = axis->drive;
    uint32_t latest_code = axis->dac_code;
    unsigned missed = axis->missed;
    rdpi_q31_unlag_give_back(&self->unlag, axis);
    int32_t reference = ahead;
    if (usable && self->leads) {
        reference = rdpi_q31_lead_step(self, ahead, axis->missed, &limited);
    }
    if (usable && creep->poles > 0u) {
        reference = rdpi_q31_creep_solve(creep, reference);
        creep->h = reference;
    }
    (void)rdpi_q31_step(axis, reference);
    if (limited) {
        report_lead(axis);
    }
    if ((axis->flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0u) { /* creep follows what was really output */
        creep->h = output(axis);
    }
    rdpi_q31_creep_move(creep);
    if (self->unlag.per_step > 0) {
        undo_lag(self, latest, latest_code, missed);
    }
    return axis->drive;
}

int32_t rdpi_q31_chain_step(rdpi_q31_chain_t *self, int32_t ahead)
{
    return self->plain ? rdpi_q31_step(&self->axis, ahead) : step_chain(self, ahead);
}

void rdpi_q31_chain_missed(rdpi_q31_chain_t *self, uint32_t ticks)
{
    rdpi_q31_missed(&self->axis, ticks);
    if (ticks > 0u) {
        rdpi_q31_creep_wait(&self->creep, ticks);
    }
}

int32_t rdpi_q31_chain_forward(rdpi_q31_chain_t *self, int32_t drive)
{
    rdpi_q31_t *axis = &self->axis;
    rdpi_q31_creep_t *creep = &self->creep;
    int32_t displacement = rdpi_q31_forward(axis, drive, 0);
    bool refused = (axis->flags & RDPI_FLAG_INPUT) != 0u;
    if (!refused) {
        rdpi_q31_unlag_settle(&self->unlag, axis);
        self->first = true;
    }
    if (creep->poles > 0u) {
        creep->h = refused ? creep->h : rdpi_q31_clamp(displacement, -MAX_H, MAX_H);
        displacement = rdpi_q31_creep_behind(creep);
        rdpi_q31_creep_move(creep);
    }
    return displacement;
}

uint32_t rdpi_q31_chain_block(rdpi_q31_chain_t *self, const int32_t *reference, uint32_t *codes, uint32_t n)
{
    uint32_t flags = 0;
    if (self == NULL || reference == NULL || codes == NULL) {
        return RDPI_FLAG_INPUT;
    }
    const int32_t *ahead = &reference[self->preview_samples];
    for (uint32_t k = 0; k < n; k++) {
        (void)rdpi_q31_chain_step(self, ahead[k]);
        codes[k] = self->axis.dac_code;
        flags |= self->axis.flags;
    }
    return flags;
}

bool rdpi_q31_chain_sweep(rdpi_q31_chain_t *self)
{
    if (self->axis.sweep_turns == 0u) { /* it begins, at what was output */
        if (self->unlag.per_step > 0) {
            self->axis.ramp = self->unlag.ramp;
        }
        rdpi_q31_chain_swept(self, 0);
    }
    bool goes_on = rdpi_q31_sweep(&self->axis);
    if (!goes_on) {
        rdpi_q31_forget_sweep(&self->axis);
    }
    self->first = true;
    rdpi_q31_unlag_settle(&self->unlag, &self->axis);
    self->creep.h = output(&self->axis);
    rdpi_q31_creep_move(&self->creep);
    return goes_on;
}
