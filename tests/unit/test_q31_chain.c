/* rdpi_q31_chain_init: what it refuses, and the digest. */
#include "unity.h"

#include "rdpi/q31_chain.h"

TEST_SOURCE_FILE("lib/src/rdpi_q31.c")
TEST_SOURCE_FILE("lib/src/rdpi_q31_chain.c")

#include "chain_q31.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

static void refused(rdpi_status_t status)
{
    TEST_ASSERT_EQUAL_INT(status, init_for(T_NS));
}

static void refused_as_they_are(rdpi_status_t status)
{
    TEST_ASSERT_EQUAL_INT(status, rdpi_q31_chain_init(&chain, &given, T_NS));
}

void test_init_refuses_null(void)
{
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_q31_chain_init(NULL, &given, T_NS));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_q31_chain_init(&chain, NULL, T_NS));
    given.axis = NULL;
    refused(RDPI_ERR_NULL);
}

void test_init_refuses_no_poles_where_there_should_be_some(void)
{
    given.pole = NULL;
    start();
    given.poles = 1;
    refused_as_they_are(RDPI_ERR_NULL);
}

void test_init_refuses_a_caller_of_another_layout(void)
{
    seal();
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SIZE,
                          rdpi_q31_chain_init_layout(RDPI_Q31_CHAIN_LAYOUT + 1u, &chain, &given, T_NS));
    TEST_ASSERT_EQUAL_UINT32(0, rdpi_q31_chain_digest_layout(RDPI_Q31_CHAIN_LAYOUT + 1u, &given));
    TEST_ASSERT_EQUAL_UINT32(given.digest, rdpi_q31_chain_digest_layout(RDPI_Q31_CHAIN_LAYOUT, &given));
}

void test_init_refuses_another_schema(void)
{
    given.schema--;
    refused(RDPI_ERR_SCHEMA);
}

void test_init_refuses_too_many_poles(void)
{
    for (size_t i = 0; i < RDPI_MAX_POLES; i++) {
        add_pole(1.0 / 64, 100);
    }
    start();
    add_pole(1.0 / 64, 100);
    refused(RDPI_ERR_COUNT);
}

void test_init_refuses_parameters_other_than_those_generated(void)
{
    const rdpi_q31_chain_params_t sealed = given;
    add_pole(0.25, 100);
    add_pole(0.125, 1e5);
    seal();
    uint32_t digest = given.digest;
    for (int k = 0; k < 11; k++) {
        given = sealed;
        given.poles = 2;
        seal();
        rdpi_q31_pole_t before = pole[1];
        given.lead_ns2 += k == 0 ? 1u : 0u;
        given.delay_ns += k == 1 ? 1u : 0u;
        given.lead_ns += k == 2 ? 1u : 0u;
        given.max_lead += k == 3 ? 1 : 0;
        given.direct -= k == 4 ? 1 : 0;
        given.preview = k == 5 ? 0 : 1;
        given.poles -= k == 6 ? 1 : 0;
        pole[1].share += k == 7 ? 1 : 0;
        pole[1].time_constant_ns += k == 8 ? 1 : 0;
        given.digest += k == 9 ? 1 : 0;
        refused_as_they_are(k < 10 ? RDPI_ERR_DIGEST : RDPI_OK);
        pole[1] = before;
    }
    given.digest = digest;
    refused_as_they_are(RDPI_OK);
}

void test_digest_of_the_chain_leaves_out_that_of_its_operator(void)
{
    start();
    actuator.params.digest++;
    TEST_ASSERT_EQUAL_UINT32(given.digest, rdpi_q31_chain_digest(&given));
    refused_as_they_are(RDPI_ERR_DIGEST);
}

void test_init_refuses_what_the_operator_refuses(void)
{
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, init_for(0));
    actuator.play[0].slope = 0;
    refused(RDPI_ERR_SLOPES);
}

void test_init_refuses_a_delay_beyond_its_format(void)
{
    given.delay_ns = RDPI_Q31_MAX_LEAD_NS;
    start();
    given.delay_ns++;
    refused(RDPI_ERR_CHAIN);
}

void test_init_refuses_a_lead_beyond_its_format(void)
{
    given.lead_ns = RDPI_Q31_MAX_LEAD_NS;
    start();
    given.lead_ns++;
    refused(RDPI_ERR_CHAIN);
}

void test_init_refuses_a_lead_of_second_order_beyond_its_format(void)
{
    given.lead_ns2 = RDPI_Q31_MAX_LEAD_NS2;
    start();
    given.lead_ns2++;
    refused(RDPI_ERR_CHAIN);
}

void test_init_refuses_a_lead_that_may_add_nothing(void)
{
    given.max_lead = 1;
    start();
    given.max_lead = 0;
    refused(RDPI_ERR_CHAIN);
    given.max_lead = -1;
    refused(RDPI_ERR_CHAIN);
}

void test_init_refuses_another_kind_of_preview(void)
{
    given.preview = 0;
    start();
    given.preview = 2;
    refused(RDPI_ERR_CHAIN);
}

void test_init_refuses_a_lead_that_multiplies_too_much(void)
{
    given.lead_ns2 = (uint64_t)1 << 28;
    TEST_ASSERT_EQUAL_INT(RDPI_OK, init_for(1));
    given.lead_ns2 = (uint64_t)1 << 29;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_CHAIN, init_for(1));
    given.lead_ns2 = 0;
    given.preview = 0;
    given.lead_ns = ((uint32_t)1 << 29) - 1u;
    TEST_ASSERT_EQUAL_INT(RDPI_OK, init_for(1));
    given.lead_ns++;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_CHAIN, init_for(1));
}

void test_init_refuses_too_small_a_share_that_comes_at_once(void)
{
    given.direct = RDPI_Q31_MIN_DIRECT;
    start();
    add_pole(0.25, 100);
    start();
    given.direct--;
    refused(RDPI_ERR_CHAIN);
    given.direct = RDPI_Q31_MIN_DIRECT + ONE / 4;
    pole[0].share = -ONE / 4;
    start();
    pole[0].share--;
    refused(RDPI_ERR_CHAIN);
}

void test_init_refuses_shares_whose_magnitudes_add_up_to_more_than_two(void)
{
    add_pole(0.5, 100);
    add_pole(-0.5, 1e5);
    given.direct = ONE;
    start();
    given.direct++;
    refused(RDPI_ERR_CHAIN);
    given.direct--;
    pole[1].share--;
    refused(RDPI_ERR_CHAIN);
    pole[1].share = INT32_MIN;
    refused(RDPI_ERR_CHAIN);
}

void test_init_refuses_a_time_constant_of_nothing(void)
{
    add_pole(0.5, 100);
    add_pole(0.25, 100);
    start();
    pole[1].time_constant_ns = 1;
    start();
    pole[1].time_constant_ns = 0;
    refused(RDPI_ERR_CHAIN);
}

void test_preview_samples_are_the_delay_and_one_more(void)
{
    start();
    TEST_ASSERT_EQUAL_UINT32(0, chain.preview_samples);
    const uint32_t samples[][2] = {{1, 1}, {T_NS / 2 - 1, 1}, {T_NS / 2, 2}, {T_NS, 2}, {7 * T_NS, 8}};
    for (size_t k = 0; k < 5; k++) {
        given.delay_ns = samples[k][0];
        start();
        TEST_ASSERT_EQUAL_UINT32(samples[k][1], chain.preview_samples);
    }
    given.preview = 0;
    start();
    TEST_ASSERT_EQUAL_UINT32(0, chain.preview_samples);
    given.preview = 1;
    given.delay_ns = 0;
    given.lead_ns = 1;
    start();
    TEST_ASSERT_EQUAL_UINT32(1, chain.preview_samples);
    given.lead_ns = 0;
    given.lead_ns2 = 1;
    start();
    TEST_ASSERT_EQUAL_UINT32(1, chain.preview_samples);
}
