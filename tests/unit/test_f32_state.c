/* rdpi_f32_chain: its state as a value, and whether it is sane. */
#include "unity.h"

#include "rdpi/f32_axis.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")
TEST_SOURCE_FILE("lib/src/rdpi_f32_chain.c")
TEST_SOURCE_FILE("lib/src/rdpi_f32_state.c")
TEST_SOURCE_FILE("lib/src/rdpi_f32_axis.c")

#include "life_f32.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What both siblings do. */
void test_a_state_that_was_set_goes_on_to_the_bit_in_every_way_and_at_every_moment(void);
void test_a_chain_that_gets_its_own_state_back_goes_on_to_the_bit(void);
void test_a_torn_state_is_refused_whatever_word_is_torn(void);
void test_a_state_in_which_no_chain_can_be_is_refused(void);
void test_a_forged_state_is_refused_or_steps_go_on_from_it(void);
void test_a_state_of_another_chain_is_refused(void);
void test_get_and_set_refuse_null(void);
void test_no_chain_and_one_that_init_has_not_accepted_is_not_sane(void);
void test_every_state_that_a_chain_reaches_is_sane(void);
void test_damage_of_each_field_is_found(void);
void test_pointers_that_do_not_lead_to_the_parameters_of_one_operator_are_found(void);
#include "chain_state.inc"

static const rdpi_f32_play_t given_elsewhere = {.slope = 1};

#define NOT_FINITE(field)                                                                                              \
    DAMAGE(field, NAN)                                                                                                 \
    DAMAGE(field, INFINITY)                                                                                            \
    DAMAGE(field, -INFINITY)
#define NOT_A_NUMBER(field)                                                                                            \
    NOT_FINITE(field)                                                                                                  \
    DAMAGE(field, (rdpi_real_t)1e30)                                                                                   \
    DAMAGE(field, (rdpi_real_t)-1e30)
#define NEGATIVE(field)                                                                                                \
    NOT_A_NUMBER(field)                                                                                                \
    DAMAGE(field, (rdpi_real_t)-0.001)

static void damage_each(void)
{
    NOT_A_NUMBER(axis.drive_V)
    DAMAGE(axis.drive_V, (rdpi_real_t)28.01)
    DAMAGE(axis.drive_V, (rdpi_real_t)-32.01)
    NEGATIVE(axis.rate_um_per_s)
    DAMAGE(axis.rate_um_per_s, 4097)
    NOT_A_NUMBER(axis.ramp_V)
#if RDPI_NOISE_SHAPING
    NOT_A_NUMBER(axis.carried_um)
#endif
    DAMAGE(axis.dac_code, 4096)
    DAMAGE(axis.sweep_turns, 6)
    NEGATIVE(axis.rate_estimator.filtered_um_per_s)
    NEGATIVE(axis.rate_estimator.per_window_s)
    DAMAGE(axis.rate_estimator.per_window_s, 0)
    NEGATIVE(axis.rate_estimator.keep)
    DAMAGE(axis.rate_estimator.keep, (rdpi_real_t)1.001)
    DAMAGE(axis.rate_estimator.window, 0)
    DAMAGE(axis.rate_estimator.window, RDPI_MAX_WINDOW + 1)
    DAMAGE(axis.rate_estimator.oldest, chain.axis.rate_estimator.window + 1)
    TEST_ASSERT_GREATER_THAN_UINT16(chain.axis.rate_estimator.oldest, chain.axis.rate_estimator.window);
    for (size_t k = 0; k < chain.axis.rate_estimator.window; k++) {
        NOT_A_NUMBER(axis.rate_estimator.z_um[k])
    }
    DAMAGE(axis.bank.engaged, 3)
    DAMAGE(axis.bank.last_engaged, NULL)
    DAMAGE(axis.bank.last_engaged, &given_elsewhere)
    NOT_A_NUMBER(axis.bank.remainder_um)
    NOT_A_NUMBER(axis.bank.remainder_rate_s)
    NOT_A_NUMBER(axis.bank.y_um[0])
    for (size_t i = chain.axis.bank.engaged + 1u; i < 3u; i++) {
        NOT_A_NUMBER(axis.bank.y_um[i])
    }
    NOT_A_NUMBER(lead.latest_um)
    NOT_A_NUMBER(lead.before_um)
    NOT_FINITE(lead.per_before)
    NOT_FINITE(lead.per_step)
    NEGATIVE(lead.max_um)
    NOT_A_NUMBER(creep.h_um)
    NEGATIVE(creep.per_direct)
    NOT_A_NUMBER(creep.settled_um)
    NOT_A_NUMBER(creep.slow_um)
    NOT_A_NUMBER(creep.next_um)
    NOT_A_NUMBER(creep.mean_um)
    NOT_A_NUMBER(creep.sum_um)
    NEGATIVE(creep.round)
    DAMAGE(creep.poles, 2)
    DAMAGE(creep.poles, 4)
    DAMAGE(creep.fast, 4)
    DAMAGE(creep.turn, 0)
    DAMAGE(creep.turn, 3)
    DAMAGE(creep.per_turn, 17)
    DAMAGE(creep.wait, chain.creep.per_turn + 1u)
    for (size_t i = 0; i < 3u; i++) {
        NOT_A_NUMBER(creep.lag[i].state_um)
        NOT_A_NUMBER(creep.lag[i].rest_um)
        NEGATIVE(creep.lag[i].blend)
        DAMAGE(creep.lag[i].blend, (rdpi_real_t)1.001)
        NOT_A_NUMBER(creep.lag[i].weight)
        NOT_A_NUMBER(creep.lag[i].weight_ahead)
        DAMAGE(creep.per_sample[i], NAN)
        DAMAGE(creep.per_sample[i], -1)
        DAMAGE(creep.per_sample[i], 0)
    }
    NEGATIVE(unlag.per_step)
    NOT_A_NUMBER(unlag.asked_V)
    NOT_A_NUMBER(unlag.before_V)
    NOT_A_NUMBER(unlag.followed_V)
    NOT_A_NUMBER(unlag.ramp_V)
    NOT_A_NUMBER(unlag.carried_V)
    NEGATIVE(unlag.codes_per_V)
    NEGATIVE(unlag.max_step_V)
    DAMAGE(unlag.dac_code, 4096)
    DAMAGE(unlag.way, 6)
    DAMAGE(way, 6)
    DAMAGE(usual, 4)
    DAMAGE(preview_samples, (uint32_t)1 << 25)
}

void test_damage_of_a_play_that_is_not_engaged_is_found(void)
{
    made(&chain, &model);
    TEST_ASSERT_EQUAL_UINT16(0, chain.axis.bank.engaged);
    memcpy(&twin, &chain, sizeof chain);
    NOT_A_NUMBER(axis.bank.y_um[0])
    NOT_A_NUMBER(axis.bank.y_um[1])
    NOT_A_NUMBER(axis.bank.y_um[2])
}

static bool sane(void)
{
    return rdpi_f32_chain_is_sane(&chain);
}

/* The places and the edge of the quick way, where it is compiled. */
void test_damage_of_the_quick_way_is_found(void)
{
    const rdpi_f32_piece_t piece = {.slope = 1};
    model.bits = 12;
    model.bent = CURVES > 1;
    model.actuator.params.deadzones = 2;
    model.actuator.saturation[1] = (rdpi_f32_deadzone_t){.d_um = 20, .weight = (rdpi_real_t)-0.5};
    made(&chain, &model);
    (void)rdpi_f32_chain_step(&chain, 3);
    (void)rdpi_f32_chain_step(&chain, 2); /* no play is engaged */
    TEST_ASSERT_TRUE(sane());
    if (!chain.axis.quick) {
        return;
    }
    memcpy(&twin, &chain, sizeof chain);
    NOT_A_NUMBER(axis.bank.edge_um)
#if RDPI_MAX_CURVE_PIECES > 1
    const rdpi_f32_line_t line = {.gain_um_per_V = 1};
    NOT_A_NUMBER(axis.bank.middle_um)
    DAMAGE(axis.line, NULL)
    DAMAGE(axis.line, &line)
#endif
    DAMAGE(axis.latest_piece, NULL)
    DAMAGE(axis.latest_piece, &piece)
}

/* What is asked for and refused may be large: a small share that comes at once, and the largest reference. */
void test_a_reference_that_creep_brings_out_of_reach_is_sane(void)
{
    add_pole(&model, 0.998, 16);
    made(&chain, &model);
    for (int k = 0; k < 20; k++) {
        (void)rdpi_f32_chain_step(&chain, k % 3 == 0 ? LARGEST : -LARGEST);
        TEST_ASSERT_TRUE(sane());
    }
    TEST_ASSERT_GREATER_THAN_UINT32(0, chain.axis.input_count);
}

void test_what_is_not_kept_may_be_anything(void)
{
    made(&chain, &model);
    chain.axis.rate_estimator.z_um[0] = NAN;
    chain.lead.latest_um = NAN;
    chain.lead.per_step = NAN;
    chain.unlag.asked_V = NAN;
    TEST_ASSERT_TRUE(sane());
    model.params.LEAD = SAMPLES(1);
    made(&chain, &model);
    chain.lead.before_um = NAN;
    TEST_ASSERT_TRUE(sane());
}

/* PLAIN, LEAD, CREEP, LEAD_CREEP, GENERAL and LAG of f32_way.h, by number. */
void test_a_way_that_the_chain_does_not_have_is_refused_and_is_damage(void)
{
    for (unsigned kind = 0; kind < 8; kind++) {
        const bool leads = kind % 2u != 0u, creeps = kind / 2u % 2u != 0u, lags = kind / 4u != 0u;
        const unsigned usual = (leads ? 1u : 0u) + (creeps ? 2u : 0u);
        setUp();
        model.params.LEAD = leads ? SAMPLES(1) : 0;
        model.params.LAG = lags ? SAMPLES(3) : 0;
        if (creeps) {
            with_creep(&model);
        }
        made(&chain, &model);
        for (int k = 0; k < 20; k++) {
            (void)rdpi_f32_chain_step(&chain, wandering(k));
        }
        memcpy(&spare, &chain, sizeof chain);
        for (unsigned way = 0; way < 7u; way++) {
            const bool has = way == usual || (leads && way == 4u);
            *(lags ? &spare.unlag.way : &spare.way) = (uint8_t)way;
            TEST_ASSERT_EQUAL_INT(has, rdpi_f32_chain_is_sane(&spare));
            TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_chain_get_state(&spare, &state));
            if (!has) {
                refused(RDPI_ERR_STATE);
            }
        }
        memcpy(&spare, &chain, sizeof chain);
        spare.way = lags ? (uint8_t)usual : 5u;
        TEST_ASSERT_FALSE(rdpi_f32_chain_is_sane(&spare));
        memcpy(&spare, &chain, sizeof chain);
        spare.usual = (uint8_t)(usual ^ 1u);
        TEST_ASSERT_FALSE(rdpi_f32_chain_is_sane(&spare));
    }
}
