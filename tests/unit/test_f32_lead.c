/* rdpi_f32_chain: the lead. */
#include "unity.h"

#include "rdpi/f32_chain.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")
TEST_SOURCE_FILE("lib/src/rdpi_f32_chain.c")

#include "chain_f32.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

#define ONLY_LEAD 0
#define LEAD_AND_CREEP 1

/* Creep that adds nothing: the lead in front of it is compiled apart. */
static void lead_for(int part)
{
    setUp();
    params.lead_s = 3 * T_S;
    params.lead_s2 = 2 * T_S * T_S;
    if (part == LEAD_AND_CREEP) {
        add_pole(0, 1);
    }
}

/* ---- the formula ---- */

static double parabola(double samples)
{
    return -20 + 0.5 * samples + 0.125 * samples * samples;
}

/* r + alpha r' + beta r'' at t + D. Differences of second order know a parabola exactly. */
static void follows_a_parabola(double delay, double alpha, double beta, int preview)
{
    params.delay_s = (rdpi_real_t)delay * T_S;
    params.lead_s = (rdpi_real_t)alpha * T_S;
    params.lead_s2 = (rdpi_real_t)beta * T_S * T_S;
    params.preview = (uint16_t)preview;
    start();
    int ahead = preview ? (int)floor(delay + 0.5) + 1 : 0;
    TEST_ASSERT_EQUAL_UINT32(ahead, chain.preview_samples);
    for (int k = 0; k < 12; k++) {
        double drive_V = step(parabola(k + ahead)), at = k + delay;
        if (k >= 2) {
            WITHIN(4e-5, parabola(at) + alpha * (0.5 + 0.25 * at) + beta * 0.25, drive_V);
        }
    }
    TEST_ASSERT_EQUAL_UINT32(0, chain.axis.clip_count);
}

void test_lead_is_exact_for_a_parabola_with_preview_and_without(void)
{
    const double cases[][3] = {{2, 0, 0}, {1.25, 0, 0}, {0.5, 0, 0}, {0.375, 2, 0}, {0, 1.5, 0},
                               {0, 0, 3}, {2.75, 1, 2}, {5, 0.25, 0.5}};
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        for (int preview = 0; preview < 2; preview++) {
            for (int part = ONLY_LEAD; part <= LEAD_AND_CREEP; part++) {
                lead_for(part);
                follows_a_parabola(cases[k][0], cases[k][1], cases[k][2], preview);
            }
        }
    }
}

void test_a_delay_of_whole_samples_is_a_shift(void)
{
    params.delay_s = 3 * T_S;
    start();
    TEST_ASSERT_EQUAL_UINT32(4, chain.preview_samples);
    double before_um = 5;
    (void)step(before_um);
    for (int k = 0; k < 20; k++) {
        double reference_um = k * k % 7;
        EQUAL(before_um, step(reference_um));
        before_um = reference_um;
    }
}

void test_a_reference_at_rest_passes_the_lead_unchanged(void)
{
    for (int part = ONLY_LEAD; part <= LEAD_AND_CREEP; part++) {
        lead_for(part);
        start();
        for (int k = 0; k < 5; k++) {
            EQUAL(12.5, step(12.5));
            TEST_ASSERT_EQUAL_UINT32(0, chain.axis.flags);
        }
    }
}

/* ---- jumps ---- */

void test_nothing_rings_on_after_a_jump(void)
{
    for (int part = ONLY_LEAD; part <= LEAD_AND_CREEP; part++) {
        for (int preview = 0; preview < 2; preview++) {
            lead_for(part);
            params.max_lead_um = 3;
            params.preview = (uint16_t)preview;
            start();
            for (int k = 0; k < 4; k++) {
                (void)step(-1);
            }
            int behind = preview; /* with preview, the jump comes when it is due */
            double first_V = step(7), second_V = step(7), third_V = step(7);
            EQUAL((behind ? -1 : 7) + 3, first_V);
            EQUAL(7 - 3, second_V);
            EQUAL(7, third_V);
            EQUAL(7, step(7));
            TEST_ASSERT_EQUAL_UINT32(0, chain.axis.flags);
        }
    }
}

void test_the_lead_is_limited_flagged_and_counted_once(void)
{
    for (int part = ONLY_LEAD; part <= LEAD_AND_CREEP; part++) {
        lead_for(part);
        params.max_lead_um = 2;
        start();
        (void)step(0);
        (void)step(0);
        EQUAL(2, step(1)); /* 1.5 + 2 */
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_LEAD, chain.axis.flags);
        TEST_ASSERT_EQUAL_UINT32(1, chain.axis.clip_count);
        EQUAL(0.5, step(1)); /* 1.5 - 2 is within */
        TEST_ASSERT_EQUAL_UINT32(0, chain.axis.flags);
        EQUAL(1 - 2, step(-1)); /* -3 - 4 */
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_LEAD, chain.axis.flags);
        TEST_ASSERT_EQUAL_UINT32(2, chain.axis.clip_count);
        (void)step(1000);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_LEAD, chain.axis.flags);
        (void)step(2000);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_LEAD | RDPI_FLAG_RANGE, chain.axis.flags);
        TEST_ASSERT_EQUAL_UINT32(4, chain.axis.clip_count);
    }
}

void test_clip_count_stays_at_its_largest_value(void)
{
    lead_for(ONLY_LEAD);
    params.max_lead_um = 2;
    start();
    (void)step(0);
    chain.axis.clip_count = UINT32_MAX - 1u;
    for (int k = 1; k < 4; k++) {
        (void)step(k % 2 * 10);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_LEAD, chain.axis.flags);
        TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, chain.axis.clip_count);
    }
}

void test_a_lead_as_large_as_its_limit_is_not_flagged(void)
{
    for (int part = ONLY_LEAD; part <= LEAD_AND_CREEP; part++) {
        lead_for(part);
        params.max_lead_um = (rdpi_real_t)3.5;
        start();
        (void)step(0);
        EQUAL(3.5, step(1));
        TEST_ASSERT_EQUAL_UINT32(0, chain.axis.flags);
    }
}

/* ---- history ---- */

void test_the_first_reference_has_no_lead_and_the_second_takes_rest_before_it(void)
{
    for (int part = ONLY_LEAD; part <= LEAD_AND_CREEP; part++) {
        lead_for(part);
        start();
        EQUAL(10, step(10));
        EQUAL(10 + 1.5 + 2, step(11));
        rdpi_f32_chain_reset(&chain);
        EQUAL(-10, step(-10));
    }
}

static void refused_reference_is_held(rdpi_real_t bad_um, int part)
{
    rdpi_f32_lead_t before;
    lead_for(part);
    start();
    for (int k = 0; k < 5; k++) {
        EQUAL(k == 0 ? 0 : k == 1 ? 3.5 : k - 1 + 3, step(k)); /* z = u_(k-1) + 3 */
    }
    before = chain.lead;
    double drive_V = (double)chain.axis.drive_V;
    for (int k = 5; k < 8; k++) {
        EQUAL(drive_V, step((double)bad_um));
        TEST_ASSERT_TRUE(chain.axis.flags == RDPI_FLAG_INPUT);
        TEST_ASSERT_EQUAL_MEMORY(&before, &chain.lead, sizeof before);
    }
    EQUAL(7 + 3, step(8)); /* the ramp goes on */
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, chain.axis.flags);
    EQUAL(8 + 3, step(9));
    TEST_ASSERT_EQUAL_UINT32(0, chain.axis.flags);
    TEST_ASSERT_EQUAL_UINT32(3, chain.axis.input_count);
}

void test_references_that_cannot_be_used_change_nothing_and_count_as_missed(void)
{
    const rdpi_real_t bad[] = {NAN, INFINITY, -INFINITY, (rdpi_real_t)1000001, (rdpi_real_t)-1e30};
    for (size_t k = 0; k < sizeof bad / sizeof bad[0]; k++) {
        refused_reference_is_held(bad[k], ONLY_LEAD);
        refused_reference_is_held(bad[k], LEAD_AND_CREEP);
    }
}

/* Where the lead is too small to notice it. */
void test_a_reference_beyond_the_largest_is_refused_by_a_pure_delay_too(void)
{
    params.delay_s = 2 * T_S;
    start();
    EQUAL(4, step(4));
    EQUAL(4, step((double)RDPI_MAX_REFERENCE_UM + 1));
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, chain.axis.flags);
}

void test_an_unusable_first_reference_starts_no_history(void)
{
    for (int part = ONLY_LEAD; part <= LEAD_AND_CREEP; part++) {
        lead_for(part);
        start();
        EQUAL(0, step(NAN));
        EQUAL(10, step(10));
    }
}

void test_missed_references_lie_on_a_straight_line(void)
{
    for (int part = ONLY_LEAD; part <= LEAD_AND_CREEP; part++) {
        for (uint32_t missed = 1; missed <= RDPI_MAX_MISSED; missed++) {
            lead_for(part);
            start();
            (void)step(-3);
            (void)step(0.25);
            rdpi_f32_chain_missed(&chain, missed);
            double to_um = 0.25 * (missed + 2);
            EQUAL(to_um - 0.25 + 3 * 0.25, step(to_um)); /* a = 3, no bend */
            EQUAL(to_um + 3 * 0.25, step(to_um + 0.25));
            TEST_ASSERT_EQUAL_UINT32(0, chain.axis.flags);
        }
    }
}

void test_after_too_many_missed_samples_the_reference_is_a_first_one(void)
{
    for (int part = ONLY_LEAD; part <= LEAD_AND_CREEP; part++) {
        lead_for(part);
        start();
        (void)step(0);
        (void)step(1);
        rdpi_f32_chain_missed(&chain, RDPI_MAX_MISSED + 1u);
        EQUAL(30, step(30));
        EQUAL(30 + 1.5 + 2, step(31));
    }
}

void test_a_resonance_without_damping_rings_too(void)
{
    params.lead_s2 = T_S * T_S;
    start();
    (void)step(0);
    EQUAL(16, step(16)); /* the reference before that, and 16 for the jump */
}
