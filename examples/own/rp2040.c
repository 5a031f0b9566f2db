/* RP2040, Pico SDK: a timer's callback, and an AD5683R (16 bits) on the SPI. Your main sets up the
 * SPI (mode 1: spi_set_format with SPI_CPOL_0 and SPI_CPHA_1) and the pins, then calls run_axis. */
#include "hardware/gpio.h"
#include "hardware/spi.h"
#include "pico/time.h"

#include "axis.h"

#if RDPI_PARAMS_DAC_BITS != 16
#error "fit with --dac-bits 16"
#endif

#define RATE_HZ 1000
#define SYNC_PIN 17u

bool run_axis(void);

static repeating_timer_t timer;
static uint32_t code;

/* Its 24 bits: command 3, "write to and update the DAC register"; the code; four bits that do not matter. */
static void write_dac(void)
{
    const uint8_t frame[3] = {(uint8_t)(0x30u | code >> 12), (uint8_t)(code >> 4), (uint8_t)(code << 4)};
    gpio_put(SYNC_PIN, false);
    (void)spi_write_blocking(spi0, frame, sizeof frame);
    gpio_put(SYNC_PIN, true);
}

/* The code is written before the next is computed: so the output changes equally long after each tick. */
static bool on_timer(repeating_timer_t *self)
{
    (void)self;
    write_dac();
    code = axis_next(0); /* a callback that is late is made up for by the SDK: none is lost */
    return true;
}

bool run_axis(void)
{
    if (axis_start(RATE_HZ) != RDPI_OK) {
        return false;
    }
    code = axis_first_code();
    return add_repeating_timer_us(-1000000 / RATE_HZ, on_timer, NULL, &timer); /* < 0: from start to start */
}
