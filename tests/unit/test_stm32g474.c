/* The STM32G474 port against registers in RAM (tests/support/stm32g474.inc). Addresses and values are written out from
 * the table in registers.h. */
#include "unity.h"

#include <math.h>
#include <string.h>

#define RDPI_STM32G474_FAKE
#define RDPI_SAFE_CODE 0x123u
#define RDPI_WATCHDOG_MS watchdog_ms
static unsigned watchdog_ms; /* 0: none */
#include "../../port/stm32g474/stm32g474.c"

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
#include "stm32g474.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* The rate that the registers make is the one asked for, to 0.1 %. */
static void makes(uint32_t rate_hz)
{
    setUp();
    started(rate_hz);
    TEST_ASSERT_TRUE(fake.tim6.psc <= 0xFFFF);
    TEST_ASSERT_TRUE(fake.tim6.arr > 0 && fake.tim6.arr <= 0xFFFF);
    double made_hz = core_hz() / (fake.tim6.psc + 1.0) / (fake.tim6.arr + 1.0);
    TEST_ASSERT_TRUE(fabs(made_hz / rate_hz - 1) <= 1e-3);
}

static void refuses(uint32_t rate_hz)
{
    setUp();
    SystemInit();
    TEST_ASSERT_FALSE(rdpi_port_start(rate_hz, tick));
    TEST_ASSERT_BITS_LOW(1u, fake.tim6.cr1);
    TEST_ASSERT_EQUAL_HEX32(0, enabled[54]);
}

void test_the_addresses(void)
{
    TEST_ASSERT_EQUAL_HEX32(0x40000000, TIM2_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x40001000, TIM6_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x40007080, PWR_BASE + offsetof(pwr_t, cr5));
    TEST_ASSERT_EQUAL_HEX32(0x40021000, RCC_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x40021094, RCC_BASE + offsetof(rcc_t, csr));
    TEST_ASSERT_EQUAL_HEX32(0x4000300C, IWDG_BASE + offsetof(iwdg_t, sr));
    TEST_ASSERT_EQUAL_HEX32(0x40022000, FLASH_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x48000000, GPIOA_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x50000808, DAC1_BASE + offsetof(dac_t, dhr12r1));
    TEST_ASSERT_EQUAL_HEX32(0x50000040, ADC1_BASE + offsetof(adc_t, dr));
    TEST_ASSERT_EQUAL_HEX32(0x50000308, ADC_COMMON_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x40004428, USART2_BASE + offsetof(usart_t, tdr));
}

void test_the_clock_is_170_MHz_in_boost_mode_with_four_wait_states(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_DOUBLE(170e6, core_hz());
    TEST_ASSERT_EQUAL_HEX32(0, fake.rcc.cfgr & 0x700); /* and so do APB1 and its timers */
    TEST_ASSERT_BITS_LOW(1u << 8, fake.pwr.cr5);
    TEST_ASSERT_EQUAL_HEX32(0x40604, fake.flash.acr); /* the caches stay on */
}

void test_the_clock_is_set_up_in_the_order_of_the_manual(void)
{
    SystemInit();
    unsigned pll = written(&fake.rcc.pllcfgr, 0xFFFFFFFF, 0x01005532, 0);
    unsigned on = written(&fake.rcc.cr, 1u << 24, 1u << 24, pll);
    unsigned half = written(&fake.rcc.cfgr, 0xF3, 0x81, on);
    unsigned boost = written(&fake.pwr.cr5, 1u << 8, 0, half);
    unsigned latency = written(&fake.flash.acr, 0xF, 4, boost);
    unsigned change_over = written(&fake.rcc.cfgr, 0xF3, 0x83, latency);
    written(&fake.rcc.cfgr, 0xF3, 0x03, change_over);
    TEST_ASSERT_TRUE(cfgr_reads > 85); /* 1 us at half the clock */
}

void test_a_clock_left_by_a_boot_loader_is_taken_down_first(void)
{
    SystemInit();
    count_writes = 0;
    SystemInit(); /* finds the PLL running and selected; the fake refuses to set it up like that */
    unsigned hsi = written(&fake.rcc.cfgr, 3, 1, 0);
    unsigned off = written(&fake.rcc.cr, 1u << 24, 0, hsi);
    written(&fake.rcc.pllcfgr, 0xFFFFFFFF, 0x01005532, off);
    TEST_ASSERT_EQUAL_DOUBLE(170e6, core_hz());
}

void test_without_the_oscillator_start_is_refused(void)
{
    fake.rcc.cr = 0;
    has_hsi = false;
    SystemInit();
    TEST_ASSERT_FALSE(rdpi_port_start(10000, tick));
}

void test_a_dac_that_does_not_become_ready_is_refused(void)
{
    has_dac = false;
    SystemInit();
    TEST_ASSERT_FALSE(rdpi_port_start(10000, tick));
    TEST_ASSERT_BITS_LOW(1u, fake.tim6.cr1);
}

void test_the_dac_is_on_before_main_at_the_safe_code(void)
{
    fake.gpioa.moder = 0xABFFFCFF;
    fake.dac1.mcr = 0x00070007;
    fake.dac1.cr = 0x00010003;
    SystemInit();
    TEST_ASSERT_BITS_HIGH(3u << 8, fake.gpioa.moder); /* PA4 analogue */
    TEST_ASSERT_EQUAL_HEX32(0x00078000, fake.dac1.mcr); /* channel 2 as it was */
    TEST_ASSERT_EQUAL_HEX32(0x00010001, fake.dac1.cr);
    TEST_ASSERT_EQUAL_HEX32(RDPI_SAFE_CODE, fake.dac1.dhr12r1);
    unsigned mode = written(&fake.dac1.mcr, 0xC000, 0x8000, 0);
    unsigned on = written(&fake.dac1.cr, 1, 1, written(&fake.dac1.dhr12r1, 0xFFFFFFFF, RDPI_SAFE_CODE, mode));
    for (unsigned k = 0; k < on; k++) { /* before the clock is touched */
        TEST_ASSERT_TRUE(writes[k].reg != &fake.rcc.cr && writes[k].reg != &fake.rcc.cfgr);
    }
}

void test_a_fault_ends_in_the_safe_code(void)
{
    started(10000);
    TEST_ASSERT_TRUE(write_code(0xABC));
    count_writes = 0;
    rdpi_port_safe();
    TEST_ASSERT_EQUAL_HEX32(RDPI_SAFE_CODE, fake.dac1.dhr12r1);
    TEST_ASSERT_EQUAL_UINT(1, count_writes); /* the output goes there without being switched off */
    TEST_ASSERT_TRUE(write_code(0xDEF));
    TEST_ASSERT_EQUAL_HEX32(0xDEF, fake.dac1.dhr12r1);
}

void test_a_fault_with_the_dac_off_switches_it_on_at_the_safe_code(void)
{
    rdpi_port_safe(); /* start-up has not come so far */
    TEST_ASSERT_EQUAL_HEX32(1, fake.dac1.cr & 3u);
    TEST_ASSERT_EQUAL_HEX32(RDPI_SAFE_CODE, fake.dac1.dhr12r1);
    fake.dac1.cr |= 2u; /* waiting for a trigger that does not come */
    rdpi_port_safe();
    TEST_ASSERT_EQUAL_HEX32(1, fake.dac1.cr & 3u);
}

void test_only_a_tick_that_has_returned_feeds_the_watchdog_and_only_while_main_lives(void)
{
    watchdog_is_fed_by_ticks();
    rdpi_port_idle();
    unsigned fed = watchdog_fed;
    device_vectors[54](); /* no update */
    fake.tim6.sr = 1;
    device_vectors[54](); /* one that was accounted for */
    TEST_ASSERT_EQUAL_UINT(fed, watchdog_fed);
}

void test_a_code_is_written(void)
{
    SystemInit();
    TEST_ASSERT_TRUE(write_code(0));
    TEST_ASSERT_EQUAL_HEX32(0, fake.dac1.dhr12r1);
    TEST_ASSERT_TRUE(write_code(0xABC));
    TEST_ASSERT_EQUAL_HEX32(0xABC, fake.dac1.dhr12r1);
    TEST_ASSERT_TRUE(write_code(0xFFF));
    TEST_ASSERT_EQUAL_HEX32(0xFFF, fake.dac1.dhr12r1);
}

void test_a_code_beyond_12_bits_outputs_nothing(void)
{
    SystemInit();
    TEST_ASSERT_TRUE(write_code(0x123));
    count_writes = 0;
    TEST_ASSERT_FALSE(write_code(0x1000));
    TEST_ASSERT_FALSE(write_code(0x1001));
    TEST_ASSERT_FALSE(write_code(UINT32_MAX));
    TEST_ASSERT_EQUAL_UINT(0, count_writes);
    TEST_ASSERT_EQUAL_HEX32(0x123, fake.dac1.dhr12r1);
}

void test_usual_rates(void)
{
    makes(10000);
    TEST_ASSERT_EQUAL_UINT32(0, fake.tim6.psc);
    TEST_ASSERT_EQUAL_UINT32(16999, fake.tim6.arr);
    makes(20000);
    TEST_ASSERT_EQUAL_UINT32(8499, fake.tim6.arr);
    makes(44100);
    TEST_ASSERT_EQUAL_UINT32(3854, fake.tim6.arr); /* 0.003 % */
}

void test_slow_rates_use_the_prescaler(void)
{
    makes(2594);
    TEST_ASSERT_EQUAL_UINT32(0, fake.tim6.psc);
    makes(2593);
    TEST_ASSERT_EQUAL_UINT32(1, fake.tim6.psc);
    makes(1000);
    makes(1);
}

void test_every_rate_up_to_340_kHz(void)
{
    for (uint32_t rate_hz = 1; rate_hz <= 340000; rate_hz += 1 + rate_hz / 50) {
        makes(rate_hz);
    }
}

void test_rates_out_of_range_are_refused(void)
{
    refuses(0);
    refuses(1000001);
    refuses(170000000);
    refuses(UINT32_MAX);
    makes(1000000);
}

void test_rates_that_would_only_be_met_roughly_are_refused(void)
{
    refuses(997000); /* 170.5 cycles */
    refuses(600000); /* 283.3 */
    makes(995000);   /* 170.85 */
}

void test_start_enables_the_interrupt_at_the_highest_priority_before_the_timer_runs(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_HEX32(0, enabled[54]);
    TEST_ASSERT_TRUE(rdpi_port_start(10000, tick));
    TEST_ASSERT_EQUAL_HEX32(0x01, enabled[54]);
    TEST_ASSERT_EQUAL_HEX32(0xC1, enabled[38]);
    TEST_ASSERT_EQUAL_HEX32(1, fake.tim6.dier);
    TEST_ASSERT_EQUAL_HEX32(0, fake.tim6.sr); /* no tick before the first period is over */
    unsigned update = written(&fake.tim6.egr, 1, 1, 0);
    unsigned cycles = written(&fake.tim2.cr1, 1, 1, update);
    written(&fake.tim6.cr1, 1, 1, cycles);
    TEST_ASSERT_EQUAL_HEX32(0xFFFFFFFF, fake.tim2.arr);
}

void test_a_tick_per_update_and_none_lost(void)
{
    started(10000);
    tick_cycles = 16000;
    for (unsigned k = 1; k <= 10; k++) {
        elapse(k * 17000 + 20 - fake.tim2.cnt);
        device_vectors[54]();
        TEST_ASSERT_EQUAL_UINT(k, ticks);
        TEST_ASSERT_EQUAL_HEX32(0, fake.tim6.sr);
    }
    TEST_ASSERT_EQUAL_UINT32(0, rdpi_port_overruns());
}

void test_an_interrupt_without_an_update_calls_nothing(void)
{
    started(10000);
    device_vectors[54]();
    TEST_ASSERT_EQUAL_UINT(0, ticks);
}

void test_a_tick_that_takes_too_long_loses_the_next(void)
{
    started(10000);
    elapse(17020);
    tick_cycles = 17000;
    device_vectors[54]();
    TEST_ASSERT_EQUAL_UINT32(1, rdpi_port_overruns());
    TEST_ASSERT_EQUAL_HEX32(0, fake.tim6.sr); /* dropped */
    device_vectors[54]();                     /* pending all the same */
    TEST_ASSERT_EQUAL_UINT(1, ticks);
    TEST_ASSERT_EQUAL_UINT32(1, rdpi_port_overruns());
    tick_cycles = 100;
    elapse(17000);
    device_vectors[54]();
    TEST_ASSERT_EQUAL_UINT(2, ticks);
    TEST_ASSERT_EQUAL_UINT32(1, rdpi_port_overruns());
}

void test_lost_ticks_are_counted_at_rates_that_use_the_prescaler(void)
{
    started(1000);
    elapse(170000 + 20);
    tick_cycles = 170000 * 2;
    device_vectors[54]();
    TEST_ASSERT_EQUAL_UINT32(2, rdpi_port_overruns());
    TEST_ASSERT_EQUAL_UINT(1, ticks);
}

void test_a_tick_entered_late_by_less_than_a_period_loses_none(void)
{
    started(10000);
    elapse(17000 + 16000);
    device_vectors[54]();
    elapse(1020);
    device_vectors[54]();
    TEST_ASSERT_EQUAL_UINT(2, ticks);
    TEST_ASSERT_EQUAL_UINT32(0, rdpi_port_overruns());
}

void test_an_update_that_was_counted_already_calls_no_tick(void)
{
    started(10000);
    elapse(17020);
    tick_cycles = 17000;
    device_vectors[54]();
    fake.tim6.sr = 1; /* it overflowed between the flag's reset and the reading of the count */
    device_vectors[54]();
    TEST_ASSERT_EQUAL_UINT(1, ticks);
    TEST_ASSERT_EQUAL_UINT32(1, rdpi_port_overruns());
}

void test_lost_ticks_are_counted_across_the_wrap_of_the_cycle_counter(void)
{
    started(10000);
    due = fake.tim2.cnt = 0u - 100u;
    fake.tim2.cnt += 17020;
    fake.tim6.sr = 1;
    device_vectors[54]();
    TEST_ASSERT_EQUAL_UINT(1, ticks);
    TEST_ASSERT_EQUAL_UINT32(0, rdpi_port_overruns());
}

void test_the_sensor_is_converted_without_end(void)
{
    fake.gpioa.moder = 0xABFFFFFC;
    SystemInit();
    TEST_ASSERT_BITS_HIGH(3u, fake.gpioa.moder); /* PA0 analogue */
    TEST_ASSERT_EQUAL_HEX32(0x10000005, fake.adc1.cr); /* regulator, started, on */
    TEST_ASSERT_EQUAL_HEX32(0x80003000, fake.adc1.cfgr); /* as after reset, and continuous, overwriting */
    TEST_ASSERT_EQUAL_HEX32(1u << 6, fake.adc1.sqr1);
    TEST_ASSERT_EQUAL_HEX32(5u << 3, fake.adc1.smpr1);
    fake.adc1.dr = 0xABC;
    TEST_ASSERT_EQUAL_INT32(0xABC, reading());
    TEST_ASSERT_EQUAL_INT32(0xABC, reading());
}

void test_a_converter_that_does_not_follow_gives_no_reading(void)
{
    has_calibration = false;
    SystemInit();
    TEST_ASSERT_BITS_LOW(1u | 1u << 2, fake.adc1.cr);
    TEST_ASSERT_EQUAL_INT32(RDPI_PORT_NO_READING, reading());
    has_calibration = true;
    has_adc = false;
    SystemInit();
    TEST_ASSERT_BITS_LOW(1u << 2, fake.adc1.cr);
    TEST_ASSERT_EQUAL_INT32(RDPI_PORT_NO_READING, reading());
    TEST_ASSERT_TRUE(rdpi_port_start(10000, tick));
}

void test_a_converter_left_by_a_boot_loader_is_reset(void)
{
    SystemInit();
    SystemInit(); /* the fake refuses to calibrate one that is on */
    TEST_ASSERT_BITS_HIGH(1u << 2, fake.adc1.cr);
    TEST_ASSERT_EQUAL_HEX32(0, fake.rcc.ahb2rstr);
    written(&fake.rcc.apb1rstr1, 1u << 17, 0, written(&fake.rcc.apb1rstr1, 1u << 17, 1u << 17, 0));
}

void test_the_pin_of_telemetry(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_HEX32(0x700, fake.gpioa.afrl);
    TEST_ASSERT_EQUAL_HEX32(2u << 4, fake.gpioa.ospeedr);
    TEST_ASSERT_EQUAL_HEX32(2u << 4, fake.gpioa.moder & 3u << 4);
}

void test_cycles_are_those_of_the_core(void)
{
    started(10000);
    elapse(12345);
    TEST_ASSERT_EQUAL_UINT32(12345, rdpi_port_cycles());
    TEST_ASSERT_EQUAL_HEX32(0, fake.tim2.psc);
}
