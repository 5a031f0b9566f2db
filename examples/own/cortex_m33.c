/* A bare Cortex-M33 with floating-point unit: its own SysTick, no vendor's library. Your start-up code calls run_axis,
 * your vector table names SysTick_Handler, and you write write_dac.
 *
 * Registers: Armv8-M Architecture Reference Manual (DDI 0553): SYST_CSR, SYST_RVR, SYST_CVR, CPACR. */
#include "axis.h"
#include "rdpi_params.h" /* for its DAC bits */

#if RDPI_PARAMS_DAC_BITS == 0
#error "fit with --dac-bits, the bits of your DAC"
#endif

#define RATE_HZ 1000u
#define CORE_HZ 20000000u

#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)
#define CPACR (*(volatile uint32_t *)0xE000ED88u)

bool write_dac(uint32_t code); /* yours; false if the DAC has not got the code and outputs the one before */
void SysTick_Handler(void);
bool run_axis(void);
extern axis_t axis; /* yours */

static uint32_t code, lost;

/* The core saves the floating-point registers by itself. SysTick does not count what it misses: this handler must take
 * less than a period. */
void SysTick_Handler(void)
{
    if (write_dac(code)) {
        code = axis_next(&axis, lost);
        lost = 0;
    } else {
        lost++; /* the code is sent again: the library counts on every code that it has returned */
    }
}

bool run_axis(void)
{
    CPACR |= 0xFu << 20; /* the unit is off after reset; your start-up code may have done it */
    __asm__ volatile("dsb\n\tisb" ::: "memory");
    rdpi_status_t status = axis_start(&axis, RATE_HZ);
    code = axis.life.dac_code; /* the safe one */
    if (status != RDPI_OK) {
        (void)write_dac(code);
        return false;
    }
    SYST_RVR = CORE_HZ / RATE_HZ - 1u;
    SYST_CVR = 0u;
    SYST_CSR = 7u; /* core clock, interrupt, on */
    return true;
}
