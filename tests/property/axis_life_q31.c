/* Property test: the life of an axis in fixed point. tests/support/axis_walk.h says what must hold.
 *
 *     axis_life_q31 [STEPS]    1000000 by default */
#include <string.h>

#include "actuator_q31.h"
#include "random_bits.h"
#include "rdpi/q31_axis.h"

static rdpi_q31_axis_t axis;

static int choose(int count)
{
    return random_between(0, count - 1);
}

#define AXIS(name) rdpi_q31_axis_##name
#define CHAIN(name) rdpi_q31_chain_##name
static double drive_now(void);
static double h_now(void);
static double pole_now(size_t i);
static void next_axis(void);
static rdpi_q31_chain_t *next_spare(void);
static void sample(void);
static double follow(void);
static double stop(void);
static double fault(void);
static double replay(void);
#include "axis_walk.h"

/* Two sets of parameters: an exchange takes the other one. */
static actuator_q31_t actuator[2];
static rdpi_q31_pole_t pole[2][POLES];
static rdpi_q31_chain_params_t params[2];
static rdpi_q31_chain_t spare;
static int which;
static int32_t reference;
static uint32_t sample_time_ns;

static double drive_now(void)
{
    return axis.drive;
}

/* Of the operator, whose drive is not what is output where there is a lag. */
static double h_now(void)
{
    const rdpi_q31_t *operator = &axis.chain.axis;
    int32_t at = params[which].lag_ns > 0u ? axis.chain.unlag.followed : operator->drive;
    return rdpi_q31_predict(operator, at, operator->rate);
}

static double pole_now(size_t i)
{
    return ldexp((double)axis.chain.creep.lag[i].state, -32);
}

static double per_sample(uint64_t per_us)
{
    return ldexp((double)per_us, -32) * sample_time_ns / 1000;
}

static void set_limits(void)
{
    const rdpi_q31_params_t *operator = &actuator[which].params;
    double code = operator->dac_bits > 0 ? ldexp(fabs((double)operator->drive_per_code), -operator->drive_shift) : 0;
    now.low = operator->min_drive;
    now.high = operator->max_drive;
    now.code = code * (operator->noise_shaping ? 3.01 : 1.01);
    now.slew = per_sample(operator->slew_per_us);
    now.sweep = per_sample(operator->sweep_per_us);
    now.rounding = 4 + 0.51 * code;
    now.poles = params[which].poles;
    now.h_rounding = 4096 + 16 * now.code;
    for (size_t i = 0; i < now.poles; i++) {
        now.keep[i] = exp(-(double)sample_time_ns / (double)pole[which][i].time_constant_ns);
    }
}

static void random_chain(int of)
{
    int32_t T = (int32_t)sample_time_ns;
    rdpi_q31_chain_params_t *chain = &params[of];
    memset(chain, 0, sizeof *chain);
    chain->schema = RDPI_PARAMS_SCHEMA;
    chain->axis = &actuator[of].params;
    chain->pole = pole[of];
    chain->preview = (uint16_t)choose(2);
    chain->delay_ns = choose(2) ? (uint32_t)random_between(0, 20 * T) : 0u;
    chain->lag_ns = choose(2) ? (uint32_t)random_between(1, 20 * T) : 0u;
    chain->lead_ns = choose(3) ? 0u : (uint32_t)random_between(0, 10 * T);
    chain->max_lead = random_between(1 << 20, 1 << 28);
    chain->poles = (uint16_t)choose(POLES + 1);
    chain->direct = chain->poles > 0u ? RDPI_Q31_ONE / 8 * 7 : RDPI_Q31_ONE;
    for (int i = 0; i < chain->poles; i++) {
        pole[of][i].share = random_between(0, RDPI_Q31_ONE / 16);
        pole[of][i].time_constant_ns = (uint64_t)T * (uint64_t)random_between(1, 1000) / 2u;
    }
    chain->digest = rdpi_q31_chain_digest(chain);
}

static void random_curve(rdpi_q31_params_t *operator, rdpi_q31_line_t *curve)
{
    operator->curve_pieces = (uint8_t)(RDPI_MAX_CURVE_PIECES > 1 && choose(2) ? 3 : 1);
    operator->min_x = operator->min_drive;
    operator->max_x = operator->max_drive;
    for (int k = 0; operator->curve_pieces > 1 && k < 3; k++) {
        int32_t third = (operator->max_drive - operator->min_drive) / 3;
        curve[k].from_drive = operator->min_drive + k * third;
        curve[k].from_x = operator->min_drive + k * third + (k == 1 ? third / 8 : 0);
    }
}

static void random_operator(int of)
{
    actuator_q31_t *self = &actuator[of];
    rdpi_q31_params_t *operator = &self->params;
    memset(self, 0, sizeof *self);
    operator->plays = (uint16_t)random_between(1, RDPI_MAX_PLAYS);
    operator->deadzones = 1;
    operator->min_drive = random_between(-(1 << 29), -(1 << 27));
    operator->max_drive = random_between(1 << 27, 1 << 29);
    operator->saturation_shift = operator->inverse_shift = 30;
    self->saturation[0].weight = RDPI_Q31_ONE;
    self->inverse_saturation[0].weight = RDPI_Q31_ONE;
    for (int i = 0; i < operator->plays; i++) {
        rdpi_q31_play_t *play = &self->play[i];
        play->r = i * ((1 << 27) / RDPI_MAX_PLAYS);
        play->slope = random_between(1 << 29, 1 << 30);
        play->slope_rate = random_between(1 << 29, 1 << 30) - play->slope;
    }
    operator->min_slope_ratio = 1;
    operator->guard_mantissa = random_bits() | (uint32_t)1 << 31;
    operator->guard_exponent = -20;
    operator->rate_window_ns = choose(2) ? (uint32_t)choose(RDPI_MAX_WINDOW) * sample_time_ns : 0u;
    operator->rate_filter_ns = choose(2) ? (uint32_t)choose(20) * sample_time_ns : 0u;
    operator->sweep_cycles = 2;
    operator->sweep_end = random_between(operator->min_drive, operator->max_drive);
    operator->sweep_forgotten = choose(2) ? 0 : random_between(0, RDPI_Q31_ONE);
    operator->sweep_per_us = ((uint64_t)random_between(1 << 23, 1 << 25) << 32) / sample_time_ns * 1000u;
    operator->slew_per_us = choose(2) ? 0u : operator->sweep_per_us * (uint64_t)random_between(1, 5);
    operator->noise_shaping = (uint8_t)(RDPI_NOISE_SHAPING && choose(4) == 0);
    operator->min_mV = -1000;
    operator->max_mV = 9000;
    operator->unit_mantissa = (uint32_t)1 << 31 | random_bits() >> 1;
    operator->unit_exponent = -55;
    operator->drive_of_code_0 = operator->min_drive;
    if (choose(3)) {
        actuator_q31_codes(self, (unsigned)random_between(8, 18), choose(2));
    } else {
        operator->noise_shaping = 0;
    }
    random_curve(operator, self->curve);
    actuator_q31_derive(self);
}

static void next_axis(void)
{
    which = 0;
    sample_time_ns = (uint32_t)random_between(5000, 500000);
    random_operator(0);
    random_chain(0);
    memset(&axis, 0, sizeof axis);
    reference = 0;
    const rdpi_q31_params_t *operator = params[0].axis;
    int32_t safe = random_between(operator->min_drive, operator->max_drive);
    rdpi_status_t status = rdpi_q31_axis_init(&axis, &params[0], sample_time_ns, safe);
    require(status == RDPI_OK, rdpi_status_text(status));
    set_limits();
}

/* Thresholds and slopes some percent off, other units, and another chain. */
static rdpi_q31_chain_t *next_spare(void)
{
    int other = 1 - which;
    rdpi_q31_params_t *operator = &actuator[other].params;
    actuator[other] = actuator[which];
    for (int i = 0; i < operator->plays; i++) {
        rdpi_q31_play_t *play = &actuator[other].play[i];
        play->r -= play->r / random_between(30, 40);
        play->slope -= play->slope / random_between(50, 100);
        play->slope_rate = random_between(1 << 29, 1 << 30) - play->slope;
    }
    operator->unit_mantissa = (uint32_t)1 << 31 | random_bits() >> 1;
    actuator_q31_derive(&actuator[other]);
    random_chain(other);
    which = other;
    rdpi_status_t status = rdpi_q31_chain_init(&spare, &params[other], sample_time_ns);
    require(status == RDPI_OK, rdpi_status_text(status));
    set_limits();
    return &spare;
}

/* Ramps, rests, jumps; sometimes none. */
static void sample(void)
{
    static int32_t way;
    if (choose(30) == 0) {
        way = choose(3) ? random_between(-(1 << 22), 1 << 22) : 0;
    }
    reference = choose(200) ? reference + way : random_between(-(1 << 28), 1 << 28);
    reference = reference > 1 << 29 ? 1 << 29 : (reference < -(1 << 29) ? -(1 << 29) : reference);
    (void)rdpi_q31_axis_step(&axis, choose(200) ? reference : RDPI_Q31_NO_REFERENCE);
}

static double follow(void)
{
    double asked = drive_now() + (now.high - now.low) / 100 * random_between(-100, 100) / 100;
    asked = fmax(now.low, fmin(now.high, asked));
    (void)rdpi_q31_axis_follow(&axis, (int32_t)asked);
    return asked;
}

static double stop(void)
{
    int32_t drive = random_between((int32_t)now.low, (int32_t)now.high);
    double step = choose(2) ? 0 : now.sweep * random_between(1, 100) / 10;
    if (rdpi_q31_axis_stop(&axis, drive, (uint64_t)ldexp(step * 1000 / sample_time_ns, 32)) == RDPI_OK) {
        step = step > 0 ? step : now.sweep;
        stop_step = now.slew > 0 ? fmin(step, now.slew) : step;
    }
    return drive;
}

static double fault(void)
{
    int32_t drive = random_between((int32_t)now.low, (int32_t)now.high);
    (void)rdpi_q31_axis_fault(&axis, drive);
    return drive;
}

static double replay(void)
{
    const rdpi_q31_params_t *operator = params[which].axis;
    uint32_t code = (uint32_t)random_between(0, (1 << operator->dac_bits) - 1);
    (void)rdpi_q31_axis_replayed(&axis, code);
    return operator->drive_of_code_0 + code * ldexp(operator->drive_per_code, -operator->drive_shift);
}

int main(int argc, char **argv)
{
    walk(argc > 1 ? strtol(argv[1], NULL, 10) : 1000000);
    return 0;
}
