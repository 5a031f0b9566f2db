/** @file
 * The library in 32-bit integers, for cores without floating point. It has the functions of rdpi/f32.h, and gives the
 * same bits on every machine. It uses no floating point, no libm and no heap. init divides 64 bits by 32, the sweep
 * 64 bits by 16. The step divides 32 bits, and by 17 at most:
 *
 * - With a rate window of several samples or a low-pass, each step divides once, and once more per missed sample.
 * - Otherwise the first step divides once, and so does a step after missed samples. Others do not divide.
 * - On cores that multiply to 32 bits only, such as Cortex-M0, no step divides.
 *
 *     static rdpi_q31_t axis;
 *     rdpi_q31_init(&axis, &rdpi_params_q31, 100000);  // once, sample time in ns; the header comes from `rdpi header`
 *     rdpi_q31_step(&axis, reference);                 // in the timer interrupt; output axis.dac_code
 *
 * The host chooses the scaling, and the header carries it:
 *
 *   reference      displacement = offset_um + reference * um_per_reference; the reach of the actuator is about +-2^30
 *   drive          V = offset_V + drive * V_per_drive; |drive| <= RDPI_Q31_MAX_DRIVE = 2^29. Where the gain is negative
 *                  so is V_per_drive.
 *   x, y, r        the operator's input, states and thresholds, <= RDPI_Q31_MAX_DRIVE. Where the input curve is
 *                  straight, the drive is x itself; else x rises with the drive.
 *   slope          the largest W_i at rest or at the guard is RDPI_Q31_ONE = 2^30, the smallest >= 2^24
 *   rate           RDPI_Q31_ONE is the guard
 *   v              bank output, x times slope over 2^30
 *
 * Scaling and overflow, all functions: sums of products are carried in 64 bits, of which 63 are used. A result that
 * leaves its format saturates. Nothing wraps, for any parameters that init accepts and for any input.
 *
 * Cost classes and contexts are those of rdpi/f32.h. */
#ifndef RDPI_Q31_H
#define RDPI_Q31_H

#include "rdpi/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Slope 1, and the rate of the guard. */
#define RDPI_Q31_ONE ((int32_t)1 << 30)

/** The largest magnitude of drives, play states and thresholds. It leaves two guard bits for sums and differences. */
#define RDPI_Q31_MAX_DRIVE ((int32_t)1 << 29)

/** The smallest slope at rest or at the guard. Below it, the quotient would lose the accuracy that the step
 * promises. */
#define RDPI_Q31_MIN_SLOPE ((int32_t)1 << 24)

/** In place of a reference: there is no reference. It is to rdpi_q31_step what NaN is to rdpi_f32_step. */
#define RDPI_Q31_NO_REFERENCE INT32_MIN

/** One play operator and its piece of the loading curve. Equation numbers are those of Ang et al., IROS 2003; here they
 * are eq. 1, 14 and 15. */
typedef struct {
    int32_t r;          /**< threshold r_i, drive units; 0 = r_0 < r_1 < ... */
    int32_t slope;      /**< W_i at rate 0 */
    int32_t slope_rate; /**< W_i at the guard less W_i at rate 0 */
} rdpi_q31_play_t;

/** One term of the saturation stage or of its inverse: weight max(v - d, 0) / 2^shift for d > 0 (eq. 7), and weight v /
 * 2^shift for d = 0. All terms of a stage have the same shift. */
typedef struct {
    int32_t d;      /**< threshold; 0 = d_0 < d_1 < ... */
    int32_t weight; /**< ws_j; the magnitudes of a stage add up to 2^31 at most */
} rdpi_q31_deadzone_t;

/** One straight piece of the input curve, from the drive to x and back. It ends where the next one begins. Beyond the
 * ends of the table, the first or the last piece goes on. */
typedef struct {
    int32_t from_drive;  /**< the lowest drive on it; of the first piece, min_drive */
    int32_t from_x;      /**< x there */
    int32_t x_per_drive; /**< its slope, times 2^x_shift, > 0 */
    int32_t drive_per_x; /**< the inverse, times 2^drive_shift */
    uint32_t x_shift;     /**< 1 .. 62 */
    uint32_t drive_shift; /**< 1 .. 62 */
} rdpi_q31_line_t;

/** One identified actuator, as `rdpi header` generates it. The arrays that it points to must outlive the instance. */
typedef struct {
    uint32_t schema;            /**< RDPI_PARAMS_SCHEMA */
    uint32_t digest;            /**< rdpi_q31_digest of the rest */
    uint64_t slew_per_us;       /**< largest slope of the output, drive units per us times 2^32, at least sweep_per_us;
                                     0: unlimited */
    uint64_t sweep_per_us;      /**< slope of the start-up sweep, in the same unit, > 0 */
    uint16_t plays;             /**< n + 1, 1 .. RDPI_MAX_PLAYS */
    uint8_t deadzones;          /**< m + 1, 1 .. RDPI_MAX_DEADZONES */
    uint8_t dac_bits;           /**< codes 0 .. 2^bits - 1 span the range; <= RDPI_MAX_DAC_BITS; 0: no codes */
    uint8_t curve_pieces;       /**< 1 .. RDPI_MAX_CURVE_PIECES; 1: the input curve is straight, and the drive is x */
    uint8_t noise_shaping;      /**< see rdpi/f32.h */
    uint16_t sweep_cycles;      /**< cycles of the start-up sweep, > 0 */
    uint8_t saturation_shift;   /**< shift of the weights of S, 0 .. 62 */
    uint8_t inverse_shift;      /**< shift of the weights of S^-1, 0 .. 62 */
    uint8_t code_shift;         /**< shift of codes_per_drive, 1 .. 62 */
    uint8_t drive_shift;        /**< shift of drive_per_code, 1 .. 62 */
    int16_t guard_exponent;     /**< the guard is guard_mantissa 2^guard_exponent reference units per ns */
    uint16_t min_slope_ratio;   /**< every i must have W_i(guard) >= ratio / 65536 W_i(0); 0 < ratio < 65536 */
    uint32_t guard_mantissa;    /**< >= 2^31 */
    uint32_t rate_window_ns;    /**< see rate_window_s in rdpi/f32.h */
    uint32_t rate_filter_ns;    /**< see rate_filter_s */
    int32_t min_drive;          /**< lower end of the output range */
    int32_t max_drive;          /**< upper end of the output range */
    int32_t min_x;              /**< x at min_drive */
    int32_t max_x;              /**< x at max_drive */
    int32_t min_mV;             /**< min_V and max_V of the model, in mV: what the units stand for, for an exchange of ... */
    int32_t max_mV;             /**< ... parameters: see rdpi_q31_chain_inherit */
    uint32_t unit_mantissa;     /**< >= 2^31; a reference unit is unit_mantissa 2^unit_exponent um */
    int32_t unit_exponent;      /**< see unit_mantissa */
    int32_t drive_of_code_0;    /**< at min_V: min_drive, or max_drive where the gain is negative */
    int32_t codes_per_drive;    /**< codes per drive unit, times 2^code_shift; has the sign of the gain */
    int32_t drive_per_code;     /**< its inverse, times 2^drive_shift */
    int32_t sweep_end;          /**< the drive at which the start-up sweep ends */
    int32_t sweep_forgotten;    /**< see sweep_forgotten in rdpi/f32.h; times 2^30 */
    uint32_t min_sample_time_ns; /**< see min_sample_time_s in rdpi/f32.h */
    uint32_t max_sample_time_ns; /**< see max_sample_time_s; 0: unlimited */
    const rdpi_q31_play_t *play;                   /**< [plays] */
    const rdpi_q31_deadzone_t *saturation;         /**< [deadzones], S (eq. 8), from v to reference units */
    const rdpi_q31_deadzone_t *inverse_saturation; /**< [deadzones], S^-1 (eq. 13), from reference units to v */
    const rdpi_q31_line_t *curve;                  /**< [curve_pieces], the input curve; not read if it is straight */
    const int32_t *memory; /**< [plays], the states of the plays at power up; memory[0] is x */
} rdpi_q31_params_t;

/** Private part of rdpi_q31_t: the plays. */
typedef struct {
    int64_t f_at_rest;     /**< output at rate 0, times 2^30; exact */
    int64_t f_rate;        /**< the change of f_at_rest from rate 0 to the guard; exact */
    const rdpi_q31_play_t *last_engaged; /**< play[engaged] */
    int32_t room;          /**< how far x can go on before the next play engages or the range ends */
    int32_t y[RDPI_MAX_PLAYS > 1 ? RDPI_MAX_PLAYS : 2]; /**< y_0 = x. x implies the states of the plays 1 .. engaged;
                                                             their places here are not kept. Never one value alone: gcc
                                                             would warn of its neighbour */
    uint16_t engaged;      /**< the plays 1 .. engaged move with x */
    bool falling;          /**< x came down to where it is */
} rdpi_q31_bank_t;

/** Private part of rdpi_q31_t: the rate estimator. */
typedef struct {
    int64_t filtered;           /**< the latest output: distance per window, times 2^31; not kept while `direct` */
    int32_t z[RDPI_MAX_WINDOW]; /**< ring of the latest N samples, the oldest at `oldest` */
    uint32_t guard;             /**< distance per window at the guard, times 2^31, over 2^guard_shift; >= 2^31 */
    uint32_t per_guard;         /**< 2^62 / guard */
    uint32_t blend;             /**< 1 - exp(-T / filter), times 2^(32 + blend_shift); 0 without a filter */
    uint8_t guard_shift;  /**< 0 .. 62 */
    uint8_t blend_shift;  /**< 0 .. 30 */
    uint8_t direct_shift; /**< 31 - guard_shift, where that is not negative */
    bool direct;          /**< the rate of the next sample follows from its distance to z[0] alone: N = 1, no filter,
                               guard_shift <= 31, there is a sample before it, and none was missed */
    uint16_t window; /**< N */
    uint16_t oldest; /**< < window; == window: no sample yet */
} rdpi_q31_rate_t;

/** Private part of rdpi_q31_t: one straight piece of S^-1. */
typedef struct {
    int64_t intercept; /**< output times 2^30 is slope * reference + intercept */
    int32_t slope;     /**< times 2^30 */
    int32_t from;      /**< the lowest reference on it */
    uint32_t length;   /**< how many references are on it; 0: none found yet, or its numbers do not fit */
} rdpi_q31_piece_t;

/** How the counts of a sensor become references. RDPI_PARAMS_Q31_SENSOR of a generated header fills it in. */
typedef struct {
    int64_t per_count; /**< reference units per count, times 2^32 */
    int64_t rest;      /**< the reference at count_0, times 2^32, and 2^31, so that cutting rounds to the nearest */
    int32_t count_0;   /**< the count nearest to reference 0 */
    int32_t least;     /**< counts below this one are taken for it, ... */
    int32_t most;      /**< ... and counts above this one for this */
} rdpi_q31_sensor_t;

/** Part of RDPI_Q31_SENSOR: the nearest number that fits 32 bits. Single precision holds these ends, too. */
#define RDPI_Q31_WITHIN(x) ((x) > 2147483520.0 ? 2147483520.0 : ((x) < -2147483520.0 ? -2147483520.0 : (x)))
/** Part of RDPI_Q31_SENSOR: the integer nearest to that. */
#define RDPI_Q31_NEAREST(x) ((int32_t)(RDPI_Q31_WITHIN(x) + ((x) < 0 ? -0.5 : 0.5)))
/** Part of RDPI_Q31_SENSOR. */
#define RDPI_Q31_MAGNITUDE(x) ((x) < 0 ? -(x) : (x))

/** An rdpi_q31_sensor_t as an initialiser, of constants in double: reference units per count, below 2^29 in magnitude and
 * not 0, and the count at reference 0, a fraction, within 32 bits. Least and most are where the reference reaches 1.5
 * times 2^30, beyond all that an actuator reaches. */
#define RDPI_Q31_SENSOR(per_count, count)                                                                             \
    {                                                                                                                 \
        (int64_t)((per_count) * 4294967296.0 + ((per_count) < 0 ? -0.5 : 0.5)),                                       \
            (int64_t)(((double)RDPI_Q31_NEAREST(count) - RDPI_Q31_WITHIN(count)) * (per_count) * 4294967296.0) +      \
                ((int64_t)1 << 31),                                                                                   \
            RDPI_Q31_NEAREST(count), RDPI_Q31_NEAREST((count) - 1610612736.0 / RDPI_Q31_MAGNITUDE(per_count)),        \
            RDPI_Q31_NEAREST((count) + 1610612736.0 / RDPI_Q31_MAGNITUDE(per_count))                                  \
    }

/** One actuator at work. Read the fields under "result"; the others are private. */
typedef struct {
    /* result */
    int32_t drive;     /**< the drive that is output, min_drive <= drive <= max_drive; before the first step, that which
                            belongs to the memory */
    int32_t rate;      /**< the rate that was used, after the guard; 0 .. RDPI_Q31_ONE */
    uint32_t dac_code; /**< drive as a DAC code; 0 if dac_bits is 0 */
    uint32_t flags;    /**< RDPI_FLAG_... of the latest step, sweep or forward only */
    /* counted since init or reset; they stop at their largest value */
    uint32_t guard_count;  /**< steps with RDPI_FLAG_GUARD */
    uint32_t clip_count;   /**< steps with RDPI_FLAG_RANGE or RDPI_FLAG_SLEW */
    uint32_t input_count;  /**< steps with RDPI_FLAG_INPUT */
    uint32_t missed_count; /**< samples reported to rdpi_q31_missed */
    /* private */
    const rdpi_q31_params_t *params; /**< as given to init */
    uint8_t missed;       /**< samples since the latest usable reference; stops at its largest value */
    bool direct_output;   /**< x goes to the nearest code directly: codes are output, they are coarse enough for 32-bit
                               arithmetic, the input curve is straight, and there is neither a slew limit nor noise
                               shaping. init sets it for good */
    uint16_t sweep_turns; /**< turning points that the start-up sweep has still to reach; 0: no sweep runs */
    int32_t x;            /**< where the plays were brought for `drive`; not kept if direct_output */
    int64_t ramp;         /**< drive before it is rounded to a code, times 2^32 */
    int64_t slew;         /**< largest change of the ramp per sample, 0: unlimited */
    int64_t sweep_step;   /**< change of the ramp per sample of the start-up sweep */
    rdpi_q31_piece_t latest_piece;  /**< the piece of S^-1 on which the latest reference lay */
    rdpi_q31_rate_t rate_estimator; /**< its state */
    rdpi_q31_bank_t bank;           /**< the plays */
#if RDPI_NOISE_SHAPING
    int64_t carried;                /**< noise shaping: see carried_um in rdpi/f32.h; times 2^30 */
#endif
} rdpi_q31_t;

/** RDPI_LAYOUT of this header. */
#define RDPI_Q31_LAYOUT RDPI_LAYOUT(rdpi_q31_t, rdpi_q31_params_t)

/** The reference for the counts of a sensor, in integers: one multiplication of 64 bits. Any counts are usable. Within
 * least to most, the reference is within 0.75 units of the exact one if double has 64 bits. O(1). ISR safe. */
static inline int32_t rdpi_q31_of_counts(const rdpi_q31_sensor_t *sensor, int32_t counts)
{
    int32_t usable = counts < sensor->least ? sensor->least : (counts > sensor->most ? sensor->most : counts);
    return (int32_t)((((int64_t)usable - sensor->count_0) * sensor->per_count + sensor->rest) >> 32);
}

/** As rdpi_f32_digest_layout. */
uint32_t rdpi_q31_digest_layout(uint64_t layout, const rdpi_q31_params_t *params);

/** As rdpi_f32_digest. */
static inline uint32_t rdpi_q31_digest(const rdpi_q31_params_t *params)
{
    return rdpi_q31_digest_layout(RDPI_Q31_LAYOUT, params);
}

/** As rdpi_f32_init_layout. */
rdpi_status_t rdpi_q31_init_layout(uint64_t layout, rdpi_q31_t *self, const rdpi_q31_params_t *params,
                                   uint32_t sample_time_ns);

/** As rdpi_f32_init. `sample_time_ns` is in ns, so it is 4.29 s at most.
 *
 * Scaling and overflow: init refuses what rdpi_f32_init refuses, and also numbers outside the formats above:
 *
 * - drives and thresholds beyond RDPI_Q31_MAX_DRIVE (RDPI_ERR_DRIVE, RDPI_ERR_THRESHOLDS, RDPI_ERR_MEMORY);
 * - slopes beyond RDPI_Q31_ONE or below RDPI_Q31_MIN_SLOPE (RDPI_ERR_SLOPES at rest, RDPI_ERR_GUARD at the guard);
 * - saturation weights whose magnitudes add up to more than 2^31 (RDPI_ERR_SATURATION);
 * - a guard of less than one reference unit per window, or of 2^63 and more (RDPI_ERR_RATE);
 * - a window of 4.29 s and more (RDPI_ERR_WINDOW). */
RDPI_MUST_CHECK
static inline rdpi_status_t rdpi_q31_init(rdpi_q31_t *self, const rdpi_q31_params_t *params, uint32_t sample_time_ns)
{
    return rdpi_q31_init_layout(RDPI_Q31_LAYOUT, self, params, sample_time_ns);
}

/** As rdpi_f32_reset. */
void rdpi_q31_reset(rdpi_q31_t *self);

/** As rdpi_f32_set_memory. States beyond RDPI_Q31_MAX_DRIVE are refused (RDPI_ERR_MEMORY). There is no slack for
 * rounding, because integers are not rounded. */
rdpi_status_t rdpi_q31_set_memory(rdpi_q31_t *self, const int32_t *y);

/** As rdpi_f32_get_memory. */
void rdpi_q31_get_memory(const rdpi_q31_t *self, int32_t *y);

/** As rdpi_f32_step: takes the reference and returns the drive. RDPI_Q31_NO_REFERENCE stands for NaN. Every other value
 * of `reference` is usable.
 *
 * The step is fastest if all of these hold:
 *
 * - the rate window is one sample, and there is no rate filter;
 * - there is no slew limit and no noise shaping, and the input curve is straight;
 * - codes are output that are some 4 drive units apart or more;
 * - S^-1 has a shift of 30 .. 61 and slopes below 2.
 *
 * Scaling and overflow: S^-1 is summed in 64 bits. It saturates, if at all, at +-2^30, twice what a drive in range
 * reaches. The drive saturates at the range (RDPI_FLAG_RANGE). The drive is within 2^-20 of RDPI_Q31_MAX_DRIVE of that
 * of exact arithmetic with the same parameters whose plays have followed the same drives. This holds whatever the
 * samples before: no rounding adds up. (Where the distance per window at the guard is fewer reference units than the
 * rate filter has samples, the rounding of the rate comes on top. No real actuator is near that.) */
int32_t rdpi_q31_step(rdpi_q31_t *self, int32_t reference);

/** As rdpi_f32_missed. The references on the straight line are whole units, rounded towards the one before. */
void rdpi_q31_missed(rdpi_q31_t *self, uint32_t ticks);

/** As rdpi_f32_sweep. */
bool rdpi_q31_sweep(rdpi_q31_t *self);

/** As rdpi_f32_forget_sweep. */
void rdpi_q31_forget_sweep(rdpi_q31_t *self);

/** As rdpi_f32_predict: returns the displacement, in reference units, for a drive at a rate. The guard, RDPI_Q31_ONE,
 * clamps the rate. Returns RDPI_Q31_NO_REFERENCE if the rate is negative or |drive| > RDPI_Q31_MAX_DRIVE.
 *
 * Scaling and overflow: the displacement saturates at +-INT32_MAX. */
int32_t rdpi_q31_predict(const rdpi_q31_t *self, int32_t drive, int32_t rate);

/** As rdpi_f32_forward. It refuses the inputs for which rdpi_q31_predict returns RDPI_Q31_NO_REFERENCE. */
int32_t rdpi_q31_forward(rdpi_q31_t *self, int32_t drive, int32_t rate);

#ifdef __cplusplus
}
#endif
#endif
