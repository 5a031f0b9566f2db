/* Backlash: a joint between actuator and stage has play. At each reversal of the reference the actuator crosses it ahead
 * of the stage: half of its width is added while the reference rises, and subtracted while it falls. The jump between
 * the two takes RDPI_PARAMS_BACKLASH_S, for a faster one would let the mechanics ring. */
#ifndef TRACK_BACKLASH_H
#define TRACK_BACKLASH_H

#include "added.h"

#define HALF_WIDTH ADDED_OF(RDPI_PARAMS_BACKLASH_UM / 2)
#define JUMP_TICKS ((uint32_t)(RDPI_PARAMS_BACKLASH_S * TRACK_RATE_HZ)) /* whole ones */
#define PER_TICK ADDED_OF(RDPI_PARAMS_BACKLASH_UM / (RDPI_PARAMS_BACKLASH_S * TRACK_RATE_HZ))

static struct {
    added_t jump;    /* what is added now */
    added_t target;  /* ... and at the end of the jump */
    number_t latest; /* the reference before */
    bool taken;      /* there was one */
} backlash;

/* What the actuator is to follow, `wanted`, so that the stage follows the reference. */
static number_t backlash_crossed(number_t wanted, number_t reference, uint32_t ticks)
{
    added_t most = ticks <= JUMP_TICKS ? PER_TICK * (added_t)ticks : 2 * HALF_WIDTH; /* the whole jump, no overflow */
    if (is_reference(reference)) {
        number_t latest = backlash.taken ? backlash.latest : reference;
        backlash.target = reference > latest ? HALF_WIDTH : reference < latest ? -HALF_WIDTH : backlash.target;
        backlash.latest = reference;
        backlash.taken = true;
    }
    added_t left = backlash.target - backlash.jump;
    backlash.jump += left > most ? most : left < -most ? -most : left;
    return with_added(wanted, backlash.jump);
}

#endif
