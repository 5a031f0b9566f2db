/* The port contract on Arm's MPS2 board, of which QEMU emulates the FPGA images AN385 (Cortex-M3), AN386 (M4) and AN500
 * (M7): TIMER0 calls the tick, TIMER1 counts cycles, UART0 sends telemetry. The board has neither DAC nor ADC: codes
 * are kept, and no sensor is read, unless RDPI_BENCH puts a program at UART1 in the place of both.
 *
 * The bench link. After each tick the timers stand still, so that no time passes for the firmware, until all telemetry
 * is out and the bench has answered:
 *
 *   to the bench   u32 tick, from 1, lost ones included; u32 DAC code of each axis
 *   from it        u32 the same tick; i32 reading of each axis in counts, which the next tick's rdpi_port_read_adc
 *                  returns
 *
 * little endian. After an answer with another tick the timers never start again, and the code is held.
 *
 * Registers: Arm Cortex-M System Design Kit TRM (DDI 0479), APB timer and APB UART; addresses, interrupts, clock: Arm
 * AN385 (DAI 0385), of which AN386 and AN500 repeat what is used here. The documents were not at hand: confirmed in
 * Arm's CMSIS device headers for the CMSDK as others quote them and in QEMU's hw/arm/mps2.c,
 * hw/timer/cmsdk-apb-timer.c and hw/char/cmsdk-apb-uart.c. */
#include <string.h>

#include "cortex_m.h"
#include "rdpi_port.h"
#include "ring.h"

#define CORE_HZ 25000000u /* core and timers */
#define LAST_RATE_HZ 100000u
#define LAST_CODE 0xFFFFFu /* of the 20 bits that rdpi knows at most */

typedef struct {
    volatile uint32_t ctrl, value, reload, intstatus; /* intstatus: 1 clears */
} cmsdk_timer_t;

#define TIMER0 ((cmsdk_timer_t *)0x40000000u)
#define TIMER1 ((cmsdk_timer_t *)0x40001000u)
#define TIMER_CTRL_EN (1u << 0)
#define TIMER_CTRL_IRQEN (1u << 3)

typedef struct {
    volatile uint32_t data, state, ctrl, intstatus, bauddiv; /* intstatus: 1 clears */
} cmsdk_uart_t;

#define UART0 ((cmsdk_uart_t *)0x40004000u)
#define UART1 ((cmsdk_uart_t *)0x40005000u)
#define UART_STATE_TXFULL (1u << 0)
#define UART_STATE_RXFULL (1u << 1)
#define UART_CTRL_TXEN (1u << 0)
#define UART_CTRL_RXEN (1u << 1)
#define UART_CTRL_TXIRQEN (1u << 2)
#define UART_CTRL_RXIRQEN (1u << 3)
#define UART_INT_TX (1u << 0)
#define UART_INT_RX (1u << 1)
#define UART_BAUDDIV 16u /* the least: 1.5625 MBd */

#define UART0_TX_IRQ 1u
#define UART1_RX_IRQ 2u
#define TIMER0_IRQ 8u

#if RDPI_SAFE_CODE > LAST_CODE
#error "RDPI_SAFE_CODE: 1048575 at most"
#endif

void SystemInit(void);

static rdpi_port_tick_t on_tick;
static uint32_t period;            /* cycles between ticks */
static uint32_t due;               /* cycle of the last tick accounted for */
static volatile uint32_t called;   /* ticks; this and the next are written by the interrupt, read anywhere */
static volatile uint32_t overruns;
#define SAFE_CODE(axis) RDPI_SAFE_CODE,
static volatile uint32_t dac_code[] = {RDPI_EACH_AXIS(SAFE_CODE)}; /* for the bench, or a debugger */
static ring_t telemetry;

/* Before main, and before variables have values: uses none. */
void SystemInit(void)
{
    TIMER1->reload = UINT32_MAX;
    TIMER1->value = UINT32_MAX;
    TIMER1->ctrl = TIMER_CTRL_EN;
    UART0->bauddiv = UART_BAUDDIV;
    UART0->ctrl = UART_CTRL_TXEN | UART_CTRL_TXIRQEN;
    cortex_m_enable(UART0_TX_IRQ, CORTEX_M_LOWEST);
#if RDPI_BENCH
    UART1->bauddiv = UART_BAUDDIV;
    UART1->ctrl = UART_CTRL_TXEN | UART_CTRL_RXEN | UART_CTRL_RXIRQEN;
    cortex_m_enable(UART1_RX_IRQ, CORTEX_M_LOWEST);
#endif
}

uint32_t rdpi_port_cycles(void)
{
    return UINT32_MAX - TIMER1->value; /* it counts down */
}

static void lose(uint32_t ticks)
{
    uint32_t room = UINT32_MAX - overruns;
    overruns += ticks < room ? ticks : room;
}

/* Ticks that have become due since this was last asked. */
static uint32_t ticks_due(void)
{
    uint32_t ticks = (rdpi_port_cycles() - due) / period;
    due += ticks * period;
    return ticks;
}

#if RDPI_BENCH

#define NO_READING(axis) RDPI_PORT_NO_READING,
static struct {
    uint32_t tick; /* of the latest question, and expected back */
    uint32_t answer[1 + RDPI_AXES];
    unsigned received; /* bytes of it */
    int32_t counts[RDPI_AXES]; /* of the latest one */
} bench = {.counts = {RDPI_EACH_AXIS(NO_READING)}};

static void bench_send(uint32_t word)
{
    for (unsigned k = 0; k < 4u; k++) {
        while ((UART1->state & UART_STATE_TXFULL) != 0u) {
        }
        UART1->data = word >> (8u * k) & 0xFFu;
    }
}

/* At the end of the timer's interrupt: no other follows until the timer goes on. */
static void bench_ask(void)
{
    memset(bench.answer, 0, sizeof bench.answer);
    bench.received = 0;
    bench_send(bench.tick);
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        bench_send(dac_code[k]);
    }
}

/* The timers go on once answer and telemetry are through. From the UARTs' interrupts, of one priority. */
static void bench_go_on(void)
{
    if (bench.received == sizeof bench.answer && bench.answer[0] == bench.tick && ring_empty(&telemetry)) {
        bench.received = 0;
        memcpy(bench.counts, &bench.answer[1], sizeof bench.counts);
        due = rdpi_port_cycles() - (TIMER0->reload - TIMER0->value); /* they did not stop at the same time */
        cortex_m_sync();
        TIMER1->ctrl = TIMER_CTRL_EN;
        TIMER0->ctrl = TIMER_CTRL_EN | TIMER_CTRL_IRQEN;
    }
}

static void uart1_rx_interrupt(void)
{
    UART1->intstatus = UART_INT_RX;
    while ((UART1->state & UART_STATE_RXFULL) != 0u) {
        uint32_t byte = UART1->data & 0xFFu;
        if (bench.received < sizeof bench.answer) {
            bench.answer[bench.received / 4u] |= byte << (8u * (bench.received % 4u));
            bench.received++;
        }
    }
    bench_go_on();
}

#endif

static void uart0_tx_interrupt(void)
{
    uint8_t byte;
    UART0->intstatus = UART_INT_TX; /* before looking: what is sent later interrupts again */
    while ((UART0->state & UART_STATE_TXFULL) == 0u && ring_take(&telemetry, &byte)) {
        UART0->data = byte;
    }
#if RDPI_BENCH
    bench_go_on();
#endif
}

static void timer0_interrupt(void)
{
    TIMER0->intstatus = 1; /* before the count is read: nothing in between is forgotten */
    uint32_t ticks = ticks_due();
    if (ticks == 0u) {
        return; /* accounted for at the end of the tick before */
    }
    lose(ticks - 1u); /* entered late, more than a period */
    called++;
#if RDPI_BENCH
    bench.tick = called + overruns;
#endif
    on_tick();
#if RDPI_BENCH
    TIMER0->ctrl = TIMER_CTRL_IRQEN;
    TIMER1->ctrl = 0;
#endif
    if (TIMER0->intstatus != 0u) {
        TIMER0->intstatus = 1;
        lose(ticks_due());
    }
#if RDPI_BENCH
    bench_ask();
#endif
}

CORTEX_M_VECTORS[] = {
    [UART0_TX_IRQ] = uart0_tx_interrupt,
#if RDPI_BENCH
    [UART1_RX_IRQ] = uart1_rx_interrupt,
#endif
    [TIMER0_IRQ] = timer0_interrupt,
};

bool rdpi_port_start(uint32_t rate_hz, rdpi_port_tick_t tick)
{
    if (tick == NULL || rate_hz == 0u || rate_hz > LAST_RATE_HZ) {
        return false;
    }
    period = (CORE_HZ + rate_hz / 2u) / rate_hz;
    uint32_t made_hz = rate_hz * period; /* the clock at which the rate would be exact */
    if ((made_hz > CORE_HZ ? made_hz - CORE_HZ : CORE_HZ - made_hz) > CORE_HZ / 1000u) {
        return false;
    }
    on_tick = tick;
    TIMER0->reload = period - 1u;
    TIMER0->value = period - 1u;
    due = rdpi_port_cycles(); /* a few cycles ahead of TIMER0: a tick is never due too late */
    cortex_m_enable(TIMER0_IRQ, CORTEX_M_HIGHEST);
    TIMER0->ctrl = TIMER_CTRL_EN | TIMER_CTRL_IRQEN;
    return true;
}

bool rdpi_port_write_dac(const uint32_t *codes)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        if (codes[k] > LAST_CODE) {
            return false;
        }
    }
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        dac_code[k] = codes[k];
    }
    return true;
}

void rdpi_port_safe(void)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        dac_code[k] = RDPI_SAFE_CODE;
    }
}

bool rdpi_port_watchdog_reset(void)
{
    return false;
}

void rdpi_port_read_adc(int32_t *counts)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
#if RDPI_BENCH
        counts[k] = bench.counts[k];
#else
        counts[k] = RDPI_PORT_NO_READING;
#endif
    }
}

uint32_t rdpi_port_overruns(void)
{
    return overruns;
}

bool rdpi_port_send(const uint8_t *bytes, size_t count)
{
    bool taken = ring_put(&telemetry, bytes, count);
    cortex_m_pend(UART0_TX_IRQ);
    return taken;
}

/* Until a tick; awake, because QEMU's time under -icount is then that of the instructions alone. While the core sleeps
 * it is the host's, and with sleep=off it jumps, in QEMU 7.2 past the next tick. */
void rdpi_port_idle(void)
{
    uint32_t seen = called;
    while (called == seen) {
    }
}
