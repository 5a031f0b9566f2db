/* Makes an actuator follow a reference in open loop. The same file on every port; see port/README.md. */
#include <stdio.h>

#include "rdpi/rdpi.h"
#include "rdpi_params.h" /* the actuator, made by `rdpi header` */
#include "rdpi_port.h"   /* the board */

#if RDPI_PARAMS_DAC_BITS == 0
#error "the actuator's model has no DAC: set drive.dac_bits, with `rdpi fit --dac-bits` or in the model file"
#endif

static rdpi_f32_t axis;

/* The timer interrupt. */
static void tick(void)
{
    rdpi_f32_step(&axis, rdpi_port_reference_um());
    rdpi_port_write_dac(axis.dac_code);
}

int main(void)
{
    rdpi_status_t status = rdpi_f32_init(&axis, &rdpi_params, 1.0f / TRACK_RATE_HZ);
    if (status != RDPI_OK) {
        fprintf(stderr, "track: %s\n", rdpi_status_text(status));
        return 1;
    }
    rdpi_port_write_dac(axis.dac_code); /* the drive at which the model's memory begins */
    if (!rdpi_port_start(TRACK_RATE_HZ, tick)) {
        fprintf(stderr, "track: this board has no timer at %d Hz\n", TRACK_RATE_HZ);
        return 1;
    }
    while (rdpi_port_idle()) {
    }
    fprintf(stderr, "track: rate clamped %lu times, drive clipped %lu, reference refused %lu, ticks lost %lu\n",
            (unsigned long)axis.guard_count, (unsigned long)axis.clip_count, (unsigned long)axis.input_count,
            (unsigned long)rdpi_port_overruns());
    return 0;
}
