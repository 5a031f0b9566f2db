/* One or two axes on the DAC of an STM32 (12 bits), by ST's HAL: a timer triggers the DAC, and a circular DMA fetches
 * the codes. The processor computes half a buffer at a time, while the other half is output. For the one C file that
 * drives the DAC, such as stm32g0.c or stm32g4_two.c. Copy it with circular.h and dma.h. Before the include come the
 * chip's header, and
 *
 *     DAC_AXES   1: channel 1; 2: channels 1 and 2, whose codes are one word, so that both outputs change together
 *     RATE_HZ    samples per second
 *     CLOCK_HZ   of TIM2
 *     HALF       samples in half a buffer; what is computed now is output at most two halves later
 *
 * CubeMX sets up: DAC1, its channels with the trigger of TIM6; for channel 1 a DMA, circular, from memory in words, with
 * its interrupt; TIM6 with update events at RATE_HZ, and TIM2 counting up over all of its 32 bits at CLOCK_HZ.
 *
 * Nothing here switches the DAC off, as HAL_DAC_Stop_DMA would: its pin would float. */
#ifndef STM32_DAC_H
#define STM32_DAC_H

#include "circular.h"

#if DAC_AXES == 2
#define DAC_TRIGGERS (DAC_CR_TEN1 | DAC_CR_TEN2)
#define DAC_START_DMA HAL_DACEx_DualStart_DMA
#else
#define DAC_TRIGGERS DAC_CR_TEN1
#define DAC_START_DMA HAL_DAC_Start_DMA
#endif

extern DAC_HandleTypeDef hdac1; /* made by CubeMX */
extern TIM_HandleTypeDef htim2, htim6;

static const uint32_t dac_channels[DAC_AXES] = {
    DAC_CHANNEL_1,
#if DAC_AXES == 2
    DAC_CHANNEL_2,
#endif
};
static uint32_t words[2u * HALF] DMA_BUFFER;
static bool dac_is_on;

static uint32_t words_left(void)
{
    return __HAL_DMA_GET_COUNTER(hdac1.DMA_Handle1);
}

static uint32_t clock_ticks(void)
{
    return __HAL_TIM_GET_COUNTER(&htim2);
}

/* late_count and replayed_count say whether the processor keeps up. */
circular_t circular = {.words = words, .length = 2u * HALF, .margin = HALF / 4u, .left = words_left, .time = clock_ticks,
                       .ticks_per_sample = CLOCK_HZ / RATE_HZ};

/* The DMA was too slow for the DAC: the HAL has stopped it, and the DAC holds its codes. Call dac_run again. */
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

/* The DAC holds what it outputs. */
static void dac_stop(void)
{
    (void)HAL_TIM_Base_Stop(&htim6);
    CLEAR_BIT(hdac1.Instance->CR, DAC_CR_DMAEN1);
    (void)HAL_DMA_Abort(hdac1.DMA_Handle1); /* an error if it had not been started */
}

/* The axes go on from what is output now. That is not the code which was computed last, nor surely the one that the DMA
 * fetched last. */
static void dac_look(axis_t *axes)
{
    uint32_t codes[DAC_AXES];
    for (uint32_t k = 0; k < DAC_AXES; k++) {
        codes[k] = HAL_DAC_GetValue(&hdac1, dac_channels[k]);
    }
    axis_replayed(axes, codes);
}

/* The next trigger outputs the latest codes of the axes; without trigger they come out at once. */
static bool dac_load(const axis_t *axes)
{
    bool good = true;
    const axis_t *axis = axes;
    for (uint32_t k = 0; k < DAC_AXES && axis != NULL; k++, axis = axis->with) {
        good = HAL_DAC_SetValue(&hdac1, dac_channels[k], DAC_ALIGN_12B_R, axis->life.dac_code) == HAL_OK && good;
    }
    return good;
}

/* Outputs the latest codes of the axes now, while TIM6 stands. A channel that is switched on with its trigger on would
 * output code 0 until the first one. */
static bool dac_output(const axis_t *axes)
{
    bool good = dac_load(axes); /* in place of a word that the DMA has fetched, which would come out without trigger */
    CLEAR_BIT(hdac1.Instance->CR, DAC_TRIGGERS);
    good = dac_load(axes) && good;
    for (uint32_t k = 0; k < DAC_AXES; k++) {
        good = HAL_DAC_Start(&hdac1, dac_channels[k]) == HAL_OK && good;
    }
    SET_BIT(hdac1.Instance->CR, DAC_TRIGGERS);
    return good;
}

/* Starts the axes, the first of which is given, or begins anew after an underrun or a fault: from what is output, without
 * a step. If an actuator is refused, its channel outputs its safe code; another one waits at its first reference. From main
 * or a task. */
static bool dac_run(axis_t *axes)
{
    circular.axes = axes;
    if (dac_is_on) {
        dac_stop();
        dac_look(axes);
    }
    underrun = false;
    __HAL_TIM_ENABLE(&htim2); /* it runs on from the first time */
    bool good = axis_start(axes, RATE_HZ) == RDPI_OK;
    dac_is_on = dac_output(axes);
    circular_begin(&circular);
    return DAC_START_DMA(&hdac1, DAC_CHANNEL_1, words, 2u * HALF, DAC_ALIGN_12B_R) == HAL_OK &&
           HAL_TIM_Base_Start(&htim6) == HAL_OK && dac_is_on && good;
}

/* Emergency: outputs the safe codes at once, in one step, and until dac_run is called again. After axis_fault alone the
 * codes in the buffer would still come out. From main, a task, or an interrupt that does not preempt that of the DMA. */
static void dac_fault(void)
{
    dac_stop();
    if (circular.axes != NULL) {
        axis_fault(circular.axes);
        (void)axis_next(circular.axes, 0); /* in which the axes obey */
        (void)dac_output(circular.axes);
    }
}

#endif
