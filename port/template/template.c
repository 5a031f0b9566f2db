/* The folder to copy for a new board, and what each function of rdpi_port.h has to do. It is written for a Cortex-M,
 * whose start-up, vectors and linker script are port/cortex_m; on another core bring your own and keep the rest.
 *
 * It compiles, and refuses to start: no timer. BOARD marks the places that wait for your registers; take those of
 * port/stm32f405 as an example. Say in a comment where you have each address and bit from. */
#include "cortex_m.h"
#include "rdpi_port.h"
#include "ring.h"

/* BOARD: the numbers of the timer's and the UART's interrupt, and of one of a peripheral that you do not use. */
#define TIMER_IRQ 0u
#define UART_IRQ 1u
#define TICK_IRQ 2u

#define LAST_CODE 0xFFFFu /* BOARD: of the DAC */

#if RDPI_SAFE_CODE > LAST_CODE
#error "RDPI_SAFE_CODE: a code of the DAC"
#endif

static rdpi_port_tick_t on_tick;
static volatile uint32_t updates;  /* of the timer since the start; wraps */
static uint32_t served;            /* of them, those that had their tick or were lost */
static volatile uint32_t overruns; /* written by the tick's interrupt, read anywhere */
static ring_t telemetry;

void SystemInit(void);

/* Before main, and before variables have values: uses none. The application begins with the board running. */
void SystemInit(void)
{
    rdpi_port_safe();
    /* BOARD: clocks, waiting for each bit with a limit, so that a dead crystal ends in rdpi_port_start returning false
     * and not here; pins; converter, converting without end;
     * UART's baud rate and transmitter. */
    cortex_m_enable(UART_IRQ, CORTEX_M_LOWEST);
}

static void lose(uint32_t ticks)
{
    uint32_t room = UINT32_MAX - overruns;
    overruns += ticks < room ? ticks : room;
}

/* The highest priority of all, and so short that it misses none. */
static void timer_interrupt(void)
{
    /* BOARD: acknowledge it. */
    updates++;
    cortex_m_pend(TICK_IRQ);
}

/* Below the timer, above all that may wait. */
static void tick_interrupt(void)
{
    uint32_t now = updates;
    if (now == served) {
        return; /* pending from a tick that was dropped */
    }
    lose(now - served - 1u);
    served = now;
    on_tick();
    now = updates;
    lose(now - served); /* dropped, not made up for: a late code is a wrong one */
    served = now;
}

bool rdpi_port_start(uint32_t rate_hz, rdpi_port_tick_t tick)
{
    if (tick == NULL || rate_hz == 0u) {
        return false;
    }
    /* BOARD: compute the timer's divider; return false for a rate that it misses by more than 0.1 %, and if the clock
     * or the DAC did not start. Set the timer up, but not going. */
    on_tick = tick;
    updates = 0;
    served = 0;
    overruns = 0;
    cortex_m_enable(TICK_IRQ, 0x40u);
    cortex_m_enable(TIMER_IRQ, CORTEX_M_HIGHEST);
    /* BOARD: start the watchdog if RDPI_WATCHDOG_MS is not 0; the tick's interrupt feeds it. See port/stm32/watchdog.h.
     * Let the timer go, and return true. */
    return false;
}

bool rdpi_port_write_dac(const uint32_t *codes)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        if (codes[k] > LAST_CODE) {
            return false;
        }
    }
    /* BOARD: start the transfer and return, true if it was started. For a DAC on the SPI or I2C take port/drivers, which
     * needs the two functions of rdpi_spi.h or rdpi_i2c.h. */
    return false;
}

/* First of all after reset, and after a fault: interrupts do not run, and no variable may be relied on. */
void rdpi_port_safe(void)
{
    /* BOARD: clock and pins of the DAC, and of its bus, from anew; RDPI_SAFE_CODE to the DAC, waiting for it with a
     * limit. Chip select goes high first, so that a frame half sent is discarded; port/stm32f405 is an example. */
}

bool rdpi_port_watchdog_reset(void)
{
    /* BOARD: whether the chip's flags say so; clear them here. See port/stm32/watchdog.h. */
    return false;
}

void rdpi_port_read_adc(int32_t *counts)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        /* BOARD: the latest conversion's counts. A converter that has to be asked is asked here for the next time. */
        counts[k] = RDPI_PORT_NO_READING;
    }
}

uint32_t rdpi_port_overruns(void)
{
    return overruns;
}

uint32_t rdpi_port_cycles(void)
{
    /* BOARD: a counter of core cycles, the DWT's CYCCNT for instance (Armv7-M), or of a timer. */
    return 0;
}

static void uart_interrupt(void)
{
    uint8_t byte;
    while (/* BOARD: the transmitter takes one, && */ ring_take(&telemetry, &byte)) {
        /* BOARD: give it the byte. */
    }
    /* BOARD: interrupt when the transmitter takes one, unless ring_empty(&telemetry). Only this function says so. */
}

bool rdpi_port_send(const uint8_t *bytes, size_t count)
{
    bool taken = ring_put(&telemetry, bytes, count);
    cortex_m_pend(UART_IRQ);
    return taken;
}

void rdpi_port_idle(void)
{
    cortex_m_sleep();
}

CORTEX_M_VECTORS[] = {
    [TIMER_IRQ] = timer_interrupt,
    [UART_IRQ] = uart_interrupt,
    [TICK_IRQ] = tick_interrupt,
};
