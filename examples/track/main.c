/* Makes actuators follow references: start-up sweep, then the reference to its end, every sample told to the host. In
 * open loop or, with TRACK_LOOP, with a PI controller around it. The same file on every port; see port/README.md. An
 * actuator and its reference are an axis: axis.c. */
#include "../tick.h"
#include "axis.h"

#if RDPI_PORT_STDERR /* a board that is a computer */
#include <stdio.h>
#define SAY(...) ((void)fprintf(stderr, __VA_ARGS__))
#else
#define SAY(...) ((void)0)
#endif

#define DECLARE(number) extern const track_axis_t track_axis_##number;
#define ADDRESS(number) &track_axis_##number,
RDPI_EACH_AXIS(DECLARE)
static const track_axis_t *const axes[] = {RDPI_EACH_AXIS(ADDRESS)};

#define BIT(number) | 1u << (number)
static uint32_t sweeping = TRACK_SWEEP ? 0u RDPI_EACH_AXIS(BIT) : 0u; /* a bit for each axis */

static bool send_info(uint32_t axis)
{
    axes[axis]->count(&counts);
    return rdpi_telemetry_info(&line[axis], axes[axis]->run, &counts);
}

/* An axis whose sweep is at its end waits for the others: their references begin together. */
static void sweep(void)
{
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        sample[k].flags = RDPI_TELEMETRY_SWEEP;
        if ((sweeping >> k & 1u) != 0u && !axes[k]->sweep(&sample[k])) {
            sweeping &= ~(1u << k);
        }
    }
}

/* An axis whose reference is at its end holds its code until all are. */
static bool advance(uint32_t ticks, const int32_t *adc_counts)
{
    uint32_t codes[RDPI_AXES];
    bool any = false;
    if (sweeping != 0u) {
        sweep();
        return true;
    }
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        codes[k] = sample[k].dac_code;
    }
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        sample[k].flags = 0;
        any = axes[k]->advance(ticks, adc_counts[k], codes, &sample[k]) || any;
    }
    return any;
}

/* False, and the host is told, if an axis refuses its parameters: the DAC stays at the safe code of the board's
 * start-up. */
static bool init_axes(void)
{
    bool good = true;
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        rdpi_status_t status = axes[k]->init(&sample[k]);
        for (uint32_t other = 0; other < RDPI_AXES; other++) {
            if (other != k) {
                axes[k]->couple(other, axes[other]->run);
            }
        }
        if (status != RDPI_OK) {
            good = false;
            counts.state = RDPI_TELEMETRY_REFUSED;
            counts.status = (int8_t)status;
            (void)send_info(k);
            SAY("track: axis %lu: %s\n", (unsigned long)k, rdpi_status_text(status));
        }
    }
    return good;
}

int main(void)
{
    if (!init_axes()) {
        return 1;
    }
    if (!start_ticks(TRACK_RATE_HZ)) {
        SAY("track: this board has no timer of that rate\n");
        return 1;
    }
    while (!finished) {
        rdpi_port_idle();
    }
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        axes[k]->count(&counts);
        SAY("track: rate clamped %lu times, drive or lead clipped %lu, reference refused %lu, ticks lost %lu\n",
            (unsigned long)counts.guard_count, (unsigned long)counts.clip_count, (unsigned long)counts.input_count,
            (unsigned long)rdpi_port_overruns());
    }
    return 0;
}
