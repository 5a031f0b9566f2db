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
void test_a_state_of_another_chain_is_refused(void);
void test_get_and_set_refuse_null(void);
void test_no_chain_and_one_that_init_has_not_accepted_is_not_sane(void);
void test_every_state_that_a_chain_reaches_is_sane(void);
void test_damage_of_each_field_is_found(void);
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
    WIDE(axis.bank.f_at_rest, RDPI_Q31_ONE)
    WIDE(axis.bank.f_rate, RDPI_Q31_ONE)
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
    WIDE(creep.settled, RDPI_Q31_ONE)
    WIDE(creep.slow, RDPI_Q31_ONE)
    WIDE(creep.next, RDPI_Q31_ONE)
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
