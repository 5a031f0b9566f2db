/* What rdpi_q31_init and rdpi_q31_set_memory refuse, and the checksum of the parameters. The statuses are described at
 * rdpi_status_t. The window is checked by rdpi_q31_rate_init. */
#ifndef RDPI_Q31_CHECK_H
#define RDPI_Q31_CHECK_H

#include "crc.h"
#include "q31_drive.h"

#define MAX_SWEEP_CYCLES 10000u

/* 1: any positive sample time is accepted. See "Build settings" in lib/README.md. */
#ifndef RDPI_ANY_SAMPLE_TIME
#define RDPI_ANY_SAMPLE_TIME 0
#endif

/* The part of the struct that holds nothing but numbers of 32 bits. */
#define NUMBERS_BEGIN offsetof(rdpi_q31_params_t, guard_mantissa)
#define NUMBERS_END (offsetof(rdpi_q31_params_t, max_sample_time_ns) + sizeof(uint32_t))

/* What must hold before any other check may read. */
static rdpi_status_t rdpi_q31_check_pointers(uint64_t layout, const rdpi_q31_t *self, const rdpi_q31_params_t *params)
{
    if (layout != RDPI_Q31_LAYOUT) {
        return RDPI_ERR_SIZE;
    }
    if (self == NULL || params == NULL) {
        return RDPI_ERR_NULL;
    }
    if (params->schema != RDPI_PARAMS_SCHEMA) {
        return RDPI_ERR_SCHEMA;
    }
    if (params->plays < 1u || params->plays > RDPI_MAX_PLAYS || params->deadzones < 1u ||
        params->deadzones > RDPI_MAX_DEADZONES) {
        return RDPI_ERR_COUNT;
    }
    if (params->curve_pieces < 1u || params->curve_pieces > RDPI_MAX_CURVE_PIECES) {
        return RDPI_ERR_CURVE;
    }
    if (params->play == NULL || params->saturation == NULL || params->inverse_saturation == NULL ||
        (params->curve == NULL && rdpi_q31_pieces(params) > 1u) || params->memory == NULL) {
        return RDPI_ERR_NULL;
    }
    return RDPI_OK;
}

static rdpi_status_t rdpi_q31_check_plays(const rdpi_q31_params_t *params)
{
    int32_t below = -1; /* the threshold before, which is below r_0 = 0 here */
    if (params->play[0].r != 0) {
        return RDPI_ERR_THRESHOLDS;
    }
    for (size_t i = 0; i < params->plays; i++) {
        const rdpi_q31_play_t *play = &params->play[i];
        int64_t fastest = (int64_t)play->slope + play->slope_rate;
        if (play->r <= below || play->r > RDPI_Q31_MAX_DRIVE) {
            return RDPI_ERR_THRESHOLDS;
        }
        if (play->slope < RDPI_Q31_MIN_SLOPE || play->slope > RDPI_Q31_ONE) {
            return RDPI_ERR_SLOPES;
        }
        if (fastest < RDPI_Q31_MIN_SLOPE || fastest > RDPI_Q31_ONE ||
            fastest * 65536 < (int64_t)params->min_slope_ratio * play->slope) {
            return RDPI_ERR_GUARD;
        }
        below = play->r;
    }
    return RDPI_OK;
}

/* One stage: S or its inverse. */
static rdpi_status_t rdpi_q31_check_saturation(const rdpi_q31_deadzone_t *term, size_t count, unsigned shift)
{
    int64_t slope = 0, size = 0;
    int32_t below = -1;
    if (term[0].d != 0) {
        return RDPI_ERR_DEADZONES;
    }
    for (size_t j = 0; j < count; j++) {
        if (term[j].d <= below) {
            return RDPI_ERR_DEADZONES;
        }
        slope += term[j].weight;
        size += term[j].weight < 0 ? -(int64_t)term[j].weight : term[j].weight;
        if (slope <= 0 || size > (int64_t)1 << 31 || shift > 62u) {
            return RDPI_ERR_SATURATION;
        }
        below = term[j].d;
    }
    return RDPI_OK;
}

/* Whether codes go from one end of the range to the other. The last drive may be 2 units off, because drive_per_code
 * has 31 bits only. */
static bool rdpi_q31_codes_fit(const rdpi_q31_params_t *params)
{
    if (params->code_shift - 1u > 61u || params->drive_shift - 1u > 61u) {
        return false;
    }
    bool rising = params->drive_of_code_0 == params->min_drive;
    int64_t beyond = rdpi_q31_drive_of_code(params, rdpi_q31_last_code(params)) - rdpi_q31_drive_of_last_code(params);
    return rising == (params->codes_per_drive > 0) && beyond >= -2 && beyond <= 2 &&
           rdpi_q31_code_of_drive(params, rdpi_q31_drive_of_last_code(params)) == rdpi_q31_last_code(params);
}

static rdpi_status_t rdpi_q31_check_drive(const rdpi_q31_params_t *params)
{
    if (params->min_drive >= params->max_drive || !rdpi_q31_in_format(params->min_drive) ||
        !rdpi_q31_in_format(params->max_drive) ||
        (params->drive_of_code_0 != params->min_drive && params->drive_of_code_0 != params->max_drive) ||
        params->dac_bits > RDPI_MAX_DAC_BITS || params->noise_shaping > RDPI_NOISE_SHAPING) {
        return RDPI_ERR_DRIVE;
    }
    if (params->dac_bits > 0u && !rdpi_q31_codes_fit(params)) {
        return RDPI_ERR_DRIVE;
    }
    if (params->sweep_cycles - 1u >= MAX_SWEEP_CYCLES || params->sweep_end < params->min_drive ||
        params->sweep_end > params->max_drive ||
        (params->slew_per_us > 0u && params->slew_per_us < params->sweep_per_us)) {
        return RDPI_ERR_SWEEP;
    }
    return RDPI_OK;
}

/* Whether the parameters are not made for this sample time. */
static bool rdpi_q31_out_of_time(const rdpi_q31_params_t *params, uint32_t sample_time_ns)
{
    return !RDPI_ANY_SAMPLE_TIME && (sample_time_ns < params->min_sample_time_ns ||
                                     (params->max_sample_time_ns > 0u && sample_time_ns > params->max_sample_time_ns));
}

/* Whether two numbers are the same but for rounding. */
static bool rdpi_q31_meet(int32_t a, int32_t b)
{
    return a - b <= 2 && b - a <= 2;
}

/* Whether the pieces of the input curve follow each other from one end of the range to the other, rise, and leave no
 * gap. The drives and their x are checked before they are subtracted. */
static rdpi_status_t rdpi_q31_check_curve(const rdpi_q31_params_t *params)
{
    const rdpi_q31_line_t *line = params->curve;
    if (!rdpi_q31_in_format(params->min_x) || !rdpi_q31_in_format(params->max_x) || params->min_x >= params->max_x) {
        return RDPI_ERR_CURVE;
    }
    if (rdpi_q31_pieces(params) == 1u) {
        return params->min_x == params->min_drive && params->max_x == params->max_drive ? RDPI_OK : RDPI_ERR_CURVE;
    }
    if (line->from_drive != params->min_drive || line->from_x != params->min_x) {
        return RDPI_ERR_CURVE;
    }
    for (unsigned left = rdpi_q31_pieces(params); left > 0u; left--) {
        int32_t to_drive = left > 1u ? line[1].from_drive : params->max_drive;
        int32_t to_x = left > 1u ? line[1].from_x : params->max_x;
        if (to_drive <= line->from_drive || to_drive > params->max_drive || to_x <= line->from_x ||
            to_x > params->max_x || line->x_per_drive < 1 || line->drive_per_x < 1 || line->x_shift - 1u > 61u ||
            line->drive_shift - 1u > 61u || !rdpi_q31_meet(rdpi_q31_line_x(line, to_drive), to_x) ||
            !rdpi_q31_meet(rdpi_q31_line_drive(line, to_x), to_drive)) {
            return RDPI_ERR_CURVE;
        }
        line++;
    }
    return RDPI_OK;
}

/* Whether one history can lead to these states, with a drive inside the range. */
static rdpi_status_t rdpi_q31_check_memory(const rdpi_q31_params_t *params, const int32_t *y)
{
    for (size_t i = 0; i < params->plays; i++) {
        int64_t lag = i > 0u ? (int64_t)y[i] - y[i - 1u] : 0;
        int32_t gap = i > 0u ? params->play[i].r - params->play[i - 1u].r : 0;
        if (lag > gap || lag < -gap || !rdpi_q31_in_format(y[i])) {
            return RDPI_ERR_MEMORY;
        }
    }
    return y[0] < params->min_x || y[0] > params->max_x ? RDPI_ERR_MEMORY : RDPI_OK;
}

/* rdpi_q31_digest, whatever the layout of the caller. */
static uint32_t rdpi_q31_checksum(const rdpi_q31_params_t *params)
{
    size_t deadzones = params->deadzones * sizeof *params->saturation;
    uint32_t crc = rdpi_crc32_wide(rdpi_crc32_wide(0, params->slew_per_us), params->sweep_per_us);
    crc = rdpi_crc32(crc, params->plays | (uint32_t)params->deadzones << 16 | (uint32_t)params->dac_bits << 24);
    crc = rdpi_crc32(crc, params->curve_pieces | (uint32_t)params->noise_shaping << 8 |
                              (uint32_t)params->sweep_cycles << 16);
    crc = rdpi_crc32(crc, params->saturation_shift | (uint32_t)params->inverse_shift << 8 |
                              (uint32_t)params->code_shift << 16 | (uint32_t)params->drive_shift << 24);
    crc = rdpi_crc32(crc, (uint16_t)params->guard_exponent | (uint32_t)params->min_slope_ratio << 16);
    crc = rdpi_crc32_block(crc, (const unsigned char *)params + NUMBERS_BEGIN, NUMBERS_END - NUMBERS_BEGIN);
    crc = rdpi_crc32_block(crc, params->play, params->plays * sizeof *params->play);
    crc = rdpi_crc32_block(crc, params->saturation, deadzones);
    crc = rdpi_crc32_block(crc, params->inverse_saturation, deadzones);
    if (rdpi_q31_pieces(params) > 1u) {
        crc = rdpi_crc32_block(crc, params->curve, rdpi_q31_pieces(params) * sizeof *params->curve);
    }
    return rdpi_crc32_block(crc, params->memory, params->plays * sizeof *params->memory);
}

/* All that needs valid pointers and counts. */
static rdpi_status_t rdpi_q31_check_params(const rdpi_q31_params_t *params)
{
    if (params->digest != rdpi_q31_checksum(params)) {
        return RDPI_ERR_DIGEST;
    }
    if (params->guard_mantissa < (uint32_t)1 << 31) {
        return RDPI_ERR_RATE;
    }
    if (params->min_slope_ratio < 1u) {
        return RDPI_ERR_GUARD;
    }
    rdpi_status_t status = rdpi_q31_check_plays(params);
    if (status == RDPI_OK) {
        status = rdpi_q31_check_saturation(params->saturation, params->deadzones, params->saturation_shift);
    }
    if (status == RDPI_OK) {
        status = rdpi_q31_check_saturation(params->inverse_saturation, params->deadzones, params->inverse_shift);
    }
    if (status == RDPI_OK) {
        status = rdpi_q31_check_drive(params);
    }
    if (status == RDPI_OK) {
        status = rdpi_q31_check_curve(params);
    }
    return status == RDPI_OK ? rdpi_q31_check_memory(params, params->memory) : status;
}

#endif
