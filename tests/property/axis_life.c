/* Property test: the life of an axis in floating point. tests/support/axis_walk.h says what must hold.
 *
 *     axis_life [STEPS]    1000000 by default */
#include "rdpi/f32_axis.h"
#include "scenario.h"

static rdpi_f32_axis_t axis;

#define AXIS(name) rdpi_f32_axis_##name
#define CHAIN(name) rdpi_f32_chain_##name
static double drive_now(void);
static double h_now(void);
static double pole_now(size_t i);
static void next_axis(void);
static rdpi_f32_chain_t *next_spare(void);
static void sample(void);
static double follow(void);
static double stop(void);
static double fault(void);
static double replay(void);
#include "axis_walk.h"

/* Two sets of parameters: an exchange takes the other one. */
static scenario_t scenario[2];
static rdpi_f32_pole_t pole[2][POLES];
static rdpi_f32_chain_params_t params[2];
static rdpi_f32_chain_t spare;
static int which;
static profile_t profile;

static double drive_now(void)
{
    return (double)axis.drive_V;
}

/* Of the operator, whose drive is not what is output where there is a lag; less h_0. */
static double h_now(void)
{
    const rdpi_f32_t *operator = &axis.chain.axis;
    rdpi_real_t at_V = params[which].lag_s > 0 ? axis.chain.unlag.followed_V : operator->drive_V;
    return (double)(rdpi_f32_predict(operator, at_V, operator->rate_um_per_s) - axis.chain.creep.settled_um);
}

static double pole_now(size_t i)
{
    return (double)(axis.chain.creep.lag[i].state_um + axis.chain.creep.lag[i].rest_um);
}

static void set_limits(void)
{
    const rdpi_f32_params_t *operator = &scenario[which].actuator.params;
    double T = scenario[which].sample_time_s, most = fabs((double)operator->min_V) + fabs((double)operator->max_V);
    now.low = (double)operator->min_V;
    now.high = (double)operator->max_V;
    now.code = operator->dac_bits > 0 ? (double)operator->V_per_code * (operator->noise_shaping ? 3.01 : 1.01) : 0;
    now.slew = (double)operator->slew_V_per_s * T;
    now.sweep = (double)operator->sweep_V_per_s * T;
    now.rounding = 4e-6 * (1 + most) + (operator->dac_bits > 0 ? 0.51 * (double)operator->V_per_code : 0);
    now.poles = params[which].poles;
    now.moves_later = true;
    double code_um = 0, span_um = 0;
    for (int i = 0; i < operator->curve_pieces; i++) {
        code_um = fmax(code_um, fabs((double)operator->curve[i].gain_um_per_V) * now.code);
        span_um = fmax(span_um, fabs((double)operator->curve[i].gain_um_per_V) * (most + 1));
    }
    now.h_rounding = 4 * code_um * 3.2 + 1e-4 * span_um * 3.2; /* slopes of S and plays are at most 1.6 and 2 */
    for (size_t i = 0; i < now.poles; i++) {
        now.keep[i] = exp(-T / (double)pole[which][i].time_constant_s);
    }
}

static void random_chain(int of)
{
    double T = scenario[of].sample_time_s;
    rdpi_f32_chain_params_t *chain = &params[of];
    *chain = (rdpi_f32_chain_params_t){
        .schema = RDPI_PARAMS_SCHEMA,
        .poles = (uint16_t)choose(POLES + 1),
        .preview = (uint16_t)choose(2),
        .delay_s = (rdpi_real_t)(choose(2) ? T * uniform(0, 20) : 0),
        .lag_s = (rdpi_real_t)(choose(2) ? T * log_uniform(0.1, 30) : 0),
        .lead_s = (rdpi_real_t)(choose(3) ? 0 : T * uniform(0, 10)),
        .lead_s2 = (rdpi_real_t)(choose(3) ? 0 : T * T * log_uniform(0.01, 30)),
        .max_lead_um = (rdpi_real_t)(scenario[of].stroke_um * log_uniform(0.01, 1)),
        .direct = 1,
        .axis = &scenario[of].actuator.params,
        .pole = pole[of],
    };
    for (int i = 0; i < chain->poles; i++) {
        pole[of][i] = (rdpi_f32_pole_t){(rdpi_real_t)uniform(0, 0.05), (rdpi_real_t)(T * log_uniform(0.5, 500))};
    }
    chain->direct = (rdpi_real_t)(chain->poles > 0 ? 0.9 : 1);
    chain->digest = rdpi_f32_chain_digest(chain);
}

static void random_operator(int of)
{
    random_scenario(&scenario[of], (law_t)choose(LAWS));
    rdpi_f32_params_t *operator = &scenario[of].actuator.params;
    double rest_V = (double)operator->sweep_end_V, span_V;
    operator->min_V = (rdpi_real_t)(rest_V - uniform(10, 80));
    operator->max_V = (rdpi_real_t)(rest_V + uniform(10, 80));
    span_V = (double)(operator->max_V - operator->min_V);
    operator->curve_pieces = 1;
    operator->dac_bits = (uint8_t)(choose(3) ? 10 + choose(8) : 0);
    operator->noise_shaping = (uint8_t)(RDPI_NOISE_SHAPING && choose(4) == 0);
    operator->sweep_cycles = 2;
    operator->sweep_V_per_s = (rdpi_real_t)(span_V / (uniform(20, 100) * scenario[of].sample_time_s));
    operator->slew_V_per_s = choose(2) ? 0 : operator->sweep_V_per_s * (rdpi_real_t)uniform(1, 5);
    operator->sweep_forgotten = (rdpi_real_t)(choose(2) ? 0 : uniform(0, 1));
    scenario[of].actuator.curve[0].offset_V = operator->sweep_end_V;
    random_curve(&scenario[of].actuator, rest_V, (double)operator->min_V + 0.1 * span_V,
                 (double)operator->max_V - 0.1 * span_V);
    for (size_t i = 0; i < RDPI_MAX_PLAYS; i++) {
        scenario[of].actuator.memory_um[i] = 0;
    }
    actuator_derive(&scenario[of].actuator);
}

static void next_axis(void)
{
    rdpi_status_t status;
    which = 0;
    random_operator(0);
    random_chain(0);
    memset(&axis, 0, sizeof axis);
    profile = (profile_t){.stroke_um = scenario[0].stroke_um};
    const rdpi_f32_params_t *operator = params[0].axis;
    rdpi_real_t safe_V = (rdpi_real_t)uniform((double)operator->min_V, (double)operator->max_V);
    status = rdpi_f32_axis_init(&axis, &params[0], (rdpi_real_t)scenario[0].sample_time_s, safe_V);
    require(status == RDPI_OK, rdpi_status_text(status));
    set_limits();
}

/* Thresholds, slopes and gain some percent off, and another chain. */
static rdpi_f32_chain_t *next_spare(void)
{
    int other = 1 - which;
    actuator_t *actuator = &scenario[other].actuator;
    scenario[other] = scenario[which];
    double stretch = uniform(0.97, 1.03);
    for (size_t i = 0; i < actuator->params.plays; i++) {
        actuator->play[i].r_um *= (rdpi_real_t)stretch;
        actuator->play[i].slope *= (rdpi_real_t)uniform(0.99, 1.01);
    }
    for (int i = 0; i < actuator->params.curve_pieces; i++) {
        actuator->curve[i].gain_um_per_V *= (rdpi_real_t)stretch;
    }
    actuator->params.min_slope_ratio = (rdpi_real_t)0.1;
    actuator_derive(actuator);
    random_chain(other);
    which = other;
    rdpi_status_t status = rdpi_f32_chain_init(&spare, &params[other], (rdpi_real_t)scenario[other].sample_time_s);
    require(status == RDPI_OK, rdpi_status_text(status));
    set_limits();
    return &spare;
}

static void sample(void)
{
    rdpi_real_t reference_um = (rdpi_real_t)profile_next(&profile) + scenario[which].actuator.params.offset_um;
    (void)rdpi_f32_axis_step(&axis, choose(200) ? reference_um : (rdpi_real_t)NAN);
}

static double follow(void)
{
    double step_V = (now.high - now.low) * uniform(-0.01, 0.01);
    double asked_V = fmax(now.low, fmin(now.high, drive_now() + step_V));
    (void)rdpi_f32_axis_follow(&axis, (rdpi_real_t)asked_V);
    return asked_V;
}

static double stop(void)
{
    rdpi_real_t drive_V = (rdpi_real_t)uniform(now.low, now.high);
    double T = scenario[which].sample_time_s;
    double step_V = choose(2) ? 0 : now.sweep * log_uniform(0.1, 10);
    if (rdpi_f32_axis_stop(&axis, drive_V, (rdpi_real_t)(step_V / T)) == RDPI_OK) {
        step_V = step_V > 0 ? step_V : now.sweep;
        stop_step = now.slew > 0 ? fmin(step_V, now.slew) : step_V;
    }
    return (double)drive_V;
}

static double fault(void)
{
    rdpi_real_t drive_V = (rdpi_real_t)uniform(now.low, now.high);
    (void)rdpi_f32_axis_fault(&axis, drive_V);
    return (double)drive_V;
}

static double replay(void)
{
    const rdpi_f32_params_t *operator = params[which].axis;
    uint32_t code = (uint32_t)uniform(0, (double)operator->last_code);
    (void)rdpi_f32_axis_replayed(&axis, code);
    return (double)operator->min_V + code * (double)operator->V_per_code;
}

int main(int argc, char **argv)
{
    walk(argc > 1 ? strtol(argv[1], NULL, 10) : 1000000);
    return 0;
}
