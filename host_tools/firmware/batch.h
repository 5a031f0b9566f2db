/* Loops over arrays for the host tools: the firmware's own functions, called once per sample without Python between
 * them. Compiled with lib/src/ into rdpi._f32 (RDPI_REAL=float) and rdpi._f64 (RDPI_REAL=double). */
#ifndef RDPI_BATCH_H
#define RDPI_BATCH_H

#include "rdpi/rdpi.h"

/* Moves a bank of plays, states `y_um`, through `samples` inputs; outputs[k * count + i] is play i at sample k. */
void rdpi_batch_plays(const rdpi_real_t *x_um, size_t samples, const rdpi_real_t *r_um, size_t count,
                      rdpi_real_t *y_um, rdpi_real_t *outputs_um);

/* rdpi_f32_rate_step over an array, from a fresh estimator. */
rdpi_status_t rdpi_batch_rate(rdpi_real_t window_s, rdpi_real_t filter_s, rdpi_real_t sample_time_s,
                              const rdpi_real_t *z_um, size_t samples, rdpi_real_t *rate_um_per_s);

/* rdpi_f32_step over an array; every output has `samples` values. */
void rdpi_batch_step(rdpi_f32_t *self, const rdpi_real_t *reference_um, size_t samples, rdpi_real_t *drive_V,
                     rdpi_real_t *rate_um_per_s, uint32_t *flags, uint32_t *dac_code);

/* rdpi_f32_forward over arrays. */
void rdpi_batch_forward(rdpi_f32_t *self, const rdpi_real_t *drive_V, const rdpi_real_t *rate_um_per_s, size_t samples,
                        rdpi_real_t *displacement_um);

/* What cffi reads (never compiled; cffi checks it against the real declarations when it builds). */
#ifdef RDPI_CFFI
/* cffi-begin */
typedef float... rdpi_real_t;
typedef int... rdpi_status_t;
#define RDPI_PARAMS_SCHEMA ...
#define RDPI_MAX_PLAYS ...
#define RDPI_MAX_DEADZONES ...
#define RDPI_MAX_WINDOW ...
#define RDPI_OK ...
typedef struct {
    uint32_t schema;
    uint16_t plays, deadzones;
    const rdpi_real_t *thresholds_um, *slopes, *slope_rate_s_per_um;
    const rdpi_real_t *deadzones_um, *deadzone_weights, *memory_um;
    rdpi_real_t gain_um_per_V, offset_V, offset_um;
    rdpi_real_t rate_window_s, rate_filter_s, max_um_per_s, min_slope_ratio;
    rdpi_real_t min_V, max_V, slew_V_per_s;
    uint16_t dac_bits;
    ...;
} rdpi_f32_params_t;
typedef struct {
    rdpi_real_t drive_V, rate_um_per_s;
    uint32_t dac_code, flags, guard_count, clip_count, input_count;
    ...;
} rdpi_f32_t;
const char *rdpi_status_text(rdpi_status_t status);
rdpi_status_t rdpi_f32_init(rdpi_f32_t *self, const rdpi_f32_params_t *params, rdpi_real_t sample_time_s);
void rdpi_f32_reset(rdpi_f32_t *self);
rdpi_status_t rdpi_f32_set_memory(rdpi_f32_t *self, const rdpi_real_t *y_um);
void rdpi_f32_get_memory(const rdpi_f32_t *self, rdpi_real_t *y_um);
void rdpi_batch_plays(const rdpi_real_t *x_um, size_t samples, const rdpi_real_t *r_um, size_t count,
                      rdpi_real_t *y_um, rdpi_real_t *outputs_um);
rdpi_status_t rdpi_batch_rate(rdpi_real_t window_s, rdpi_real_t filter_s, rdpi_real_t sample_time_s,
                              const rdpi_real_t *z_um, size_t samples, rdpi_real_t *rate_um_per_s);
void rdpi_batch_step(rdpi_f32_t *self, const rdpi_real_t *reference_um, size_t samples, rdpi_real_t *drive_V,
                     rdpi_real_t *rate_um_per_s, uint32_t *flags, uint32_t *dac_code);
void rdpi_batch_forward(rdpi_f32_t *self, const rdpi_real_t *drive_V, const rdpi_real_t *rate_um_per_s, size_t samples,
                        rdpi_real_t *displacement_um);
/* cffi-end */
#endif
#endif
