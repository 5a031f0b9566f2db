/* Between main.c and the axes. */
#ifndef EXCITE_AXIS_H
#define EXCITE_AXIS_H

#include <stdint.h>

#include "telemetry.h"

typedef struct {
    const rdpi_telemetry_run_t *run; /* its constants */
    const uint32_t *codes;           /* of the drive ... */
    uint32_t count;                  /* ... so many */
    uint32_t swept;                  /* of the first, the sweep; may be 0 */
} excite_axis_t;

#endif
