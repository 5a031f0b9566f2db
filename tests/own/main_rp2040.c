/* Plays the Pico SDK for examples/own/rp2040.c: its timer, and an AD5683R that takes frames between edges of SYNC. */
#include "hardware/gpio.h"
#include "hardware/spi.h"
#include "pico/time.h"
#include "triangle.h"

spi_inst_t *const spi0 = NULL;
static uint32_t frame;
static unsigned bits;
static bool fails, axis_is_stopped;

bool run_axis(void);
uint32_t frames_failed(void);
void axis_stopped(void);

void axis_stopped(void)
{
    axis_is_stopped = true;
}

int spi_write_blocking(spi_inst_t *spi, const uint8_t *source, size_t length)
{
    (void)spi;
    fails = frame_fails();
    length -= fails ? 1u : 0u;
    for (size_t i = 0; i < length; i++, bits += 8u) {
        frame = frame << 8 | source[i];
    }
    return (int)length;
}

void gpio_put(uint gpio, bool value)
{
    (void)gpio;
    if (value && fails) { /* the DAC discards a frame that is too short */
        dac_gets(dac_got[dac_count - 1u], 0u);
    } else if (value) {
        if (bits != 24u || frame >> 20 != 3u) {
            exit(4);
        }
        dac_gets(frame >> 4 & 0xFFFFu, 0u);
    }
    frame = bits = 0u;
}

bool add_repeating_timer_us(int64_t delay_us, repeating_timer_callback_t callback, void *user_data,
                            repeating_timer_t *out)
{
    (void)user_data;
    if (delay_us != -1000) {
        return false;
    }
    while (callback(out)) {
    }
    if (!axis_is_stopped || frames_failed() != 10u) {
        exit(5);
    }
    finish();
    return true;
}

int main(void)
{
    return run_axis() ? 2 : 1; /* add_repeating_timer_us ends the program */
}
