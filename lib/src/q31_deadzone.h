/* The saturation stage in fixed point: Ang et al., IROS 2003, eq. 7, 8 and 13. */
#ifndef RDPI_Q31_DEADZONE_H
#define RDPI_Q31_DEADZONE_H

#include "q31_math.h"

/* Eq. 7: the one-sided dead zone of threshold d > 0. Scaling and overflow: cannot overflow. */
static inline int32_t rdpi_q31_deadzone(int32_t v, int32_t d)
{
    return v > d ? v - d : 0;
}

/* Eq. 8, and as eq. 13 its inverse: the weighted sum over 2^shift, rounded down. O(count), count >= 1.
 * Scaling and overflow: with weights that add up to 2^31 at most the sum stays within 2^62; saturates at +-limit. */
static inline int32_t rdpi_q31_saturation(const rdpi_q31_deadzone_t *term, size_t count, unsigned shift, int32_t limit,
                                          int32_t v)
{
    int64_t sum = (int64_t)term[0].weight * v;
    for (size_t j = 1; j < count; j++) {
        sum += (int64_t)term[j].weight * rdpi_q31_deadzone(v, term[j].d);
    }
    return rdpi_q31_clamp(sum >> shift, -limit, limit);
}

#endif
