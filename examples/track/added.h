/* What is added to a reference, in its own units. Fixed point has 16 bits more for it. */
#ifndef TRACK_ADDED_H
#define TRACK_ADDED_H

#if TRACK_Q31
typedef int64_t added_t; /* reference units times 2^16 */
#define ADDED_OF(um) ((added_t)((um) / (RDPI_PARAMS_Q31_UM(1) - RDPI_PARAMS_Q31_UM(0)) * 65536))
#else
typedef float added_t; /* um */
#define ADDED_OF(um) ((added_t)(um))
#endif

static inline bool is_reference(number_t reference)
{
#if TRACK_Q31
    return reference != RDPI_Q31_NO_REFERENCE;
#else
    return reference >= -RDPI_MAX_REFERENCE_UM && reference <= RDPI_MAX_REFERENCE_UM;
#endif
}

/* None stays none. */
static inline number_t with_added(number_t reference, added_t added)
{
#if TRACK_Q31
    int64_t sum = reference + added / 65536;
    if (!is_reference(reference)) {
        return reference;
    }
    return (number_t)(sum > INT32_MAX ? INT32_MAX : sum < -INT32_MAX ? -INT32_MAX : sum);
#else
    return reference + added;
#endif
}

#endif
