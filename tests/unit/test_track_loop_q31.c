/* The controller of examples/track in fixed point. */
#include "unity.h"

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "mock_rdpi_port.h" /* only for RDPI_PORT_NO_READING */

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
void test_lost_ticks_count(void);
void test_the_largest_error_does_not_wrap(void);

#include "track_loop.inc"
