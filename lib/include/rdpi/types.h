/* rdpi: what the float and the fixed-point library share.
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

/** The layout of rdpi_f32_params_t and rdpi_q31_params_t. Changes when one of them does; init compares. */
#define RDPI_PARAMS_SCHEMA 3u

/** More bits than single precision resolves are refused. */
#define RDPI_MAX_DAC_BITS 20

/* Compile-time maxima: they size the state in RAM, nothing else. Define them for the library and its users alike; init
 * returns RDPI_ERR_SIZE where they differ. */
#ifndef RDPI_MAX_PLAYS
#define RDPI_MAX_PLAYS 16 /**< play operators, n + 1, the identity (r_0 = 0) included */
#endif
#ifndef RDPI_MAX_DEADZONES
#define RDPI_MAX_DEADZONES 8 /**< pieces of the saturation stage, m + 1, the identity (d_0 = 0) included */
#endif
#ifndef RDPI_MAX_WINDOW
#define RDPI_MAX_WINDOW 16 /**< samples spanned by the rate estimator's difference, N */
#endif

#if RDPI_MAX_PLAYS < 1 || RDPI_MAX_DEADZONES < 1 || RDPI_MAX_WINDOW < 1
#error "define RDPI_MAX_PLAYS, RDPI_MAX_DEADZONES and RDPI_MAX_WINDOW as at least 1"
#endif

/** How a state and parameters lie in memory where this is compiled: what decides it, in one number. init compares that
 * of its caller with the library's. */
#define RDPI_LAYOUT(state, params)                                                                                    \
    (((uint64_t)1 << 44) * sizeof(state) + ((uint64_t)1 << 32) * sizeof(params) +                                     \
     ((uint64_t)1 << 16) * RDPI_MAX_PLAYS + RDPI_MAX_WINDOW)

/** After more missed samples than this the rate starts afresh; up to it, they cost one turn of a loop each. */
#define RDPI_MAX_MISSED 16u

/** What init and set_memory return: one value for each way in which their input can be wrong. */
typedef enum {
    RDPI_OK = 0,                /**< done */
    RDPI_ERR_NULL = -1,         /**< a required pointer is NULL */
    RDPI_ERR_SCHEMA = -2,       /**< parameters generated for another version of the library */
    RDPI_ERR_NOT_FINITE = -3,   /**< a number is NaN, infinite or beyond 1e7 */
    RDPI_ERR_COUNT = -4,        /**< plays or dead zones: 0, or above the compile-time maximum */
    RDPI_ERR_GAIN = -5,         /**< gain_um_per_V is 0 */
    RDPI_ERR_THRESHOLDS = -6,   /**< not 0 = r_0 < r_1 < ... < r_n */
    RDPI_ERR_SLOPES = -7,       /**< a slope W_i is not positive at rate 0 (q31: or outside its format) */
    RDPI_ERR_GUARD = -8,        /**< min_slope_ratio not in (0, 1), or some W_i falls below that ratio of its value at
                                     rest (or overflows) within the guard */
    RDPI_ERR_DEADZONES = -9,    /**< not 0 = d_0 < d_1 < ... < d_m */
    RDPI_ERR_SATURATION = -10,  /**< a piece of the saturation stage has a slope that is not positive (q31: or its
                                     weights are outside their format) */
    RDPI_ERR_SAMPLE_TIME = -11, /**< the sample time is not positive, or out of range */
    RDPI_ERR_RATE = -12,        /**< rate window or filter time negative, or guard rate not positive */
    RDPI_ERR_WINDOW = -13,      /**< the rate window spans more than RDPI_MAX_WINDOW samples */
    RDPI_ERR_DRIVE = -14,       /**< not min < max (by 1 nV), slew negative or too many DAC bits (q31: or steps of codes
                                     that do not fit the range) */
    RDPI_ERR_MEMORY = -15,      /**< the plays' states cannot come from one history, or lie outside the drive range */
    RDPI_ERR_SWEEP = -16,       /**< start-up sweep: not 1 to 10000 cycles, end outside the range, speed above the slew
                                     limit or too slow for one sample's share to survive rounding */
    RDPI_ERR_DIGEST = -17,      /**< the parameters are not those that were generated: flash or file damaged, or
                                     generated for another RDPI_REAL */
    RDPI_ERR_SIZE = -18         /**< the caller was compiled with other maxima (RDPI_MAX_PLAYS, RDPI_MAX_WINDOW), another
                                     RDPI_REAL or other alignment than the library */
} rdpi_status_t;

/** What happened in the latest step; the bits are OR-ed. */
enum {
    RDPI_FLAG_GUARD = 1u,  /**< the rate was above the guard and was clamped to it */
    RDPI_FLAG_RANGE = 2u,  /**< the drive was clipped to its range */
    RDPI_FLAG_SLEW = 4u,   /**< the drive was clipped to what the slew limit allows in one sample */
    RDPI_FLAG_INPUT = 8u,  /**< the input was not usable; the last drive was held and no state changed */
    RDPI_FLAG_MISSED = 16u /**< samples were missed or refused before this one; its rate counts the time they took,
                                up to RDPI_MAX_MISSED of them */
};

/** A status as a short English sentence; never NULL. Any context. */
const char *rdpi_status_text(rdpi_status_t status);

#ifdef __cplusplus
}
#endif
#endif
