/* One axis of excite: its drive, in flash. The build compiles this file once for each axis, with its header. */
#include "axis.h"
#include "rdpi_port.h"
#include "rdpi_profile.h" /* the drive as DAC codes, made by `rdpi profile DRIVE.csv --dac BITS:MIN_V:MAX_V` */
#include "rdpi_reference.h" /* the names of an axis */

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

const excite_axis_t RDPI_AXIS_NAME(excite_axis) = {&run, rdpi_profile_codes, RDPI_PROFILE_COUNT, RDPI_PROFILE_SWEEP};
