/* rdpi: open-loop linearisation of a hysteretic actuator. Include this file, or one of the two that it includes:
 *
 *   rdpi/f32_axis.h   the library in single precision: rdpi/f32.h, the chain around it, and the life of an axis
 *   rdpi/q31_axis.h   the same in 32-bit integers, for cores without floating point */
#ifndef RDPI_RDPI_H
#define RDPI_RDPI_H

#include "rdpi/f32_axis.h"
#include "rdpi/q31_axis.h"

#endif
