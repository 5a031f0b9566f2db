/* Loops over arrays for the host tools: the firmware's own functions, called once per sample without Python between
 * them. Compiled with lib/src/ into rdpi._f32 (RDPI_REAL=float) and rdpi._f64 (RDPI_REAL=double); the fixed-point half
 * is the same in both. */
#ifndef RDPI_BATCH_H
#define RDPI_BATCH_H

#include "plant.h"
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

/* rdpi_f32_sweep until it ends, `samples` times at most, then rdpi_f32_forget_sweep; returns how many samples it took,
 * 0 if it goes on. */
size_t rdpi_batch_sweep(rdpi_f32_t *self, size_t samples, rdpi_real_t *drive_V, uint32_t *dac_code);

/* rdpi_f32_predict over arrays. */
void rdpi_batch_predict(const rdpi_f32_t *self, const rdpi_real_t *drive_V, const rdpi_real_t *rate_um_per_s,
                        size_t samples, rdpi_real_t *displacement_um);

/* rdpi_f32_forward over arrays. */
void rdpi_batch_forward(rdpi_f32_t *self, const rdpi_real_t *drive_V, const rdpi_real_t *rate_um_per_s, size_t samples,
                        rdpi_real_t *displacement_um);

/* As rdpi_batch_step and rdpi_batch_sweep, of an operator and its chain. */
void rdpi_batch_chain_step(rdpi_f32_chain_t *self, const rdpi_real_t *ahead_um, size_t samples, rdpi_real_t *drive_V,
                           rdpi_real_t *rate_um_per_s, uint32_t *flags, uint32_t *dac_code);
size_t rdpi_batch_chain_sweep(rdpi_f32_chain_t *self, size_t samples, rdpi_real_t *drive_V, uint32_t *dac_code);

/* The same of rdpi_q31_... */
void rdpi_batch_q31_step(rdpi_q31_t *self, const int32_t *reference, size_t samples, int32_t *drive, int32_t *rate,
                         uint32_t *flags, uint32_t *dac_code);
size_t rdpi_batch_q31_sweep(rdpi_q31_t *self, size_t samples, int32_t *drive, uint32_t *dac_code);
void rdpi_batch_q31_predict(const rdpi_q31_t *self, const int32_t *drive, const int32_t *rate, size_t samples,
                            int32_t *displacement);
void rdpi_batch_q31_forward(rdpi_q31_t *self, const int32_t *drive, const int32_t *rate, size_t samples,
                            int32_t *displacement);
void rdpi_batch_q31_chain_step(rdpi_q31_chain_t *self, const int32_t *ahead, size_t samples, int32_t *drive,
                               int32_t *rate, uint32_t *flags, uint32_t *dac_code);
size_t rdpi_batch_q31_chain_sweep(rdpi_q31_chain_t *self, size_t samples, int32_t *drive, uint32_t *dac_code);

/* What cffi reads (never compiled; cffi checks it against the real declarations when it builds). */
#ifdef RDPI_CFFI
/* cffi-begin */
typedef float... rdpi_real_t;
typedef int... rdpi_status_t;
#define RDPI_PARAMS_SCHEMA ...
#define RDPI_MAX_PLAYS ...
#define RDPI_MAX_DEADZONES ...
#define RDPI_MAX_WINDOW ...
#define RDPI_MAX_POLES ...
#define RDPI_MAX_REFERENCE_UM ...
#define RDPI_OK ...
#define RDPI_ERR_DIGEST ...
#define RDPI_ERR_SAMPLE_RANGE ...
const char *rdpi_status_text(rdpi_status_t status);

typedef struct {
    rdpi_real_t r_um, slope, slope_rate_s_per_um, intercept_um, intercept_rate_s;
} rdpi_f32_play_t;
typedef struct {
    rdpi_real_t d_um, weight;
} rdpi_f32_deadzone_t;
typedef struct {
    rdpi_real_t from_um, to_um, slope, intercept_um;
} rdpi_f32_piece_t;
typedef struct {
    rdpi_real_t to_V, to_um, middle_um, reach_um, gain_um_per_V, V_per_um, offset_V, from_code, to_code;
    rdpi_real_t codes_per_um, code_of_x_0, um_per_code, x_of_code_0_um;
} rdpi_f32_line_t;
typedef struct {
    uint32_t schema, digest;
    uint16_t plays;
    uint8_t deadzones, dac_bits, curve_pieces, noise_shaping;
    uint16_t sweep_cycles;
    rdpi_real_t offset_um;
    rdpi_real_t rate_window_s, rate_filter_s, max_um_per_s, min_slope_ratio;
    rdpi_real_t min_V, max_V, slew_V_per_s, sweep_V_per_s, sweep_end_V, sweep_forgotten;
    rdpi_real_t min_sample_time_s, max_sample_time_s;
    rdpi_real_t last_code, V_per_code;
    const rdpi_f32_play_t *play;
    const rdpi_f32_deadzone_t *saturation;
    const rdpi_f32_piece_t *inverse_saturation;
    const rdpi_f32_line_t *curve;
    const rdpi_real_t *memory_um;
} rdpi_f32_params_t;
typedef struct {
    rdpi_real_t drive_V, rate_um_per_s;
    uint32_t dac_code, flags, guard_count, clip_count, input_count, missed_count;
    ...;
} rdpi_f32_t;
uint32_t rdpi_f32_digest(const rdpi_f32_params_t *params);
rdpi_status_t rdpi_f32_init(rdpi_f32_t *self, const rdpi_f32_params_t *params, rdpi_real_t sample_time_s);
void rdpi_f32_reset(rdpi_f32_t *self);
rdpi_status_t rdpi_f32_set_memory(rdpi_f32_t *self, const rdpi_real_t *y_um);
void rdpi_f32_get_memory(const rdpi_f32_t *self, rdpi_real_t *y_um);
void rdpi_f32_missed(rdpi_f32_t *self, uint32_t ticks);

typedef struct {
    uint16_t window, oldest;
    ...;
} rdpi_f32_rate_t;
#define RDPI_BLOCK_LINE ...
#define RDPI_BLOCK_BENT ...
#define RDPI_BLOCK_CUBIC ...
#define RDPI_BLOCK_CLAMP ...
#define RDPI_BLOCK_ROUND ...
#define RDPI_BLOCK_STAIRCASE ...
#define RDPI_BLOCK_SLEW ...
#define RDPI_BLOCK_DELAY ...
#define RDPI_BLOCK_LAGS ...
#define RDPI_BLOCK_RING ...
#define RDPI_BLOCK_PLAY ...
#define RDPI_BLOCK_WIDEN ...
#define RDPI_BLOCK_OPERATOR ...
typedef struct {
    int kind;
    uint32_t count;
    rdpi_real_t p[7];
    const rdpi_real_t *a, *b, *c;
    rdpi_real_t *state;
    rdpi_f32_rate_t *rate;
    rdpi_f32_t *axis;
    int of_control;
} rdpi_block_t;
rdpi_status_t rdpi_plant_rate_init(rdpi_f32_rate_t *rate, rdpi_real_t window_s, rdpi_real_t filter_s,
                                   rdpi_real_t sample_time_s);
void rdpi_plant_run(const rdpi_block_t *block, size_t count, size_t samples, rdpi_real_t *signal, rdpi_real_t *driven_V,
                    rdpi_real_t *rate_um_per_s);

void rdpi_batch_plays(const rdpi_real_t *x_um, size_t samples, const rdpi_real_t *r_um, size_t count,
                      rdpi_real_t *y_um, rdpi_real_t *outputs_um);
rdpi_status_t rdpi_batch_rate(rdpi_real_t window_s, rdpi_real_t filter_s, rdpi_real_t sample_time_s,
                              const rdpi_real_t *z_um, size_t samples, rdpi_real_t *rate_um_per_s);
void rdpi_batch_step(rdpi_f32_t *self, const rdpi_real_t *reference_um, size_t samples, rdpi_real_t *drive_V,
                     rdpi_real_t *rate_um_per_s, uint32_t *flags, uint32_t *dac_code);
size_t rdpi_batch_sweep(rdpi_f32_t *self, size_t samples, rdpi_real_t *drive_V, uint32_t *dac_code);
void rdpi_batch_predict(const rdpi_f32_t *self, const rdpi_real_t *drive_V, const rdpi_real_t *rate_um_per_s,
                        size_t samples, rdpi_real_t *displacement_um);
void rdpi_batch_forward(rdpi_f32_t *self, const rdpi_real_t *drive_V, const rdpi_real_t *rate_um_per_s, size_t samples,
                        rdpi_real_t *displacement_um);

typedef struct {
    rdpi_real_t share, time_constant_s;
} rdpi_f32_pole_t;
typedef struct {
    uint32_t schema, digest;
    uint16_t poles, preview;
    rdpi_real_t delay_s, lag_s, lead_s, lead_s2, max_lead_um, direct;
    const rdpi_f32_params_t *axis;
    const rdpi_f32_pole_t *pole;
} rdpi_f32_chain_params_t;
typedef struct {
    rdpi_f32_t axis;
    uint32_t preview_samples;
    ...;
} rdpi_f32_chain_t;
uint32_t rdpi_f32_chain_digest(const rdpi_f32_chain_params_t *params);
rdpi_status_t rdpi_f32_chain_init(rdpi_f32_chain_t *self, const rdpi_f32_chain_params_t *params,
                                  rdpi_real_t sample_time_s);
void rdpi_f32_chain_settle(rdpi_f32_chain_t *self);
void rdpi_f32_chain_swept(rdpi_f32_chain_t *self, uint32_t ticks);
void rdpi_f32_chain_missed(rdpi_f32_chain_t *self, uint32_t ticks);
void rdpi_batch_chain_step(rdpi_f32_chain_t *self, const rdpi_real_t *ahead_um, size_t samples, rdpi_real_t *drive_V,
                           rdpi_real_t *rate_um_per_s, uint32_t *flags, uint32_t *dac_code);
size_t rdpi_batch_chain_sweep(rdpi_f32_chain_t *self, size_t samples, rdpi_real_t *drive_V, uint32_t *dac_code);

typedef struct {
    int32_t r, slope, slope_rate;
} rdpi_q31_play_t;
typedef struct {
    int32_t d, weight;
} rdpi_q31_deadzone_t;
typedef struct {
    int32_t from_drive, from_x, x_per_drive, drive_per_x;
    uint32_t x_shift, drive_shift;
} rdpi_q31_line_t;
typedef struct {
    uint32_t schema, digest;
    uint64_t slew_per_us, sweep_per_us;
    uint16_t plays;
    uint8_t deadzones, dac_bits, curve_pieces, noise_shaping;
    uint16_t sweep_cycles;
    uint8_t saturation_shift, inverse_shift, code_shift, drive_shift;
    int16_t guard_exponent;
    uint16_t min_slope_ratio;
    uint32_t guard_mantissa, rate_window_ns, rate_filter_ns;
    int32_t min_drive, max_drive, min_x, max_x;
    int32_t min_mV, max_mV;
    uint32_t unit_mantissa;
    int32_t unit_exponent;
    int32_t drive_of_code_0, codes_per_drive, drive_per_code, sweep_end, sweep_forgotten;
    uint32_t min_sample_time_ns, max_sample_time_ns;
    const rdpi_q31_play_t *play;
    const rdpi_q31_deadzone_t *saturation, *inverse_saturation;
    const rdpi_q31_line_t *curve;
    const int32_t *memory;
} rdpi_q31_params_t;
typedef struct {
    int32_t drive, rate;
    uint32_t dac_code, flags, guard_count, clip_count, input_count, missed_count;
    ...;
} rdpi_q31_t;
uint32_t rdpi_q31_digest(const rdpi_q31_params_t *params);
rdpi_status_t rdpi_q31_init(rdpi_q31_t *self, const rdpi_q31_params_t *params, uint32_t sample_time_ns);
void rdpi_q31_reset(rdpi_q31_t *self);
rdpi_status_t rdpi_q31_set_memory(rdpi_q31_t *self, const int32_t *y);
void rdpi_q31_get_memory(const rdpi_q31_t *self, int32_t *y);
void rdpi_q31_missed(rdpi_q31_t *self, uint32_t ticks);
void rdpi_batch_q31_step(rdpi_q31_t *self, const int32_t *reference, size_t samples, int32_t *drive, int32_t *rate,
                         uint32_t *flags, uint32_t *dac_code);
size_t rdpi_batch_q31_sweep(rdpi_q31_t *self, size_t samples, int32_t *drive, uint32_t *dac_code);
void rdpi_batch_q31_predict(const rdpi_q31_t *self, const int32_t *drive, const int32_t *rate, size_t samples,
                            int32_t *displacement);
void rdpi_batch_q31_forward(rdpi_q31_t *self, const int32_t *drive, const int32_t *rate, size_t samples,
                            int32_t *displacement);

typedef struct {
    int32_t share;
    uint64_t time_constant_ns;
} rdpi_q31_pole_t;
typedef struct {
    uint32_t schema, digest;
    uint64_t lead_ns2;
    uint32_t delay_ns, lag_ns, lead_ns;
    int32_t max_lead, direct;
    uint16_t poles, preview;
    const rdpi_q31_params_t *axis;
    const rdpi_q31_pole_t *pole;
} rdpi_q31_chain_params_t;
typedef struct {
    rdpi_q31_t axis;
    uint32_t preview_samples;
    ...;
} rdpi_q31_chain_t;
uint32_t rdpi_q31_chain_digest(const rdpi_q31_chain_params_t *params);
rdpi_status_t rdpi_q31_chain_init(rdpi_q31_chain_t *self, const rdpi_q31_chain_params_t *params,
                                  uint32_t sample_time_ns);
void rdpi_q31_chain_settle(rdpi_q31_chain_t *self);
void rdpi_q31_chain_swept(rdpi_q31_chain_t *self, uint32_t ticks);
void rdpi_q31_chain_missed(rdpi_q31_chain_t *self, uint32_t ticks);
void rdpi_batch_q31_chain_step(rdpi_q31_chain_t *self, const int32_t *ahead, size_t samples, int32_t *drive,
                               int32_t *rate, uint32_t *flags, uint32_t *dac_code);
size_t rdpi_batch_q31_chain_sweep(rdpi_q31_chain_t *self, size_t samples, int32_t *drive, uint32_t *dac_code);
/* cffi-end */
#endif
#endif
