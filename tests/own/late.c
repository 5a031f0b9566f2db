/* An example with a circular DMA on this computer: late AT FOR INSIDE LOAD SAMPLES UNDERRUN LATE WAIT FAULT. Prints for
 * each sample, and for each change without one, "x y fresh", then "late_count replayed_count".
 *
 * AT, FOR, INSIDE   for so many samples from the one on the processor is blocked, in the interrupt or not
 * LOAD              thousandths of a sample for each look at the DMA
 * SAMPLES           to print
 * UNDERRUN          from that sample on the DMA fetches nothing; 0: never. With LATE it fetches one word more. WAIT
 *                   samples later the program starts everything again
 * FAULT             in that sample the program stops all; 40 samples' time later it starts again; 0: never */
#include <stdio.h>

#include "stm32_hal.h"

#include "circular.h"
#define TICKS 1000u
#define CHANNELS (TWO ? 2u : 1u)
#include "stm32_model.h"

bool run_axis(void);
bool run_axes(void);
void fault_axis(void);
void fault_axes(void);
extern circular_t circular;
extern volatile bool underrun;
static uint32_t samples, underrun_at, wait_for, fault_at;
static bool fetches_late;

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

static void fault(void)
{
#if TWO
    fault_axes();
#else
    fault_axis();
#endif
}

/* The DAC holds its code. */
static bool begins_anew_after_an_underrun(void)
{
    starved = true;
    pass(2u * TICKS);
    underrun_interrupt(fetches_late);
    starved = false;
    pass(wait_for * TICKS);
    return underrun && run() && !underrun;
}

static bool begins_anew_after_a_fault(void)
{
    fault();
    pass(40u * TICKS);
    interrupts();
    return run();
}

int main(int argc, char **argv)
{
    if (argc != 10) {
        return 2;
    }
    block_at = (uint32_t)atoi(argv[1]);
    block_for = (uint32_t)atoi(argv[2]);
    block_inside = atoi(argv[3]) != 0;
    step_ticks = TICKS * (uint32_t)atoi(argv[4]) / 1000u;
    samples = (uint32_t)atoi(argv[5]);
    underrun_at = (uint32_t)atoi(argv[6]);
    fetches_late = atoi(argv[7]) != 0;
    wait_for = (uint32_t)atoi(argv[8]);
    fault_at = (uint32_t)atoi(argv[9]);
    now = (uint32_t)-1000000; /* it wraps */
    if (!run()) {
        return 1;
    }
    for (;;) {
        interrupts();
        if (underrun_at > 0u && taken >= underrun_at) {
            underrun_at = 0;
            if (!begins_anew_after_an_underrun()) {
                return 1;
            }
        }
        if (fault_at > 0u && taken >= fault_at) {
            fault_at = 0;
            if (!begins_anew_after_a_fault()) {
                return 1;
            }
        }
    }
}
