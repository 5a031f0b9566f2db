/* Plays ST's HAL for the examples with a circular DMA, and the DAC by its registers: a code goes into a holding register,
 * and from there to the output with a trigger of the timer, or at once where the channel has its trigger off. With each
 * trigger the DMA fetches the next word, whatever the processor does; the processor's time passes where it reads the
 * clock. Memory has what dma_publish has written back: so the model knows each word that is new.
 *
 * The includer defines CHANNELS of the DAC, TICKS of the clock per sample, and takes_word. That gets what is output: after
 * each trigger, and where it changes without one. */
#include <stdlib.h>
#include <string.h>

#include "axis.h"
#include "stm32_hal.h"

static DAC_TypeDef dac_registers = {DAC_CR_TEN1 | DAC_CR_TEN2}; /* as CubeMX sets them up */
DMA_HandleTypeDef dma;
DAC_HandleTypeDef hdac1 = {&dac_registers, &dma};
TIM_HandleTypeDef htim2, htim6;

static void takes_word(uint32_t word, bool is_new);

static const uint32_t *buffer;
static uint32_t memory[64], length, position, now, since, taken;
static uint32_t holding[2], output[2], first[2], shown = UINT32_MAX;
static bool holding_is_new, is_new[64], half_over, round_over, clock_runs, dac_runs, dma_runs, in_interrupt;
static bool enabled[2];
static bool starved; /* the DMA is kept from fetching */

/* For so many samples from the one on, the processor does something else: before the interrupt, or in the middle of it. */
static uint32_t block_at, block_for;
static bool block_inside;
static uint32_t step_ticks = TICKS / 10u; /* between two looks at the clock */

static uint32_t bit(uint32_t channel, uint32_t bit_of_first)
{
    return bit_of_first << (channel == 0u ? 0u : 16u);
}

/* What the registers make of themselves. A pin floats while its channel is off: once it is on it must stay so. */
static void settle(void)
{
    bool all = true;
    uint32_t word = 0;
    for (uint32_t k = 0; k < CHANNELS; k++) {
        bool on = (dac_registers.CR & bit(k, DAC_CR_EN1)) != 0u;
        if (enabled[k] && !on) {
            exit(6);
        }
        if (on && (dac_registers.CR & bit(k, DAC_CR_TEN1)) == 0u) {
            output[k] = holding[k];
        }
        if (on && !enabled[k]) {
            first[k] = output[k];
        }
        if (shown == UINT32_MAX && on && output[k] != first[k]) {
            exit(7); /* while it waits for the other channel */
        }
        enabled[k] = on;
        all = all && on;
        word |= output[k] << 16u * k;
    }
    if (all && word != shown) {
        shown = word;
        takes_word(word, true);
    }
}

/* The DMA's next word goes into the holding registers. */
static void fetch(void)
{
    uint32_t word = memory[position];
    holding[0] = word & 0xFFFFu;
    holding[1] = word >> 16;
    holding_is_new = is_new[position];
    is_new[position] = false;
    position++;
    half_over = half_over || position == length / 2u;
    if (position == length) {
        position = 0;
        round_over = true;
    }
}

static void trigger(void)
{
    bool fresh = holding_is_new;
    shown = 0;
    for (uint32_t k = 0; k < CHANNELS; k++) {
        output[k] = holding[k];
        shown |= output[k] << 16u * k;
    }
    holding_is_new = false;
    taken++;
    if (dma_runs && (dac_registers.CR & DAC_CR_DMAEN1) != 0u && !starved) {
        fetch();
    }
    takes_word(shown, fresh);
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

static HAL_StatusTypeDef start_dma(const DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data, uint32_t words)
{
    if (dma_runs) {
        return HAL_ERROR;
    }
    buffer = data;
    length = words;
    position = 0;
    half_over = round_over = false;
    dma_runs = true;
    dac_registers.CR |= DAC_CR_DMAEN1 | DAC_CR_EN1 | (CHANNELS == 2u ? DAC_CR_EN2 : 0u);
    settle();
    return dac == &hdac1 && channel == DAC_CHANNEL_1 && words <= 64u && (uintptr_t)data % 32u == 0u ? HAL_OK : HAL_ERROR;
}

HAL_StatusTypeDef HAL_DAC_Start_DMA(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data, uint32_t words,
                                    uint32_t alignment)
{
    return CHANNELS == 1u && alignment == DAC_ALIGN_12B_R ? start_dma(dac, channel, data, words) : HAL_ERROR;
}

HAL_StatusTypeDef HAL_DACEx_DualStart_DMA(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data, uint32_t words,
                                          uint32_t alignment)
{
    return CHANNELS == 2u && alignment == DAC_ALIGN_12B_R ? start_dma(dac, channel, data, words) : HAL_ERROR;
}

HAL_StatusTypeDef HAL_DMA_Abort(DMA_HandleTypeDef *handle)
{
    bool ran = dma_runs;
    dma_runs = half_over = round_over = false;
    return handle == &dma && ran ? HAL_OK : HAL_ERROR;
}

HAL_StatusTypeDef HAL_DAC_Start(DAC_HandleTypeDef *dac, uint32_t channel)
{
    settle(); /* registers may have been written before */
    dac_registers.CR |= bit(channel, DAC_CR_EN1);
    settle();
    return dac == &hdac1 ? HAL_OK : HAL_ERROR;
}

HAL_StatusTypeDef HAL_DAC_SetValue(DAC_HandleTypeDef *dac, uint32_t channel, uint32_t alignment, uint32_t data)
{
    settle();
    holding[channel == DAC_CHANNEL_2 ? 1 : 0] = data;
    holding_is_new = true;
    settle();
    return dac == &hdac1 && alignment == DAC_ALIGN_12B_R && !dac_runs ? HAL_OK : HAL_ERROR;
}

uint32_t HAL_DAC_GetValue(const DAC_HandleTypeDef *dac, uint32_t channel)
{
    settle();
    return dac == &hdac1 ? output[channel == DAC_CHANNEL_2 ? 1 : 0] : UINT32_MAX;
}

void tim_enable(const TIM_HandleTypeDef *timer)
{
    if (timer != &htim2) {
        exit(4);
    }
    clock_runs = true;
}

/* The first trigger comes a period later. */
HAL_StatusTypeDef HAL_TIM_Base_Start(TIM_HandleTypeDef *timer)
{
    settle();
    if (timer != &htim6 || dac_runs || !dma_runs || !clock_runs) {
        return HAL_ERROR;
    }
    dac_runs = true;
    since = now;
    return HAL_OK;
}

HAL_StatusTypeDef HAL_TIM_Base_Stop(TIM_HandleTypeDef *timer)
{
    dac_runs = false;
    return timer == &htim6 ? HAL_OK : HAL_ERROR;
}

/* As HAL_DAC_IRQHandler, where a trigger has come before the DMA has fetched. With `late` the DMA fetches all the same, as
 * soon as it can. */
static void underrun_interrupt(bool late)
{
    dac_registers.CR &= ~DAC_CR_DMAEN1;
    if (late) {
        fetch();
    }
    HAL_DAC_DMAUnderrunCallbackCh1(&hdac1);
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
