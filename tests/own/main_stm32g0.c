/* Plays ST's HAL for examples/own/stm32g0.c: a circular DMA that fetches code by code. */
#include "stm32g0xx_hal.h"
#include "triangle.h"
#include <string.h>

DAC_HandleTypeDef hdac1;
TIM_HandleTypeDef htim6;
static const uint32_t *buffer;
static uint32_t count;

bool run_axis(void);

#ifdef CACHED
/* Memory, and what the cache has written back to it: nothing until the processor asks. */
static struct {
    const uint8_t *address;
    uint32_t words[8];
} memory[32];

static unsigned line_of(const void *address)
{
    const uint8_t *line = (const uint8_t *)((uintptr_t)address & ~(uintptr_t)31u);
    unsigned k = 0;
    while (k < 31u && memory[k].address != NULL && memory[k].address != line) {
        k++;
    }
    memory[k].address = line;
    return k;
}

/* As of CMSIS 4.30, which counts lines from the address that it is given. */
void SCB_CleanDCache_by_Addr(uint32_t *address, int32_t bytes)
{
    for (; bytes > 0; bytes -= 32, address += 8) {
        unsigned line = line_of(address);
        memcpy(memory[line].words, memory[line].address, 32);
    }
}

static uint32_t fetch(const uint32_t *address)
{
    return memory[line_of(address)].words[(uintptr_t)address / 4u % 8u];
}
#else
static uint32_t fetch(const uint32_t *address)
{
    return *address;
}
#endif

HAL_StatusTypeDef HAL_DAC_Start_DMA(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data, uint32_t length,
                                    uint32_t alignment)
{
    buffer = data;
    count = length;
    return dac == &hdac1 && channel == DAC_CHANNEL_1 && alignment == DAC_ALIGN_12B_R ? HAL_OK : HAL_ERROR;
}

HAL_StatusTypeDef HAL_TIM_Base_Start(TIM_HandleTypeDef *timer)
{
    return timer == &htim6 && buffer != NULL ? HAL_OK : HAL_ERROR;
}

int main(void)
{
    if (!run_axis()) {
        return 1;
    }
    for (uint32_t at = 0;; at = (at + 1u) % count) {
        if (at == count / 2u) {
            HAL_DAC_ConvHalfCpltCallbackCh1(&hdac1);
        } else if (at == 0u && dac_count > 0u) {
            HAL_DAC_ConvCpltCallbackCh1(&hdac1);
        }
        dac_gets(fetch(&buffer[at]), 2u * count); /* all of what was computed by the 400th reference has surely been output */
    }
}
