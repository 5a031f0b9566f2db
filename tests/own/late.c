/* An example with a circular DMA on this computer, its processor blocked: late AT FOR INSIDE LOAD SAMPLES UNDERRUN. Prints
 * for each sample "x y fresh", then "late_count replayed_count". UNDERRUN: in that sample the DMA stops; 50 samples later
 * the program starts everything again. */
#include <stdio.h>

#include "stm32_hal.h"

#include "circular.h"
#define TICKS 1000u
#include "stm32_model.h"

bool run_axis(void);
bool run_axes(void);
extern circular_t circular;
extern volatile bool underrun;
static uint32_t samples, underrun_at;

static void takes_word(uint32_t word, bool fresh)
{
    (void)printf("%u %u %d\n", (unsigned)(word & 0xFFFFu), (unsigned)(word >> 16), (int)fresh);
    if (taken >= samples) {
        (void)printf("%u %u\n", (unsigned)circular.late_count, (unsigned)circular.replayed_count);
        exit(0);
    }
}

static bool run(void)
{
#if TWO
    return run_axes();
#else
    return run_axis();
#endif
}

int main(int argc, char **argv)
{
    if (argc != 7) {
        return 2;
    }
    block_at = (uint32_t)atoi(argv[1]);
    block_for = (uint32_t)atoi(argv[2]);
    block_inside = atoi(argv[3]) != 0;
    step_ticks = TICKS * (uint32_t)atoi(argv[4]) / 1000u;
    samples = (uint32_t)atoi(argv[5]);
    underrun_at = (uint32_t)atoi(argv[6]);
    now = (uint32_t)-1000000; /* it wraps */
    if (!run()) {
        return 1;
    }
    for (;;) {
        interrupts();
        if (underrun_at > 0u && taken >= underrun_at) {
            underrun_at = 0;
            HAL_DAC_DMAUnderrunCallbackCh1(&hdac1);
            dac_runs = false;
            now += 50u * TICKS;
            if (!underrun || !run() || underrun) {
                return 1;
            }
        }
    }
}
