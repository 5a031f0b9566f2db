/* Moves an actuator: start-up sweep over the whole range, a ramp, then a triangle for ever. In fixed point, with an MCP4725
 * (12 bits) on the I2C. For an Arduino Mega and other AVR boards with 128 kB of flash and 4 kB of RAM: 59 kB and 2 kB are
 * used. An Uno is too small.
 *
 * 1. Replace rdpi_params.h by that of your actuator: `rdpi fit --dac-bits 12`, then `rdpi header`. With a
 *    header that has more bits the lower ones are left out.
 * 2. Set SAFE_V, the triangle, and the address of your MCP4725.
 * 3. Look at the output without an actuator first.
 *
 * The timer's interrupt only counts: Wire must never be used in an interrupt. It needs interrupts of its own and would
 * wait there for ever. loop() computes and sends, one sample for each tick. */
#include <Wire.h>
#include <rdpi.h>
#include <rdpi_i2c.h>
#include <drivers/mcp4725.h>
#include "rdpi_params.h"

#if !RDPI_PARAMS_Q31
#error "this actuator has no parameters in fixed point; rdpi_params.h says why"
#endif
#if RDPI_PARAMS_DAC_BITS < 12
#error "fit with --dac-bits 12"
#endif
#define SURPLUS_BITS (RDPI_PARAMS_DAC_BITS - 12)

/* Samples per second. A code takes up to 2 ms to compute on an AVR. Below some hundred, the sweep would jump from code to code:
 * then the start is refused, unless the header is made with a slower sweep, `rdpi header --sweep-rate`. */
static const uint16_t RATE_HZ = 400;
static const double SAFE_V = 0.0;     /* drive until the actuator is accepted, and where the sweep begins */
static const uint8_t ADDRESS = 0x62;  /* 0x60 to 0x67 */
static const uint16_t PERIOD = 320;   /* samples of the triangle: up and down */
static const uint8_t MOST_FAILED = 20; /* frames in a row: then the axis stops */

static rdpi_q31_axis_t axis;
static rdpi_mcp4725_t dac;
static rdpi_i2c_state_t bus = RDPI_I2C_DONE;
static volatile uint8_t ticks; /* since loop looked */
static uint16_t sample;        /* of the triangle: it counts within a period and so never wraps */
static bool follows;           /* the triangle goes on with time */
static uint8_t in_a_row;       /* frames that have failed */
uint32_t lost;                 /* samples so far that had no code of their own; a debugger may look */

/* ---- the two functions that the driver needs ---- */

void rdpi_i2c_write(uint8_t address, const uint8_t *bytes, size_t count)
{
    Wire.beginTransmission(address);
    Wire.write(bytes, count);
    bus = Wire.endTransmission() == 0 ? RDPI_I2C_DONE : RDPI_I2C_FAILED;
}

rdpi_i2c_state_t rdpi_i2c_state(void)
{
    return bus; /* endTransmission has waited for the end */
}

/* ---- the timer ---- */

ISR(TIMER1_COMPA_vect)
{
    if (ticks < UINT8_MAX) {
        ticks++;
    }
}

static void start_timer()
{
    TCCR1A = 0;
    TCCR1B = _BV(WGM12) | _BV(CS11); /* from 0 to OCR1A, the clock by 8 */
    OCR1A = (uint16_t)(F_CPU / 8 / RATE_HZ - 1);
    TIMSK1 = _BV(OCIE1A);
}

static uint8_t take_ticks()
{
    noInterrupts();
    uint8_t taken = ticks;
    ticks = 0;
    interrupts();
    return taken;
}

/* ---- the axis ---- */

/* Yours. A position has the offset of the sensor taken off, a difference of two positions has not. */
static int32_t reference(uint16_t at)
{
    const int32_t bottom = RDPI_PARAMS_Q31_REFERENCE(0.0);
    const int32_t step = RDPI_PARAMS_Q31_DIFFERENCE(0.05); /* um a sample */
    return bottom + step * (int32_t)(at < PERIOD / 2 ? at : PERIOD - at);
}

static uint16_t later(uint32_t samples)
{
    return (uint16_t)((sample + samples) % PERIOD);
}

static uint32_t safe_code()
{
    const double share = (SAFE_V - RDPI_PARAMS_MIN_V) / (RDPI_PARAMS_MAX_V - RDPI_PARAMS_MIN_V);
    return (uint32_t)(share * ((1ul << RDPI_PARAMS_DAC_BITS) - 1) + 0.5);
}

void setup()
{
    const rdpi_mcp4725_config_t config = {ADDRESS};
    Serial.begin(115200);
    Wire.begin();
    Wire.setClock(400000);
    axis.dac_code = safe_code(); /* what steps return until init has accepted */
    rdpi_mcp4725_init(&dac, &config);
    bool there = false;
    for (uint8_t attempt = 0; !there && attempt < 10; attempt++) {
        there = rdpi_mcp4725_start(&dac, axis.dac_code >> SURPLUS_BITS);
    }
    rdpi_status_t status = rdpi_q31_axis_init(&axis, &rdpi_chain_q31, 1000000000ul / RATE_HZ, RDPI_PARAMS_Q31_DRIVE(SAFE_V));
    if (status == RDPI_OK) {
        status = rdpi_q31_axis_start(&axis);
    }
    Serial.println(there ? "DAC found" : "no DAC answers");
    Serial.print("status ");
    Serial.println((int)status); /* of rdpi/types.h; unless it is 0, RDPI_OK, the DAC stays at the safe code */
    if (there) {
        start_timer();
    }
}

void loop()
{
    static uint32_t missed;
    uint8_t taken = take_ticks();
    if (taken == 0 || in_a_row >= MOST_FAILED) {
        return;
    }
    missed += taken - 1u;
    if (!rdpi_mcp4725_write(&dac, axis.dac_code >> SURPLUS_BITS)) {
        in_a_row++; /* the DAC holds the code before. This one is sent again: the library counts on every code */
        missed++;
        return;
    }
    in_a_row = 0;
    rdpi_q31_axis_missed(&axis, missed);
    lost += missed;
    sample = follows ? later(missed) : 0;
    missed = 0;
    (void)rdpi_q31_axis_step(&axis, reference(later(axis.chain.preview_samples)));
    follows = follows || axis.mode == RDPI_AXIS_RUN; /* the ramp has reached the triangle */
    sample = follows ? later(1) : 0;
}
