/* The gain of the controller of examples/track in single precision. */
#include "unity.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "mock_rdpi_port.h" /* only for RDPI_PORT_NO_READING */

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#define TRACK_Q31 0
typedef float number_t;
#define NUMBER(um) ((float)(um))
#define UM(number) ((double)(number))
#define AXIS(name) rdpi_f32_##name
#define RATE(axis) (axis).rate_um_per_s
#define PARAMS rdpi_params
#define SAMPLE_TIME 1e-4f

void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);
void test_the_advised_gain_settles(void);
void test_one_reading_per_half_leaves_a_gain_margin(void);
void test_a_reading_per_sample_leaves_a_gain_margin(void);
void test_a_gain_that_does_not_count_the_half_oscillates(void);

#include "track_loop_gain.inc"
