/* Whatever the parameters are, rdpi_q31_init refuses them or everything that it accepts keeps its promises. */
#include "q31.h"

static void *take_array(size_t count, size_t size)
{
    void *array = malloc(count * size + 1); /* of exactly this size, so that a read beyond it is seen */
    take(array, count * size);
    return array;
}

/* Bits of the first byte: left out, fields are taken from the input although they follow from others. */
enum { DIGEST = 1, CODES = 2, FALLING = 4, SCHEMA = 8, NO_PLAY = 16, NO_MEMORY = 32, LARGE = 64 };

/* Whether the pieces of the input curve follow each other, so that slopes can be derived. */
static bool in_order(const params_t *params, rdpi_q31_line_t *curve)
{
    curve[0].from_drive = params->min_drive;
    curve[0].from_x = params->min_x;
    for (size_t k = 0; k < params->curve_pieces; k++) {
        bool last = k + 1 == params->curve_pieces;
        double drives = (double)(last ? params->max_drive : curve[k + 1].from_drive) - curve[k].from_drive;
        double x = (double)(last ? params->max_x : curve[k + 1].from_x) - curve[k].from_x;
        if (!(drives > 0 && x > 0)) {
            return false;
        }
    }
    return true;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    axis_t self;
    params_t params;
    input = data;
    input_left = size;

    uint8_t how = take_u8();
    take(&params, offsetof(params_t, play)); /* as it lies in memory: padding too, which must not matter */
    uint32_t sample_time_ns = take_u32();
    if (!(how & SCHEMA)) {
        params.schema = RDPI_PARAMS_SCHEMA;
    }
    if (!(how & LARGE)) {
        params.plays %= RDPI_MAX_PLAYS + 2;
        params.deadzones %= RDPI_MAX_DEADZONES + 2;
        params.dac_bits %= RDPI_MAX_DAC_BITS + 2;
        params.noise_shaping %= 3; /* 2 is refused */
        params.curve_pieces = params.curve_pieces % 4 ? 1 : params.curve_pieces / 4 % (RDPI_MAX_CURVE_PIECES + 2);
    }
    if (params.curve_pieces == 1) {
        params.min_x = params.min_drive;
        params.max_x = params.max_drive;
    }
    if (!(how & CODES) && params.dac_bits <= RDPI_MAX_DAC_BITS && params.min_drive < params.max_drive) {
        derive_codes(&params, !(how & FALLING));
    }
    bool counts_fit = params.plays >= 1 && params.plays <= RDPI_MAX_PLAYS && params.deadzones >= 1 &&
                      params.deadzones <= RDPI_MAX_DEADZONES && params.curve_pieces >= 1 &&
                      params.curve_pieces <= RDPI_MAX_CURVE_PIECES;
    size_t plays = counts_fit ? params.plays : 0, deadzones = counts_fit ? params.deadzones : 0;
    rdpi_q31_play_t *play = take_array(plays, sizeof *play);
    rdpi_q31_deadzone_t *saturation = take_array(deadzones, sizeof *saturation);
    rdpi_q31_deadzone_t *inverse = take_array(deadzones, sizeof *inverse);
    rdpi_q31_line_t *curve = take_array(counts_fit ? params.curve_pieces : 0, sizeof *curve);
    if (counts_fit && params.curve_pieces > 1 && !(how & CODES) && in_order(&params, curve)) {
        derive_curve(&params, curve);
    }
    int32_t *memory = take_array(plays, sizeof *memory);
    params.play = how & NO_PLAY ? NULL : play;
    params.saturation = saturation;
    params.inverse_saturation = inverse;
    params.curve = curve;
    params.memory = how & NO_MEMORY ? NULL : memory;
    bool complete = params.play && params.memory && counts_fit;
    if (!(how & DIGEST) && complete) {
        params.digest = rdpi_q31_digest(&params);
    }

    rdpi_status_t status = rdpi_q31_init(&self, &params, sample_time_ns);
    CHECK(rdpi_status_text(status) != NULL);
    if (status == RDPI_OK) {
        count_accepted();
        CHECK(complete && params.schema == RDPI_PARAMS_SCHEMA);
        call_everything(&self, -0x1p30, 0x1p30);
    }
    free(play);
    free(saturation);
    free(inverse);
    free(curve);
    free(memory);
    return 0;
}
