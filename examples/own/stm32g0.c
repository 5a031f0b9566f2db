/* STM32G0 with a DAC (G051 and larger), HAL: a timer triggers the chip's DAC (12 bits), and a circular DMA fetches the
 * codes. stm32_dac.h says what CubeMX sets up, and does it. Your main calls run_axis. */
#include "stm32g0xx_hal.h"

#define DAC_AXES 1
#define RATE_HZ 1000u
#define CLOCK_HZ 1000000u
#define HALF 16u

#include "rdpi_params.h" /* for its DAC bits */
#include "stm32_dac.h"

#if RDPI_PARAMS_DAC_BITS != 12
#error "fit with --dac-bits 12"
#endif

extern axis_t axis; /* yours */

bool run_axis(void);
void fault_axis(void);

/* Once, and again after an underrun or a fault. */
bool run_axis(void)
{
    return dac_run(&axis);
}

/* Your emergency stop: the safe code at once, until run_axis. */
void fault_axis(void)
{
    dac_fault();
}
