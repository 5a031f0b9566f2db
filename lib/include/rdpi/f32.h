/** @file
 * The library in single precision.
 *
 *     reference_um -> rate -> guard -> S^-1 -> exact inverse -> input curve -> limits -> DAC code -> drive_V
 *
 *     static rdpi_f32_t axis;
 *     rdpi_f32_init(&axis, &rdpi_params, 1.0f / 10000);   // once; rdpi_params comes from `rdpi header`
 *     drive_V = rdpi_f32_step(&axis, reference_um);       // in the timer interrupt
 *
 * Memory: the parameters are const (flash), and instances may share them. The state belongs to the caller (RAM). No
 * function keeps a static variable, allocates or blocks.
 *
 * Contexts:
 *
 * - Different instances may run at different interrupt priorities. One instance must not be used from two contexts at
 *   once.
 * - "ISR safe" means: the time of the function is bounded, and it may run in an interrupt while other instances are at
 *   work elsewhere.
 * - rdpi_f32_init and rdpi_f32_set_memory check their pointers. The other functions need an instance that rdpi_f32_init
 *   has accepted.
 * - Another context must read a field of the result through volatile. It must mask the interrupt to read several fields
 *   that belong together. Each step sets `flags` to 0 for a moment; it never does so with a counter.
 *
 * Compilers: -ffast-math is refused, because it cannot tell NaN from numbers. With -ffreestanding or -fno-builtin, the
 * compiler calls fabsf of libm.
 *
 * Cost classes: there are n + 1 plays and m + 1 pieces of saturation. A reversal, and each play that engages after it,
 * add to the cost of the step in which they happen. They add O(n) at worst. Most steps have none of them; "amortised"
 * is the cost without them.
 *
 * The quick way: most steps take some 70 instructions if DAC codes are output, the rate window is one sample, and there
 * is no rate filter, no slew limit and no noise shaping. The macro RDPI_QUICK_STEP, defined as 0, 1 or 2 for lib/src,
 * leaves the quick way out (0), or compiles half of it (1) or all of it (2). Half of it adds 1 kB of code: steps that
 * the quick way does not serve cost what they cost without it. All of it adds 2 to 3 kB. The default is 1 with -Os and 2
 * otherwise. Codes, drives, flags and counts are the same with each of them, bit for bit. */
#ifndef RDPI_F32_H
#define RDPI_F32_H

#include "rdpi/types.h"

#ifdef __cplusplus
extern "C" {
#endif

/** The number type. Firmware leaves it alone. The host tools and the tests also compile the same sources with
 * RDPI_REAL=double, so that each equation stands in one place. */
#ifndef RDPI_REAL
#define RDPI_REAL float
#endif
typedef RDPI_REAL rdpi_real_t; /**< the number type of the rdpi_f32 functions */

/** The largest magnitude of a reference, um. Larger ones are refused, as references that are not finite are. */
#define RDPI_MAX_REFERENCE_UM 1000000

/** The smallest sample time, s. Its inverse is the largest, s. Others are refused. */
#define RDPI_MIN_SAMPLE_TIME_S ((rdpi_real_t)1e-9)

/** One play operator and its piece of the loading curve. Equation numbers are those of Ang et al., IROS 2003; here they
 * are eq. 1, 14 and 15. At rate rho, the curve from r_i to r_(i+1) is W_i(rho) x - P_i(rho). W_i(rho) is slope +
 * slope_rate_s_per_um rho, and P_i(rho) is intercept_um + intercept_rate_s rho. */
typedef struct {
    rdpi_real_t r_um;                /**< threshold r_i; 0 = r_0 < r_1 < ... */
    rdpi_real_t slope;               /**< W_i at rate 0, >= 1e-7: the cumulative slope, not the weight of the play */
    rdpi_real_t slope_rate_s_per_um; /**< c_i: the change of W_i per unit rate */
    rdpi_real_t intercept_um;        /**< P_i at rate 0: P_0 = 0, P_i = P_(i-1) + (W_i - W_(i-1)) r_i */
    rdpi_real_t intercept_rate_s;    /**< the change of P_i per unit rate: the same sum with c_i in place of W_i */
} rdpi_f32_play_t;

/** One term of the saturation stage: weight max(v - d, 0) for d > 0 (eq. 7), and weight v for d = 0. */
typedef struct {
    rdpi_real_t d_um;   /**< threshold; 0 = d_0 < d_1 < ... */
    rdpi_real_t weight; /**< ws_j; every partial sum > 0 */
} rdpi_f32_deadzone_t;

/** One straight piece of S^-1, the inverse of the saturation stage (eq. 13): v = slope (reference - offset_um) +
 * intercept_um. */
typedef struct {
    rdpi_real_t from_um;      /**< the lowest reference on it; of the first piece, -RDPI_MAX_REFERENCE_UM */
    rdpi_real_t to_um;        /**< the highest reference on it; of the last piece, RDPI_MAX_REFERENCE_UM */
    rdpi_real_t slope;        /**< > 0 */
    rdpi_real_t intercept_um; /**< 0 for the piece that 0 is on */
} rdpi_f32_piece_t;

/** One straight piece of the input curve, which leads from the drive to the input x of the plays. The pieces are in the
 * order of the drive. The first begins at min_V. A piece ends at a code, if there are codes: half a code to either side
 * of that end is rounded to this code. Beyond the ends of the table, the first or the last piece goes on. Without
 * codes, the last six numbers are 0. */
typedef struct {
    rdpi_real_t to_V;           /**< the highest drive on it, where the next piece begins; of the last piece, max_V */
    rdpi_real_t to_um;          /**< x at to_V */
    rdpi_real_t middle_um;      /**< x in the middle of it */
    rdpi_real_t reach_um;       /**< how far x can go from there on it, either way */
    rdpi_real_t gain_um_per_V;  /**< x = gain (V - offset_V), not 0 */
    rdpi_real_t V_per_um;       /**< 1 / gain */
    rdpi_real_t offset_V;       /**< the drive at which x = 0, if the piece went on to there */
    rdpi_real_t from_code;      /**< the lowest code on it */
    rdpi_real_t to_code;        /**< the code at to_V, the lowest of the next piece; of the last piece, last_code */
    rdpi_real_t codes_per_um;   /**< dac_code = codes_per_um * x + code_of_x_0, cut to an integer */
    rdpi_real_t code_of_x_0;    /**< includes 0.5, so that cutting rounds to the nearest code */
    rdpi_real_t um_per_code;    /**< x = um_per_code * dac_code + x_of_code_0_um */
    rdpi_real_t x_of_code_0_um; /**< see um_per_code */
} rdpi_f32_line_t;

/** One identified actuator, as `rdpi header` generates it. The arrays that it points to must outlive the instance. */
typedef struct {
    uint32_t schema;             /**< RDPI_PARAMS_SCHEMA */
    uint32_t digest;             /**< rdpi_f32_digest of the rest */
    uint16_t plays;              /**< n + 1, 1 .. RDPI_MAX_PLAYS */
    uint8_t deadzones;           /**< m + 1, 1 .. RDPI_MAX_DEADZONES */
    uint8_t dac_bits;            /**< codes 0 .. 2^bits - 1 span min_V .. max_V; <= RDPI_MAX_DAC_BITS; 0: no codes */
    uint8_t curve_pieces;        /**< 1 .. RDPI_MAX_CURVE_PIECES; 1: the input curve is straight */
    uint8_t noise_shaping;       /**< 1: what a code misses is carried to the next, see rdpi_f32_step; 0: it is not */
    uint16_t sweep_cycles;       /**< cycles of the start-up sweep, > 0 */
    rdpi_real_t offset_um;       /**< displacement = z + offset_um; references are displacements */
    rdpi_real_t rate_window_s;   /**< >= 0; rho_k = |z_k - z_(k-N)| / (N T) with N = max(1, round(window / T)) */
    rdpi_real_t rate_filter_s;   /**< >= 0, time constant of a low-pass behind that; 0: none. In single precision, one
                                      of K samples costs about K 10^-7 of the rate */
    rdpi_real_t max_um_per_s;    /**< the guard clamps the rate to this, > 0 */
    rdpi_real_t min_slope_ratio; /**< every i must have W_i(max_um_per_s) >= ratio * W_i(0); 0 < ratio < 1 */
    rdpi_real_t min_V;           /**< lower end of the output range */
    rdpi_real_t max_V;           /**< upper end of the output range */
    rdpi_real_t slew_V_per_s;    /**< largest slope of the output before it is rounded to a code, >= sweep_V_per_s;
                                      0: unlimited */
    rdpi_real_t sweep_V_per_s;   /**< slope of the start-up sweep, > 0 */
    rdpi_real_t sweep_end_V;     /**< where the start-up sweep ends, min_V <= end <= max_V */
    rdpi_real_t sweep_forgotten; /**< share, 0 .. 1, of y_i - x that the actuator has forgotten when the start-up sweep
                                      has ended; see rdpi_f32_forget_sweep */
    rdpi_real_t min_sample_time_s; /**< the shortest sample time that init takes: no controller computes a step in less,
                                        or the sweep would be lost in rounding; 0: only the sweep decides */
    rdpi_real_t max_sample_time_s; /**< the longest: the sweep then goes from min_V to max_V in 8 samples. In fewer, its
                                        ramps are jumps of the amplifier. 0: unlimited */
    rdpi_real_t last_code;       /**< 2^dac_bits - 1. Without codes, this and the number below are 0 */
    rdpi_real_t V_per_code;      /**< drive = V_per_code * dac_code + min_V, at no code above max_V */
    const rdpi_f32_play_t *play;                /**< [plays] */
    const rdpi_f32_deadzone_t *saturation;      /**< [deadzones], S (eq. 8) */
    const rdpi_f32_piece_t *inverse_saturation; /**< [deadzones], S^-1 (eq. 13) */
    const rdpi_f32_line_t *curve;               /**< [curve_pieces], the input curve */
    const rdpi_real_t *memory_um; /**< [plays], the states of the plays at power up; memory_um[0] is x */
} rdpi_f32_params_t;

/** Private part of rdpi_f32_t: the plays. */
typedef struct {
    rdpi_real_t y_um[RDPI_MAX_PLAYS > 1 ? RDPI_MAX_PLAYS : 2]; /**< y_0 = x. x implies the states of the plays
                                                                    1 .. engaged; their places here are not kept */
    rdpi_real_t remainder_um;     /**< output at rate rho: W_k(rho) x + remainder_um + rho remainder_rate_s,
                                       k = engaged */
    rdpi_real_t remainder_rate_s; /**< see remainder_um */
    rdpi_real_t edge_um;          /**< where the quick way ends: see rdpi_f32_t.quick */
#if RDPI_MAX_CURVE_PIECES > 1
    rdpi_real_t middle_um;        /**< see there */
#endif
    const rdpi_f32_play_t *last_engaged; /**< play[engaged] */
    uint16_t engaged;             /**< the plays 1 .. engaged move with x */
    bool falling;                 /**< x pulls them down */
} rdpi_f32_bank_t;

/** Private part of rdpi_f32_t: the rate estimator. */
typedef struct {
    rdpi_real_t z_um[RDPI_MAX_WINDOW]; /**< ring of the latest N samples, the oldest at `oldest` */
    rdpi_real_t per_window_s;          /**< 1 / (N T) */
    rdpi_real_t keep;                  /**< exp(-T / filter_s); 0 without a filter */
    rdpi_real_t filtered_um_per_s;     /**< the latest output of the low-pass */
    uint16_t window; /**< N */
    uint16_t oldest; /**< < window; == window: no sample yet */
} rdpi_f32_rate_t;

/** One actuator at work. Read the fields under "result"; the others are private. */
typedef struct {
    /* result */
    rdpi_real_t drive_V;       /**< the drive that is output, min_V <= drive_V <= max_V; before the first step, that
                                    which belongs to the memory */
    rdpi_real_t rate_um_per_s; /**< the rate that was used, after the guard */
    uint32_t dac_code;         /**< drive_V as a DAC code; 0 if dac_bits is 0 */
    uint32_t flags;            /**< RDPI_FLAG_... of the latest step, sweep or forward only */
    /* counted since init or reset; they stop at their largest value */
    uint32_t guard_count;  /**< steps with RDPI_FLAG_GUARD */
    uint32_t clip_count;   /**< steps with RDPI_FLAG_RANGE or RDPI_FLAG_SLEW */
    uint32_t input_count;  /**< steps with RDPI_FLAG_INPUT */
    uint32_t missed_count; /**< samples reported to rdpi_f32_missed */
    /* private */
    const rdpi_f32_params_t *params;      /**< as given to init */
    const rdpi_f32_piece_t *latest_piece; /**< the piece of S^-1 on which the latest reference lay; only kept for the
                                               quick way */
#if RDPI_MAX_CURVE_PIECES > 1
    const rdpi_f32_line_t *line; /**< the piece of the input curve on which dac_code lies; only kept for the quick way.
                                      A code at an end between two pieces lies on the upper one */
#endif
#if RDPI_NOISE_SHAPING
    rdpi_real_t carried_um; /**< noise shaping: what the codes so far have missed, added up at the output of the plays */
#endif
    rdpi_real_t ramp_V;   /**< drive_V before it is rounded to a code; without it, a slow slew would never leave a code.
                               Steps without a slew limit may leave it behind; a sweep then starts from drive_V */
    uint16_t sweep_turns; /**< turning points that the start-up sweep has still to reach; 0: no sweep runs */
    uint8_t missed;       /**< samples since the latest usable reference; stops at its largest value */
    bool quick;           /**< the next step may take the quick way. While it is true, this holds:
                               - DAC codes are output, the rate window is one sample, and there is no rate filter, no
                                 slew limit and no noise shaping. Code 0 is so near to x = 0 that single precision resolves a code.
                               - rate_estimator.z_um[0] is the latest reference; none was missed or refused since.
                               - latest_piece is the piece of S^-1 on which the latest reference lies.
                               - drive_V and x are those of dac_code, to the last bit, and `line` is its piece.
                               - bank.edge_um bounds where x can go. While x is between bank.y_um[0] and bank.edge_um,
                                 no play engages or lets go and `line` does not end, rounding to a code included. With
                                 engaged = 0, that holds while x is less than bank.edge_um away from bank.middle_um.
                               - Without the input curve, `line` is its only piece, and bank.y_um[1] is in place of
                                 bank.middle_um.
                               A step whose rate is within the guard, whose reference lies inside latest_piece and whose
                               x is before the edge therefore needs no search, and gives the same bits as the long
                               way */
    rdpi_f32_rate_t rate_estimator; /**< its state */
    rdpi_f32_bank_t bank;           /**< the plays */
} rdpi_f32_t;

/** RDPI_LAYOUT of this header. */
#define RDPI_F32_LAYOUT RDPI_LAYOUT(rdpi_f32_t, rdpi_f32_params_t)

/** What rdpi_f32_digest calls. Returns 0 for another layout than the library's. */
uint32_t rdpi_f32_digest_layout(uint64_t layout, const rdpi_f32_params_t *params);

/** The CRC-32 (that of zlib) of the parameters, for programs that fill in parameters themselves. It covers counts,
 * numbers and arrays in the order of the struct, each number with its lowest byte first and without padding, so that it
 * is the same on every machine. It leaves out schema, digest and addresses. `params` must have pointers and counts that rdpi_f32_init accepts. O(n + m). ISR safe. */
static inline uint32_t rdpi_f32_digest(const rdpi_f32_params_t *params)
{
    return rdpi_f32_digest_layout(RDPI_F32_LAYOUT, params);
}

/** What rdpi_f32_init calls. The layout is the first argument because the library finds it there whatever RDPI_REAL of
 * the caller is. */
rdpi_status_t rdpi_f32_init_layout(uint64_t layout, rdpi_f32_t *self, const rdpi_f32_params_t *params,
                                   rdpi_real_t sample_time_s);

/** Checks `params`, and prepares `self` for one step every `sample_time_s`, in the state that rdpi_f32_reset makes.
 * `params` and its arrays must outlive `self`. Some numbers are derived from others: V_per_um, to_um, the
 * intercepts, the inverse of the saturation, and the numbers that make codes. Only the digest vouches that these fit
 * the others.
 *
 * The function is inline, so that it knows how its caller was compiled. If the library was compiled differently, it
 * returns RDPI_ERR_SIZE, and has neither read nor written anything.
 *
 * A damaged count or pointer can make it read beyond the arrays before it refuses. O(n + m), but long: not for an
 * ISR.
 *
 * @return RDPI_OK, or the first fault found; each kind of fault has a value of its own (rdpi_status_t). After a fault,
 * `self` must not be used. */
RDPI_MUST_CHECK
static inline rdpi_status_t rdpi_f32_init(rdpi_f32_t *self, const rdpi_f32_params_t *params, rdpi_real_t sample_time_s)
{
    return rdpi_f32_init_layout(RDPI_F32_LAYOUT, self, params, sample_time_s);
}

/** Goes back to power up: the plays have the memory of the parameters, drive_V is the drive that belongs to it, there
 * is no rate history, no sweep runs, and the counters are 0. O(n). ISR safe. */
void rdpi_f32_reset(rdpi_f32_t *self);

/** Replaces the states of the plays by the `plays` values of `y_um`. y_um[0] is x, and sets drive_V. One history must
 * be able to lead to these states: |y_i - y_(i-1)| <= r_i - r_(i-1), with drive_V inside [min_V, max_V]. Departures as
 * small as rounding leaves are accepted. The rate history and the counters stay. A sweep in progress ends. drive_V is
 * not rounded to a code. O(n). ISR safe.
 *
 * @return RDPI_OK; or RDPI_ERR_NULL or RDPI_ERR_MEMORY, and then nothing has changed. */
rdpi_status_t rdpi_f32_set_memory(rdpi_f32_t *self, const rdpi_real_t *y_um);

/** Copies the states of the plays, `plays` values, to `y_um`, in the form that rdpi_f32_set_memory takes.
 * (rdpi_f32_set_memory refuses states that rdpi_f32_forward has left outside the drive range.) O(n). ISR safe. */
void rdpi_f32_get_memory(const rdpi_f32_t *self, rdpi_real_t *y_um);

/** One sample: takes the reference, a displacement in um, and returns the drive in V to output now. The drive is also
 * in drive_V and, as a code, in dac_code.
 *
 * The step never fails:
 *
 * - A rate above the guard is clamped to it (RDPI_FLAG_GUARD).
 * - A drive beyond the range or the slew limit is clipped (RDPI_FLAG_RANGE, RDPI_FLAG_SLEW). The plays follow the
 *   clipped drive, so that model and actuator stay in step.
 * - With dac_bits, the drive is rounded to a code. The plays follow the rounded drive.
 * - With noise_shaping, one of the two codes next to the drive is output, so that what the codes miss of the displacement
 *   adds up to nothing (first order). Slow errors become small, fast ones larger: for sample rates far above the
 *   bandwidth. Without dac_bits it does nothing. The sum starts again from 0 where the drive is clipped, and after reset,
 *   rdpi_f32_set_memory, rdpi_f32_forward and a sweep, which round to the nearest code.
 * - A reference that is NaN, infinite or beyond RDPI_MAX_REFERENCE_UM holds the last drive and changes no state
 *   (RDPI_FLAG_INPUT). It counts as a missed sample: see rdpi_f32_missed.
 *
 * The rate of the first sample is 0, because there is no sample before it. A sample is the first after init, reset, a
 * sweep, rdpi_f32_forward, or more than RDPI_MAX_MISSED missed samples. The reference that keeps the present drive is
 * rdpi_f32_predict(self, self->drive_V, 0).
 *
 * Amortised O(m), at most O(n + m). With a rate window of N samples, the first sample is O(N). The quick way divides
 * once. Any other step divides up to three times; a slew limit and noise shaping add one each. ISR safe. */
rdpi_real_t rdpi_f32_step(rdpi_f32_t *self, rdpi_real_t reference_um);

/** Reports that `ticks` samples went by without a step, while the last drive was held. The next step takes the missed
 * references to lie on a straight line (RDPI_FLAG_MISSED), so that its rate is that over the true time. After more than
 * RDPI_MAX_MISSED missed samples, the rate starts again from 0. The slew limit stays that of one sample. O(1). ISR
 * safe. */
void rdpi_f32_missed(rdpi_f32_t *self, uint32_t ticks);

/** One sample of the start-up sweep, in place of a step. The sweep wipes out what the actuator remembers. The plays
 * follow it, so that plays and actuator end in the same state, whatever each was before. (Only plays whose r_i is
 * beyond half the range of x keep their state, because nothing moves them.)
 *
 * 1. If the amplifier does not output drive_V, report its drive first: rdpi_f32_forward(self, its_V, 0). Otherwise the
 *    first sample jumps.
 * 2. Once per sample, call rdpi_f32_sweep and output drive_V (or dac_code).
 * 3. Stop after the sample for which it returned false. One more call would begin another sweep.
 * 4. Call rdpi_f32_forget_sweep once. Parameters whose sweep_forgotten is 0 do not need it.
 *
 * @return true while the sweep goes on; false with its last sample, at which drive_V is sweep_end_V (to a code).
 *
 * The sweep is made of straight ramps with a slope of sweep_V_per_s. Their turning points close in from min_V and max_V
 * on sweep_end_V, in sweep_cycles cycles of equal decrements. It starts from drive_V, which init sets to the drive that
 * belongs to the memory of the parameters. After steps under a slew limit, it starts from their drive before it was
 * rounded to a code.
 *
 * If the calls stop half way, the states are consistent, and a later call goes on with the sweep. rdpi_f32_reset,
 * rdpi_f32_set_memory and rdpi_f32_forward end it. The sweep forgets the rate history. Amortised O(1), at most O(n).
 * ISR safe. */
bool rdpi_f32_sweep(rdpi_f32_t *self);

/** The end of the start-up sweep for an actuator that forgets part of what the sweep leaves. Brings every play nearer
 * to x, by the share sweep_forgotten of its distance. A share below 0 counts as 0, one above 1 as 1. Nothing else
 * changes. Call it once, after the last sample of a sweep and before the first step. O(n). ISR safe. */
void rdpi_f32_forget_sweep(rdpi_f32_t *self);

/** Returns the displacement in um that the model predicts for `drive_V` at `rate_um_per_s` (eq. 8, 9 and 17). The guard
 * clamps the rate; the drive is not limited. No state changes. Returns NaN if the drive is not finite, or the rate is
 * NaN or negative. O(n + m). ISR safe. */
rdpi_real_t rdpi_f32_predict(const rdpi_f32_t *self, rdpi_real_t drive_V, rdpi_real_t rate_um_per_s);

/** Tells the library that another source applied `drive_V`: the plays follow it, and so do drive_V and the slew limit.
 *
 * @return what rdpi_f32_predict predicts for it.
 *
 * Use it for simulation, and to enable the step without a bump:
 *
 * 1. While another source drives the actuator, call this with each drive that it outputs, at rate 0.
 * 2. Take the displacement returned last as the first reference of rdpi_f32_step. The step goes on from the same drive.
 *
 * The rate does not change what the plays do. The plays follow the drive also outside [min_V, max_V]; drive_V stays
 * inside. The rate history is forgotten. Sets and counts RDPI_FLAG_GUARD and RDPI_FLAG_INPUT.
 *
 * An input is refused if it is not finite, if the rate is negative, or if the drive is further outside the range than
 * 16 times its width. It moves nothing (RDPI_FLAG_INPUT) and counts as a missed sample. The prediction is then that for
 * drive_V at the rate in rate_um_per_s of `self`. O(n + m). ISR safe. */
rdpi_real_t rdpi_f32_forward(rdpi_f32_t *self, rdpi_real_t drive_V, rdpi_real_t rate_um_per_s);

#ifdef __cplusplus
}
#endif
#endif
