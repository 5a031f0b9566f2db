/* STM32G4, HAL, two axes: a timer triggers both channels of the chip's DAC (12 bits), and one circular DMA fetches the codes
 * of both as one word. So both outputs change at the same moment. stm32_dac.h says what CubeMX sets up, and does it. Each
 * axis is a C file of yours. Your main calls run_axes. */
#include "stm32g4xx_hal.h"

#define DAC_AXES 2
#define RATE_HZ 1000u
#define CLOCK_HZ 1000000u
#define HALF 16u

#include "stm32_dac.h"

extern axis_t axis_x, axis_y; /* yours: on channel 1 and on channel 2 */

bool run_axes(void);
void fault_axes(void);

static bool has_12_bits(const axis_t *axis)
{
    return axis->params->axis->dac_bits == 12u; /* fit with --dac-bits 12 */
}

/* Once, and again after an underrun or a fault. */
bool run_axes(void)
{
    if (!has_12_bits(&axis_x) || !has_12_bits(&axis_y)) {
        return false;
    }
    axis_x.with = &axis_y; /* their references begin together */
    return dac_run(&axis_x);
}

/* Your emergency stop: the safe codes of both at once, until run_axes. */
void fault_axes(void)
{
    dac_fault();
}
