/* What the examples for STM32 use of ST's HAL; main_stm32.c plays the HAL. */
#pragma once
#include <stdint.h>
typedef enum { HAL_OK, HAL_ERROR } HAL_StatusTypeDef;
typedef struct {
    int instance;
} DMA_HandleTypeDef;
typedef struct {
    DMA_HandleTypeDef *DMA_Handle1;
} DAC_HandleTypeDef;
typedef struct {
    int instance;
} TIM_HandleTypeDef;
#define DAC_CHANNEL_1 0u
#define DAC_CHANNEL_2 16u
#define DAC_ALIGN_12B_R 0u
HAL_StatusTypeDef HAL_DAC_Start_DMA(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data, uint32_t length,
                                    uint32_t alignment);
HAL_StatusTypeDef HAL_DACEx_DualStart_DMA(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data,
                                          uint32_t length, uint32_t alignment);
HAL_StatusTypeDef HAL_DAC_SetValue(DAC_HandleTypeDef *dac, uint32_t channel, uint32_t alignment, uint32_t data);
HAL_StatusTypeDef HAL_TIM_Base_Start(TIM_HandleTypeDef *timer);
void HAL_DAC_ConvHalfCpltCallbackCh1(DAC_HandleTypeDef *dac);
void HAL_DAC_ConvCpltCallbackCh1(DAC_HandleTypeDef *dac);
void HAL_DAC_DMAUnderrunCallbackCh1(DAC_HandleTypeDef *dac);
uint32_t dma_counter(const DMA_HandleTypeDef *dma); /* registers in the real HAL */
uint32_t tim_counter(const TIM_HandleTypeDef *timer);
#define __HAL_DMA_GET_COUNTER(dma) dma_counter(dma)
#define __HAL_TIM_GET_COUNTER(timer) tim_counter(timer)
#define __DCACHE_PRESENT 1U /* not on these chips: so the test knows what has been written, and when */
void SCB_CleanDCache_by_Addr(uint32_t *address, int32_t bytes);
