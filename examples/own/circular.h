/* Codes for a circular DMA, which outputs whatever is in its buffer: also where the processor has been kept from computing
 * for longer than the buffer lasts, as by an erase of flash. Then old codes are output again. circular_fill sees it at the
 * DMA's own counter, has the axes follow those codes, and begins again ahead of the DMA. The axes go back to their
 * references by a ramp. Copy this file and dma.h, and include the chip's header first.
 *
 * A word of the buffer has the code of the first axis in its lower 16 bits, and of the axis that is linked to it in the
 * upper ones: as both channels of an STM32's DAC take it. */
#ifndef CIRCULAR_H
#define CIRCULAR_H

#include "axis.h"
#include "dma.h"

typedef struct {
    axis_t *axes;              /* the first one; at most two */
    uint32_t *words;           /* [length], declared with DMA_BUFFER of dma.h */
    uint32_t length;           /* 4 or more. The DMA interrupts after each half */
    uint32_t margin;           /* a word is not written if the DMA takes it within so many samples; 1 .. length / 4. They
                                  must last for the longest step */
    uint32_t (*left)(void);    /* the DMA's counter: words to the end of its round, length .. 1 */
    uint32_t (*time)(void);    /* a counter of 32 bits that counts up for ever whatever the processor does. It tells whole
                                  rounds of the DMA that nobody has seen */
    uint32_t ticks_per_sample; /* of that counter; 4 or more */
    /* result; from another context read through volatile */
    uint32_t late_count;     /* how often the processor was late */
    uint32_t replayed_count; /* how many samples had old codes; wraps */
    /* private */
    uint32_t at;       /* where the next word is written */
    int32_t ahead;     /* words that are written and that the DMA has not taken; negative: it took so many old ones */
    uint32_t position; /* what the DMA takes next, as seen last */
    uint32_t then;     /* when that was */
} circular_t;

static inline uint32_t circular_next(const circular_t *self, uint32_t at)
{
    return at + 1u < self->length ? at + 1u : 0u;
}

/* What the DMA takes next. */
static inline uint32_t circular_position(const circular_t *self)
{
    uint32_t left = self->left();
    return left > 0u && left < self->length ? self->length - left : 0u;
}

/* How many words the DMA has taken since the last time. Its counter has them exactly, but for whole rounds. */
static inline void circular_look(circular_t *self)
{
    uint32_t now, at;
    do { /* an interrupt in between would make time and position of two moments */
        now = self->time();
        at = circular_position(self);
    } while (self->time() - now > self->ticks_per_sample);
    uint32_t taken = at >= self->position ? at - self->position : at + self->length - self->position;
    int32_t more = (int32_t)(now - self->then - taken * self->ticks_per_sample); /* about: a whole number of rounds */
    const int32_t round = (int32_t)(self->length * self->ticks_per_sample);
    for (; more > round / 2; more -= round) {
        taken += self->length;
    }
    self->ahead -= (int32_t)taken;
    self->position = at;
    self->then = now;
}

static inline void circular_replay(circular_t *self)
{
    uint32_t codes[2] = {self->words[self->at] & 0xFFFFu, self->words[self->at] >> 16};
    axis_replayed(self->axes, codes);
    self->at = circular_next(self, self->at);
}

/* The DMA has taken old codes, and will take more of them until the margin is over. Of more than a round the last one is
 * enough: the rounds before went the same way. */
static inline void circular_catch_up(circular_t *self)
{
    uint32_t old = (uint32_t)((int32_t)self->margin - self->ahead);
    uint32_t skipped = old > self->length ? old - self->length : 0u;
    self->replayed_count += old;
    axis_lost(self->axes, skipped);
    self->at = (self->at + skipped) % self->length;
    for (; old > skipped; old--) {
        circular_replay(self);
    }
    self->ahead = (int32_t)self->margin;
}

static inline void circular_write(circular_t *self)
{
    uint32_t word = axis_next(self->axes, 0);
    if (self->axes->with != NULL) {
        word |= self->axes->with->life.dac_code << 16;
    }
    self->words[self->at] = word;
    dma_publish(&self->words[self->at], sizeof word); /* for a chip with a data cache */
    self->at = circular_next(self, self->at);
    self->ahead++;
}

/* Fills the whole buffer. Call it before the DMA starts, with the clock running. If the DMA has run before, it must have
 * stopped, and axis_replayed must have told the axes what is output now: of what is in the buffer they know only that they
 * have computed it. */
static inline void circular_begin(circular_t *self)
{
    self->at = self->position = 0;
    self->ahead = 0;
    while (self->ahead < (int32_t)self->length) {
        circular_write(self);
    }
    self->then = self->time();
}

/* Fills what the DMA has taken. Call it from both interrupts of the DMA, after a half and after the whole: which of them it
 * is does not matter. At most `length` steps of the axes. */
static inline void circular_fill(circular_t *self)
{
    bool late = false;
    for (uint32_t steps = 0; steps < self->length; steps++) {
        circular_look(self);
        if (self->ahead < (int32_t)self->margin) {
            late = true;
            circular_catch_up(self);
        } else if (self->ahead < (int32_t)self->length) {
            circular_write(self);
        } else {
            break; /* the buffer is full */
        }
    }
    self->late_count += late ? 1u : 0u;
}

#endif
