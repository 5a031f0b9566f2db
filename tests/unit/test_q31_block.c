/* rdpi_q31_chain_block: many samples at once. */
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
void test_a_block_gives_the_same_as_steps(void);
void test_a_block_of_nothing_does_nothing(void);
void test_a_block_refuses_null_and_does_nothing_then(void);
#include "chain_block.inc"
