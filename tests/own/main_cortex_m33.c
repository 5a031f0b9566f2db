/* The rest of a firmware for examples/own/cortex_m33.c: a vector table with its SysTick_Handler, and a DAC. */
#include "triangle.h"

bool run_axis(void);
void SysTick_Handler(void);
bool write_dac(uint32_t code);

static const void *vectors[16] __attribute__((aligned(128)));

bool write_dac(uint32_t code)
{
    bool fails = frame_fails();
    dac_gets(fails ? dac_got[dac_count - 1u] : code, 0u);
    return !fails;
}

int main(void)
{
    const void *const *before = *(const void *const *volatile *)0xE000ED08u; /* VTOR */
    for (int i = 0; i < 16; i++) {
        vectors[i] = before[i];
    }
    vectors[15] = (const void *)SysTick_Handler;
    *(volatile uint32_t *)0xE000ED08u = (uint32_t)vectors;
    if (!run_axis()) {
        return 1;
    }
    for (;;) {
        __asm__ volatile("wfi");
    }
}
