/* Follows the triangle of the Arduino sketches and prints "code in single precision, code in fixed point" per sample. */
#include <stdio.h>

#include <rdpi/rdpi.h>

#include "rdpi_params.h"

int main(void)
{
    static rdpi_f32_t f32;
    static rdpi_q31_t q31;
    if (rdpi_f32_init(&f32, &rdpi_params, 1.0f / 1000) != RDPI_OK ||
        rdpi_q31_init(&q31, &rdpi_params_q31, 1000000) != RDPI_OK) {
        return 1;
    }
    const int32_t bottom = RDPI_PARAMS_Q31_REFERENCE(0), step = RDPI_PARAMS_Q31_DIFFERENCE(0.05);
    for (int sample = 0; sample < 400; sample++) {
        int phase = sample % 320;
        int height = phase < 160 ? phase : 320 - phase;
        (void)rdpi_f32_step(&f32, 0.05f * (float)height);
        (void)rdpi_q31_step(&q31, bottom + step * height);
        (void)printf("%lu %lu\n", (unsigned long)f32.dac_code, (unsigned long)q31.dac_code);
    }
    return 0;
}
