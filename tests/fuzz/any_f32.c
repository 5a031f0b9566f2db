/* Whatever the parameters are, rdpi_f32_init refuses them or everything that it accepts keeps its promises. */
#include "f32_chain.h"

static void *take_array(size_t count, size_t size)
{
    void *array = malloc(count * size + 1); /* of exactly this size, so that a read beyond it is seen */
    take(array, count * size);
    return array;
}

/* Bits of the first byte: left out, fields are taken from the input although they follow from others. */
enum { DIGEST = 1, V_PER_UM = 2, INTERCEPTS = 4, INVERSE = 8, SCHEMA = 16, NO_PLAY = 32, NO_MEMORY = 64, LARGE = 128 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    rdpi_f32_t self;
    rdpi_f32_params_t params;
    input = data;
    input_left = size;

    uint8_t how = take_u8();
    params.schema = how & SCHEMA ? take_u32() : RDPI_PARAMS_SCHEMA;
    params.plays = how & LARGE ? take_u16() : take_u8() % (RDPI_MAX_PLAYS + 2);
    params.deadzones = how & LARGE ? take_u8() : take_u8() % (RDPI_MAX_DEADZONES + 2);
    params.dac_bits = how & LARGE ? take_u8() : take_u8() % (RDPI_MAX_DAC_BITS + 2);
    uint8_t curve_byte = take_u8(); /* and whether noise is shaped: 0, 1, or what no value of it is */
    params.curve_pieces = how & LARGE ? curve_byte : curve_byte % (RDPI_MAX_CURVE_PIECES + 2);
    params.noise_shaping = how & LARGE ? curve_byte : curve_byte / (RDPI_MAX_CURVE_PIECES + 2) % 3;
    params.sweep_cycles = take_u16();
    params.offset_um = take_any();
    params.rate_window_s = take_any();
    params.rate_filter_s = take_any();
    params.max_um_per_s = take_any();
    params.min_slope_ratio = take_any();
    params.min_V = take_any();
    params.max_V = take_any();
    params.slew_V_per_s = take_any();
    params.sweep_V_per_s = take_any();
    params.sweep_end_V = take_any();
    params.sweep_forgotten = take_any();
    rdpi_real_t sample_time_s = take_any();

    bool counts_fit = params.plays >= 1 && params.plays <= RDPI_MAX_PLAYS && params.deadzones >= 1 &&
                      params.deadzones <= RDPI_MAX_DEADZONES && params.curve_pieces >= 1 &&
                      params.curve_pieces <= RDPI_MAX_CURVE_PIECES;
    size_t plays = counts_fit ? params.plays : 0, deadzones = counts_fit ? params.deadzones : 0;
    size_t pieces = counts_fit ? params.curve_pieces : 0;
    rdpi_f32_play_t *play = take_array(plays, sizeof *play);
    rdpi_f32_deadzone_t *saturation = take_array(deadzones, sizeof *saturation);
    rdpi_f32_piece_t *inverse = malloc(deadzones * sizeof *inverse + 1);
    rdpi_real_t *memory_um = take_array(plays, sizeof *memory_um);
    if (plays > 0 && !(how & INTERCEPTS)) {
        actuator_derive_intercepts(play, plays);
    }
    if (how & INVERSE) {
        take(inverse, deadzones * sizeof *inverse);
    } else if (deadzones > 0) {
        actuator_derive_inverse(saturation, params.offset_um, inverse, deadzones);
    }
    rdpi_f32_line_t *curve = take_array(pieces, sizeof *curve);
    if (pieces > 0) {
        actuator_derive_curve(&params, curve);
        for (size_t k = 0; k < pieces && how & V_PER_UM; k++) {
            curve[k].V_per_um = take_any();
        }
    }
    params.play = how & NO_PLAY ? NULL : play;
    params.saturation = saturation;
    params.inverse_saturation = inverse;
    params.curve = curve;
    params.memory_um = how & NO_MEMORY ? NULL : memory_um;
    bool complete = params.play && params.memory_um && counts_fit;
    params.digest = how & DIGEST || !complete ? take_u32() : rdpi_f32_digest(&params);

    rdpi_status_t status = rdpi_f32_init(&self, &params, sample_time_s);
    CHECK(rdpi_status_text(status) != NULL);
    if (status == RDPI_OK) {
        count_accepted();
        CHECK(complete && params.schema == RDPI_PARAMS_SCHEMA);
        double stroke_um = fabs((double)curve[0].gain_um_per_V * (params.max_V - params.min_V));
        double low_um = fmax(params.offset_um - stroke_um, -1e30), high_um = fmin(params.offset_um + stroke_um, 1e30);
        if (size % 2 == 0) {
            call_everything(&self, low_um, high_um);
        } else {
            any_chain(&params, sample_time_s, low_um, high_um);
        }
    }
    free(play);
    free(saturation);
    free(inverse);
    free(curve);
    free(memory_um);
    return 0;
}
