/* examples/track/main.c with two axes: what it asks of each, in which order, and what it tells the host. The board is a
 * mock, and the axes are made up here. */
#define RDPI_AXES 2
#include "unity.h"

#include "mock_rdpi_port.h"

TEST_SOURCE_FILE("port/drivers/telemetry.c")
TEST_SOURCE_FILE("lib/src/status.c")

#define TRACK_RATE_HZ 10000
#define TRACK_SWEEP 0
#define main track_main
#include "track/main.c"
#undef main

/* The codes of an axis: 1000 at start, 2000 on in the sweep, 3000 on in the reference; axis 1 has 100 more. */
static struct {
    rdpi_status_t status;
    uint32_t sweep, reference; /* samples of each */
    uint32_t swept, followed, first; /* first: tick of the first reference */
    int32_t adc_counts;
    uint32_t codes[2], of, rate_hz; /* what it was told */
} axis[2];

static uint32_t ticks, written, infos[2], samples[2], last_sample[2], held_of[2];
static uint32_t codes[2][100];
static int last_state[2];
static uint32_t dac_refuses; /* the first codes of the reference, so often */

static rdpi_status_t init_of(uint32_t k, rdpi_telemetry_sample_t *told)
{
    told->dac_code = 1000 + 100 * k;
    return axis[k].status;
}

static bool sweep_of(uint32_t k, rdpi_telemetry_sample_t *told)
{
    told->dac_code = 2000 + 100 * k + axis[k].swept;
    return ++axis[k].swept < axis[k].sweep;
}

static bool advance_of(uint32_t k, int32_t adc_counts, const uint32_t *before, rdpi_telemetry_sample_t *told)
{
    if (axis[k].followed == axis[k].reference) {
        return false;
    }
    axis[k].first = axis[k].followed == 0 ? ticks : axis[k].first;
    axis[k].adc_counts = adc_counts;
    memcpy(axis[k].codes, before, sizeof axis[k].codes);
    told->dac_code = 3000 + 100 * k + axis[k].followed++;
    return true;
}

#define AXIS(k) \
    static rdpi_status_t init_##k(rdpi_telemetry_sample_t *told) { return init_of(k, told); } \
    static bool sweep_##k(rdpi_telemetry_sample_t *told) { return sweep_of(k, told); } \
    static void count_##k(rdpi_telemetry_counts_t *told) { told->guard_count = 7 + k; } \
    static void couple_##k(uint32_t of, const rdpi_telemetry_run_t *its) \
    { \
        axis[k].of = of; \
        axis[k].rate_hz = its->rate_hz; \
    } \
    static bool advance_##k(uint32_t since, int32_t adc_counts, const uint32_t *before, rdpi_telemetry_sample_t *told) \
    { \
        (void)since; \
        return advance_of(k, adc_counts, before, told); \
    } \
    static const rdpi_telemetry_run_t run_##k = {.rate_hz = 10000 + k, .dac_bits = 16, .max_V = 1}; \
    const track_axis_t track_axis_##k = {&run_##k, init_##k, couple_##k, sweep_##k, advance_##k, count_##k};
AXIS(0)
AXIS(1)

static void idle(int calls)
{
    (void)calls;
    ticks++;
    tick();
}

static bool write_dac(const uint32_t *both, int calls)
{
    (void)calls;
    codes[0][written] = both[0];
    codes[1][written] = both[1];
    written++;
    return written == 1u || written > 1u + dac_refuses;
}

static void read_adc(int32_t *counts_of, int calls)
{
    (void)calls;
    counts_of[0] = 10 + (int32_t)ticks;
    counts_of[1] = 20 + (int32_t)ticks;
}

/* A frame without its COBS, as far as it is looked at: first byte, last code of the sample, state of the info. */
static bool send_bytes(const uint8_t *bytes, size_t count, int calls)
{
    uint8_t frame[RDPI_TELEMETRY_MAX_BYTES];
    (void)calls;
    memcpy(frame, bytes, count);
    for (size_t zero = 0; zero < count - 1u;) {
        size_t next = zero + frame[zero];
        frame[zero] = 0;
        zero = next;
    }
    uint32_t k = frame[1] >> 4;
    TEST_ASSERT_TRUE(k < 2u);
    if ((frame[1] & 15u) == 2u) {
        infos[k]++;
        last_state[k] = frame[3];
        return true;
    }
    TEST_ASSERT_EQUAL_UINT8(1, frame[1] & 15u);
    TEST_ASSERT_EQUAL_UINT8(samples[k], frame[2]); /* its own sequence */
    TEST_ASSERT_EQUAL_UINT8(10u + 10u * k + samples[k] + 2u, frame[20]); /* its own reading, one period later */
    held_of[k] += (frame[25] & 2u) / 2u;
    last_sample[k] = frame[16] | (uint32_t)frame[17] << 8;
    samples[k]++;
    return true;
}

void setUp(void)
{
    memset(axis, 0, sizeof axis);
    memset(sample, 0, sizeof sample);
    memset(&counts, 0, sizeof counts);
    for (uint32_t k = 0; k < 2; k++) {
        axis[k].reference = 5;
        line[k].offered_count = 0;
        infos[k] = samples[k] = last_sample[k] = held_of[k] = 0;
        last_state[k] = -1;
    }
    ticks = written = sweeping = 0;
    finished = false;
    dac_refuses = held = waited = 0;
    rdpi_port_start_IgnoreAndReturn(true);
    rdpi_port_watchdog_reset_IgnoreAndReturn(false);
    rdpi_port_overruns_IgnoreAndReturn(0);
    rdpi_port_cycles_IgnoreAndReturn(0);
    rdpi_port_safe_Ignore();
    rdpi_port_idle_StubWithCallback(idle);
    rdpi_port_write_dac_StubWithCallback(write_dac);
    rdpi_port_read_adc_StubWithCallback(read_adc);
    rdpi_port_send_StubWithCallback(send_bytes);
}

void tearDown(void)
{
}

void test_both_axes_advance_in_every_tick(void)
{
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_UINT32(1 + 5, written);
    for (uint32_t k = 0; k < 2; k++) {
        TEST_ASSERT_EQUAL_UINT32(1000 + 100 * k, codes[k][0]);
        TEST_ASSERT_EQUAL_UINT32(3000 + 100 * k, codes[k][1]);
        TEST_ASSERT_EQUAL_UINT32(3004 + 100 * k, codes[k][5]);
        TEST_ASSERT_EQUAL_UINT32(5, samples[k]);
        TEST_ASSERT_EQUAL_INT32(10 + 10 * (int32_t)k + 5, axis[k].adc_counts);
    }
}

void test_each_axis_is_told_of_the_other_and_of_the_codes_before(void)
{
    TEST_ASSERT_EQUAL_INT(0, track_main());
    for (uint32_t k = 0; k < 2; k++) {
        TEST_ASSERT_EQUAL_UINT32(1 - k, axis[k].of);
        TEST_ASSERT_EQUAL_UINT32(10000 + 1 - k, axis[k].rate_hz);
        TEST_ASSERT_EQUAL_UINT32(3003, axis[k].codes[0]); /* the same for both, whichever comes first */
        TEST_ASSERT_EQUAL_UINT32(3103, axis[k].codes[1]);
    }
}

void test_the_axis_whose_reference_ends_first_holds_its_code(void)
{
    axis[0].reference = 2;
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_UINT32(1 + 5, written);
    TEST_ASSERT_EQUAL_UINT32(3001, codes[0][5]);
    TEST_ASSERT_EQUAL_UINT32(3104, codes[1][5]);
    TEST_ASSERT_EQUAL_UINT32(5, samples[0]);
    TEST_ASSERT_EQUAL_UINT32(3001, last_sample[0]);
}

void test_the_references_begin_together_when_all_sweeps_have_ended(void)
{
    sweeping = 3;
    axis[0].sweep = 3;
    axis[1].sweep = 8;
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_UINT32(3, axis[0].swept);
    TEST_ASSERT_EQUAL_UINT32(8, axis[1].swept);
    TEST_ASSERT_EQUAL_UINT32(9, axis[0].first);
    TEST_ASSERT_EQUAL_UINT32(9, axis[1].first);
    TEST_ASSERT_EQUAL_UINT32(2002, codes[0][8]); /* waits where its sweep has left it */
}

void test_each_axis_has_infos_of_its_own(void)
{
    TEST_ASSERT_EQUAL_INT(0, track_main());
    for (uint32_t k = 0; k < 2; k++) {
        TEST_ASSERT_EQUAL_UINT32(2, infos[k]);
        TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_FINISHED, last_state[k]);
    }
    for (int more = 0; more < 1000; more++) {
        tick();
    }
    TEST_ASSERT_EQUAL_UINT32(12, infos[0]);
    TEST_ASSERT_EQUAL_UINT32(12, infos[1]);
}

void test_codes_that_the_dac_does_not_take_are_flagged_and_tried_again_on_both(void)
{
    dac_refuses = 3;
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_UINT32(3, counts.held_count);
    TEST_ASSERT_EQUAL_UINT32(1 + 3 + 5, written);
    for (uint32_t k = 0; k < 2; k++) {
        TEST_ASSERT_EQUAL_UINT32(3, held_of[k]);
        TEST_ASSERT_EQUAL_UINT32(3 + 5, samples[k]);
        TEST_ASSERT_EQUAL_UINT32(3000 + 100 * k, codes[k][4]);
        TEST_ASSERT_EQUAL_UINT32(3001 + 100 * k, codes[k][5]);
    }
}

void test_an_axis_with_damaged_parameters_lets_none_run(void)
{
    axis[1].status = RDPI_ERR_DIGEST;
    TEST_ASSERT_EQUAL_INT(1, track_main());
    TEST_ASSERT_EQUAL_UINT32(0, written);
    TEST_ASSERT_EQUAL_UINT32(0, infos[0]);
    TEST_ASSERT_EQUAL_UINT32(1, infos[1]);
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_REFUSED, last_state[1]);
}
