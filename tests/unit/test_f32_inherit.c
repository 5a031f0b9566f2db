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
void test_another_number_of_poles_goes_on_from_nearly_the_same_drive(void);
void test_creep_that_begins_or_ends_with_the_new_parameters_has_settled(void);
void test_creep_is_inherited_from_what_was_really_output(void);
#include "chain_inherit.inc"
