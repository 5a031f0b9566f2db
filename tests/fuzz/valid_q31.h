/* Parameters of the fixed-point library that are valid by construction. */
#ifndef VALID_Q31_H
#define VALID_Q31_H

#include "q31.h"

typedef struct {
    params_t params;
    rdpi_q31_play_t play[RDPI_MAX_PLAYS];
    rdpi_q31_deadzone_t saturation[RDPI_MAX_DEADZONES], inverse[RDPI_MAX_DEADZONES];
    rdpi_q31_line_t curve[RDPI_MAX_CURVE_PIECES];
    int32_t memory[RDPI_MAX_PLAYS];
    uint32_t sample_time_ns;
} valid_q31_t;

/* A whole number from `low` to `high`; small ones are as likely as large ones. */
static int64_t take_whole(int64_t low, int64_t high)
{
    uint64_t span = (uint64_t)high - (uint64_t)low;
    uint8_t how = take_u8();
    uint64_t value = ((uint64_t)take_u32() << 32 | take_u32()) >> how % 64;
    value = span == UINT64_MAX ? value : value % (span + 1);
    return (int64_t)(how < 128 ? (uint64_t)low + value : (uint64_t)high - value);
}

static int64_t least(int64_t a, int64_t b)
{
    return a < b ? a : b;
}

static int64_t most(int64_t a, int64_t b)
{
    return a > b ? a : b;
}

/* Slopes of the pieces are positive, magnitudes of the weights add up to 2^31 at most. */
static void take_stage(rdpi_q31_deadzone_t *term, size_t count)
{
    int64_t largest = least(((int64_t)1 << 31) / (int64_t)count, INT32_MAX), d = 0, slope = 0;
    for (size_t j = 0; j < count; j++) {
        int64_t above = take_whole(1, largest);
        term[j].d = (int32_t)d;
        term[j].weight = (int32_t)(above - slope);
        slope = above;
        d += take_whole(1, INT32_MAX / RDPI_MAX_DEADZONES);
    }
}

/* Up to RDPI_MAX_CURVE_PIECES pieces of slopes 1/8 to 1 between x and drive. */
static void take_curve(valid_q31_t *self)
{
    params_t *params = &self->params;
    int64_t x = params->min_drive, end = (int64_t)params->max_drive - params->min_drive;
    unsigned pieces = 1u + take_u8() % RDPI_MAX_CURVE_PIECES;
    if (pieces == 1 || end <= 1024) {
        return;
    }
    params->curve_pieces = (uint8_t)pieces;
    for (unsigned k = 0; k < pieces; k++) {
        int64_t from = end * k / pieces, to = end * (k + 1) / pieces;
        self->curve[k].from_drive = (int32_t)(params->min_drive + from);
        self->curve[k].from_x = (int32_t)x;
        x += take_whole((to - from) / 8, to - from);
    }
    params->max_x = (int32_t)x;
    derive_curve(params, self->curve);
}

static void take_valid(valid_q31_t *self)
{
    params_t *params = &self->params;
    int64_t window = take_whole(1, RDPI_MAX_WINDOW);
    self->sample_time_ns = (uint32_t)take_whole(1, UINT32_MAX / window);
    int64_t min_drive = take_whole(-RDPI_Q31_MAX_DRIVE, RDPI_Q31_MAX_DRIVE - 1);
    int64_t max_drive = take_whole(min_drive + 1, RDPI_Q31_MAX_DRIVE);
    uint64_t sweep_per_us = (uint64_t)take_whole(1000, INT64_MAX);
    uint64_t guard_mantissa = (uint64_t)take_whole((int64_t)1 << 31, UINT32_MAX);
    int guard_bits; /* of the distance at the guard, per window */
    (void)frexp((double)(guard_mantissa * (uint64_t)window * self->sample_time_ns >> 11), &guard_bits);
    guard_bits += 11;
    *params = (params_t){
        .schema = RDPI_PARAMS_SCHEMA,
        .plays = (uint16_t)(1 + take_u8() % RDPI_MAX_PLAYS),
        .deadzones = (uint8_t)(1 + take_u8() % RDPI_MAX_DEADZONES),
        .dac_bits = take_u8() % RDPI_MAX_DAC_BITS,
        .sweep_cycles = (uint16_t)(1 + take_u16() % 50),
        .sweep_per_us = sweep_per_us,
        .slew_per_us = take_u8() % 2 ? (uint64_t)take_whole((int64_t)sweep_per_us, INT64_MAX) : 0,
        .saturation_shift = take_u8() % 63,
        .inverse_shift = take_u8() % 63,
        .guard_exponent = (int16_t)(1 - guard_bits + take_u8() % 63),
        .guard_mantissa = (uint32_t)guard_mantissa,
        .min_slope_ratio = (uint16_t)take_whole(1, UINT16_MAX),
        .rate_window_ns = (uint32_t)(window * self->sample_time_ns),
        .rate_filter_ns = take_u8() % 2 ? (uint32_t)take_whole(0, UINT32_MAX) : 0,
        .min_drive = (int32_t)min_drive,
        .max_drive = (int32_t)max_drive,
        .sweep_end = (int32_t)take_whole(min_drive, max_drive),
        .sweep_forgotten = RDPI_Q31_ONE / 4,
        .play = self->play,
        .saturation = self->saturation,
        .inverse_saturation = self->inverse,
        .curve_pieces = 1,
        .min_x = (int32_t)min_drive,
        .max_x = (int32_t)max_drive,
        .curve = self->curve,
        .memory = self->memory,
    };
    params->dac_bits += params->dac_bits > 0; /* not 1: a step of 2^30 has no format */
    uint8_t how = take_u8();
    params->noise_shaping = how / 2 % 4 == 0;
    derive_codes(params, how % 2);
    take_curve(self);
    int64_t r = 0, y = take_whole(params->min_x, params->max_x);
    for (size_t i = 0; i < params->plays; i++) {
        int64_t gap = i > 0 ? take_whole(1, RDPI_Q31_MAX_DRIVE / RDPI_MAX_PLAYS) : 0;
        int64_t slope = take_whole(RDPI_Q31_MIN_SLOPE, RDPI_Q31_ONE);
        int64_t lowest = (params->min_slope_ratio * slope + 65535) / 65536;
        r += gap;
        y = most(least(y + take_whole(-gap, gap), RDPI_Q31_MAX_DRIVE), -RDPI_Q31_MAX_DRIVE);
        self->memory[i] = (int32_t)y;
        self->play[i].r = (int32_t)r;
        self->play[i].slope = (int32_t)slope;
        self->play[i].slope_rate = (int32_t)(take_whole(most(lowest, RDPI_Q31_MIN_SLOPE), RDPI_Q31_ONE) - slope);
    }
    take_stage(self->saturation, params->deadzones);
    take_stage(self->inverse, params->deadzones);
    params->digest = rdpi_q31_digest(params);
}

#endif
