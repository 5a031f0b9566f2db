#include "rdpi/types.h"

const char *rdpi_status_text(rdpi_status_t status)
{
    switch (status) {
    case RDPI_OK:
        return "ok";
    case RDPI_ERR_NULL:
        return "a required pointer is NULL";
    case RDPI_ERR_SCHEMA:
        return "parameters of another schema: generate the header again";
    case RDPI_ERR_NOT_FINITE:
        return "a number is NaN, infinite or beyond 1e7";
    case RDPI_ERR_COUNT:
        return "number of plays or dead zones is 0 or above the compile-time maximum, or number of poles is above it";
    case RDPI_ERR_GAIN:
        return "gain_um_per_V is 0";
    case RDPI_ERR_THRESHOLDS:
        return "thresholds_um must start at 0 and increase";
    case RDPI_ERR_SLOPES:
        return "a slope is not positive, or outside its format";
    case RDPI_ERR_GUARD:
        return "min_slope_ratio not in (0, 1), or a slope falls below that ratio before max_um_per_s";
    case RDPI_ERR_DEADZONES:
        return "deadzones_um must start at 0 and increase";
    case RDPI_ERR_SATURATION:
        return "a piece of the saturation stage has no positive slope, or weights are outside their format";
    case RDPI_ERR_SAMPLE_TIME:
        return "sample time must be positive and within range";
    case RDPI_ERR_RATE:
        return "rate window, filter time or max_um_per_s out of range";
    case RDPI_ERR_WINDOW:
        return "rate window spans more samples than RDPI_MAX_WINDOW";
    case RDPI_ERR_DRIVE:
        return "drive limits: need min < max, slew not negative, at most 20 dac_bits, codes that fit, noise shaping compiled in";
    case RDPI_ERR_MEMORY:
        return "memory is not a state one history can leave inside the drive range";
    case RDPI_ERR_SWEEP:
        return "start-up sweep: needs 1 to 10000 cycles, an end in range, a speed within the slew and not too slow";
    case RDPI_ERR_DIGEST:
        return "parameters differ from those generated, or are of another number type: generate or flash them again";
    case RDPI_ERR_SIZE:
        return "library and application were compiled with different maxima (RDPI_MAX_...) or number type";
    case RDPI_ERR_CHAIN:
        return "chain: a number is outside its range, the delay is too long, or creep cannot be inverted";
    case RDPI_ERR_CURVE:
        return "input curve: at most RDPI_MAX_CURVE_PIECES pieces in order, no gaps, all rising or falling, ends at codes";
    case RDPI_ERR_SAMPLE_RANGE:
        return "sample time is outside the range of the parameters: wrong unit, or generate them for a slower or faster sweep";
    case RDPI_ERR_STATE:
        return "the state is torn or damaged, or belongs to other parameters or another sample time";
    case RDPI_ERR_MODE:
        return "the axis does not take this call in its present mode";
    }
    return "unknown status";
}
