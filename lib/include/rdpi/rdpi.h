/* rdpi: open-loop linearisation of a hysteretic actuator. Include this file, or one of those that it includes:
 *
 *   rdpi/f32.h   the library in single precision
 *   rdpi/q31.h   the library in 32-bit integers, for cores without floating point
 *
 * Each has a sibling that also compensates what stands around the operator: rdpi/f32_chain.h, rdpi/q31_chain.h. */
#ifndef RDPI_RDPI_H
#define RDPI_RDPI_H

#include "rdpi/f32.h"
#include "rdpi/q31.h"
#include "rdpi/q31_chain.h"

#endif
