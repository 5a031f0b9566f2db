/* rdpi_f32_chain_inherit: an exchange of parameters. */
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

void test_inherit_refuses_a_drive_outside_the_range_and_changes_nothing(void)
{
    wander(0);
    (void)rdpi_f32_chain_forward(&chain, 20);
    for (int kind = 0; kind < 2; kind++) {
        given_model(&other);
        other.max_V = kind == 0 ? (double)19.9 : 28;
        chain.axis.drive_V = kind == 0 ? 20 : NAN;
        made(&spare, &other);
        memcpy(&twin, &spare, sizeof spare);
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, rdpi_f32_chain_inherit(&spare, &chain));
        TEST_ASSERT_EQUAL_MEMORY(&twin, &spare, sizeof spare);
    }
    chain.axis.drive_V = 20;
    other.min_V = (double)20.1;
    for (size_t i = 0; i < 3; i++) {
        other.actuator.memory_um[i] = 25;
    }
    other.actuator.params.sweep_end_V = 25;
    made(&spare, &other);
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, rdpi_f32_chain_inherit(&spare, &chain));
}

/* x of some 300000 um in a range of 60 V: what single precision makes of its ends may lie outside. */
void test_what_rounding_takes_out_of_the_range_is_refused_and_changes_nothing(void)
{
    int taken = 0, left = 0;
    wander(0);
    (void)rdpi_f32_chain_forward(&chain, 28);
    for (int k = 0; k < 40; k++) {
        other.gain = 0.3 + 0.001 * k;
        other.offset_V = 1e6;
        for (size_t i = 0; i < 3; i++) {
            other.actuator.memory_um[i] = (rdpi_real_t)(other.gain * -1e6);
        }
        made(&spare, &other);
        memcpy(&twin, &spare, sizeof spare);
        rdpi_status_t status = rdpi_f32_chain_inherit(&spare, &chain);
        if (status == RDPI_OK) {
            taken++;
        } else {
            TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, status);
            TEST_ASSERT_EQUAL_MEMORY(&twin, &spare, sizeof spare);
            left++;
        }
    }
    TEST_ASSERT_GREATER_THAN_INT(0, taken);
    TEST_ASSERT_GREATER_THAN_INT(0, left);
}

/* T / time_constant of 1e30 is infinite for some; the pole follows at once. */
void test_a_time_constant_of_next_to_nothing_is_inherited(void)
{
    add_pole(&model, 0.25, 16);
    wander(100);
    add_pole(&other, 0.25, 1e-42);
    made(&spare, &other);
    inherits();
    TEST_ASSERT_TRUE(rdpi_f32_chain_is_sane(&spare));
    wander(0);
    chain = spare;
    other = model;
    made(&spare, &other);
    inherits();
}

/* As many codes over another range. */
void test_another_range_outputs_the_nearest_code(void)
{
    model.bits = other.bits = 12;
    for (int kind = 0; kind < 2; kind++) {
        other.min_V = kind == 0 ? -30 : -32;
        other.max_V = kind == 1 ? 30 : 28;
        wander(100);
        double volts = V_in(&model, &chain), span_V = other.max_V - other.min_V;
        inherits();
        TEST_ASSERT_EQUAL_UINT32((uint32_t)((volts - other.min_V) * 4095 / span_V + 0.5), spare.axis.dac_code);
    }
}
