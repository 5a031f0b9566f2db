/** @file
 * The chain in single precision: it compensates what stands around the operator.
 *
 *     reference_um -> lead -> creep^-1 -> rdpi_f32_step -> lag^-1 -> drive_V
 *
 *     static rdpi_f32_chain_t axis;
 *     rdpi_f32_chain_init(&axis, &rdpi_chain, 1.0f / 10000);   // once; rdpi_chain comes from `rdpi header`
 *     drive_V = rdpi_f32_chain_step(&axis, ahead_um);          // in the timer interrupt
 *
 * - The lead makes up for delay and resonances. It is a filter on the reference.
 * - creep^-1 makes up for creep and relaxation. It is the exact inverse of a sum of first-order lags.
 * - lag^-1 makes up for the lag of an amplifier. It is a filter on the drive: the plays follow the drive behind the
 *   amplifier, which does not overshoot.
 *
 * `ahead_um` is the reference axis.preview_samples samples ahead of the present one. It is the present reference if
 * preview_samples is 0.
 *
 * A model without such effects has a chain too. Its step is that of the operator after one comparison. A program that
 * never needs the chain uses rdpi/f32.h alone, and pays nothing. Memory, contexts and cost classes are those of
 * rdpi/f32.h. */
#ifndef RDPI_F32_CHAIN_H
#define RDPI_F32_CHAIN_H

#include "rdpi/f32.h"

#ifdef __cplusplus
extern "C" {
#endif

/** One first-order lag of creep or relaxation, l' = (h - l) / time_constant_s. */
typedef struct {
    rdpi_real_t share;           /**< of the lag in the displacement; may be negative, see `direct` */
    rdpi_real_t time_constant_s; /**< > 0 */
} rdpi_f32_pole_t;

/** The chain around one identified actuator, as `rdpi header` generates it. With h the displacement of the operator,
 * h_0 its value when creep had settled and l_i the lags of h, the displacement behind creep and relaxation is
 *
 *     z = h_0 + direct (h - h_0) + sum share_i (l_i - h_0).
 *
 * The displacement of the actuator is z through delay, lags and resonances. */
typedef struct {
    uint32_t schema;                 /**< RDPI_PARAMS_SCHEMA */
    uint32_t digest;                 /**< rdpi_f32_chain_digest of the rest, those of `axis` left out */
    uint16_t poles;                  /**< 0 .. RDPI_MAX_POLES */
    uint16_t preview;                /**< 1: the caller knows the future, and passes it; 0: it is extrapolated */
    rdpi_real_t delay_s;             /**< D, >= 0 */
    rdpi_real_t lag_s;               /**< time constant of the amplifier's lag, >= 0 */
    rdpi_real_t lead_s;              /**< alpha: 2 damping / w of the resonances, added up; >= 0 */
    rdpi_real_t lead_s2;             /**< beta: 1 / w^2 of the resonances and the products of all, added up; >= 0 */
    rdpi_real_t max_lead_um;         /**< the most that the lead adds to the reference; > 0 */
    rdpi_real_t direct;              /**< share of a move that comes at once, 1 without poles. It and the negative
                                          shares must add up to 0.001 or more: then the inverse is stable */
    const rdpi_f32_params_t *axis;   /**< the operator */
    const rdpi_f32_pole_t *pole;     /**< [poles] */
} rdpi_f32_chain_params_t;

/** Private part of rdpi_f32_chain_t: the lead. With d the latest difference of two references and d_before the one
 * before it, it adds per_step d + per_before d_before, to the reference before the latest if there is preview, else to
 * the latest. */
typedef struct {
    rdpi_real_t latest_um;  /**< the latest reference */
    rdpi_real_t before_um;  /**< how much it differed from the one before */
    rdpi_real_t per_before; /**< see above */
    rdpi_real_t per_step;   /**< see above */
    rdpi_real_t max_um;     /**< the most that the lead adds */
    bool rings;             /**< there are resonances */
} rdpi_f32_lead_t;

/** Private part of rdpi_f32_chain_t: lag^-1. To the drive it adds per_step times the mean of its latest two differences,
 * or twice the smaller one if that is less; nothing unless they have the same sign. */
typedef struct {
    rdpi_real_t per_step;   /**< lag_s / sample time; 0: there is no lag */
    rdpi_real_t asked_V;    /**< what the operator asked for in the latest step */
    rdpi_real_t before_V;   /**< how much it differed from the one before */
    rdpi_real_t followed_V; /**< the operator's own drive, which the plays have followed */
    rdpi_real_t ramp_V;     /**< what was output, before it was rounded to a code: as rdpi_f32_t.ramp_V */
    rdpi_real_t carried_V;  /**< noise shaping: what the codes so far have missed */
    rdpi_real_t codes_per_V; /**< DAC codes in a V; 0 without codes */
    rdpi_real_t max_step_V; /**< of the slew limit; 0: unlimited */
    uint32_t dac_code;      /**< code of followed_V */
    uint8_t way;            /**< in place of rdpi_f32_chain_t.way, which leads here */
    bool first;             /**< the next drive has no history */
} rdpi_f32_unlag_t;

/** Private part of rdpi_f32_chain_t: one pole. */
typedef struct {
    rdpi_real_t state_um; /**< where the lag stands, less h_0 */
    rdpi_real_t rest_um;  /**< what is too small for state_um; slow poles only */
    rdpi_real_t blend;    /**< 1 - exp(-time / time_constant), of the time between two moves of the pole */
    rdpi_real_t weight;   /**< of the state in the displacement */
    rdpi_real_t weight_ahead; /**< slow poles only: of what the state moves in a round, in the displacement of the next one */
} rdpi_f32_lag_t;

/** Private part of rdpi_f32_chain_t: creep^-1. */
typedef struct {
    rdpi_real_t h_um;       /**< what the operator was asked for in the latest step, less h_0 */
    rdpi_real_t per_direct; /**< 1 / the share of a move that comes within its sample */
    rdpi_real_t settled_um; /**< h_0 */
    rdpi_real_t slow_um;    /**< h_0 and what the slow poles add in this round */
    rdpi_real_t next_um;    /**< what they add in the next one, of those that have moved */
    rdpi_real_t mean_um;    /**< mean of h in the round before, less h_0 */
    rdpi_real_t sum_um;     /**< sum of h in this round, less h_0 */
    rdpi_real_t round;      /**< samples in a round */
    uint32_t fast;          /**< lag[0 .. fast - 1] move in every sample, the others in turns */
    uint32_t poles;         /**< all of them */
    uint32_t turn;          /**< the slow one that moves next; the last one begins the round */
    uint32_t per_turn;      /**< samples between two turns; 0 without slow poles */
    uint32_t wait;          /**< ... and until the next one */
    rdpi_f32_lag_t lag[RDPI_MAX_POLES];     /**< one of each pole */
    rdpi_real_t per_sample[RDPI_MAX_POLES]; /**< sample time / time_constant of each */
} rdpi_f32_creep_t;

/** One actuator and its chain at work. Read the results in `axis` and preview_samples; the others are private. */
typedef struct {
    rdpi_f32_t axis;          /**< the operator. Its results are those of the whole: drive_V, dac_code, flags, counts */
    uint32_t preview_samples; /**< how far ahead rdpi_f32_chain_step needs the reference; init sets it for good */
    /* private */
    uint8_t usual; /**< the way of a step after one that was not special: see rdpi_f32_chain.c */
    uint8_t way;   /**< the way of the next step */
    bool first;    /**< the next reference is the first: the lead has no history */
    const rdpi_f32_chain_params_t *params; /**< as given to init */
    rdpi_f32_lead_t lead;   /**< its state */
    rdpi_f32_creep_t creep; /**< its state */
    rdpi_f32_unlag_t unlag; /**< of lag^-1 */
} rdpi_f32_chain_t;

/** How many numbers and how many whole ones the state of a chain has. */
#define RDPI_F32_STATE_NUMBERS (19 + RDPI_NOISE_SHAPING + RDPI_MAX_WINDOW + RDPI_MAX_PLAYS + 2 * RDPI_MAX_POLES)
#define RDPI_F32_STATE_COUNTS 17 /**< see above */

/** All that a chain remembers, as one value without addresses: to be kept over a reset of the processor, or to try
 * something and go back. */
typedef struct {
    uint32_t digest; /**< of the parameters and the sample time that it belongs to */
    uint32_t check;  /**< CRC-32 of what follows: it tells a torn or damaged state */
    uint32_t count[RDPI_F32_STATE_COUNTS];       /**< codes, counts, flags */
    rdpi_real_t number[RDPI_F32_STATE_NUMBERS];  /**< drives, displacements, rates */
} rdpi_f32_chain_state_t;

/** RDPI_LAYOUT of this header. */
#define RDPI_F32_CHAIN_LAYOUT (RDPI_LAYOUT(rdpi_f32_chain_t, rdpi_f32_chain_params_t) + RDPI_MAX_POLES)

/** What rdpi_f32_chain_digest calls. */
uint32_t rdpi_f32_chain_digest_layout(uint64_t layout, const rdpi_f32_chain_params_t *params);

/** As rdpi_f32_digest, of the chain's numbers and poles. */
static inline uint32_t rdpi_f32_chain_digest(const rdpi_f32_chain_params_t *params)
{
    return rdpi_f32_chain_digest_layout(RDPI_F32_CHAIN_LAYOUT, params);
}

/** What rdpi_f32_chain_init calls. */
rdpi_status_t rdpi_f32_chain_init_layout(uint64_t layout, rdpi_f32_chain_t *self,
                                         const rdpi_f32_chain_params_t *params, rdpi_real_t sample_time_s);

/** Checks the chain and its operator, and prepares `self` for one step every `sample_time_s`, in the state that
 * rdpi_f32_chain_reset makes. As rdpi_f32_init in all else.
 *
 * @return RDPI_OK, or the first fault found: those of rdpi_f32_init, and RDPI_ERR_CHAIN. */
RDPI_MUST_CHECK
static inline rdpi_status_t rdpi_f32_chain_init(rdpi_f32_chain_t *self, const rdpi_f32_chain_params_t *params,
                                                rdpi_real_t sample_time_s)
{
    return rdpi_f32_chain_init_layout(RDPI_F32_CHAIN_LAYOUT, self, params, sample_time_s);
}

/** rdpi_f32_reset, then rdpi_f32_chain_settle. O(n). ISR safe. */
void rdpi_f32_chain_reset(rdpi_f32_chain_t *self);

/** Creep has settled at the present drive, and the lead forgets its history. Call it after functions of rdpi/f32.h
 * have moved self->axis: rdpi_f32_set_memory, rdpi_f32_forward. O(n + m). ISR safe. */
void rdpi_f32_chain_settle(rdpi_f32_chain_t *self);

/** A decaying sweep ended at the present drive, `ticks` samples ago. The drive that rdpi_f32_set_memory has put into
 * self->axis counts as such. Creep had settled in the middle of the range, and has followed to the present drive since
 * the sweep ended. The lead forgets its history. Call it in place of rdpi_f32_chain_settle if the application has swept
 * the actuator itself, or has waited after a sweep. O(n + m + poles). ISR safe. */
void rdpi_f32_chain_swept(rdpi_f32_chain_t *self, uint32_t ticks);

/** One sample: takes the reference preview_samples ahead, a displacement in um, and returns the drive in V to output
 * now. It never fails, as rdpi_f32_step never does. What is added to that:
 *
 * - The lead adds max_lead_um at most, and then reports RDPI_FLAG_LEAD. It looks at three references, so nothing rings
 *   on after a jump. Without resonances, a jump has no lead.
 * - lag^-1 keeps the range and the slew limit, and then reports RDPI_FLAG_LEAD. A jump of the drive has no lead.
 * - Where the drive was clipped, creep follows what was really output.
 * - A reference that is not usable holds the last drive. Creep goes on. The same holds if lead and creep bring a
 *   reference beyond RDPI_MAX_REFERENCE_UM.
 * - After missed or refused samples, the lead takes their references to lie on a straight line. After more than
 *   RDPI_MAX_MISSED of them, the next reference is a first one. A first one has no lead.
 *
 * Amortised O(m + poles), at most O(n + m + poles). ISR safe. */
rdpi_real_t rdpi_f32_chain_step(rdpi_f32_chain_t *self, rdpi_real_t ahead_um);

/** As rdpi_f32_missed. Creep goes on for the time of the missed samples, however many they are. O(n + m + poles). ISR
 * safe. */
void rdpi_f32_chain_missed(rdpi_f32_chain_t *self, uint32_t ticks);

/** Tells the chain that another source applied `drive_V` in this sample. Call it once per sample in place of
 * rdpi_f32_chain_step, with each drive that the other source outputs. Plays and creep follow. The amplifier's lag counts
 * as settled, and the lead forgets its history.
 *
 * @return the displacement in um that the chain predicts, creep included. As the first reference of rdpi_f32_chain_step
 * it goes on from the same drive.
 *
 * A drive is refused as rdpi_f32_forward does: the drive is held, creep goes on, and RDPI_FLAG_INPUT is set and counted.
 * O(n + m + poles). ISR safe. */
rdpi_real_t rdpi_f32_chain_forward(rdpi_f32_chain_t *self, rdpi_real_t drive_V);

/** `n` samples at once, for a DMA that fetches codes. `reference_um` holds the references of these samples and of the
 * preview_samples that follow: n + preview_samples numbers. The code of each sample goes to `codes`, so the parameters
 * must have DAC codes. The results in `axis` are those of the last sample. The block gives the same as n calls of
 * rdpi_f32_chain_step.
 *
 * @return the flags of all samples, OR-ed. RDPI_FLAG_INPUT alone if a pointer is NULL: then nothing else has happened.
 *
 * n times the amortised cost of a step, and O(n + m + poles) more for each sample in which x turns round or a play
 * engages: lib/README.md has figures. ISR safe. */
uint32_t rdpi_f32_chain_block(rdpi_f32_chain_t *self, const rdpi_real_t *reference_um, uint32_t *codes, uint32_t n);

/** Reads all that the chain remembers. Between this and rdpi_f32_chain_set_state the chain goes on to the bit: steps
 * after it give the same drives, flags and counts as if nothing had happened. No step may come in between: call it where
 * the samples are made, or with their interrupt masked.
 *
 * @return RDPI_OK or RDPI_ERR_NULL. O(n + poles), and a CRC of the state. ISR safe. */
rdpi_status_t rdpi_f32_chain_get_state(const rdpi_f32_chain_t *self, rdpi_f32_chain_state_t *state);

/** Takes a state of a chain with the same parameters, sample time and compile-time maxima, at the same amplifier: its
 * drive counts as output. No step may come in between. Not for an ISR with a small stack: it holds a chain there.
 *
 * @return RDPI_OK, RDPI_ERR_NULL, or RDPI_ERR_STATE if the state is torn, damaged or not of this chain. Then nothing has
 * changed. */
RDPI_MUST_CHECK
rdpi_status_t rdpi_f32_chain_set_state(rdpi_f32_chain_t *self, const rdpi_f32_chain_state_t *state);

/** Whether the state is one that a chain can have: every number is finite and within what parameters and range allow,
 * every index within its array. Finds a stray write or an upset memory cell that would hold or move the output; a change
 * that leaves a number within its bounds is not found. rdpi_f32_chain_reset repairs what it finds, and rdpi_f32_chain_init
 * also what follows from the sample time.
 *
 * It reads each field once and compares nearly all with constants, so a step may interrupt it. An interrupted look can
 * find damage that is none: then look again, as rdpi_f32_axis_check does. On 8-bit cores mask the
 * interrupt: there a number is read in parts. False for NULL. O(n + poles). */
bool rdpi_f32_chain_is_sane(const rdpi_f32_chain_t *self);

/** Exchanges parameters: `self` is a chain that rdpi_f32_chain_init has just accepted, with other parameters of the same
 * actuator and the same sample time. It takes over what the chain `from` remembers, at the same drive:
 *
 * - The plays. Each one's state bounds the turning points of the drive that are still remembered; the new thresholds
 *   find their places between them.
 * - Creep. How far each pole is behind is found between the poles with the next time constants.
 * - dac_code, if both have the same codes; else the nearest code. The counts.
 *
 * The history of the rate and of the lead is forgotten. The new parameters ask for another drive at the same reference: let
 * rdpi_f32_axis_exchange lead there. No step of either chain may come in between. O(n (n + pieces) + poles^2). ISR safe.
 *
 * @return RDPI_OK; RDPI_ERR_NULL; RDPI_ERR_SAMPLE_TIME if the sample times differ; RDPI_ERR_MEMORY if the drive of `from`
 * is outside the range of `self`. Then `self` is as init made it. */
RDPI_MUST_CHECK
rdpi_status_t rdpi_f32_chain_inherit(rdpi_f32_chain_t *self, const rdpi_f32_chain_t *from);

/** As rdpi_f32_sweep. With its last sample comes rdpi_f32_forget_sweep. Creep counts as settled in the middle of the
 * range when the sweep begins, and follows it. O(n + m + poles). */
bool rdpi_f32_chain_sweep(rdpi_f32_chain_t *self);

#ifdef __cplusplus
}
#endif
#endif
