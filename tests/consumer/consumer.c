/* What a user of the library does first, with as many plays as the headers say that the library takes. */
#include <math.h>
#include <rdpi/rdpi.h>

#if defined EXPECTED_MAX_PLAYS && RDPI_MAX_PLAYS != EXPECTED_MAX_PLAYS
#error "the maximum set in CMake did not reach the library's user"
#endif

int main(void)
{
    static rdpi_f32_play_t play[RDPI_MAX_PLAYS];
    static rdpi_real_t memory_um[RDPI_MAX_PLAYS];
    const rdpi_f32_deadzone_t straight = {.d_um = 0, .weight = 1};
    const rdpi_f32_piece_t back = {-RDPI_MAX_REFERENCE_UM, RDPI_MAX_REFERENCE_UM, .slope = 1, .intercept_um = 0};
    const rdpi_f32_line_t curve = {
        .to_V = 10, .to_um = 20, .middle_um = 10, .reach_um = 10, .gain_um_per_V = 2, .V_per_um = 0.5f};
    for (int i = 0; i < RDPI_MAX_PLAYS; i++) {
        play[i] = (rdpi_f32_play_t){.r_um = (rdpi_real_t)i, .slope = 1};
    }
    rdpi_f32_params_t params = {
        .schema = RDPI_PARAMS_SCHEMA, .plays = RDPI_MAX_PLAYS, .deadzones = 1, .curve_pieces = 1, .sweep_cycles = 10,
        .max_um_per_s = 1000, .min_slope_ratio = 0.1f, .max_V = 10, .sweep_V_per_s = 100,
        .play = play, .saturation = &straight, .inverse_saturation = &back, .curve = &curve,
        .memory_um = memory_um};
    params.digest = rdpi_f32_digest(&params);
    static rdpi_f32_t axis;
    if (rdpi_f32_init(&axis, &params, 1e-4f) != RDPI_OK) {
        return 1;
    }
    if (fabsf(rdpi_f32_step(&axis, 5) - 2.5f) > 1e-6f) {
        return 2;
    }
    params.plays = RDPI_MAX_PLAYS + 1;
    return rdpi_f32_init(&axis, &params, 1e-4f) == RDPI_ERR_COUNT ? 0 : 3;
}
