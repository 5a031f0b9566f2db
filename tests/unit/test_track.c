/* The example application against the port contract: what it asks of a board, in which order, and what it outputs. The
 * board is a mock of port/include/rdpi_port.h. */
#include "unity.h"

#include <math.h>

#include "mock_rdpi_port.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")
TEST_SOURCE_FILE("lib/src/status.c")

#define TRACK_RATE_HZ 10000
#define main track_main
#include "track/main.c"
#undef main

#define TICKS 40

static rdpi_f32_t expected; /* what the application should do, step by step */
static rdpi_port_tick_t timer;
static float references_um[TICKS];
static uint32_t codes[TICKS + 1];
static int ticks, written;

static bool start(uint32_t rate_hz, rdpi_port_tick_t tick_function, int calls)
{
    (void)calls;
    TEST_ASSERT_EQUAL_UINT32(TRACK_RATE_HZ, rate_hz);
    TEST_ASSERT_EQUAL_INT(1, written); /* the first code is out before the first tick */
    timer = tick_function;
    return true;
}

static bool idle(int calls)
{
    (void)calls;
    TEST_ASSERT_NOT_NULL(timer);
    if (ticks == TICKS) {
        return false;
    }
    timer();
    ticks++;
    TEST_ASSERT_EQUAL_INT(ticks + 1, written); /* one code per tick */
    return true;
}

static float reference_um(int calls)
{
    TEST_ASSERT_EQUAL_INT(ticks, calls);
    return references_um[calls];
}

static void write_dac(uint32_t code, int calls)
{
    TEST_ASSERT_EQUAL_INT(written, calls);
    TEST_ASSERT_TRUE(code < 1u << RDPI_PARAMS_DAC_BITS);
    codes[written++] = code;
}

void setUp(void)
{
    timer = NULL;
    ticks = 0;
    written = 0;
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_init(&expected, &rdpi_params, 1.0f / TRACK_RATE_HZ));
    float rest_um = rdpi_f32_predict(&expected, expected.drive_V, 0);
    for (int k = 0; k < TICKS; k++) {
        references_um[k] = rest_um + 2 * sinf(0.3f * (float)k);
    }
    rdpi_port_start_StubWithCallback(start);
    rdpi_port_idle_StubWithCallback(idle);
    rdpi_port_reference_um_StubWithCallback(reference_um);
    rdpi_port_write_dac_StubWithCallback(write_dac);
    rdpi_port_overruns_IgnoreAndReturn(0);
}

void tearDown(void)
{
}

static void runs_as_the_library_steps(void)
{
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_INT(TICKS, ticks);
    TEST_ASSERT_EQUAL_UINT32(expected.dac_code, codes[0]);
    for (int k = 0; k < TICKS; k++) {
        rdpi_f32_step(&expected, references_um[k]);
        TEST_ASSERT_EQUAL_UINT32(expected.dac_code, codes[k + 1]);
    }
}

void test_every_tick_outputs_the_code_of_its_reference(void)
{
    runs_as_the_library_steps();
    TEST_ASSERT_NOT_EQUAL_UINT32(codes[1], codes[TICKS / 2]);
}

void test_a_tick_without_reference_outputs_the_code_before(void)
{
    references_um[7] = NAN;
    runs_as_the_library_steps();
    TEST_ASSERT_EQUAL_UINT32(codes[7], codes[8]);
    TEST_ASSERT_EQUAL_UINT32(1, axis.input_count);
}

void test_nothing_runs_on_a_board_without_such_a_timer(void)
{
    rdpi_port_start_StubWithCallback(NULL);
    rdpi_port_start_ExpectAndReturn(TRACK_RATE_HZ, tick, false);
    TEST_ASSERT_EQUAL_INT(1, track_main());
    TEST_ASSERT_EQUAL_INT(0, ticks);
    TEST_ASSERT_EQUAL_INT(1, written);
}

void test_the_loss_of_ticks_is_asked_of_the_board_at_the_end(void)
{
    rdpi_port_overruns_StopIgnore();
    rdpi_port_overruns_ExpectAndReturn(3);
    TEST_ASSERT_EQUAL_INT(0, track_main());
}
