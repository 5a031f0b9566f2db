/* What a user of the library does first, with as many plays as the headers say that the library takes. */
#include <math.h>
#include <rdpi/rdpi.h>

#if defined EXPECTED_MAX_PLAYS && RDPI_MAX_PLAYS != EXPECTED_MAX_PLAYS
#error "the maximum set in CMake did not reach the library's user"
#endif

int main(void)
{
    static rdpi_real_t thresholds_um[RDPI_MAX_PLAYS + 1], slopes[RDPI_MAX_PLAYS + 1], zero[RDPI_MAX_PLAYS + 1];
    for (int i = 0; i <= RDPI_MAX_PLAYS; i++) {
        thresholds_um[i] = (rdpi_real_t)i;
        slopes[i] = 1;
    }
    rdpi_f32_params_t params = {
        .schema = RDPI_PARAMS_SCHEMA, .plays = RDPI_MAX_PLAYS, .deadzones = 1, .thresholds_um = thresholds_um,
        .slopes = slopes, .slope_rate_s_per_um = zero, .deadzones_um = zero, .deadzone_weights = slopes,
        .gain_um_per_V = 2, .max_um_per_s = 1000, .min_slope_ratio = 0.1f, .max_V = 10};
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
