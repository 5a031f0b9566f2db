/* STM32G4, HAL, two axes: a timer triggers both channels of the chip's DAC (12 bits), and one circular DMA fetches the codes
 * of both as one word. So both outputs change at the same moment.
 *
 * CubeMX sets up: DAC1 channels 1 and 2 with the trigger of TIM6; for channel 1 a DMA, circular, from memory in words, with
 * its interrupt; TIM6 with update events at RATE_HZ, and TIM2 counting up over all of its 32 bits at CLOCK_HZ. Each axis is
 * a C file of yours. Your main calls run_axes. */
#include "stm32g4xx_hal.h"

#include "circular.h" /* behind the chip's header */

#define RATE_HZ 1000u
#define CLOCK_HZ 1000000u
#define HALF 16u /* samples; what is computed now is output at most two halves later */

extern DAC_HandleTypeDef hdac1; /* made by CubeMX */
extern TIM_HandleTypeDef htim2, htim6;
extern axis_t axis_x, axis_y; /* yours: on channel 1 and on channel 2 */

bool run_axes(void);

static uint32_t words[2u * HALF] DMA_BUFFER;

static uint32_t words_left(void)
{
    return __HAL_DMA_GET_COUNTER(hdac1.DMA_Handle1);
}

static uint32_t clock_ticks(void)
{
    return __HAL_TIM_GET_COUNTER(&htim2);
}

/* late_count and replayed_count say whether the processor keeps up. */
circular_t circular = {.axes = &axis_x, .words = words, .length = 2u * HALF, .margin = HALF / 4u, .left = words_left,
                       .time = clock_ticks, .ticks_per_sample = CLOCK_HZ / RATE_HZ};

/* The DMA was too slow for the DAC: the HAL has stopped it, and the DAC holds its codes. Then stop DAC
 * (HAL_DACEx_DualStop_DMA) and TIM6, and call run_axes again. */
volatile bool underrun;

/* The first half has been output. */
void HAL_DAC_ConvHalfCpltCallbackCh1(DAC_HandleTypeDef *hdac)
{
    (void)hdac;
    circular_fill(&circular);
}

/* The second half has been output. */
void HAL_DAC_ConvCpltCallbackCh1(DAC_HandleTypeDef *hdac)
{
    (void)hdac;
    circular_fill(&circular);
}

void HAL_DAC_DMAUnderrunCallbackCh1(DAC_HandleTypeDef *hdac)
{
    (void)hdac;
    underrun = true;
}

static bool has_12_bits(const axis_t *axis)
{
    return axis->params->axis->dac_bits == 12u; /* fit with --dac-bits 12 */
}

/* If an actuator is refused, its channel outputs its safe code; the other one waits at its first reference. */
bool run_axes(void)
{
    if (!has_12_bits(&axis_x) || !has_12_bits(&axis_y)) {
        return false;
    }
    underrun = false;
    axis_x.with = &axis_y; /* their references begin together */
    bool good = circular.begun || HAL_TIM_Base_Start(&htim2) == HAL_OK; /* it runs on from the first time */
    good = axis_start(&axis_x, RATE_HZ) == RDPI_OK && good;
    /* the first trigger outputs these, and fetches the first word */
    good = HAL_DAC_SetValue(&hdac1, DAC_CHANNEL_1, DAC_ALIGN_12B_R, axis_x.life.dac_code) == HAL_OK && good;
    good = HAL_DAC_SetValue(&hdac1, DAC_CHANNEL_2, DAC_ALIGN_12B_R, axis_y.life.dac_code) == HAL_OK && good;
    circular_begin(&circular);
    return HAL_DACEx_DualStart_DMA(&hdac1, DAC_CHANNEL_1, words, 2u * HALF, DAC_ALIGN_12B_R) == HAL_OK &&
           HAL_TIM_Base_Start(&htim6) == HAL_OK && good;
}
