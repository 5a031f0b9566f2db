/* The STM32F405 port against registers in RAM (tests/support/stm32f405.inc). Addresses and values are written out from
 * the table in registers.h. The DAC's driver is the real one. */
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
#include "stm32f405.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

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
    TEST_ASSERT_EQUAL_INT32(RDPI_PORT_NO_READING, reading());
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
    TEST_ASSERT_TRUE(write_code(0xABCD));
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
    TEST_ASSERT_TRUE(write_code(0xABCD));
    TEST_ASSERT_FALSE(rdpi_spi_busy());
    TEST_ASSERT_EQUAL_UINT(9, spi_count);
    TEST_ASSERT_EQUAL_UINT(3, spi_frames);
    TEST_ASSERT_EQUAL_HEX8(0x3A, spi_bytes[6]);
}

void test_two_frames_have_chip_select_high_between_them(void)
{
    const uint8_t bytes[] = {1, 2, 3, 4, 5, 6};
    booted();
    rdpi_spi_write(bytes, 3, 2);
    spi_drain();
    TEST_ASSERT_EQUAL_HEX8_ARRAY(bytes, spi_bytes, 6);
    TEST_ASSERT_EQUAL_UINT(6, spi_count);
    TEST_ASSERT_EQUAL_UINT(2, spi_frames);
    TEST_ASSERT_FALSE(spi_low);
    TEST_ASSERT_TRUE(reads_high >= 7); /* before it is no longer busy */
}

void test_frames_of_two_bytes_have_chip_select_high_between_them(void)
{
    const uint8_t bytes[] = {1, 2, 3, 4};
    booted();
    spi_whole_frame = 2;
    rdpi_spi_write(bytes, 2, 2);
    spi_drain();
    TEST_ASSERT_EQUAL_HEX8_ARRAY(bytes, spi_bytes, 4);
    TEST_ASSERT_EQUAL_UINT(4, spi_count);
    TEST_ASSERT_EQUAL_UINT(2, spi_frames);
    TEST_ASSERT_FALSE(spi_low);
    TEST_ASSERT_FALSE(rdpi_spi_busy());
}

void test_a_code_while_the_one_before_is_sent_is_refused(void)
{
    booted();
    TEST_ASSERT_TRUE(write_code(1));
    TEST_ASSERT_FALSE(write_code(2));
    spi_drain();
    TEST_ASSERT_EQUAL_UINT(9, spi_count);
    TEST_ASSERT_EQUAL_UINT32(1, dac.busy_count);
    TEST_ASSERT_TRUE(write_code(2));
}

void test_a_code_beyond_16_bits_outputs_nothing(void)
{
    booted();
    TEST_ASSERT_TRUE(write_code(0xFFFF));
    spi_drain();
    TEST_ASSERT_FALSE(write_code(0x10000));
    TEST_ASSERT_FALSE(write_code(UINT32_MAX));
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
    TEST_ASSERT_TRUE(write_code(0xABCD));
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
    TEST_ASSERT_TRUE(write_code(0x4321));
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
    TEST_ASSERT_FALSE(write_code(1));
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
    TEST_ASSERT_EQUAL_INT32(0xABC, reading());
    TEST_ASSERT_EQUAL_INT32(0xABC, reading());
}

void test_cycles_are_those_of_the_core(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_HEX32(1u << 24, fake.demcr.demcr);
    TEST_ASSERT_EQUAL_HEX32(1, fake.dwt.ctrl);
    fake.dwt.cyccnt = 123456;
    TEST_ASSERT_EQUAL_UINT32(123456, rdpi_port_cycles());
}
