/* Property test: the library with the quick way (RDPI_QUICK_STEP 1, linked) and without (0, compiled into this file)
 * gives the same codes, drives, rates, flags, counters and play states, bit for bit, whatever is done with it. First
 * operators alone, then chains around them.
 *
 *     one_code [MODELS [CHAINS [SEED]]] */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Where the library that is linked has no quick way either, as in one build of tests/mutation, none is seen. */
#if defined(RDPI_QUICK_STEP) && !RDPI_QUICK_STEP
#define QUICK_WAY false
#else
#define QUICK_WAY true
#endif

/* The long way, under names of its own. */
#undef RDPI_QUICK_STEP
#define RDPI_QUICK_STEP 0
#define rdpi_f32_digest_layout long_digest_layout
#define rdpi_f32_init_layout long_init_layout
#define rdpi_f32_reset long_reset
#define rdpi_f32_set_memory long_set_memory
#define rdpi_f32_get_memory long_get_memory
#define rdpi_f32_step long_step
#define rdpi_f32_missed long_missed
#define rdpi_f32_sweep long_sweep
#define rdpi_f32_forget_sweep long_forget_sweep
#define rdpi_f32_predict long_predict
#define rdpi_f32_forward long_forward
#define rdpi_f32_chain_digest_layout long_chain_digest_layout
#define rdpi_f32_chain_init_layout long_chain_init_layout
#define rdpi_f32_chain_reset long_chain_reset
#define rdpi_f32_chain_settle long_chain_settle
#define rdpi_f32_chain_swept long_chain_swept
#define rdpi_f32_chain_step long_chain_step
#define rdpi_f32_chain_missed long_chain_missed
#define rdpi_f32_chain_sweep long_chain_sweep
#define rdpi_f32_chain_forward long_chain_forward
#define rdpi_f32_chain_block long_chain_block
#include "rdpi_f32.c"
#undef DIGEST_BEGIN /* each of the two files has its own */
#undef DIGEST_END
#include "rdpi_f32_chain.c"
#undef rdpi_f32_digest_layout
#undef rdpi_f32_init_layout
#undef rdpi_f32_reset
#undef rdpi_f32_set_memory
#undef rdpi_f32_get_memory
#undef rdpi_f32_step
#undef rdpi_f32_missed
#undef rdpi_f32_sweep
#undef rdpi_f32_forget_sweep
#undef rdpi_f32_predict
#undef rdpi_f32_forward
#undef rdpi_f32_chain_digest_layout
#undef rdpi_f32_chain_init_layout
#undef rdpi_f32_chain_reset
#undef rdpi_f32_chain_settle
#undef rdpi_f32_chain_swept
#undef rdpi_f32_chain_step
#undef rdpi_f32_chain_missed
#undef rdpi_f32_chain_sweep
#undef rdpi_f32_chain_forward
#undef rdpi_f32_chain_block

/* As in rdpi/f32.h and rdpi/f32_chain.h. */
rdpi_status_t rdpi_f32_init_layout(uint64_t layout, rdpi_f32_t *self, const rdpi_f32_params_t *params,
                                   rdpi_real_t sample_time_s);
void rdpi_f32_reset(rdpi_f32_t *self);
rdpi_status_t rdpi_f32_set_memory(rdpi_f32_t *self, const rdpi_real_t *y_um);
void rdpi_f32_get_memory(const rdpi_f32_t *self, rdpi_real_t *y_um);
rdpi_real_t rdpi_f32_step(rdpi_f32_t *self, rdpi_real_t reference_um);
void rdpi_f32_missed(rdpi_f32_t *self, uint32_t ticks);
bool rdpi_f32_sweep(rdpi_f32_t *self);
void rdpi_f32_forget_sweep(rdpi_f32_t *self);
rdpi_real_t rdpi_f32_forward(rdpi_f32_t *self, rdpi_real_t drive_V, rdpi_real_t rate_um_per_s);
rdpi_status_t rdpi_f32_chain_init_layout(uint64_t layout, rdpi_f32_chain_t *self,
                                         const rdpi_f32_chain_params_t *params, rdpi_real_t sample_time_s);
void rdpi_f32_chain_reset(rdpi_f32_chain_t *self);
void rdpi_f32_chain_settle(rdpi_f32_chain_t *self);
void rdpi_f32_chain_swept(rdpi_f32_chain_t *self, uint32_t ticks);
rdpi_real_t rdpi_f32_chain_step(rdpi_f32_chain_t *self, rdpi_real_t ahead_um);
void rdpi_f32_chain_missed(rdpi_f32_chain_t *self, uint32_t ticks);
bool rdpi_f32_chain_sweep(rdpi_f32_chain_t *self);

#include "random_chain.h"

#if defined(__SANITIZE_ADDRESS__) /* ten times slower */
#define MODELS 200
#undef CHAINS
#define CHAINS 100
#else
#define MODELS 2000
#if !defined(CHAINS)
#define CHAINS 500
#endif
#endif
#define OPERATIONS 5000
#define CHAIN_OPERATIONS 2000
#define SEED 15u /* the first 200 models come upon drives that have just come back to an end of the range */

/* ---- both libraries ---- */

typedef enum { STEP, REFUSED, MISSED_SAMPLES, SWEEP, FORWARD, SET_MEMORY, RESET, OPERATION_KINDS } operation_t;
static const char *const names[] = {"step", "refused", "missed", "sweep", "forward", "set_memory", "reset"};

typedef struct {
    operation_t operation;
    rdpi_real_t value, rate; /* a reference, or a drive and its rate */
    uint32_t ticks;
    rdpi_real_t y_um[RDPI_MAX_PLAYS];
} call_t;

typedef struct {
    rdpi_status_t (*init)(uint64_t, rdpi_f32_t *, const rdpi_f32_params_t *, rdpi_real_t);
    void (*reset)(rdpi_f32_t *);
    rdpi_status_t (*set_memory)(rdpi_f32_t *, const rdpi_real_t *);
    void (*get_memory)(const rdpi_f32_t *, rdpi_real_t *);
    rdpi_real_t (*step)(rdpi_f32_t *, rdpi_real_t);
    void (*missed)(rdpi_f32_t *, uint32_t);
    bool (*sweep)(rdpi_f32_t *);
    void (*forget_sweep)(rdpi_f32_t *);
    rdpi_real_t (*forward)(rdpi_f32_t *, rdpi_real_t, rdpi_real_t);
    rdpi_status_t (*chain_init)(uint64_t, rdpi_f32_chain_t *, const rdpi_f32_chain_params_t *, rdpi_real_t);
    void (*chain_reset)(rdpi_f32_chain_t *);
    void (*chain_settle)(rdpi_f32_chain_t *);
    void (*chain_swept)(rdpi_f32_chain_t *, uint32_t);
    rdpi_real_t (*chain_step)(rdpi_f32_chain_t *, rdpi_real_t);
    void (*chain_missed)(rdpi_f32_chain_t *, uint32_t);
    bool (*chain_sweep)(rdpi_f32_chain_t *);
} library_t;

static const library_t with_quick_way = {
    rdpi_f32_init_layout, rdpi_f32_reset, rdpi_f32_set_memory, rdpi_f32_get_memory, rdpi_f32_step, rdpi_f32_missed,
    rdpi_f32_sweep, rdpi_f32_forget_sweep, rdpi_f32_forward, rdpi_f32_chain_init_layout, rdpi_f32_chain_reset,
    rdpi_f32_chain_settle, rdpi_f32_chain_swept, rdpi_f32_chain_step, rdpi_f32_chain_missed, rdpi_f32_chain_sweep};
static const library_t long_way = {
    long_init_layout, long_reset, long_set_memory, long_get_memory, long_step, long_missed,
    long_sweep, long_forget_sweep, long_forward, long_chain_init_layout, long_chain_reset,
    long_chain_settle, long_chain_swept, long_chain_step, long_chain_missed, long_chain_sweep};

/* The operator alone. Returns the result. */
static rdpi_real_t call_operator(const library_t *library, rdpi_f32_t *axis, const call_t *call)
{
    switch (call->operation) {
    case STEP:
    case REFUSED:
        return library->step(axis, call->value);
    case MISSED_SAMPLES:
        library->missed(axis, call->ticks);
        return 0;
    case SWEEP: {
        bool more = library->sweep(axis);
        if (!more) {
            library->forget_sweep(axis);
        }
        return more;
    }
    case FORWARD:
        return library->forward(axis, call->value, call->rate);
    case SET_MEMORY:
        return (rdpi_real_t)library->set_memory(axis, call->y_um);
    default: /* RESET */
        library->reset(axis);
        return 0;
    }
}

static rdpi_real_t call_chain(const library_t *library, rdpi_f32_chain_t *chain, const call_t *call)
{
    rdpi_real_t result = 0;
    switch (call->operation) {
    case STEP:
    case REFUSED:
        return library->chain_step(chain, call->value);
    case MISSED_SAMPLES:
        library->chain_missed(chain, call->ticks);
        break;
    case SWEEP:
        return library->chain_sweep(chain);
    case RESET:
        library->chain_reset(chain);
        break;
    case FORWARD: /* as an application that has swept, that many samples ago, or not */
        result = call_operator(library, &chain->axis, call);
        if (call->ticks > 0) {
            library->chain_swept(chain, call->ticks);
        } else {
            library->chain_settle(chain);
        }
        break;
    default: /* SET_MEMORY */
        result = call_operator(library, &chain->axis, call);
        library->chain_settle(chain);
        break;
    }
    return result;
}

/* Chains, or with `alone` only what is in their axis. */
typedef struct {
    bool alone;
    rdpi_f32_chain_t quick, slow;
} twins_t;

static unsigned long done[OPERATION_KINDS], quick_steps, rounded_steps, flagged, lagging_steps, shaped_steps;

static rdpi_real_t apply(const library_t *library, bool alone, rdpi_f32_chain_t *chain, const call_t *call)
{
    return alone ? call_operator(library, &chain->axis, call) : call_chain(library, chain, call);
}

/* ---- what differs ---- */

static bool same_bits(const void *a, const void *b, size_t size)
{
    return memcmp(a, b, size) == 0;
}

/* All that a user sees of them, y_um included. */
static const char *difference(const twins_t *twins, rdpi_real_t quick_result, rdpi_real_t slow_result)
{
    const rdpi_f32_t *quick = &twins->quick.axis, *slow = &twins->slow.axis;
    rdpi_real_t quick_um[RDPI_MAX_PLAYS] = {0}, slow_um[RDPI_MAX_PLAYS] = {0};
    rdpi_f32_get_memory(quick, quick_um);
    long_get_memory(slow, slow_um);
    for (size_t i = 0; i < RDPI_MAX_PLAYS; i++) {
        if (!(quick_um[i] == slow_um[i])) { /* either zero will do */
            return "play states";
        }
    }
    bool same_asked = twins->alone || twins->quick.unlag.asked_V == twins->slow.unlag.asked_V;
    return quick->dac_code != slow->dac_code                                      ? "codes"
           : quick->flags != slow->flags                                          ? "flags"
           : !same_bits(&quick->drive_V, &slow->drive_V, sizeof slow->drive_V)    ? "drives"
           : quick->rate_um_per_s != slow->rate_um_per_s                          ? "rates"
           : quick->guard_count != slow->guard_count                              ? "guard_count"
           : quick->clip_count != slow->clip_count                                ? "clip_count"
           : quick->input_count != slow->input_count                              ? "input_count"
           : quick->missed_count != slow->missed_count                            ? "missed_count"
           : !same_asked                                                          ? "drives ahead of the lag"
           : !same_bits(&quick_result, &slow_result, sizeof slow_result)          ? "results"
                                                                                  : NULL;
}

/* ---- a random model: scenario.h's, but mostly with codes and what the quick way takes ---- */

static void random_model(scenario_t *scenario, int number)
{
    random_scenario(scenario, (law_t)(number % LAWS));
    rdpi_f32_params_t *params = &scenario->actuator.params;
    double reach_V = uniform(0.2, 1.5) * scenario->stroke_um / fabs((double)scenario->actuator.curve[0].gain_um_per_V);
    if (choose(4)) {
        params->rate_window_s = params->rate_filter_s = 0;
    }
    if (choose(4)) {
        params->slew_V_per_s = 0;
    }
    if (choose(8)) {
        double shift_V = choose(8) ? uniform(-0.5, 0.5) * reach_V : uniform(-100, 100) * reach_V;
        double offset_V = (double)params->sweep_end_V + (choose(4) ? 0 : 1000 * uniform(-1, 1));
        params->dac_bits = (uint8_t)(1 + choose(RDPI_MAX_DAC_BITS));
        params->min_V = (rdpi_real_t)(offset_V - reach_V + shift_V);
        params->max_V = (rdpi_real_t)(offset_V + reach_V + shift_V);
        do {
            random_curve(&scenario->actuator, offset_V, (double)params->min_V, (double)params->max_V);
        } while (params->curve_pieces >= 1u << params->dac_bits);
        params->sweep_end_V = (rdpi_real_t)uniform((double)params->min_V, (double)params->max_V);
        params->sweep_forgotten = (rdpi_real_t)fmax(0, uniform(-1, 1));
        params->sweep_V_per_s = (rdpi_real_t)fmin(2e6, reach_V * log_uniform(1e-3, 0.3) / scenario->sample_time_s);
        params->slew_V_per_s = params->slew_V_per_s > 0 ? 4 * params->sweep_V_per_s : 0;
        params->sweep_cycles = (uint16_t)(1 + choose(4));
        params->noise_shaping = RDPI_NOISE_SHAPING && number % 8 == 5;
        rdpi_real_t rest_V = (rdpi_real_t)uniform((double)params->min_V, (double)params->max_V);
        actuator_derive(&scenario->actuator);
        rdpi_real_t rest_um = rdpi_f32_x_of_drive(rdpi_f32_line_of_drive(params, rest_V), rest_V);
        for (size_t i = 0; i < params->plays; i++) { /* one excursion from rest there */
            scenario->actuator.memory_um[i] = rest_um;
        }
    }
    actuator_derive(&scenario->actuator);
}

/* ---- random operations ---- */

/* Where rounding decides: the reference that leads to a code, half a code beside it, a corner of the plays or
 * of the input curve, or an end. */
static rdpi_real_t delicate_reference(const twins_t *twins)
{
    const rdpi_f32_t *axis = &twins->slow.axis;
    const rdpi_f32_params_t *params = axis->params;
    double drive_V = (double)axis->drive_V, code_V = (double)params->V_per_code;
    switch (choose(6)) {
    case 0:
        drive_V += (choose(9) - 4) * code_V / 2;
        break;
    case 1:
        drive_V += (choose(2001) - 1000) * code_V / 4;
        break;
    case 2:
        drive_V = choose(2) ? (double)params->min_V : (double)params->max_V;
        drive_V += (choose(5) - 2) * code_V / 2;
        break;
    case 4:
        drive_V = (double)params->curve[choose(params->curve_pieces)].to_V + (choose(7) - 3) * code_V / 2;
        break;
    case 3: {
        int i = choose(params->plays);
        rdpi_real_t y_um[RDPI_MAX_PLAYS];
        long_get_memory(axis, y_um);
        double corner_um = (double)y_um[i] + (choose(3) - 1) * (double)params->play[i].r_um;
        const rdpi_f32_line_t *line = rdpi_f32_line_of_x(params, (rdpi_real_t)corner_um);
        drive_V = (double)rdpi_f32_drive_of_x(line, (rdpi_real_t)corner_um) + (choose(3) - 1) * code_V / 2;
        break;
    }
    default:
        break;
    }
    rdpi_real_t rate = choose(2) ? 0 : axis->rate_um_per_s;
    return long_predict(axis, (rdpi_real_t)drive_V, rate);
}

static rdpi_real_t bad_reference(void)
{
    const rdpi_real_t bad_um[] = {(rdpi_real_t)NAN, (rdpi_real_t)INFINITY, (rdpi_real_t)-INFINITY,
                                  2 * (rdpi_real_t)RDPI_MAX_REFERENCE_UM, -2 * (rdpi_real_t)RDPI_MAX_REFERENCE_UM};
    return bad_um[choose(5)];
}

/* Of any size, most of them small. */
static unsigned few(void)
{
    return choose(10) ? 1u + (unsigned)choose(RDPI_MAX_MISSED + 3) : (unsigned)choose(1000);
}

typedef struct {
    profile_t profile;
    double grid_um; /* references are multiples of it; 0: anything */
    double last_um;
    int sweeps_left, delicate_left;
} user_t;

/* What the user does next. */
static call_t next_call(const twins_t *twins, user_t *user)
{
    const rdpi_f32_t *axis = &twins->slow.axis;
    const rdpi_f32_params_t *params = axis->params;
    call_t call = {.operation = STEP};
    if (user->sweeps_left > 0) {
        user->sweeps_left--;
        call.operation = SWEEP;
    } else if (choose(40) == 0) {
        call.operation = (operation_t)choose(OPERATION_KINDS);
        user->sweeps_left = call.operation == SWEEP ? choose(60) : 0;
    }
    switch (call.operation) {
    case STEP: {
        double reference_um = profile_next(&user->profile) + (double)params->offset_um;
        if (user->grid_um > 0) {
            reference_um = user->grid_um * floor(reference_um / user->grid_um);
        }
        if (user->delicate_left == 0 && choose(30) == 0) {
            user->delicate_left = choose(40);
        }
        if (user->delicate_left > 0) {
            user->delicate_left--;
            reference_um = choose(3) ? (double)delicate_reference(twins) : user->last_um;
        }
        user->last_um = reference_um;
        call.value = (rdpi_real_t)reference_um;
        break;
    }
    case REFUSED:
        call.value = bad_reference();
        break;
    case MISSED_SAMPLES:
        call.ticks = few();
        break;
    case FORWARD: {
        double span_V = (double)params->max_V - (double)params->min_V;
        double drive_V = choose(4) ? (double)axis->drive_V + uniform(-0.1, 0.1) * span_V
                                   : uniform((double)params->min_V - span_V, (double)params->max_V + span_V);
        call.value = (rdpi_real_t)drive_V;
        call.rate = (rdpi_real_t)(uniform(-0.1, 1.2) * (double)params->max_um_per_s);
        call.ticks = twins->alone || choose(2) ? 0 : few();
        break;
    }
    case SET_MEMORY:
        long_get_memory(axis, call.y_um);
        if (choose(2)) {
            memcpy(call.y_um, params->memory_um, params->plays * sizeof *call.y_um);
        }
        break;
    default: /* SWEEP, RESET */
        break;
    }
    return call;
}

static void init(const library_t *library, rdpi_f32_chain_t *self, const chain_t *chain, double T, int number)
{
    const rdpi_f32_params_t *axis = chain->params.axis;
    rdpi_status_t status = chain->params.schema == 0
                               ? library->init(RDPI_F32_LAYOUT, &self->axis, axis, (rdpi_real_t)T)
                               : library->chain_init(RDPI_F32_CHAIN_LAYOUT, self, &chain->params, (rdpi_real_t)T);
    if (status != RDPI_OK) {
        printf("one_code: model %d: init refuses: %d\n", number, (int)status);
        exit(1);
    }
}

/* An operator alone, or in a chain with all that it can have. */
static void run_model(int number, bool alone)
{
    static scenario_t scenario;
    static twins_t twins;
    static chain_t chain;
    random_model(&scenario, number);
    const rdpi_f32_params_t *params = &scenario.actuator.params;
    if (alone) {
        chain.params = (rdpi_f32_chain_params_t){.axis = params};
    } else {
        random_chain(&chain, &scenario);
    }
    twins.alone = alone;
    init(&long_way, &twins.slow, &chain, scenario.sample_time_s, number);
    init(&with_quick_way, &twins.quick, &chain, scenario.sample_time_s, number);
    user_t user = {.profile = {.stroke_um = scenario.stroke_um}};
    user.grid_um = choose(3) ? 0 : scenario.stroke_um * log_uniform(1e-6, 1e-2);
    for (int k = 0; k < (alone ? OPERATIONS : CHAIN_OPERATIONS); k++) {
        const rdpi_f32_t *quick = &twins.quick.axis, *slow = &twins.slow.axis;
        call_t call = next_call(&twins, &user);
        bool quick_way = quick->quick;
        rdpi_real_t quick_result = apply(&with_quick_way, alone, &twins.quick, &call);
        rdpi_real_t slow_result = apply(&long_way, alone, &twins.slow, &call);
        done[call.operation]++;
        if (call.operation == STEP) {
            quick_steps += quick_way;
            rounded_steps += params->dac_bits > 0;
            flagged += slow->flags != 0;
            lagging_steps += chain.params.lag_s > 0 && quick_way;
            shaped_steps += chain.params.lag_s > 0 && params->dac_bits > 0 && params->noise_shaping != 0u;
        }
        const char *what = difference(&twins, quick_result, slow_result);
        if (what != NULL) {
            printf("one_code: %s %d, operation %d, %s: other %s with the quick way than without\n"
                   "codes %lu %lu, flags %lu %lu, drives %.9g %.9g, rates %.9g %.9g, %d bits, %d plays, window %d, "
                   "%d poles, lag %.3g samples\n",
                   alone ? "model" : "chain", number, k, names[call.operation], what,
                   (unsigned long)quick->dac_code, (unsigned long)slow->dac_code, (unsigned long)quick->flags, (unsigned long)slow->flags,
                   (double)quick->drive_V, (double)slow->drive_V, (double)quick->rate_um_per_s,
                   (double)slow->rate_um_per_s, params->dac_bits, params->plays, slow->rate_estimator.window,
                   chain.params.poles, (double)chain.params.lag_s / scenario.sample_time_s);
            exit(1);
        }
    }
}

int main(int argc, char **argv)
{
    int models = argc > 1 ? atoi(argv[1]) : MODELS, chains = argc > 2 ? atoi(argv[2]) : CHAINS;
    random_state += argc > 3 ? (uint64_t)atoi(argv[3]) : SEED;
    unsigned long total = 0;
    for (int number = 0; number < models; number++) {
        run_model(number, true);
    }
    for (int number = 0; number < chains; number++) {
        run_model(number, false);
    }
    printf("%d models, %d chains", models, chains);
    for (int kind = 0; kind < OPERATION_KINDS; kind++) {
        printf(", %s %lu", names[kind], done[kind]);
        total += done[kind];
    }
    printf("\n%lu operations alike; of the steps %lu had codes, %lu could take the quick way, %lu of them ahead of a lag, "
           "%lu were flagged, %lu shaped noise behind a lag\n",
           total, rounded_steps, quick_steps, lagging_steps, flagged, shaped_steps);
    unsigned long chain_steps = (unsigned long)chains * CHAIN_OPERATIONS;
    if ((QUICK_WAY && (quick_steps < done[STEP] / 4 || lagging_steps < chain_steps / 10)) ||
        rounded_steps < done[STEP] / 2 || flagged < done[STEP] / 20 ||
        (RDPI_NOISE_SHAPING && shaped_steps < chain_steps / 40)) {
        printf("one_code: hardly a quick way, a code, a lag, noise shaping or a flag\n");
        return 1;
    }
    return 0;
}
