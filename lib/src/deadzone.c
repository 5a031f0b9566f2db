#include "rdpi/deadzone.h"

rdpi_real_t rdpi_f32_saturation(const rdpi_real_t *d_um, const rdpi_real_t *weights, size_t count, rdpi_real_t v_um)
{
    rdpi_real_t z_um = weights[0] * v_um;
    for (size_t j = 1; j < count; j++) {
        z_um += weights[j] * rdpi_f32_deadzone(v_um, d_um[j]);
    }
    return z_um;
}

rdpi_real_t rdpi_f32_saturation_inverse(const rdpi_real_t *d_um, const rdpi_real_t *weights, size_t count,
                                        rdpi_real_t z_um)
{
    rdpi_real_t v_um = 0; /* the corner at which the piece of slope `slope` begins, */
    rdpi_real_t corner_um = 0; /* and S there */
    rdpi_real_t slope = weights[0];
    for (size_t j = 1; j < count; j++) {
        rdpi_real_t next_um = corner_um + slope * (d_um[j] - v_um);
        if (z_um <= next_um) {
            break;
        }
        v_um = d_um[j];
        corner_um = next_um;
        slope += weights[j];
    }
    return v_um + (z_um - corner_um) / slope;
}
