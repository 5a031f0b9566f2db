/* Follows a triangle in open loop, in single precision, and prints the code for a 16-bit DAC of every sample.
 *
 * rdpi_params.h is the actuator: replace it with that of `rdpi header --effects none`. This sketch is of the operator
 * alone: rdpi/f32_chain.h also makes up for effects around it, such as a lag. The sketch computes as fast as it can. One
 * that moves an actuator computes one sample in each interrupt of a timer, and sends the code to the DAC there. */
#include <rdpi.h>
#include "rdpi_params.h"

static const long RATE_HZ = 1000;
static const long SAMPLES = 400;
static const long TURN = 160; /* samples up, and as many down */
static rdpi_f32_t axis;

void setup()
{
    Serial.begin(115200);
    rdpi_status_t status = rdpi_f32_init(&axis, &rdpi_params, 1.0f / RATE_HZ);
    Serial.print("status ");
    Serial.println((int)status); /* of rdpi/types.h; 0 is RDPI_OK */
    for (long sample = 0; status == RDPI_OK && sample < SAMPLES; sample++) {
        long phase = sample % (2 * TURN);
        rdpi_f32_step(&axis, 0.05f * (phase < TURN ? phase : 2 * TURN - phase)); /* um */
        Serial.println(axis.dac_code);
    }
    Serial.println("end");
}

void loop()
{
}
