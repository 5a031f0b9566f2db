/* Actuators between your timer and your DAC: start-up sweep, a ramp, then your references. Copy this file and axis.c.
 *
 * Each actuator is an axis_t. A C file of yours defines it, with the header of that actuator; two actuators are two such
 * files. axis.c is compiled once:
 *
 *     #include "axis.h"
 *     #include "rdpi_params.h"                                 // the actuator, made by `rdpi header`
 *     static axis_reference_t reference(uint32_t sample) { ... }
 *     axis_t stage = AXIS_OF(SAFE_V, reference, PERIOD);
 *
 * `life` in it is an rdpi_q31_axis_t or an rdpi_f32_axis_t. AXIS_LIFE(stop) and so on are the functions of its life, with
 * AXIS_DRIVE(V) for a drive: rdpi/f32_axis.h is their manual.
 *
 * AXIS_Q31 is 1 for fixed point and 0 for single precision. By default it follows from the core: single precision if it
 * has a floating-point unit. On a PC it is 1. */
#ifndef AXIS_H
#define AXIS_H

#include <stdbool.h>
#include <stdint.h>

#include "rdpi/rdpi.h"

#ifndef AXIS_Q31
#if defined(__ARM_FP) || defined(__riscv_flen)
#define AXIS_Q31 0
#else
#define AXIS_Q31 1
#endif
#endif

/* AXIS_UM: a displacement in um as a reference. AXIS_UM_STEP: a difference of two displacements; in fixed point
 * AXIS_UM(0.1) is not that, because it takes the offset of the sensor off. AXIS_DRIVE: a drive in V. Of a constant, the
 * compiler makes a number, in fixed point too.
 *
 * With a header of another name, as of `rdpi header --name stage_x`: AXIS_NAMED_UM(STAGE_X, um) and so on, and
 * AXIS_NAMED(stage_x_chain, STAGE_X, SAFE_V, reference, PERIOD) in place of AXIS_OF. */
#if AXIS_Q31
typedef int32_t axis_reference_t;
typedef rdpi_q31_axis_t axis_life_t;
typedef rdpi_q31_chain_params_t axis_params_t;
#define AXIS_LIFE(verb) rdpi_q31_axis_##verb
#define AXIS_CHAIN(chain) chain##_q31
#define AXIS_NAMED_UM(NAME, um) NAME##_Q31_REFERENCE(um)
#define AXIS_NAMED_UM_STEP(NAME, um) NAME##_Q31_DIFFERENCE(um)
#define AXIS_NAMED_DRIVE(NAME, V) NAME##_Q31_DRIVE(V)
#define AXIS_AT(V) .drive = (V)
#else
typedef float axis_reference_t;
typedef rdpi_f32_axis_t axis_life_t;
typedef rdpi_f32_chain_params_t axis_params_t;
#define AXIS_LIFE(verb) rdpi_f32_axis_##verb
#define AXIS_CHAIN(chain) chain
#define AXIS_NAMED_UM(NAME, um) ((float)(um))
#define AXIS_NAMED_UM_STEP(NAME, um) ((float)(um))
#define AXIS_NAMED_DRIVE(NAME, V) ((float)(V))
#define AXIS_AT(V) .drive_V = (V)
#endif
#define AXIS_UM(um) AXIS_NAMED_UM(RDPI_PARAMS, um)
#define AXIS_UM_STEP(um) AXIS_NAMED_UM_STEP(RDPI_PARAMS, um)
#define AXIS_DRIVE(V) AXIS_NAMED_DRIVE(RDPI_PARAMS, V)

/* Yours: the reference of a sample. `sample` counts from 0, which is the sample after ramp and sweep.
 *
 * - It is always below the period of the axis: a periodic reference cannot jump where a counter wraps.
 * - With period 0, it stops at UINT32_MAX: for a move that has an end.
 * - A source that does not know the future returns the present reference whatever `sample` is. Make the header with `rdpi
 *   header --no-preview` then. */
typedef axis_reference_t axis_source_t(uint32_t sample);

/* Yours, for a hand-over: the drive that the other source outputs in this sample, as AXIS_DRIVE(V) has it. */
typedef axis_reference_t axis_other_t(void);

typedef struct axis axis_t;
struct axis {
    axis_life_t life;            /* life.mode says what it does; axis_look reads more */
    const axis_params_t *params; /* the actuator */
    axis_source_t *source;
    uint32_t period;             /* of the reference, samples; 0: it has none */
    axis_t *with;                /* the next axis whose reference shall begin together with this one's; NULL: none. Of axes
                                    that are linked so, call axis_next for the first only */
    axis_other_t *other;         /* while another source drives; NULL: its drives are not known, and the axis takes the
                                    drive at the hand-over for them */
    axis_reference_t safe;       /* as AXIS_DRIVE(V) has it, for axis_fault: with other parameters, another */
    /* private */
    uint32_t rate_hz;
    uint32_t sample; /* of the reference */
    bool counts;     /* of the first axis: the references go on with time */
};

/* An axis_t at its beginning. The DAC gets the code of `safe_V` until axis_start has accepted the actuator, and the sweep
 * begins there. Let it be what your hardware outputs at power-up. */
#define AXIS_OF(safe_V, of_sample, period_samples)                                                                     \
    AXIS_NAMED(rdpi_chain, RDPI_PARAMS, safe_V, of_sample, period_samples)
#define AXIS_NAMED(chain, NAME, safe_V, of_sample, period_samples)                                                     \
    {                                                                                                                  \
        .life = {AXIS_AT(AXIS_NAMED_DRIVE(NAME, safe_V)), .dac_code = AXIS_CODE(NAME, safe_V)},                        \
        .params = &AXIS_CHAIN(chain), .source = (of_sample), .period = (period_samples),                               \
        .safe = AXIS_NAMED_DRIVE(NAME, safe_V)                                                                         \
    }
#define AXIS_CODE(NAME, V)                                                                                             \
    ((uint32_t)(((double)(V) - NAME##_MIN_V) / (NAME##_MAX_V - NAME##_MIN_V) * ((1ul << NAME##_DAC_BITS) - 1u) + 0.5))

/* What a task may want to know of an axis. The counts stop at their largest values. */
typedef struct {
    rdpi_axis_mode_t mode;
    uint32_t dac_code;
    uint32_t flags;        /* of the latest sample: RDPI_FLAG_... */
    uint32_t guard_count;  /* samples in which the rate was clamped */
    uint32_t clip_count;   /* ... in which range, slew limit or lead was */
    uint32_t input_count;  /* ... whose reference was refused */
    uint32_t missed_count; /* ... without a call of their own */
} axis_look_t;

/* The axis, and those that are linked to it, begin their sweep at the drive that they output. Call it before the timer
 * runs, and again whenever they shall begin anew, from any one context; the timer may run then. `rate_hz` is the rate at
 * which axis_next is called. Anything but RDPI_OK: parameters that are damaged or of another version, a rate of 0 or one
 * that does not suit them. Those axes then output the safe code. */
RDPI_MUST_CHECK rdpi_status_t axis_start(axis_t *self, uint32_t rate_hz);

/* One sample of the axis, and of those that are linked to it. Returns the code of the axis for its DAC; others have it in
 * life.dac_code. Call it at the rate given to axis_start, from one context. `lost` is how many samples since the previous
 * call had no call of their own. */
uint32_t axis_next(axis_t *self, uint32_t lost);

/* The axis, and those that are linked to it, step to their safe drives in the next sample and hold them: for an
 * emergency, or where something else has brought the outputs there. axis_start leads on, with a sweep. From any one
 * context. With a DMA, the codes in its buffer come out first: dac_fault of stm32_dac.h does not wait for them. */
void axis_fault(axis_t *self);

/* In place of axis_next: in this sample the DACs got these codes once more, because nobody had computed others.
 * codes[0] is that of the axis, codes[1] of the next one that is linked to it, and so on. */
void axis_replayed(axis_t *self, const uint32_t *codes);

/* So many samples pass without a call of their own. */
void axis_lost(axis_t *self, uint32_t samples);

/* For a task that axis_next may interrupt: each number is right for itself, but they may be of two samples. */
axis_look_t axis_look(const axis_t *self);

#endif
