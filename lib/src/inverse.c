#include "rdpi/inverse.h"

#include "rdpi/play.h"

/* As x moves one way from where it is, f(x) = sum of w_i play_i(x) is continuous, increasing and piecewise linear.
 * Its corners are where the next play engages: rising at x = y_i + r_i, falling at x = y_i - r_i. Both sequences are
 * ordered for states reached from one history, so the engaged plays are always 0..k and the slope is W_k. Walk from
 * corner to corner until the piece that holds v is found. Falling is rising seen in a mirror: `side` turns it over. */
rdpi_real_t rdpi_f32_plays_solve(const rdpi_real_t *y_um, const rdpi_real_t *r_um, const rdpi_real_t *slopes,
                                 size_t count, rdpi_real_t v_um)
{
    rdpi_real_t rise_um = v_um - rdpi_f32_plays_sum(y_um, slopes, count); /* still to climb */
    rdpi_real_t side = rise_um < 0 ? -1 : 1;
    rdpi_real_t x_um = side * y_um[0];
    size_t k = 0;

    rise_um *= side;
    while (k + 1 < count) {
        rdpi_real_t corner_um = side * y_um[k + 1] + r_um[k + 1];
        if (corner_um > x_um) {
            rdpi_real_t climb_um = slopes[k] * (corner_um - x_um);
            if (climb_um >= rise_um) {
                break;
            }
            rise_um -= climb_um;
            x_um = corner_um;
        } /* else it is engaged already, up to rounding */
        k++;
    }
    return side * (x_um + rise_um / slopes[k]);
}
