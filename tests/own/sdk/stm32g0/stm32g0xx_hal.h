/* What examples/own/stm32g0.c uses of ST's HAL; main_stm32g0.c plays the HAL. */
#pragma once
#include <stdint.h>
typedef enum { HAL_OK, HAL_ERROR } HAL_StatusTypeDef;
typedef struct {
    int instance;
} DAC_HandleTypeDef;
typedef struct {
    int instance;
} TIM_HandleTypeDef;
#define DAC_CHANNEL_1 0u
#define DAC_ALIGN_12B_R 0u
HAL_StatusTypeDef HAL_DAC_Start_DMA(DAC_HandleTypeDef *dac, uint32_t channel, const uint32_t *data, uint32_t length,
                                    uint32_t alignment);
HAL_StatusTypeDef HAL_TIM_Base_Start(TIM_HandleTypeDef *timer);
void HAL_DAC_ConvHalfCpltCallbackCh1(DAC_HandleTypeDef *dac);
void HAL_DAC_ConvCpltCallbackCh1(DAC_HandleTypeDef *dac);
void HAL_DAC_DMAUnderrunCallbackCh1(DAC_HandleTypeDef *dac);
#ifdef CACHED /* as of a chip with a Cortex-M7 */
#define __CORTEX_M 7U
#define __DCACHE_PRESENT 1U
void SCB_CleanDCache_by_Addr(uint32_t *address, int32_t bytes);
#endif
