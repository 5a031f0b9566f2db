/* rdpi_f32_chain_block: many samples at once. */
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
void test_a_block_gives_the_same_as_steps(void);
void test_a_block_of_nothing_does_nothing(void);
void test_a_block_refuses_null_and_does_nothing_then(void);
#include "chain_block.inc"
