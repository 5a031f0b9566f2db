/** @file
 * The life of an axis in fixed point. rdpi/f32_axis.h says what it does, in which modes and from which contexts: the
 * functions are the same, with integers in place of numbers in V and um.
 *
 *     static rdpi_q31_axis_t axis = {.dac_code = SAFE_CODE};               // what the DAC shows until init has accepted
 *     rdpi_q31_axis_init(&axis, &rdpi_chain_q31, 100000, RDPI_PARAMS_Q31_DRIVE(SAFE_V)); // ns; before the timer runs
 *     rdpi_q31_axis_start(&axis);                                          // sweep, ramp to the reference, run
 *     rdpi_q31_axis_step(&axis, ahead); write_dac(axis.dac_code);          // in the timer interrupt, in every mode */
#ifndef RDPI_Q31_AXIS_H
#define RDPI_Q31_AXIS_H

#include "rdpi/q31_chain.h"

#ifdef __cplusplus
extern "C" {
#endif

/** As rdpi_f32_request_t. */
typedef struct {
    uint8_t call;            /**< which function */
    int32_t drive;           /**< of stop and fault */
    uint64_t per_us;         /**< of stop */
    rdpi_q31_chain_t *spare; /**< of exchange */
} rdpi_q31_request_t;

/** One actuator over its whole life. All zero but for dac_code and drive before init. */
typedef struct {
    /* result */
    int32_t drive;         /**< the drive to output */
    uint32_t dac_code;     /**< the same as a DAC code; 0 if the parameters have no codes. Until init has accepted, both
                                are what the caller put there: initialise them with the safe drive */
    uint32_t flags;        /**< RDPI_FLAG_... of the latest step, follow, replayed or block; of a block OR-ed */
    rdpi_axis_mode_t mode; /**< see rdpi_axis_mode_t */
    rdpi_status_t exchanged; /**< see rdpi_f32_axis_t */
    rdpi_q31_chain_t chain;  /**< its counts and preview_samples are results */
    /* private */
    int64_t at;       /**< of a ramp to a drive: where it is, times 2^32 */
    int64_t step;     /**< ... and how far in a sample, times 2^32 */
    int32_t target;   /**< ... and where it goes */
    int64_t own_slew;        /**< the slew limit of the parameters, per sample; 0: unlimited */
    bool own_direct_output;  /**< as init has set it in the chain */
    bool to_drive;           /**< the ramp goes to a drive, and the axis stops there */
    bool sane;               /**< reset by check: the next sample goes to FAULT */
    bool known;              /**< where the plays are: there was no fault after the latest sweep */
    volatile uint8_t posted; /**< counts requests; the latest is request[posted % 2] */
    uint8_t taken;           /**< the request that was obeyed last */
    volatile rdpi_q31_request_t request[2]; /**< two, so that no sample reads one that is being written */
} rdpi_q31_axis_t;

/** As rdpi_f32_axis_init_layout. */
rdpi_status_t rdpi_q31_axis_init_layout(uint64_t layout, rdpi_q31_axis_t *self, const rdpi_q31_chain_params_t *params,
                                        uint32_t sample_time_ns, int32_t drive);

/** As rdpi_f32_axis_init. `sample_time_ns` is that of rdpi_q31_init. */
RDPI_MUST_CHECK
static inline rdpi_status_t rdpi_q31_axis_init(rdpi_q31_axis_t *self, const rdpi_q31_chain_params_t *params,
                                               uint32_t sample_time_ns, int32_t drive)
{
    return rdpi_q31_axis_init_layout(RDPI_Q31_CHAIN_LAYOUT, self, params, sample_time_ns, drive);
}

/** As rdpi_f32_axis_step. */
int32_t rdpi_q31_axis_step(rdpi_q31_axis_t *self, int32_t ahead);

/** As rdpi_f32_axis_block. */
uint32_t rdpi_q31_axis_block(rdpi_q31_axis_t *self, const int32_t *reference, uint32_t *codes, uint32_t n);

/** As rdpi_f32_axis_missed. */
void rdpi_q31_axis_missed(rdpi_q31_axis_t *self, uint32_t ticks);

/** As rdpi_f32_axis_follow. RDPI_Q31_NO_REFERENCE in OFF. */
int32_t rdpi_q31_axis_follow(rdpi_q31_axis_t *self, int32_t drive);

/** As rdpi_f32_axis_replayed. RDPI_Q31_NO_REFERENCE in OFF. */
int32_t rdpi_q31_axis_replayed(rdpi_q31_axis_t *self, uint32_t dac_code);

/** As rdpi_f32_axis_start. */
rdpi_status_t rdpi_q31_axis_start(rdpi_q31_axis_t *self);

/** As rdpi_f32_axis_restart. */
rdpi_status_t rdpi_q31_axis_restart(rdpi_q31_axis_t *self);

/** As rdpi_f32_axis_stop. `per_us` is the speed in drive units per us, times 2^32, as sweep_per_us of the parameters. 0:
 * that of the sweep. RDPI_ERR_RATE for a speed that is less than 2^-32 of a drive unit per sample. */
rdpi_status_t rdpi_q31_axis_stop(rdpi_q31_axis_t *self, int32_t drive, uint64_t per_us);

/** As rdpi_f32_axis_hand_over. */
rdpi_status_t rdpi_q31_axis_hand_over(rdpi_q31_axis_t *self);

/** As rdpi_f32_axis_take_back. */
rdpi_status_t rdpi_q31_axis_take_back(rdpi_q31_axis_t *self);

/** As rdpi_f32_axis_fault. */
rdpi_status_t rdpi_q31_axis_fault(rdpi_q31_axis_t *self, int32_t drive);

/** As rdpi_f32_axis_exchange. */
rdpi_status_t rdpi_q31_axis_exchange(rdpi_q31_axis_t *self, rdpi_q31_chain_t *spare);

/** As rdpi_f32_axis_pending. */
static inline bool rdpi_q31_axis_pending(const rdpi_q31_axis_t *self)
{
    return self->posted != self->taken;
}

/** As rdpi_f32_axis_check. */
bool rdpi_q31_axis_check(rdpi_q31_axis_t *self);

#ifdef __cplusplus
}
#endif
#endif
