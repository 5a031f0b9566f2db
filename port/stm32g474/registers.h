/* The registers of the STM32G474 that stm32g474.c uses, and no others. With RDPI_STM32G474_FAKE they are blocks in RAM,
 * and the test that defines it brings its own functions for what reads, writes and enables.
 *
 *     what                                                                        sources
 *     base addresses   FLASH, RCC, PWR, TIM2, TIM6, GPIOA, DAC1                   [2] [3]; FLASH, RCC, GPIOA also [5]
 *     offsets          FLASH, RCC, PWR                                            [2] [3]; RCC CFGR, PLLCFGR also [1]
 *                      TIM2, TIM6, DAC1                                           [2] [4]; DAC MCR also [1] [3]
 *                      GPIO MODER (PA0 and PA4 are analogue after reset)          [1] [2]
 *                      GPIO OSPEEDR, AFRL; PA2 USART2_TX = AF7; PA0 ADC1 IN1      [14]
 *                      ADC, ADC common                                            [2]
 *                      USART                                                      [13]
 *     base addresses   ADC1, ADC common, USART2                                   [14]
 *     FLASH_ACR        LATENCY 3:0, the number of wait states                     [1] [3]
 *                      four for 136 .. 170 MHz in boost mode (RM0440, table 9)    [1] [3] [6] [8]
 *     RCC_CR           HSION 8, HSIRDY 10, PLLON 24, PLLRDY 25                    [1] [3] [7]
 *     RCC_CFGR         SW 1:0, SWS 3:2, HPRE 7:4, PPRE1 10:8 and their values     [1] [3]
 *     RCC_PLLCFGR      PLLSRC 1:0, PLLM 7:4, PLLN 14:8, PLLREN 24, PLLR 26:25     [1] [3]
 *                      16 MHz / 4 * 85 / 2 = 170 MHz                              [3] [6]
 *     RCC_AHB2ENR      GPIOAEN 0, ADC12EN 13, DAC1EN 16                           [1] [3]; ADC12EN [13]
 *     RCC_APB1ENR1     TIM2EN 0, TIM6EN 4, USART2EN 17, PWREN 28                  [3] [4]; USART2EN [13]
 *     RCC_CSR          at 0x94; RMVF 23, IWDGRSTF 29                              [2]; bits [15]
 *     RCC_AHB2RSTR     at 0x2C, APB1RSTR1 at 0x38, bits as in the enable registers [14]
 *     PWR_CR5          R1MODE 8, 0 = boost, for more than 150 MHz (table 38)      [3] [7]; [1] [6]
 *     order            AHB / 2, R1MODE, wait states, switch, 1 us, AHB / 1        [1] [8]
 *     DAC_MCR          HFSEL 15:14, 2 = AHB above 160 MHz; MODE1 2:0,             [1] [3]
 *                      0 = pin with buffer; only to be written while EN1 is 0
 *     DAC_CR           EN1 0, TEN1 1                                              [1] [3]
 *     DAC_SR           DAC1RDY 11                                                 [1] [3]
 *     TIM              CR1 CEN 0, URS 2; DIER UIE 0; SR UIF 0, cleared by 0       [4] [9]
 *                      EGR UG 0                                                   [9]
 *                      TIM2 has 32 bits                                           [4] [12]
 *                      clock of the timers = APB1's when PPRE1 does not divide    [5] [8]
 *     interrupt        TIM6_DAC is number 54                                      [2] [3]
 *                      USART2 is number 38                                        [14]
 *     ADC              CR ADEN 0, ADSTART 2, ADVREGEN 28, DEEPPWD 29, ADCAL 31    [13]
 *                      ISR ADRDY 0, EOC 2; CFGR OVRMOD 12, CONT 13                [14]; ADRDY [10]
 *                      common CCR CKMODE 17:16, 3 = AHB / 4                       [13]; value [14]
 *                      SMPR1 SMP1 5:3, 5 = 92.5 cycles; SQR1 SQ1 10:6             [10]; value [14]
 *                      order: regulator, 20 us, calibration, ADEN, ADRDY          [10] [13]
 *     USART            CR1 UE 0, TE 3, TXEIE 7; ISR TXE 7                         [13]; UE [14]
 *
 * [1] RM0440, chapters 3, 4, 6, 7, 9 and 22, in a public transcript; the PDF itself was not at hand;
 * [2] ST, github.com/STMicroelectronics/cmsis-device-g4, Include/stm32g474xx.h: structures, addresses, interrupts;
 * [3] libopencm3, stm32/g4/{memorymap,rcc,pwr,flash}.h, stm32/common/dac_common_{all,v2}.h, stm32/g4/irq.json, rcc.c;
 * [4] stm32-rs (corrected SVD), stm32g4/src/stm32g474/{tim2,tim6,dac1,rcc};
 * [5] Zephyr, dts/arm/st/g4/stm32g4.dtsi; for the clock of the timers its driver for STM32 PWM;
 * [6] R. G. Martins, clock.c for NUCLEO-G431KB, with sections and tables of RM0440: HSI16, 170 MHz;
 * [7] S. Grzegorzewski, RegistersConfig.c for the STM32G431, with bit numbers;
 * [8] clock set-up of embassy-stm32 and stm32g4xx-hal, with the words of RM0440 as comments;
 * [9] RM0456 (STM32U5), TIM6/TIM7, and SVDs of STM32F7 and STM32N6 in cmforthlib: the same timer;
 * [10] programs for STM32L4, F3 and G4 with this converter, with sections of their manuals as comments;
 * [12] ST, DS12288 Rev 6, features: two 32-bit timers, buffered DAC channels 1 MSPS;
 * [13] ST's headers of chips with the same ADC, USART and RCC, as they turn up in public projects;
 * [14] from memory of RM0440 and DS12288: to be checked against them;
 * [15] NuttX, arch/arm/src/stm32/hardware/stm32g4xxxx_rcc.h.
 *
 * Prefetch (FLASH_ACR 8) stays off as after reset; the caches are on then. Nothing was run on silicon here. */
#ifndef RDPI_STM32G474_REGISTERS_H
#define RDPI_STM32G474_REGISTERS_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    uint32_t acr;
} flash_t;

typedef struct {
    uint32_t cr, icscr, cfgr, pllcfgr, unused_10[7], ahb2rstr, unused_30[2], apb1rstr1, unused_3c[4], ahb2enr,
        unused_50[2], apb1enr1, unused_5c[14], csr;
} rcc_t;

typedef struct {
    uint32_t unused_00[32], cr5;
} pwr_t;

typedef struct {
    uint32_t cr1, unused_04[2], dier, sr, egr, unused_18[3], cnt, psc, arr;
} tim_t;

typedef struct {
    uint32_t moder, unused_04, ospeedr, unused_0c[5], afrl;
} gpio_t;

typedef struct {
    uint32_t cr, swtrigr, dhr12r1, unused_0c[10], sr, ccr, mcr;
} dac_t;

typedef struct {
    uint32_t isr, unused_04, cr, cfgr, unused_10, smpr1, unused_18[6], sqr1, unused_34[3], dr;
} adc_t;

typedef struct {
    uint32_t kr, pr, rlr, sr;
} iwdg_t;

typedef struct {
    uint32_t ccr;
} adc_common_t;

typedef struct {
    uint32_t cr1, unused_04[2], brr, unused_10[3], isr, unused_20[2], tdr;
} usart_t;

/* C99 has no _Static_assert: an array of -1 elements does not compile. */
#define AT(type, field, offset) typedef char type##_##field##_at[offsetof(type, field) == (offset) ? 1 : -1]
AT(flash_t, acr, 0x00);
AT(rcc_t, cr, 0x00);
AT(rcc_t, cfgr, 0x08);
AT(rcc_t, pllcfgr, 0x0C);
AT(rcc_t, ahb2rstr, 0x2C);
AT(rcc_t, apb1rstr1, 0x38);
AT(rcc_t, ahb2enr, 0x4C);
AT(rcc_t, apb1enr1, 0x58);
AT(rcc_t, csr, 0x94);
AT(pwr_t, cr5, 0x80);
AT(tim_t, cr1, 0x00);
AT(tim_t, dier, 0x0C);
AT(tim_t, sr, 0x10);
AT(tim_t, egr, 0x14);
AT(tim_t, cnt, 0x24);
AT(tim_t, psc, 0x28);
AT(tim_t, arr, 0x2C);
AT(gpio_t, moder, 0x00);
AT(dac_t, cr, 0x00);
AT(dac_t, dhr12r1, 0x08);
AT(dac_t, sr, 0x34);
AT(dac_t, mcr, 0x3C);
AT(gpio_t, ospeedr, 0x08);
AT(gpio_t, afrl, 0x20);
AT(adc_t, cr, 0x08);
AT(adc_t, cfgr, 0x0C);
AT(adc_t, smpr1, 0x14);
AT(adc_t, sqr1, 0x30);
AT(adc_t, dr, 0x40);
AT(usart_t, brr, 0x0C);
AT(usart_t, isr, 0x1C);
AT(usart_t, tdr, 0x28);
AT(iwdg_t, sr, 0x0C);
#undef AT

#define TIM2_BASE 0x40000000u
#define TIM6_BASE 0x40001000u
#define IWDG_BASE 0x40003000u
#define USART2_BASE 0x40004400u
#define PWR_BASE 0x40007000u
#define RCC_BASE 0x40021000u
#define FLASH_BASE 0x40022000u
#define GPIOA_BASE 0x48000000u
#define ADC1_BASE 0x50000000u
#define ADC_COMMON_BASE 0x50000308u
#define DAC1_BASE 0x50000800u

#define FLASH_ACR_LATENCY 0xFu
#define FLASH_ACR_LATENCY_4 4u

#define RCC_CR_HSION (1u << 8)
#define RCC_CR_HSIRDY (1u << 10)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_CFGR_SW 0x3u
#define RCC_CFGR_SW_HSI16 1u
#define RCC_CFGR_SW_PLL 3u
#define RCC_CFGR_SWS (0x3u << 2)
#define RCC_CFGR_SWS_HSI16 (1u << 2)
#define RCC_CFGR_SWS_PLL (3u << 2)
#define RCC_CFGR_HPRE (0xFu << 4)
#define RCC_CFGR_HPRE_2 (8u << 4)
#define RCC_CFGR_PPRE1 (0x7u << 8)
#define RCC_PLLCFGR_PLLSRC_HSI16 2u
#define RCC_PLLCFGR_PLLM(divider) (((divider)-1u) << 4)
#define RCC_PLLCFGR_PLLN(factor) ((uint32_t)(factor) << 8)
#define RCC_PLLCFGR_PLLREN (1u << 24)
#define RCC_PLLCFGR_PLLR(divider) (((divider) / 2u - 1u) << 25)
/* Enable and reset registers. */
#define RCC_AHB2_GPIOA (1u << 0)
#define RCC_AHB2_ADC12 (1u << 13)
#define RCC_AHB2_DAC1 (1u << 16)
#define RCC_APB1_TIM2 (1u << 0)
#define RCC_APB1_TIM6 (1u << 4)
#define RCC_APB1_USART2 (1u << 17)
#define RCC_APB1_PWR (1u << 28)

#define RCC_CSR_RMVF (1u << 23)
#define RCC_CSR_IWDGRSTF (1u << 29)

#define PWR_CR5_R1MODE (1u << 8)

#define TIM_CR1_CEN (1u << 0)
#define TIM_CR1_URS (1u << 2)
#define TIM_DIER_UIE (1u << 0)
#define TIM_SR_UIF (1u << 0)
#define TIM_EGR_UG (1u << 0)

#define GPIO_MODER_0_ANALOG (3u << 0)
#define GPIO_MODER_2 (3u << 4)
#define GPIO_MODER_2_ALTERNATE (2u << 4)
#define GPIO_MODER_4_ANALOG (3u << 8)
#define GPIO_OSPEEDR_2_FAST (2u << 4)
#define GPIO_AFRL_2 (0xFu << 8)
#define GPIO_AFRL_2_USART2 (7u << 8)

#define DAC_CR_EN1 (1u << 0)
#define DAC_CR_TEN1 (1u << 1)
#define DAC_SR_DAC1RDY (1u << 11)
#define DAC_MCR_MODE1 0x7u
#define DAC_MCR_HFSEL (0x3u << 14)
#define DAC_MCR_HFSEL_160_MHZ (2u << 14)

#define ADC_ISR_ADRDY (1u << 0)
#define ADC_ISR_EOC (1u << 2)
#define ADC_CR_ADEN (1u << 0)
#define ADC_CR_ADSTART (1u << 2)
#define ADC_CR_ADVREGEN (1u << 28)
#define ADC_CR_DEEPPWD (1u << 29)
#define ADC_CR_ADCAL (1u << 31)
#define ADC_CFGR_OVRMOD (1u << 12)
#define ADC_CFGR_CONT (1u << 13)
#define ADC_SMPR1_SMP1_92 (5u << 3)
#define ADC_SQR1_IN1 (1u << 6)
#define ADC_CCR_CKMODE_4 (3u << 16)

#define USART_CR1_UE (1u << 0)
#define USART_CR1_TE (1u << 3)
#define USART_CR1_TXEIE (1u << 7)
#define USART_ISR_TXE (1u << 7)

#define USART2_IRQ 38u
#define TIM6_DAC_IRQ 54u

#ifdef RDPI_STM32G474_FAKE

static struct {
    flash_t flash;
    rcc_t rcc;
    pwr_t pwr;
    tim_t tim2, tim6;
    gpio_t gpioa;
    dac_t dac1;
    adc_t adc1;
    adc_common_t adc_common;
    usart_t usart2;
    iwdg_t iwdg;
} fake;
#define FLASH (&fake.flash)
#define RCC (&fake.rcc)
#define PWR (&fake.pwr)
#define TIM2 (&fake.tim2)
#define TIM6 (&fake.tim6)
#define GPIOA (&fake.gpioa)
#define DAC1 (&fake.dac1)
#define ADC1 (&fake.adc1)
#define ADC_COMMON (&fake.adc_common)
#define USART2 (&fake.usart2)
#define IWDG (&fake.iwdg)

typedef void (*cortex_m_handler_t)(void);
#define CORTEX_M_VECTORS static const cortex_m_handler_t device_vectors
static uint32_t reg_read(const uint32_t *reg);
static void reg_write(uint32_t *reg, uint32_t value);
static void cortex_m_enable(unsigned interrupt, uint32_t priority);
static void cortex_m_pend(unsigned interrupt);
static void cortex_m_sleep(void);

#else

#include "cortex_m.h"

#define FLASH ((flash_t *)FLASH_BASE)
#define RCC ((rcc_t *)RCC_BASE)
#define PWR ((pwr_t *)PWR_BASE)
#define TIM2 ((tim_t *)TIM2_BASE)
#define TIM6 ((tim_t *)TIM6_BASE)
#define GPIOA ((gpio_t *)GPIOA_BASE)
#define DAC1 ((dac_t *)DAC1_BASE)
#define ADC1 ((adc_t *)ADC1_BASE)
#define ADC_COMMON ((adc_common_t *)ADC_COMMON_BASE)
#define USART2 ((usart_t *)USART2_BASE)
#define IWDG ((iwdg_t *)IWDG_BASE)

static inline uint32_t reg_read(const uint32_t *reg)
{
    return *(const volatile uint32_t *)reg;
}

static inline void reg_write(uint32_t *reg, uint32_t value)
{
    *(volatile uint32_t *)reg = value;
}

#endif
#endif
