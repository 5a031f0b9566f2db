/* The controller of examples/track in single precision. */
#include "unity.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "mock_rdpi_port.h" /* LOOP_NO_READING is its RDPI_PORT_NO_READING */

#define TRACK_Q31 0
typedef float number_t;
#define NUMBER(um) ((float)(um))
#define UM(number) ((double)(number))
#define NONE NAN
#define IS_NONE(number) isnan(number)

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
void test_references_that_the_library_refuses_correct_nothing(void);

#include "track_loop.inc"

/* The library holds at them; the integral must not take them for an error. */
void test_references_that_the_library_refuses_correct_nothing(void)
{
    const float refused[] = {INFINITY, -INFINITY, 2e6f};
    double corrections_um[CLOSE_AT + 30];
    for (size_t k = 0; k < sizeof refused / sizeof refused[0]; k++) {
        setUp();
        follow(corrections_um, CLOSE_AT + 30);
        float before_um = loop.correction;
        (void)next(refused[k], refused[k], reading(NUMBER(REFERENCE_UM)));
        (void)next(NUMBER(REFERENCE_UM), NUMBER(REFERENCE_UM), reading(NUMBER(REFERENCE_UM)));
        TEST_ASSERT_FLOAT_WITHIN(0.5f, before_um, loop.correction);
    }
}
