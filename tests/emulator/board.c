/* What a test program needs to run in qemu-system-arm: vectors, start-up, and the exit status as that of the emulator.
 * printf goes out through semihosting (newlib's rdimon). */
#include <stdint.h>
#include <stdlib.h>

extern uint32_t stack_end, data_begin, data_end, data_image, bss_begin, bss_end;

int main(void);
void initialise_monitor_handles(void); /* rdimon's, opens stdout */
void __libc_init_array(void);
void _init(void);
void _fini(void);
void reset(void);

static void semihost(uint32_t operation, const void *argument)
{
    register uint32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

/* Instead of rdimon's, which loses the status. */
void _exit(int status)
{
    const uint32_t application_exit[2] = {0x20026u, (uint32_t)status};
    for (;;) {
        semihost(0x20u, application_exit); /* SYS_EXIT_EXTENDED */
    }
}

void _init(void)
{
}

void _fini(void)
{
}

void reset(void)
{
#if defined(__ARM_FP)
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* CPACR: the FPU is off after reset */
    __asm__ volatile("dsb\n isb");
#endif
    uint32_t *from = &data_image;
    for (uint32_t *to = &data_begin; to < &data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = &bss_begin; to < &bss_end;) {
        *to++ = 0;
    }
    initialise_monitor_handles();
    __libc_init_array();
    exit(main());
}

static void fault(void)
{
    _exit(99);
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_end, (const void *)reset, (const void *)fault, (const void *)fault,
    (const void *)fault, (const void *)fault, (const void *)fault,
};
