/* rdpi_f32_axis: the life of an axis. */
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
void test_before_init_the_axis_holds_what_its_caller_put_there(void);
void test_off_takes_no_call(void);
void test_every_call_refuses_null(void);
void test_a_refused_init_leaves_drive_and_code_and_the_axis_off(void);
void test_init_takes_both_ends_of_the_range(void);
void test_init_stops_at_the_drive_that_is_output(void);
void test_init_forgets_requests(void);
void test_each_mode_takes_the_calls_of_the_table_and_no_other(void);
void test_start_sweeps_over_the_range_ramps_and_runs(void);
void test_the_reference_that_ends_the_ramp_is_the_first_one_followed(void);
void test_a_ramp_goes_on_until_its_reference_is_usable_and_reached(void);
void test_behind_a_lag_a_ramp_goes_on_until_the_drive_has_arrived(void);
void test_a_ramp_begins_where_run_has_left_the_drive_though_nothing_could_be_followed(void);
void test_a_request_is_pending_until_a_sample_has_obeyed(void);
void test_of_two_requests_before_a_sample_the_later_counts(void);
void test_no_request_pushes_out_one_that_matters_more(void);
void test_however_many_requests_come_before_a_sample_the_last_counts(void);
void test_no_transition_makes_a_step_larger_than_its_speed(void);
void test_no_transition_makes_a_step_larger_than_the_slew_limit(void);
void test_no_transition_makes_a_larger_step_where_the_gain_is_negative(void);
void test_plays_and_creep_follow_the_drive_in_every_mode(void);
void test_plays_and_creep_follow_the_codes_in_every_mode(void);
void test_plays_follow_the_drive_in_every_mode(void);
void test_stop_goes_straight_to_its_drive_at_its_speed(void);
void test_stop_without_a_speed_has_that_of_the_sweep(void);
void test_stop_keeps_the_slew_limit(void);
void test_stop_where_the_drive_is_stops_at_once(void);
void test_another_stop_replaces_the_one_on_its_way(void);
void test_a_slow_stop_outputs_codes_and_arrives(void);
void test_stop_refuses_drives_outside_the_range(void);
void test_follow_outputs_the_drive_of_the_other_source_and_tells_where_the_actuator_is(void);
void test_follow_obeys_a_hand_over_that_is_pending(void);
void test_follow_in_another_mode_holds_the_drive_and_flags_it(void);
void test_follow_refuses_a_drive_that_is_none(void);
void test_from_codes_output_again_a_ramp_leads_back_to_the_reference(void);
void test_plays_and_creep_follow_codes_output_again(void);
void test_codes_output_again_in_each_mode(void);
void test_a_code_that_there_is_not_is_not_followed(void);
void test_a_sweep_and_ramps_go_on_where_they_were_after_missed_samples(void);
void test_creep_goes_on_while_samples_are_missed(void);
void test_fault_holds_the_drive_that_was_output_elsewhere(void);
void test_after_a_fault_only_a_whole_sweep_leads_back_to_run(void);
void test_a_start_after_a_fault_makes_anew_what_a_sweep_does_not_erase(void);
void test_check_passes_every_mode(void);
void test_a_damaged_state_leads_to_fault_at_the_same_drive(void);
void test_a_damaged_mode_leads_to_fault(void);
void test_a_request_that_the_mode_takes_no_longer_is_dropped(void);
void test_damage_that_a_reset_does_not_repair_needs_another_init(void);
void test_a_count_of_poles_that_was_damaged_is_repaired(void);
void test_a_pointer_of_the_operator_that_was_damaged_is_repaired(void);
void test_an_exchange_keeps_the_drive_and_ramps_to_what_the_new_parameters_ask_for(void);
void test_an_exchange_of_parameters_at_rest_holds_the_drive(void);
void test_a_refused_exchange_leaves_the_old_parameters_in_force(void);
void test_a_stop_on_its_way_takes_no_exchange(void);
void test_a_block_outputs_what_steps_output_and_says_how_many_references_it_followed(void);
void test_a_block_reads_no_further_than_its_caller_knows(void);
#include "axis_life.inc"

void test_stop_refuses_speeds_that_are_none(void)
{
    const rdpi_real_t bad[] = {NAN, INFINITY, -1, (rdpi_real_t)1e-6}; /* the last is 1 nV a sample: nothing, at 60 V */
    init_at(0);
    for (size_t k = 0; k < sizeof bad / sizeof bad[0]; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_RATE, rdpi_f32_axis_stop(&life, 5, bad[k]));
    }
    TEST_ASSERT_FALSE(rdpi_f32_axis_pending(&life));
}

void test_init_refuses_a_drive_that_is_not_finite(void)
{
    const rdpi_real_t bad[] = {NAN, INFINITY, -INFINITY};
    seal(&model);
    for (size_t k = 0; k < sizeof bad / sizeof bad[0]; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, rdpi_f32_axis_init(&life, &model.params, SAMPLE_TIME, bad[k]));
    }
}

void test_follow_predicts_nothing_in_off(void)
{
    TEST_ASSERT_TRUE(isnan(rdpi_f32_axis_follow(&life, 1)));
}

void test_an_exchange_for_a_range_without_the_drive_is_refused(void)
{
    bring(RDPI_AXIS_RUN);
    rdpi_real_t drive_V = life.drive_V;
    other.max_V = (double)drive_V - 0.5;
    spare_of(&other);
    ok(rdpi_f32_axis_exchange(&life, &spare));
    (void)step(HOME);
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, life.exchanged);
    in_mode(RDPI_AXIS_RUN);
    SAME_NUMBER(drive_V, life.drive_V);
}

/* The quick way does not keep the drive before it is rounded to a code: 0.5 V are 34.125 codes. */
void test_a_ramp_begins_at_the_code_that_was_output(void)
{
    for (int k = 0; k < 40; k++) {
        setUp();
        model.bits = 12;
        init_and_run();
        (void)step(Z(4 + 0.01 * k));
        uint32_t code = life.dac_code;
        ok(LIFE(hand_over)(&life));
        (void)LIFE(follow)(&life, FAR_DRIVE); /* nothing is followed, which would forget the rest of the code */
        ok(LIFE(take_back)(&life));
        (void)step(Z(-20));
        TEST_ASSERT_EQUAL_UINT32(code - 34u, life.dac_code);
    }
}

/* In RAM: an upset memory cell would let a ramp leave the range, or go faster. */
void test_damaged_limits_of_ramps_are_found_and_made_anew(void)
{
    for (int kind = 0; kind < 3; kind++) {
        setUp();
        bring(RDPI_AXIS_RAMP);
        rdpi_real_t *field[] = {&life.slow.min_V, &life.slow.max_V, &life.slow.slew_V_per_s};
        rdpi_real_t before = *field[kind];
        *field[kind] *= 2;
        TEST_ASSERT_FALSE(LIFE(check)(&life));
        (void)step(HOME);
        in_mode(RDPI_AXIS_FAULT);
        SAME_NUMBER(before, *field[kind]);
        TEST_ASSERT_TRUE(LIFE(check)(&life));
        only_a_sweep_leads_on();
    }
}
