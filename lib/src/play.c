#include "rdpi/play.h"

void rdpi_f32_plays_move(rdpi_real_t *y_um, const rdpi_real_t *r_um, size_t count, rdpi_real_t x_um)
{
    for (size_t i = 0; i < count; i++) {
        y_um[i] = rdpi_f32_play(x_um, r_um[i], y_um[i]);
    }
}

void rdpi_f32_slopes_at(rdpi_real_t *slopes_out, const rdpi_real_t *slopes, const rdpi_real_t *slope_rate_s_per_um,
                        size_t count, rdpi_real_t rate_um_per_s)
{
    for (size_t i = 0; i < count; i++) {
        slopes_out[i] = slopes[i] + slope_rate_s_per_um[i] * rate_um_per_s;
    }
}

/* Summed by parts, v = sum of W_i (y_i - y_(i+1)): each play's weight is never formed, so none is rounded. */
rdpi_real_t rdpi_f32_plays_sum(const rdpi_real_t *y_um, const rdpi_real_t *slopes, size_t count)
{
    rdpi_real_t v_um = slopes[count - 1] * y_um[count - 1];
    for (size_t i = count - 1; i > 0; i--) {
        v_um += slopes[i - 1] * (y_um[i - 1] - y_um[i]);
    }
    return v_um;
}
