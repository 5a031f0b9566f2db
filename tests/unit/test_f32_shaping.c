/* rdpi_f32: noise shaping of the DAC's codes. */
#include "unity.h"

#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#include "axis_f32.inc"

#define CARRIED carried_um
#define MUCH 100 /* carried, more than codes miss */
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What both siblings do. */
void test_what_codes_miss_adds_up_to_less_than_two_codes(void);
void test_a_reference_that_a_code_makes_has_that_code(void);
void test_x_is_moved_by_half_a_code_at_most(void);
void test_the_code_is_the_nearest_or_the_one_beside_it_and_flags_are_the_same(void);
void test_noise_shaping_keeps_the_slew_limit(void);
void test_nothing_is_carried_over_a_clip(void);
void test_nothing_is_carried_over_a_drive_of_another_source(void);
void test_nothing_is_carried_over_a_reset(void);
void test_nothing_is_carried_into_other_memory(void);
void test_nothing_is_carried_over_a_sweep(void);
void test_what_is_carried_stays_while_references_are_refused(void);
void test_noise_shaping_without_codes_does_nothing(void);
#include "axis_shaping.inc"
