/* The STM32F405 port against registers in RAM that behave like the chip's where it matters: ready bits, the clock that
 * results, peripherals without a clock, an SPI whose bytes take time, a transmitter that is full at times. Addresses
 * and values are written out from the table in registers.h. The DAC's driver is the real one. */
#include "unity.h"

#include <math.h>
#include <string.h>

#include "ad5683r.h"

#define RDPI_STM32F405_FAKE
#define RDPI_SAFE_CODE 0x1234u
#define RDPI_WATCHDOG_MS watchdog_ms
static unsigned watchdog_ms; /* 0: none */
#include "../../port/stm32f405/stm32f405.c"

TEST_SOURCE_FILE("port/drivers/ad5683r.c")

/* What both ports do. */
void test_without_the_pll_start_is_refused(void);
void test_start_without_a_tick_is_refused(void);
void test_idle_sleeps(void);
void test_a_tick_entered_late_by_periods_counts_those_it_stands_for(void);
void test_a_tick_that_takes_periods_loses_as_many(void);
void test_the_count_of_lost_ticks_saturates(void);
void test_telemetry_goes_out_in_order_as_the_transmitter_takes_it(void);
void test_telemetry_that_does_not_fit_is_refused_whole(void);
void test_without_a_watchdog_its_registers_are_left_alone(void);
void test_the_watchdog_has_the_time_that_was_asked_for(void);
void test_the_watchdog_is_started_in_the_order_of_the_manual_before_the_timer(void);
void test_a_rate_that_would_not_feed_the_watchdog_is_refused(void);
void test_a_watchdog_that_does_not_start_is_told(void);
void test_a_reset_by_the_watchdog_is_told_once(void);

#define SAMPLE_TIMER tim2
#define TICK_INTERRUPT 55
#define TELEMETRY_INTERRUPT 37
#define USART usart1
#define USART_TAKES_ALL 0x2008
#define USART_WAITS 0x2088
#define USART_DIVIDER 28 /* of 84 MHz */
#define CSR_RMVF (1u << 24)
#include "stm32.inc"

static bool has_crystal, has_clock, spi_at_once;

/* The bus as the DAC sees it. */
static uint8_t spi_bytes[16];
static unsigned spi_count, spi_frames, reads_high, adc_waited; /* reads of some 12 ns: SYNC high, converter on */
static unsigned spi_frame_bytes, spi_sr_reads;
static bool spi_low, spi_shifting, spi_dead, in_interrupt, masked; /* masked: no interrupt runs, as in a fault */
static bool cut_allowed; /* a frame that was begun may be given up */

/* The AD5683R: what its last whole frames of either kind said. */
static uint32_t dac_code, dac_control;

static uint32_t tick_updates; /* how many updates a tick lasts */

static double core_hz(void)
{
    uint32_t pll = fake.rcc.pllcfgr;
    if ((fake.rcc.cfgr >> 2 & 3u) == 0u) {
        return 16e6;
    }
    TEST_ASSERT_EQUAL_UINT32(2, fake.rcc.cfgr >> 2 & 3u);
    TEST_ASSERT_BITS_HIGH(1u << 22, pll); /* from the crystal */
    double vco_hz = RDPI_HSE_HZ / (double)(pll & 0x3Fu) * (pll >> 6 & 0x1FFu);
    TEST_ASSERT_TRUE(vco_hz >= 100e6 && vco_hz <= 432e6);
    return vco_hz / (2u * ((pll >> 16 & 3u) + 1u));
}

/* RM0090 7.3.3: 0xx not divided, 100 by 2, 101 by 4; the core's 0xxx not, 1000 by 2. */
static double bus_hz(unsigned shift)
{
    uint32_t bits = fake.rcc.cfgr >> shift & 7u, core = fake.rcc.cfgr >> 4 & 0xFu;
    TEST_ASSERT_TRUE(core <= 8u);
    return core_hz() / (core < 8u ? 1u : 2u) / (bits < 4u ? 1u : 2u << (bits - 4u));
}

/* RM0090, table 10, 2.7 to 3.6 V; and the limits of the buses. */
static void check_clock(void)
{
    TEST_ASSERT_TRUE(core_hz() <= ((fake.flash.acr & 7u) + 1u) * 30e6);
    TEST_ASSERT_TRUE(core_hz() <= 168e6);
    TEST_ASSERT_TRUE(bus_hz(10) <= 42e6);
    TEST_ASSERT_TRUE(bus_hz(13) <= 84e6);
}

static void check_enabled(const uint32_t *reg)
{
    const char *at = (const char *)reg;
#define IN(block) (at >= (const char *)&fake.block && at < (const char *)(&fake.block + 1))
    if (IN(pwr)) {
        TEST_ASSERT_BITS_HIGH(1u << 28, fake.rcc.apb1enr);
    } else if (IN(tim2)) {
        TEST_ASSERT_BITS_HIGH(1u << 0, fake.rcc.apb1enr);
    } else if (IN(gpioa)) {
        TEST_ASSERT_BITS_HIGH(1u << 0, fake.rcc.ahb1enr);
    } else if (IN(usart1)) {
        TEST_ASSERT_BITS_HIGH(1u << 4, fake.rcc.apb2enr);
    } else if (IN(adc1) || IN(adc_common)) {
        TEST_ASSERT_BITS_HIGH(1u << 8, fake.rcc.apb2enr);
    } else if (IN(spi1)) {
        TEST_ASSERT_BITS_HIGH(1u << 12, fake.rcc.apb2enr);
    }
#undef IN
}

/* A byte is out: the flag, and the interrupt if it is wanted. */
static void spi_shifted(void)
{
    if (spi_shifting && !spi_dead && !in_interrupt) {
        spi_shifting = false;
        fake.spi1.sr |= 1u;
        if ((fake.spi1.cr2 & 1u << 6) != 0u && !masked) {
            in_interrupt = true;
            device_vectors[35]();
            in_interrupt = false;
        }
    }
}

static uint32_t reg_read(const uint32_t *reg)
{
    if (reg == &fake.gpioa.odr) { /* time passes */
        reads_high += !spi_low;
        adc_waited++;
        spi_shifted();
    } else if (reg == &fake.spi1.sr && ++spi_sr_reads > 10u) { /* polled */
        spi_shifted();
    } else if (reg == &fake.spi1.dr) {
        fake.spi1.sr &= ~1u;
    } else if (reg == &fake.usart1.sr) {
        return usart_status();
    }
    return *reg;
}

static void write_rcc_cr(uint32_t value)
{
    value &= ~(1u << 1 | 1u << 17 | 1u << 25);
    value |= (value & 1u << 0) << 1;
    value |= has_crystal ? (value & 1u << 16) << 1 : 0u;
    value |= has_pll ? (value & 1u << 24) << 1 : 0u;
    fake.rcc.cr = has_clock ? value : 0u;
}

static uint8_t spi_frame[3];

/* The table of ad5683r.h. */
static void dac_take(const uint8_t *frame)
{
    uint32_t data = (uint32_t)(frame[0] & 15u) << 12 | (uint32_t)frame[1] << 4 | frame[2] >> 4;
    if (frame[0] >> 4 == 3u) {
        dac_code = data;
    } else if (frame[0] >> 4 == 4u) {
        dac_control = data;
        dac_code = (data & 1u << 15) != 0u ? 0u : dac_code;
    }
}

static void write_bsrr(uint32_t value)
{
    fake.gpioa.odr = (fake.gpioa.odr | (value & 0xFFFFu)) & ~(value >> 16);
    bool low = (fake.gpioa.odr & 1u << 4) == 0u;
    TEST_ASSERT_TRUE(!spi_shifting || cut_allowed); /* an edge amid a byte */
    if (low && !spi_low) {
        TEST_ASSERT_TRUE(spi_frames == 0u || reads_high >= 7u); /* 80 ns and more */
        spi_frames++;
        spi_frame_bytes = 0;
    } else if (!low && spi_low) {
        TEST_ASSERT_TRUE(spi_frame_bytes == 3u || cut_allowed); /* whole frames only */
        if (spi_frame_bytes == 3u && !spi_shifting) {
            dac_take(spi_frame);
        }
        reads_high = 0;
    }
    spi_low = low;
}

static void write_spi_dr(uint32_t value)
{
    TEST_ASSERT_TRUE(spi_low);
    TEST_ASSERT_TRUE(!spi_shifting || spi_dead);
    TEST_ASSERT_BITS_HIGH(1u << 6, fake.spi1.cr1);
    TEST_ASSERT_TRUE(spi_frame_bytes < 3u);
    spi_frame[spi_frame_bytes++] = (uint8_t)value;
    spi_sr_reads = 0;
    if (spi_count < sizeof spi_bytes) {
        spi_bytes[spi_count] = (uint8_t)value;
    }
    spi_count++;
    spi_shifting = !spi_at_once;
    fake.spi1.sr |= spi_at_once;
}

static void reg_write(uint32_t *reg, uint32_t value)
{
    check_enabled(reg);
    record(reg, value);
    if (reg == &fake.rcc.cr) {
        write_rcc_cr(value);
    } else if (reg == &fake.rcc.cfgr) {
        fake.rcc.cfgr = (value & ~0xCu) | (value & 3u) << 2;
    } else if (reg == &fake.rcc.pllcfgr) {
        TEST_ASSERT_BITS_LOW(1u << 24 | 1u << 25, fake.rcc.cr); /* only to be written while the PLL is off */
        *reg = value;
    } else if (reg == &fake.gpioa.bsrr) {
        write_bsrr(value);
    } else if (reg == &fake.spi1.dr) {
        write_spi_dr(value);
    } else if (reg == &fake.usart1.dr) {
        usart_takes(value);
    } else if (reg == &fake.rcc.apb2rstr && (value & 1u << 12) != 0u) {
        memset(&fake.spi1, 0, sizeof fake.spi1);
        spi_shifting = false;
        *reg = value;
    } else if (reg == &fake.tim2.sr) {
        *reg &= value;
    } else if (watchdog_takes(reg, value)) {
    } else if (reg == &fake.adc1.cr2) {
        adc_waited = (*reg & 1u) != 0u ? adc_waited : 0u;
        *reg = value & ~(1u << 30);
        if ((value & 1u << 30) != 0u) {
            TEST_ASSERT_TRUE(adc_waited * 12u >= 3000u); /* the data sheet's time until it is stable */
            fake.adc1.sr |= 1u << 4 | 1u << 1;
        }
    } else {
        *reg = value;
    }
    if (has_clock) {
        check_clock();
    }
}

/* The chip after reset: HSI on and selected, no wait states. */
void setUp(void)
{
    memset(&fake, 0, sizeof fake);
    shared_power_up();
    fake.rcc.cr = 0x83;
    fake.rcc.pllcfgr = 0x24003010;
    fake.gpioa.moder = 0xA8000000;
    has_crystal = has_clock = true;
    dac_prepared = spi_at_once = spi_low = spi_shifting = spi_dead = in_interrupt = masked = cut_allowed = false;
    dac_code = dac_control = 0; /* power up */
    spi_count = spi_frames = reads_high = spi_left = 0;
    tick_updates = 0;
}

void tearDown(void)
{
}

/* QEMU: a clock that reads 0, SPI bytes that take no time, no interrupt of theirs. */
static void in_qemu(void)
{
    fake.rcc.cr = fake.rcc.pllcfgr = 0;
    has_clock = false;
    spi_at_once = true;
}

/* TIM2 overflows, and its interrupt runs. */
static void update(void)
{
    fake.tim2.sr |= 1u;
    pending = 0;
    device_vectors[28]();
    TEST_ASSERT_BITS_LOW(1u, fake.tim2.sr);
    TEST_ASSERT_EQUAL_UINT(55, pending);
}

static void periods(uint32_t count)
{
    for (uint32_t k = 0; k < count; k++) {
        update();
    }
}

static void tick_lasts(uint32_t count)
{
    tick_updates = count;
}

static void tick(void)
{
    ticks++;
    fed_in_tick = watchdog_fed;
    periods(tick_updates);
}

static void started(uint32_t rate_hz)
{
    SystemInit();
    TEST_ASSERT_TRUE(rdpi_port_start(rate_hz, tick));
}

static void makes(uint32_t rate_hz)
{
    setUp();
    started(rate_hz);
    double made_hz = 2 * bus_hz(10) / (fake.tim2.arr + 1.0);
    TEST_ASSERT_TRUE(fabs(made_hz / rate_hz - 1) <= 1e-3);
}

static void refuses(uint32_t rate_hz)
{
    setUp();
    SystemInit();
    TEST_ASSERT_FALSE(rdpi_port_start(rate_hz, tick));
    TEST_ASSERT_BITS_LOW(1u, fake.tim2.cr1);
}

/* What start-up sends is out and forgotten. */
static void booted(void)
{
    SystemInit();
    spi_count = spi_frames = 0;
}

/* Lets all that is being sent go out. */
static void spi_drain(void)
{
    while (spi_shifting) {
        spi_shifted();
    }
}

void test_the_addresses(void)
{
    TEST_ASSERT_EQUAL_HEX32(0x4000002C, TIM2_BASE + offsetof(tim_t, arr));
    TEST_ASSERT_EQUAL_HEX32(0x40007000, PWR_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x4001100C, USART1_BASE + offsetof(usart_t, cr1));
    TEST_ASSERT_EQUAL_HEX32(0x4001204C, ADC1_BASE + offsetof(adc_t, dr));
    TEST_ASSERT_EQUAL_HEX32(0x40012304, ADC_COMMON_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x4001300C, SPI1_BASE + offsetof(spi_t, dr));
    TEST_ASSERT_EQUAL_HEX32(0x40020018, GPIOA_BASE + offsetof(gpio_t, bsrr));
    TEST_ASSERT_EQUAL_HEX32(0x40023844, RCC_BASE + offsetof(rcc_t, apb2enr));
    TEST_ASSERT_EQUAL_HEX32(0x40023874, RCC_BASE + offsetof(rcc_t, csr));
    TEST_ASSERT_EQUAL_HEX32(0x40023C00, FLASH_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x4000300C, IWDG_BASE + offsetof(iwdg_t, sr));
    TEST_ASSERT_EQUAL_HEX32(0xE0001004, DWT_BASE + offsetof(dwt_t, cyccnt));
    TEST_ASSERT_EQUAL_HEX32(0xE000EDFC, DEMCR_BASE);
}

void test_the_clock_is_168_MHz_from_the_crystal(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_DOUBLE(168e6, core_hz());
    TEST_ASSERT_EQUAL_DOUBLE(42e6, bus_hz(10));
    TEST_ASSERT_EQUAL_DOUBLE(84e6, bus_hz(13));
    TEST_ASSERT_EQUAL_HEX32(0x705, fake.flash.acr);
    TEST_ASSERT_EQUAL_HEX32(0x07405408, fake.rcc.pllcfgr); /* 8 MHz / 8 * 336 / 2, USB / 7 */
    TEST_ASSERT_BITS_HIGH(1u << 14, fake.pwr.cr);
}

void test_the_clock_is_set_up_in_the_order_of_the_manual(void)
{
    SystemInit();
    unsigned pll = written(&fake.rcc.pllcfgr, 0xFFFFFFFF, 0x07405408, 0);
    unsigned on = written(&fake.rcc.cr, 1u << 24, 1u << 24, pll);
    unsigned latency = written(&fake.flash.acr, 7, 5, on);
    unsigned buses = written(&fake.rcc.cfgr, 0xFCF3, 0x9400, latency);
    written(&fake.rcc.cfgr, 3, 2, buses);
}

void test_a_clock_left_by_a_boot_loader_is_taken_down_first(void)
{
    SystemInit();
    count_writes = 0;
    fake.rcc.cfgr |= 8u << 4; /* the core at half the clock */
    SystemInit();             /* finds the PLL running and selected; the fake refuses to set it up like that */
    unsigned hsi = written(&fake.rcc.cfgr, 3, 0, 0);
    unsigned off = written(&fake.rcc.cr, 1u << 24, 0, hsi);
    written(&fake.rcc.pllcfgr, 0xFFFFFFFF, 0x07405408, off);
    TEST_ASSERT_EQUAL_DOUBLE(168e6, core_hz());
    TEST_ASSERT_EQUAL_DOUBLE(84e6, bus_hz(13));
}

void test_peripherals_left_by_a_boot_loader_are_reset(void)
{
    SystemInit();
    written(&fake.rcc.apb1rstr, 1, 0, written(&fake.rcc.apb1rstr, 1, 1, 0));
    for (unsigned bit = 4; bit <= 12; bit += 4) { /* USART1, ADC1, SPI1 */
        written(&fake.rcc.apb2rstr, 1u << bit, 0, written(&fake.rcc.apb2rstr, 1u << bit, 1u << bit, 0));
    }
}

void test_without_a_crystal_start_is_refused(void)
{
    has_crystal = false;
    SystemInit();
    TEST_ASSERT_EQUAL_DOUBLE(16e6, core_hz());
    TEST_ASSERT_FALSE(rdpi_port_start(10000, tick));
}

void test_in_qemu_without_a_clock_unit_it_goes_on(void)
{
    in_qemu();
    started(10000);
    TEST_ASSERT_EQUAL_HEX32(1, fake.tim2.cr1);
    TEST_ASSERT_EQUAL_INT32(RDPI_PORT_NO_READING, rdpi_port_read_adc());
    for (unsigned k = 0; k < count_writes; k++) { /* some versions would give back what is written */
        TEST_ASSERT_NOT_EQUAL(&fake.rcc.cr, writes[k].reg);
    }
}

void test_the_pins(void)
{
    fake.gpioa.moder = 0xFFFFFFFF;
    fake.gpioa.afr[0] = fake.gpioa.afr[1] = 0xFFFFFFFF;
    SystemInit();
    /* PA0 analogue, PA4 output, PA5, PA7, PA9 alternate */
    TEST_ASSERT_EQUAL_HEX32(0xFFFBB9FF, fake.gpioa.moder);
    TEST_ASSERT_EQUAL_HEX32(0x5F5FFFFF, fake.gpioa.afr[0]);
    TEST_ASSERT_EQUAL_HEX32(0xFFFFFF7F, fake.gpioa.afr[1]);
    TEST_ASSERT_EQUAL_HEX32(0x00088A00, fake.gpioa.ospeedr);
    /* SYNC is high before it is an output */
    written(&fake.gpioa.moder, 3u << 8, 1u << 8, written(&fake.gpioa.bsrr, 0xFFFFFFFF, 1u << 4, 0));
}

void test_the_spi_is_a_master_in_mode_1_at_10_5_MHz(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_HEX32(0x355, fake.spi1.cr1); /* SSM, SSI, SPE, /8, MSTR, CPHA */
    TEST_ASSERT_EQUAL_DOUBLE(10.5e6, bus_hz(13) / (2u << (fake.spi1.cr1 >> 3 & 7u)));
    TEST_ASSERT_EQUAL_HEX32(0x41, enabled[35]);
}

void test_the_first_code_starts_the_dac_and_is_sent(void)
{
    const uint8_t expected[] = {0x48, 0x00, 0x00, 0x40, 0x80, 0x00, 0x3A, 0xBC, 0xD0};
    booted();
    TEST_ASSERT_TRUE(rdpi_port_write_dac(0xABCD));
    TEST_ASSERT_TRUE(rdpi_spi_busy());
    spi_drain();
    TEST_ASSERT_FALSE(rdpi_spi_busy());
    TEST_ASSERT_EQUAL_UINT(9, spi_count);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(expected, spi_bytes, 9);
    TEST_ASSERT_EQUAL_UINT(3, spi_frames);
    TEST_ASSERT_FALSE(spi_low);
    TEST_ASSERT_EQUAL_HEX32(0, fake.spi1.cr2);
}

void test_in_qemu_frames_go_out_without_interrupts(void)
{
    in_qemu();
    booted();
    TEST_ASSERT_TRUE(rdpi_port_write_dac(0xABCD));
    TEST_ASSERT_FALSE(rdpi_spi_busy());
    TEST_ASSERT_EQUAL_UINT(9, spi_count);
    TEST_ASSERT_EQUAL_UINT(3, spi_frames);
    TEST_ASSERT_EQUAL_HEX8(0x3A, spi_bytes[6]);
}

void test_two_frames_have_chip_select_high_between_them(void)
{
    const uint8_t bytes[] = {1, 2, 3, 4, 5, 6};
    booted();
    rdpi_spi_write(bytes, 2);
    spi_drain();
    TEST_ASSERT_EQUAL_HEX8_ARRAY(bytes, spi_bytes, 6);
    TEST_ASSERT_EQUAL_UINT(6, spi_count);
    TEST_ASSERT_EQUAL_UINT(2, spi_frames);
    TEST_ASSERT_FALSE(spi_low);
    TEST_ASSERT_TRUE(reads_high >= 7); /* before it is no longer busy */
}

void test_a_code_while_the_one_before_is_sent_is_refused(void)
{
    booted();
    TEST_ASSERT_TRUE(rdpi_port_write_dac(1));
    TEST_ASSERT_FALSE(rdpi_port_write_dac(2));
    spi_drain();
    TEST_ASSERT_EQUAL_UINT(9, spi_count);
    TEST_ASSERT_EQUAL_UINT32(1, dac.busy_count);
    TEST_ASSERT_TRUE(rdpi_port_write_dac(2));
}

void test_a_code_beyond_16_bits_outputs_nothing(void)
{
    booted();
    TEST_ASSERT_TRUE(rdpi_port_write_dac(0xFFFF));
    spi_drain();
    TEST_ASSERT_FALSE(rdpi_port_write_dac(0x10000));
    TEST_ASSERT_FALSE(rdpi_port_write_dac(UINT32_MAX));
    TEST_ASSERT_EQUAL_UINT(9, spi_count);
    TEST_ASSERT_EQUAL_UINT32(2, dac.code_count);
}

void test_after_reset_the_safe_code_is_out_before_anything_else(void)
{
    const uint8_t expected[] = {0x40, 0x80, 0x00, 0x31, 0x23, 0x40}; /* gain 2, then the code */
    SystemInit();
    TEST_ASSERT_EQUAL_UINT(6, spi_count);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(expected, spi_bytes, 6);
    TEST_ASSERT_EQUAL_HEX32(RDPI_SAFE_CODE, dac_code);
    /* before the clock, which may have no crystal */
    unsigned last = written(&fake.spi1.dr, 0xFF, 0x40, written(&fake.spi1.dr, 0xFF, 0x23, 0));
    written(&fake.rcc.cr, 1u << 16, 1u << 16, last);
    for (unsigned k = 0; k < last; k++) {
        TEST_ASSERT_NOT_EQUAL(&fake.rcc.cr, writes[k].reg);
    }
}

void test_a_warm_start_leads_a_dac_that_kept_its_code_to_the_safe_one(void)
{
    dac_code = 0xABCD;
    dac_control = 1u << 11;
    SystemInit();
    TEST_ASSERT_EQUAL_HEX32(RDPI_SAFE_CODE, dac_code);
    TEST_ASSERT_EQUAL_HEX32(1u << 11, dac_control);
}

/* A fault when so many bytes of a frame are out and perhaps the next is on its way; what variables hold may be lost. */
static void faults_after(unsigned bytes, bool amid, bool lost)
{
    setUp();
    started(10000);
    spi_drain();
    TEST_ASSERT_TRUE(rdpi_port_write_dac(0xABCD));
    for (unsigned k = 0; k < bytes; k++) {
        spi_shifted();
    }
    TEST_ASSERT_EQUAL(bytes < 3u, spi_low);
    spi_shifting = spi_shifting && amid;
    if (lost) {
        memset(&dac, 0xA5, sizeof dac);
        spi_left = 0xA5A5A5A5u;
        spi_next = NULL;
    }
    cut_allowed = masked = true;
    rdpi_port_safe();
    TEST_ASSERT_EQUAL_HEX32(RDPI_SAFE_CODE, dac_code);
    TEST_ASSERT_EQUAL_HEX32(1u << 11, dac_control);
    TEST_ASSERT_FALSE(spi_low);
    TEST_ASSERT_FALSE(rdpi_spi_busy());
}

void test_a_fault_at_any_point_of_a_frame_ends_in_the_safe_code_with_chip_select_high(void)
{
    for (unsigned bytes = 0; bytes <= 3; bytes++) {
        for (unsigned how = 0; how < 4; how++) {
            faults_after(bytes, how % 2u == 0, how / 2u == 0);
        }
    }
}

void test_a_fault_before_start_up_has_prepared_anything_ends_in_the_safe_code(void)
{
    rdpi_port_safe();
    TEST_ASSERT_EQUAL_HEX32(RDPI_SAFE_CODE, dac_code);
}

void test_the_safe_state_is_given_up_on_a_bus_that_does_not_answer(void)
{
    spi_dead = cut_allowed = true;
    fake.rcc.apb2rstr = 0;
    rdpi_port_safe();
    TEST_ASSERT_FALSE(spi_low);
}

void test_a_code_after_the_safe_one_is_sent_again(void)
{
    faults_after(1, true, false);
    masked = cut_allowed = false;
    device_vectors[35](); /* pending all the same */
    TEST_ASSERT_TRUE(rdpi_port_write_dac(0x4321));
    spi_drain();
    TEST_ASSERT_EQUAL_HEX32(0x4321, dac_code);
}

void test_only_a_tick_that_has_returned_feeds_the_watchdog_and_only_while_main_lives(void)
{
    watchdog_is_fed_by_ticks();
    rdpi_port_idle();
    unsigned fed = watchdog_fed;
    device_vectors[28](); /* the timer alone, and a tick that was dropped */
    served = updates;
    device_vectors[55]();
    TEST_ASSERT_EQUAL_UINT(fed, watchdog_fed);
}

void test_rates(void)
{
    makes(10000);
    TEST_ASSERT_EQUAL_UINT32(8399, fake.tim2.arr);
    makes(20000);
    TEST_ASSERT_EQUAL_UINT32(4199, fake.tim2.arr);
    makes(1);
    TEST_ASSERT_EQUAL_UINT32(83999999, fake.tim2.arr);
    for (uint32_t rate_hz = 1; rate_hz <= 100000; rate_hz += 1 + rate_hz / 20) {
        makes(rate_hz);
    }
    makes(100000);
}

void test_rates_out_of_range_are_refused(void)
{
    refuses(0);
    refuses(100001);
    refuses(UINT32_MAX);
}

void test_start_without_the_dac_is_refused(void)
{
    SystemInit();
    fake.spi1.cr1 = 1u << 6;
    dac_prepared = true;
    rdpi_ad5683r_init(&dac, &wiring);
    spi_left = 1; /* a transfer that does not end */
    TEST_ASSERT_FALSE(rdpi_port_start(10000, tick));
    TEST_ASSERT_FALSE(rdpi_port_write_dac(1));
}

void test_start_enables_the_interrupts_before_the_timer_runs(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_HEX32(0, enabled[28]);
    TEST_ASSERT_TRUE(rdpi_port_start(10000, tick));
    /* the timer above the SPI above the tick above telemetry */
    TEST_ASSERT_EQUAL_HEX32(0x01, enabled[28]);
    TEST_ASSERT_EQUAL_HEX32(0x41, enabled[35]);
    TEST_ASSERT_EQUAL_HEX32(0x81, enabled[55]);
    TEST_ASSERT_EQUAL_HEX32(0xC1, enabled[37]);
    unsigned interrupt = written(&fake.tim2.dier, 1, 1, 0);
    written(&fake.tim2.cr1, 1, 1, written(&fake.tim2.arr, 0xFFFFFFFF, 8399, interrupt));
    TEST_ASSERT_EQUAL_UINT(0, ticks);
}

void test_a_tick_per_update_and_none_lost(void)
{
    started(10000);
    for (unsigned k = 1; k <= 10; k++) {
        update();
        device_vectors[55]();
        TEST_ASSERT_EQUAL_UINT(k, ticks);
    }
    TEST_ASSERT_EQUAL_UINT32(0, rdpi_port_overruns());
}

void test_lost_ticks_are_counted_across_the_wrap_of_the_updates(void)
{
    started(10000);
    updates = served = UINT32_MAX - 1;
    update();
    update();
    device_vectors[55]();
    TEST_ASSERT_EQUAL_UINT(1, ticks);
    TEST_ASSERT_EQUAL_UINT32(1, rdpi_port_overruns());
}

void test_the_sensor_is_converted_without_end(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_HEX32(1u << 16, fake.adc_common.ccr);
    TEST_ASSERT_EQUAL_DOUBLE(21e6, bus_hz(13) / 4);
    TEST_ASSERT_EQUAL_HEX32(4, fake.adc1.smpr2);
    TEST_ASSERT_EQUAL_HEX32(3, fake.adc1.cr2);
    fake.adc1.dr = 0xABC;
    TEST_ASSERT_EQUAL_INT32(0xABC, rdpi_port_read_adc());
    TEST_ASSERT_EQUAL_INT32(0xABC, rdpi_port_read_adc());
}

void test_cycles_are_those_of_the_core(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_HEX32(1u << 24, fake.demcr.demcr);
    TEST_ASSERT_EQUAL_HEX32(1, fake.dwt.ctrl);
    fake.dwt.cyccnt = 123456;
    TEST_ASSERT_EQUAL_UINT32(123456, rdpi_port_cycles());
}
