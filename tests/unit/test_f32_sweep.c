/* rdpi_f32: the start-up sweep. */
#include "unity.h"

#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#include "axis_f32.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* A whole sweep, its plant moving along: each sample goes `step_V` towards the next of `count` turning points and stops
 * there, and the last sample alone returns false. */
static void sweeps_through(const rdpi_real_t *turns_V, size_t count, double step_V)
{
    double drive_V = (double)axis.drive_V;
    for (size_t turn = 0; turn < count;) {
        double left_V = (double)turns_V[turn] - drive_V;
        drive_V = fabs(left_V) > step_V ? drive_V + copysign(step_V, left_V) : (double)turns_V[turn];
        turn += fabs(left_V) <= step_V;
        TEST_ASSERT_EQUAL(turn < count, rdpi_f32_sweep(&axis));
        EQUAL(drive_V, axis.drive_V);
        TEST_ASSERT_TRUE(axis.drive_V >= given.params.min_V && axis.drive_V <= given.params.max_V);
        TEST_ASSERT_EQUAL_UINT32(0, axis.flags);
        EQUAL(0, axis.rate_um_per_s);
        plant((double)axis.drive_V, 0);
        equal_plant_memory();
    }
    SAME(turns_V[count - 1], axis.drive_V);
}

static const rdpi_real_t four_cycles_to_4[] = {15, -16, 12, (rdpi_real_t)-11.25, 9, (rdpi_real_t)-6.5, 6,
                                               (rdpi_real_t)-1.75, 3};
static const rdpi_real_t four_cycles_to_the_end[] = {15, -16, 15, (rdpi_real_t)-8.25, 15, (rdpi_real_t)-0.5, 15,
                                                     (rdpi_real_t)7.25, 15};

/* What both siblings do. */
void test_sweep_closes_in_on_its_end_in_cycles_of_equal_decrements(void);
void test_sweep_of_one_cycle_goes_up_down_and_to_its_end(void);
void test_sweep_stops_at_turning_points_that_its_steps_do_not_meet(void);
void test_sweep_to_the_end_of_the_range_returns_there_after_every_cycle(void);
void test_sweep_after_the_last_is_another_whole_one(void);
void test_sweep_begins_from_the_present_drive_without_a_jump(void);
void test_sweep_wipes_out_what_the_plays_remember(void);
void test_sweep_leaves_what_is_not_forgotten(void);
void test_sweep_forgets_nothing_by_itself(void);
void test_sweep_forgets_no_less_than_nothing_and_no_more_than_all(void);
void test_sweep_ignores_the_slew_limit_it_cannot_exceed(void);
void test_reset_makes_the_next_sweep_begin_anew(void);
void test_memory_set_makes_the_next_sweep_begin_anew(void);
void test_forward_makes_the_next_sweep_begin_anew(void);
void test_sweep_given_up_half_way_leaves_states_that_steps_go_on_from(void);
void test_sweep_forgets_rate_history_and_missed_samples(void);
void test_sweep_clears_the_flags_of_the_step_before(void);
#include "axis_sweep.inc"

void test_sweep_outputs_dac_codes_and_the_plays_follow_them(void)
{
    five_bit_dac();
    given.params.sweep_end_V = (rdpi_real_t)0.2; /* nearest: 0 V */
    start();
    plant_at_rest();
    bool goes_on = true;
    for (int k = 0; goes_on; k++) { /* an eighth of a code a sample: it must not get stuck */
        TEST_ASSERT_LESS_THAN_INT(2000, k);
        goes_on = rdpi_f32_sweep(&axis);
        EQUAL((rdpi_real_t)axis.dac_code / 2 - 8, axis.drive_V);
        TEST_ASSERT_LESS_OR_EQUAL_UINT32(31, axis.dac_code);
        plant((double)axis.drive_V, 0);
        equal_plant_memory();
    }
    TEST_ASSERT_EQUAL_UINT32(16, axis.dac_code);
    EQUAL(0, axis.drive_V);
}

void test_sweep_reaches_both_ends_of_a_range_of_codes(void)
{
    uint32_t lowest = 31, highest = 0;
    five_bit_dac();
    start();
    while (rdpi_f32_sweep(&axis)) {
        lowest = axis.dac_code < lowest ? axis.dac_code : lowest;
        highest = axis.dac_code > highest ? axis.dac_code : highest;
    }
    TEST_ASSERT_EQUAL_UINT32(0, lowest);
    TEST_ASSERT_EQUAL_UINT32(31, highest);
}

void test_what_is_forgotten_leaves_the_drive_before_it_is_rounded(void)
{
    five_bit_dac(); /* 0.5 V */
    given.params.sweep_end_V = (rdpi_real_t)0.125;
    given.params.sweep_forgotten = (rdpi_real_t)0.5;
    start();
    while (rdpi_f32_sweep(&axis)) {
    }
    rdpi_f32_forget_sweep(&axis);
    EQUAL(0, axis.drive_V);
    EQUAL(0.125, axis.ramp_V);
}
