/* rdpi_f32: reset, and states that are read and set. */
#include "unity.h"

#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#include "axis_f32.inc"
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
    rdpi_real_t y_um[PLAYS], again[PLAYS];
    rdpi_f32_t other;
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&other, &given.params, T_S));
    for (int k = 0; k < 200; k++) {
        rdpi_f32_step(&axis, (rdpi_real_t)(3 * sin(0.3 * k) + 2 * sin(1.7 * k)));
        rdpi_f32_get_memory(&axis, y_um);
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&other, y_um));
        rdpi_f32_get_memory(&other, again);
        TEST_ASSERT_EQUAL_MEMORY(y_um, again, sizeof y_um);
    }
}

void test_memory_rounded_in_print_is_accepted_and_the_drive_kept_in_range(void)
{
    const rdpi_real_t above[PLAYS] = {(rdpi_real_t)28.0001, (rdpi_real_t)27.00011, (rdpi_real_t)25.00009};
    const rdpi_real_t below[PLAYS] = {(rdpi_real_t)-34.0001, -34, -34};
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, above));
    SAME(given.params.max_V, axis.drive_V);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, below));
    SAME(given.params.min_V, axis.drive_V);
}

/* 1e-5 of the largest threshold and of the state before. */
void test_memory_may_depart_by_as_much_as_rounding_leaves(void)
{
    const rdpi_real_t at_zero[PLAYS] = {0, (rdpi_real_t)1.000025, 1}, beyond[PLAYS] = {0, (rdpi_real_t)1.00004, 1};
    const rdpi_real_t at_20[PLAYS] = {20, (rdpi_real_t)21.0002, 20}, beyond_20[PLAYS] = {20, (rdpi_real_t)21.0003, 20};
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, at_zero));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, rdpi_f32_set_memory(&axis, beyond));
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, at_20));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_MEMORY, rdpi_f32_set_memory(&axis, beyond_20));
}

void test_set_memory_refuses_states_that_are_not_finite_and_changes_nothing(void)
{
    rdpi_real_t y_um[PLAYS];
    set3(y_um, NAN, 0, 0);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, 0, 0, NAN);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, INFINITY, 0, 0);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, 0, -INFINITY, 0);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, 0, 0, INFINITY);
    memory_refused(RDPI_ERR_MEMORY, y_um);
}

void test_set_memory_refuses_states_too_far_apart_and_changes_nothing(void)
{
    rdpi_real_t y_um[PLAYS];
    set3(y_um, 3, (rdpi_real_t)1.9375, 0);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, 3, (rdpi_real_t)4.0625, 4);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, 3, 2, (rdpi_real_t)-0.0625);
    memory_refused(RDPI_ERR_MEMORY, y_um);
}

void test_set_memory_refuses_a_drive_outside_the_range_and_changes_nothing(void)
{
    rdpi_real_t y_um[PLAYS];
    set3(y_um, (rdpi_real_t)28.0625, 28, 28);
    memory_refused(RDPI_ERR_MEMORY, y_um);
    set3(y_um, (rdpi_real_t)-34.0625, -34, -34);
    memory_refused(RDPI_ERR_MEMORY, y_um);
}
