/* rdpi: open-loop linearisation of a hysteretic actuator. Firmware includes this, or one of the two.
 *
 *   rdpi/f32.h   in single precision
 *   rdpi/q31.h   in 32-bit integers, for cores without floating point */
#ifndef RDPI_RDPI_H
#define RDPI_RDPI_H

#include "rdpi/f32.h"
#include "rdpi/q31.h"

#endif
