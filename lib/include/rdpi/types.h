/* rdpi: types shared by every block of the chain.
 *
 * Units are in the names: _um micrometres of displacement, _V volts at the actuator, _s seconds, _per_ a quotient.
 * Nothing here allocates, prints or keeps a static variable. */
#ifndef RDPI_TYPES_H
#define RDPI_TYPES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The number type of the rdpi_f32 functions. The host tools and the tests compile the same sources a second time with
 * RDPI_REAL=double: same equations, one place. Firmware leaves it alone. */
#ifndef RDPI_REAL
#define RDPI_REAL float
#endif
typedef RDPI_REAL rdpi_real_t;

/* A reference beyond this magnitude is refused like one that is not finite. */
#define RDPI_MAX_REFERENCE_UM 1000000

/* More bits than single precision resolves are refused. */
#define RDPI_MAX_DAC_BITS 20

/* Compile-time maxima: they size the state in RAM, nothing else. Define them for the library and its users alike. */
#ifndef RDPI_MAX_PLAYS
#define RDPI_MAX_PLAYS 16 /* play operators, n + 1, the identity (r_0 = 0) included */
#endif
#ifndef RDPI_MAX_DEADZONES
#define RDPI_MAX_DEADZONES 8 /* pieces of the saturation stage, m + 1, the identity (d_0 = 0) included */
#endif
#ifndef RDPI_MAX_WINDOW
#define RDPI_MAX_WINDOW 16 /* samples spanned by the rate estimator's difference, N */
#endif

/* What rdpi_f32_init and rdpi_f32_set_memory return: one value for each way in which the input can be wrong. */
typedef enum {
    RDPI_OK = 0,
    RDPI_ERR_NULL = -1,         /* a required pointer is NULL */
    RDPI_ERR_SCHEMA = -2,       /* parameters generated for another version of rdpi_f32_params_t */
    RDPI_ERR_NOT_FINITE = -3,   /* a parameter is NaN or infinite */
    RDPI_ERR_COUNT = -4,        /* plays or dead zones: 0, or above the compile-time maximum */
    RDPI_ERR_GAIN = -5,         /* gain_um_per_V is 0 */
    RDPI_ERR_THRESHOLDS = -6,   /* not 0 = r_0 < r_1 < ... < r_n */
    RDPI_ERR_SLOPES = -7,       /* a slope W_i is not positive at rate 0 */
    RDPI_ERR_GUARD = -8,        /* min_slope_ratio not in (0, 1), or some W_i falls below that ratio of its value at rest
                                   (or overflows) within [0, max_um_per_s] */
    RDPI_ERR_DEADZONES = -9,    /* not 0 = d_0 < d_1 < ... < d_m */
    RDPI_ERR_SATURATION = -10,  /* a piece of the saturation stage has a slope that is not positive: no inverse */
    RDPI_ERR_SAMPLE_TIME = -11, /* the sample time is not positive and finite, or so short that rates overflow */
    RDPI_ERR_RATE = -12,        /* rate window or filter time negative or not finite, or guard rate not positive */
    RDPI_ERR_WINDOW = -13,      /* the rate window spans more than RDPI_MAX_WINDOW samples */
    RDPI_ERR_DRIVE = -14,       /* not min_V < max_V a finite span apart, slew negative or too slow for one sample's share
                                   to survive rounding, or too many dac_bits */
    RDPI_ERR_MEMORY = -15       /* the plays' states cannot come from one history, or lie outside the drive range */
} rdpi_status_t;

/* What happened in the latest step; the bits are OR-ed. */
enum {
    RDPI_FLAG_GUARD = 1u, /* the rate was above max_um_per_s and was clamped to it */
    RDPI_FLAG_RANGE = 2u, /* the drive was clipped to [min_V, max_V] */
    RDPI_FLAG_SLEW = 4u,  /* the drive was clipped to what slew_V_per_s allows in one sample */
    RDPI_FLAG_INPUT = 8u  /* the reference was not usable; the last drive was held and no state changed */
};

/* A status as a short English sentence; never NULL. Any context. */
const char *rdpi_status_text(rdpi_status_t status);

#ifdef __cplusplus
}
#endif
#endif
