/* rdpi_f32: the quick way of the step, which gives the same as the long way. */
#include "unity.h"

#include "rdpi/f32.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")

#include "axis_f32.inc"
void setUp(void); /* there, named here for the generator of the runner */
void tearDown(void);

/* As f32_math.h has it, whose tgmath.h newlib's double functions do not bear. */
#if !defined(RDPI_QUICK_STEP) && defined(__OPTIMIZE_SIZE__)
#define RDPI_QUICK_STEP 1
#elif !defined(RDPI_QUICK_STEP)
#define RDPI_QUICK_STEP 2
#endif

/* Whether the next step may take the quick way, in a build that has one. */
#define ASSERT_QUICK(expected) TEST_ASSERT_EQUAL(RDPI_QUICK_STEP && (expected), axis.quick)

/* Steps through references of all kinds, beside a twin that is made to take the long way: the same, bit for bit. */
static void equals_the_long_way(size_t plays)
{
    given.params.plays = (uint16_t)plays;
    start();
    rdpi_f32_t twin = axis;
    uint32_t seed = 5;
    double reference_um = 0;
    unsigned quick_ways = 0;
    for (int k = 0; k < 20000; k++) {
        seed = seed * 1664525u + 1013904223u;
        double change = (double)(seed >> 8) / (1 << 23) - 1;
        switch (k / 50 % 4) {
        case 0: /* jumps, also beyond the range */
            reference_um = k % 7 == 0 ? 24 * change : reference_um;
            break;
        case 1:
            reference_um += change;
            break;
        case 2:
            reference_um += change / 64;
            break;
        default:
            reference_um = 4 * sin(0.02 * k);
            break;
        }
        bool quick = axis.quick;
        twin.quick = false;
        rdpi_real_t drive_V = rdpi_f32_step(&twin, (rdpi_real_t)reference_um);
        rdpi_real_t quick_V = rdpi_f32_step(&axis, (rdpi_real_t)reference_um);
        SAME(drive_V, quick_V);
        SAME(quick_V, axis.drive_V);
        SAME(twin.rate_um_per_s, axis.rate_um_per_s);
        TEST_ASSERT_EQUAL_UINT32(twin.dac_code, axis.dac_code);
        TEST_ASSERT_EQUAL_UINT32(twin.flags, axis.flags);
        rdpi_real_t y_um[RDPI_MAX_PLAYS], twin_y_um[RDPI_MAX_PLAYS];
        rdpi_f32_get_memory(&axis, y_um);
        rdpi_f32_get_memory(&twin, twin_y_um);
        for (size_t i = 0; i < plays; i++) {
            SAME(twin_y_um[i], y_um[i]);
        }
        quick_ways += quick;
    }
    const unsigned least[] = {0, 11000, 15000}; /* half of the quick way is not open at an end of the range */
    TEST_ASSERT_TRUE(RDPI_QUICK_STEP ? quick_ways > least[RDPI_QUICK_STEP] : quick_ways == 0);
    TEST_ASSERT_EQUAL_UINT32(twin.clip_count, axis.clip_count);
    TEST_ASSERT_EQUAL_UINT32(twin.guard_count, axis.guard_count);
    TEST_ASSERT_TRUE(axis.clip_count > 100 && axis.guard_count > 100);
}

void test_quick_and_long_way_lead_to_the_same_drive(void)
{
    for (size_t plays = 1; plays <= PLAYS; plays++) {
        given.params.dac_bits = 20; /* codes of 3e-5 V, which single precision just resolves */
        equals_the_long_way(plays);
    }
}

void test_quick_and_long_way_lead_to_the_same_code(void)
{
    five_bit_dac();
    equals_the_long_way(PLAYS);
    given.curve[0].gain_um_per_V = (rdpi_real_t)-1.5; /* corners between codes: rounding alone can reach one */
    equals_the_long_way(PLAYS);
}

void test_quick_and_long_way_are_the_same_where_half_a_code_leads_past_a_corner(void)
{
    given.play[0].slope = 2; /* steeper than beyond r_1: W_0 alone would hold back what gets to the next code */
    given.params.min_V = -15;
    for (unsigned bits = 3; bits <= 5; bits++) { /* 8.6 um, 4 r_1 and 1.9 um a code */
        given.params.dac_bits = (uint16_t)bits;
        equals_the_long_way(PLAYS);
    }
}

void test_back_from_beyond_the_range_half_a_code_the_other_way_is_clipped(void)
{
    without_rate_law();
    five_bit_dac();
    for (int side = -1; side <= 1; side += 2) {
        start();
        rdpi_real_t end_V = side > 0 ? given.params.max_V : given.params.min_V;
        rdpi_f32_forward(&axis, end_V + (rdpi_real_t)side * 20, 0); /* and back: all plays are engaged */
        rdpi_real_t end_um = rdpi_f32_predict(&axis, end_V, 0);
        for (int k = 0; k < 4; k++) {
            rdpi_real_t drive_V = rdpi_f32_step(&axis, end_um + (rdpi_real_t)(side * (k % 2 == 0 ? -1 : 1)) / 32);
            EQUAL(end_V, drive_V);
            TEST_ASSERT_EQUAL_UINT32(k % 2 == 0 ? 0 : RDPI_FLAG_RANGE, axis.flags);
        }
    }
}

void test_the_quick_way_refuses_what_is_no_reference(void)
{
    const rdpi_real_t bad_um[] = {(rdpi_real_t)NAN, (rdpi_real_t)INFINITY, (rdpi_real_t)-INFINITY,
                                  (rdpi_real_t)1.001e6, (rdpi_real_t)-1.001e6};
    given.params.dac_bits = 16;
    for (size_t k = 0; k < sizeof bad_um / sizeof bad_um[0]; k++) {
        start();
        rdpi_f32_step(&axis, 1);
        rdpi_real_t drive_V = rdpi_f32_step(&axis, 2); /* above the guard: flagged */
        ASSERT_QUICK(true);
        rdpi_real_t held_V = rdpi_f32_step(&axis, bad_um[k]);
        SAME(drive_V, held_V);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_INPUT, axis.flags);
        TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
        rdpi_f32_step(&axis, (rdpi_real_t)2.25);
        EQUAL(0.25 / 2 / T_S, axis.rate_um_per_s);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_MISSED, axis.flags);
    }
}

void test_a_sweep_after_the_quick_way_starts_from_the_drive(void)
{
    given.params.dac_bits = 16;
    start();
    rdpi_f32_step(&axis, 0);
    for (int k = 1; k < 20; k++) {
        rdpi_f32_step(&axis, (rdpi_real_t)k / 32);
    }
    rdpi_real_t drive_V = axis.drive_V;
    rdpi_f32_sweep(&axis);
    TEST_ASSERT_FLOAT_WITHIN(1e-3f, (float)drive_V + 0.0625f, (float)axis.drive_V);
    rdpi_f32_step(&axis, (rdpi_real_t)20 / 32); /* goes on, but from nothing */
    EQUAL(0, axis.rate_um_per_s);
}

/* Such a sample ends the quick way, which is then no sign of where the drive comes from. */
void test_a_sweep_after_an_unusable_or_missed_sample_starts_from_the_drive(void)
{
    given.params.dac_bits = 16;
    for (int missed = 0; missed <= 1; missed++) {
        start();
        for (int k = 0; k < 20; k++) {
            rdpi_f32_step(&axis, (rdpi_real_t)k / 32);
        }
        rdpi_real_t drive_V = axis.drive_V;
        if (missed != 0) {
            rdpi_f32_missed(&axis, 1);
        } else {
            rdpi_f32_step(&axis, (rdpi_real_t)NAN);
        }
        rdpi_f32_sweep(&axis);
        TEST_ASSERT_FLOAT_WITHIN(1e-3f, (float)drive_V + 0.0625f, (float)axis.drive_V);
    }
}

void test_a_sweep_after_steps_that_take_the_long_way_starts_from_the_drive(void)
{
    five_bit_dac();
    given.params.rate_window_s = 2 * T_S;
    start();
    rdpi_f32_step(&axis, 1);
    rdpi_f32_step(&axis, (rdpi_real_t)1.25);
    rdpi_real_t drive_V = axis.drive_V;
    TEST_ASSERT_TRUE(axis.ramp_V != drive_V); /* the wish is no code */
    rdpi_f32_sweep(&axis); /* 1/16 V a sample */
    EQUAL(drive_V + (rdpi_real_t)0.0625, axis.ramp_V);
}

/* Half a step of codes is no change that the limit allows. */
void test_a_sweep_after_slewing_goes_on_from_the_drive_before_rounding(void)
{
    five_bit_dac();
    given.params.slew_V_per_s = 64;
    start();
    for (int k = 0; k < 2; k++) {
        rdpi_f32_step(&axis, 3); /* 1 V, and 1/16 V a sample */
    }
    EQUAL(1, axis.drive_V);
    rdpi_f32_sweep(&axis);
    EQUAL(1, axis.drive_V);
    rdpi_f32_sweep(&axis); /* 1.25 V */
    rdpi_f32_sweep(&axis);
    EQUAL(1.5, axis.drive_V);
}

void test_the_range_ends_the_quick_way_while_no_play_is_engaged(void)
{
    rdpi_real_t y_um[PLAYS];
    given.params.dac_bits = 16;
    for (int side = -1; side <= 1; side += 2) {
        start();
        rdpi_real_t end_V = side > 0 ? given.params.max_V : given.params.min_V;
        rdpi_real_t x_um = 2 * (end_V - 1) - (rdpi_real_t)side / 2; /* and r_1 = 1 */
        set3(y_um, x_um, x_um, x_um);
        TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, y_um));
        rdpi_real_t from_um = rdpi_f32_predict(&axis, axis.drive_V, 0);
        for (int k = 0; k < 50; k++) {
            rdpi_f32_step(&axis, from_um + (rdpi_real_t)(side * k) / 128);
            TEST_ASSERT_TRUE(side * axis.drive_V <= side * end_V);
            TEST_ASSERT_TRUE(axis.dac_code <= 65535u);
        }
        EQUAL(end_V, axis.drive_V);
        TEST_ASSERT_EQUAL_UINT32(side > 0 ? 65535u : 0u, axis.dac_code);
        TEST_ASSERT_EQUAL_UINT32(RDPI_FLAG_RANGE, axis.flags & RDPI_FLAG_RANGE);
    }
}

void test_states_that_were_set_are_heeded_by_the_next_step(void)
{
    rdpi_real_t y_um[PLAYS];
    given.params.dac_bits = 16;
    start();
    rdpi_f32_step(&axis, 2);
    rdpi_f32_step(&axis, (rdpi_real_t)2.125);
    set3(y_um, (rdpi_real_t)0.25, (rdpi_real_t)1.25, (rdpi_real_t)2.25); /* the same output, but other corners */
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_set_memory(&axis, y_um));
    rdpi_f32_t twin = axis;
    twin.quick = false;
    for (int k = 0; k < 20; k++) {
        rdpi_real_t reference_um = (rdpi_real_t)2.125 - (rdpi_real_t)k / 64;
        rdpi_real_t drive_V = rdpi_f32_step(&twin, reference_um);
        TEST_ASSERT_FLOAT_WITHIN(1e-3f, (float)drive_V, (float)rdpi_f32_step(&axis, reference_um));
        rdpi_f32_get_memory(&twin, y_um);
        equal_memory(y_um[0], y_um[1], y_um[2]);
    }
}

void test_windows_filters_slew_limits_and_drives_without_codes_take_the_long_way(void)
{
    start();
    rdpi_f32_step(&axis, 0);
    ASSERT_QUICK(false);
    five_bit_dac();
    start();
    rdpi_f32_step(&axis, 0);
    ASSERT_QUICK(true);
    given.params.rate_window_s = 2 * T_S;
    start();
    rdpi_f32_step(&axis, 0);
    ASSERT_QUICK(false);
    given.params.rate_window_s = 0;
    given.params.rate_filter_s = T_S;
    start();
    rdpi_f32_step(&axis, 0);
    ASSERT_QUICK(false);
    given.params.rate_filter_s = 0;
    given.params.slew_V_per_s = 512;
    start();
    rdpi_f32_step(&axis, 0);
    ASSERT_QUICK(false);
}

void test_codes_too_far_from_x_0_for_single_precision_take_the_long_way(void)
{
    given.params.dac_bits = RDPI_MAX_DAC_BITS;
    for (int k = 0; k < 2; k++) {
        given.curve[0].offset_V = k == 0 ? (rdpi_real_t)-77.5 : (rdpi_real_t)-78.5; /* 1.98 and 2.02 ranges below it */
        set3(given.memory_um, 160, 160, 160);
        start();
        rdpi_f32_step(&axis, 100);
        ASSERT_QUICK(k == 0);
    }
}
