/* The independent watchdog of the STM32F4 and G4, for a port that includes this after common.h and its registers.h,
 * which has IWDG, RCC and RCC_CSR_... Off unless the build asks for it, RDPI_WATCHDOG_MS.
 *
 * What feeds it is a tick that has returned, if main has come by rdpi_port_idle since it was fed before: a tick that
 * hangs, one that no longer comes and a main that hangs all end in a reset.
 *
 *     what                                                                          sources
 *     KR, PR, RLR, SR at 0x00, 0x04, 0x08, 0x0C; base address 0x40003000            ST's stm32f405xx.h, stm32g474xx.h;
 *                                                                                   the address also Mios, stm32g4
 *     keys             0x5555 opens PR and RLR, 0xAAAA reloads, 0xCCCC starts       SVDs in cmforthlib (STM32H743)
 *     PR 2:0           the divider is 4 << PR, 256 at most; RLR has 12 bits         the same
 *     SR               PVU 0, RVU 1: PR, RLR are being taken over                   the same (STM32WL5x)
 *     oscillator       32 kHz; the data sheets allow 17 to 47 (F405)                RM0090, DS8626, from memory
 *     RCC_CSR          in the ports' registers.h */
#ifndef RDPI_STM32_WATCHDOG_H
#define RDPI_STM32_WATCHDOG_H

#ifndef RDPI_WATCHDOG_MS
#define RDPI_WATCHDOG_MS 0 /* none */
#endif
#if RDPI_WATCHDOG_MS > 32768
#error "RDPI_WATCHDOG_MS: 32768 at most"
#endif

#define WATCHDOG_OPEN 0x5555u
#define WATCHDOG_FEED 0xAAAAu
#define WATCHDOG_START 0xCCCCu
#define WATCHDOG_BUSY 0x3u
#define WATCHDOG_KHZ 32u
#define WATCHDOG_COUNTS 4096u
#define WATCHDOG_LEAST_TICKS 4u /* in its time, which a fast oscillator makes shorter by a third */

static volatile bool main_came_by; /* since it was fed */
static bool watchdog_has_reset;

/* Nothing if none is wanted. False for a sample rate that would not feed it often enough, or if it does not start; once
 * started it cannot be stopped. */
static bool watchdog_start(uint32_t rate_hz)
{
    if (RDPI_WATCHDOG_MS == 0) {
        return true;
    }
    const uint32_t ms = RDPI_WATCHDOG_MS, clocks = ms * WATCHDOG_KHZ;
    if ((uint64_t)rate_hz * ms < WATCHDOG_LEAST_TICKS * UINT64_C(1000)) {
        return false;
    }
    uint32_t divider = 0;
    while (clocks >> (divider + 2u) > WATCHDOG_COUNTS) {
        divider++;
    }
    reg_write(&IWDG->kr, WATCHDOG_START);
    reg_write(&IWDG->kr, WATCHDOG_OPEN);
    reg_write(&IWDG->pr, divider);
    reg_write(&IWDG->rlr, (clocks >> (divider + 2u)) - 1u);
    bool taken = false;
    for (unsigned k = 0; k < 8u && !taken; k++) { /* six of its clocks, 48 ms if divided by 256 */
        taken = reached(&IWDG->sr, WATCHDOG_BUSY, 0);
    }
    reg_write(&IWDG->kr, WATCHDOG_FEED);
    return taken;
}

/* From the tick's interrupt, when the application's tick has returned. */
static void watchdog_feed(void)
{
    if (RDPI_WATCHDOG_MS > 0 && main_came_by) {
        main_came_by = false;
        reg_write(&IWDG->kr, WATCHDOG_FEED);
    }
}

/* The flag outlasts the reset, and would outlast later ones. */
bool rdpi_port_watchdog_reset(void)
{
    if ((reg_read(&RCC->csr) & RCC_CSR_IWDGRSTF) != 0u) {
        watchdog_has_reset = true;
        reg_write(&RCC->csr, reg_read(&RCC->csr) | RCC_CSR_RMVF);
    }
    return watchdog_has_reset;
}

#endif
