/* What the examples for STM32 use of ST's HAL; stm32_model.h plays the HAL. */
#pragma once
#include <stdint.h>
typedef enum { HAL_OK, HAL_ERROR } HAL_StatusTypeDef;
typedef struct {
    int instance;
} DMA_HandleTypeDef;
typedef struct {
    volatile uint32_t CR;
} DAC_TypeDef;
typedef struct {
    DAC_TypeDef *Instance;
    DMA_HandleTypeDef *DMA_Handle1;
} DAC_HandleTypeDef;
typedef struct {
    int instance;
} TIM_HandleTypeDef;
#define DAC_CHANNEL_1 0u
#define DAC_CHANNEL_2 16u
#define DAC_ALIGN_12B_R 0u
#define DAC_CR_EN1 (1u << 0) /* these bits: RM0444 and RM0440, DAC_CR */
#define DAC_CR_TEN1 (1u << 1)
#define DAC_CR_DMAEN1 (1u << 12)
#define DAC_CR_EN2 (1u << 16)
#define DAC_CR_TEN2 (1u << 17)
#define SET_BIT(reg, bits) ((reg) |= (bits))
#define CLEAR_BIT(reg, bits) ((reg) &= ~(bits))
HAL_StatusTypeDef HAL_DAC_Start(DAC_HandleTypeDef *dac, uint32_t channel);
HAL_StatusTypeDef HAL_DAC_Start_DMA(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data, uint32_t length,
                                    uint32_t alignment);
HAL_StatusTypeDef HAL_DACEx_DualStart_DMA(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data,
                                          uint32_t length, uint32_t alignment);
HAL_StatusTypeDef HAL_DAC_SetValue(DAC_HandleTypeDef *dac, uint32_t channel, uint32_t alignment, uint32_t data);
uint32_t HAL_DAC_GetValue(const DAC_HandleTypeDef *dac, uint32_t channel);
HAL_StatusTypeDef HAL_DMA_Abort(DMA_HandleTypeDef *dma);
HAL_StatusTypeDef HAL_TIM_Base_Start(TIM_HandleTypeDef *timer);
HAL_StatusTypeDef HAL_TIM_Base_Stop(TIM_HandleTypeDef *timer);
void HAL_DAC_ConvHalfCpltCallbackCh1(DAC_HandleTypeDef *dac);
void HAL_DAC_ConvCpltCallbackCh1(DAC_HandleTypeDef *dac);
void HAL_DAC_DMAUnderrunCallbackCh1(DAC_HandleTypeDef *dac);
uint32_t dma_counter(const DMA_HandleTypeDef *dma); /* registers in the real HAL */
uint32_t tim_counter(const TIM_HandleTypeDef *timer);
void tim_enable(const TIM_HandleTypeDef *timer);
#define __HAL_TIM_ENABLE(timer) tim_enable(timer)
#define __HAL_DMA_GET_COUNTER(dma) dma_counter(dma)
#define __HAL_TIM_GET_COUNTER(timer) tim_counter(timer)
#define __DCACHE_PRESENT 1U /* not on these chips: so the test knows what has been written, and when */
void SCB_CleanDCache_by_Addr(uint32_t *address, int32_t bytes);
