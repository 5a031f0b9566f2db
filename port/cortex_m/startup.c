/* From reset to main, and what is left when main or the program has come to its end. Cortex-M0 to M7; no vendor file.
 * Of the linker script: where the stack ends and what has to be copied and cleared. */
#include <stdint.h>

#include "../include/rdpi_port.h" /* by its place: not every port's folder of headers is known here */
#include "cortex_m.h"

extern uint32_t stack_end[], data_begin[], data_end[], data_image[], bss_begin[], bss_end[];

int main(void);
void reset(void);
void stay_safe(void);
void SystemInit(void);

/* Clocks, before variables have values; a port's function of this name takes the place of this one. */
__attribute__((weak)) void SystemInit(void)
{
}

void reset(void)
{
#if defined(__ARM_FP)
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* CPACR, Armv7-M B3.2.20: the FPU is off after reset */
    __asm__ volatile("dsb\n\tisb" ::: "memory");
#endif
    SystemInit();
    const uint32_t *from = data_image;
    for (uint32_t *to = data_begin; to < data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = bss_begin; to < bss_end;) {
        *to++ = 0;
    }
    (void)main();
    for (;;) { /* interrupts go on: the timer, what is still to be sent */
        rdpi_port_idle();
    }
}

__attribute__((used)) void stay_safe(void)
{
    rdpi_port_safe();
    for (;;) {
        cortex_m_sleep();
    }
}

/* A fault, or an exception that nothing here raises: no interrupt runs any more, and the DAC gets its safe code. The
 * stack begins anew: to have left its memory may have been the fault, and a second one in here would lock the
 * processor up. */
__attribute__((naked)) static void stop(void)
{
    __asm__ volatile("cpsid i\n\tldr r0, =stack_end\n\tmov sp, r0\n\tldr r0, =stay_safe\n\tbx r0");
}

/* The interrupts' come behind these, from the port. */
__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    cortex_m_handler_t handlers[15];
} vectors = {
    stack_end,
    {reset, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop, stop},
};
