/* The cross coupling of examples/track in fixed point. */
#include "unity.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#define RDPI_AXES 2
#define RDPI_AXIS 0
#include "mock_rdpi_port.h"

TEST_SOURCE_FILE("port/drivers/telemetry.c")

#define TRACK_Q31 1
typedef int32_t number_t;
#define NUMBER(um) RDPI_PARAMS_Q31_REFERENCE(um)
#define UM(number) RDPI_PARAMS_Q31_UM(number)
#define NONE RDPI_Q31_NO_REFERENCE
#define IS_NONE(number) ((number) == RDPI_Q31_NO_REFERENCE)

void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);
void test_what_the_other_axis_moves_is_taken_off(void);
void test_its_own_code_does_not_count(void);
void test_no_reference_stays_none(void);
void test_it_does_not_wrap(void);

#include "track_coupling.inc"

void test_it_does_not_wrap(void)
{
    const uint32_t codes[] = {0, 32767};
    coupling.per_code[1] = (int64_t)1 << 45;
    TEST_ASSERT_EQUAL_INT32(-INT32_MAX, coupling_taken_off(0, codes));
    coupling.per_code[1] = -((int64_t)1 << 45);
    TEST_ASSERT_EQUAL_INT32(INT32_MAX, coupling_taken_off(0, codes));
}
