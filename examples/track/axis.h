/* Between main.c and the axes. */
#ifndef TRACK_AXIS_H
#define TRACK_AXIS_H

#include "rdpi/types.h"
#include "telemetry.h"

/* What the application asks of an axis. */
typedef struct {
    const rdpi_telemetry_run_t *run; /* its constants */

    /* First of all. The sample gets the code of the drive at which the model's memory begins. */
    rdpi_status_t (*init)(rdpi_telemetry_sample_t *sample);

    /* Tells it of another axis, which may move it; NULL if there is none. */
    void (*couple)(uint32_t axis, const rdpi_telemetry_run_t *of);

    /* The next sample of the start-up sweep. False when it was the last. */
    bool (*sweep)(rdpi_telemetry_sample_t *sample);

    /* The next sample of the reference, `ticks` after the one before. `adc_counts` belongs to the code before; `codes`
     * are those that all axes output then. False, and the sample stays, when the reference is at its end. */
    bool (*advance)(uint32_t ticks, int32_t adc_counts, const uint32_t *codes, rdpi_telemetry_sample_t *sample);

    void (*count)(rdpi_telemetry_counts_t *counts); /* puts the axis' own into them */
} track_axis_t;

#endif
