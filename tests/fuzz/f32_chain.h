/* A chain around the operator of any_f32.c or valid_f32.c. Both take it for inputs of an odd size. */
#ifndef FUZZ_F32_CHAIN_H
#define FUZZ_F32_CHAIN_H

#include "f32.h"

#include "rdpi/f32_chain.h"

#define CLIPS (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW | RDPI_FLAG_LEAD)

static void check_chain(const rdpi_f32_chain_t *self)
{
    rdpi_f32_t axis = self->axis;
    axis.flags &= ~(uint32_t)RDPI_FLAG_LEAD;
    check_state(&axis);
    for (size_t i = 0; i < self->params->poles; i++) {
        CHECK(isfinite(self->creep.lag[i].state_um));
    }
    if (self->params->lag_s > 0) { /* what the operator gets back */
        axis.drive_V = self->unlag.followed_V;
        axis.dac_code = self->unlag.dac_code;
        check_state(&axis);
        CHECK(isfinite(self->unlag.carried_V) && (self->unlag.first || isfinite(self->unlag.asked_V)));
    }
}

/* The long way gives the same. */
static void check_long_way(rdpi_f32_chain_t before, const rdpi_f32_chain_t *after, number_t reference)
{
    before.axis.quick = false;
    number_t drive = rdpi_f32_chain_step(&before, reference);
    CHECK(drive == after->axis.drive_V && before.axis.dac_code == after->axis.dac_code);
    CHECK(before.axis.flags == after->axis.flags);
    CHECK(after->unlag.first || before.unlag.asked_V == after->unlag.asked_V);
}

static void chain_step(rdpi_f32_chain_t *self, number_t reference)
{
    rdpi_f32_chain_t all_before = *self;
    rdpi_f32_t before = self->axis;
    rdpi_f32_lead_t lead = self->lead;
    number_t drive = rdpi_f32_chain_step(self, reference);
    const rdpi_f32_t *axis = &self->axis;
    check_long_way(all_before, self, reference);
    CHECK(drive == axis->drive_V);
    CHECK(axis->guard_count == before.guard_count + ((axis->flags & RDPI_FLAG_GUARD) != 0));
    CHECK(axis->clip_count == before.clip_count + ((axis->flags & CLIPS) != 0));
    CHECK(axis->input_count == before.input_count + ((axis->flags & RDPI_FLAG_INPUT) != 0));
    CHECK(axis->missed_count == before.missed_count);
    if (!usable_reference(reference)) {
        CHECK(axis->flags == RDPI_FLAG_INPUT && memcmp(&lead, &self->lead, sizeof lead) == 0);
    }
    if (axis->flags & RDPI_FLAG_INPUT) { /* lead or creep may have brought it beyond the largest */
        check_held(&before, axis);
    }
}

/* Nothing rings on: without creep and lag, a reference at rest reaches the operator as it is after three samples. (Behind
 * lag^-1 the drive goes on while the operator's does: its rate may be filtered.) */
static void chain_rest(rdpi_f32_chain_t *self, number_t reference)
{
    for (int k = 0; k < 3; k++) {
        chain_step(self, reference);
    }
    if (self->params->poles == 0 && self->params->lag_s <= 0 && usable_reference(reference)) {
        rdpi_f32_t axis = self->axis;
        CHECK(rdpi_f32_chain_step(self, reference) == rdpi_f32_step(&axis, reference));
        CHECK(self->axis.flags == axis.flags);
    }
}

static void chain_sweep(rdpi_f32_chain_t *self, unsigned samples)
{
    bool more = true;
    for (; more && samples > 0; samples--) {
        more = rdpi_f32_chain_sweep(self);
        check_chain(self);
    }
}

/* Calls in the order that the rest of the input gives. */
static void call_chain(rdpi_f32_chain_t *self, double low, double high)
{
    check_chain(self);
    for (unsigned calls = 0; input_left > 0 && calls < 400; calls++) {
        uint8_t what = take_u8();
        switch (what % 16) {
        case 0:
            rdpi_f32_chain_missed(self, what < 128 ? what / 16 : take_u32());
            break;
        case 1:
            chain_sweep(self, 1u + what);
            break;
        case 2:
            (void)rdpi_f32_forward(&self->axis, take_drive(self->axis.params), 0);
            if (what < 128) {
                rdpi_f32_chain_settle(self);
            } else {
                rdpi_f32_chain_swept(self, take_u32());
            }
            break;
        case 3:
            do_any_memory(&self->axis);
            rdpi_f32_chain_settle(self);
            break;
        case 4:
            if (what >= 128) {
                rdpi_f32_chain_reset(self);
                CHECK(self->axis.flags == 0 && self->axis.clip_count == 0);
            }
            break;
        case 5:
            chain_rest(self, (number_t)take_between(low, high));
            break;
        case 6:
        case 7:
            chain_step(self, take_any());
            break;
        default:
            chain_step(self, (number_t)take_between(low, high));
        }
        check_chain(self);
    }
}

/* Whatever the chain is, it is refused or keeps its promises. */
static void any_chain(const rdpi_f32_params_t *axis, number_t sample_time_s, double low, double high)
{
    rdpi_f32_chain_t self;
    rdpi_f32_pole_t pole[RDPI_MAX_POLES];
    uint8_t how = take_u8();
    rdpi_f32_chain_params_t params = {.schema = RDPI_PARAMS_SCHEMA, .axis = axis, .pole = pole};
    params.poles = take_u8() % (RDPI_MAX_POLES + 2);
    params.preview = how % 4 == 0 ? take_u16() : how % 2;
    params.delay_s = take_any();
    params.lag_s = take_any();
    params.lead_s = take_any();
    params.lead_s2 = take_any();
    params.max_lead_um = take_any();
    params.direct = take_any();
    take(pole, sizeof pole);
    bool counts_fit = params.poles <= RDPI_MAX_POLES;
    params.digest = how >= 240 || !counts_fit ? take_u32() : rdpi_f32_chain_digest(&params);
    rdpi_status_t status = rdpi_f32_chain_init(&self, &params, sample_time_s);
    CHECK(rdpi_status_text(status) != NULL);
    if (status == RDPI_OK) {
        CHECK(counts_fit);
        call_chain(&self, low, high);
    }
}

/* A chain that is valid by construction is accepted. */
static void valid_chain(const rdpi_f32_params_t *axis, number_t sample_time_s, double low, double high)
{
    rdpi_f32_chain_t self;
    rdpi_f32_pole_t pole[RDPI_MAX_POLES];
    uint8_t how = take_u8();
    double negative = 0, T = (double)sample_time_s;
    rdpi_f32_chain_params_t params = {.schema = RDPI_PARAMS_SCHEMA, .axis = axis, .pole = pole};
    params.poles = how & 1 ? take_u8() % (RDPI_MAX_POLES + 1) : 0;
    params.preview = how >> 1 & 1;
    params.delay_s = (number_t)(how & 4 ? T * pow(10, take_between(-2, 6)) : 0);
    params.lag_s = (number_t)(how & 32 ? T * pow(10, take_between(-2, 6)) : 0);
    params.lead_s = (number_t)(how & 8 ? T * pow(10, take_between(-2, 6)) : 0);
    params.lead_s2 = (number_t)(how & 16 ? T * T * pow(10, take_between(-2, 6)) : 0);
    params.max_lead_um = (number_t)pow(10, take_between(-6, 7));
    for (size_t i = 0; i < params.poles; i++) {
        pole[i].share = (number_t)take_between(-1, 2);
        pole[i].time_constant_s = (number_t)fmin(T * pow(10, take_between(-9, 9)), 1e7);
        negative += fmin((double)pole[i].share, 0);
    }
    params.direct = (number_t)(take_between(0.002, 2) - negative);
    params.digest = rdpi_f32_chain_digest(&params);
    CHECK(rdpi_f32_chain_init(&self, &params, sample_time_s) == RDPI_OK);
    call_chain(&self, low, high);
}

#endif
