/** @file
 * The life of an axis in single precision: start, run, stop, restart, hand-over, exchange of parameters. Optional: a
 * program that does not call it pays nothing.
 *
 *     static rdpi_f32_axis_t axis = {.dac_code = SAFE_CODE};            // what the DAC shows until init has accepted
 *     rdpi_f32_axis_init(&axis, &rdpi_chain, 1.0f / 10000, SAFE_V);     // once, before the timer runs
 *     rdpi_f32_axis_start(&axis);                                       // sweep, ramp to the reference, run
 *     rdpi_f32_axis_step(&axis, ahead_um); write_dac(axis.dac_code);    // in the timer interrupt, in every mode
 *
 *     STOPPED --start--> SWEEP --> RAMP --> RUN        start: from STOPPED, SWEEP, RAMP, RUN and FAULT
 *     STOPPED --restart----------> RAMP --> RUN        no sweep: plays and creep are known
 *     any     --stop-------------> RAMP --> STOPPED    at a drive, at a speed
 *     any     --hand_over--> MANUAL --take_back--> RAMP --> RUN
 *     any     --fault--> FAULT --start--> SWEEP ...
 *
 * "Any" is every mode but OFF. No call and no change of mode makes a step of the drive that is larger than the slew
 * limit. In SWEEP and RAMP the step is not larger than the speed of the sweep, or than that of the stop, either. The
 * exceptions are `fault` and `replayed`, which report a drive that something else has output.
 *
 * Contexts:
 *
 * | call | context |
 * |---|---|
 * | init | main, before the timer runs |
 * | step, block, missed, follow, replayed | the sample: the timer interrupt, or the one task that makes the samples |
 * | start, restart, stop, hand_over, take_back, fault, exchange | any one context at a time. The next sample obeys. A call replaces one that no sample has taken yet, but not one that matters more: fault, then stop, then hand_over, then the others. RDPI_ERR_MODE then: ask again after the sample |
 * | check, pending | any |
 *
 * Another context must read a field of the result through volatile. Memory and cost classes are those of rdpi/f32.h. */
#ifndef RDPI_F32_AXIS_H
#define RDPI_F32_AXIS_H

#include "rdpi/f32_chain.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Private part of rdpi_f32_axis_t: what was asked for, for the next sample to obey. */
typedef struct {
    uint8_t call;            /**< which function, see lib/src/axis_life.h */
    rdpi_real_t drive_V;     /**< of stop and fault */
    rdpi_real_t V_per_s;     /**< of stop */
    rdpi_f32_chain_t *spare; /**< of exchange */
} rdpi_f32_request_t;

/** One actuator over its whole life. All zero but for dac_code and drive_V before init. After init it stays where it is: it
 * may hold its own address. */
typedef struct {
    /* result */
    rdpi_real_t drive_V;   /**< the drive to output */
    uint32_t dac_code;     /**< the same as a DAC code; 0 if the parameters have no codes. Until init has accepted, both
                                are what the caller put there: initialise them with the safe drive */
    uint32_t flags;        /**< RDPI_FLAG_... of the latest step, follow, replayed or block; of a block OR-ed */
    rdpi_axis_mode_t mode; /**< see rdpi_axis_mode_t */
    rdpi_status_t exchanged; /**< what became of the latest exchange of parameters; RDPI_ERR_MODE until a sample has obeyed
                                  it, and if another request has taken its place */
    rdpi_f32_chain_t chain;  /**< its counts and preview_samples are results */
    /* private */
    rdpi_f32_params_t slow;    /**< the operator's parameters with the speed of the ramp as their slew limit */
    rdpi_real_t sample_time_s; /**< as given to init */
    rdpi_real_t at_V;          /**< of a ramp to a drive: where it is, before it is rounded to a code */
    rdpi_real_t target_V;      /**< ... and where it goes */
    rdpi_real_t step_V;        /**< ... and how far in a sample */
    bool to_drive;             /**< the ramp goes to a drive, and the axis stops there */
    bool sane;                 /**< reset by check: the next sample goes to FAULT */
    bool known;                /**< where the plays are: there was no fault after the latest sweep */
    volatile uint8_t posted;   /**< counts requests; the latest is request[posted % 2] */
    uint8_t taken;             /**< the request that was obeyed last */
    volatile rdpi_f32_request_t request[2]; /**< two, so that no sample reads one that is being written */
} rdpi_f32_axis_t;

/** What rdpi_f32_axis_init calls. */
rdpi_status_t rdpi_f32_axis_init_layout(uint64_t layout, rdpi_f32_axis_t *self, const rdpi_f32_chain_params_t *params,
                                        rdpi_real_t sample_time_s, rdpi_real_t drive_V);

/** Checks the parameters as rdpi_f32_chain_init does, and prepares `self` for one step every `sample_time_s`. The mode
 * becomes STOPPED at `drive_V`, the drive that the amplifier outputs now.
 *
 * @return RDPI_OK; what rdpi_f32_chain_init returns; or RDPI_ERR_MEMORY if `drive_V` is not finite or outside the range.
 * After a fault the mode is OFF, and drive_V and dac_code of `self` are as before: steps hold them. Not for an ISR. */
RDPI_MUST_CHECK
static inline rdpi_status_t rdpi_f32_axis_init(rdpi_f32_axis_t *self, const rdpi_f32_chain_params_t *params,
                                               rdpi_real_t sample_time_s, rdpi_real_t drive_V)
{
    return rdpi_f32_axis_init_layout(RDPI_F32_CHAIN_LAYOUT, self, params, sample_time_s, drive_V);
}

/** One sample in any mode: takes the reference as rdpi_f32_chain_step does, and returns the drive in V to output now.
 * The reference counts in RAMP and RUN. While the mode is not RUN, pass the first reference again and again: count the
 * samples after which `mode` is RUN. The reference that ends the ramp is the first one that is followed.
 *
 * A ramp goes on until the reference is reached at the speed of the sweep. In OFF, STOPPED, MANUAL and FAULT the drive is
 * held; creep goes on. It never fails, as rdpi_f32_chain_step never does. O(n + m + poles); in RUN amortised. ISR safe. */
rdpi_real_t rdpi_f32_axis_step(rdpi_f32_axis_t *self, rdpi_real_t ahead_um);

/** `n` samples at once, in any mode: as rdpi_f32_chain_block. `reference_um` holds n + chain.preview_samples references,
 * the present one first. In RAMP the first one is approached. Where an exchange in the block asks for more preview, the
 * last reference takes the place of those beyond.
 *
 * @return how many references were followed: `n` in RUN, 0 in other modes, part of `n` where RUN begins in the block.
 * The next block begins so many references later. The flags of all samples are in `flags`, OR-ed. With a NULL pointer,
 * 0 and RDPI_FLAG_INPUT. ISR safe. */
uint32_t rdpi_f32_axis_block(rdpi_f32_axis_t *self, const rdpi_real_t *reference_um, uint32_t *codes, uint32_t n);

/** As rdpi_f32_chain_missed, in any mode. A sweep and a ramp go on where they were. ISR safe. */
void rdpi_f32_axis_missed(rdpi_f32_axis_t *self, uint32_t ticks);

/** In MANUAL, in place of rdpi_f32_axis_step: the other source outputs `drive_V` in this sample. Also where the request
 * of hand_over is pending.
 *
 * @return the displacement in um that the chain predicts; NaN in SWEEP, RUN and on a ramp to the reference. In other modes,
 * and for a drive that rdpi_f32_chain_forward refuses, the drive is held and RDPI_FLAG_INPUT set. ISR safe. */
rdpi_real_t rdpi_f32_axis_follow(rdpi_f32_axis_t *self, rdpi_real_t drive_V);

/** In place of rdpi_f32_axis_step, in any mode: the DAC got `dac_code` in this sample, whatever the axis had asked for. A
 * circular DMA, for example, outputs old codes again while the processor is late. The chain follows the drive of the code,
 * and the axis goes on from there: from RUN by a ramp to the reference, from STOPPED by a ramp back to where it stopped. A
 * sweep begins anew, a ramp goes on, MANUAL and FAULT hold the drive.
 *
 * @return the displacement in um that the chain predicts. In OFF, and for a code that the parameters do not have, NaN, or
 * the displacement at the drive: it is held and RDPI_FLAG_INPUT set. O(n + m + poles). ISR safe. */
rdpi_real_t rdpi_f32_axis_replayed(rdpi_f32_axis_t *self, uint32_t dac_code);

/** Begins the start-up sweep at the present drive; then the ramp to the reference, then RUN. From FAULT, the states of
 * the chain are made anew first. @return RDPI_OK, RDPI_ERR_NULL, RDPI_ERR_MODE in OFF and MANUAL. */
rdpi_status_t rdpi_f32_axis_start(rdpi_f32_axis_t *self);

/** Goes from STOPPED on to the ramp and RUN, without a sweep: the chain has followed the drive all the time.
 * @return RDPI_OK, RDPI_ERR_NULL, RDPI_ERR_MODE in other modes, and after a fault until a sweep has ended. */
rdpi_status_t rdpi_f32_axis_restart(rdpi_f32_axis_t *self);

/** Leads the drive to `drive_V` on a straight line at `V_per_s`, and stops there. 0 V/s: the speed of the sweep. The
 * slew limit holds, too. @return RDPI_OK, RDPI_ERR_NULL, RDPI_ERR_MODE in OFF; RDPI_ERR_MEMORY for a drive that is not
 * finite or outside the range, RDPI_ERR_RATE for a speed that is not finite, negative, or
 * so slow that rounding swallows the change of one sample. */
rdpi_status_t rdpi_f32_axis_stop(rdpi_f32_axis_t *self, rdpi_real_t drive_V, rdpi_real_t V_per_s);

/** Hands the actuator over to another source: the axis holds its drive until rdpi_f32_axis_follow reports another.
 * @return RDPI_OK, RDPI_ERR_NULL, RDPI_ERR_MODE in OFF. */
rdpi_status_t rdpi_f32_axis_hand_over(rdpi_f32_axis_t *self);

/** Takes the actuator back: from the drive that was followed last, the ramp leads to the reference.
 * @return RDPI_OK, RDPI_ERR_NULL, RDPI_ERR_MODE unless the mode is MANUAL, and after a fault until a sweep has ended. */
rdpi_status_t rdpi_f32_axis_take_back(rdpi_f32_axis_t *self);

/** Something else, such as a watchdog or an emergency stop, has brought the output to `drive_V`. The chain follows it,
 * the drive is held there, and only rdpi_f32_axis_start with its whole sweep leads back to RUN. @return RDPI_OK,
 * RDPI_ERR_NULL, RDPI_ERR_MODE in OFF, RDPI_ERR_MEMORY for a drive that is not finite or outside the range. */
rdpi_status_t rdpi_f32_axis_fault(rdpi_f32_axis_t *self, rdpi_real_t drive_V);

/** Exchanges the parameters while the axis runs. `spare` is a chain that rdpi_f32_chain_init has accepted with the new
 * parameters and the same sample time. It must stay untouched until the request is no longer pending. The next sample
 * calls rdpi_f32_chain_inherit: it takes what the chain remembers over, and the drive stays where it is. From RUN a ramp
 * leads to what the new parameters ask for. In fixed point, references are in the units of the new parameters from then on. `exchanged` says whether the exchange was accepted. If not, the old
 * parameters go on.
 * @return RDPI_OK, RDPI_ERR_NULL, RDPI_ERR_MODE in OFF, SWEEP and FAULT, and while a stop is on its way. */
rdpi_status_t rdpi_f32_axis_exchange(rdpi_f32_axis_t *self, rdpi_f32_chain_t *spare);

/** Whether no sample has obeyed the latest request yet. */
static inline bool rdpi_f32_axis_pending(const rdpi_f32_axis_t *self)
{
    return self->posted != self->taken;
}

/** Looks the state over as rdpi_f32_chain_is_sane does. If it is damaged, the next sample goes to FAULT and holds its
 * drive, and the states of the chain are made anew as rdpi_f32_chain_reset does. If that does not repair them, the drive
 * is held, and every call returns RDPI_ERR_MODE until another init. For a background task: it may be interrupted by a
 * sample. O(n + poles). @return false if it is damaged, in OFF, or if `self` is NULL. */
bool rdpi_f32_axis_check(rdpi_f32_axis_t *self);

#ifdef __cplusplus
}
#endif
#endif
