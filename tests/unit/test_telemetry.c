/* Telemetry frames, byte by byte; the line to the host is a mock of port/include/rdpi_port.h. */
#include "unity.h"

#include <string.h>

#include "mock_rdpi_port.h"
#include "telemetry.h"

TEST_SOURCE_FILE("port/drivers/telemetry.c")

static uint8_t sent[256], body[256];
static size_t sent_count;
static bool taken;

static bool keep(const uint8_t *bytes, size_t count, int calls)
{
    (void)calls;
    TEST_ASSERT_TRUE(count <= RDPI_TELEMETRY_MAX_BYTES);
    memcpy(sent, bytes, count);
    sent_count = count;
    return taken;
}

/* CRC-16/IBM-3740, bit by bit. */
static uint16_t crc16(const uint8_t *bytes, size_t count)
{
    unsigned crc = 0xFFFFu;
    for (size_t k = 0; k < count; k++) {
        crc ^= (unsigned)bytes[k] << 8;
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000u) != 0u ? (crc << 1) ^ 0x1021u : crc << 1;
        }
    }
    return (uint16_t)crc;
}

/* Decodes what was sent to `body`; returns its length without the CRC, which it checks. */
static size_t received(void)
{
    size_t count = 0, k = 0;
    TEST_ASSERT_EQUAL_UINT8(0, sent[sent_count - 1u]);
    TEST_ASSERT_NULL(memchr(sent, 0, sent_count - 1u));
    while (k < sent_count - 1u) {
        size_t code = sent[k];
        TEST_ASSERT_TRUE(k + code <= sent_count - 1u);
        memcpy(&body[count], &sent[k + 1u], code - 1u);
        count += code - 1u;
        k += code;
        if (code < 0xFFu && k < sent_count - 1u) {
            body[count++] = 0;
        }
    }
    TEST_ASSERT_EQUAL_HEX16(crc16(body, count - 2u), body[count - 2u] | body[count - 1u] << 8);
    return count - 2u;
}

void setUp(void)
{
    taken = true;
    sent_count = 0;
    rdpi_port_send_StubWithCallback(keep);
}

void tearDown(void)
{
}

static const rdpi_telemetry_sample_t sample = {.tick = 0x04030201u, .reference = 0x14131211u, .rate = 0x24232221u,
                                               .dac_code = 0x34333231u, .adc_counts = 0x44434241, .flags = 0x5251u};

void test_the_crc_here_is_the_one_of_the_catalogue(void)
{
    TEST_ASSERT_EQUAL_HEX16(0x29B1, crc16((const uint8_t *)"123456789", 9));
}

void test_a_sample_is_laid_out_as_documented(void)
{
    static const uint8_t layout[25] = {1, 0, 0, 1, 2, 3, 4, 0x11, 0x12, 0x13, 0x14, 0x21, 0x22, 0x23, 0x24,
                                       0x31, 0x32, 0x33, 0x34, 0x41, 0x42, 0x43, 0x44, 0x51, 0x52};
    rdpi_telemetry_t line = {0};
    TEST_ASSERT_TRUE(rdpi_telemetry_sample(&line, &sample));
    TEST_ASSERT_EQUAL_size_t(29, sent_count);
    TEST_ASSERT_EQUAL_size_t(25, received());
    TEST_ASSERT_EQUAL_HEX8_ARRAY(layout, body, 25);
}

void test_the_first_byte_holds_the_axis(void)
{
    rdpi_telemetry_t line = {.axis = 15};
    (void)rdpi_telemetry_sample(&line, &sample);
    TEST_ASSERT_EQUAL_size_t(25, received());
    TEST_ASSERT_EQUAL_HEX8(0xF1, body[0]);
    (void)rdpi_telemetry_info(&line, &(rdpi_telemetry_run_t){0}, &(rdpi_telemetry_counts_t){0});
    (void)received();
    TEST_ASSERT_EQUAL_HEX8(0xF2, body[0]);
}

void test_samples_are_numbered_and_the_number_wraps(void)
{
    rdpi_telemetry_t line = {0};
    for (unsigned k = 0; k <= 0x10000u; k++) {
        (void)rdpi_telemetry_sample(&line, &sample);
        (void)received();
        TEST_ASSERT_EQUAL_HEX16(k & 0xFFFFu, body[1] | body[2] << 8);
    }
}

void test_a_sample_that_is_not_taken_is_counted_and_leaves_a_gap_in_the_numbers(void)
{
    rdpi_telemetry_t line = {0};
    taken = false;
    TEST_ASSERT_FALSE(rdpi_telemetry_sample(&line, &sample));
    TEST_ASSERT_EQUAL_UINT32(1, line.refused_count);
    taken = true;
    TEST_ASSERT_TRUE(rdpi_telemetry_sample(&line, &sample));
    (void)received();
    TEST_ASSERT_EQUAL_UINT8(1, body[1]);
    line.refused_count = UINT32_MAX;
    taken = false;
    (void)rdpi_telemetry_sample(&line, &sample);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, line.refused_count);
}

/* A number of the frame, the lowest byte first. */
static uint64_t number(const uint8_t *bytes, size_t count)
{
    uint64_t value = 0;
    for (size_t k = 0; k < count; k++) {
        value |= (uint64_t)bytes[k] << 8 * k;
    }
    return value;
}

void test_any_bytes_survive(void)
{
    rdpi_telemetry_t line = {0};
    uint32_t bits = 1;
    for (int k = 0; k < 20000; k++) {
        rdpi_telemetry_sample_t random = sample;
        bits = bits * 1664525u + 1013904223u;
        random.tick = (bits >> (k % 32)) & 0xFF00FFu; /* many zeros */
        random.reference = bits;
        random.dac_code = bits & 0xFFFFu;
        random.adc_counts = (int32_t)~bits;
        (void)rdpi_telemetry_sample(&line, &random);
        TEST_ASSERT_EQUAL_size_t(25, received());
        TEST_ASSERT_EQUAL_HEX32(random.tick, number(body + 3, 4));
        TEST_ASSERT_EQUAL_HEX32(random.reference, number(body + 7, 4));
        TEST_ASSERT_EQUAL_HEX32(random.dac_code, number(body + 15, 4));
        TEST_ASSERT_EQUAL_HEX32(random.adc_counts, number(body + 19, 4));
    }
}

void test_an_info_is_laid_out_as_documented(void)
{
    static const rdpi_telemetry_run_t run = {.min_V = -20, .max_V = 120, .um_per_reference = 0.25,
                                             .reference_0_um = 1.5, .um_per_s_per_rate = 2, .um_per_count = 0.001,
                                             .count_0_um = -3, .rate_hz = 10000, .cycles_per_s = 168000000,
                                             .dac_bits = 16, .numbers = RDPI_TELEMETRY_INT32};
    static const rdpi_telemetry_counts_t counts = {.overruns = 2, .guard_count = 3, .clip_count = 4, .input_count = 5,
                                                   .missed_count = 6, .held_count = 7, .longest_tick_cycles = 8,
                                                   .state = RDPI_TELEMETRY_REFUSED, .status = -17};
    static const double doubles[7] = {-20, 120, 0.25, 1.5, 2, 0.001, -3};
    static const uint32_t counters[10] = {9, 1, 2, 3, 4, 5, 6, 7, 8, 168000000};
    static const uint8_t head[10] = {2, 1, 3, 0xEF, 0x10, 0x27, 0, 0, 16, 2};
    const rdpi_telemetry_t line = {.offered_count = 9, .refused_count = 1};
    TEST_ASSERT_TRUE(rdpi_telemetry_info(&line, &run, &counts));
    TEST_ASSERT_EQUAL_size_t(RDPI_TELEMETRY_MAX_BYTES, sent_count);
    TEST_ASSERT_EQUAL_size_t(106, received());
    TEST_ASSERT_EQUAL_HEX8_ARRAY(head, body, 10);
    for (size_t k = 0; k < 7; k++) {
        uint64_t bits;
        memcpy(&bits, &doubles[k], sizeof bits);
        TEST_ASSERT_EQUAL_HEX64(bits, number(body + 10 + 8 * k, 8));
    }
    for (size_t k = 0; k < 10; k++) {
        TEST_ASSERT_EQUAL_UINT32(counters[k], number(body + 66 + 4 * k, 4));
    }
}
