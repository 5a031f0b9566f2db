/* What the ports of the STM32F4 and G4 have in common: access to registers, and the count of lost ticks. For a port that
 * includes this after its registers.h, which has reg_read and reg_write. */
#ifndef RDPI_STM32_COMMON_H
#define RDPI_STM32_COMMON_H

#define PATIENCE 100000u /* reads until a bit is given up, some 10 ms; a crystal takes 2 ms, all else less than 0.1 ms */

static volatile uint32_t overruns; /* written by the tick's interrupt, read anywhere */

static void change(uint32_t *reg, uint32_t clear, uint32_t set)
{
    reg_write(reg, (reg_read(reg) & ~clear) | set);
}

/* Waits until the bits of the mask are `value`, but not for ever. */
static bool reached(const uint32_t *reg, uint32_t mask, uint32_t value)
{
    for (uint32_t k = 0; k < PATIENCE; k++) {
        if ((reg_read(reg) & mask) == value) {
            return true;
        }
    }
    return false;
}

static void lose(uint32_t ticks)
{
    uint32_t room = UINT32_MAX - overruns;
    overruns += ticks < room ? ticks : room;
}

uint32_t rdpi_port_overruns(void)
{
    return overruns;
}

#endif
