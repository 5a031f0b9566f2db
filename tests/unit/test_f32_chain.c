/* rdpi_f32_chain: what init refuses, what the chain passes on to the operator, reset, settling, the start-up sweep. */
#include "unity.h"

#include "rdpi/f32_chain.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")
TEST_SOURCE_FILE("lib/src/rdpi_f32_chain.c")

#include "chain_f32.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

static void lead_and_creep(void)
{
    params.delay_s = 3 * T_S;
    params.lead_s = T_S;
    params.lead_s2 = T_S * T_S;
    add_pole(0.25, 0.25);
    add_pole(0.25, 16);
}

/* ---- init ---- */

/* Every number, the last pole standing for all of them. */
#define NUMBERS 7

static rdpi_real_t *number(size_t k)
{
    rdpi_real_t *const numbers[NUMBERS] = {&params.delay_s, &params.lead_s, &params.lead_s2, &params.max_lead_um,
                                           &params.direct, &pole[1].share, &pole[1].time_constant_s};
    return numbers[k];
}

void test_init_refuses_a_caller_of_another_layout_before_all_else(void)
{
    const uint64_t others[] = {RDPI_F32_CHAIN_LAYOUT + 1u, RDPI_F32_LAYOUT, 0};
    for (size_t k = 0; k < sizeof others / sizeof others[0]; k++) {
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_SIZE, rdpi_f32_chain_init_layout(others[k], NULL, NULL, T_S));
    }
}

void test_init_refuses_null_pointers(void)
{
    lead_and_creep();
    start();
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_chain_init(NULL, &params, T_S));
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_chain_init(&chain, NULL, T_S));
    params.pole = NULL;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_chain_init(&chain, &params, T_S));
    params.pole = pole;
    params.axis = NULL;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_NULL, rdpi_f32_chain_init(&chain, &params, T_S));
}

void test_init_needs_no_array_of_poles_without_poles(void)
{
    start();
    params.pole = NULL;
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_chain_init(&chain, &params, T_S));
}

void test_init_refuses_another_schema(void)
{
    start();
    params.schema++;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SCHEMA, rdpi_f32_chain_init(&chain, &params, T_S));
}

void test_init_takes_as_many_poles_as_the_maximum_and_no_more(void)
{
    for (size_t i = 0; i < RDPI_MAX_POLES; i++) {
        add_pole(0.01, pow(4, (double)i - 4));
    }
    start();
    params.poles++;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_COUNT, rdpi_f32_chain_init(&chain, &params, T_S));
}

void test_init_refuses_what_the_operator_refuses(void)
{
    given.curve[0].gain_um_per_V = 0;
    refused(RDPI_ERR_GAIN);
    setUp();
    actuator_derive(&given);
    seal();
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_SAMPLE_TIME, rdpi_f32_chain_init(&chain, &params, 0));
}

void test_init_refuses_each_number_that_was_changed_after_the_digest(void)
{
    lead_and_creep();
    start();
    for (size_t k = 0; k < NUMBERS; k++) {
        rdpi_real_t good = *number(k);
        *number(k) = good * 2;
        TEST_ASSERT_EQUAL_INT(RDPI_ERR_DIGEST, rdpi_f32_chain_init(&chain, &params, T_S));
        *number(k) = good;
    }
    params.preview = 0;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_DIGEST, rdpi_f32_chain_init(&chain, &params, T_S));
    params.preview = 1;
    params.poles = 1;
    TEST_ASSERT_EQUAL_INT(RDPI_ERR_DIGEST, rdpi_f32_chain_init(&chain, &params, T_S));
    params.poles = 2;
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_chain_init(&chain, &params, T_S));
}

void test_digest_does_not_depend_on_addresses_and_schema(void)
{
    lead_and_creep();
    start();
    uint32_t digest = params.digest;
    rdpi_f32_pole_t copy[2] = {pole[0], pole[1]};
    params.schema++;
    params.digest++;
    params.axis = NULL;
    params.pole = copy;
    TEST_ASSERT_EQUAL_HEX32(digest, rdpi_f32_chain_digest(&params));
}

void test_digest_for_another_layout_is_0(void)
{
    start();
    TEST_ASSERT_NOT_EQUAL(0, rdpi_f32_chain_digest(&params));
    TEST_ASSERT_EQUAL_HEX32(0, rdpi_f32_chain_digest_layout(RDPI_F32_CHAIN_LAYOUT + 1u, &params));
}

void test_init_refuses_each_number_that_is_not_finite_or_too_large(void)
{
    const rdpi_real_t bad[] = {NAN, INFINITY, -INFINITY, (rdpi_real_t)1.00001e7, (rdpi_real_t)-1.00001e7};
    lead_and_creep();
    for (size_t i = 0; i < NUMBERS; i++) {
        rdpi_real_t good = *number(i);
        for (size_t k = 0; k < sizeof bad / sizeof bad[0]; k++) {
            *number(i) = bad[k];
            refused(RDPI_ERR_NOT_FINITE);
        }
        *number(i) = good;
    }
    start();
    pole[0].share = NAN;
    refused(RDPI_ERR_NOT_FINITE);
}

void test_init_refuses_negative_times_and_times_that_must_not_be_0(void)
{
    lead_and_creep();
    const struct {
        size_t number;
        double bad, good;
    } cases[] = {{0, -1e-9, 0}, {1, -1e-9, 0}, {2, -1e-9, 0}, {3, 0, 1e-9}, {6, 0, 1e-9}, {6, -1, 1}};
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        *number(cases[k].number) = (rdpi_real_t)cases[k].bad;
        refused(RDPI_ERR_CHAIN);
        *number(cases[k].number) = (rdpi_real_t)cases[k].good;
        start();
    }
    pole[0].time_constant_s = 0;
    refused(RDPI_ERR_CHAIN);
}

void test_init_refuses_a_preview_that_is_neither_0_nor_1(void)
{
    params.preview = 2;
    refused(RDPI_ERR_CHAIN);
}

void test_init_refuses_a_delay_of_more_samples_than_single_precision_counts(void)
{
    params.delay_s = 16384; /* 2^24 samples */
    refused(RDPI_ERR_CHAIN);
    params.preview = 0;
    refused(RDPI_ERR_CHAIN);
    params.delay_s = 16383;
    start();
    params.preview = 1;
    start();
    TEST_ASSERT_EQUAL_UINT32(16383u * 1024u + 1u, chain.preview_samples);
}

void test_init_refuses_creep_whose_inverse_may_be_unstable(void)
{
    add_pole(-0.5, 0.25);
    add_pole(4, 0.5);
    add_pole(-0.4995, 16);
    refused(RDPI_ERR_CHAIN);
    pole[2].share = (rdpi_real_t)-0.498;
    start();
    params.poles = 0;
    params.direct = (rdpi_real_t)0.0009;
    refused(RDPI_ERR_CHAIN);
}

/* ---- no effects ---- */

static void plain_does_what_the_operator_does(void)
{
    rdpi_f32_t axis;
    given.params.slew_V_per_s = 65536;
    given.params.max_V = 50;
    given.params.dac_bits = 12;
    start();
    TEST_ASSERT_EQUAL_UINT32(0, chain.preview_samples);
    memcpy(&axis, &chain.axis, sizeof axis);
    for (int k = 0; k < 200; k++) {
        rdpi_real_t reference_um = k % 40 == 20 ? NAN : (rdpi_real_t)(100 * sin(0.1 * k));
        if (k % 30 == 7) {
            rdpi_f32_missed(&axis, (uint32_t)k);
            rdpi_f32_chain_missed(&chain, (uint32_t)k);
        }
        rdpi_real_t expected_V = rdpi_f32_step(&axis, reference_um);
        rdpi_real_t drive_V = rdpi_f32_chain_step(&chain, reference_um);
        SAME(expected_V, drive_V);
        TEST_ASSERT_EQUAL_MEMORY(&axis, &chain.axis, sizeof axis);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(0, chain.axis.clip_count);
}

void test_a_chain_without_effects_does_what_the_operator_does(void)
{
    plain_does_what_the_operator_does();
    params.preview = 0;
    plain_does_what_the_operator_does();
}

/* ---- reset, settle, sweep ---- */

/* `chain` does what one does that has just been started. */
static void as_started(double at_um)
{
    rdpi_f32_chain_t started;
    memcpy(&started, &chain, sizeof chain);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_chain_init(&started, &params, T_S));
    (void)rdpi_f32_forward(&started.axis, (rdpi_real_t)at_um, 0);
    rdpi_f32_chain_settle(&started);
    for (int k = 0; k < 100; k++) {
        rdpi_real_t reference_um = (rdpi_real_t)(at_um + 10 * sin(0.3 * k));
        rdpi_real_t expected_V = rdpi_f32_chain_step(&started, reference_um);
        rdpi_real_t drive_V = rdpi_f32_chain_step(&chain, reference_um);
        SAME(expected_V, drive_V);
    }
}

static void walk(void)
{
    for (int k = 0; k < 100; k++) {
        (void)step(20 + k * 0.25);
    }
}

void test_reset_forgets_references_creep_and_counts(void)
{
    lead_and_creep();
    params.max_lead_um = (rdpi_real_t)0.125;
    start();
    walk();
    TEST_ASSERT_GREATER_THAN_UINT32(0, chain.axis.clip_count);
    rdpi_f32_chain_reset(&chain);
    TEST_ASSERT_EQUAL_UINT32(0, chain.axis.clip_count);
    as_started(0);
}

void test_settle_keeps_the_drive_and_takes_it_for_settled(void)
{
    lead_and_creep();
    start();
    walk();
    double drive_V = (double)chain.axis.drive_V;
    rdpi_f32_chain_settle(&chain);
    EQUAL(drive_V, step(drive_V));
    EQUAL(drive_V, step(drive_V));
    rdpi_f32_chain_settle(&chain);
    as_started(drive_V);
}

void test_settle_takes_on_a_drive_of_another_source(void)
{
    lead_and_creep();
    start();
    walk();
    (void)rdpi_f32_forward(&chain.axis, 16, 0);
    rdpi_f32_chain_settle(&chain);
    as_started(16);
}

void test_settle_knows_the_offset_of_the_displacement(void)
{
    lead_and_creep();
    given.params.offset_um = 5;
    start();
    EQUAL(0, step(5));
    EQUAL(5, chain.creep.settled_um);
}

void test_sweep_ends_with_a_first_reference(void)
{
    params.lead_s = 4 * T_S;
    start();
    (void)step(0);
    (void)step(1);
    for (int samples = 0; rdpi_f32_chain_sweep(&chain); samples++) {
        TEST_ASSERT_LESS_THAN_INT(100, samples);
    }
    EQUAL(10, step(10));
}

/* The plays follow as after rdpi_f32_forget_sweep, and creep from the middle of the range on, where all plays are. */
void test_sweep_ends_with_what_the_actuator_forgets(void)
{
    rdpi_f32_t axis;
    lead_and_creep();
    given.params.plays = 2;
    given.play[1] = (rdpi_f32_play_t){.r_um = 4, .slope = 2};
    given.params.sweep_forgotten = (rdpi_real_t)0.5;
    given.params.min_V = -32;
    given.params.offset_um = 5;
    given.params.sweep_cycles = 3;
    start();
    memcpy(&axis, &chain.axis, sizeof axis);
    bool goes_on = true;
    while (goes_on) {
        goes_on = rdpi_f32_sweep(&axis);
        TEST_ASSERT_EQUAL_INT(goes_on, rdpi_f32_chain_sweep(&chain));
    }
    rdpi_f32_forget_sweep(&axis);
    TEST_ASSERT_EQUAL_MEMORY(&axis, &chain.axis, sizeof axis);
    EQUAL(16 * 2 + 5, chain.creep.settled_um);
    EQUAL(rdpi_f32_predict(&axis, axis.drive_V, 0), chain.creep.settled_um + chain.creep.h_um);
}

void test_a_step_in_the_middle_of_a_sweep_is_a_first_one(void)
{
    params.lead_s = 4 * T_S;
    start();
    (void)step(0);
    (void)step(1);
    (void)rdpi_f32_chain_sweep(&chain);
    EQUAL(10, step(10));
    (void)step(11);
    (void)rdpi_f32_chain_sweep(&chain);
    EQUAL(10, step(10));
}
