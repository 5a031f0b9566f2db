/* STM32G0 with a DAC (G051 and larger), HAL: a timer triggers the chip's DAC (12 bits), and a circular DMA fetches the
 * codes. The processor computes half a buffer at a time, while the other half is output.
 *
 * CubeMX sets up: DAC channel 1 with the timer's trigger output, its DMA circular from memory in words, the DMA's
 * interrupt, TIM6 with update events at RATE_HZ, and TIM2 counting up over all of its 32 bits at CLOCK_HZ. Your main calls
 * run_axis. */
#include "stm32g0xx_hal.h"

#include "circular.h" /* behind the chip's header */
#include "rdpi_params.h" /* for its DAC bits */

#if RDPI_PARAMS_DAC_BITS != 12
#error "fit with --dac-bits 12"
#endif

#define RATE_HZ 1000u
#define CLOCK_HZ 1000000u
#define HALF 16u /* samples; what is computed now is output at most two halves later */

extern DAC_HandleTypeDef hdac1; /* made by CubeMX */
extern TIM_HandleTypeDef htim2, htim6;
extern axis_t axis; /* yours */

bool run_axis(void);

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
circular_t circular = {.axes = &axis, .words = words, .length = 2u * HALF, .margin = HALF / 4u, .left = words_left,
                       .time = clock_ticks, .ticks_per_sample = CLOCK_HZ / RATE_HZ};

/* The DMA was too slow for the DAC: the HAL has stopped it, and the DAC holds a code. Then stop DAC (HAL_DAC_Stop_DMA) and
 * TIM6, and call run_axis again. */
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

/* If the actuator is refused, the DMA outputs the safe code. */
bool run_axis(void)
{
    underrun = false;
    bool good = circular.begun || HAL_TIM_Base_Start(&htim2) == HAL_OK; /* it runs on from the first time */
    good = axis_start(&axis, RATE_HZ) == RDPI_OK && good;
    /* the first trigger outputs this, and fetches the first word */
    good = HAL_DAC_SetValue(&hdac1, DAC_CHANNEL_1, DAC_ALIGN_12B_R, axis.life.dac_code) == HAL_OK && good;
    circular_begin(&circular);
    return HAL_DAC_Start_DMA(&hdac1, DAC_CHANNEL_1, words, 2u * HALF, DAC_ALIGN_12B_R) == HAL_OK &&
           HAL_TIM_Base_Start(&htim6) == HAL_OK && good;
}
