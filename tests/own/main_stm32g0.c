/* The rest of a firmware for examples/own/stm32g0.c. */
#include "triangle.h"

#define TICKS 1000u
#define CHANNELS 1u
#include "stm32_model.h"

bool run_axis(void);

static void takes_word(uint32_t word, bool fresh)
{
    if (!fresh) {
        exit(5);
    }
    dac_gets(word, 2u * length); /* all of what was computed by the 400th reference has surely been output */
}

int main(void)
{
    if (!run_axis()) {
        return 1;
    }
    for (;;) {
        interrupts();
    }
}
