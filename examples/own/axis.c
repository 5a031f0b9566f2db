#include "axis.h"

#if AXIS_Q31
#if !RDPI_PARAMS_Q31
#error "this actuator has no parameters in fixed point; rdpi_params.h says why"
#endif
#define RDPI(verb) rdpi_q31_chain_##verb
#define CHAIN rdpi_chain_q31
#define SAMPLE_TIME(rate_hz) ((1000000000u + (rate_hz) / 2u) / (rate_hz)) /* ns */
#else
#define RDPI(verb) rdpi_f32_chain_##verb
#define CHAIN rdpi_chain
#define SAMPLE_TIME(rate_hz) (1.0f / (float)(rate_hz))
#endif

static RDPI(t) chain; /* what stands around the actuator, and in it the actuator itself */
static bool sweeping = true;
static uint32_t sample;

rdpi_status_t axis_start(uint32_t rate_hz)
{
    return RDPI(init)(&chain, &CHAIN, SAMPLE_TIME(rate_hz));
}

uint32_t axis_first_code(void)
{
    return chain.axis.dac_code;
}

uint32_t axis_next(uint32_t lost)
{
    if (sweeping) {
        sweeping = RDPI(sweep)(&chain);
    } else {
        if (lost > 0u) {
            RDPI(missed)(&chain, lost);
            sample += lost;
        }
        (void)RDPI(step)(&chain, axis_reference(sample + chain.preview_samples));
        sample++;
    }
    return chain.axis.dac_code;
}
