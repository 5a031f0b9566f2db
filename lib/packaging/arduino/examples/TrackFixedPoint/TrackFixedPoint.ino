/* Follows a triangle in open loop, in fixed point, and prints the code for a 16-bit DAC of every sample. See Track. */
#include <rdpi.h>
#include "rdpi_params.h"

static const long RATE_HZ = 1000;
static const long SAMPLES = 400;
static const long TURN = 160; /* samples up, and as many down */
static rdpi_q31_t axis;

void setup()
{
    Serial.begin(115200);
    rdpi_status_t status = rdpi_q31_init(&axis, &rdpi_params_q31, 1000000000ul / RATE_HZ); /* ns */
    Serial.print("status ");
    Serial.println((int)status); /* of rdpi/types.h; 0 is RDPI_OK */
    const int32_t bottom = RDPI_PARAMS_Q31_REFERENCE(0), step = RDPI_PARAMS_Q31_DIFFERENCE(0.05); /* um */
    for (long sample = 0; status == RDPI_OK && sample < SAMPLES; sample++) {
        long phase = sample % (2 * TURN);
        rdpi_q31_step(&axis, bottom + step * (phase < TURN ? phase : 2 * TURN - phase));
        Serial.println(axis.dac_code);
    }
    Serial.println("end");
}

void loop()
{
}
