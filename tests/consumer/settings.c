/* An application beside a library that was compiled with other settings, or, given any argument, with the same: init
 * tells which, and with others writes nothing. The states are on the heap, where the address sanitizer sees every byte
 * beyond them. Without printf: settings that pack structs do not fit libc. */
#include <rdpi/rdpi.h>
#include <stdlib.h>
#include <string.h>

#define FILL 0xA5

static rdpi_status_t init_any_f32(rdpi_f32_t *axis, rdpi_f32_chain_t *chain)
{
    static const rdpi_f32_play_t play = {.r_um = 0, .slope = 1};
    static const rdpi_f32_deadzone_t straight = {.d_um = 0, .weight = 1};
    static const rdpi_f32_piece_t back = {-RDPI_MAX_REFERENCE_UM, RDPI_MAX_REFERENCE_UM, .slope = 1, .intercept_um = 0};
    static const rdpi_real_t memory_um = 0;
    static const rdpi_f32_line_t curve = {
        .to_V = 10, .to_um = 20, .middle_um = 10, .reach_um = 10, .gain_um_per_V = 2, .V_per_um = (rdpi_real_t)0.5};
    rdpi_f32_params_t params = {
        .schema = RDPI_PARAMS_SCHEMA, .plays = 1, .deadzones = 1, .curve_pieces = 1, .sweep_cycles = 10,
        .max_um_per_s = 1000, .min_slope_ratio = (rdpi_real_t)0.1, .max_V = 10,
        .sweep_V_per_s = 100, .play = &play, .saturation = &straight, .inverse_saturation = &back,
        .curve = &curve, .memory_um = &memory_um};
    params.digest = rdpi_f32_digest(&params);
    rdpi_f32_chain_params_t around = {
        .schema = RDPI_PARAMS_SCHEMA, .preview = 1, .lead_s = 1, .max_lead_um = 1, .direct = 1, .axis = &params};
    around.digest = rdpi_f32_chain_digest(&around);
    return axis != NULL ? rdpi_f32_init(axis, &params, (rdpi_real_t)1e-4)
                        : rdpi_f32_chain_init(chain, &around, (rdpi_real_t)1e-4);
}

static rdpi_status_t init_f32(void *self)
{
    return init_any_f32(self, NULL);
}

static rdpi_status_t init_f32_chain(void *self)
{
    return init_any_f32(NULL, self);
}

static rdpi_status_t init_q31(void *self)
{
    static const rdpi_q31_play_t play = {.r = 0, .slope = RDPI_Q31_ONE};
    static const rdpi_q31_deadzone_t straight = {.d = 0, .weight = RDPI_Q31_ONE};
    static const int32_t memory = 0;
    rdpi_q31_params_t params = {
        .schema = RDPI_PARAMS_SCHEMA, .sweep_per_us = (uint64_t)1 << 50, .plays = 1, .deadzones = 1,
        .curve_pieces = 1, .sweep_cycles = 10, .max_x = 1 << 28, .saturation_shift = 30, .inverse_shift = 30, .guard_exponent = -31, .min_slope_ratio = 1,
        .guard_mantissa = (uint32_t)1 << 31, .min_drive = 0, .max_drive = 1 << 28, .play = &play,
        .saturation = &straight, .inverse_saturation = &straight, .memory = &memory};
    params.digest = rdpi_q31_digest(&params);
    return rdpi_q31_init(self, &params, 100000);
}

/* Whether init says what it should, and has written to `size` bytes only if it said that all is well. */
static int holds(rdpi_status_t (*init)(void *), size_t size, int same)
{
    unsigned char *self = malloc(size);
    memset(self, FILL, size);
    rdpi_status_t status = init(self);
    size_t written = 0;
    for (size_t k = 0; k < size; k++) {
        written += self[k] != FILL;
    }
    free(self);
    return same ? status == RDPI_OK && written > 0 : status == RDPI_ERR_SIZE && written == 0;
}

int main(int argc, char **argv)
{
    (void)argv;
    int same = argc > 1;
    return (holds(init_f32, sizeof(rdpi_f32_t), same) ? 0 : 1) + (holds(init_q31, sizeof(rdpi_q31_t), same) ? 0 : 2) +
           (holds(init_f32_chain, sizeof(rdpi_f32_chain_t), same) ? 0 : 4);
}
