/* The reference is a column of a CSV file; sim.c reads it. */
#include "rdpi_reference.h"
#include "sim.h"

#if RDPI_REFERENCE_Q31
#include "rdpi_params.h"

/* As the host tools do: within 32 bits, or none where the library in floating point would refuse it. */
bool rdpi_reference_q31(uint32_t ticks, int32_t *reference)
{
    const double highest_um = RDPI_PARAMS_Q31_UM(INT32_MAX), lowest_um = RDPI_PARAMS_Q31_UM(-INT32_MAX);
    double um;
    (void)ticks; /* every row is a tick */
    if (!rdpi_port_sim_reference(&um)) {
        return false;
    }
    if (!(um >= -RDPI_MAX_REFERENCE_UM && um <= RDPI_MAX_REFERENCE_UM)) {
        *reference = RDPI_Q31_NO_REFERENCE;
    } else if (um >= highest_um || um <= lowest_um) {
        *reference = um >= highest_um ? INT32_MAX : -INT32_MAX;
    } else {
        *reference = RDPI_PARAMS_Q31_REFERENCE(um);
    }
    return true;
}
#else
bool rdpi_reference_um(uint32_t ticks, float *reference_um)
{
    double um;
    (void)ticks; /* every row is a tick */
    if (!rdpi_port_sim_reference(&um)) {
        return false;
    }
    *reference_um = (float)um;
    return true;
}
#endif
