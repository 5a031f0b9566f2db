/* rdpi_q31_chain: lag^-1, the lead of the drive. */
#include "unity.h"

#include "rdpi/q31_chain.h"
#include "q31_unlag.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")
TEST_SOURCE_FILE("lib/src/rdpi_q31_chain.c")

#include "chain_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

#define LAG 4 /* samples */

static void start_with_lag(int preview)
{
    given.lag_ns = LAG * T_NS;
    given.preview = (uint16_t)preview;
    start();
    TEST_ASSERT_EQUAL_UINT32(preview, chain.preview_samples);
}

static void ahead(int32_t reference)
{
    (void)rdpi_q31_chain_step(&chain, reference);
}

/* The operator rounds what it asks for by a unit or two. */
static void leads_to(double expected, int32_t reference)
{
    TEST_ASSERT_DOUBLE_WITHIN(4 + 2 * LAG, expected, rdpi_q31_chain_step(&chain, reference));
}

void test_a_ramp_is_led_by_the_lag(void)
{
    for (int preview = 0; preview < 2; preview++) {
        for (int way = -1; way <= 1; way += 2) {
            setUp();
            start_with_lag(preview);
            for (int k = 0; k < 8; k++) {
                int32_t reference = way * U / 4 * (k + preview);
                if (k < 2) {
                    ahead(reference);
                } else {
                    leads_to(way * U / 4 * (double)(k + LAG), reference);
                }
            }
            TEST_ASSERT_EQUAL_UINT32(0, chain.axis.clip_count);
        }
    }
}

void test_the_slope_is_the_mean_of_two_but_at_most_twice_the_smaller(void)
{
    for (int way = -1; way <= 1; way += 2) {
        setUp();
        start_with_lag(1);
        int32_t V = way * U / 4;
        ahead(0);
        ahead(V);
        leads_to(V * (1 + LAG * 1.5), 3 * V);
        leads_to(V * (3 + LAG * 4.0), 11 * V);
        leads_to(V * (11 + LAG * 2.0), 12 * V);
        leads_to(V * 12.0, 11 * V);
        leads_to(V * (11 - LAG * 1.5), 9 * V);
    }
}

void test_a_jump_has_no_lead(void)
{
    start_with_lag(1);
    ahead(0);
    leads_to(0, 16 * U);
    leads_to(16 * U, 16 * U);
    leads_to(16 * U, 16 * U);
}

void test_range_and_slew_are_kept_flagged_and_counted(void)
{
    start_with_lag(1);
    ahead(0);
    ahead(MAX / 4);
    leads_to(MAX, MAX / 2);
    TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_LEAD, chain.axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, chain.axis.clip_count);
    for (int way = -1; way <= 1; way += 2) {
        setUp();
        actuator.params.slew_per_us = actuator.params.sweep_per_us; /* MAX / 8 a sample */
        start_with_lag(1);
        int32_t V = way * (MAX / 24);
        ahead(0);
        ahead(V);
        leads_to(3.0 * V, 2 * V); /* 1 + 4 */
        TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_LEAD, chain.axis.flags);
        leads_to(6.0 * V, 3 * V);
    }
}

/* A quarter of a code per sample: rounded to codes in between, the drive would never leave one. */
void test_a_slow_slew_gets_from_code_to_code(void)
{
    for (int way = -1; way <= 1; way += 2) {
        setUp();
        actuator_q31_codes(&actuator, 10, false);
        actuator.params.slew_per_us = actuator.params.sweep_per_us; /* MAX / 8 a sample */
        start_with_lag(1);
        const int32_t code = MAX / 1023 * 2;
        chain.axis.slew = (int64_t)code * (1 << 30);
        int32_t from = chain.axis.drive;
        for (int k = 1; k <= 400; k++) { /* as ever, it begins a sample late */
            ahead(way * (MAX / 2));
            int32_t expected = from + way * (k > 1 ? k - 1 : k) * (code / 4);
            TEST_ASSERT_INT32_WITHIN(code / 2 + code / 50, expected, chain.axis.drive);
        }
        TEST_ASSERT_EQUAL_UINT32(400, chain.axis.clip_count);
    }
}

void test_a_sweep_begins_at_what_was_output(void)
{
    actuator.params.slew_per_us = actuator.params.sweep_per_us; /* MAX / 8 a sample */
    start_with_lag(1);
    for (int k = 0; k < 8; k++) {
        ahead(MAX / 32 * k);
    }
    int32_t before = chain.axis.drive;
    TEST_ASSERT_INT32_WITHIN(100, MAX / 32 * (6 + LAG), before);
    (void)rdpi_q31_chain_sweep(&chain);
    TEST_ASSERT_INT32_WITHIN(100, MAX / 8, chain.axis.drive > before ? chain.axis.drive - before : before - chain.axis.drive);
}

void test_a_reference_that_is_not_usable_holds_what_was_output(void)
{
    actuator_q31_codes(&actuator, 14, false);
    start_with_lag(1);
    ahead(0);
    ahead(U);
    ahead(2 * U);
    int32_t led = chain.axis.drive;
    uint32_t code = chain.axis.dac_code;
    for (int k = 0; k < 2; k++) {
        TEST_ASSERT_EQUAL_INT32(led, rdpi_q31_chain_step(&chain, NONE));
        TEST_ASSERT_EQUAL_UINT32(code, chain.axis.dac_code);
        TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_INPUT, chain.axis.flags);
    }
    ahead(5 * U); /* two were missed: a straight line */
    TEST_ASSERT_INT32_WITHIN(MAX >> 13, (4 + LAG) * U, chain.axis.drive);
}

void test_after_missed_samples_the_drive_lies_on_a_straight_line(void)
{
    start_with_lag(1);
    ahead(0);
    ahead(U);
    rdpi_q31_chain_missed(&chain, 3);
    leads_to((7 + LAG * 2.0) * U, 9 * U);
    rdpi_q31_chain_missed(&chain, 1);
    leads_to((8 - LAG * 1.0) * U, 7 * U); /* and down again */
    rdpi_q31_chain_missed(&chain, RDPI_MAX_MISSED + 1u);
    leads_to(30.0 * U, 30 * U); /* a first one */
}

void test_what_is_output_is_a_code_and_slow_motion_has_its_lead(void)
{
    for (int shaping = 0; shaping <= RDPI_NOISE_SHAPING; shaping++) {
        setUp();
        actuator_q31_codes(&actuator, 10, false);
        actuator.params.noise_shaping = (uint8_t)shaping;
        start_with_lag(1);
        const int32_t code = MAX / 1023 * 2, slope = code / 12;
        double sum = 0;
        for (int k = 0; k < 2000; k++) {
            ahead(slope * (k + 1));
            double off = chain.axis.drive - (double)slope * (k + LAG * (k > 1));
            TEST_ASSERT_DOUBLE_WITHIN(code * (shaping ? 1.01 : 0.51), 0, off);
            sum += off;
        }
        TEST_ASSERT_DOUBLE_WITHIN(code * (shaping ? 0.005 : 0.05), 0, sum / 2000);
    }
}

void test_codes_of_a_drive_at_rest_are_right_in_the_mean_with_noise_shaping(void)
{
    actuator_q31_codes(&actuator, 10, false);
    actuator.params.noise_shaping = RDPI_NOISE_SHAPING;
    start_with_lag(1);
    const int32_t code = MAX / 1023 * 2, wish = code / 4;
    double sum = 0;
    for (int k = 0; k < 1002; k++) {
        ahead(wish);
        sum += k > 1 ? chain.axis.drive - (double)wish : 0;
    }
    TEST_ASSERT_DOUBLE_WITHIN(code * (RDPI_NOISE_SHAPING ? 0.01 : 0.51), 0, sum / 1000);
}

void test_nothing_is_carried_over_a_clip(void)
{
    actuator_q31_codes(&actuator, 8, false);
    actuator.params.noise_shaping = RDPI_NOISE_SHAPING;
    start_with_lag(1);
    ahead(U);
    ahead(MAX / 4 + U);
    ahead(MAX / 2 + U);
    TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_LEAD, chain.axis.flags);
    TEST_ASSERT_EQUAL_INT32(0, chain.unlag.carried);
}

void test_what_is_settled_carries_nothing(void)
{
    actuator_q31_codes(&actuator, 8, false);
    actuator.params.noise_shaping = RDPI_NOISE_SHAPING;
    start_with_lag(1);
    ahead(MAX / 255 / 3);
    TEST_ASSERT_TRUE(RDPI_NOISE_SHAPING == 0 || chain.unlag.carried != 0);
    rdpi_q31_chain_settle(&chain);
    TEST_ASSERT_EQUAL_INT32(0, chain.unlag.carried);
}

void test_a_slew_limit_that_is_just_reached_is_no_clip(void)
{
    actuator.params.slew_per_us = actuator.params.sweep_per_us; /* MAX / 8 a sample */
    start_with_lag(1);
    for (int way = -1; way <= 1; way += 2) {
        int32_t reach = (int32_t)(chain.axis.slew >> 32);
        chain.axis.slew = (int64_t)reach * ((int64_t)1 << 32);
        chain.unlag.ramp = 0;
        TEST_ASSERT_TRUE(rdpi_q31_unlag_output(&chain.unlag, &chain.axis, way * reach));
        TEST_ASSERT_EQUAL_INT32(way * reach, chain.axis.drive);
        chain.unlag.ramp = 0;
        TEST_ASSERT_FALSE(rdpi_q31_unlag_output(&chain.unlag, &chain.axis, way * (reach + 1)));
        TEST_ASSERT_EQUAL_INT32(way * reach, chain.axis.drive);
    }
}

void test_a_sweep_is_output_as_it_is(void)
{
    rdpi_q31_t alone;
    start_with_lag(1);
    for (int k = 0; k < 5; k++) {
        ahead(k * U);
    }
    rdpi_q31_chain_reset(&chain);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&alone, &actuator.params, T_NS));
    bool goes_on = true;
    while (goes_on) {
        goes_on = rdpi_q31_sweep(&alone);
        TEST_ASSERT_EQUAL_INT(goes_on, rdpi_q31_chain_sweep(&chain));
        TEST_ASSERT_EQUAL_INT32(alone.drive, chain.axis.drive);
    }
    leads_to(7.0 * U, 7 * U); /* the first has no lead */
}

void test_init_refuses_a_lag_that_does_not_fit(void)
{
    given.lag_ns = RDPI_Q31_MAX_LEAD_NS + 1u;
    seal();
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_CHAIN, rdpi_q31_chain_init(&chain, &given, T_NS));
    given.lag_ns = RDPI_Q31_MAX_LEAD_NS; /* of 2^29 samples of 1 ns */
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_CHAIN, init_for(1));
    TEST_ASSERT_EQUAL_INT(RDPI_OK, init_for(4));
}
