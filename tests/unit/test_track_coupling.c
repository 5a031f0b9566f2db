/* The cross coupling of examples/track in single precision. */
#include "unity.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#define RDPI_AXES 2
#define RDPI_AXIS 0
#include "mock_rdpi_port.h"

TEST_SOURCE_FILE("port/drivers/telemetry.c")

#define TRACK_Q31 0
typedef float number_t;
#define NUMBER(um) ((float)(um))
#define UM(number) ((double)(number))
#define NONE NAN
#define IS_NONE(number) isnan(number)

void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);
void test_what_the_other_axis_moves_is_taken_off(void);
void test_its_own_code_does_not_count(void);
void test_no_reference_stays_none(void);

#include "track_coupling.inc"
