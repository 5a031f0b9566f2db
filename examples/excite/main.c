/* Plays a drive and tells the host what the displacement sensor reads: the recordings that `rdpi fit` identifies an
 * actuator from, made by the board that will drive it. The same file on every port. */
#include "../tick.h"
#include "rdpi_profile.h" /* the drive as DAC codes, made by `rdpi profile DRIVE.csv --dac BITS:MIN_V:MAX_V` */

#if defined(RDPI_PORT_DAC_BITS) && RDPI_PORT_DAC_BITS != RDPI_PROFILE_DAC_BITS
#error "this board's DAC has other bits than the drive: give them to `rdpi profile --dac`"
#endif

static const rdpi_telemetry_run_t run = {
    .min_V = RDPI_PROFILE_MIN_V,
    .max_V = RDPI_PROFILE_MAX_V,
    .um_per_count = EXCITE_UM_PER_COUNT,
    .count_0_um = EXCITE_COUNT_0_UM,
    .rate_hz = RDPI_PROFILE_RATE_HZ,
    .dac_bits = RDPI_PROFILE_DAC_BITS,
    .numbers = RDPI_TELEMETRY_NO_REFERENCE,
};

static const uint32_t swept = RDPI_PROFILE_SWEEP; /* may be 0 */
static uint32_t played;

static bool send_info(void)
{
    return rdpi_telemetry_info(&line, &run, &counts);
}

/* Every code is played: where ticks are lost one is held for longer, and the host is told. */
static bool advance(uint32_t ticks, int32_t adc_counts)
{
    (void)ticks;
    (void)adc_counts;
    if (played == RDPI_PROFILE_COUNT) {
        return false;
    }
    sample.dac_code = rdpi_profile_codes[played];
    sample.flags = played < swept ? RDPI_TELEMETRY_SWEEP : 0u;
    played++;
    return true;
}

int main(void)
{
    if (!start_ticks(RDPI_PROFILE_RATE_HZ, rdpi_profile_codes[0])) {
        return 1;
    }
    while (!finished) {
        rdpi_port_idle();
    }
    return 0;
}
