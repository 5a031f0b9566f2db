/* The controller of examples/track in fixed point. */
#include "unity.h"

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "mock_rdpi_port.h" /* LOOP_NO_READING is its RDPI_PORT_NO_READING */

#define TRACK_Q31 1
typedef int32_t number_t;
#define NUMBER(um) RDPI_PARAMS_Q31_REFERENCE(um)
#define UM(number) RDPI_PARAMS_Q31_UM(number)
#define NONE RDPI_Q31_NO_REFERENCE
#define IS_NONE(number) ((number) == RDPI_Q31_NO_REFERENCE)

void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);
void test_it_takes_the_error_away(void);
void test_hand_over_changes_nothing(void);
void test_it_goes_on_from_where_it_was_opened(void);
void test_the_integral_does_not_wind_up(void);
void test_no_reference_stays_none_and_corrects_nothing(void);
void test_two_loops_do_not_share_anything(void);
void test_it_says_that_the_library_limits_it(void);
void test_a_reading_of_a_block_counts_for_its_samples(void);
void test_the_largest_error_does_not_wrap(void);

#include "track_loop.inc"
