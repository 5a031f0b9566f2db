/* rdpi_q31: samples that were missed. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#include "axis_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What both siblings do. */
void test_after_missed_samples_the_rate_is_that_over_the_true_time(void);
void test_missed_is_flagged_once(void);
void test_no_ticks_missed_change_nothing(void);
void test_missed_references_are_taken_to_lie_on_a_straight_line(void);
void test_as_many_missed_samples_as_allowed_keep_the_rate(void);
void test_after_more_missed_samples_the_rate_starts_afresh_from_zero(void);
void test_however_many_ticks_are_missed_the_rate_starts_afresh(void);
void test_missed_count_stays_at_its_largest_value(void);
void test_a_refused_reference_counts_as_a_missed_sample(void);
void test_however_many_references_are_refused_the_rate_starts_afresh(void);
void test_missed_samples_do_not_widen_the_slew_limit(void);
void test_missed_samples_do_not_survive_a_reset(void);
#include "axis_missed.inc"

void test_missed_samples_move_neither_drive_nor_plays(void)
{
    rdpi_q31_t before;
    start();
    rdpi_q31_step(&axis, 2 * U);
    memcpy(&before, &axis, sizeof axis);
    rdpi_q31_missed(&axis, 7);
    before.missed = 7;
    before.missed_count = 7;
    before.rate_estimator.direct = false; /* the next rate counts them */
    TEST_ASSERT_EQUAL_MEMORY(&before, &axis, sizeof axis);
}
