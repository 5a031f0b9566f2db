/* The example application against the port contract: what it asks of a board, in which order, and what it outputs. The
 * board and the source of references are mocks of port/include. */
#include "unity.h"

#include <math.h>

#include "mock_rdpi_port.h"
#include "mock_rdpi_reference.h"

TEST_SOURCE_FILE("lib/src/rdpi_f32.c")
TEST_SOURCE_FILE("lib/src/rdpi_f32_chain.c")
TEST_SOURCE_FILE("lib/src/status.c")
TEST_SOURCE_FILE("port/drivers/telemetry.c")

#define TICK_MAX_OVERRUNS 5
#define TRACK_RATE_HZ 10000
#define TRACK_Q31 0
#define TRACK_SWEEP 0
#define TRACK_SWEPT 0u
#define TRACK_UM_PER_COUNT 0.001
#define TRACK_COUNT_0_UM 0.0
#include "rdpi_params.h"
static rdpi_f32_chain_params_t flashed; /* in place of that of rdpi_params.h: tests change it */
#define rdpi_chain flashed
#include "track/axis.c"
#undef rdpi_chain
#undef couple
#define main track_main
#include "track/main.c"
#undef main

#define TICKS 40

static rdpi_f32_chain_t expected; /* what the application should do, step by step */
static rdpi_port_tick_t timer;
static float references_um[TICKS];
static uint32_t codes[TICKS + 2];
static uint32_t output[TICKS + 2]; /* what the DAC outputs after each write, with take_some */
static int ticks, asked, written, samples, infos, last_state, made_safe;
static uint32_t lost, cycles;
static bool line_full, was_reset;

static bool start(uint32_t rate_hz, rdpi_port_tick_t tick_function, int calls)
{
    (void)calls;
    TEST_ASSERT_EQUAL_UINT32(TRACK_RATE_HZ, rate_hz);
    TEST_ASSERT_EQUAL_INT(1, written); /* the first code is out before the first tick */
    timer = tick_function;
    return true;
}

static void idle(int calls)
{
    (void)calls;
    TEST_ASSERT_NOT_NULL(timer);
    ticks++;
    timer();
}

/* What the chain is given in the sample k: a reference of later. */
static float ahead_of(int k)
{
    int later = k + (int)expected.preview_samples;
    return references_um[later < TICKS ? later : TICKS - 1];
}

static bool reference_um(uint32_t since, uint32_t ahead, float *reference, float *ahead_um, int calls)
{
    (void)calls;
    asked += (int)since;
    if (asked > TICKS) {
        return false;
    }
    TEST_ASSERT_EQUAL_UINT32(expected.preview_samples, ahead);
    *reference = references_um[asked - 1];
    *ahead_um = ahead_of(asked - 1);
    return true;
}

static bool write_dac(const uint32_t *code, int calls)
{
    TEST_ASSERT_EQUAL_INT(written, calls);
    TEST_ASSERT_TRUE(*code < 1u << RDPI_PARAMS_DAC_BITS);
    codes[written++] = *code;
    return true;
}

/* Nothing is written after it. */
static void safe(int calls)
{
    (void)calls;
    made_safe = written;
}

static bool watchdog_reset(int calls)
{
    (void)calls;
    return was_reset;
}

static void read_adc(int32_t *adc_counts, int calls)
{
    (void)calls;
    *adc_counts = 100 + ticks; /* of the code before */
}

static uint32_t overruns(int calls)
{
    (void)calls;
    return lost;
}

static uint32_t count_cycles(int calls)
{
    (void)calls;
    return cycles += 10u;
}

/* Undoes COBS: where a code says that the next zero is. What the frame holds is tested in test_telemetry.c. */
static void decode(uint8_t *bytes, size_t count)
{
    size_t zero = 0;
    while (zero < count - 1u) {
        size_t next = zero + bytes[zero];
        bytes[zero] = 0;
        zero = next;
    }
}

static uint32_t number_at(const uint8_t *bytes)
{
    return bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

static bool send_bytes(const uint8_t *bytes, size_t count, int calls)
{
    uint8_t copy[RDPI_TELEMETRY_MAX_BYTES];
    (void)calls;
    if (line_full) {
        return false;
    }
    memcpy(copy, bytes, count);
    decode(copy, count);
    const uint8_t *body = copy + 1;
    if (body[0] == 2u) {
        infos++;
        last_state = body[2];
        return true;
    }
    /* the code that was output before the latest, and the reading that followed it */
    int tick_number = (int)number_at(body + 3);
    uint32_t reference;
    memcpy(&reference, &references_um[tick_number - 1], sizeof reference); /* of the present sample, not of later */
    TEST_ASSERT_EQUAL_HEX32(reference, number_at(body + 7));
    TEST_ASSERT_EQUAL_UINT32(codes[tick_number], number_at(body + 15));
    TEST_ASSERT_EQUAL_INT32(100 + tick_number + 1, (int32_t)number_at(body + 19));
    samples++;
    return true;
}

/* As at power up: main.c's own variables. */
static void power_up(void)
{
    memset(line, 0, sizeof line);
    memset(&counts, 0, sizeof counts);
    memset(sample, 0, sizeof sample);
    sweeping = TRACK_SWEEP;
    finished = false;
    held = waited = 0;
}

void setUp(void)
{
    power_up();
    timer = NULL;
    ticks = asked = written = samples = infos = 0;
    last_state = -1;
    lost = cycles = 0;
    line_full = was_reset = false;
    made_safe = -1;
    memset(output, 0, sizeof output);
    flashed = rdpi_chain;
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_chain_init(&expected, &flashed, 1.0f / TRACK_RATE_HZ));
    float rest_um = rdpi_f32_predict(&expected.axis, expected.axis.drive_V, 0);
    for (int k = 0; k < TICKS; k++) {
        references_um[k] = rest_um + 2 * sinf(0.3f * (float)k);
    }
    rdpi_port_start_StubWithCallback(start);
    rdpi_port_idle_StubWithCallback(idle);
    rdpi_port_write_dac_StubWithCallback(write_dac);
    rdpi_port_safe_StubWithCallback(safe);
    rdpi_port_watchdog_reset_StubWithCallback(watchdog_reset);
    rdpi_port_read_adc_StubWithCallback(read_adc);
    rdpi_port_overruns_StubWithCallback(overruns);
    rdpi_port_cycles_StubWithCallback(count_cycles);
    rdpi_port_send_StubWithCallback(send_bytes);
    rdpi_reference_um_StubWithCallback(reference_um);
}

void tearDown(void)
{
}

static void runs_as_the_library_steps(void)
{
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_INT(TICKS + 1, ticks); /* the last finds no reference and sends the reading of the one before */
    TEST_ASSERT_EQUAL_INT(TICKS + 1, written);
    TEST_ASSERT_EQUAL_UINT32(expected.axis.dac_code, codes[0]);
    for (int k = 0; k < TICKS; k++) {
        rdpi_f32_chain_step(&expected, ahead_of(k));
        TEST_ASSERT_EQUAL_UINT32(expected.axis.dac_code, codes[k + 1]);
    }
}

void test_every_tick_outputs_the_code_of_its_reference(void)
{
    runs_as_the_library_steps();
    TEST_ASSERT_NOT_EQUAL_UINT32(codes[1], codes[TICKS / 2]);
}

void test_the_chain_is_given_the_reference_of_later(void)
{
    flashed.delay_s = 3e-4f;
    flashed.lead_s = 2e-4f;
    flashed.digest = rdpi_f32_chain_digest(&flashed);
    TEST_ASSERT_EQUAL_INT(RDPI_OK, rdpi_f32_chain_init(&expected, &flashed, 1.0f / TRACK_RATE_HZ));
    TEST_ASSERT_EQUAL_UINT32(4, expected.preview_samples);
    runs_as_the_library_steps();
    uint32_t led = codes[TICKS / 2];
    setUp();
    runs_as_the_library_steps();
    TEST_ASSERT_NOT_EQUAL_UINT32(codes[TICKS / 2], led);
}

void test_every_sample_is_sent_with_the_reading_one_period_later(void)
{
    runs_as_the_library_steps();
    TEST_ASSERT_EQUAL_INT(TICKS, samples);
}

void test_the_host_is_told_of_the_start_and_of_the_end(void)
{
    runs_as_the_library_steps();
    TEST_ASSERT_EQUAL_INT(2, infos);
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_FINISHED, last_state);
    TEST_ASSERT_EQUAL_UINT32(10, counts.longest_tick_cycles);
}

void test_after_the_end_the_output_is_held_and_the_host_told_so_again(void)
{
    runs_as_the_library_steps();
    for (int k = TICKS + 1; k < 1500; k++) {
        timer();
    }
    TEST_ASSERT_EQUAL_INT(TICKS + 1, written);
    TEST_ASSERT_EQUAL_INT(TICKS, samples);
    TEST_ASSERT_EQUAL_INT(2 + 15, infos); /* every 100 samples */
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_FINISHED, last_state);
}

void test_a_tick_without_reference_outputs_the_code_before(void)
{
    references_um[7] = NAN;
    runs_as_the_library_steps();
    TEST_ASSERT_EQUAL_UINT32(codes[7], codes[8]);
    TEST_ASSERT_EQUAL_UINT32(1, counts.input_count);
}

static bool sweep_expected; /* the library is still sweeping */
static int swept;

static bool write_what_the_library_sweeps_and_steps(const uint32_t *code, int calls)
{
    if (calls > 0 && sweep_expected) {
        sweep_expected = rdpi_f32_chain_sweep(&expected);
        swept++;
    } else if (calls > 0) {
        rdpi_f32_chain_step(&expected, ahead_of(calls - swept - 1));
    }
    TEST_ASSERT_EQUAL_UINT32(expected.axis.dac_code, *code);
    written++;
    return true;
}

static bool count_frames(const uint8_t *bytes, size_t count, int calls)
{
    (void)bytes;
    (void)calls;
    samples += count < 64u;
    infos += count >= 64u;
    return true;
}

void test_the_start_up_sweep_comes_first(void)
{
    sweeping = 1;
    sweep_expected = true;
    swept = 0;
    rdpi_port_write_dac_StubWithCallback(write_what_the_library_sweeps_and_steps);
    rdpi_port_send_StubWithCallback(count_frames);
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_FALSE(sweep_expected);
    TEST_ASSERT_GREATER_THAN_INT(100, swept);
    TEST_ASSERT_EQUAL_INT(1 + swept + TICKS, written);
    TEST_ASSERT_EQUAL_INT(swept + TICKS, samples);
    TEST_ASSERT_EQUAL_INT(2 + (swept + TICKS) / 1000, infos); /* and one every 1000 samples */
}

static void lose_two_after_ten(int calls)
{
    idle(calls);
    if (ticks == 10) {
        lost = 2;
    }
}

void test_lost_ticks_are_missed_samples_of_the_reference(void)
{
    rdpi_port_idle_StubWithCallback(lose_two_after_ten);
    for (int k = 0; k < 10; k++) {
        rdpi_f32_chain_step(&expected, ahead_of(k));
    }
    rdpi_f32_chain_missed(&expected, 2);
    rdpi_f32_chain_step(&expected, ahead_of(12));
    rdpi_port_send_StubWithCallback(NULL);
    rdpi_port_send_IgnoreAndReturn(true);
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_UINT32(expected.axis.dac_code, codes[11]);
    TEST_ASSERT_EQUAL_INT(TICKS - 2 + 1, written);
    TEST_ASSERT_EQUAL_UINT32(2, counts.overruns);
    TEST_ASSERT_EQUAL_UINT32(2, counts.missed_count);
    TEST_ASSERT_EQUAL_UINT32(TICKS + 1, sample[0].tick);
}

void test_a_full_line_to_the_host_changes_no_code_and_is_counted(void)
{
    line_full = true;
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_UINT32(TICKS, line[0].refused_count);
    for (int k = 0; k < TICKS; k++) {
        rdpi_f32_chain_step(&expected, ahead_of(k));
        TEST_ASSERT_EQUAL_UINT32(expected.axis.dac_code, codes[k + 1]);
    }
    TEST_ASSERT_EQUAL_INT(TICKS + 1, written);
}

static uint16_t flags_of[TICKS + 2]; /* by tick */

static bool keep_flags(const uint8_t *bytes, size_t count, int calls)
{
    uint8_t copy[RDPI_TELEMETRY_MAX_BYTES];
    (void)calls;
    memcpy(copy, bytes, count);
    decode(copy, count);
    if (copy[1] == 1u) {
        flags_of[copy[4]] = (uint16_t)(copy[24] | copy[25] << 8);
    }
    return true;
}

static int refused_from, refused_to; /* writes that the DAC does not take, from 0 */

static bool take_some(const uint32_t *code, int calls)
{
    bool taken = calls < refused_from || calls > refused_to;
    TEST_ASSERT_TRUE(calls <= TICKS + 1);
    output[calls] = taken ? *code : output[calls > 0 ? calls - 1 : 0];
    return write_dac(code, calls) && taken;
}

static void refuses(int from, int to)
{
    refused_from = from;
    refused_to = to;
    rdpi_port_write_dac_StubWithCallback(take_some);
    rdpi_port_send_StubWithCallback(keep_flags);
}

void test_a_code_that_the_dac_does_not_take_is_flagged_and_counted(void)
{
    refuses(5, 7);
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_UINT32(3, counts.held_count);
    for (int k = 1; k <= TICKS; k++) {
        TEST_ASSERT_EQUAL_HEX16(k >= 5 && k <= 7 ? RDPI_TELEMETRY_HELD : 0, flags_of[k] & RDPI_TELEMETRY_HELD);
    }
}

/* The library counts on each code, and the reference goes on with time. */
void test_a_code_that_the_dac_does_not_take_is_written_until_it_does(void)
{
    refuses(5, 7);
    TEST_ASSERT_EQUAL_INT(0, track_main());
    for (int k = 0; k < 5; k++) {
        rdpi_f32_chain_step(&expected, ahead_of(k));
    }
    TEST_ASSERT_EQUAL_UINT32(expected.axis.dac_code, output[8]);
    TEST_ASSERT_EQUAL_UINT32(output[4], output[7]);
    rdpi_f32_chain_missed(&expected, 3);
    for (int k = 8; k < TICKS; k++) {
        rdpi_f32_chain_step(&expected, ahead_of(k));
        TEST_ASSERT_EQUAL_UINT32(expected.axis.dac_code, output[k + 1]);
    }
    TEST_ASSERT_EQUAL_UINT32(3, counts.missed_count);
}

void test_a_code_that_the_dac_does_not_take_makes_no_step_beyond_the_slew_limit(void)
{
    rdpi_f32_params_t slow = *flashed.axis;
    slow.slew_V_per_s = slow.sweep_V_per_s; /* slower than the reference */
    slow.digest = rdpi_f32_digest(&slow);
    flashed.axis = &slow;
    flashed.digest = rdpi_f32_chain_digest(&flashed);
    uint32_t most = (uint32_t)(slow.slew_V_per_s / TRACK_RATE_HZ / slow.V_per_code) + 1u;
    refuses(5, 7);
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_GREATER_THAN_UINT32(0, counts.clip_count);
    for (int k = 1; k <= TICKS; k++) {
        uint32_t step = output[k] > output[k - 1] ? output[k] - output[k - 1] : output[k - 1] - output[k];
        TEST_ASSERT_TRUE(step <= most);
    }
}

void test_after_the_end_the_dac_has_the_last_code(void)
{
    references_um[TICKS - 1] = references_um[5];
    refuses(TICKS, TICKS);
    TEST_ASSERT_EQUAL_INT(0, track_main());
    for (int k = 0; k < TICKS; k++) {
        rdpi_f32_chain_step(&expected, ahead_of(k));
    }
    TEST_ASSERT_NOT_EQUAL_UINT32(output[TICKS - 1], expected.axis.dac_code);
    TEST_ASSERT_EQUAL_UINT32(expected.axis.dac_code, output[TICKS + 1]);
}

void test_a_dac_that_stays_away_ends_in_the_safe_state_and_the_host_is_told(void)
{
    refuses(5, TICKS);
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_INT(5 + 10, written);
    TEST_ASSERT_EQUAL_INT(written, made_safe);
    TEST_ASSERT_EQUAL_UINT32(10, counts.held_count);
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_SAFE, counts.state);
    for (int k = 0; k < 200; k++) {
        timer();
    }
    TEST_ASSERT_EQUAL_INT(made_safe, written);
}

void test_a_dac_that_comes_back_before_ends_the_row(void)
{
    refuses(5, 13);
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_UINT32(9, counts.held_count);
    TEST_ASSERT_EQUAL_UINT32(0, held);
    TEST_ASSERT_EQUAL_INT(-1, made_safe);
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_FINISHED, counts.state);
}

void test_nothing_runs_if_the_dac_does_not_take_the_first_code(void)
{
    refuses(0, 0);
    rdpi_port_send_StubWithCallback(send_bytes);
    TEST_ASSERT_EQUAL_INT(1, track_main());
    TEST_ASSERT_EQUAL_INT(0, ticks);
    TEST_ASSERT_NULL(timer);
    TEST_ASSERT_EQUAL_INT(1, written);
    TEST_ASSERT_EQUAL_INT(1, made_safe);
    TEST_ASSERT_EQUAL_UINT32(1, counts.held_count);
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_REFUSED, last_state);
}

void test_nothing_runs_on_a_board_without_such_a_timer(void)
{
    rdpi_port_start_StubWithCallback(NULL);
    rdpi_port_start_ExpectAndReturn(TRACK_RATE_HZ, tick, false);
    TEST_ASSERT_EQUAL_INT(1, track_main());
    TEST_ASSERT_EQUAL_INT(0, ticks);
    TEST_ASSERT_EQUAL_INT(1, written);
    TEST_ASSERT_EQUAL_INT(1, made_safe);
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_REFUSED, last_state);
}

void test_after_a_reset_by_the_watchdog_nothing_moves_and_the_host_is_told(void)
{
    was_reset = true;
    TEST_ASSERT_EQUAL_INT(1, track_main());
    TEST_ASSERT_EQUAL_INT(0, written);
    TEST_ASSERT_EQUAL_INT(0, ticks);
    TEST_ASSERT_EQUAL_INT(2, infos); /* a start, for the decoder to begin anew, and what came of it */
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_RESET, last_state);
}

static int lose_each, lose_for; /* ticks lost before each of so many */

static void lose_some(int calls)
{
    idle(calls);
    lost += ticks >= 10 && ticks < 10 + lose_for ? (uint32_t)lose_each : 0u;
}

static void loses(int each, int for_ticks)
{
    lose_each = each;
    lose_for = for_ticks;
    rdpi_port_idle_StubWithCallback(lose_some);
    rdpi_port_send_StubWithCallback(count_frames);
    TEST_ASSERT_EQUAL_INT(0, track_main());
}

void test_too_many_ticks_lost_in_a_row_lead_to_the_safe_state_and_the_host_is_told(void)
{
    loses(2, 100);
    TEST_ASSERT_EQUAL_INT(1 + 12, written); /* with the tick that makes it 6 none is */
    TEST_ASSERT_EQUAL_INT(written, made_safe);
    TEST_ASSERT_EQUAL_INT(12, samples);
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_SAFE, counts.state);
    TEST_ASSERT_EQUAL_UINT32(6, counts.overruns);
    int told = infos;
    for (int k = 0; k < 200; k++) {
        timer();
    }
    TEST_ASSERT_EQUAL_INT(made_safe, written);
    TEST_ASSERT_EQUAL_INT(told + 2, infos);
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_SAFE, counts.state);
}

void test_fewer_lost_in_a_row_are_missed_samples(void)
{
    loses(2, 2);
    TEST_ASSERT_EQUAL_INT(-1, made_safe);
    TEST_ASSERT_EQUAL_UINT32(4, counts.missed_count);
    TEST_ASSERT_EQUAL_INT(RDPI_TELEMETRY_FINISHED, counts.state);
}

static void lose_every_other(int calls)
{
    idle(calls);
    lost += ticks % 2 == 0 ? 4u : 0u;
}

void test_a_tick_in_time_ends_the_row(void)
{
    rdpi_port_idle_StubWithCallback(lose_every_other);
    rdpi_port_send_StubWithCallback(count_frames);
    TEST_ASSERT_EQUAL_INT(0, track_main());
    TEST_ASSERT_EQUAL_INT(-1, made_safe);
    TEST_ASSERT_GREATER_THAN_UINT32(TICK_MAX_OVERRUNS, counts.overruns);
}
