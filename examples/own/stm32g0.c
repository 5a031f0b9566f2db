/* STM32G0 with a DAC (G051 and larger), HAL: a timer triggers the chip's DAC (12 bits), and a circular DMA fetches the
 * codes. The processor computes half a buffer at a time, while the other half is output.
 *
 * CubeMX sets up: DAC channel 1 with the timer's trigger output, its DMA circular from memory in words, the DMA's
 * interrupt, and TIM6 with update events at RATE_HZ. Your main calls run_axis. */
#include "stm32g0xx_hal.h"

#include "axis.h"
#include "dma.h" /* behind the chip's header */

#if RDPI_PARAMS_DAC_BITS != 12
#error "fit with --dac-bits 12"
#endif

#define RATE_HZ 1000
#define HALF 16u /* samples; what is computed now is output at most two halves later */

extern DAC_HandleTypeDef hdac1; /* made by CubeMX */
extern TIM_HandleTypeDef htim6;

bool run_axis(void);

static uint32_t codes[2u * HALF] DMA_BUFFER;
static volatile bool late; /* the DAC took a code twice: the processor did not keep up */

static void fill(uint32_t *half)
{
    for (uint32_t i = 0; i < HALF; i++) {
        half[i] = axis_next(0);
    }
    dma_publish(half, HALF * sizeof *half); /* for a chip with a data cache; not this one */
}

/* The first half has been output. */
void HAL_DAC_ConvHalfCpltCallbackCh1(DAC_HandleTypeDef *hdac)
{
    (void)hdac;
    fill(codes);
}

/* The second half has been output. */
void HAL_DAC_ConvCpltCallbackCh1(DAC_HandleTypeDef *hdac)
{
    (void)hdac;
    fill(codes + HALF);
}

/* After this the HAL's DMA has stopped, and the DAC holds its last code. */
void HAL_DAC_DMAUnderrunCallbackCh1(DAC_HandleTypeDef *hdac)
{
    (void)hdac;
    late = true;
}

bool run_axis(void)
{
    if (axis_start(RATE_HZ) != RDPI_OK) {
        return false;
    }
    fill(codes);
    fill(codes + HALF);
    return HAL_DAC_Start_DMA(&hdac1, DAC_CHANNEL_1, codes, 2u * HALF, DAC_ALIGN_12B_R) == HAL_OK &&
           HAL_TIM_Base_Start(&htim6) == HAL_OK;
}
