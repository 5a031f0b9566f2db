/* The port contract on an STM32F405 at 168 MHz with an AD5683R on its SPI: TIM2 calls the tick, by way of an interrupt
 * that software sets; SPI1 sends the code, USART1 telemetry, ADC1 reads the sensor. PA0 sensor, PA4 the DAC's SYNC,
 * PA5 SCLK, PA7 SDI, PA9 telemetry.
 *
 * Priorities, highest first: TIM2, which only counts, so that no tick is lost unseen; SPI1, so that the rest of a frame
 * does not wait for the tick to end; the tick; USART1. */
#include "../cortex_m/ring.h" /* by their places: the test includes this file, from a folder that knows none */
#include "../drivers/ad5683r.h"
#include "../include/rdpi_port.h"
#include "../include/rdpi_spi.h"
#include "registers.h"

#include "../stm32/common.h" /* these two with those registers */
#include "../stm32/watchdog.h"

#ifndef RDPI_HSE_HZ
#define RDPI_HSE_HZ 8000000 /* the crystal */
#endif
#ifndef RDPI_BAUD
#define RDPI_BAUD 3000000
#endif

#if RDPI_HSE_HZ % 1000000 != 0 || RDPI_HSE_HZ < 4000000 || RDPI_HSE_HZ > 26000000
#error "RDPI_HSE_HZ: the crystal has 4 to 26 MHz, in whole MHz"
#endif
#define TIMER_HZ 84000000u /* twice APB1, which is the core's / 4 */
#define APB2_HZ 84000000
#define BAUD_DIVIDER ((APB2_HZ + RDPI_BAUD / 2) / RDPI_BAUD)
#if BAUD_DIVIDER < 16 || BAUD_DIVIDER > 65535 || \
    BAUD_DIVIDER * RDPI_BAUD > APB2_HZ / 100 * 102 || BAUD_DIVIDER * RDPI_BAUD < APB2_HZ / 100 * 98
#error "RDPI_BAUD: not to be made of 84 MHz by a divider of 16 to 65535 within 2 %"
#endif

#if RDPI_SAFE_CODE > RDPI_AD5683R_MAX_CODE
#error "RDPI_SAFE_CODE: 65535 at most, the DAC has 16 bits"
#endif

#define LAST_RATE_HZ 100000u /* a frame takes 4 us; the divider is then exact to 0.06 % */
#define SYNC_PIN 4u
#define TICK_IRQ TIM7_IRQ /* of a timer that is not used */
#define PRIORITY_TIMER 0x00u
#define PRIORITY_SPI 0x40u
#define PRIORITY_TICK 0x80u
#define PRIORITY_USART 0xC0u

void SystemInit(void);

static const rdpi_ad5683r_config_t wiring = {.gain_2 = true}; /* 0 .. 5 V from the internal reference, LDAC tied */
static rdpi_ad5683r_t dac;
static bool dac_prepared;

static const uint8_t *volatile spi_next;   /* byte that goes out next */
static volatile unsigned spi_left;         /* bytes of this transfer that are not out yet */
static volatile unsigned spi_frame_length; /* bytes of one of its frames */
static rdpi_port_tick_t on_tick;
static volatile uint32_t updates;  /* of TIM2 since the start; wraps */
static uint32_t served;            /* of them, those that had their tick or were lost */
static ring_t telemetry;

/* At least `ns` at 168 MHz: a read of the AHB takes two cycles and more. */
static void pause_ns(uint32_t ns)
{
    for (uint32_t k = 0; k <= ns / 12u; k++) {
        (void)reg_read(&GPIOA->odr);
    }
}

/* The processor runs, so on silicon some oscillator is ready. Not in QEMU, which does not model the clock. */
static bool clock_is_modelled(void)
{
    return (reg_read(&RCC->cr) & (RCC_CR_HSIRDY | RCC_CR_HSERDY | RCC_CR_PLLRDY)) != 0u;
}

/* RM0090, chapters 3, 5 and 7. Stops where the chip does not follow. */
static bool clock_start(void)
{
    if (!clock_is_modelled()) {
        return false;
    }
    change(&RCC->apb1enr, 0, RCC_APB1_PWR);
    (void)reg_read(&RCC->apb1enr); /* the clock is on two cycles after the write */
    change(&PWR->cr, 0, PWR_CR_VOS);

    /* From HSI, as after reset; a boot loader may have left something else. */
    change(&RCC->cr, 0, RCC_CR_HSION | RCC_CR_HSEON);
    if (!reached(&RCC->cr, RCC_CR_HSIRDY, RCC_CR_HSIRDY)) {
        return false;
    }
    change(&RCC->cfgr, RCC_CFGR_SW, RCC_CFGR_SW_HSI);
    if (!reached(&RCC->cfgr, RCC_CFGR_SWS, RCC_CFGR_SWS_HSI)) {
        return false;
    }
    change(&RCC->cr, RCC_CR_PLLON, 0);
    if (!reached(&RCC->cr, RCC_CR_HSERDY | RCC_CR_PLLRDY, RCC_CR_HSERDY)) {
        return false;
    }

    /* 1 MHz * 336 / 2 */
    reg_write(&RCC->pllcfgr, RCC_PLLCFGR_PLLSRC_HSE | RCC_PLLCFGR_PLLM(RDPI_HSE_HZ / 1000000) | RCC_PLLCFGR_PLLN(336) |
                                 RCC_PLLCFGR_PLLP(2u) | RCC_PLLCFGR_PLLQ(7));
    change(&RCC->cr, 0, RCC_CR_PLLON);
    if (!reached(&RCC->cr, RCC_CR_PLLRDY, RCC_CR_PLLRDY)) {
        return false;
    }
    change(&FLASH->acr, FLASH_ACR_LATENCY, FLASH_ACR_LATENCY_5 | FLASH_ACR_CACHES);
    if (!reached(&FLASH->acr, FLASH_ACR_LATENCY, FLASH_ACR_LATENCY_5)) {
        return false;
    }
    change(&RCC->cfgr, RCC_CFGR_HPRE | RCC_CFGR_PPRE1 | RCC_CFGR_PPRE2, RCC_CFGR_PPRE1_4 | RCC_CFGR_PPRE2_2);
    change(&RCC->cfgr, RCC_CFGR_SW, RCC_CFGR_SW_PLL);
    return reached(&RCC->cfgr, RCC_CFGR_SWS, RCC_CFGR_SWS_PLL);
}

/* SPI and its pins, whatever was done with them. SYNC goes high first: of a frame that was being sent the DAC
 * discards what it has. */
static void spi_start(void)
{
    change(&RCC->ahb1enr, 0, RCC_AHB1_GPIOA);
    change(&RCC->apb2enr, 0, RCC_APB2_SPI1);
    (void)reg_read(&RCC->apb2enr); /* the clocks are on two cycles after the write */
    reg_write(&SPI1->cr2, 0);      /* no interrupt goes on with that frame */
    reg_write(&GPIOA->bsrr, GPIO_HIGH(SYNC_PIN));
    change(&GPIOA->afr[0], GPIO_4(5u, 15u) | GPIO_4(7u, 15u), GPIO_4(5u, 5u) | GPIO_4(7u, 5u));
    change(&GPIOA->ospeedr, GPIO_2(SYNC_PIN, 3u) | GPIO_2(5u, 3u) | GPIO_2(7u, 3u),
           GPIO_2(SYNC_PIN, GPIO_FAST) | GPIO_2(5u, GPIO_FAST) | GPIO_2(7u, GPIO_FAST));
    change(&GPIOA->moder, GPIO_2(SYNC_PIN, 3u) | GPIO_2(5u, 3u) | GPIO_2(7u, 3u),
           GPIO_2(SYNC_PIN, GPIO_OUTPUT) | GPIO_2(5u, GPIO_ALTERNATE) | GPIO_2(7u, GPIO_ALTERNATE));
    change(&RCC->apb2rstr, 0, RCC_APB2_SPI1);
    change(&RCC->apb2rstr, RCC_APB2_SPI1, 0);

    /* Mode 1, 10.5 MHz; chip select is the port's. */
    reg_write(&SPI1->cr1, SPI_CR1_CPHA | SPI_CR1_MSTR | SPI_CR1_BR_8 | SPI_CR1_SSI | SPI_CR1_SSM);
    change(&SPI1->cr1, 0, SPI_CR1_SPE);
    pause_ns(80);
}

/* Peripherals as after reset, whatever a boot loader did with them. */
static void peripherals_start(void)
{
    const uint32_t apb2 = RCC_APB2_USART1 | RCC_APB2_ADC1;
    change(&RCC->apb1rstr, 0, RCC_APB1_TIM2);
    change(&RCC->apb1rstr, RCC_APB1_TIM2, 0);
    change(&RCC->apb2rstr, 0, apb2);
    change(&RCC->apb2rstr, apb2, 0);
    change(&RCC->apb1enr, 0, RCC_APB1_TIM2);
    change(&RCC->apb2enr, 0, apb2);
    (void)reg_read(&RCC->apb2enr);

    change(&GPIOA->afr[1], GPIO_4(9u, 15u), GPIO_4(9u, 7u));
    change(&GPIOA->ospeedr, GPIO_2(9u, 3u), GPIO_2(9u, GPIO_FAST));
    change(&GPIOA->moder, GPIO_2(0u, 3u) | GPIO_2(9u, 3u), GPIO_2(0u, GPIO_ANALOG) | GPIO_2(9u, GPIO_ALTERNATE));

    reg_write(&USART1->brr, BAUD_DIVIDER);
    reg_write(&USART1->cr1, USART_CR1_UE | USART_CR1_TE);

    cortex_m_enable(SPI1_IRQ, PRIORITY_SPI);
    cortex_m_enable(USART1_IRQ, PRIORITY_USART);
}

/* One conversion after the other, (84 + 12) / 21 MHz = 4.6 us each; the latest is in the data register. */
static void adc_start(void)
{
    reg_write(&ADC_COMMON->ccr, ADC_CCR_ADCPRE_4);
    reg_write(&ADC1->smpr2, ADC_SMPR2_SMP0_84);
    reg_write(&ADC1->cr2, ADC_CR2_ADON | ADC_CR2_CONT);
    pause_ns(3000); /* until it is stable */
    change(&ADC1->cr2, 0, ADC_CR2_SWSTART);
    (void)reached(&ADC1->sr, ADC_SR_EOC, ADC_SR_EOC); /* the first */
}

/* Before main, and before variables have values: uses none. */
void SystemInit(void)
{
    rdpi_port_safe();
    (void)clock_start(); /* rdpi_port_start looks at what came of it */
    peripherals_start();
    if (clock_is_modelled()) {
        adc_start();
    }
    change(&DEMCR->demcr, 0, DEMCR_TRCENA);
    change(&DWT->ctrl, 0, DWT_CTRL_CYCCNTENA);
}

/* By polling. A bus that does not answer costs 10 ms a byte. */
void rdpi_port_safe(void)
{
    uint8_t bytes[RDPI_AD5683R_SAFE_BYTES];
    rdpi_ad5683r_safe_frames(&wiring, RDPI_SAFE_CODE, bytes);
    spi_start();
    for (unsigned k = 0; k < sizeof bytes; k++) {
        if (k % RDPI_AD5683R_FRAME_BYTES == 0u) {
            reg_write(&GPIOA->bsrr, GPIO_LOW(SYNC_PIN));
        }
        reg_write(&SPI1->dr, bytes[k]);
        (void)reached(&SPI1->sr, SPI_SR_RXNE, SPI_SR_RXNE);
        (void)reg_read(&SPI1->dr);
        if (k % RDPI_AD5683R_FRAME_BYTES == RDPI_AD5683R_FRAME_BYTES - 1u) {
            reg_write(&GPIOA->bsrr, GPIO_HIGH(SYNC_PIN));
            pause_ns(80);
        }
    }
    spi_left = 0; /* of the frame that was given up */
}

/* For every byte that is out: the next, or the end of the frame. */
static void spi_advance(void)
{
    while (spi_left > 0u && (reg_read(&SPI1->sr) & SPI_SR_RXNE) != 0u) {
        (void)reg_read(&SPI1->dr); /* what came in meanwhile; clears the flag */
        if (spi_left % spi_frame_length == 1u) {
            reg_write(&GPIOA->bsrr, GPIO_HIGH(SYNC_PIN));
            pause_ns(80);
            if (spi_left > 1u) {
                reg_write(&GPIOA->bsrr, GPIO_LOW(SYNC_PIN));
            }
        }
        spi_left--;
        if (spi_left > 0u) {
            reg_write(&SPI1->dr, *spi_next);
            spi_next++;
        }
    }
}

static void spi1_interrupt(void)
{
    spi_advance();
    if (spi_left == 0u) {
        reg_write(&SPI1->cr2, 0);
    }
}

void rdpi_spi_write(const uint8_t *bytes, size_t frame_bytes, size_t frames)
{
    spi_next = bytes + 1;
    spi_frame_length = (unsigned)frame_bytes;
    spi_left = (unsigned)(frames * frame_bytes);
    reg_write(&GPIOA->bsrr, GPIO_LOW(SYNC_PIN)); /* half a clock, 48 ns, before the first falling edge at the least */
    reg_write(&SPI1->dr, bytes[0]);
    spi_advance(); /* nothing is out yet; but in QEMU, where a byte takes no time and no interrupt follows */
    if (spi_left > 0u) {
        reg_write(&SPI1->cr2, SPI_CR2_RXNEIE);
    }
}

bool rdpi_spi_busy(void)
{
    return spi_left > 0u;
}

/* Whether the DAC takes codes; the first call, from main, takes 3 ms. */
static bool dac_start(void)
{
    if (!dac_prepared) {
        dac_prepared = true;
        rdpi_ad5683r_init(&dac, &wiring);
        for (unsigned k = 0; k < 2u && !rdpi_ad5683r_start(&dac); k++) {
            pause_ns(1000000);
        }
    }
    return rdpi_ad5683r_start(&dac);
}

bool rdpi_port_write_dac(const uint32_t *codes)
{
    return dac_start() && rdpi_ad5683r_write(&dac, codes[0]);
}

static void tim2_interrupt(void)
{
    reg_write(&TIM2->sr, ~TIM_SR_UIF);
    updates++;
    cortex_m_pend(TICK_IRQ);
}

static void tick_interrupt(void)
{
    uint32_t now = updates;
    if (now == served) {
        return; /* pending from a tick that was dropped */
    }
    lose(now - served - 1u);
    served = now;
    on_tick();
    watchdog_feed();
    now = updates;
    lose(now - served);
    served = now;
}

bool rdpi_port_start(uint32_t rate_hz, rdpi_port_tick_t tick)
{
    if (tick == NULL || rate_hz == 0u || rate_hz > LAST_RATE_HZ ||
        (clock_is_modelled() && (reg_read(&RCC->cfgr) & RCC_CFGR_SWS) != RCC_CFGR_SWS_PLL) || !dac_start() ||
        !watchdog_start(rate_hz)) {
        return false;
    }
    on_tick = tick;
    updates = 0;
    served = 0;
    overruns = 0;
    cortex_m_enable(TICK_IRQ, PRIORITY_TICK);
    cortex_m_enable(TIM2_IRQ, PRIORITY_TIMER);
    reg_write(&TIM2->dier, TIM_DIER_UIE);
    reg_write(&TIM2->arr, (TIMER_HZ + rate_hz / 2u) / rate_hz - 1u); /* QEMU's counts from this write */
    reg_write(&TIM2->cr1, TIM_CR1_CEN);
    return true;
}

/* None while the converter does not run. */
void rdpi_port_read_adc(int32_t *counts)
{
    counts[0] = (reg_read(&ADC1->sr) & ADC_SR_STRT) != 0u ? (int32_t)reg_read(&ADC1->dr) : RDPI_PORT_NO_READING;
}

uint32_t rdpi_port_cycles(void)
{
    return reg_read(&DWT->cyccnt);
}

/* Set by software too, in rdpi_port_send: QEMU before version 8 has no interrupt for an empty register. */
static void usart1_interrupt(void)
{
    uint8_t byte;
    while ((reg_read(&USART1->sr) & USART_SR_TXE) != 0u && ring_take(&telemetry, &byte)) {
        reg_write(&USART1->dr, byte);
    }
    reg_write(&USART1->cr1, USART_CR1_UE | USART_CR1_TE | (ring_empty(&telemetry) ? 0u : USART_CR1_TXEIE));
}

bool rdpi_port_send(const uint8_t *bytes, size_t count)
{
    bool taken = ring_put(&telemetry, bytes, count);
    cortex_m_pend(USART1_IRQ);
    return taken;
}

void rdpi_port_idle(void)
{
    main_came_by = true;
    cortex_m_sleep();
}

CORTEX_M_VECTORS[] = {
    [TIM2_IRQ] = tim2_interrupt,
    [SPI1_IRQ] = spi1_interrupt,
    [USART1_IRQ] = usart1_interrupt,
    [TICK_IRQ] = tick_interrupt,
};
