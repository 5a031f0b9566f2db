/* The reference is a column of a CSV file; sim.c reads it. */
#include "rdpi_reference.h"
#include "sim.h"

#if RDPI_REFERENCE_Q31
#include "rdpi_params.h"

/* As the host tools do: within 32 bits, or none where the library in floating point would refuse it. */
static int32_t reference_of(double um)
{
    const double highest_um = RDPI_PARAMS_Q31_UM(INT32_MAX), lowest_um = RDPI_PARAMS_Q31_UM(-INT32_MAX);
    if (!(um >= -RDPI_MAX_REFERENCE_UM && um <= RDPI_MAX_REFERENCE_UM)) {
        return RDPI_Q31_NO_REFERENCE;
    }
    if (um >= highest_um || um <= lowest_um) {
        return um >= highest_um ? INT32_MAX : -INT32_MAX;
    }
    return RDPI_PARAMS_Q31_REFERENCE(um);
}

bool rdpi_reference_q31(uint32_t ticks, uint32_t ahead, int32_t *reference, int32_t *ahead_reference)
{
    double um, later_um;
    (void)ticks; /* every row is a tick */
    if (!rdpi_port_sim_reference(RDPI_AXIS, ahead, &um, &later_um)) {
        return false;
    }
    *reference = reference_of(um);
    *ahead_reference = reference_of(later_um);
    return true;
}
#else
bool rdpi_reference_um(uint32_t ticks, uint32_t ahead, float *reference_um, float *ahead_um)
{
    double um, later_um;
    (void)ticks; /* every row is a tick */
    if (!rdpi_port_sim_reference(RDPI_AXIS, ahead, &um, &later_um)) {
        return false;
    }
    *reference_um = (float)um;
    *ahead_um = (float)later_um;
    return true;
}
#endif
