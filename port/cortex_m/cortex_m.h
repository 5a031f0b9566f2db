/* What the ports to Arm's Cortex-M share: vectors, interrupt controller, sleep. M0 to M7.
 *
 * Addresses: Armv6-M Architecture Reference Manual (DDI 0419) B3.4 and Armv7-M (DDI 0403) B3.4, the same in both.
 * Priorities: their upper two bits are all that an M0 has (DDI 0419, B3.4.7), which also wants whole words. */
#ifndef RDPI_CORTEX_M_H
#define RDPI_CORTEX_M_H

#include <stdint.h>

typedef void (*cortex_m_handler_t)(void);

/* The port's interrupt handlers by number: CORTEX_M_VECTORS[] = {[8] = timer_interrupt}; a number left out that occurs
 * all the same is a fault. */
#define CORTEX_M_VECTORS \
    __attribute__((section(".vectors.device"), used)) static const cortex_m_handler_t device_vectors

#define CORTEX_M_HIGHEST 0x00u
#define CORTEX_M_LOWEST 0xC0u

#define CORTEX_M_ISER ((volatile uint32_t *)0xE000E100u)
#define CORTEX_M_ISPR ((volatile uint32_t *)0xE000E200u)
#define CORTEX_M_IPR ((volatile uint32_t *)0xE000E400u)

/* What was written so far is done before what follows. */
static inline void cortex_m_sync(void)
{
    __asm__ volatile("dsb" ::: "memory");
}

/* Gives an interrupt a priority and lets it happen; what was written before, it finds. */
static inline void cortex_m_enable(unsigned interrupt, uint32_t priority)
{
    unsigned shift = interrupt % 4u * 8u;
    volatile uint32_t *ipr = &CORTEX_M_IPR[interrupt / 4u];
    *ipr = (*ipr & ~(0xFFu << shift)) | priority << shift;
    cortex_m_sync();
    CORTEX_M_ISER[interrupt / 32u] = 1u << interrupt % 32u;
}

/* Calls an interrupt's handler as soon as its priority allows. */
static inline void cortex_m_pend(unsigned interrupt)
{
    cortex_m_sync();
    CORTEX_M_ISPR[interrupt / 32u] = 1u << interrupt % 32u;
}

/* Until an interrupt. */
static inline void cortex_m_sleep(void)
{
    __asm__ volatile("dsb\n\twfi" ::: "memory");
}

#endif
