/* The STM32G474 port against registers in RAM that behave like the chip's where it matters: ready bits, the clock that
 * results, flags cleared by writing 0, peripherals without a clock. Every write is checked and recorded. Addresses and
 * values are written out from the table in registers.h. */
#include "unity.h"

#include <math.h>
#include <string.h>

#define RDPI_STM32G474_FAKE
#include "../../port/stm32g474/stm32g474.c"

#define WRITES 64

static struct {
    const uint32_t *reg;
    uint32_t value;
} writes[WRITES];
static unsigned count_writes, cfgr_reads, syncs, sleeps;
static bool has_pll, has_hsi;

/* The period of the sample timer and TIM2's count at its start. */
static uint32_t cycles_per_tick;
static unsigned ticks;
static uint32_t tick_cycles; /* how long a tick takes */

/* Computed from the fields as RM0440 7.4.3 and 7.4.4 say. */
static double sysclk_hz(void)
{
    if (((fake.rcc.cfgr >> 2) & 3u) == 1u) {
        return 16e6;
    }
    uint32_t pll = fake.rcc.pllcfgr;
    TEST_ASSERT_EQUAL_UINT32(3, (fake.rcc.cfgr >> 2) & 3u);
    TEST_ASSERT_EQUAL_UINT32(2, pll & 3u); /* from HSI16 */
    TEST_ASSERT_BITS_HIGH(1u << 24, pll);  /* output R enabled */
    return 16e6 / ((pll >> 4 & 0xFu) + 1u) * (pll >> 8 & 0x7Fu) / (2u * ((pll >> 25 & 3u) + 1u));
}

static double hclk_hz(void)
{
    uint32_t hpre = fake.rcc.cfgr >> 4 & 0xFu;
    TEST_ASSERT_TRUE(hpre == 0 || hpre == 8);
    return sysclk_hz() / (hpre == 8 ? 2 : 1);
}

/* RM0440, tables 9 and 38: no clock that the regulator and the flash memory do not keep up with. */
static void check_clock(void)
{
    bool boost = (fake.pwr.cr5 & 1u << 8) == 0;
    uint32_t wait_states = fake.flash.acr & 0xFu;
    TEST_ASSERT_TRUE(sysclk_hz() <= (boost ? 170e6 : 150e6));
    TEST_ASSERT_TRUE(hclk_hz() <= (wait_states + 1u) * (boost ? 34e6 : 30e6));
}

static void check_enabled(const uint32_t *reg)
{
    const char *at = (const char *)reg;
#define IN(block) (at >= (const char *)&fake.block && at < (const char *)(&fake.block + 1))
    if (IN(pwr)) {
        TEST_ASSERT_BITS_HIGH(1u << 28, fake.rcc.apb1enr1);
    } else if (IN(tim2)) {
        TEST_ASSERT_BITS_HIGH(1u << 0, fake.rcc.apb1enr1);
    } else if (IN(tim6)) {
        TEST_ASSERT_BITS_HIGH(1u << 4, fake.rcc.apb1enr1);
    } else if (IN(gpioa)) {
        TEST_ASSERT_BITS_HIGH(1u << 0, fake.rcc.ahb2enr);
    } else if (IN(dac1)) {
        TEST_ASSERT_BITS_HIGH(1u << 16, fake.rcc.ahb2enr);
    }
#undef IN
}

static uint32_t reg_read(const uint32_t *reg)
{
    cfgr_reads += reg == &fake.rcc.cfgr;
    return *reg;
}

static void write_rcc_cr(uint32_t value)
{
    value &= ~(1u << 10 | 1u << 25);
    value |= has_hsi && (value & 1u << 8) ? 1u << 10 : 0;
    value |= has_pll && (value & 1u << 24) ? 1u << 25 : 0;
    fake.rcc.cr = value;
}

static void reg_write(uint32_t *reg, uint32_t value)
{
    check_enabled(reg);
    if (count_writes < WRITES) {
        writes[count_writes].reg = reg;
        writes[count_writes].value = value;
        count_writes++;
    }
    double before_hz = hclk_hz();
    if (reg == &fake.rcc.cr) {
        write_rcc_cr(value);
    } else if (reg == &fake.rcc.cfgr) {
        fake.rcc.cfgr = (value & ~0xCu) | (value & 3u) << 2;
    } else if (reg == &fake.rcc.pllcfgr) {
        TEST_ASSERT_BITS_LOW(1u << 24 | 1u << 25, fake.rcc.cr); /* only to be written while the PLL is off */
        *reg = value;
    } else if (reg == &fake.dac1.mcr) {
        TEST_ASSERT_BITS_LOW(1u, fake.dac1.cr); /* ignored while the channel is on */
        *reg = value;
    } else if (reg == &fake.dac1.cr) {
        *reg = value;
        fake.dac1.sr = (value & 1u) << 11;
    } else if (reg == &fake.tim6.sr) {
        *reg &= value;
    } else if (reg == &fake.tim6.egr || reg == &fake.tim2.egr) {
        tim_t *timer = reg == &fake.tim6.egr ? &fake.tim6 : &fake.tim2;
        timer->cnt = 0;
        timer->sr |= (timer->cr1 & 1u << 2) == 0; /* URS */
    } else if (reg == &fake.nvic.iser[1]) {
        *reg |= value;
    } else {
        *reg = value;
    }
    check_clock();
    if (before_hz <= 16e6) { /* above 150 MHz only by way of half of it */
        TEST_ASSERT_TRUE(hclk_hz() <= 85e6);
    }
}

static void core_sync(void)
{
    syncs++;
}

static void core_sleep(void)
{
    sleeps++;
}

/* The chip after reset: HSI16 on and selected, Range 1 normal, one wait state. */
void setUp(void)
{
    memset(&fake, 0, sizeof fake);
    fake.rcc.cr = 1u << 8 | 1u << 10;
    fake.rcc.cfgr = 5;
    fake.rcc.pllcfgr = 0x1000;
    fake.pwr.cr5 = 1u << 8;
    fake.flash.acr = 0x40601;
    fake.gpioa.moder = 0xABFFFFFF;
    fake.nvic.ipr[13] = 0x11223344;
    has_pll = has_hsi = true;
    count_writes = cfgr_reads = syncs = sleeps = ticks = 0;
    tick_cycles = 0;
}

void tearDown(void)
{
}

/* The index of the first write of this value, at or after `from`. */
static unsigned written(const uint32_t *reg, uint32_t mask, uint32_t value, unsigned from)
{
    for (unsigned k = from; k < count_writes; k++) {
        if (writes[k].reg == reg && (writes[k].value & mask) == value) {
            return k;
        }
    }
    TEST_FAIL_MESSAGE("not written, or not in this order");
    return 0;
}

/* Lets time pass; the flag goes up when TIM6 overflows. */
static void elapse(uint32_t cycles)
{
    uint32_t before = fake.tim2.cnt;
    fake.tim2.cnt += cycles;
    if (before / cycles_per_tick != fake.tim2.cnt / cycles_per_tick) {
        fake.tim6.sr |= 1;
    }
}

static void tick(void)
{
    ticks++;
    TEST_ASSERT_EQUAL_HEX32(0, fake.tim6.sr); /* acknowledged */
    elapse(tick_cycles);
}

static void started(uint32_t rate_hz)
{
    SystemInit();
    TEST_ASSERT_TRUE(rdpi_port_start(rate_hz, tick));
    cycles_per_tick = (fake.tim6.psc + 1) * (fake.tim6.arr + 1);
}

/* The rate that the registers make is the one asked for, to 0.1 %. */
static void makes(uint32_t rate_hz)
{
    setUp();
    started(rate_hz);
    TEST_ASSERT_TRUE(fake.tim6.psc <= 0xFFFF);
    TEST_ASSERT_TRUE(fake.tim6.arr > 0 && fake.tim6.arr <= 0xFFFF);
    double made_hz = hclk_hz() / (fake.tim6.psc + 1.0) / (fake.tim6.arr + 1.0);
    TEST_ASSERT_TRUE(fabs(made_hz / rate_hz - 1) <= 1e-3);
}

static void refuses(uint32_t rate_hz)
{
    setUp();
    SystemInit();
    TEST_ASSERT_FALSE(rdpi_port_start(rate_hz, tick));
    TEST_ASSERT_BITS_LOW(1u, fake.tim6.cr1);
    TEST_ASSERT_EQUAL_HEX32(0, fake.nvic.iser[1]);
}

void test_the_addresses(void)
{
    TEST_ASSERT_EQUAL_HEX32(0x40000000, TIM2_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x40001000, TIM6_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x40007080, PWR_BASE + offsetof(pwr_t, cr5));
    TEST_ASSERT_EQUAL_HEX32(0x40021000, RCC_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x40022000, FLASH_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x48000000, GPIOA_BASE);
    TEST_ASSERT_EQUAL_HEX32(0x50000808, DAC1_BASE + offsetof(dac_t, dhr12r1));
    TEST_ASSERT_EQUAL_HEX32(0xE000E104, NVIC_BASE + offsetof(nvic_t, iser) + 4);
    TEST_ASSERT_EQUAL_HEX32(0xE000E434, NVIC_BASE + offsetof(nvic_t, ipr) + 4 * 13);
    TEST_ASSERT_EQUAL_HEX32(0xE000ED88, CPACR_BASE);
}

void test_the_clock_is_170_MHz_in_boost_mode_with_four_wait_states(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_DOUBLE(170e6, hclk_hz());
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
    TEST_ASSERT_EQUAL_DOUBLE(170e6, hclk_hz());
}

void test_the_fpu_is_on_before_anything_else(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_PTR(&fake.cpacr.cpacr, writes[0].reg);
    TEST_ASSERT_EQUAL_HEX32(0x00F00000, fake.cpacr.cpacr);
    TEST_ASSERT_EQUAL_UINT(1, syncs);
}

void test_without_the_pll_start_is_refused(void)
{
    has_pll = false;
    SystemInit();
    TEST_ASSERT_EQUAL_DOUBLE(16e6, hclk_hz());
    TEST_ASSERT_FALSE(rdpi_port_start(10000, tick));
}

void test_without_the_oscillator_start_is_refused(void)
{
    fake.rcc.cr = 0;
    has_hsi = false;
    SystemInit();
    TEST_ASSERT_FALSE(rdpi_port_start(10000, tick));
}

void test_the_dac_is_on_before_main_at_code_0(void)
{
    fake.gpioa.moder = 0xABFFFCFF;
    fake.dac1.mcr = 0x00070007;
    fake.dac1.cr = 0x00010003;
    SystemInit();
    TEST_ASSERT_EQUAL_HEX32(0xABFFFFFF, fake.gpioa.moder);
    TEST_ASSERT_EQUAL_HEX32(0x00078000, fake.dac1.mcr); /* channel 2 as it was */
    TEST_ASSERT_EQUAL_HEX32(0x00010001, fake.dac1.cr);
    TEST_ASSERT_EQUAL_HEX32(0, fake.dac1.dhr12r1);
    unsigned mode = written(&fake.dac1.mcr, 0xC000, 0x8000, 0);
    written(&fake.dac1.cr, 1, 1, written(&fake.dac1.dhr12r1, 0xFFFFFFFF, 0, mode));
}

void test_a_code_is_written_and_its_higher_bits_ignored(void)
{
    SystemInit();
    rdpi_port_write_dac(0);
    TEST_ASSERT_EQUAL_HEX32(0, fake.dac1.dhr12r1);
    rdpi_port_write_dac(0xABC);
    TEST_ASSERT_EQUAL_HEX32(0xABC, fake.dac1.dhr12r1);
    rdpi_port_write_dac(0xFFF);
    TEST_ASSERT_EQUAL_HEX32(0xFFF, fake.dac1.dhr12r1);
    rdpi_port_write_dac(0x1001);
    TEST_ASSERT_EQUAL_HEX32(0x001, fake.dac1.dhr12r1);
    rdpi_port_write_dac(0xFFFFFFFF);
    TEST_ASSERT_EQUAL_HEX32(0xFFF, fake.dac1.dhr12r1);
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

void test_start_without_a_tick_is_refused(void)
{
    SystemInit();
    TEST_ASSERT_FALSE(rdpi_port_start(10000, NULL));
}

void test_start_enables_the_interrupt_at_the_highest_priority_before_the_timer_runs(void)
{
    SystemInit();
    TEST_ASSERT_EQUAL_HEX32(0, fake.nvic.iser[1]);
    TEST_ASSERT_TRUE(rdpi_port_start(10000, tick));
    TEST_ASSERT_EQUAL_HEX32(1u << 22, fake.nvic.iser[1]);
    TEST_ASSERT_EQUAL_HEX32(0x11003344, fake.nvic.ipr[13]);
    TEST_ASSERT_EQUAL_HEX32(1, fake.tim6.dier);
    TEST_ASSERT_EQUAL_HEX32(0, fake.tim6.sr); /* no tick before the first period is over */
    unsigned update = written(&fake.tim6.egr, 1, 1, 0);
    unsigned enable = written(&fake.nvic.iser[1], 1u << 22, 1u << 22, update);
    unsigned cycles = written(&fake.tim2.cr1, 1, 1, enable);
    written(&fake.tim6.cr1, 1, 1, cycles);
    TEST_ASSERT_EQUAL_HEX32(0xFFFFFFFF, fake.tim2.arr);
}

void test_a_tick_per_update_and_none_lost(void)
{
    started(10000);
    tick_cycles = 16000;
    for (unsigned k = 1; k <= 10; k++) {
        elapse(k * 17000 + 20 - fake.tim2.cnt);
        TIM6_DAC_IRQHandler();
        TEST_ASSERT_EQUAL_UINT(k, ticks);
        TEST_ASSERT_EQUAL_HEX32(0, fake.tim6.sr);
    }
    TEST_ASSERT_EQUAL_UINT32(0, rdpi_port_overruns());
}

void test_an_interrupt_without_an_update_calls_nothing(void)
{
    started(10000);
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT(0, ticks);
}

void test_a_tick_that_takes_too_long_loses_the_next(void)
{
    started(10000);
    elapse(17020);
    tick_cycles = 17000;
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT32(1, rdpi_port_overruns());
    TEST_ASSERT_EQUAL_HEX32(0, fake.tim6.sr); /* dropped */
    TIM6_DAC_IRQHandler();                    /* pending all the same */
    TEST_ASSERT_EQUAL_UINT(1, ticks);
    TEST_ASSERT_EQUAL_UINT32(1, rdpi_port_overruns());
    tick_cycles = 100;
    elapse(17000);
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT(2, ticks);
    TEST_ASSERT_EQUAL_UINT32(1, rdpi_port_overruns());
}

void test_a_tick_that_takes_periods_loses_as_many(void)
{
    started(44100);
    elapse(3855 + 20);
    tick_cycles = 3855 * 5;
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT32(5, rdpi_port_overruns());
    TEST_ASSERT_EQUAL_UINT(1, ticks);
}

void test_lost_ticks_are_counted_at_rates_that_use_the_prescaler(void)
{
    started(1000);
    elapse(170000 + 20);
    tick_cycles = 170000 * 2;
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT32(2, rdpi_port_overruns());
    TEST_ASSERT_EQUAL_UINT(1, ticks);
}

void test_a_tick_entered_late_by_periods_counts_those_it_stands_for(void)
{
    started(20000);
    elapse(8500 * 3 + 20); /* three due, one tick */
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT(1, ticks);
    TEST_ASSERT_EQUAL_UINT32(2, rdpi_port_overruns());
    elapse(8500);
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT(2, ticks);
    TEST_ASSERT_EQUAL_UINT32(2, rdpi_port_overruns());
}

void test_a_tick_entered_late_by_less_than_a_period_loses_none(void)
{
    started(10000);
    elapse(17000 + 16000);
    TIM6_DAC_IRQHandler();
    elapse(1020);
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT(2, ticks);
    TEST_ASSERT_EQUAL_UINT32(0, rdpi_port_overruns());
}

void test_an_update_that_was_counted_already_calls_no_tick(void)
{
    started(10000);
    elapse(17020);
    tick_cycles = 17000;
    TIM6_DAC_IRQHandler();
    fake.tim6.sr = 1; /* it overflowed between the flag's reset and the reading of the count */
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT(1, ticks);
    TEST_ASSERT_EQUAL_UINT32(1, rdpi_port_overruns());
}

void test_lost_ticks_are_counted_across_the_wrap_of_the_cycle_counter(void)
{
    started(10000);
    due = fake.tim2.cnt = 0u - 100u;
    fake.tim2.cnt += 17020;
    fake.tim6.sr = 1;
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT(1, ticks);
    TEST_ASSERT_EQUAL_UINT32(0, rdpi_port_overruns());
}

void test_the_count_of_lost_ticks_saturates(void)
{
    started(10000);
    overruns = UINT32_MAX - 1;
    elapse(17000 * 4);
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, rdpi_port_overruns());
    elapse(17000 * 4);
    TIM6_DAC_IRQHandler();
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, rdpi_port_overruns());
}

void test_there_is_no_reference_unless_the_board_has_one(void)
{
    TEST_ASSERT_TRUE(isnan(rdpi_port_reference_um()));
}

void test_idle_sleeps_and_goes_on(void)
{
    TEST_ASSERT_TRUE(rdpi_port_idle());
    TEST_ASSERT_EQUAL_UINT(1, sleeps);
}
