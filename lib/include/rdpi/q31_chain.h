/** @file
 * The chain in 32-bit integers: it compensates what stands around the operator. It has the functions of
 * rdpi/f32_chain.h, and gives the same bits on every machine. After missed samples the lead and lag^-1 divide once each,
 * by 17 at most; rdpi/q31.h says when the operator divides.
 *
 *     reference -> lead -> creep^-1 -> rdpi_q31_step -> lag^-1 -> drive
 *
 *     static rdpi_q31_chain_t axis;
 *     rdpi_q31_chain_init(&axis, &rdpi_chain_q31, 100000); // once, sample time in ns; from `rdpi header`
 *     rdpi_q31_chain_step(&axis, ahead);                   // in the timer interrupt; output axis.axis.dac_code
 *
 * References, drives and rates are scaled as in rdpi/q31.h. Shares are times 2^30, times are in ns.
 *
 * Scaling and overflow, all functions: as in rdpi/q31.h. References with the lead added saturate at +-INT32_MAX. Creep
 * is compensated within the reach: the displacement that is asked of the operator saturates at +-(2^30 - 1) if there
 * are poles.
 *
 * Memory, contexts and cost classes are those of rdpi/q31.h. */
#ifndef RDPI_Q31_CHAIN_H
#define RDPI_Q31_CHAIN_H

#include "rdpi/q31.h"

#ifdef __cplusplus
extern "C" {
#endif

/** The largest delay_ns, lag_ns and lead_ns: half a second. */
#define RDPI_Q31_MAX_LEAD_NS ((uint32_t)1 << 29)

/** The largest lead_ns2: a second squared. */
#define RDPI_Q31_MAX_LEAD_NS2 ((uint64_t)1 << 60)

/** The least that `direct` and the negative shares may add up to: a quarter. */
#define RDPI_Q31_MIN_DIRECT ((int32_t)1 << 28)

/** One first-order lag of creep or relaxation, l' = (h - l) / time_constant. */
typedef struct {
    int32_t share;             /**< of the lag in the displacement, times 2^30; may be negative */
    uint64_t time_constant_ns; /**< > 0 */
} rdpi_q31_pole_t;

/** The chain around one identified actuator, as `rdpi header` generates it. rdpi_f32_chain_params_t says what it
 * stands for. The arrays that it points to must outlive the instance. */
typedef struct {
    uint32_t schema;    /**< RDPI_PARAMS_SCHEMA */
    uint32_t digest;    /**< rdpi_q31_chain_digest of the rest, those of `axis` left out */
    uint64_t lead_ns2;  /**< beta, in ns^2; <= RDPI_Q31_MAX_LEAD_NS2 */
    uint32_t delay_ns;  /**< D; <= RDPI_Q31_MAX_LEAD_NS */
    uint32_t lag_ns;    /**< of the amplifier; <= RDPI_Q31_MAX_LEAD_NS */
    uint32_t lead_ns;   /**< alpha; <= RDPI_Q31_MAX_LEAD_NS */
    int32_t max_lead;   /**< the most that the lead adds to the reference, reference units; > 0 */
    int32_t direct;     /**< share of a move that comes at once, times 2^30; RDPI_Q31_ONE without poles. With the
                             magnitudes of all shares it adds up to 2^31 at most, and with the negative shares to
                             RDPI_Q31_MIN_DIRECT at least */
    uint16_t poles;     /**< 0 .. RDPI_MAX_POLES */
    uint16_t preview;   /**< 1: the caller knows the future, and passes it; 0: it is extrapolated */
    const rdpi_q31_params_t *axis; /**< the operator */
    const rdpi_q31_pole_t *pole;   /**< [poles] */
} rdpi_q31_chain_params_t;

/** Private part of rdpi_q31_chain_t: the lead. It adds (per_sum (d + d_before) + per_change (d - d_before)) 2^-shift,
 * with d the latest difference of references and d_before the one before it. */
typedef struct {
    int32_t per_sum;    /**< magnitude <= 2^30 */
    int32_t per_change; /**< magnitude <= 2^30 */
    int32_t latest;     /**< the latest reference */
    int32_t before;     /**< how much it differed from the one before; saturates at +-INT32_MAX */
    uint8_t shift;      /**< 1 .. 63 */
    bool rings;         /**< there are resonances */
} rdpi_q31_lead_t;

/** Private part of rdpi_q31_chain_t: lag^-1, as rdpi_f32_unlag_t. */
typedef struct {
    int64_t ramp;      /**< what was output, before it was rounded to a code: as rdpi_q31_t.ramp */
    int32_t per_step;  /**< lag / sample time, times 2^shift; <= 2^30; 0: there is no lag */
    int32_t asked;     /**< what the operator asked for in the latest step, not rounded to a code */
    int32_t before;    /**< how much it differed from the one before */
    int32_t followed;  /**< the operator's own drive */
    int32_t carried;   /**< noise shaping: what the codes so far have missed */
    uint32_t dac_code; /**< code of `followed` */
    uint8_t shift;     /**< 1 .. 63 */
    bool first;        /**< the next drive has no history */
} rdpi_q31_unlag_t;

/** Private part of rdpi_q31_chain_t: one pole. */
typedef struct {
    int64_t state;       /**< where the lag stands, times 2^32 */
    int32_t blend;       /**< 1 - exp(-time / time_constant), of the time between two moves of the pole; times 2^31,
                              of a slow pole times 2^(32 + shift) */
    int32_t weight;      /**< of the state in the displacement, times 2^30 */
    uint32_t per_sample; /**< sample time / time_constant, times 2^exponent; >= 2^30 */
    uint8_t exponent;    /**< 0 .. 94 */
    uint8_t shift;       /**< 0 .. 62; of a fast pole 0 */
} rdpi_q31_lag_t;

/** Private part of rdpi_q31_chain_t: creep^-1. */
typedef struct {
    int64_t settled;    /**< what h_0 adds to the displacement, times 2^30 */
    int64_t slow;       /**< what the slow poles add in this round, times 2^30 */
    int64_t next;       /**< what they add in the next one, of those that have moved */
    int64_t sum;        /**< sum of h in this round */
    int32_t mean;       /**< mean of h in the round before */
    int32_t h;          /**< the latest displacement of the operator */
    int32_t per_direct; /**< 2^28 / the share of a move that comes within its sample */
    uint32_t per_round; /**< 2^31 / number of slow poles */
    uint16_t fast;      /**< lag[0 .. fast - 1] move in every sample, of the others one at a time */
    uint16_t turn;      /**< the slow one whose turn it is */
    uint16_t poles;     /**< all of them */
    rdpi_q31_lag_t lag[RDPI_MAX_POLES]; /**< the fast ones first */
} rdpi_q31_creep_t;

/** One actuator and its chain at work. Read the results in `axis` and preview_samples; the others are private. */
typedef struct {
    rdpi_q31_t axis;          /**< the operator. Its results are those of the whole: drive, dac_code, flags, counts */
    uint32_t preview_samples; /**< how far ahead rdpi_q31_chain_step needs the reference; init sets it for good */
    /* private */
    uint32_t sample_time_ns; /**< as given to init */
    const rdpi_q31_chain_params_t *params; /**< as given to init */
    bool first; /**< the next reference is the first: the lead has no history */
    bool leads; /**< there is a lead */
    bool plain; /**< there is no lead, no lag, and there are no poles: nothing to do but the step of the operator */
    rdpi_q31_lead_t lead;   /**< its state */
    rdpi_q31_creep_t creep; /**< its state */
    rdpi_q31_unlag_t unlag; /**< of lag^-1 */
} rdpi_q31_chain_t;

/** How many numbers of 64 and of 32 bits the state of a chain has. */
#define RDPI_Q31_STATE_WIDE (9 + RDPI_NOISE_SHAPING + RDPI_MAX_POLES)
#define RDPI_Q31_STATE_NUMBERS (11 + RDPI_MAX_WINDOW + RDPI_MAX_PLAYS) /**< see above */
#define RDPI_Q31_STATE_COUNTS 15 /**< see above */

/** As rdpi_f32_chain_state_t. */
typedef struct {
    uint32_t digest; /**< of the parameters and the sample time that it belongs to */
    uint32_t check;  /**< CRC-32 of what follows: it tells a torn or damaged state */
    int64_t wide[RDPI_Q31_STATE_WIDE];       /**< sums and ramps */
    int32_t number[RDPI_Q31_STATE_NUMBERS];  /**< drives, displacements, rates */
    uint32_t count[RDPI_Q31_STATE_COUNTS];   /**< codes, counts, flags */
} rdpi_q31_chain_state_t;

/** RDPI_LAYOUT of this header. */
#define RDPI_Q31_CHAIN_LAYOUT (RDPI_LAYOUT(rdpi_q31_chain_t, rdpi_q31_chain_params_t) + RDPI_MAX_POLES)

/** As rdpi_f32_chain_digest_layout. */
uint32_t rdpi_q31_chain_digest_layout(uint64_t layout, const rdpi_q31_chain_params_t *params);

/** As rdpi_f32_chain_digest: CRC-32 of the fields from lead_ns2 to preview, then of share and time_constant_ns of each
 * pole. */
static inline uint32_t rdpi_q31_chain_digest(const rdpi_q31_chain_params_t *params)
{
    return rdpi_q31_chain_digest_layout(RDPI_Q31_CHAIN_LAYOUT, params);
}

/** As rdpi_f32_chain_init_layout. */
rdpi_status_t rdpi_q31_chain_init_layout(uint64_t layout, rdpi_q31_chain_t *self,
                                         const rdpi_q31_chain_params_t *params, uint32_t sample_time_ns);

/** As rdpi_f32_chain_init. `sample_time_ns` is that of rdpi_q31_init.
 *
 * Scaling and overflow: init refuses what rdpi_q31_init refuses, and with RDPI_ERR_CHAIN numbers outside what their
 * fields say. It also refuses a lead that multiplies differences of references by 2^29 or more, and a lag of 2^28
 * samples or more. */
RDPI_MUST_CHECK
static inline rdpi_status_t rdpi_q31_chain_init(rdpi_q31_chain_t *self, const rdpi_q31_chain_params_t *params,
                                                uint32_t sample_time_ns)
{
    return rdpi_q31_chain_init_layout(RDPI_Q31_CHAIN_LAYOUT, self, params, sample_time_ns);
}

/** As rdpi_f32_chain_reset. */
void rdpi_q31_chain_reset(rdpi_q31_chain_t *self);

/** As rdpi_f32_chain_settle. */
void rdpi_q31_chain_settle(rdpi_q31_chain_t *self);

/** As rdpi_f32_chain_swept. */
void rdpi_q31_chain_swept(rdpi_q31_chain_t *self, uint32_t ticks);

/** As rdpi_f32_chain_step: takes the reference preview_samples ahead, and returns the drive to output now.
 * RDPI_Q31_NO_REFERENCE stands for NaN.
 *
 * Scaling and overflow: what is asked of the operator is within 2^-23 of the reach of what exact arithmetic with the
 * same parameters gives, if no pole is slow. A pole is slow if its time constant is more than 4096 samples. P slow
 * poles take turns, so what one of them adds after a jump is up to 2.5 P samples late. No rounding adds up. */
int32_t rdpi_q31_chain_step(rdpi_q31_chain_t *self, int32_t ahead);

/** As rdpi_f32_chain_missed. Nothing is divided. */
void rdpi_q31_chain_missed(rdpi_q31_chain_t *self, uint32_t ticks);

/** As rdpi_f32_chain_forward. It refuses what rdpi_q31_forward refuses. With poles it divides 64 bits by 32.
 *
 * Scaling and overflow: the displacement saturates at +-INT32_MAX. */
int32_t rdpi_q31_chain_forward(rdpi_q31_chain_t *self, int32_t drive);

/** As rdpi_f32_chain_block. */
uint32_t rdpi_q31_chain_block(rdpi_q31_chain_t *self, const int32_t *reference, uint32_t *codes, uint32_t n);

/** As rdpi_f32_chain_get_state. */
rdpi_status_t rdpi_q31_chain_get_state(const rdpi_q31_chain_t *self, rdpi_q31_chain_state_t *state);

/** As rdpi_f32_chain_set_state. */
RDPI_MUST_CHECK
rdpi_status_t rdpi_q31_chain_set_state(rdpi_q31_chain_t *self, const rdpi_q31_chain_state_t *state);

/** As rdpi_f32_chain_is_sane. Of numbers of 64 bits it looks at the upper half, which is read at once. */
bool rdpi_q31_chain_is_sane(const rdpi_q31_chain_t *self);

/** As rdpi_f32_chain_inherit. The parameters say in which units they are: both must be made for the same output range.
 *
 * @return also RDPI_ERR_DRIVE if the output ranges, in V, differ.
 *
 * Scaling and overflow: what does not fit the formats of the new parameters saturates. It divides 64 bits by 32. */
RDPI_MUST_CHECK
rdpi_status_t rdpi_q31_chain_inherit(rdpi_q31_chain_t *self, const rdpi_q31_chain_t *from);

/** As rdpi_f32_chain_sweep. */
bool rdpi_q31_chain_sweep(rdpi_q31_chain_t *self);

#ifdef __cplusplus
}
#endif
#endif
