/* The registers of the STM32F405 that stm32f405.c uses, and no others. With RDPI_STM32F405_FAKE they are blocks in RAM,
 * and the test that defines it brings its own functions for what reads, writes and enables.
 *
 *     what                                                                          sources
 *     offsets          PWR, RCC, SPI, TIM, USART, ADC                               [1]; RCC, SPI, ADC also [3]
 *                      GPIO, ADC common                                             [5]; ADC common also [1]
 *     base addresses   TIM2, ADC1, SPI1, USART1, GPIOA, RCC, FLASH, PWR             [2]
 *     interrupts       TIM2 28, SPI1 35, USART1 37, TIM7 55                         [1]; the first three also [2]
 *     RCC_CR           HSION 0, HSIRDY 1, HSEON 16, HSERDY 17, PLLON 24, PLLRDY 25  [3]
 *     RCC_PLLCFGR      PLLM 5:0, PLLN 14:6, PLLP 17:16, PLLSRC 22, PLLQ 27:24       [3] [5]
 *     RCC_CFGR         SW 1:0, SWS 3:2, HPRE 7:4, PPRE1 12:10, PPRE2 15:13          [3] [5]
 *     RCC enable and   GPIOA 0; TIM2 0, PWR 28; USART1 4, ADC1 8, SPI1 12           [3]
 *     reset registers
 *     RCC_CSR          at 0x74; RMVF 24, IWDGRSTF 29                                [1]; bits [5]
 *     FLASH_ACR        LATENCY 2:0, PRFTEN 8, ICEN 9, DCEN 10                       ICEN, DCEN [3]; all [6]
 *                      five wait states for 168 MHz                                 [6]
 *     PWR_CR           VOS 14: full speed, as after reset                           [5]
 *     GPIO             two bits a pin (MODER, OSPEEDR), four (AFR), BSRR            [5]
 *                      PA5, PA7 SPI1 = AF5; PA9 USART1_TX = AF7; PA0 ADC channel 0  [6]
 *     SPI_CR1          CPHA 0, MSTR 2, BR 5:3, SPE 6, SSI 8, SSM 9                  [3]
 *     SPI_CR2, SR      RXNEIE 6; RXNE 0                                             [3]; RXNE also [2]
 *     USART_CR1, SR    TE 3, TXEIE 7, UE 13; TXE 7                                  [5]; TXEIE, TXE also [2]
 *     ADC              CR2 ADON 0, CONT 1; SR EOC 1, STRT 4                         [3]; ADON also [2]
 *                      CR2 SWSTART 30, SMPR2 84 cycles = 4, CCR ADCPRE 17:16        [5]; SWSTART also [2]
 *                      stable after 3 us                                            [6]
 *     TIM              CR1 CEN 0; DIER UIE 0; SR UIF 0, cleared by 0                [2], as in stm32g474
 *                      TIM2 has 32 bits; timers run at twice APB1 / 4               [6]
 *     DWT, DEMCR       CTRL CYCCNTENA 0, CYCCNT; TRCENA 24                          [4]
 *
 * [1] ST, github.com/STMicroelectronics/cmsis_device_f4, Include/stm32f405xx.h;
 * [2] QEMU's models of the chip: hw/arm/stm32f405_soc.c, hw/{timer,ssi,char,adc}/stm32f2xx_*.c;
 * [3] libopencm3, stm32/f4/rcc.h, stm32/common/{spi_common_all,adc_common_v1,flash_common_idcache}.h;
 * [4] Armv7-M Architecture Reference Manual (DDI 0403), C1.6 and C1.8, from memory;
 * [5] headers of ST's and libopencm3's for this family, as they turn up in public projects;
 * [6] from memory of RM0090 and DS8626, which were not at hand: to be checked against them.
 *
 * QEMU's machine ran what it models, which is neither clock nor converter nor the SPI's interrupt. Nothing ran on
 * silicon. */
#ifndef RDPI_STM32F405_REGISTERS_H
#define RDPI_STM32F405_REGISTERS_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    uint32_t acr;
} flash_t;

typedef struct {
    uint32_t cr, pllcfgr, cfgr, unused_0c[5], apb1rstr, apb2rstr, unused_28[2], ahb1enr, unused_34[3], apb1enr, apb2enr,
        unused_48[11], csr;
} rcc_t;

typedef struct {
    uint32_t cr;
} pwr_t;

typedef struct {
    uint32_t cr1, unused_04[2], dier, sr, unused_14[6], arr;
} tim_t;

typedef struct {
    uint32_t moder, unused_04, ospeedr, unused_0c[2], odr, bsrr, unused_1c, afr[2];
} gpio_t;

typedef struct {
    uint32_t cr1, cr2, sr, dr;
} spi_t;

typedef struct {
    uint32_t sr, dr, brr, cr1;
} usart_t;

typedef struct {
    uint32_t sr, cr1, cr2, unused_0c, smpr2, unused_14[14], dr;
} adc_t;

typedef struct {
    uint32_t ccr;
} adc_common_t;

typedef struct {
    uint32_t kr, pr, rlr, sr;
} iwdg_t;

typedef struct {
    uint32_t ctrl, cyccnt;
} dwt_t;

typedef struct {
    uint32_t demcr;
} demcr_t;

/* C99 has no _Static_assert: an array of -1 elements does not compile. */
#define AT(type, field, offset) typedef char type##_##field##_at[offsetof(type, field) == (offset) ? 1 : -1]
AT(rcc_t, cfgr, 0x08);
AT(rcc_t, apb1rstr, 0x20);
AT(rcc_t, ahb1enr, 0x30);
AT(rcc_t, apb1enr, 0x40);
AT(rcc_t, apb2enr, 0x44);
AT(rcc_t, csr, 0x74);
AT(tim_t, dier, 0x0C);
AT(tim_t, sr, 0x10);
AT(tim_t, arr, 0x2C);
AT(gpio_t, ospeedr, 0x08);
AT(gpio_t, odr, 0x14);
AT(gpio_t, bsrr, 0x18);
AT(gpio_t, afr, 0x20);
AT(spi_t, dr, 0x0C);
AT(usart_t, brr, 0x08);
AT(usart_t, cr1, 0x0C);
AT(adc_t, cr2, 0x08);
AT(adc_t, smpr2, 0x10);
AT(adc_t, dr, 0x4C);
AT(iwdg_t, sr, 0x0C);
AT(dwt_t, cyccnt, 0x04);
#undef AT

#define TIM2_BASE 0x40000000u
#define IWDG_BASE 0x40003000u
#define PWR_BASE 0x40007000u
#define USART1_BASE 0x40011000u
#define ADC1_BASE 0x40012000u
#define ADC_COMMON_BASE 0x40012304u
#define SPI1_BASE 0x40013000u
#define GPIOA_BASE 0x40020000u
#define RCC_BASE 0x40023800u
#define FLASH_BASE 0x40023C00u
#define DWT_BASE 0xE0001000u
#define DEMCR_BASE 0xE000EDFCu

#define FLASH_ACR_LATENCY 0x7u
#define FLASH_ACR_LATENCY_5 5u
#define FLASH_ACR_CACHES (7u << 8)

#define RCC_CR_HSION (1u << 0)
#define RCC_CR_HSIRDY (1u << 1)
#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_PLLCFGR_PLLM(divider) ((uint32_t)(divider))
#define RCC_PLLCFGR_PLLN(factor) ((uint32_t)(factor) << 6)
#define RCC_PLLCFGR_PLLP(divider) (((divider) / 2u - 1u) << 16)
#define RCC_PLLCFGR_PLLSRC_HSE (1u << 22)
#define RCC_PLLCFGR_PLLQ(divider) ((uint32_t)(divider) << 24)
#define RCC_CFGR_SW 0x3u
#define RCC_CFGR_SW_HSI 0u
#define RCC_CFGR_SW_PLL 2u
#define RCC_CFGR_SWS (0x3u << 2)
#define RCC_CFGR_SWS_HSI (0u << 2)
#define RCC_CFGR_SWS_PLL (2u << 2)
#define RCC_CFGR_HPRE (0xFu << 4)
#define RCC_CFGR_PPRE1 (0x7u << 10)
#define RCC_CFGR_PPRE1_4 (5u << 10)
#define RCC_CFGR_PPRE2 (0x7u << 13)
#define RCC_CFGR_PPRE2_2 (4u << 13)
#define RCC_AHB1_GPIOA (1u << 0)
#define RCC_APB1_TIM2 (1u << 0)
#define RCC_APB1_PWR (1u << 28)
#define RCC_APB2_USART1 (1u << 4)
#define RCC_APB2_ADC1 (1u << 8)
#define RCC_APB2_SPI1 (1u << 12)

#define RCC_CSR_RMVF (1u << 24)
#define RCC_CSR_IWDGRSTF (1u << 29)

#define PWR_CR_VOS (1u << 14)

#define TIM_CR1_CEN (1u << 0)
#define TIM_DIER_UIE (1u << 0)
#define TIM_SR_UIF (1u << 0)

#define GPIO_2(pin, bits) ((uint32_t)(bits) << (2u * (pin)))         /* MODER, OSPEEDR */
#define GPIO_4(pin, bits) ((uint32_t)(bits) << (4u * ((pin) % 8u))) /* AFR */
#define GPIO_OUTPUT 1u
#define GPIO_ALTERNATE 2u
#define GPIO_ANALOG 3u
#define GPIO_FAST 2u
#define GPIO_HIGH(pin) (1u << (pin)) /* BSRR */
#define GPIO_LOW(pin) (1u << ((pin) + 16u))

#define SPI_CR1_CPHA (1u << 0)
#define SPI_CR1_MSTR (1u << 2)
#define SPI_CR1_BR_8 (2u << 3)
#define SPI_CR1_SPE (1u << 6)
#define SPI_CR1_SSI (1u << 8)
#define SPI_CR1_SSM (1u << 9)
#define SPI_CR2_RXNEIE (1u << 6)
#define SPI_SR_RXNE (1u << 0)

#define USART_CR1_TE (1u << 3)
#define USART_CR1_TXEIE (1u << 7)
#define USART_CR1_UE (1u << 13)
#define USART_SR_TXE (1u << 7)

#define ADC_SR_EOC (1u << 1)
#define ADC_SR_STRT (1u << 4)
#define ADC_CR2_ADON (1u << 0)
#define ADC_CR2_CONT (1u << 1)
#define ADC_CR2_SWSTART (1u << 30)
#define ADC_SMPR2_SMP0_84 4u
#define ADC_CCR_ADCPRE_4 (1u << 16)

#define DWT_CTRL_CYCCNTENA (1u << 0)
#define DEMCR_TRCENA (1u << 24)

#define TIM2_IRQ 28u
#define SPI1_IRQ 35u
#define USART1_IRQ 37u
#define TIM7_IRQ 55u

#ifdef RDPI_STM32F405_FAKE

static struct {
    flash_t flash;
    rcc_t rcc;
    pwr_t pwr;
    tim_t tim2;
    gpio_t gpioa;
    spi_t spi1;
    usart_t usart1;
    adc_t adc1;
    adc_common_t adc_common;
    iwdg_t iwdg;
    dwt_t dwt;
    demcr_t demcr;
} fake;
#define FLASH (&fake.flash)
#define RCC (&fake.rcc)
#define PWR (&fake.pwr)
#define TIM2 (&fake.tim2)
#define GPIOA (&fake.gpioa)
#define SPI1 (&fake.spi1)
#define USART1 (&fake.usart1)
#define ADC1 (&fake.adc1)
#define ADC_COMMON (&fake.adc_common)
#define IWDG (&fake.iwdg)
#define DWT (&fake.dwt)
#define DEMCR (&fake.demcr)

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
#define GPIOA ((gpio_t *)GPIOA_BASE)
#define SPI1 ((spi_t *)SPI1_BASE)
#define USART1 ((usart_t *)USART1_BASE)
#define ADC1 ((adc_t *)ADC1_BASE)
#define ADC_COMMON ((adc_common_t *)ADC_COMMON_BASE)
#define IWDG ((iwdg_t *)IWDG_BASE)
#define DWT ((dwt_t *)DWT_BASE)
#define DEMCR ((demcr_t *)DEMCR_BASE)

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
