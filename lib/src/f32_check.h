/* What rdpi_f32_init and rdpi_f32_set_memory refuse, and the checksum of the parameters. The statuses are described at
 * rdpi_status_t. */
#ifndef RDPI_F32_CHECK_H
#define RDPI_F32_CHECK_H

#include <string.h>

#include "crc.h"
#include "f32_drive.h"
#include "f32_math.h"
#include "f32_play.h"
#include "f32_rate.h"

/* The smallest slope. The step divides by slopes. */
#define MIN_SLOPE ((rdpi_real_t)1e-7)

/* The narrowest output range, V. */
#define MIN_SPAN_V ((rdpi_real_t)1e-9)

#define MAX_SWEEP_CYCLES 10000u

/* 1: any positive sample time is accepted. See "Build settings" in lib/README.md. */
#ifndef RDPI_ANY_SAMPLE_TIME
#define RDPI_ANY_SAMPLE_TIME 0
#endif

/* The part of the struct that holds nothing but numbers, from offset_um on. */
#define NUMBERS_SIZE (offsetof(rdpi_f32_params_t, V_per_code) + sizeof(rdpi_real_t) - offsetof(rdpi_f32_params_t, offset_um))

/* Of a piece of the input curve, the part without the numbers that make codes. */
#define LINE_NUMBERS_SIZE offsetof(rdpi_f32_line_t, codes_per_um)

/* The largest magnitude of the numbers that make codes: codes may be many and close together. */
#define MAX_CODE_NUMBER ((rdpi_real_t)1e15)

/* What must hold before any other check may read. */
static RDPI_F32_SHARED rdpi_status_t rdpi_f32_check_pointers(uint64_t layout, const rdpi_f32_t *self,
                                                             const rdpi_f32_params_t *params)
{
    if (layout != RDPI_F32_LAYOUT) {
        return RDPI_ERR_SIZE;
    }
    if (self == NULL || params == NULL) {
        return RDPI_ERR_NULL;
    }
    if (params->schema != RDPI_PARAMS_SCHEMA) {
        return RDPI_ERR_SCHEMA;
    }
    if (params->plays < 1 || params->plays > RDPI_MAX_PLAYS || params->deadzones < 1 ||
        params->deadzones > RDPI_MAX_DEADZONES) {
        return RDPI_ERR_COUNT;
    }
    if (params->curve_pieces < 1 || params->curve_pieces > RDPI_MAX_CURVE_PIECES) {
        return RDPI_ERR_CURVE;
    }
    if (params->play == NULL || params->saturation == NULL || params->inverse_saturation == NULL ||
        params->curve == NULL || params->memory_um == NULL) {
        return RDPI_ERR_NULL;
    }
    return RDPI_OK;
}

static rdpi_status_t rdpi_f32_check_plays(const rdpi_f32_params_t *params)
{
    rdpi_real_t below_um = -1; /* the threshold before, which is below r_0 = 0 here */
    if (params->play[0].r_um != 0) {
        return RDPI_ERR_THRESHOLDS;
    }
    for (size_t i = 0; i < params->plays; i++) {
        const rdpi_f32_play_t *play = &params->play[i];
        if (play->r_um <= below_um) {
            return RDPI_ERR_THRESHOLDS;
        }
        if (play->slope < MIN_SLOPE) {
            return RDPI_ERR_SLOPES;
        }
        /* W_i is linear in the rate, so that both ends of its range decide. */
        rdpi_real_t fastest = rdpi_f32_slope(play, params->max_um_per_s);
        if (fastest < MIN_SLOPE || fastest < params->min_slope_ratio * (1 - ROUNDING) * play->slope) {
            return RDPI_ERR_GUARD;
        }
        below_um = play->r_um;
    }
    return RDPI_OK;
}

static rdpi_status_t rdpi_f32_check_saturation(const rdpi_f32_params_t *params)
{
    rdpi_real_t slope = 0, below_um = -1;
    if (params->saturation[0].d_um != 0) {
        return RDPI_ERR_DEADZONES;
    }
    for (size_t j = 0; j < params->deadzones; j++) {
        const rdpi_f32_deadzone_t *term = &params->saturation[j];
        if (term->d_um <= below_um) {
            return RDPI_ERR_DEADZONES;
        }
        slope += term->weight;
        if (slope <= 0) {
            return RDPI_ERR_SATURATION;
        }
        below_um = term->d_um;
    }
    return RDPI_OK;
}

/* Whether the pieces of the input curve follow each other from min_V to max_V and from code 0 to the last, all rise or
 * all fall, and leave no gap in x. */
static rdpi_status_t rdpi_f32_check_curve(const rdpi_f32_params_t *params)
{
    const rdpi_f32_line_t *before = NULL;
    rdpi_real_t from_V = params->min_V, from_code = 0;
    for (size_t i = 0; i < rdpi_f32_pieces(params); i++) {
        const rdpi_f32_line_t *line = &params->curve[i];
        bool no_code = params->dac_bits > 0 && line->to_code <= from_code;
        if (line->to_V <= from_V || line->from_code != from_code || no_code) {
            return RDPI_ERR_CURVE;
        }
        if (before != NULL) {
            rdpi_real_t x_um = rdpi_f32_x_of_drive(line, from_V);
            rdpi_real_t slack_V = params->max_V - params->min_V + fabs(from_V) / 16;
            rdpi_real_t gains = fabs(line->gain_um_per_V) + fabs(before->gain_um_per_V);
            rdpi_real_t slack_um = ROUNDING * (fabs(x_um) + gains * slack_V);
            if (line->gain_um_per_V * before->gain_um_per_V <= 0 ||
                fabs(x_um - rdpi_f32_x_of_drive(before, from_V)) > slack_um) {
                return RDPI_ERR_CURVE;
            }
        }
        before = line;
        from_V = line->to_V;
        from_code = line->to_code;
    }
    return from_V == params->max_V && from_code == params->last_code ? RDPI_OK : RDPI_ERR_CURVE;
}

static rdpi_status_t rdpi_f32_check_drive(const rdpi_f32_params_t *params, rdpi_real_t sample_time_s)
{
    if (params->noise_shaping > RDPI_NOISE_SHAPING || params->max_V - params->min_V < MIN_SPAN_V ||
        params->slew_V_per_s < 0 || params->dac_bits > RDPI_MAX_DAC_BITS) {
        return RDPI_ERR_DRIVE;
    }
    /* The change per sample must survive rounding anywhere in the range, or the sweep would never arrive. */
    rdpi_real_t largest_V = fabs(params->min_V) + fabs(params->max_V);
    rdpi_real_t moved_V = largest_V + params->sweep_V_per_s * sample_time_s / 16;
    if (params->sweep_cycles - 1u >= MAX_SWEEP_CYCLES || params->sweep_end_V < params->min_V ||
        params->sweep_end_V > params->max_V || moved_V <= largest_V ||
        (params->slew_V_per_s > 0 && params->slew_V_per_s < params->sweep_V_per_s)) {
        return RDPI_ERR_SWEEP;
    }
    return RDPI_OK;
}

/* Whether the parameters are not made for this sample time, which is one. */
static bool rdpi_f32_out_of_time(const rdpi_f32_params_t *params, rdpi_real_t sample_time_s)
{
    return !RDPI_ANY_SAMPLE_TIME &&
           (sample_time_s < params->min_sample_time_s ||
            (params->max_sample_time_s > 0 && sample_time_s > params->max_sample_time_s));
}

/* Whether one history can lead to these states, with a drive inside the range. NaN fails the comparisons, and so does
 * infinity beside a finite state. */
static rdpi_status_t rdpi_f32_check_memory(const rdpi_f32_params_t *params, const rdpi_real_t *y_um)
{
    rdpi_real_t drive_V = rdpi_f32_drive_of_x(rdpi_f32_line_of_x(params, y_um[0]), y_um[0]);
    rdpi_real_t slack_V = ROUNDING * (params->max_V - params->min_V);
    if (!(fabs(drive_V - rdpi_f32_clamp(drive_V, params->min_V, params->max_V)) <= slack_V)) {
        return RDPI_ERR_MEMORY;
    }
    const rdpi_f32_play_t *last = &params->play[params->plays - 1u];
    for (const rdpi_f32_play_t *play = params->play; play < last; play++) {
        rdpi_real_t gap_um = play[1].r_um - play->r_um;
        rdpi_real_t slack_um = ROUNDING * (last->r_um + fabs(*y_um));
        if (!(fabs(y_um[1] - *y_um) <= gap_um + slack_um)) {
            return RDPI_ERR_MEMORY;
        }
        y_um++;
    }
    return RDPI_OK;
}

/* One pass over the parameters. */
typedef struct {
    rdpi_real_t limit; /* the largest magnitude of a number */
    bool within;       /* whether no number is NaN or beyond its limit */
} rdpi_f32_scan_t;

/* Continues the digest over a block of memory that holds nothing but numbers. */
static RDPI_F32_SHARED uint32_t rdpi_f32_scan_block(uint32_t crc, const void *block, size_t bytes, rdpi_f32_scan_t *scan)
{
    for (size_t offset = 0; offset < bytes; offset += sizeof(rdpi_real_t)) {
        rdpi_real_t value;
        memcpy(&value, (const unsigned char *)block + offset, sizeof value);
        scan->within = scan->within && fabs(value) <= scan->limit;
        crc = rdpi_f32_crc32(crc, value);
    }
    return crc;
}

/* rdpi_f32_digest, whatever the layout of the caller. */
static uint32_t rdpi_f32_scan(rdpi_f32_scan_t *scan, const rdpi_f32_params_t *params)
{
    uint32_t crc = rdpi_crc32(0, params->plays | (uint32_t)params->deadzones << 16 | (uint32_t)params->dac_bits << 24);
    crc = rdpi_crc32(crc, params->curve_pieces | (uint32_t)params->noise_shaping << 8 |
                              (uint32_t)params->sweep_cycles << 16);
    scan->within = true;
    scan->limit = MAX_NUMBER;
    crc = rdpi_f32_scan_block(crc, &params->offset_um, NUMBERS_SIZE, scan);
    crc = rdpi_f32_scan_block(crc, params->play, params->plays * sizeof *params->play, scan);
    crc = rdpi_f32_scan_block(crc, params->saturation, params->deadzones * sizeof *params->saturation, scan);
    size_t pieces = params->deadzones * sizeof *params->inverse_saturation;
    crc = rdpi_f32_scan_block(crc, params->inverse_saturation, pieces, scan);
    for (size_t i = 0; i < rdpi_f32_pieces(params); i++) {
        const rdpi_f32_line_t *line = &params->curve[i];
        scan->limit = MAX_NUMBER;
        crc = rdpi_f32_scan_block(crc, line, LINE_NUMBERS_SIZE, scan);
        scan->limit = MAX_CODE_NUMBER;
        crc = rdpi_f32_scan_block(crc, &line->codes_per_um, sizeof *line - LINE_NUMBERS_SIZE, scan);
    }
    return rdpi_f32_scan_block(crc, params->memory_um, params->plays * sizeof *params->memory_um, scan);
}

/* All that needs valid pointers and counts. Also sets up the rate estimator of `self`, which checks the sample time:
 * rdpi_f32_check_drive relies on it. */
static rdpi_status_t rdpi_f32_check_params(rdpi_f32_t *self, const rdpi_f32_params_t *params, rdpi_real_t sample_time_s)
{
    rdpi_f32_scan_t scan;
    if (params->digest != rdpi_f32_scan(&scan, params)) {
        return RDPI_ERR_DIGEST;
    }
    if (!scan.within) {
        return RDPI_ERR_NOT_FINITE;
    }
    for (size_t i = 0; i < rdpi_f32_pieces(params); i++) {
        if (params->curve[i].gain_um_per_V == 0) {
            return RDPI_ERR_GAIN;
        }
    }
    if (!rdpi_f32_is_time(sample_time_s)) {
        return RDPI_ERR_SAMPLE_TIME;
    }
    if (rdpi_f32_out_of_time(params, sample_time_s)) { /* before all that follows from it */
        return RDPI_ERR_SAMPLE_RANGE;
    }
    if (params->max_um_per_s <= 0) {
        return RDPI_ERR_RATE;
    }
    if (params->min_slope_ratio <= 0 || params->min_slope_ratio >= 1) {
        return RDPI_ERR_GUARD;
    }
    rdpi_status_t status = rdpi_f32_check_plays(params);
    if (status == RDPI_OK) {
        status = rdpi_f32_check_saturation(params);
    }
    if (status == RDPI_OK) {
        status = rdpi_f32_rate_init(&self->rate_estimator, params->rate_window_s, params->rate_filter_s, sample_time_s);
    }
    if (status == RDPI_OK) {
        status = rdpi_f32_check_drive(params, sample_time_s);
    }
    if (RDPI_MAX_CURVE_PIECES > 1 && status == RDPI_OK) { /* a single piece is taken whatever its ends are */
        status = rdpi_f32_check_curve(params);
    }
    return status == RDPI_OK ? rdpi_f32_check_memory(params, params->memory_um) : status;
}

#endif
