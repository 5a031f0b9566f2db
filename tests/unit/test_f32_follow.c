/* rdpi_f32_chain_forward: a chain that follows another source. */
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
void test_forward_predicts_the_displacement_behind_plays(void);
void test_forward_predicts_the_displacement_behind_creep(void);
void test_steps_and_forward_lead_through_the_same_creep(void);
void test_creep_follows_what_a_clipped_step_has_output_before_forward(void);
void test_a_step_after_forward_goes_on_from_the_same_drive(void);
void test_forward_outputs_the_code_and_ends_what_noise_shaping_has_carried(void);
void test_forward_refuses_a_drive_that_is_none(void);
void test_forward_ends_a_sweep(void);
#include "chain_follow.inc"
