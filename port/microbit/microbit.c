/* The port contract on a BBC micro:bit of the first generation (nRF51822): TIMER0 counts the 16 MHz that core and timer
 * share, and calls the tick where it compares; UART0 sends telemetry, 1 MBd at the USB interface's pin.
 *
 * The board has no DAC, and this port reads no sensor: a code is kept. Functions of the same names in the application
 * take the place of rdpi_port_write_dac and rdpi_port_safe, for instance for one of port/drivers on the SPI, or of
 * rdpi_port_read_adc.
 *
 * Registers: nRF51 Series Reference Manual 3.0, CLOCK, GPIO, TIMER and UART; an interrupt has the number of its
 * peripheral. The manual was not at hand: confirmed in Nordic's nrf51.h and nrf51_bitfields.h as others quote them and
 * in QEMU's hw/timer/nrf51_timer.c and hw/char/nrf51_uart.c. Pin: board files of RIOT and MicroPython. */
#include "cortex_m.h"
#include "rdpi_port.h"
#include "ring.h"

#define CORE_HZ 16000000u
#define LAST_RATE_HZ 100000u
#define LAST_CODE 0xFFFFFu /* of the 20 bits that rdpi knows at most */
#define PATIENCE 100000u   /* reads, some 50 ms; the crystal takes about 1 ms */

#define REGISTER(address) (*(volatile uint32_t *)(address))

#define CLOCK_TASKS_HFCLKSTART REGISTER(0x40000000u)
#define CLOCK_EVENTS_HFCLKSTARTED REGISTER(0x40000100u)

#define UART0_TASKS_STARTTX REGISTER(0x40002008u)
#define UART0_EVENTS_TXDRDY REGISTER(0x4000211Cu)
#define UART0_INTENSET REGISTER(0x40002304u)
#define UART0_ENABLE REGISTER(0x40002500u)
#define UART0_PSELTXD REGISTER(0x4000250Cu)
#define UART0_TXD REGISTER(0x4000251Cu)
#define UART0_BAUDRATE REGISTER(0x40002524u)
#define UART_INT_TXDRDY (1u << 7)
#define UART_ENABLED 4u
#define UART_1_MBD 0x10000000u

#define TIMER0_TASKS_START REGISTER(0x40008000u)
#define TIMER0_TASKS_CAPTURE1 REGISTER(0x40008044u)
#define TIMER0_EVENTS_COMPARE0 REGISTER(0x40008140u)
#define TIMER0_INTENSET REGISTER(0x40008304u)
#define TIMER0_BITMODE REGISTER(0x40008508u)
#define TIMER0_PRESCALER REGISTER(0x40008510u)
#define TIMER0_CC0 REGISTER(0x40008540u)
#define TIMER0_CC1 REGISTER(0x40008544u)
#define TIMER_INT_COMPARE0 (1u << 16)
#define TIMER_32_BITS 3u

#define GPIO_OUTSET REGISTER(0x50000508u)
#define GPIO_DIRSET REGISTER(0x50000518u)
#define TXD_PIN 24u

#define UART0_IRQ 2u
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
static volatile uint32_t dac_code = RDPI_SAFE_CODE; /* for a debugger */
static ring_t telemetry;
static bool sending; /* a byte is in the UART */

/* Before main, and before variables have values: uses none. */
void SystemInit(void)
{
    CLOCK_EVENTS_HFCLKSTARTED = 0;
    CLOCK_TASKS_HFCLKSTART = 1; /* the crystal; rdpi_port_start looks at what came of it */
    for (uint32_t k = 0; k < PATIENCE && CLOCK_EVENTS_HFCLKSTARTED == 0u; k++) {
    }
    TIMER0_BITMODE = TIMER_32_BITS;
    TIMER0_PRESCALER = 0;
    TIMER0_TASKS_START = 1;
    GPIO_OUTSET = 1u << TXD_PIN; /* the line's rest */
    GPIO_DIRSET = 1u << TXD_PIN;
    UART0_PSELTXD = TXD_PIN;
    UART0_BAUDRATE = UART_1_MBD;
    UART0_ENABLE = UART_ENABLED;
    UART0_INTENSET = UART_INT_TXDRDY;
    UART0_TASKS_STARTTX = 1;
    cortex_m_enable(UART0_IRQ, CORTEX_M_LOWEST);
}

/* An interrupt in between makes it the later time. */
uint32_t rdpi_port_cycles(void)
{
    TIMER0_TASKS_CAPTURE1 = 1;
    return TIMER0_CC1;
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

/* The next tick's time; if that passed before it was set, the interrupt comes at once. */
static void arm(void)
{
    TIMER0_CC0 = due + period;
    TIMER0_EVENTS_COMPARE0 = 0; /* after CC0: QEMU's timer compares anew when this is cleared */
    if (rdpi_port_cycles() - due >= period) {
        cortex_m_pend(TIMER0_IRQ);
    }
}

static void timer0_interrupt(void)
{
    uint32_t ticks = ticks_due();
    if (ticks > 0u) {
        lose(ticks - 1u); /* entered late, more than a period */
        called++;
        on_tick();
        lose(ticks_due()); /* it returned late */
    }
    arm();
    cortex_m_pend(UART0_IRQ); /* QEMU's UART does not interrupt when a full line has become free */
}

static void uart0_interrupt(void)
{
    for (;;) {
        uint8_t byte;
        if (sending) {
            if (UART0_EVENTS_TXDRDY == 0u) {
                return;
            }
            UART0_EVENTS_TXDRDY = 0;
            sending = false;
        }
        if (!ring_take(&telemetry, &byte)) {
            return;
        }
        sending = true;
        UART0_TXD = byte;
    }
}

CORTEX_M_VECTORS[] = {
    [UART0_IRQ] = uart0_interrupt,
    [TIMER0_IRQ] = timer0_interrupt,
};

bool rdpi_port_start(uint32_t rate_hz, rdpi_port_tick_t tick)
{
    if (tick == NULL || rate_hz == 0u || rate_hz > LAST_RATE_HZ || CLOCK_EVENTS_HFCLKSTARTED == 0u) {
        return false;
    }
    period = (CORE_HZ + rate_hz / 2u) / rate_hz;
    uint32_t made_hz = rate_hz * period; /* the clock at which the rate would be exact */
    if ((made_hz > CORE_HZ ? made_hz - CORE_HZ : CORE_HZ - made_hz) > CORE_HZ / 1000u) {
        return false;
    }
    on_tick = tick;
    due = rdpi_port_cycles();
    arm();
    TIMER0_INTENSET = TIMER_INT_COMPARE0;
    cortex_m_enable(TIMER0_IRQ, CORTEX_M_HIGHEST);
    return true;
}

__attribute__((weak)) bool rdpi_port_write_dac(const uint32_t *codes)
{
    if (codes[0] > LAST_CODE) {
        return false;
    }
    dac_code = codes[0];
    return true;
}

__attribute__((weak)) void rdpi_port_safe(void)
{
    dac_code = RDPI_SAFE_CODE;
}

bool rdpi_port_watchdog_reset(void)
{
    return false;
}

__attribute__((weak)) void rdpi_port_read_adc(int32_t *counts)
{
    counts[0] = RDPI_PORT_NO_READING;
}

uint32_t rdpi_port_overruns(void)
{
    return overruns;
}

bool rdpi_port_send(const uint8_t *bytes, size_t count)
{
    bool taken = ring_put(&telemetry, bytes, count);
    cortex_m_pend(UART0_IRQ);
    return taken;
}

/* Until a tick; awake, because under -icount QEMU's time is then that of the instructions alone. */
void rdpi_port_idle(void)
{
    uint32_t seen = called;
    while (called == seen) {
    }
}
