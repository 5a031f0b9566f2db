/* rdpi: open-loop linearisation of a hysteretic actuator. Include this file, or one of the two that it includes:
 *
 *   rdpi/f32_chain.h   the library in single precision: rdpi/f32.h, and the chain around it
 *   rdpi/q31_chain.h   the library in 32-bit integers, for cores without floating point: rdpi/q31.h, and the chain */
#ifndef RDPI_RDPI_H
#define RDPI_RDPI_H

#include "rdpi/f32_chain.h"
#include "rdpi/q31_chain.h"

#endif
