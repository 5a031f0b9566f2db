/* Plays drives and tells the host what the displacement sensors read: the recordings that `rdpi fit` identifies
 * actuators from, made by the board that will drive them. The same file on every port. An actuator and its drive are an
 * axis: axis.c. */
#include "../tick.h"
#include "axis.h"

#define DECLARE(number) extern const excite_axis_t excite_axis_##number;
#define ADDRESS(number) &excite_axis_##number,
RDPI_EACH_AXIS(DECLARE)
static const excite_axis_t *const axes[] = {RDPI_EACH_AXIS(ADDRESS)};

static uint32_t played;

static bool send_info(uint32_t axis)
{
    return rdpi_telemetry_info(&line[axis], axes[axis]->run, &counts);
}

/* Every code is played: where ticks are lost one is held for longer, and the host is told. An axis whose drive is at its
 * end holds the last code until all are. */
static bool advance(uint32_t ticks, const int32_t *adc_counts)
{
    bool any = false;
    (void)ticks;
    (void)adc_counts;
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        sample[k].flags = 0;
        if (played < axes[k]->count) {
            sample[k].dac_code = axes[k]->codes[played];
            sample[k].flags = played < axes[k]->swept ? RDPI_TELEMETRY_SWEEP : 0u;
            any = true;
        }
    }
    played += any;
    return any;
}

/* All axes share the timer. */
static bool same_rates(void)
{
    for (uint32_t k = 1; k < RDPI_AXES; k++) {
        if (axes[k]->run->rate_hz != axes[0]->run->rate_hz) {
            counts.state = RDPI_TELEMETRY_REFUSED; /* with status ok: no timer of that rate */
            (void)send_info(k);
            return false;
        }
    }
    return true;
}

int main(void)
{
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        sample[k].dac_code = axes[k]->codes[0];
    }
    if (!same_rates() || !start_ticks(axes[0]->run->rate_hz)) {
        return 1;
    }
    while (!finished) {
        rdpi_port_idle();
    }
    return 0;
}
