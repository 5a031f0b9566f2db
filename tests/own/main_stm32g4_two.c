/* The rest of a firmware for examples/own/stm32g4_two.c: the second axis has the reference of the first one, and the first
 * one's codes are printed. */
#define OF_AXIS axis_x
#include "triangle.h"

#define TICKS 1000u
#define CHANNELS 2u
#include "stm32_model.h"

static axis_reference_t falling(uint32_t sample)
{
    uint32_t phase = sample % 320u;
    return AXIS_UM(8.0) - AXIS_UM_STEP(0.05) * (axis_reference_t)(phase < 160u ? phase : 320u - phase);
}

axis_t axis_y = AXIS_OF(40.0, falling, 0u); /* its ramp takes longer: the first one waits */

bool run_axes(void);

static void takes_word(uint32_t word, bool fresh)
{
    if (!fresh || word >> 28 != 0u) {
        exit(5);
    }
    dac_gets(word & 0xFFFFu, 2u * length);
}

int main(void)
{
    if (!run_axes()) {
        return 1;
    }
    for (;;) {
        interrupts();
    }
}
