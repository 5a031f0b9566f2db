/* The MCP4922 driver: every byte it sends, in which order, and what it refuses. The bus is a mock of
 * port/include/rdpi_spi.h. The bytes are written out from the table in mcp4922.h, none is computed. */
#include "unity.h"

#include "mcp4922.h"
#include "mock_rdpi_spi.h"

TEST_SOURCE_FILE("port/drivers/mcp4922.c")

/* One transfer of so many frames, of these bytes; the bus was asked first, and was free. */
#define EXPECT_SENT(frames, ...)                                                                        \
    rdpi_spi_busy_ExpectAndReturn(false);                                                               \
    rdpi_spi_write_ExpectWithArray(((const uint8_t[]){__VA_ARGS__}), 2 * (frames), 2, frames)

static rdpi_mcp4922_t dac;

void setUp(void)
{
    const rdpi_mcp4922_config_t config = {0};
    rdpi_mcp4922_init(&dac, &config);
}

void tearDown(void)
{
}

void test_init_sends_nothing_and_clears_the_counters(void)
{
    const rdpi_mcp4922_config_t config = {0};
    dac.busy_count = dac.code_count = 7;
    rdpi_mcp4922_init(&dac, &config);
    TEST_ASSERT_EQUAL_UINT32(0, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.code_count);
}

void test_a_write_sends_channel_a_then_channel_b(void)
{
    EXPECT_SENT(2, 0x31, 0x23, 0xba, 0xbc);
    TEST_ASSERT_TRUE(rdpi_mcp4922_write(&dac, 0x123, 0xabc));
}

void test_a_write_of_one_channel_sends_one_frame(void)
{
    EXPECT_SENT(1, 0x31, 0x23);
    TEST_ASSERT_TRUE(rdpi_mcp4922_write_channel(&dac, RDPI_MCP4922_A, 0x123));
    EXPECT_SENT(1, 0xba, 0xbc);
    TEST_ASSERT_TRUE(rdpi_mcp4922_write_channel(&dac, RDPI_MCP4922_B, 0xabc));
}

/* What both channels are sent with this wiring: their first bytes, without the code's bits. */
static void sends(rdpi_mcp4922_config_t config, uint8_t a, uint8_t b)
{
    rdpi_mcp4922_init(&dac, &config);
    EXPECT_SENT(2, a, 0x00, b, 0x00);
    TEST_ASSERT_TRUE(rdpi_mcp4922_write(&dac, 0, 0));
    EXPECT_SENT(1, a, 0x00);
    TEST_ASSERT_TRUE(rdpi_mcp4922_write_channel(&dac, RDPI_MCP4922_A, 0));
    EXPECT_SENT(1, b, 0x00);
    TEST_ASSERT_TRUE(rdpi_mcp4922_write_channel(&dac, RDPI_MCP4922_B, 0));
}

void test_each_frame_holds_the_wiring(void)
{
    sends((rdpi_mcp4922_config_t){0}, 0x30, 0xb0);
    sends((rdpi_mcp4922_config_t){.gain_2 = true}, 0x10, 0x90);
    sends((rdpi_mcp4922_config_t){.buffered = true}, 0x70, 0xf0);
    sends((rdpi_mcp4922_config_t){.buffered = true, .gain_2 = true}, 0x50, 0xd0);
}

void test_the_ends_of_the_range(void)
{
    EXPECT_SENT(2, 0x30, 0x00, 0xbf, 0xff);
    TEST_ASSERT_TRUE(rdpi_mcp4922_write(&dac, 0, 4095));
    EXPECT_SENT(2, 0x3f, 0xff, 0xb0, 0x00);
    TEST_ASSERT_TRUE(rdpi_mcp4922_write(&dac, 4095, 0));
}

void test_a_code_beyond_the_range_holds_both_outputs_and_is_counted(void)
{
    rdpi_spi_busy_IgnoreAndReturn(false);
    TEST_ASSERT_FALSE(rdpi_mcp4922_write(&dac, 4096, 0));
    TEST_ASSERT_FALSE(rdpi_mcp4922_write(&dac, 0, 4096));
    TEST_ASSERT_FALSE(rdpi_mcp4922_write_channel(&dac, RDPI_MCP4922_A, 4096));
    TEST_ASSERT_FALSE(rdpi_mcp4922_write_channel(&dac, RDPI_MCP4922_B, UINT32_MAX));
    TEST_ASSERT_EQUAL_UINT32(4, dac.code_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.busy_count);
}

static const uint8_t *sending;

static void remember(const uint8_t *bytes, size_t frame_bytes, size_t frames, int calls)
{
    (void)frame_bytes;
    (void)frames;
    (void)calls;
    sending = bytes;
}

void test_a_write_during_a_transfer_is_refused_and_counted_and_spoils_nothing(void)
{
    rdpi_spi_write_StubWithCallback(remember);
    rdpi_spi_busy_ExpectAndReturn(false);
    TEST_ASSERT_TRUE(rdpi_mcp4922_write(&dac, 0x123, 0xabc));
    rdpi_spi_busy_IgnoreAndReturn(true);
    TEST_ASSERT_FALSE(rdpi_mcp4922_write(&dac, 0x555, 0x555));
    TEST_ASSERT_FALSE(rdpi_mcp4922_write_channel(&dac, RDPI_MCP4922_B, 0x555));
    TEST_ASSERT_FALSE(rdpi_mcp4922_write(&dac, 4096, 4096));
    const uint8_t expected[] = {0x31, 0x23, 0xba, 0xbc};
    TEST_ASSERT_EQUAL_UINT8_ARRAY(expected, sending, 4);
    TEST_ASSERT_EQUAL_UINT32(3, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.code_count);
}

void test_counters_saturate(void)
{
    dac.busy_count = UINT32_MAX;
    dac.code_count = UINT32_MAX - 1;
    rdpi_spi_busy_ExpectAndReturn(true);
    rdpi_mcp4922_write(&dac, 0, 0);
    rdpi_spi_busy_IgnoreAndReturn(false);
    rdpi_mcp4922_write(&dac, 4096, 0);
    rdpi_mcp4922_write(&dac, 4096, 0);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, dac.code_count);
}

void test_the_safe_frames_are_those_of_a_write_and_nothing_is_sent(void)
{
    const rdpi_mcp4922_config_t wiring = {.gain_2 = true};
    const uint8_t expected[RDPI_MCP4922_SAFE_BYTES] = {0x11, 0x23, 0x9a, 0xbc};
    uint8_t bytes[RDPI_MCP4922_SAFE_BYTES];
    rdpi_mcp4922_safe_frames(&wiring, 0x123, 0xabc, bytes); /* the mocked bus expects nothing */
    TEST_ASSERT_EQUAL_HEX8_ARRAY(expected, bytes, RDPI_MCP4922_SAFE_BYTES);
}

void test_a_safe_code_beyond_the_range_changes_no_other_bit(void)
{
    const rdpi_mcp4922_config_t wiring = {0};
    const uint8_t expected[RDPI_MCP4922_SAFE_BYTES] = {0x3f, 0xff, 0xb0, 0x01};
    uint8_t bytes[RDPI_MCP4922_SAFE_BYTES];
    rdpi_mcp4922_safe_frames(&wiring, UINT32_MAX, 0x1001, bytes);
    TEST_ASSERT_EQUAL_HEX8_ARRAY(expected, bytes, RDPI_MCP4922_SAFE_BYTES);
}
