/* The saturation stage and its inverse in fixed point: Ang et al., IROS 2003, eq. 7, 8 and 13. Both are sums of
 * one-sided dead zones. Of the inverse, the step uses the straight piece on which the reference lies, if its numbers
 * fit. */
#ifndef RDPI_Q31_SATURATION_H
#define RDPI_Q31_SATURATION_H

#include "q31_math.h"

/* Eq. 7: the one-sided dead zone of threshold d > 0. Scaling and overflow: cannot overflow. */
static inline int32_t rdpi_q31_deadzone(int32_t v, int32_t d)
{
    return v > d ? v - d : 0;
}

/* Eq. 8 and, with the terms of S^-1, eq. 13: the weighted sum over 2^shift, rounded down. O(count), count >= 1. Scaling
 * and overflow: the magnitudes of the weights add up to 2^31 at most, so the sum stays within 2^62. The result
 * saturates at +-limit. */
static inline int32_t rdpi_q31_saturation(const rdpi_q31_deadzone_t *term, size_t count, unsigned shift, int32_t limit,
                                          int32_t v)
{
    int64_t sum = rdpi_q31_mul(term[0].weight, v);
    for (size_t j = 1; j < count; j++) {
        sum += rdpi_q31_mul(term[j].weight, rdpi_q31_deadzone(v, term[j].d));
    }
    return rdpi_q31_clamp(sum >> shift, -limit, limit);
}

/* Finds the piece on which `v` lies. Returns whether its numbers fit, as they do for shifts of 30 to 61 and slopes
 * below 2. Scaling and overflow: slope and intercept are rounded down, the output is off by |v| / 2^30 + 1 units of
 * 2^-30 at most. Before it is divided by 2^30, it stays within 2^62. */
static inline bool rdpi_q31_piece_find(rdpi_q31_piece_t *piece, const rdpi_q31_deadzone_t *term, size_t count,
                                       unsigned shift, int32_t v)
{
    const rdpi_q31_deadzone_t *const end = &term[count];
    uint32_t slope = (uint32_t)term->weight;
    int64_t intercept = 0;
    int32_t from = -INT32_MAX, to = INT32_MAX;
    for (const rdpi_q31_deadzone_t *next = &term[1]; next != end; next++) {
        if (v < next->d) {
            to = next->d;
            break;
        }
        from = next->d;
        slope += (uint32_t)next->weight;
        intercept -= rdpi_q31_mul(next->weight, from);
    }
    shift -= 30u;
    piece->length = 0;
    if (shift > 31u || slope >> shift > INT32_MAX) {
        return false;
    }
    piece->slope = (int32_t)(slope >> shift);
    piece->intercept = intercept >> shift;
    piece->from = from;
    piece->length = (uint32_t)to - (uint32_t)from;
    return true;
}

/* Whether `v` lies on the piece. */
static inline bool rdpi_q31_piece_holds(const rdpi_q31_piece_t *piece, int32_t v)
{
    return (uint32_t)v - (uint32_t)piece->from < piece->length;
}

/* The stage on that piece, times 2^30. */
static inline int64_t rdpi_q31_piece_at(const rdpi_q31_piece_t *piece, int32_t v)
{
    return rdpi_q31_mul(piece->slope, v) + piece->intercept;
}

#endif
