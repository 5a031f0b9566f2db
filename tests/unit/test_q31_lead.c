/* rdpi_q31_chain: the lead, and a chain that has nothing to do. */
#include "unity.h"

#include "rdpi/q31_chain.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")
TEST_SOURCE_FILE("lib/src/rdpi_q31_chain.c")

#include "chain_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* A reference of second order, and as many samples later. */
static double parabola(double sample)
{
    return 3 * U + 5000.0 * sample + 640.0 * sample * sample;
}

/* The drive is the reference with a and b, so many samples, at the present sample and one delay later. */
static void leads_the_parabola(double a, double b, double delay)
{
    start();
    for (int k = 0; k < 100; k++) {
        int32_t ahead = (int32_t)parabola(k + (double)chain.preview_samples);
        double slope = 5000 + 2 * 640.0 * (k + delay);
        double expected = parabola(k + delay) + a * slope + b * 2 * 640;
        if (k < 2) {
            rdpi_q31_chain_step(&chain, ahead); /* no history yet */
        } else {
            drives(expected, ahead);
        }
        TEST_ASSERT_EQUAL_HEX32(0, chain.axis.flags);
    }
}

void test_nothing_to_do_is_the_operator_alone(void)
{
    rdpi_q31_t alone;
    int32_t alone_y[RDPI_MAX_PLAYS], chain_y[RDPI_MAX_PLAYS];
    actuator_q31_codes(&actuator, 14, false);
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_q31_init(&alone, &actuator.params, T_NS));
    for (int k = 0; k < 3000; k++) {
        int32_t reference = k % 17 == 5 ? NONE : random_size(INT32_MAX, 12);
        if (k % 31 == 0) {
            rdpi_q31_missed(&alone, (uint32_t)k);
            rdpi_q31_chain_missed(&chain, (uint32_t)k);
        }
        TEST_ASSERT_EQUAL_INT32(rdpi_q31_step(&alone, reference), rdpi_q31_chain_step(&chain, reference));
        TEST_ASSERT_EQUAL_INT32(alone.rate, chain.axis.rate);
        TEST_ASSERT_EQUAL_UINT32(alone.dac_code, chain.axis.dac_code);
        TEST_ASSERT_EQUAL_HEX32(alone.flags, chain.axis.flags);
        TEST_ASSERT_EQUAL_UINT32(alone.input_count, chain.axis.input_count);
        TEST_ASSERT_EQUAL_UINT32(alone.missed_count, chain.axis.missed_count);
        rdpi_q31_get_memory(&alone, alone_y);
        rdpi_q31_get_memory(&chain.axis, chain_y);
        TEST_ASSERT_EQUAL_INT32_ARRAY(alone_y, chain_y, actuator.params.plays);
    }
}

void test_a_delay_of_whole_samples_is_preview_alone(void)
{
    given.delay_ns = 3 * T_NS;
    start();
    TEST_ASSERT_EQUAL_UINT32(4, chain.preview_samples);
    int32_t before = random_size(MAX, 8);
    rdpi_q31_chain_step(&chain, before);
    for (int k = 0; k < 1000; k++) {
        int32_t ahead = random_size(MAX, 8);
        drives(before, ahead);
        before = ahead;
    }
}

void test_a_delay_of_parts_of_a_sample(void)
{
    given.delay_ns = 9 * T_NS / 4;
    leads_the_parabola(0, 0, 2.25);
    given.delay_ns = 11 * T_NS / 4;
    leads_the_parabola(0, 0, 2.75);
    given.delay_ns = T_NS / 4;
    leads_the_parabola(0, 0, 0.25);
}

void test_a_lag_a_resonance_and_both_with_a_delay(void)
{
    given.lead_ns = 5 * T_NS / 2;
    leads_the_parabola(2.5, 0, 0);
    given.lead_ns2 = (uint64_t)12 * T_NS * T_NS;
    leads_the_parabola(2.5, 12, 0);
    given.lead_ns = 0;
    leads_the_parabola(0, 12, 0);
    given.lead_ns = 5 * T_NS / 2;
    given.delay_ns = 7 * T_NS / 4;
    leads_the_parabola(2.5, 12, 1.75);
}

void test_without_preview_the_future_is_extrapolated(void)
{
    given.preview = 0;
    given.delay_ns = 7 * T_NS / 4;
    leads_the_parabola(0, 0, 1.75);
    given.lead_ns = 5 * T_NS / 2;
    leads_the_parabola(2.5, 0, 1.75);
    given.lead_ns2 = (uint64_t)12 * T_NS * T_NS;
    leads_the_parabola(2.5, 12, 1.75);
    given.lead_ns = given.delay_ns = 0;
    leads_the_parabola(0, 12, 0);
}

/* On a straight line, `a` samples ahead of each. */
static void leads_the_line(int32_t from, double a)
{
    for (int k = 0; k < 10; k++) {
        drives(from + (k + a) * 6000, from + (k + (int32_t)chain.preview_samples) * 6000);
    }
}

static void leads_after(uint32_t missed, double a)
{
    start();
    rdpi_q31_chain_step(&chain, -12000 + (int32_t)chain.preview_samples * 6000);
    rdpi_q31_chain_step(&chain, -6000 + (int32_t)chain.preview_samples * 6000);
    leads_the_line(0, a);
    rdpi_q31_chain_missed(&chain, missed);
    leads_the_line((10 + (int32_t)missed) * 6000, a);
    rdpi_q31_chain_step(&chain, NONE); /* one more */
    leads_the_line((21 + (int32_t)missed) * 6000, a);
}

void test_missed_and_refused_samples_are_taken_to_lie_on_a_straight_line(void)
{
    given.lead_ns = 5 * T_NS / 2;
    given.lead_ns2 = (uint64_t)12 * T_NS * T_NS;
    leads_after(1, 2.5);
    leads_after(7, 2.5);
    leads_after(RDPI_MAX_MISSED, 2.5);
    given.preview = 0;
    leads_after(7, 2.5);
}

void test_missed_samples_of_a_falling_reference(void)
{
    given.lead_ns = 2 * T_NS;
    start();
    rdpi_q31_chain_step(&chain, 9900);
    drives(9900 - 900, 9000);
    drives(9000 - 2 * 900, 9000 - 900);
    rdpi_q31_chain_missed(&chain, 3);
    drives(9000 - 4 * 900 - 2 * 900, 9000 - 5 * 900);
}

static void forgets_history(void)
{
    drives(-5 * U, -5 * U);
    TEST_ASSERT_EQUAL_HEX32(0, chain.axis.flags & RDPI_FLAG_LEAD);
    rdpi_q31_chain_step(&chain, 6 * U);
    TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_LEAD, chain.axis.flags & RDPI_FLAG_LEAD);
}

void test_without_history_there_is_no_lead(void)
{
    given.lead_ns = 50 * T_NS;
    start();
    forgets_history();
    rdpi_q31_chain_reset(&chain);
    forgets_history();
    rdpi_q31_chain_settle(&chain);
    forgets_history();
    rdpi_q31_chain_missed(&chain, RDPI_MAX_MISSED + 1u);
    forgets_history();
    rdpi_q31_chain_sweep(&chain);
    forgets_history();
}

/* After a jump the lead is limited, and after three samples nothing is left of it. */
static void limited_after_a_jump(int32_t from, int32_t to, int32_t side)
{
    start();
    drives(from, from);
    drives(from, from);
    drives(from + side * given.max_lead, to);
    TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_LEAD, chain.axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, chain.axis.clip_count);
    drives(to - side * given.max_lead, to);
    TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_LEAD, chain.axis.flags);
    TEST_ASSERT_EQUAL_UINT32(2, chain.axis.clip_count);
    drives(to, to);
    TEST_ASSERT_EQUAL_HEX32(0, chain.axis.flags);
    TEST_ASSERT_EQUAL_UINT32(2, chain.axis.clip_count);
}

void test_the_lead_is_limited_and_rings_not_on(void)
{
    given.lead_ns2 = (uint64_t)100 * T_NS * T_NS;
    limited_after_a_jump(0, 100 * U, 1);
    limited_after_a_jump(100 * U, -200 * U, -1);
}

void test_the_largest_lead_is_not_limited(void)
{
    given.lead_ns = 2 * T_NS;
    given.max_lead = 6 * U;
    start();
    rdpi_q31_chain_step(&chain, 0);
    drives(3 * U, 3 * U); /* 2 (3 + 0) / 2 = 3 */
    drives(3 * U + 6 * U, 6 * U);
    TEST_ASSERT_EQUAL_HEX32(0, chain.axis.flags);
    drives(6 * U + 6 * U, 9 * U + 1);
    TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_LEAD, chain.axis.flags);
}

void test_a_sample_counts_once_whatever_clips_it(void)
{
    given.lead_ns = 50 * T_NS;
    start();
    rdpi_q31_chain_step(&chain, 0);
    rdpi_q31_chain_step(&chain, 0);
    rdpi_q31_chain_step(&chain, MAX);
    rdpi_q31_chain_step(&chain, MAX);
    TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_LEAD | RDPI_FLAG_RANGE, chain.axis.flags);
    TEST_ASSERT_EQUAL_UINT32(2, chain.axis.clip_count);
    TEST_ASSERT_EQUAL_INT32(MAX, chain.axis.drive);

    actuator.params.slew_per_us = actuator.params.sweep_per_us; /* 64 U a sample */
    given.max_lead = 65 * U;
    start();
    rdpi_q31_chain_step(&chain, 0);
    rdpi_q31_chain_step(&chain, MAX);
    TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_LEAD | RDPI_FLAG_SLEW, chain.axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, chain.axis.clip_count);
}

void test_clip_count_stays_at_its_largest_value(void)
{
    given.lead_ns = 50 * T_NS;
    start();
    rdpi_q31_chain_step(&chain, 0);
    chain.axis.clip_count = UINT32_MAX - 1u;
    for (int k = 0; k < 3; k++) {
        rdpi_q31_chain_step(&chain, 10 * (k + 1) * U);
        TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_LEAD, chain.axis.flags & RDPI_FLAG_LEAD);
        TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, chain.axis.clip_count);
    }
}

void test_a_reference_that_is_not_usable_holds_the_drive(void)
{
    given.lead_ns = 50 * T_NS;
    start();
    rdpi_q31_chain_step(&chain, 0);
    rdpi_q31_chain_step(&chain, U / 16);
    int32_t drive = chain.axis.drive;
    TEST_ASSERT_EQUAL_INT32(drive, rdpi_q31_chain_step(&chain, NONE));
    TEST_ASSERT_EQUAL_HEX32(RDPI_FLAG_INPUT, chain.axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, chain.axis.input_count);
    TEST_ASSERT_EQUAL_UINT32(0, chain.axis.clip_count);
}

/* The largest references and the largest lead: all saturates, nothing wraps. */
static void saturates(int32_t side, int32_t first, int32_t second)
{
    start();
    drives(-side * MAX, -side * INT32_MAX);
    drives(side * first, side * INT32_MAX);
    TEST_ASSERT_EQUAL_INT32(side * INT32_MAX, chain.lead.before);
    drives(side * second, -side * INT32_MAX);
    TEST_ASSERT_EQUAL_INT32(-side * INT32_MAX, chain.lead.before);
}

void test_the_lead_saturates(void)
{
    given.max_lead = INT32_MAX;
    given.lead_ns = RDPI_Q31_MAX_LEAD_NS;
    given.lead_ns2 = RDPI_Q31_MAX_LEAD_NS2;
    saturates(1, 0, 0); /* at the sample before the jump, which was as far on the other side */
    saturates(-1, 0, 0);
    given.preview = 0;
    saturates(1, MAX, -MAX);
    saturates(-1, MAX, -MAX);
}

void test_a_lead_too_small_for_its_format_is_none(void)
{
    given.lead_ns2 = 1;
    TEST_ASSERT_EQUAL_INT(RDPI_OK, init_for(UINT32_MAX));
    TEST_ASSERT_EQUAL_INT32(0, chain.lead.per_sum);
    drives(-MAX, -MAX);
    drives(-MAX, MAX);
    drives(MAX, MAX);
    given.lead_ns = 1000000;
    TEST_ASSERT_EQUAL_INT(RDPI_OK, init_for(T_NS));
    TEST_ASSERT_EQUAL_INT32(0, chain.lead.per_change);
}
