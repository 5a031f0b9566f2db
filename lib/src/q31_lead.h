/* The lead in fixed point: r + a r' + b r'' from three references in a row. f32_lead.h says where a and b come from. */
#ifndef RDPI_Q31_LEAD_H
#define RDPI_Q31_LEAD_H

#include "q31_blend.h"
#include "q31_rate.h"
#include "rdpi/q31_chain.h"

/* a / b as a ratio, whatever the sign of a. Where a is 0, no other ratio is smaller. */
static inline rdpi_q31_scaled_t rdpi_q31_lead_ratio(int64_t a, uint64_t b)
{
    rdpi_q31_scaled_t none = {0, 65};
    return a == 0 ? none : rdpi_q31_ratio(a < 0 ? 0u - (uint64_t)a : (uint64_t)a, b);
}

/* The shift with which both ratios have 30 bits at most. */
static inline int rdpi_q31_lead_shift(int exponent, int other)
{
    int shift = (exponent < other ? exponent : other) - 2;
    return shift < 63 ? shift : 63;
}

/* A ratio with the sign of `a`, times 2^shift. */
static inline int32_t rdpi_q31_lead_factor(rdpi_q31_scaled_t ratio, int shift, int64_t a)
{
    int excess = ratio.exponent - shift; /* >= 2 */
    int32_t factor = excess < 32 ? (int32_t)(ratio.mantissa >> excess) : 0;
    return a < 0 ? -factor : factor;
}

/* Sets up the lead of checked parameters for samples that are T ns apart. Returns whether it fits: it must not multiply
 * by 2^29 or more. */
static inline bool rdpi_q31_lead_init(rdpi_q31_chain_t *self, const rdpi_q31_chain_params_t *params, uint32_t T)
{
    rdpi_q31_lead_t *lead = &self->lead;
    uint32_t samples = params->preview > 0u ? (uint32_t)(((uint64_t)params->delay_ns + T / 2u) / T) : 0u;
    /* what is left of the delay, or all of it: |f| <= delay_ns */
    int64_t f = (int64_t)params->delay_ns - (int64_t)((uint64_t)samples * T);
    int64_t a = (int64_t)params->lead_ns + f; /* < 2^31 */
    int64_t b = (int64_t)params->lead_ns2 + (int64_t)params->lead_ns * f + f * f / 2;
    if (params->preview == 0u) {
        b += a * (int64_t)T; /* r' is (d + d_before) / 2 T at the reference before, and r'' / T larger at the latest */
    }
    rdpi_q31_scaled_t sum = rdpi_q31_lead_ratio(a, 2u * (uint64_t)T);
    rdpi_q31_scaled_t change = rdpi_q31_lead_ratio(b, (uint64_t)T * T);
    int shift = rdpi_q31_lead_shift(sum.exponent, change.exponent);
    lead->shift = (uint8_t)shift;
    lead->per_sum = rdpi_q31_lead_factor(sum, shift, a);
    lead->per_change = rdpi_q31_lead_factor(change, shift, b);
    self->leads = params->delay_ns > 0u || params->lead_ns > 0u || params->lead_ns2 > 0u;
    lead->rings = params->lead_ns > 0u || params->lead_ns2 > 0u;
    self->preview_samples = self->leads && params->preview > 0u ? samples + 1u : 0u;
    return shift >= 1;
}

/* A difference of less than 2^33 in 32 bits. */
static inline int32_t rdpi_q31_lead_narrow(int64_t difference)
{
    int32_t narrow = (int32_t)difference;
    if (narrow != difference) {
        narrow = difference < 0 ? -INT32_MAX : INT32_MAX;
    }
    return narrow;
}

/* The difference of the latest two references per sample, if some were missed or there is no history. */
static RDPI_Q31_SELDOM int64_t rdpi_q31_lead_begin(rdpi_q31_chain_t *self, int32_t ahead, unsigned missed)
{
    rdpi_q31_lead_t *lead = &self->lead;
    if (self->first || missed > RDPI_MAX_MISSED) {
        self->first = false;
        lead->before = 0;
        return 0;
    }
    uint32_t way = rdpi_q31_part(rdpi_q31_distance(ahead, lead->latest), missed + 1u);
    int64_t d = ahead > lead->latest ? (int64_t)way : -(int64_t)way;
    lead->before = rdpi_q31_lead_narrow(d); /* on a straight line */
    return d;
}

/* Takes a reference, and returns it with the lead added. Sets `limited` if the lead would have been more than max_lead.
 * `missed` samples were missed before it. Scaling and overflow: references differ by less than 2^32; differences, their
 * sum and their change saturate at +-INT32_MAX, and the products are <= 2^61. */
static inline int32_t rdpi_q31_lead_step(rdpi_q31_chain_t *self, int32_t ahead, unsigned missed, bool *limited)
{
    rdpi_q31_lead_t *lead = &self->lead;
    int64_t d = (int64_t)ahead - lead->latest;
    if (self->first || missed > 0u) {
        d = rdpi_q31_lead_begin(self, ahead, missed);
    }
    int32_t step = rdpi_q31_lead_narrow(d), before = lead->before;
    int32_t sum = rdpi_q31_lead_narrow((int64_t)step + before);
    int32_t change = rdpi_q31_lead_narrow((int64_t)step - before);
    lead->latest = ahead;
    lead->before = step;

    bool jumps = !lead->rings && !((step > 0 && before > 0) || (step < 0 && before < 0));
    int64_t wish = (rdpi_q31_mul(lead->per_sum, sum) + rdpi_q31_mul(lead->per_change, change)) >> lead->shift;
    wish = jumps ? 0 : wish;
    int32_t most = self->params->max_lead;
    int32_t added = rdpi_q31_clamp(wish, -most, most);
    *limited = added != wish;
    int64_t base = self->preview_samples > 0u ? ahead - d : ahead;
    return rdpi_q31_clamp(base + added, -INT32_MAX, INT32_MAX);
}

#endif
