/* The reference is a table in flash, made by `rdpi profile`: rdpi_profile.h. In fixed point it is converted when it is
 * compiled, with the scale of rdpi_params.h. */
#include "rdpi_reference.h"

#if RDPI_REFERENCE_Q31
#include "rdpi_params.h"
#define RDPI_PROFILE_NUMBER int32_t
#define RDPI_PROFILE_UM(um) RDPI_PARAMS_Q31_REFERENCE(um)
#define RDPI_PROFILE_NONE RDPI_Q31_NO_REFERENCE
#define NEXT rdpi_reference_q31
#else
#include <math.h>
#define RDPI_PROFILE_NUMBER float
#define RDPI_PROFILE_UM(um) ((float)(um))
#define RDPI_PROFILE_NONE NAN
#define NEXT rdpi_reference_um
#endif
#include "rdpi_profile.h"
#ifdef RDPI_PROFILE_DAC_BITS
#error "rdpi_profile.h holds a drive, for examples/excite; a reference is made without --dac"
#endif

#if defined(TRACK_RATE_HZ) && RDPI_PROFILE_RATE_HZ != TRACK_RATE_HZ
#error "rdpi_profile.h has another number of samples per second than the application, RDPI_TRACK_RATE_HZ"
#endif

static uint32_t due; /* the sample that comes next if no tick is lost */

bool NEXT(uint32_t ticks, uint32_t ahead, RDPI_PROFILE_NUMBER *reference, RDPI_PROFILE_NUMBER *ahead_reference)
{
    uint32_t present = due + (ticks - 1u);
    if (due >= RDPI_PROFILE_COUNT || ticks - 1u >= RDPI_PROFILE_COUNT - due) {
        due = RDPI_PROFILE_COUNT;
        return false;
    }
    *reference = rdpi_profile[present];
    *ahead_reference = rdpi_profile[ahead < RDPI_PROFILE_COUNT - present ? present + ahead : RDPI_PROFILE_COUNT - 1u];
    due = present + 1u;
    return true;
}
