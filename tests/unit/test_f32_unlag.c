/* rdpi_f32_chain: lag^-1, the lead of the drive. */
#include "unity.h"

#include "rdpi/f32_chain.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")
TEST_SOURCE_FILE("lib/src/rdpi_f32_chain.c")

#include "chain_f32.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

#define LAG 4 /* samples */

static void with_codes(uint8_t bits, bool shaping)
{
    given.params.dac_bits = bits;
    given.params.noise_shaping = shaping;
}

static void start_with(uint32_t preview_samples)
{
    params.lag_s = LAG * T_S;
    start();
    TEST_ASSERT_EQUAL_UINT32(preview_samples, chain.preview_samples);
}

static void start_with_lag(int preview)
{
    params.preview = (uint16_t)preview;
    start_with((uint32_t)preview);
}

/* What an amplifier with this lag makes of a drive that is held for each sample. */
static double amplified(double before_V, double drive_V)
{
    return drive_V + (before_V - drive_V) * exp(-1.0 / LAG);
}

void test_a_ramp_is_led_by_the_lag(void)
{
    for (int preview = 0; preview < 2; preview++) {
        setUp();
        start_with_lag(preview);
        for (int k = 0; k < 8; k++) {
            double drive_V = step(0.5 * (k + preview));
            if (k > 1) {
                EQUAL(0.5 * k + LAG * 0.5, drive_V);
            }
        }
        TEST_ASSERT_EQUAL_UINT32(0, chain.axis.clip_count);
    }
}

void test_the_slope_is_the_mean_of_two_but_at_most_twice_the_smaller(void)
{
    start_with_lag(1);
    (void)step(0);
    (void)step(1);
    EQUAL(1 + LAG * 1.5, step(3)); /* 1 and 2 */
    EQUAL(3 + LAG * 4, step(11));  /* 2 and 8 */
    EQUAL(11 + LAG * 2, step(12)); /* 8 and 1 */
    EQUAL(12, step(11));           /* it turns round */
    EQUAL(11 - LAG * 1.5, step(9));
}

/* A jump and the end of a ramp have no lead, so that the amplifier goes nowhere beyond them. */
void test_an_amplifier_goes_no_further_than_the_reference(void)
{
    start_with_lag(1);
    double actual_V = 0, highest_V = 0;
    for (int k = 0; k < 60; k++) {
        double ahead = k < 20 ? 0 : (k < 40 ? 16 : fmin(16 + 2 * (k - 40), 24));
        actual_V = amplified(actual_V, step(ahead));
        highest_V = fmax(highest_V, actual_V);
    }
    TEST_ASSERT_TRUE(highest_V <= 24 + 1e-5);
    WITHIN(0.1, 24, actual_V);
    TEST_ASSERT_EQUAL_UINT32(0, chain.axis.clip_count);
}

void test_plays_follow_what_the_amplifier_outputs(void)
{
    given.play[1] = (rdpi_f32_play_t){.r_um = 4, .slope = 2};
    given.params.plays = 2;
    start_with_lag(1);
    rdpi_real_t led_um[2], plain_um[2];
    rdpi_f32_t alone;
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&alone, &given.params, T_S));
    for (int k = 0; k < 100; k++) {
        double reference_um = 20 * sin(0.1 * k);
        (void)step(reference_um);
        (void)rdpi_f32_step(&alone, (rdpi_real_t)reference_um);
    }
    rdpi_f32_get_memory(&chain.axis, led_um);
    rdpi_f32_get_memory(&alone, plain_um);
    EQUAL(plain_um[0], led_um[0]);
    EQUAL(plain_um[1], led_um[1]);
}

void test_range_and_slew_are_kept_flagged_and_counted(void)
{
    start_with_lag(1);
    (void)step(0);
    (void)step(20);
    EQUAL(64, step(40)); /* 20 + 80 */
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_LEAD, chain.axis.flags);
    TEST_ASSERT_EQUAL_UINT32(1, chain.axis.clip_count);
    setUp();
    given.params.slew_V_per_s = given.params.sweep_V_per_s = 1024 * 3; /* 3 V a sample */
    start_with_lag(1);
    (void)step(0);
    (void)step(1);
    EQUAL(3, step(2)); /* 1 + 4 */
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_LEAD, chain.axis.flags);
    EQUAL(6, step(3));
    TEST_ASSERT_EQUAL_UINT32(0, chain.axis.flags);
}

/* A quarter of a code per sample: rounded to codes in between, the drive would never leave one. */
void test_a_slow_slew_gets_from_code_to_code(void)
{
    with_codes(10, false);
    const double code_V = 128.0 / 1023;
    given.params.slew_V_per_s = given.params.sweep_V_per_s = (rdpi_real_t)(1024 * code_V / 4);
    start_with_lag(1);
    double from_V = (double)chain.axis.drive_V;
    for (int k = 1; k <= 400; k++) { /* as ever, it begins a sample late */
        WITHIN(0.51 * code_V, from_V + (k > 1 ? k - 1 : k) * code_V / 4, step(40));
    }
    TEST_ASSERT_EQUAL_UINT32(400, chain.axis.clip_count);
}

void test_a_sweep_begins_at_what_was_output(void)
{
    given.params.slew_V_per_s = given.params.sweep_V_per_s = 1024 * 3; /* 3 V a sample */
    start_with_lag(1);
    for (int k = 0; k < 8; k++) {
        (void)step(k); /* the operator asks for 6, and 10 is output */
    }
    double before_V = (double)chain.axis.drive_V;
    EQUAL(6 + LAG, before_V);
    (void)rdpi_f32_chain_sweep(&chain);
    EQUAL(3, fabs((double)chain.axis.drive_V - before_V));
}

void test_a_reference_that_is_not_usable_holds_what_was_output(void)
{
    with_codes(12, false);
    start_with_lag(1);
    (void)step(0);
    (void)step(1);
    double led_V = step(2);
    uint32_t code = chain.axis.dac_code;
    for (int k = 0; k < 2; k++) {
        EQUAL(led_V, step(NAN));
        TEST_ASSERT_EQUAL_UINT32(code, chain.axis.dac_code);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, chain.axis.flags);
    }
    WITHIN(0.05, 4 + LAG, step(5)); /* two were missed: a straight line */
}

void test_after_missed_samples_the_drive_lies_on_a_straight_line(void)
{
    start_with_lag(1);
    (void)step(0);
    (void)step(1);
    rdpi_f32_chain_missed(&chain, 3);
    EQUAL(7 + LAG * 2, step(9));
    rdpi_f32_chain_missed(&chain, RDPI_MAX_MISSED + 1u);
    EQUAL(30, step(30)); /* a first one */
}

void test_what_is_output_is_a_code_and_slow_motion_has_its_lead(void)
{
    for (int shaping = 0; shaping <= RDPI_NOISE_SHAPING; shaping++) {
        setUp();
        with_codes(10, shaping != 0); /* 0.125 V */
        start_with_lag(1);
        double sum_V = 0, slope_V = 0.01;
        for (int k = 0; k < 2000; k++) {
            double drive_V = step(slope_V * (k + 1)), code_V = 128.0 / 1023;
            EQUAL(-64 + code_V * chain.axis.dac_code, drive_V);
            TEST_ASSERT_DOUBLE_WITHIN(code_V * (shaping ? 1.01 : 0.51), slope_V * (k + LAG * (k > 1)), drive_V);
            sum_V += drive_V - slope_V * (k + LAG);
        }
        WITHIN(shaping ? 0.001 : 0.01, 0, sum_V / 2000);
    }
}

void test_codes_of_a_drive_at_rest_are_right_in_the_mean_with_noise_shaping(void)
{
    with_codes(10, RDPI_NOISE_SHAPING != 0);
    start_with_lag(1);
    double sum_V = 0;
    for (int k = 0; k < 1002; k++) {
        double drive_V = step(0.03); /* a quarter of a code */
        sum_V += k > 1 ? drive_V - 0.03 : 0;
    }
    WITHIN(RDPI_NOISE_SHAPING ? 0.001 : 0.0626, 0, sum_V / 1000);
}

void test_a_sweep_is_output_as_it_is(void)
{
    rdpi_f32_t alone;
    start_with_lag(1);
    for (int k = 0; k < 5; k++) {
        (void)step(k);
    }
    rdpi_f32_chain_reset(&chain);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&alone, &given.params, T_S));
    bool goes_on = true;
    while (goes_on) {
        goes_on = rdpi_f32_sweep(&alone);
        TEST_ASSERT_EQUAL_INT(goes_on, rdpi_f32_chain_sweep(&chain));
        EQUAL(alone.drive_V, chain.axis.drive_V);
    }
    EQUAL(7, step(7)); /* the first has no lead */
}

void test_creep_and_the_lead_of_the_reference_stand_ahead_of_it(void)
{
    params.delay_s = 2 * T_S;
    add_pole(0, 1);
    params.lag_s = LAG * T_S;
    start();
    TEST_ASSERT_EQUAL_UINT32(4, chain.preview_samples);
    for (int k = 0; k < 10; k++) {
        double drive_V = step(0.25 * k);
        if (k > 3) {
            EQUAL(0.25 * (k - 2) + LAG * 0.25, drive_V); /* one sample each */
        }
    }
    (void)step(NAN);
    rdpi_f32_chain_missed(&chain, 2);
    EQUAL(0.25 * 11 + LAG * 0.25, step(0.25 * 13));
}

/* What the operator asks for is known to parts of a code, whichever way the step takes: over edges of plays, reversals,
 * the guard and pieces of the saturation. */
void test_the_lead_follows_what_was_asked_for_and_not_codes(void)
{
    for (int poles = 0; poles < 2; poles++) {
        setUp();
        given.play[0] = (rdpi_f32_play_t){.r_um = 0, .slope = 1, .slope_rate_s_per_um = (rdpi_real_t)-1e-6};
        given.play[1] = (rdpi_f32_play_t){.r_um = 4, .slope = (rdpi_real_t)1.25};
        given.params.plays = 2;
        given.saturation[1] = (rdpi_f32_deadzone_t){8, (rdpi_real_t)-0.25};
        given.params.deadzones = 2;
        given.params.max_um_per_s = 2000;
        with_codes(12, false);
        for (int k = 0; k < poles; k++) {
            add_pole(0, 1);
        }
        start_with_lag(1);
        const double code_V = 128.0 / 4095;
        double before_V = 0, latest_V = 0;
        for (int k = 0; k < 3000; k++) {
            double wave = k < 1000 ? 0.7 * sin(0.02 * k) : 20 * sin(k < 2000 ? 0.02 * k : 0.3 * k);
            double drive_V = step(wave), asked_V = (double)chain.unlag.asked_V, slope_V = 0;
            double d = asked_V - latest_V, other = latest_V - before_V;
            WITHIN(0.5001 * code_V, (double)chain.unlag.followed_V, asked_V);
            if (d * other > 0) {
                slope_V = copysign(fmin(fabs(d + other) / 2, 2 * fmin(fabs(d), fabs(other))), d);
            }
            if (k > 1 && chain.axis.flags == 0u) {
                WITHIN(0.51 * code_V, latest_V + LAG * slope_V, drive_V);
            }
            before_V = latest_V;
            latest_V = asked_V;
        }
        TEST_ASSERT_GREATER_THAN_UINT32(100, chain.axis.guard_count);
    }
}

/* One step of the chain, and of a twin that is made to take the long way: to the last bit the same. */
static void same_as_the_long_way(rdpi_f32_chain_t *twin, double reference_um)
{
    twin->axis.quick = false;
    rdpi_real_t long_V = rdpi_f32_chain_step(twin, (rdpi_real_t)reference_um);
    rdpi_real_t quick_V = rdpi_f32_chain_step(&chain, (rdpi_real_t)reference_um);
    SAME(long_V, quick_V);
    SAME(twin->unlag.asked_V, chain.unlag.asked_V);
    TEST_ASSERT_EQUAL_UINT32(twin->axis.dac_code, chain.axis.dac_code);
    TEST_ASSERT_EQUAL_UINT32(twin->axis.flags, chain.axis.flags);
}

/* Where x turns round within its code, the plays that were engaged have let go: it is further from that code than it
 * would be with them. */
void test_quick_and_long_way_ask_for_the_same_drive(void)
{
    given.play[0].slope = (rdpi_real_t)0.5;
    given.play[1] = (rdpi_f32_play_t){.r_um = 4, .slope = 2};
    given.params.plays = 2;
    for (uint8_t bits = 8; bits <= 16; bits += 4) { /* from 0.5 V to 0.002 V a code */
        with_codes(bits, false);
        start_with_lag(1);
        rdpi_f32_chain_t twin = chain;
        for (int k = 0; k < 4000; k++) {
            same_as_the_long_way(&twin, (k < 2000 ? 16 : 0.125) * sin(0.01 * k));
        }
    }
}

/* There a code begins a piece, and rounding leaves some of these codes on the piece before it. */
void test_quick_and_long_way_ask_for_the_same_drive_between_two_pieces_of_the_input_curve(void)
{
#if RDPI_MAX_CURVE_PIECES > 1
    with_codes(13, false);
    given.params.curve_pieces = 2;
    given.play[1] = (rdpi_f32_play_t){.r_um = (rdpi_real_t)0.125, .slope = (rdpi_real_t)1.25};
    given.params.plays = 2;
    for (int side = -1; side <= 1; side += 2) {
        for (int k = -40; k < 40; k++) {
            given.curve[0] = (rdpi_f32_line_t){.gain_um_per_V = (rdpi_real_t)1.3, .to_V = (rdpi_real_t)(1.1 * k)};
            given.curve[1] = (rdpi_f32_line_t){.gain_um_per_V = (rdpi_real_t)0.7};
            start_with_lag(1);
            rdpi_f32_chain_t twin = chain;
            rdpi_real_t end_V = given.curve[0].to_V;
            for (int i = 8; i >= 0; i--) { /* there from one side, then on by less than rounding */
                same_as_the_long_way(&twin, rdpi_f32_predict(&chain.axis, end_V - (rdpi_real_t)(side * i) / 8, 0));
            }
            double end_um = rdpi_f32_predict(&chain.axis, end_V, 0);
            for (int i = 0; i < 12; i++) {
                same_as_the_long_way(&twin, end_um + side * 2e-8 * i * fabs(end_um));
            }
        }
    }
#endif
}

void test_resonances_and_creep_stand_ahead_of_it(void)
{
    for (int poles = 0; poles < 2; poles++) {
        setUp();
        params.lead_s = T_S;
        params.lag_s = LAG * T_S;
        for (int k = 0; k < poles; k++) {
            add_pole(0, 1);
        }
        start();
        TEST_ASSERT_EQUAL_UINT32(2, chain.preview_samples);
        for (int k = 0; k < 10; k++) {
            double drive_V = step(0.25 * k);
            if (k > 3) {
                EQUAL(0.25 * (k - 2 + 1 + LAG), drive_V);
            }
        }
        params.max_lead_um = 1;
        start();
        (void)step(0);
        (void)step(16);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_LEAD, chain.axis.flags);
        TEST_ASSERT_EQUAL_UINT32(1, chain.axis.clip_count);
        EQUAL(1 + LAG * 2, step(16)); /* the limited lead makes 1, 17 and 16 of it */
        EQUAL(17, step(16));
    }
}

void test_a_sample_that_both_leads_limit_counts_once(void)
{
    params.lead_s = T_S;
    params.max_lead_um = 1;
    start_with(2);
    (void)step(0);
    (void)step(20);
    (void)step(40);
    (void)step(60);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_LEAD, chain.axis.flags);
    TEST_ASSERT_EQUAL_UINT32(3, chain.axis.clip_count);
}

void test_creep_alone_stands_ahead_of_it(void)
{
    add_pole(0, 1);
    start_with_lag(1);
    for (int k = 0; k < 6; k++) {
        double drive_V = step(0.25 * (k + 1));
        if (k > 1) {
            EQUAL(0.25 * (k + LAG), drive_V);
        }
    }
    double led_V = (double)chain.axis.drive_V;
    EQUAL(led_V, step(NAN));
    (void)step(100); /* clipped */
    (void)step(0.25 * 9);
    TEST_ASSERT_EQUAL_UINT32(0, chain.axis.flags & RDPI_FLAG_RANGE);
}

void test_nothing_is_carried_over_a_clip(void)
{
    with_codes(8, RDPI_NOISE_SHAPING != 0);
    start_with_lag(1);
    (void)step(0.1);
    (void)step(20.1);
    (void)step(40.1);
    TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_LEAD, chain.axis.flags);
    EQUAL(0, chain.unlag.carried_V);
}

void test_what_is_settled_carries_nothing(void)
{
    with_codes(8, RDPI_NOISE_SHAPING != 0); /* 0.5 V */
    start_with_lag(1);
    (void)step(0.1);
    TEST_ASSERT_TRUE(RDPI_NOISE_SHAPING == 0 || fabs((double)chain.unlag.carried_V) > 0.05);
    rdpi_f32_chain_settle(&chain);
    EQUAL(0, chain.unlag.carried_V);
}

void test_the_operator_keeps_a_slew_limit_of_its_own(void)
{
    given.params.slew_V_per_s = given.params.sweep_V_per_s = 1024 * 3; /* 3 V a sample */
    start_with_lag(1);
    for (int k = 1; k < 8; k++) {
        (void)step(40);
        EQUAL(3 * k, chain.unlag.followed_V); /* what is output is a sample behind that */
    }
}

void test_init_refuses_a_lag_that_is_none(void)
{
    params.lag_s = -T_S;
    refused(RDPI_ERR_CHAIN);
    params.lag_s = NAN;
    refused(RDPI_ERR_NOT_FINITE);
}
