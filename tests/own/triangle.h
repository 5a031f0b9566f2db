/* The reference of all examples, and what their DAC got: printed at the end, one code a line. */
#include <stdio.h>
#include <stdlib.h>

#include "axis.h"
#include "rdpi_params.h"

#define REFERENCES 400u
#define MOST_CODES 2000u

#ifndef FAIL_TIMES
#define FAIL_AT 0u
#define FAIL_TIMES 0u
#endif
#ifndef OF_AXIS
#define OF_AXIS axis
#endif

static uint16_t dac_got[MOST_CODES];
static uint32_t dac_count, references;

static axis_reference_t triangle(uint32_t sample)
{
    uint32_t phase = sample % 320u;
    references = sample + 1u;
    return AXIS_UM(0.0) + AXIS_UM_STEP(0.05) * (axis_reference_t)(phase < 160u ? phase : 320u - phase);
}

axis_t OF_AXIS = AXIS_OF(0.0, triangle, 0u);

/* Whether the bus fails in this frame: so many do, from that one on. The DAC then outputs what it got before. */
static inline bool frame_fails(void)
{
    static uint32_t frames;
    uint32_t frame = frames++;
    return frame >= FAIL_AT && frame - FAIL_AT < FAIL_TIMES;
}

static void finish(void)
{
    for (uint32_t i = 0; i < dac_count; i++) {
        (void)printf("%u\n", (unsigned)dac_got[i]);
    }
    exit(0);
}

/* Takes a code. Ends the program with that of the last reference, which a code is `behind` the latest computed. */
static void dac_gets(uint32_t code, uint32_t behind)
{
    if (dac_count >= MOST_CODES || code > 0xFFFFu) {
        exit(3);
    }
    dac_got[dac_count++] = (uint16_t)code;
    if (references >= REFERENCES + behind) {
        finish();
    }
}
