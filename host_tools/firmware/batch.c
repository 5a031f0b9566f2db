#include "batch.h"

#include "rdpi/play.h"

void rdpi_batch_plays(const rdpi_real_t *x_um, size_t samples, const rdpi_real_t *r_um, size_t count,
                      rdpi_real_t *y_um, rdpi_real_t *outputs_um)
{
    for (size_t k = 0; k < samples; k++) {
        rdpi_f32_plays_move(y_um, r_um, count, x_um[k]);
        for (size_t i = 0; i < count; i++) {
            outputs_um[k * count + i] = y_um[i];
        }
    }
}

rdpi_status_t rdpi_batch_rate(rdpi_real_t window_s, rdpi_real_t filter_s, rdpi_real_t sample_time_s,
                              const rdpi_real_t *z_um, size_t samples, rdpi_real_t *rate_um_per_s)
{
    rdpi_f32_rate_t rate;
    rdpi_status_t status = rdpi_f32_rate_init(&rate, window_s, filter_s, sample_time_s);
    for (size_t k = 0; status == RDPI_OK && k < samples; k++) {
        rate_um_per_s[k] = rdpi_f32_rate_step(&rate, z_um[k]);
    }
    return status;
}

void rdpi_batch_step(rdpi_f32_t *self, const rdpi_real_t *reference_um, size_t samples, rdpi_real_t *drive_V,
                     rdpi_real_t *rate_um_per_s, uint32_t *flags, uint32_t *dac_code)
{
    for (size_t k = 0; k < samples; k++) {
        drive_V[k] = rdpi_f32_step(self, reference_um[k]);
        rate_um_per_s[k] = self->rate_um_per_s;
        flags[k] = self->flags;
        dac_code[k] = self->dac_code;
    }
}

void rdpi_batch_forward(rdpi_f32_t *self, const rdpi_real_t *drive_V, const rdpi_real_t *rate_um_per_s, size_t samples,
                        rdpi_real_t *displacement_um)
{
    for (size_t k = 0; k < samples; k++) {
        displacement_um[k] = rdpi_f32_forward(self, drive_V[k], rate_um_per_s[k]);
    }
}
