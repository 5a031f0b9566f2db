/* Between the parts of this port. */
#ifndef RDPI_PORT_SIM_H
#define RDPI_PORT_SIM_H

#include <stdbool.h>
#include <stdint.h>

/* The next row's reference of an axis, and that of the row `ahead` rows later or of the last; false after the last row,
 * which leaves both. Called from the tick. */
bool rdpi_port_sim_reference(uint32_t axis, uint32_t ahead, double *reference_um, double *ahead_um);

#endif
