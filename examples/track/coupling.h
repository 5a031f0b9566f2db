/* Cross coupling: what the other axes of a stage move this one by is taken off its reference. The model knows their
 * drives as columns of the recordings: other_axis_V of two axes, axis_0_V, axis_1_V, ... of more. `rdpi header` writes
 * a macro for each, in um. */
#ifndef TRACK_COUPLING_H
#define TRACK_COUPLING_H

#include "added.h"

static struct {
    added_t at_zero;              /* with all other axes at code 0 */
    added_t per_code[RDPI_AXES];
} coupling;

static double coupling_um(uint32_t axis, double drive_V)
{
    (void)drive_V;
    switch (axis) {
#if RDPI_AXES == 2 && defined RDPI_PARAMS_OTHER_AXIS_V_UM
    case 1 - RDPI_AXIS: return RDPI_PARAMS_OTHER_AXIS_V_UM(drive_V);
#endif
#if RDPI_AXES > 2 && defined RDPI_PARAMS_AXIS_0_V_UM
    case 0: return RDPI_PARAMS_AXIS_0_V_UM(drive_V);
#endif
#if RDPI_AXES > 2 && defined RDPI_PARAMS_AXIS_1_V_UM
    case 1: return RDPI_PARAMS_AXIS_1_V_UM(drive_V);
#endif
#if RDPI_AXES > 2 && defined RDPI_PARAMS_AXIS_2_V_UM
    case 2: return RDPI_PARAMS_AXIS_2_V_UM(drive_V);
#endif
#if RDPI_AXES > 2 && defined RDPI_PARAMS_AXIS_3_V_UM
    case 3: return RDPI_PARAMS_AXIS_3_V_UM(drive_V);
#endif
#if RDPI_AXES > 2 && defined RDPI_PARAMS_AXIS_4_V_UM
    case 4: return RDPI_PARAMS_AXIS_4_V_UM(drive_V);
#endif
#if RDPI_AXES > 2 && defined RDPI_PARAMS_AXIS_5_V_UM
    case 5: return RDPI_PARAMS_AXIS_5_V_UM(drive_V);
#endif
    default: return 0;
    }
}

static void couple(uint32_t axis, const rdpi_telemetry_run_t *of)
{
    double at_zero_um = coupling_um(axis, of->min_V);
    double last_code = (double)((1uL << of->dac_bits) - 1uL);
    coupling.at_zero += ADDED_OF(at_zero_um);
    coupling.per_code[axis] = ADDED_OF((coupling_um(axis, of->max_V) - at_zero_um) / last_code);
}

/* A reference for this axis alone. None stays none. */
static number_t coupling_taken_off(number_t reference, const uint32_t *codes)
{
    added_t moved = coupling.at_zero;
    for (uint32_t k = 0; k < RDPI_AXES; k++) {
        moved += coupling.per_code[k] * (added_t)codes[k];
    }
    return with_added(reference, -moved);
}

#endif
