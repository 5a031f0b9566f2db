/* What a chain has really output: for its step, and for its exchange to other parameters. */
#ifndef RDPI_F32_OUTPUT_H
#define RDPI_F32_OUTPUT_H

#include "f32_math.h"
#include "rdpi/f32_chain.h"

static inline bool has_lag(const rdpi_f32_chain_t *self)
{
    return self->unlag.per_step > 0;
}

/* Whether the latest call has not output what it was asked for. */
static inline bool was_clipped(const rdpi_f32_t *axis)
{
    return (axis->flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW | RDPI_FLAG_INPUT)) != 0u;
}

/* Where the actuator is, relative to h_0. */
static RDPI_F32_SELDOM rdpi_real_t output_um(const rdpi_f32_chain_t *self)
{
    const rdpi_f32_t *axis = &self->axis;
    rdpi_real_t drive_V = has_lag(self) ? self->unlag.followed_V : axis->drive_V;
    return rdpi_f32_predict(axis, drive_V, axis->rate_um_per_s) - self->creep.settled_um;
}

#endif
