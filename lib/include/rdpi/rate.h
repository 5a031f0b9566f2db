/* The rate estimator: a difference over a time window, then a first-order low-pass. Both are configured in seconds, so
 * that one parameter set serves any interrupt rate.
 *
 *   rho_k = |z_k - z_(k-N)| / (N T),  N = max(1, round(window_s / T)),  z_0 in place of samples before the first
 *   low-pass: rho'_k = rho'_(k-1) + (1 - exp(-T / filter_s)) (rho_k - rho'_(k-1)),  rho'_0 = 0;  none if filter_s = 0 */
#ifndef RDPI_RATE_H
#define RDPI_RATE_H

#include "rdpi/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Caller's memory; the fields are private. */
typedef struct {
    rdpi_real_t z_um[RDPI_MAX_WINDOW]; /* ring of the latest N samples, the oldest at `oldest` */
    rdpi_real_t per_window_s;          /* 1 / (N T) */
    rdpi_real_t blend;                 /* 1 - exp(-T / filter_s); 1 without filter */
    rdpi_real_t filtered_um_per_s;
    uint16_t window; /* N */
    uint16_t oldest;
    bool started;
} rdpi_f32_rate_t;

/* Sets up `rate` for samples `sample_time_s` apart, no sample seen yet. Returns RDPI_OK, RDPI_ERR_SAMPLE_TIME unless
 * sample_time_s > 0 is finite and long enough for finite rates, RDPI_ERR_RATE unless window_s >= 0 and filter_s >= 0 are
 * finite, or RDPI_ERR_WINDOW iff N > RDPI_MAX_WINDOW.
 * Not for an ISR: it calls expm1. */
rdpi_status_t rdpi_f32_rate_init(rdpi_f32_rate_t *rate, rdpi_real_t window_s, rdpi_real_t filter_s,
                                 rdpi_real_t sample_time_s);

/* Forgets the samples seen. O(1). */
void rdpi_f32_rate_reset(rdpi_f32_rate_t *rate);

/* Takes the sample `z_um` and returns the rate in um/s, >= 0. O(1), the first sample O(N). ISR safe, re-entrant.
 * |z_um| <= 2 RDPI_MAX_REFERENCE_UM. */
rdpi_real_t rdpi_f32_rate_step(rdpi_f32_rate_t *rate, rdpi_real_t z_um);

#ifdef __cplusplus
}
#endif
#endif
