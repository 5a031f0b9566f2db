/* The port contract on an STM32G474: TIM6 calls the tick, DAC1 channel 1 (PA4, 12 bits, buffered) holds the code, ADC1
 * reads the sensor at PA0, USART2 sends telemetry from PA2, which on a Nucleo goes to the ST-Link; TIM2 counts the
 * cycles that say how many ticks were lost. 170 MHz from the internal 16 MHz oscillator. */
#include "../cortex_m/ring.h" /* by their places: the test includes this file, from a folder that knows none */
#include "../include/rdpi_port.h"
#include "registers.h"

#include "../stm32/common.h" /* these two with those registers */
#include "../stm32/watchdog.h"

#ifndef RDPI_BAUD
#define RDPI_BAUD 3000000
#endif
#define USART_HZ 170000000
#define BAUD_DIVIDER ((USART_HZ + RDPI_BAUD / 2) / RDPI_BAUD)
#if BAUD_DIVIDER < 16 || BAUD_DIVIDER > 65535 || \
    BAUD_DIVIDER * RDPI_BAUD > USART_HZ / 100 * 102 || BAUD_DIVIDER * RDPI_BAUD < USART_HZ / 100 * 98
#error "RDPI_BAUD: not to be made of 170 MHz by a divider of 16 to 65535 within 2 %"
#endif

#define CORE_HZ 170000000u    /* core, buses and timers */
#define LAST_RATE_HZ 1000000u /* the buffered DAC's, DS12288 */
#define LAST_CODE 0xFFFu
#define PRIORITY_TICK 0x00u
#define PRIORITY_USART 0xC0u

#if RDPI_SAFE_CODE > LAST_CODE
#error "RDPI_SAFE_CODE: 4095 at most, the DAC has 12 bits"
#endif

void SystemInit(void);

static rdpi_port_tick_t on_tick;
static uint32_t period;            /* cycles between ticks */
static uint32_t due;               /* TIM2's count at the last tick accounted for */
static ring_t telemetry;

/* RM0440 6.1.5, Range 1 normal to boost, and 3.3.3, increasing the frequency. Stops where the chip does not follow. */
static bool clock_start(void)
{
    change(&RCC->apb1enr1, 0, RCC_APB1_PWR);
    (void)reg_read(&RCC->apb1enr1); /* the clock is on two cycles after the write */

    /* From HSI16, as after reset; a boot loader may have left something else. */
    change(&RCC->cr, 0, RCC_CR_HSION);
    if (!reached(&RCC->cr, RCC_CR_HSIRDY, RCC_CR_HSIRDY)) {
        return false;
    }
    change(&RCC->cfgr, RCC_CFGR_SW, RCC_CFGR_SW_HSI16);
    if (!reached(&RCC->cfgr, RCC_CFGR_SWS, RCC_CFGR_SWS_HSI16)) {
        return false;
    }
    change(&RCC->cr, RCC_CR_PLLON, 0);
    if (!reached(&RCC->cr, RCC_CR_PLLRDY, 0)) {
        return false;
    }

    /* 16 MHz / 4 * 85 = 340 MHz, / 2 */
    reg_write(&RCC->pllcfgr, RCC_PLLCFGR_PLLSRC_HSI16 | RCC_PLLCFGR_PLLM(4u) | RCC_PLLCFGR_PLLN(85u) |
                                 RCC_PLLCFGR_PLLR(2u) | RCC_PLLCFGR_PLLREN);
    change(&RCC->cr, 0, RCC_CR_PLLON);
    if (!reached(&RCC->cr, RCC_CR_PLLRDY, RCC_CR_PLLRDY)) {
        return false;
    }

    change(&RCC->cfgr, RCC_CFGR_HPRE | RCC_CFGR_PPRE1, RCC_CFGR_HPRE_2);
    if (!reached(&RCC->cfgr, RCC_CFGR_HPRE, RCC_CFGR_HPRE_2)) {
        return false;
    }
    change(&PWR->cr5, PWR_CR5_R1MODE, 0);
    change(&FLASH->acr, FLASH_ACR_LATENCY, FLASH_ACR_LATENCY_4);
    if (!reached(&FLASH->acr, FLASH_ACR_LATENCY, FLASH_ACR_LATENCY_4)) {
        return false;
    }
    change(&RCC->cfgr, RCC_CFGR_SW, RCC_CFGR_SW_PLL);
    if (!reached(&RCC->cfgr, RCC_CFGR_SWS, RCC_CFGR_SWS_PLL)) {
        return false;
    }
    for (uint32_t k = 0; k < 100u; k++) { /* at least 1 us, 85 cycles of 85 MHz */
        (void)reg_read(&RCC->cfgr);
    }
    change(&RCC->cfgr, RCC_CFGR_HPRE, 0);
    return reached(&RCC->cfgr, RCC_CFGR_HPRE, 0);
}

/* At least `ns` at 170 MHz: a read takes two cycles and more. */
static void pause_ns(uint32_t ns)
{
    for (uint32_t k = 0; k <= ns / 11u; k++) {
        (void)reg_read(&RCC->cfgr);
    }
}

/* Converter and transmitter as after reset, whatever a boot loader did with them; the DAC goes on as it is. */
static void peripherals_start(void)
{
    change(&RCC->ahb2rstr, 0, RCC_AHB2_ADC12);
    change(&RCC->ahb2rstr, RCC_AHB2_ADC12, 0);
    change(&RCC->apb1rstr1, 0, RCC_APB1_USART2);
    change(&RCC->apb1rstr1, RCC_APB1_USART2, 0);
    change(&RCC->ahb2enr, 0, RCC_AHB2_ADC12);
    change(&RCC->apb1enr1, 0, RCC_APB1_TIM2 | RCC_APB1_TIM6 | RCC_APB1_USART2);
    (void)reg_read(&RCC->apb1enr1);
}

/* The safe code from here on until main writes one. */
static void dac_start(void)
{
    change(&RCC->ahb2enr, 0, RCC_AHB2_GPIOA | RCC_AHB2_DAC1);
    (void)reg_read(&RCC->ahb2enr); /* the clock is on two cycles after the write */
    change(&GPIOA->moder, 0, GPIO_MODER_4_ANALOG);
    change(&DAC1->cr, DAC_CR_EN1 | DAC_CR_TEN1, 0);
    change(&DAC1->mcr, DAC_MCR_HFSEL | DAC_MCR_MODE1, DAC_MCR_HFSEL_160_MHZ);
    reg_write(&DAC1->dhr12r1, RDPI_SAFE_CODE);
    change(&DAC1->cr, 0, DAC_CR_EN1);
    (void)reached(&DAC1->sr, DAC_SR_DAC1RDY, DAC_SR_DAC1RDY); /* a code written earlier would only come out later */
}

/* RM0440, chapter 21: regulator, calibration, on. One conversion after the other, (92.5 + 12.5) / 42.5 MHz = 2.5 us
 * each; the latest is in the data register. Where the converter does not follow it is not started. */
static void adc_start(void)
{
    change(&GPIOA->moder, 0, GPIO_MODER_0_ANALOG);
    change(&ADC1->cr, ADC_CR_DEEPPWD, 0);
    change(&ADC1->cr, 0, ADC_CR_ADVREGEN);
    pause_ns(20000); /* until the regulator is up */
    change(&ADC_COMMON->ccr, 0, ADC_CCR_CKMODE_4);
    change(&ADC1->cr, 0, ADC_CR_ADCAL);
    if (!reached(&ADC1->cr, ADC_CR_ADCAL, 0)) {
        return;
    }
    pause_ns(100); /* four of its clocks */
    change(&ADC1->cr, 0, ADC_CR_ADEN);
    if (!reached(&ADC1->isr, ADC_ISR_ADRDY, ADC_ISR_ADRDY)) {
        return;
    }
    reg_write(&ADC1->sqr1, ADC_SQR1_IN1);
    reg_write(&ADC1->smpr1, ADC_SMPR1_SMP1_92);
    change(&ADC1->cfgr, 0, ADC_CFGR_CONT | ADC_CFGR_OVRMOD);
    change(&ADC1->cr, 0, ADC_CR_ADSTART);
    (void)reached(&ADC1->isr, ADC_ISR_EOC, ADC_ISR_EOC); /* the first */
}

static void usart_start(void)
{
    change(&GPIOA->afrl, GPIO_AFRL_2, GPIO_AFRL_2_USART2);
    change(&GPIOA->ospeedr, 0, GPIO_OSPEEDR_2_FAST);
    change(&GPIOA->moder, GPIO_MODER_2, GPIO_MODER_2_ALTERNATE);
    reg_write(&USART2->brr, BAUD_DIVIDER);
    reg_write(&USART2->cr1, USART_CR1_UE | USART_CR1_TE);
    cortex_m_enable(USART2_IRQ, PRIORITY_USART);
}

/* Before main, and before variables have values: uses none. */
void SystemInit(void)
{
    dac_start();
    (void)clock_start(); /* rdpi_port_start looks at what came of it */
    peripherals_start();
    adc_start();
    usart_start();
}

/* Ticks that have become due since this was last asked. */
static uint32_t ticks_due(void)
{
    uint32_t ticks = (reg_read(&TIM2->cnt) - due) / period;
    due += ticks * period;
    return ticks;
}

static void tim6_interrupt(void)
{
    if ((reg_read(&TIM6->sr) & TIM_SR_UIF) == 0u) {
        return; /* pending from a tick that was dropped */
    }
    reg_write(&TIM6->sr, 0); /* before the count is read: nothing in between is forgotten */
    uint32_t ticks = ticks_due();
    if (ticks == 0u) {
        return; /* accounted for at the end of the tick before */
    }
    lose(ticks - 1u); /* entered late, more than a period */
    on_tick();
    watchdog_feed();
    if ((reg_read(&TIM6->sr) & TIM_SR_UIF) != 0u) {
        reg_write(&TIM6->sr, 0);
        lose(ticks_due());
    }
}

bool rdpi_port_start(uint32_t rate_hz, rdpi_port_tick_t tick)
{
    if (tick == NULL || rate_hz == 0u || rate_hz > LAST_RATE_HZ ||
        (reg_read(&RCC->cfgr) & (RCC_CFGR_SWS | RCC_CFGR_HPRE)) != RCC_CFGR_SWS_PLL ||
        (reg_read(&DAC1->sr) & DAC_SR_DAC1RDY) == 0u) {
        return false;
    }
    uint32_t prescaler = ((CORE_HZ + rate_hz / 2u) / rate_hz - 1u) / 0x10000u + 1u;
    uint32_t steps_hz = rate_hz * prescaler; /* below 2 MHz */
    uint32_t counts = (CORE_HZ + steps_hz / 2u) / steps_hz;
    uint32_t made_hz = steps_hz * counts; /* the core's frequency at which the rate would be exact */
    if ((made_hz > CORE_HZ ? made_hz - CORE_HZ : CORE_HZ - made_hz) > CORE_HZ / 1000u || !watchdog_start(rate_hz)) {
        return false;
    }

    on_tick = tick;
    period = prescaler * counts;
    due = 0;
    overruns = 0;

    reg_write(&TIM6->cr1, TIM_CR1_URS); /* UG below loads the prescaler and raises no flag */
    reg_write(&TIM6->psc, prescaler - 1u);
    reg_write(&TIM6->arr, counts - 1u);
    reg_write(&TIM6->egr, TIM_EGR_UG);
    reg_write(&TIM6->dier, TIM_DIER_UIE);
    reg_write(&TIM2->cr1, TIM_CR1_URS);
    reg_write(&TIM2->psc, 0);
    reg_write(&TIM2->arr, UINT32_MAX);
    reg_write(&TIM2->egr, TIM_EGR_UG);
    cortex_m_enable(TIM6_DAC_IRQ, PRIORITY_TICK); /* finds the variables above with their values */
    reg_write(&TIM2->cr1, TIM_CR1_URS | TIM_CR1_CEN); /* a few cycles ahead of TIM6: a tick is never due too late */
    reg_write(&TIM6->cr1, TIM_CR1_URS | TIM_CR1_CEN);
    return true;
}

bool rdpi_port_write_dac(const uint32_t *codes)
{
    if (codes[0] > LAST_CODE) {
        return false;
    }
    reg_write(&DAC1->dhr12r1, codes[0]);
    return true;
}

/* The DAC is on from start-up; should it be off after all, as before. */
void rdpi_port_safe(void)
{
    if ((reg_read(&DAC1->cr) & (DAC_CR_EN1 | DAC_CR_TEN1)) == DAC_CR_EN1) {
        reg_write(&DAC1->dhr12r1, RDPI_SAFE_CODE);
    } else {
        dac_start();
    }
}

/* None if the converter could not be started. */
void rdpi_port_read_adc(int32_t *counts)
{
    counts[0] = (reg_read(&ADC1->cr) & ADC_CR_ADSTART) != 0u ? (int32_t)reg_read(&ADC1->dr) : RDPI_PORT_NO_READING;
}

/* From rdpi_port_start on. */
uint32_t rdpi_port_cycles(void)
{
    return reg_read(&TIM2->cnt);
}

static void usart2_interrupt(void)
{
    uint8_t byte;
    while ((reg_read(&USART2->isr) & USART_ISR_TXE) != 0u && ring_take(&telemetry, &byte)) {
        reg_write(&USART2->tdr, byte);
    }
    reg_write(&USART2->cr1, USART_CR1_UE | USART_CR1_TE | (ring_empty(&telemetry) ? 0u : USART_CR1_TXEIE));
}

bool rdpi_port_send(const uint8_t *bytes, size_t count)
{
    bool taken = ring_put(&telemetry, bytes, count);
    cortex_m_pend(USART2_IRQ); /* only its interrupt writes the control register */
    return taken;
}

void rdpi_port_idle(void)
{
    main_came_by = true;
    cortex_m_sleep();
}

CORTEX_M_VECTORS[] = {
    [USART2_IRQ] = usart2_interrupt,
    [TIM6_DAC_IRQ] = tim6_interrupt,
};
