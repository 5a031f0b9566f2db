/* Plays ST's HAL for the examples with a circular DMA. The DMA takes a word with each trigger of the timer, whatever the
 * processor does; the processor's time passes where it reads the clock. Memory has what dma_publish has written back: so
 * the model knows each word that is new. The includer defines takes_word and TICKS, of the clock per sample. */
#include <stdlib.h>
#include <string.h>

#include "axis.h"
#include "stm32_hal.h"

DMA_HandleTypeDef dma;
DAC_HandleTypeDef hdac1 = {&dma};
TIM_HandleTypeDef htim2, htim6;

static void takes_word(uint32_t word, bool is_new);

static const uint32_t *buffer;
static uint32_t memory[64], length, position, now, since, taken;
static uint32_t first[2]; /* what the first trigger outputs */
static bool is_new[64], half_over, round_over, clock_runs, dac_runs, in_interrupt;

/* For so many samples from the one on, the processor does something else: before the interrupt, or in the middle of it. */
static uint32_t block_at, block_for;
static bool block_inside;
static uint32_t step_ticks = TICKS / 10u; /* between two looks at the clock */

static void trigger(void)
{
    uint32_t word = memory[position];
    bool fresh = is_new[position];
    is_new[position] = false;
    position++;
    half_over = half_over || position == length / 2u;
    if (position == length) {
        position = 0;
        round_over = true;
    }
    taken++;
    takes_word(word, fresh);
}

static void pass(uint32_t ticks)
{
    for (; ticks > 0u; ticks--) {
        now++;
        if (dac_runs && (now - since) % TICKS == 0u) {
            trigger();
        }
    }
}

uint32_t tim_counter(const TIM_HandleTypeDef *timer)
{
    if (timer != &htim2 || !clock_runs) {
        exit(4);
    }
    pass(dac_runs ? step_ticks : 0u);
    if (block_inside && in_interrupt && block_for > 0u && taken >= block_at) {
        uint32_t samples = block_for;
        block_for = 0;
        pass(samples * TICKS);
    }
    return now;
}

uint32_t dma_counter(const DMA_HandleTypeDef *handle)
{
    if (handle != &dma) {
        exit(4);
    }
    return length - position;
}

/* As of CMSIS 4.30, which counts lines from the address that it is given: the last of the bytes was written. */
void SCB_CleanDCache_by_Addr(uint32_t *address, int32_t bytes)
{
    static const uint32_t *start;
    if (start == NULL) {
        start = address; /* the first word of the buffer is written first */
    }
    size_t written = (size_t)(address - start) + (size_t)bytes / 4u - 1u;
    if (written >= 64u || (uintptr_t)address % 32u != 0u) {
        exit(4);
    }
    memory[written] = start[written];
    is_new[written] = true;
}

static HAL_StatusTypeDef start_dma(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data, uint32_t words)
{
    buffer = data;
    length = words;
    position = 0;
    half_over = round_over = false;
    return dac == &hdac1 && channel == DAC_CHANNEL_1 && words <= 64u && (uintptr_t)data % 32u == 0u ? HAL_OK : HAL_ERROR;
}

HAL_StatusTypeDef HAL_DAC_Start_DMA(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data, uint32_t words,
                                    uint32_t alignment)
{
    return alignment == DAC_ALIGN_12B_R ? start_dma(dac, channel, data, words) : HAL_ERROR;
}

HAL_StatusTypeDef HAL_DACEx_DualStart_DMA(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data, uint32_t words,
                                          uint32_t alignment)
{
    return alignment == DAC_ALIGN_12B_R ? start_dma(dac, channel, data, words) : HAL_ERROR;
}

HAL_StatusTypeDef HAL_DAC_SetValue(DAC_HandleTypeDef *dac, uint32_t channel, uint32_t alignment, uint32_t data)
{
    first[channel == DAC_CHANNEL_2 ? 1 : 0] = data;
    return dac == &hdac1 && alignment == DAC_ALIGN_12B_R && !dac_runs ? HAL_OK : HAL_ERROR;
}

HAL_StatusTypeDef HAL_TIM_Base_Start(TIM_HandleTypeDef *timer)
{
    if (timer == &htim2) {
        clock_runs = true;
    } else {
        dac_runs = true;
        since = now;
        takes_word(first[1] << 16 | first[0], true);
    }
    return timer == &htim2 || (timer == &htim6 && buffer != NULL && clock_runs) ? HAL_OK : HAL_ERROR;
}

/* As HAL_DMA_IRQHandler: of two flags that are set, that of the half comes first. */
static void interrupts(void)
{
    pass(TICKS / 10u);
    if (!block_inside && taken >= block_at && taken < block_at + block_for) {
        return;
    }
    in_interrupt = true;
    if (half_over) {
        half_over = false;
        HAL_DAC_ConvHalfCpltCallbackCh1(&hdac1);
    } else if (round_over) {
        round_over = false;
        HAL_DAC_ConvCpltCallbackCh1(&hdac1);
    } else {
        /* none */
    }
    in_interrupt = false;
}
