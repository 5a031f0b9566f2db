/* Parameters that are valid by construction are accepted, and keep their promises for any samples and calls. */
#include "f32_chain.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    rdpi_f32_t self;
    rdpi_f32_play_t play[RDPI_MAX_PLAYS];
    rdpi_f32_deadzone_t saturation[RDPI_MAX_DEADZONES];
    rdpi_f32_piece_t inverse[RDPI_MAX_DEADZONES];
    rdpi_f32_line_t curve[RDPI_MAX_CURVE_PIECES];
    rdpi_real_t memory_um[RDPI_MAX_PLAYS];
    input = data;
    input_left = size;

    double sample_time_s = pow(10, take_between(-5, -2));
    double min_V = take_between(-200, 100), span_V = take_between(1, 300);
    double size_of_gain = take_between(0.01, 1);
    uint8_t how = take_u8();
    double gain = how % 4 == 0 ? -size_of_gain : size_of_gain;
    double max_um_per_s = pow(10, take_between(0, 5));
    double offset_V = min_V + span_V * take_between(-0.5, 1.5);
    rdpi_f32_params_t params = {
        .schema = RDPI_PARAMS_SCHEMA,
        .plays = (uint16_t)(1 + take_u8() % RDPI_MAX_PLAYS),
        .deadzones = (uint8_t)(1 + take_u8() % RDPI_MAX_DEADZONES),
        .dac_bits = take_u8() % (RDPI_MAX_DAC_BITS + 1),
        .noise_shaping = how / 4 % 4 == 0,
        .sweep_cycles = (uint16_t)(1 + take_u16() % 50),
        .offset_um = (rdpi_real_t)take_between(-100, 100),
        .rate_window_s = (rdpi_real_t)(sample_time_s * take_between(0, RDPI_MAX_WINDOW)),
        .rate_filter_s = (rdpi_real_t)(take_u8() % 2 ? sample_time_s * pow(10, take_between(-2, 5)) : 0),
        .max_um_per_s = (rdpi_real_t)max_um_per_s,
        .min_slope_ratio = (rdpi_real_t)take_between(0.05, 0.5),
        .min_V = (rdpi_real_t)min_V,
        .max_V = (rdpi_real_t)(min_V + span_V),
        .play = play,
        .saturation = saturation,
        .inverse_saturation = inverse,
        .curve = curve,
        .memory_um = memory_um,
    };
    double sweep_V_per_s = fmin(span_V / sample_time_s * pow(10, take_between(-2, 0.5)), 1e6);
    params.sweep_V_per_s = (rdpi_real_t)sweep_V_per_s;
    params.slew_V_per_s = (rdpi_real_t)(take_u8() % 2 ? fmin(sweep_V_per_s * pow(10, take_between(0.01, 2)), 1e7) : 0);
    params.sweep_forgotten = (rdpi_real_t)0.25;
    params.sweep_end_V = (rdpi_real_t)(min_V + span_V * take_between(0.01, 0.99));

    unsigned most = params.dac_bits > 0 && params.dac_bits <= 3 ? (1u << params.dac_bits) - 1u : RDPI_MAX_CURVE_PIECES;
    params.curve_pieces = (uint8_t)(1 + take_u8() % most);
    for (size_t k = 0; k < params.curve_pieces; k++) {
        double share = ((double)k + take_between(0.6, 1.4)) / params.curve_pieces;
        curve[k].gain_um_per_V = (rdpi_real_t)(gain * (k == 0 ? 1 : take_between(0.3, 3)));
        curve[k].to_V = (rdpi_real_t)(min_V + span_V * share);
    }
    curve[0].offset_V = (rdpi_real_t)offset_V;
    actuator_derive_curve(&params, curve);

    double r_um = 0, stroke_um = fabs(gain) * span_V;
    rdpi_real_t rest_V = (rdpi_real_t)(min_V + span_V * take_between(0.01, 0.99));
    const rdpi_f32_line_t *line = curve;
    while (line != &curve[params.curve_pieces - 1] && rest_V > line->to_V) {
        line++;
    }
    double x_um = (double)line->gain_um_per_V * ((double)rest_V - (double)line->offset_V);
    for (size_t i = 0; i < params.plays; i++) {
        double gap_um = i > 0 ? stroke_um * take_between(0.001, 0.2) : 0;
        double slope = take_between(0.1, 2);
        double ratio = take_between(params.min_slope_ratio, 3); /* of the slope at the guard to that at rest */
        r_um += gap_um;
        x_um += gap_um * take_between(-1, 1);
        memory_um[i] = (rdpi_real_t)x_um;
        play[i].r_um = (rdpi_real_t)r_um;
        play[i].slope = (rdpi_real_t)slope;
        play[i].slope_rate_s_per_um = (rdpi_real_t)(slope * (ratio - 1) / max_um_per_s);
    }
    actuator_derive_intercepts(play, params.plays);
    double d_um = 0, slope = 0;
    for (size_t j = 0; j < params.deadzones; j++) {
        double slope_above = take_between(0.2, 2);
        saturation[j].d_um = (rdpi_real_t)d_um;
        saturation[j].weight = (rdpi_real_t)(slope_above - slope);
        slope = slope_above;
        d_um += stroke_um * take_between(0.01, 0.5);
    }
    actuator_derive_inverse(saturation, params.offset_um, inverse, params.deadzones);
    params.digest = rdpi_f32_digest(&params);

    rdpi_status_t status = rdpi_f32_init(&self, &params, (rdpi_real_t)sample_time_s);
    if (status != RDPI_OK) {
        fprintf(stderr, "%d: %s\n", status, rdpi_status_text(status));
    }
    CHECK(status == RDPI_OK);
    double reach_um = 2 * (fabs(gain * (offset_V - min_V)) + stroke_um);
    if (size % 2 == 0) {
        call_everything(&self, params.offset_um - reach_um, params.offset_um + reach_um);
    } else {
        valid_chain(&params, (rdpi_real_t)sample_time_s, params.offset_um - reach_um, params.offset_um + reach_um);
    }
    return 0;
}
