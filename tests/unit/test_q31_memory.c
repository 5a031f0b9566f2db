/* rdpi_q31: reset, and states that are read and set. */
#include "unity.h"

#include "rdpi/q31.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")

#include "axis_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* What both siblings do. */
void test_reset_is_power_up_again(void);
void test_set_memory_moves_plays_and_drive(void);
void test_step_goes_on_from_the_memory_set(void);
void test_set_memory_leaves_rate_history_and_counters(void);
void test_set_memory_refuses_no_states_and_changes_nothing(void);
void test_set_memory_refuses_no_instance(void);
#include "axis_memory.inc"

void test_get_memory_gives_what_set_memory_takes(void)
{
    int32_t y[PLAYS], again[PLAYS];
    rdpi_q31_t other;
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&other, &given.params, T_NS));
    for (int k = 0; k < 1000; k++) {
        rdpi_q31_step(&axis, random_size(FAR, 12));
        rdpi_q31_get_memory(&axis, y);
        TEST_ASSERT_EQUAL_INT32(axis.drive, y[0]);
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&other, y));
        rdpi_q31_get_memory(&other, again);
        TEST_ASSERT_EQUAL_MEMORY(y, again, sizeof y);
        TEST_ASSERT_EQUAL_INT32(axis.drive, other.drive);
    }
}

/* No slack: one unit too far apart, or outside. */
void test_set_memory_refuses_states_one_unit_out_of_place_and_changes_nothing(void)
{
    const int32_t bad[][PLAYS] = {{3 * U, 2 * U - 1, 0}, {3 * U, 4 * U + 1, 4 * U}, {3 * U, 2 * U, 4 * U + 1},
                                  {28 * U + 1, 28 * U, 28 * U}, {-32 * U - 1, -32 * U, -32 * U}};
    const int32_t good[][PLAYS] = {{3 * U, 2 * U, 0}, {3 * U, 4 * U, 4 * U}, {3 * U, 2 * U, 4 * U},
                                   {28 * U, 29 * U, 31 * U}, {-32 * U, -33 * U, -35 * U}};
    for (size_t k = 0; k < 5; k++) {
        memory_refused(RDPI_ERR_MEMORY, bad[k]);
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, good[k]));
        equal_memory(good[k][0], good[k][1], good[k][2]);
    }
}

void test_set_memory_refuses_states_beyond_the_largest_drive(void)
{
    const int32_t bad[][PLAYS] = {{MAX, MAX + 1, MAX}, {-MAX, -MAX, -MAX - 1}, {INT32_MIN, INT32_MAX, 0}};
    const int32_t good[][PLAYS] = {{MAX, MAX, MAX}, {-MAX, -MAX, -MAX}};
    whole_format();
    for (size_t k = 0; k < 3; k++) {
        memory_refused(RDPI_ERR_MEMORY, bad[k]);
    }
    for (size_t k = 0; k < 2; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_set_memory(&axis, good[k]));
        TEST_ASSERT_EQUAL_INT32(good[k][0], axis.drive);
    }
}
