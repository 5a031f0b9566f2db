/* RP2040, Pico SDK: a timer's callback, and an AD5683R (16 bits) on the SPI. Your main sets up the
 * SPI (mode 1: spi_set_format with SPI_CPOL_0 and SPI_CPHA_1) and the pins, then calls run_axis. */
#include "hardware/gpio.h"
#include "hardware/spi.h"
#include "pico/time.h"

#include "axis.h"
#include "rdpi_params.h" /* for its DAC bits */

#if RDPI_PARAMS_DAC_BITS != 16
#error "fit with --dac-bits 16"
#endif

#define RATE_HZ 1000
#define SYNC_PIN 17u
#define MOST_FAILED 10u /* frames in a row: the first that gets through is a step of as many samples. Yours to choose */

extern axis_t axis; /* yours */

bool run_axis(void);
uint32_t frames_failed(void); /* since the start; 0 on a healthy bus */

/* Yours: MOST_FAILED frames in a row have failed, and no more are sent. The DAC still outputs its last code: switch the
 * amplifier off. In the timer's callback. */
void axis_stopped(void);

static repeating_timer_t timer;
static uint32_t code, lost, in_a_row;
static volatile uint32_t failed;

/* Its 24 bits: command 3, "write to and update the DAC register"; the code; four bits that do not matter. False if the
 * DAC has not got all of them: it then outputs the code before. */
static bool write_dac(void)
{
    const uint8_t frame[3] = {(uint8_t)(0x30u | code >> 12), (uint8_t)(code >> 4), (uint8_t)(code << 4)};
    gpio_put(SYNC_PIN, false);
    bool sent = spi_write_blocking(spi0, frame, sizeof frame) == (int)sizeof frame;
    gpio_put(SYNC_PIN, true);
    return sent;
}

/* The code is written before the next is computed: so the output changes equally long after each tick. A code that has
 * not got through is sent again, and axis_next waits for it: the library counts on every code that it has returned. A
 * callback that is late is made up for by the SDK: no sample is lost but by a frame that fails. */
static bool on_timer(repeating_timer_t *self)
{
    (void)self;
    if (write_dac()) {
        code = axis_next(&axis, lost);
        lost = in_a_row = 0;
        return true;
    }
    failed++;
    in_a_row++;
    lost++;
    if (in_a_row < MOST_FAILED) {
        return true;
    }
    axis_stopped();
    return false; /* the SDK's timer ends */
}

uint32_t frames_failed(void)
{
    return failed;
}

bool run_axis(void)
{
    rdpi_status_t status = axis_start(&axis, RATE_HZ);
    code = axis.life.dac_code; /* the safe one */
    if (status != RDPI_OK) {
        (void)write_dac();
        return false;
    }
    return add_repeating_timer_us(-1000000 / RATE_HZ, on_timer, NULL, &timer); /* < 0: from start to start */
}
