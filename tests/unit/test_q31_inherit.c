/* rdpi_q31_chain_inherit: an exchange of parameters. */
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
void test_inherit_refuses_null(void);
void test_inherit_refuses_another_sample_time_and_changes_nothing(void);
void test_identical_parameters_keep_plays_and_drive(void);
void test_identical_parameters_keep_creep(void);
void test_identical_parameters_keep_the_code(void);
void test_identical_parameters_keep_a_bent_input_curve(void);
void test_the_counts_are_inherited(void);
void test_thresholds_that_differ_a_little_lead_to_nearly_the_same_plays(void);
void test_more_plays_find_their_places_between_the_turning_points_that_are_remembered(void);
void test_fewer_plays_keep_those_that_they_have(void);
void test_a_single_play_on_either_side_is_x(void);
void test_another_gain_keeps_the_drives_that_the_plays_remember(void);
void test_another_offset_keeps_the_drives_that_the_plays_remember(void);
void test_a_negative_gain_keeps_the_drives_that_the_plays_remember(void);
void test_the_sign_of_the_gain_may_change(void);
void test_a_bent_input_curve_on_either_side_keeps_the_drives_that_the_plays_remember(void);
void test_plays_from_outside_the_range_come_back_into_it(void);
void test_other_codes_output_the_nearest_one(void);
void test_a_lag_keeps_what_is_output_and_what_the_plays_follow(void);
void test_a_pole_is_behind_as_those_with_the_next_time_constants(void);
void test_poles_in_any_order_are_compared(void);
void test_another_number_of_poles_goes_on_from_nearly_the_same_drive(void);
void test_creep_that_begins_or_ends_with_the_new_parameters_has_settled(void);
void test_creep_is_inherited_from_what_was_really_output(void);
#include "chain_inherit.inc"

void test_inherit_refuses_another_range_in_V_and_changes_nothing(void)
{
    wander(100);
    for (int kind = 0; kind < 4; kind++) {
        const uint32_t mantissa = model.actuator.params.unit_mantissa;
        given_model(&other);
        other.min_V = kind == 0 ? -31 : -32;
        other.max_V = kind == 1 ? 27 : 28;
        made(&spare, &other);
        other.actuator.params.unit_mantissa = kind == 2 ? INT32_MAX : mantissa; /* parameters that say no units */
        model.actuator.params.unit_mantissa = kind == 3 ? 0 : mantissa;
        memcpy(&twin, &spare, sizeof spare);
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_DRIVE, rdpi_q31_chain_inherit(&spare, &chain));
        TEST_ASSERT_EQUAL_MEMORY(&twin, &spare, sizeof spare);
        model.actuator.params.unit_mantissa = mantissa;
    }
}

/* The same actuator, whose displacement is counted in units of 2^-21 um, 2^-19 um, ...: slopes of the stages make up. */
void test_creep_is_inherited_in_other_units_of_displacement(void)
{
    with_creep(&model);
    with_creep(&other);
    wander(0);
    for (int k = 0; k < 30; k++) {
        (void)rdpi_q31_chain_forward(&chain, drive_of(&model, 12));
    }
    for (int shift = -1; shift < 3; shift++) {
        other.um_per_reference = ldexp(1, shift);
        other.actuator.params.saturation_shift = (uint8_t)(29 + shift);
        made(&spare, &other);
        inherits();
        for (size_t i = 0; i < 3; i++) {
            NEAR(0.001, creep_behind_um(&chain, i), creep_behind_um(&spare, i));
        }
        NEAR(0.001, ldexp((double)chain.creep.settled, -30) / U, ldexp((double)spare.creep.settled, -30 + shift) / U);
    }
}

/* What does not fit the units saturates. */
void test_creep_in_units_that_have_nothing_in_common_saturates(void)
{
    with_creep(&model);
    with_creep(&other);
    for (int sign = -1; sign <= 1; sign += 2) {
        wander(0);
        (void)rdpi_q31_chain_forward(&chain, drive_of(&model, 12));
        other.um_per_reference = ldexp(1, 100 * sign);
        made(&spare, &other);
        inherits();
        for (size_t i = 0; i < 3; i++) {
            int64_t expected = sign > 0 ? spare.creep.h : -(RDPI_Q31_ONE - 1);
            TEST_ASSERT_EQUAL_INT64(expected, spare.creep.lag[i].state >> 32);
        }
    }
}

/* Shares that add up to 1: what h_0 adds is nothing, wherever it was. */
void test_creep_without_a_share_of_where_it_had_settled_is_inherited(void)
{
    other = model;
    add_pole(&model, 0.25, 16);
    wander(0);
    TEST_ASSERT_EQUAL_INT64(0, chain.creep.settled);
    (void)rdpi_q31_chain_forward(&chain, drive_of(&model, 12));
    add_pole(&other, -0.25, 16); /* has one */
    made(&spare, &other);
    inherits();
    TEST_ASSERT_TRUE(spare.creep.settled != 0);
    NEAR(CLOSE, creep_behind_um(&chain, 0), creep_behind_um(&spare, 0));
}

/* The output and the x of the plays differ by what rounding leaves in other units, and by volts where there was a lag. The
 * direct way to a code must not take the one for the other: the search for corners would leave the arrays. */
void test_after_an_exchange_the_first_step_begins_where_the_plays_are(void)
{
    state_t state;
    for (int k = 0; k < 200; k++) {
        setUp();
        model.bits = other.bits = 12;
        model.params.LAG = k % 2 != 0 ? SAMPLES(4) : 0;
        other.gain = 0.8 + 0.002 * k;
        wander(k);
        made(&spare, &other);
        for (int n = 0; n < 5; n++) { /* a rate that is direct */
            (void)rdpi_q31_chain_step(&spare, Z(n));
        }
        inherits();
        TEST_ASSERT_TRUE(spare.axis.direct_output);
        int32_t here = rdpi_q31_predict(&spare.axis, spare.axis.bank.y[0], 0);
        for (int n = 0; n < 10; n++) {
            int32_t reference = here + (n % 2 != 0 ? 7 * n : -7 * n) * U / 1024;
            (void)rdpi_q31_chain_step(&spare, reference);
            NEAR(0.03, UM(reference), UM(rdpi_q31_predict(&spare.axis, spare.axis.drive, 0))); /* a code */
            TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_chain_get_state(&spare, &state));
            TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_chain_set_state(&spare, &state));
        }
    }
}
