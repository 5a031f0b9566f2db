/* Random actuators, random references and the actuator by definition, for the property tests. */
#ifndef RDPI_TEST_SCENARIO_H
#define RDPI_TEST_SCENARIO_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "actuator.h"

/* ---- random numbers: xorshift64*, the same on every machine ---- */

static uint64_t random_state = 20031027;

static inline double uniform(double low, double high)
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return low + (high - low) * (double)((random_state * 2685821657736338717u) >> 11) / 9007199254740992.0;
}

static inline double log_uniform(double low, double high)
{
    return exp(uniform(log(low), log(high)));
}

static inline int choose(int count)
{
    return (int)uniform(0, count);
}

/* ---- the model by definition: eq. 1, 7, 8, 9 and 16 of Ang et al., IROS 2003, in long double ---- */

typedef struct {
    const rdpi_f32_params_t *params;
    long double y[RDPI_MAX_PLAYS];
} plant_t;

static inline void plant_move(plant_t *plant, long double x)
{
    for (size_t i = 0; i < plant->params->plays; i++) {
        long double r = plant->params->play[i].r_um;
        plant->y[i] = fmaxl(x - r, fminl(x + r, plant->y[i]));
    }
}

static inline long double plant_x(const plant_t *plant, rdpi_real_t drive_V)
{
    const rdpi_f32_line_t *line = plant->params->curve, *last = &line[plant->params->curve_pieces - 1];
    while (line != last && drive_V > line->to_V) {
        line++;
    }
    return (long double)line->gain_um_per_V * ((long double)drive_V - line->offset_V);
}

/* z of the states as they are, at a rate */
static inline long double plant_z(const plant_t *plant, long double rate_um_per_s)
{
    const rdpi_f32_params_t *params = plant->params;
    long double v = 0, z = 0, slope_before = 0;
    for (size_t i = 0; i < params->plays; i++) {
        long double slope = params->play[i].slope + (long double)params->play[i].slope_rate_s_per_um * rate_um_per_s;
        v += (slope - slope_before) * plant->y[i];
        slope_before = slope;
    }
    for (size_t j = 0; j < params->deadzones; j++) {
        const rdpi_f32_deadzone_t *term = &params->saturation[j];
        z += term->weight * (j == 0 ? v : fmaxl(v - term->d_um, 0));
    }
    return z;
}

/* ---- a random actuator ---- */

typedef enum { CONSTANT, MILD, STRONG, LAWS } law_t;

typedef struct {
    law_t law;
    double stroke_um, sample_time_s;
    actuator_t actuator;
} scenario_t;

static inline double ascend(int i, int count, double below, double end)
{
    return i == 0 ? 0 : below + uniform(0.2, 1.8) * end / count;
}

/* Some history, with drives around rest, in place of rest. */
static inline void random_memory(actuator_t *actuator)
{
    plant_t past = {&actuator->params, {0}};
    for (int k = 0; k < 6; k++) {
        double drive_V = (double)actuator->params.sweep_end_V + uniform(-10, 10);
        plant_move(&past, plant_x(&past, (rdpi_real_t)drive_V));
    }
    for (size_t i = 0; i < actuator->params.plays; i++) {
        actuator->memory_um[i] = (rdpi_real_t)past.y[i];
    }
}

/* In half of the cases bends the input curve, at several drives between these two. x = 0 at rest_V. */
static inline void random_curve(actuator_t *actuator, double rest_V, double from_V, double to_V)
{
    double low_V = fmax(from_V, (double)actuator->params.min_V), high_V = fmin(to_V, (double)actuator->params.max_V);
    int pieces = RDPI_MAX_CURVE_PIECES == 1 || choose(2) ? 1 : 2 + choose(RDPI_MAX_CURVE_PIECES - 1);
    rdpi_f32_line_t *curve = actuator->curve;
    double gain_um_per_V = (double)curve[0].gain_um_per_V, x_um = 0;
    actuator->params.curve_pieces = (uint8_t)pieces;
    for (int i = 1; i < pieces; i++) {
        curve[i].gain_um_per_V = (rdpi_real_t)(gain_um_per_V * log_uniform(0.5, 2));
        curve[i - 1].to_V = (rdpi_real_t)(low_V + (high_V - low_V) * (i + uniform(-0.3, 0.3)) / pieces);
        double bend = (double)(curve[i].gain_um_per_V - curve[i - 1].gain_um_per_V);
        x_um += bend * fmax(rest_V - (double)curve[i - 1].to_V, 0);
    }
    curve[0].offset_V = (rdpi_real_t)(rest_V + x_um / gain_um_per_V);
}

/* One random draw per statement: C leaves the order within an expression open. */
static inline void random_scenario(scenario_t *self, law_t law)
{
    actuator_t *actuator = &self->actuator;
    rdpi_f32_params_t *params = &actuator->params;
    int plays = 1 + choose(RDPI_MAX_PLAYS), deadzones = 1 + choose(RDPI_MAX_DEADZONES);
    double stroke_um = 12.5 * log_uniform(0.1, 10), max_um_per_s = stroke_um * log_uniform(10, 1000);
    double gain_um_per_V = stroke_um / uniform(50, 150), offset_V = uniform(-50, 50), offset_um = uniform(-1, 1);
    double sample_time_s = log_uniform(1e-5, 1e-3), slope_before = 0, below_um = 0;
    double window = choose(2) ? 0 : uniform(0, RDPI_MAX_WINDOW), filter = choose(2) ? 0 : log_uniform(0.1, 100);

    memset(self, 0, sizeof *self);
    self->law = law;
    self->stroke_um = stroke_um;
    self->sample_time_s = (double)(rdpi_real_t)sample_time_s;
    double last_threshold_um = stroke_um * uniform(0.2, 0.6);
    for (int i = 0; i < plays; i++) {
        rdpi_f32_play_t *play = &actuator->play[i];
        below_um = ascend(i, plays, below_um, last_threshold_um);
        double kept = law == MILD ? uniform(0.8, 1.2) : uniform(0.21, 1); /* of the slope, at the guard */
        play->r_um = (rdpi_real_t)below_um;
        play->slope = (rdpi_real_t)log_uniform(0.2, 2);
        double change = law == CONSTANT ? 0 : (double)play->slope * (kept - 1);
        play->slope_rate_s_per_um = (rdpi_real_t)(change / max_um_per_s);
    }
    double last_deadzone_um = stroke_um * uniform(0.1, 0.6);
    for (int j = 0; j < deadzones; j++) {
        double slope = log_uniform(0.4, 1.6);
        below_um = ascend(j, deadzones, below_um, last_deadzone_um);
        actuator->saturation[j] = (rdpi_f32_deadzone_t){(rdpi_real_t)below_um, (rdpi_real_t)(slope - slope_before)};
        slope_before = slope;
    }
    *params = (rdpi_f32_params_t){
        .plays = (uint16_t)plays,
        .deadzones = (uint8_t)deadzones,
        .sweep_cycles = 10,
        .offset_um = (rdpi_real_t)(stroke_um * offset_um),
        .rate_window_s = (rdpi_real_t)(sample_time_s * window),
        .rate_filter_s = (rdpi_real_t)(sample_time_s * filter),
        .max_um_per_s = (rdpi_real_t)max_um_per_s,
        .min_slope_ratio = (rdpi_real_t)0.2,
        .min_V = -100000,
        .max_V = 100000,
        .sweep_V_per_s = (rdpi_real_t)(0.5 / sample_time_s),
        .sweep_end_V = (rdpi_real_t)offset_V,
    };
    actuator->curve[0].gain_um_per_V = (rdpi_real_t)(choose(2) ? gain_um_per_V : -gain_um_per_V);
    if (choose(3) == 0) { /* a range that clips */
        params->min_V = (rdpi_real_t)(offset_V - uniform(10, 80));
        params->max_V = (rdpi_real_t)(offset_V + uniform(10, 80));
        params->dac_bits = (uint8_t)(choose(4) ? 0 : 8 + choose(9));
    }
    if (choose(4) == 0) {
        params->slew_V_per_s = (rdpi_real_t)(log_uniform(0.5, 50) / sample_time_s);
    }
    random_curve(actuator, offset_V, offset_V - 60, offset_V + 60);
    actuator_derive(actuator);
    if (choose(2)) {
        random_memory(actuator);
        actuator_seal(actuator);
    }
}

/* ---- random references: pieces of 1 to 100 samples, each of one kind ---- */

typedef struct {
    double stroke_um, now_um; /* now_um within half a stroke of 0 */
    double centre_um, amplitude_um, step_um, omega, phase;
    int kind, left, until_turn;
} profile_t;

enum { HOLD, JUMPS, SINE, ZIGZAG, MINOR_LOOPS, KINDS };

static inline double profile_next(profile_t *self)
{
    double half_um = self->stroke_um / 2;
    if (self->left-- == 0) {
        self->kind = choose(KINDS);
        self->left = choose(100);
        self->until_turn = 0;
        self->step_um = self->stroke_um * log_uniform(1e-4, 0.1);
        self->amplitude_um = self->kind == MINOR_LOOPS ? self->stroke_um * log_uniform(1e-3, 0.1) : half_um;
        self->amplitude_um *= uniform(0.2, 1);
        self->centre_um = (half_um - self->amplitude_um) * uniform(-1, 1);
        self->omega = log_uniform(1e-3, 1);
        self->phase = uniform(0, 6);
    }
    switch (self->kind) {
    case JUMPS:
        if (choose(5) == 0) {
            self->now_um = half_um * uniform(-1, 1);
        }
        break;
    case ZIGZAG: /* a reversal every few samples */
        if (self->until_turn-- == 0) {
            self->until_turn = choose(6);
            self->step_um *= -uniform(0.7, 1.4);
        }
        self->now_um = fmax(-half_um, fmin(half_um, self->now_um + self->step_um));
        break;
    case SINE:
    case MINOR_LOOPS:
        self->phase += self->omega;
        self->now_um = self->centre_um + self->amplitude_um * sin(self->phase);
        break;
    default: /* HOLD */
        break;
    }
    return self->now_um;
}

#endif
