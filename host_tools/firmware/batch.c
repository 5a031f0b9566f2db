#include "batch.h"

#include "f32_play.h"
#include "f32_rate.h"

void rdpi_batch_plays(const rdpi_real_t *x_um, size_t samples, const rdpi_real_t *r_um, size_t count,
                      rdpi_real_t *y_um, rdpi_real_t *outputs_um)
{
    for (size_t k = 0; k < samples; k++) {
        for (size_t i = 0; i < count; i++) {
            y_um[i] = rdpi_f32_play(x_um[k], r_um[i], y_um[i]);
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
        rate_um_per_s[k] = rdpi_f32_rate_step(&rate, z_um[k], 0);
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

size_t rdpi_batch_sweep(rdpi_f32_t *self, size_t samples, rdpi_real_t *drive_V, uint32_t *dac_code)
{
    for (size_t k = 0; k < samples; k++) {
        bool more = rdpi_f32_sweep(self);
        drive_V[k] = self->drive_V;
        dac_code[k] = self->dac_code;
        if (!more) {
            rdpi_f32_forget_sweep(self);
            return k + 1u;
        }
    }
    return 0;
}

void rdpi_batch_predict(const rdpi_f32_t *self, const rdpi_real_t *drive_V, const rdpi_real_t *rate_um_per_s,
                        size_t samples, rdpi_real_t *displacement_um)
{
    for (size_t k = 0; k < samples; k++) {
        displacement_um[k] = rdpi_f32_predict(self, drive_V[k], rate_um_per_s[k]);
    }
}

void rdpi_batch_forward(rdpi_f32_t *self, const rdpi_real_t *drive_V, const rdpi_real_t *rate_um_per_s, size_t samples,
                        rdpi_real_t *displacement_um)
{
    for (size_t k = 0; k < samples; k++) {
        displacement_um[k] = rdpi_f32_forward(self, drive_V[k], rate_um_per_s[k]);
    }
}

void rdpi_batch_chain_step(rdpi_f32_chain_t *self, const rdpi_real_t *ahead_um, size_t samples, rdpi_real_t *drive_V,
                           rdpi_real_t *rate_um_per_s, uint32_t *flags, uint32_t *dac_code)
{
    for (size_t k = 0; k < samples; k++) {
        drive_V[k] = rdpi_f32_chain_step(self, ahead_um[k]);
        rate_um_per_s[k] = self->axis.rate_um_per_s;
        flags[k] = self->axis.flags;
        dac_code[k] = self->axis.dac_code;
    }
}

size_t rdpi_batch_chain_sweep(rdpi_f32_chain_t *self, size_t samples, rdpi_real_t *drive_V, uint32_t *dac_code)
{
    for (size_t k = 0; k < samples; k++) {
        bool more = rdpi_f32_chain_sweep(self);
        drive_V[k] = self->axis.drive_V;
        dac_code[k] = self->axis.dac_code;
        if (!more) {
            return k + 1u;
        }
    }
    return 0;
}

void rdpi_batch_q31_step(rdpi_q31_t *self, const int32_t *reference, size_t samples, int32_t *drive, int32_t *rate,
                         uint32_t *flags, uint32_t *dac_code)
{
    for (size_t k = 0; k < samples; k++) {
        drive[k] = rdpi_q31_step(self, reference[k]);
        rate[k] = self->rate;
        flags[k] = self->flags;
        dac_code[k] = self->dac_code;
    }
}

size_t rdpi_batch_q31_sweep(rdpi_q31_t *self, size_t samples, int32_t *drive, uint32_t *dac_code)
{
    for (size_t k = 0; k < samples; k++) {
        bool more = rdpi_q31_sweep(self);
        drive[k] = self->drive;
        dac_code[k] = self->dac_code;
        if (!more) {
            rdpi_q31_forget_sweep(self);
            return k + 1u;
        }
    }
    return 0;
}

void rdpi_batch_q31_predict(const rdpi_q31_t *self, const int32_t *drive, const int32_t *rate, size_t samples,
                            int32_t *displacement)
{
    for (size_t k = 0; k < samples; k++) {
        displacement[k] = rdpi_q31_predict(self, drive[k], rate[k]);
    }
}

void rdpi_batch_q31_forward(rdpi_q31_t *self, const int32_t *drive, const int32_t *rate, size_t samples,
                            int32_t *displacement)
{
    for (size_t k = 0; k < samples; k++) {
        displacement[k] = rdpi_q31_forward(self, drive[k], rate[k]);
    }
}

void rdpi_batch_q31_chain_step(rdpi_q31_chain_t *self, const int32_t *ahead, size_t samples, int32_t *drive,
                               int32_t *rate, uint32_t *flags, uint32_t *dac_code)
{
    for (size_t k = 0; k < samples; k++) {
        drive[k] = rdpi_q31_chain_step(self, ahead[k]);
        rate[k] = self->axis.rate;
        flags[k] = self->axis.flags;
        dac_code[k] = self->axis.dac_code;
    }
}

size_t rdpi_batch_q31_chain_sweep(rdpi_q31_chain_t *self, size_t samples, int32_t *drive, uint32_t *dac_code)
{
    for (size_t k = 0; k < samples; k++) {
        bool more = rdpi_q31_chain_sweep(self);
        drive[k] = self->axis.drive;
        dac_code[k] = self->axis.dac_code;
        if (!more) {
            return k + 1u;
        }
    }
    return 0;
}
