/* Whatever the parameters of a chain are, rdpi_q31_chain_init refuses them or the chain keeps the promises of its
 * operator, in any order of calls. */
#include "rdpi/q31_chain.h"
#include "valid_q31.h"

/* Bits of the first byte: left out, fields fit their formats. */
enum { DIGEST = 1, NUMBERS = 2, SCHEMA = 4, NO_POLE = 8, NO_AXIS = 16, COUNT = 32, ANY_TIME = 64 };

static void fit_numbers(rdpi_q31_chain_params_t *params, rdpi_q31_pole_t *pole, size_t poles)
{
    int32_t share = poles > 0u ? RDPI_Q31_ONE / (int32_t)poles : 0;
    params->lead_ns2 %= RDPI_Q31_MAX_LEAD_NS2 + 1u;
    params->lead_ns %= RDPI_Q31_MAX_LEAD_NS + 1u;
    params->lag_ns %= RDPI_Q31_MAX_LEAD_NS + 1u;
    params->delay_ns %= RDPI_Q31_MAX_LEAD_NS + 1u;
    params->max_lead = params->max_lead == INT32_MIN ? 1 : abs(params->max_lead) | 1;
    params->preview %= 2u;
    params->direct = RDPI_Q31_ONE;
    for (size_t i = 0; i < poles; i++) {
        pole[i].share %= share / 2 + 1; /* the negative ones leave half of what comes at once */
        pole[i].time_constant_ns >>= pole[i].share & 63;
        pole[i].time_constant_ns |= 1u;
    }
}

/* What holds of the operator after every call holds of the chain's, and counts follow from flags. */
static void check_chain(const rdpi_q31_chain_t *self, const axis_t *before)
{
    axis_t after = self->axis;
    bool led = (after.flags & RDPI_FLAG_LEAD) != 0u;
    after.flags &= ~(uint32_t)RDPI_FLAG_LEAD;
    check_state(&after);
    if (led) {
        bool clipped = (after.flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0u;
        CHECK((self->leads || self->params->lag_ns > 0u) && (after.flags & RDPI_FLAG_INPUT) == 0u);
        after.clip_count -= clipped ? 0u : 1u;
    }
    check_counts(before, &after);
    for (size_t i = 0; i < self->params->poles; i++) {
        int64_t state = self->creep.lag[i].state >> 32;
        CHECK(state > -RDPI_Q31_ONE && state < RDPI_Q31_ONE);
    }
}

static void chain_step(rdpi_q31_chain_t *self, int32_t reference)
{
    axis_t before = self->axis;
    int32_t drive = rdpi_q31_chain_step(self, reference);
    CHECK(drive == self->axis.drive);
    check_chain(self, &before);
    CHECK((self->axis.flags == RDPI_FLAG_INPUT) == !usable_reference(reference));
    if (!usable_reference(reference)) {
        check_held(&before, &self->axis);
    }
}

static void chain_calls(rdpi_q31_chain_t *self)
{
    for (unsigned calls = 0; input_left > 0 && calls < 400; calls++) {
        uint8_t what = take_u8();
        axis_t before = self->axis;
        switch (what % 16) {
        case 0:
            rdpi_q31_chain_missed(self, what < 128 ? what / 16 : take_u32());
            check_held(&before, &self->axis);
            break;
        case 1:
            for (unsigned samples = what; samples > 0 && rdpi_q31_chain_sweep(self); samples--) {
                check_state(&self->axis);
            }
            break;
        case 2:
            do_forward(&self->axis, take_drive(self->axis.params), RDPI_Q31_ONE / 2);
            if (what < 128) {
                rdpi_q31_chain_settle(self);
            } else {
                rdpi_q31_chain_swept(self, take_u32());
            }
            break;
        case 3:
            if (what >= 128) {
                rdpi_q31_chain_reset(self);
                CHECK(self->axis.flags == 0 && self->axis.clip_count == 0);
            }
            break;
        case 4:
            chain_step(self, take_any());
            break;
        case 5: /* held, until creep has nearly settled */
            for (unsigned k = 0; k < 300; k++) {
                chain_step(self, (int32_t)what << 22);
            }
            break;
        default:
            chain_step(self, (int32_t)take_between(-0x1p30, 0x1p30));
        }
        CHECK(self->axis.drive >= self->axis.params->min_drive && self->axis.drive <= self->axis.params->max_drive);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    rdpi_q31_chain_t self;
    rdpi_q31_chain_params_t params;
    valid_q31_t valid;
    input = data;
    input_left = size;

    uint8_t how = take_u8();
    take_valid(&valid);
    take(&params, offsetof(rdpi_q31_chain_params_t, axis));
    params.poles = how & COUNT ? params.poles : params.poles % (RDPI_MAX_POLES + 1u);
    size_t poles = params.poles <= RDPI_MAX_POLES ? params.poles : 0u;
    rdpi_q31_pole_t *pole = malloc(poles * sizeof *pole + 1u); /* of exactly this size, so that a read beyond is seen */
    for (size_t i = 0; i < poles; i++) {
        take(&pole[i].share, sizeof pole[i].share);
        take(&pole[i].time_constant_ns, sizeof pole[i].time_constant_ns);
    }
    if (!(how & NUMBERS)) {
        fit_numbers(&params, pole, poles);
    }
    params.schema = how & SCHEMA ? params.schema : RDPI_PARAMS_SCHEMA;
    params.axis = how & NO_AXIS ? NULL : &valid.params;
    params.pole = how & NO_POLE ? NULL : pole;
    bool complete = params.poles <= RDPI_MAX_POLES && (poles == 0u || params.pole != NULL);
    if (!(how & DIGEST) && complete) {
        params.digest = rdpi_q31_chain_digest(&params);
    }
    uint32_t sample_time_ns = how & ANY_TIME ? take_u32() : valid.sample_time_ns;
    rdpi_status_t status = rdpi_q31_chain_init(&self, &params, sample_time_ns);
    CHECK(rdpi_status_text(status) != NULL);
    if (status == RDPI_OK) {
        CHECK(complete && params.axis != NULL && params.schema == RDPI_PARAMS_SCHEMA);
        check_state(&self.axis);
        chain_calls(&self);
    }
    free(pole);
    return 0;
}
