/* rdpi: what the library in single precision and the library in fixed point share.
 *
 * Names end in their unit: _um is micrometres of displacement, _V is volts at the actuator, _s is seconds, and _per_ is
 * a quotient. Nothing here allocates, prints or keeps a static variable. */
#ifndef RDPI_TYPES_H
#define RDPI_TYPES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define RDPI_VERSION_MAJOR 0 /**< the version of the library */
#define RDPI_VERSION_MINOR 1 /**< see RDPI_VERSION_MAJOR */
#define RDPI_VERSION_PATCH 0 /**< see RDPI_VERSION_MAJOR */
#define RDPI_VERSION "0.1.0" /**< the same as text */

/** The version of the layout of rdpi_f32_params_t and rdpi_q31_params_t. It changes whenever one of the layouts does.
 * init refuses parameters of another version. */
#define RDPI_PARAMS_SCHEMA 8u

/** The most bits of a DAC. init refuses more, because single precision does not resolve more. */
#define RDPI_MAX_DAC_BITS 20

/* Compile-time maxima. Define them the same for the library and for the code that uses it. RDPI_MAX_PLAYS and
 * RDPI_MAX_WINDOW set the size of the state in RAM, RDPI_MAX_POLES that of the state of a chain; init returns
 * RDPI_ERR_SIZE if they differ. RDPI_MAX_CURVE_PIECES 1 leaves the input curve out of code and state: the drive is then
 * proportional to x, but for an offset. RDPI_NOISE_SHAPING 0 leaves noise shaping out of code and state. init returns
 * RDPI_ERR_SIZE if only one side leaves one of them out. RDPI_MAX_DEADZONES and other numbers of pieces only limit what
 * init accepts. */
#ifndef RDPI_MAX_PLAYS
#define RDPI_MAX_PLAYS 16 /**< most play operators: n + 1, the identity (r_0 = 0) included */
#endif
#ifndef RDPI_MAX_DEADZONES
#define RDPI_MAX_DEADZONES 8 /**< most pieces of the saturation stage: m + 1, up to 255, the identity (d_0 = 0)
                                  included */
#endif
#ifndef RDPI_MAX_WINDOW
#define RDPI_MAX_WINDOW 16 /**< most samples in the window of the rate estimator: N */
#endif
#ifndef RDPI_MAX_POLES
#define RDPI_MAX_POLES 12 /**< most poles of creep and relaxation in a chain, up to 64 */
#endif

#ifndef RDPI_MAX_CURVE_PIECES
#define RDPI_MAX_CURVE_PIECES 8 /**< most straight pieces of the input curve, up to 255; 1: the curve is left out */
#endif
#ifndef RDPI_NOISE_SHAPING
#define RDPI_NOISE_SHAPING 1 /**< 1: parameters may ask for noise shaping; 0: it is left out */
#endif

#if RDPI_MAX_PLAYS < 1 || RDPI_MAX_DEADZONES < 1 || RDPI_MAX_WINDOW < 1 || RDPI_MAX_POLES < 1
#error "define RDPI_MAX_PLAYS, RDPI_MAX_DEADZONES, RDPI_MAX_WINDOW and RDPI_MAX_POLES as at least 1"
#endif
#if RDPI_MAX_DEADZONES > 255
#error "define RDPI_MAX_DEADZONES as at most 255"
#endif
#if RDPI_MAX_POLES > 64
#error "define RDPI_MAX_POLES as at most 64"
#endif
#if RDPI_NOISE_SHAPING != 0 && RDPI_NOISE_SHAPING != 1
#error "define RDPI_NOISE_SHAPING as 0 or 1"
#endif
#if RDPI_MAX_CURVE_PIECES < 1 || RDPI_MAX_CURVE_PIECES > 255
#error "define RDPI_MAX_CURVE_PIECES as at least 1 and at most 255"
#endif

/** The layout of a state and of parameters in memory, as one number made of all that decides it. init compares the
 * number of its caller with the number of the library. */
#define RDPI_LAYOUT(state, params)                                                                                    \
    (((uint64_t)1 << 44) * sizeof(state) + ((uint64_t)1 << 32) * sizeof(params) +                                     \
     ((uint64_t)1 << 43) * (RDPI_MAX_CURVE_PIECES > 1) + ((uint64_t)1 << 42) * RDPI_NOISE_SHAPING +                    \
     ((uint64_t)1 << 16) * RDPI_MAX_PLAYS + RDPI_MAX_WINDOW)

/** The most missed samples that the rate still takes into account. Each of them costs one turn of a loop. After more,
 * the rate starts again from 0. */
#define RDPI_MAX_MISSED 16u

/** What init and set_memory return. Each kind of wrong input has a value of its own. */
typedef enum {
    RDPI_OK = 0,                /**< done */
    RDPI_ERR_NULL = -1,         /**< a required pointer is NULL */
    RDPI_ERR_SCHEMA = -2,       /**< the parameters were generated for another version of the library */
    RDPI_ERR_NOT_FINITE = -3,   /**< a number is NaN, infinite or beyond 1e7 */
    RDPI_ERR_COUNT = -4,        /**< the number of plays or dead zones is 0 or above the compile-time maximum, or the
                                     number of poles is above it */
    RDPI_ERR_GAIN = -5,         /**< a gain_um_per_V is 0 */
    RDPI_ERR_THRESHOLDS = -6,   /**< the thresholds of the plays are not 0 = r_0 < r_1 < ... < r_n */
    RDPI_ERR_SLOPES = -7,       /**< a slope W_i is not positive at rate 0 (q31: or outside its format) */
    RDPI_ERR_GUARD = -8,        /**< min_slope_ratio is not in (0, 1), or at a rate within the guard some W_i is below
                                     that ratio of its value at rest (or overflows) */
    RDPI_ERR_DEADZONES = -9,    /**< the thresholds of the dead zones are not 0 = d_0 < d_1 < ... < d_m */
    RDPI_ERR_SATURATION = -10,  /**< a piece of the saturation stage has a slope that is not positive (q31: or its
                                     weights are outside their format) */
    RDPI_ERR_SAMPLE_TIME = -11, /**< the sample time is not positive, or out of range */
    RDPI_ERR_RATE = -12,        /**< the rate window or the filter time is negative, or the rate of the guard is not
                                     positive */
    RDPI_ERR_WINDOW = -13,      /**< the rate window spans more than RDPI_MAX_WINDOW samples */
    RDPI_ERR_DRIVE = -14,       /**< min is not below max (f32: by 1 nV), the slew limit is negative, there are too many
                                     DAC bits (q31: or the steps of the codes do not fit the range), or noise_shaping is
                                     above RDPI_NOISE_SHAPING */
    RDPI_ERR_MEMORY = -15,      /**< no single history leads to these states, or their drive is outside its range */
    RDPI_ERR_SWEEP = -16,       /**< the start-up sweep does not have 1 to 10000 cycles, ends outside the range, is
                                     faster than the slew limit, or is so slow that rounding swallows the change of one
                                     sample */
    RDPI_ERR_DIGEST = -17,      /**< the parameters are not those that were generated: the flash or the file is damaged,
                                     or they were generated for another RDPI_REAL */
    RDPI_ERR_SIZE = -18,        /**< the caller was compiled with other maxima (RDPI_MAX_PLAYS, RDPI_MAX_WINDOW; of a
                                     chain, RDPI_MAX_POLES), another RDPI_REAL or another alignment than the library, or
                                     only one of them without the input curve (RDPI_MAX_CURVE_PIECES 1) or without
                                     noise shaping (RDPI_NOISE_SHAPING 0) */
    RDPI_ERR_CHAIN = -19,       /**< a number of the chain is outside what its field says, or its delay is longer than
                                     2^24 samples */
    RDPI_ERR_CURVE = -20,       /**< the input curve does not have 1 to RDPI_MAX_CURVE_PIECES pieces, or these are out of
                                     order, leave a gap, do not all rise or all fall, or do not end at codes */
    RDPI_ERR_SAMPLE_RANGE = -21, /**< the sample time is outside the range of the parameters, min_sample_time to
                                     max_sample_time: is it in s (q31: in ns)? The macro RDPI_ANY_SAMPLE_TIME leaves
                                     this check out */
    RDPI_ERR_STATE = -22,       /**< the state of a chain is torn or damaged, or belongs to other parameters or another
                                     sample time */
    RDPI_ERR_MODE = -23         /**< the axis does not take this call in its present mode: see rdpi/f32_axis.h */
} rdpi_status_t;

/** The caller must look at the result. */
#if defined(__GNUC__)
#define RDPI_MUST_CHECK __attribute__((warn_unused_result))
#else
#define RDPI_MUST_CHECK
#endif

/** What an axis does: see rdpi/f32_axis.h. */
typedef enum {
    RDPI_AXIS_OFF = 0, /**< init has not accepted it: the output is what it was before */
    RDPI_AXIS_STOPPED, /**< the drive is held */
    RDPI_AXIS_SWEEP,   /**< the start-up sweep */
    RDPI_AXIS_RAMP,    /**< on the way to the reference, or to the drive of a stop, at a limited speed */
    RDPI_AXIS_RUN,     /**< follows the reference */
    RDPI_AXIS_MANUAL,  /**< another source drives the actuator; the chain follows it */
    RDPI_AXIS_FAULT    /**< the drive is held; only a start with its sweep leads back to RUN */
} rdpi_axis_mode_t;

/** What happened in the latest step. The bits are OR-ed. */
enum {
    RDPI_FLAG_GUARD = 1u,  /**< the rate was above the guard and was clamped to it */
    RDPI_FLAG_RANGE = 2u,  /**< the drive was clipped to its range */
    RDPI_FLAG_SLEW = 4u,   /**< the drive was clipped to what the slew limit allows in one sample */
    RDPI_FLAG_INPUT = 8u,  /**< the input was not usable: the last drive was held and no state changed */
    RDPI_FLAG_MISSED = 16u, /**< samples were missed or refused before this one. Its rate counts their time, for up to
                                 RDPI_MAX_MISSED samples */
    RDPI_FLAG_LEAD = 32u /**< of a chain: the lead would have added more than max_lead, or lag^-1 more than range and slew
                              allow, and was clipped; counted in clip_count */
};

/** A status as a short English sentence, never NULL. Callable from any context. */
const char *rdpi_status_text(rdpi_status_t status);

#ifdef __cplusplus
}
#endif
#endif
