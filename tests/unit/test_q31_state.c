/* rdpi_q31_chain: its state as a value, and whether it is sane. */
#include "unity.h"

#include "rdpi/q31_axis.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")
TEST_SOURCE_FILE("lib/src/rdpi_q31_chain.c")
TEST_SOURCE_FILE("lib/src/rdpi_q31_state.c")
TEST_SOURCE_FILE("lib/src/rdpi_q31_axis.c")

#include "life_q31.inc"
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

static const rdpi_q31_play_t given_elsewhere = {0, RDPI_Q31_ONE, 0};

#define BOTH(field, most)                                                                                              \
    DAMAGE(field, (most) + 1)                                                                                          \
    DAMAGE(field, -(most)-1)
#define WIDE(field, most)                                                                                              \
    DAMAGE(field, ((int64_t)(most) + 1) * ((int64_t)1 << 32))                                                          \
    DAMAGE(field, -((int64_t)(most) + 1) * ((int64_t)1 << 32))                                                         \
    DAMAGE(field, INT64_MAX)                                                                                           \
    DAMAGE(field, INT64_MIN)

static void damage_each(void)
{
    DAMAGE(axis.drive, drive_of(&model, 28.01))
    DAMAGE(axis.drive, drive_of(&model, -32.01))
    DAMAGE(axis.rate, -1)
    DAMAGE(axis.rate, RDPI_Q31_ONE + 1)
    DAMAGE(axis.dac_code, 4096)
    DAMAGE(axis.sweep_turns, 6)
    BOTH(axis.x, RDPI_Q31_MAX_DRIVE)
    WIDE(axis.ramp, RDPI_Q31_MAX_DRIVE)
    DAMAGE(axis.slew, -1)
    DAMAGE(axis.sweep_step, 0)
#if RDPI_NOISE_SHAPING
    WIDE(axis.carried, 1 << 29)
#endif
    DAMAGE(axis.rate_estimator.filtered, -1)
    DAMAGE(axis.rate_estimator.direct, true)
    DAMAGE(axis.rate_estimator.guard, INT32_MAX)
    DAMAGE(axis.rate_estimator.per_guard, ((uint32_t)1 << 30) - 1u)
    DAMAGE(axis.rate_estimator.guard_shift, 63)
    DAMAGE(axis.rate_estimator.blend_shift, 31)
    DAMAGE(axis.rate_estimator.direct_shift, (uint8_t)(chain.axis.rate_estimator.direct_shift + 1))
    DAMAGE(axis.rate_estimator.window, 0)
    DAMAGE(axis.rate_estimator.window, RDPI_MAX_WINDOW + 1)
    DAMAGE(axis.rate_estimator.oldest, chain.axis.rate_estimator.window + 1)
    DAMAGE(axis.bank.engaged, 3)
    DAMAGE(axis.bank.last_engaged, NULL)
    DAMAGE(axis.bank.last_engaged, &given_elsewhere)
    DAMAGE(axis.bank.room, -1)
    DAMAGE(axis.bank.room, RDPI_Q31_ONE + 1)
    WIDE(axis.bank.f_at_rest, RDPI_Q31_ONE / 4)
    WIDE(axis.bank.f_rate, RDPI_Q31_ONE / 4)
    BOTH(axis.bank.y[0], RDPI_Q31_MAX_DRIVE)
    for (size_t i = chain.axis.bank.engaged + 1u; i < 3u; i++) {
        BOTH(axis.bank.y[i], RDPI_Q31_MAX_DRIVE)
    }
    BOTH(lead.per_sum, RDPI_Q31_ONE)
    BOTH(lead.per_change, RDPI_Q31_ONE)
    DAMAGE(lead.before, INT32_MIN)
    DAMAGE(lead.latest, INT32_MIN)
    DAMAGE(lead.shift, 0)
    DAMAGE(lead.shift, 64)
    BOTH(creep.h, RDPI_Q31_ONE - 1)
    BOTH(creep.mean, RDPI_Q31_ONE - 1)
    WIDE(creep.settled, RDPI_Q31_ONE / 4)
    WIDE(creep.slow, RDPI_Q31_ONE / 32 * 17)
    WIDE(creep.next, RDPI_Q31_ONE / 32 * 17)
    WIDE(creep.sum, RDPI_MAX_POLES)
    DAMAGE(creep.per_direct, ((int32_t)1 << 27) - 1)
    DAMAGE(creep.per_direct, RDPI_Q31_ONE + 1)
    DAMAGE(creep.poles, 2)
    DAMAGE(creep.poles, 4)
    DAMAGE(creep.fast, 4)
    DAMAGE(creep.turn, 0)
    DAMAGE(creep.turn, 3)
    DAMAGE(creep.turn, 4)
    for (size_t i = 0; i < 3u; i++) {
        WIDE(creep.lag[i].state, RDPI_Q31_ONE)
        DAMAGE(creep.lag[i].blend, -1)
        BOTH(creep.lag[i].weight, RDPI_Q31_ONE)
        DAMAGE(creep.lag[i].per_sample, ((uint32_t)1 << 30) - 1u)
        DAMAGE(creep.lag[i].exponent, 95)
        DAMAGE(creep.lag[i].shift, 63)
    }
    WIDE(unlag.ramp, RDPI_Q31_MAX_DRIVE)
    DAMAGE(unlag.per_step, -1)
    DAMAGE(unlag.per_step, RDPI_Q31_ONE + 1)
    BOTH(unlag.asked, RDPI_Q31_MAX_DRIVE)
    BOTH(unlag.before, RDPI_Q31_ONE)
    BOTH(unlag.followed, RDPI_Q31_MAX_DRIVE)
    BOTH(unlag.carried, RDPI_Q31_MAX_DRIVE)
    DAMAGE(unlag.dac_code, 4096)
    DAMAGE(unlag.shift, 0)
    DAMAGE(unlag.shift, 64)
    DAMAGE(preview_samples, (uint32_t)1 << 30)
    DAMAGE(sample_time_ns, 0)
}

void test_damage_of_a_play_that_is_not_engaged_is_found(void)
{
    made(&chain, &model);
    TEST_ASSERT_EQUAL_UINT16(0, chain.axis.bank.engaged);
    memcpy(&twin, &chain, sizeof chain);
    BOTH(axis.bank.y[0], RDPI_Q31_MAX_DRIVE)
    BOTH(axis.bank.y[1], RDPI_Q31_MAX_DRIVE)
    BOTH(axis.bank.y[2], RDPI_Q31_MAX_DRIVE)
}

/* ---- states whose CRC is right, but which no step can go on from: fields that do not fit each other ---- */

static void forged(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_chain_get_state(&spare, &state));
    refused(RDPI_ERR_STATE);
    memcpy(&spare, &chain, sizeof chain);
}

#define FORGE(field, value)                                                                                            \
    spare.field = (value);                                                                                             \
    forged();

/* A chain at some moment of its life, and one like it to forge; the state is taken as it is. */
static void moment(int samples)
{
    made(&chain, &model);
    for (int k = 0; k < samples; k++) {
        (void)rdpi_q31_chain_step(&chain, wandering(k));
    }
    memcpy(&spare, &chain, sizeof chain);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_chain_get_state(&chain, &state));
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_chain_set_state(&chain, &state));
    memcpy(&chain, &spare, sizeof chain);
}

/* Plays in other states, with the f that belongs to them: all weights are 0.5. */
static void with_plays(int32_t x, int32_t y1, int32_t y2)
{
    rdpi_q31_bank_t *bank = &spare.axis.bank;
    bank->y[0] = x;
    bank->y[1] = y1;
    bank->y[2] = y2;
    bank->f_at_rest = (int64_t)SLOPE(0.5) * ((int64_t)x + y1 + y2);
    bank->room = 0;
}

/* Each is within its format; the ways between their corners overflow, or would with more of them. */
void test_plays_that_no_history_leads_to_are_refused(void)
{
    const int32_t most = RDPI_Q31_MAX_DRIVE, x = drive_of(&model, 5);
    moment(0);
    with_plays(x, x + R(1) + 1, x);
    forged();
    with_plays(x, x - R(1) - 1, x);
    forged();
    with_plays(x, x, x + R(2) + 1);
    forged();
    with_plays(x, x + R(1), x - R(1) - 1); /* its corner is before that of the play below it */
    forged();
    with_plays(most, -most, most);
    forged();
    with_plays(x, x + R(1), x - R(1)); /* no further than they may be */
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_chain_get_state(&spare, &state));
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_chain_set_state(&chain, &state));
}

/* The states of plays that are engaged are no part of the state: x implies them. */
void test_engaged_plays_beyond_their_format_are_refused(void)
{
    for (int falling = 0; falling < 2; falling++) {
        const int32_t x = falling ? RDPI_Q31_MAX_DRIVE : -RDPI_Q31_MAX_DRIVE, side = falling ? -1 : 1;
        moment(0);
        with_plays(x, x - side * R(1), x - side * R(3));
        spare.axis.bank.falling = falling;
        spare.axis.bank.engaged = 2;
        spare.axis.bank.last_engaged = &model.actuator.play[2];
        spare.axis.bank.y[1] = 0; /* not read */
        spare.axis.bank.y[2] = 0;
        forged();
    }
}

/* A step back over a corner reads the place of a play that is engaged; what is saved there is what x implies. */
void test_another_state_in_the_place_of_an_engaged_play_is_refused(void)
{
    moment(40);
    TEST_ASSERT_GREATER_THAN_UINT16(0, chain.axis.bank.engaged);
    state.number[RDPI_Q31_STATE_NUMBERS - RDPI_MAX_PLAYS + 1]++;
    reseal(&state);
    refused(RDPI_ERR_STATE);
}

void test_what_follows_from_the_plays_must_fit_them(void)
{
    with_rate_law(&model);
    moment(40);
    FORGE(axis.bank.f_at_rest, chain.axis.bank.f_at_rest + 1)
    FORGE(axis.bank.f_rate, chain.axis.bank.f_rate - 1)
    FORGE(axis.bank.room, chain.axis.bank.room + 1)
    moment(0);
    FORGE(axis.bank.room, chain.axis.bank.room + 1)
}

void test_a_sum_of_a_round_larger_than_its_samples_allow_is_refused(void)
{
    with_creep(&model);
    moment(20);
    TEST_ASSERT_EQUAL_UINT16(chain.creep.fast, chain.creep.turn);
    FORGE(creep.sum, 1)
    FORGE(creep.sum, -1)
    moment(21);
    FORGE(creep.sum, RDPI_Q31_ONE)
    FORGE(creep.sum, -RDPI_Q31_ONE)
}

/* The direct rate shifts by 31 - guard_shift. It is no part of the state: the next step finds out whether it may be. */
void test_a_rate_that_cannot_be_direct_is_damage(void)
{
    for (int kind = 0; kind < 4; kind++) {
        setUp();
        model.actuator.params.guard_exponent = kind == 1 ? -19 : model.actuator.params.guard_exponent;
        model.actuator.params.RATE_WINDOW = kind == 2 ? SAMPLES(5) : 0;
        model.actuator.params.RATE_FILTER = kind == 3 ? SAMPLES(4) : 0;
        moment(20);
        TEST_ASSERT_EQUAL_INT(kind == 1, chain.axis.rate_estimator.guard_shift > 31);
        chain.axis.rate_estimator.direct = true;
        TEST_ASSERT_EQUAL_INT(kind == 0, rdpi_q31_chain_is_sane(&chain));
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_chain_set_state(&chain, &state));
        TEST_ASSERT_FALSE(chain.axis.rate_estimator.direct);
    }
}
