/* Between the parts of this port. */
#ifndef RDPI_PORT_SIM_H
#define RDPI_PORT_SIM_H

#include <stdbool.h>

/* The next row's reference; false after the last, which leaves `reference_um`. Called from the tick. */
bool rdpi_port_sim_reference(double *reference_um);

#endif
