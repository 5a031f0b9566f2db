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
    }
    if (!(how & CODES) && params.dac_bits <= RDPI_MAX_DAC_BITS && params.min_drive < params.max_drive) {
        derive_codes(&params, !(how & FALLING));
    }
    bool counts_fit = params.plays >= 1 && params.plays <= RDPI_MAX_PLAYS && params.deadzones >= 1 &&
                      params.deadzones <= RDPI_MAX_DEADZONES;
    size_t plays = counts_fit ? params.plays : 0, deadzones = counts_fit ? params.deadzones : 0;
    rdpi_q31_play_t *play = take_array(plays, sizeof *play);
    rdpi_q31_deadzone_t *saturation = take_array(deadzones, sizeof *saturation);
    rdpi_q31_deadzone_t *inverse = take_array(deadzones, sizeof *inverse);
    int32_t *memory = take_array(plays, sizeof *memory);
    params.play = how & NO_PLAY ? NULL : play;
    params.saturation = saturation;
    params.inverse_saturation = inverse;
    params.memory = how & NO_MEMORY ? NULL : memory;
    bool complete = params.play && params.memory && counts_fit;
    if (!(how & DIGEST) && complete) {
        params.digest = rdpi_q31_digest(&params);
    }

    rdpi_status_t status = rdpi_q31_init(&self, &params, sample_time_ns);
    CHECK(rdpi_status_text(status) != NULL);
    if (status == RDPI_OK) {
        CHECK(complete && params.schema == RDPI_PARAMS_SCHEMA);
        call_everything(&self, -0x1p30, 0x1p30);
    }
    free(play);
    free(saturation);
    free(inverse);
    free(memory);
    return 0;
}
