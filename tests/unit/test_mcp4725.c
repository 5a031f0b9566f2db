/* The MCP4725 driver: every byte it sends, to which address, what it refuses and what it makes of a DAC that does not
 * acknowledge. The bus is a mock of port/include/rdpi_i2c.h. The bytes are written out from the table in mcp4725.h, none
 * is computed. */
#include "unity.h"

#include "mcp4725.h"
#include "mock_rdpi_i2c.h"

TEST_SOURCE_FILE("port/drivers/mcp4725.c")

/* One transfer of these bytes to 0x62. The bus was asked first and was not busy, and is then in this state. */
#define EXPECT_SENT(then, ...)                                                                          \
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_DONE);                                                      \
    EXPECT_SENT_AGAIN(then, __VA_ARGS__)
#define EXPECT_SENT_AGAIN(then, ...)                                                                    \
    rdpi_i2c_write_ExpectWithArray(0x62, ((const uint8_t[]){__VA_ARGS__}), 2, 2);                       \
    rdpi_i2c_state_ExpectAndReturn(then)

static rdpi_mcp4725_t dac;

static void prepared(uint8_t address)
{
    const rdpi_mcp4725_config_t config = {.address = address};
    rdpi_mcp4725_init(&dac, &config);
}

void setUp(void)
{
    prepared(0x62);
}

void tearDown(void)
{
}

static void started(void)
{
    EXPECT_SENT(RDPI_I2C_DONE, 0x00, 0x00);
    TEST_ASSERT_TRUE(rdpi_mcp4725_start(&dac, 0));
}

void test_init_sends_nothing_and_clears_the_counters(void)
{
    dac.busy_count = dac.code_count = dac.fail_count = 7;
    prepared(0x62);
    TEST_ASSERT_EQUAL_UINT32(0, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.code_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.fail_count);
}

void test_start_outputs_the_first_code_of_a_board_that_sends_at_once(void)
{
    EXPECT_SENT(RDPI_I2C_DONE, 0x01, 0x23);
    TEST_ASSERT_TRUE(rdpi_mcp4725_start(&dac, 0x123));
    TEST_ASSERT_TRUE(rdpi_mcp4725_start(&dac, 0x123)); /* nothing is sent any more */
    TEST_ASSERT_EQUAL_UINT32(0, dac.fail_count);
}

void test_start_waits_for_the_acknowledge_bits_of_a_board_that_sends_later(void)
{
    EXPECT_SENT(RDPI_I2C_BUSY, 0x01, 0x23);
    TEST_ASSERT_FALSE(rdpi_mcp4725_start(&dac, 0x123));
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_BUSY);
    TEST_ASSERT_FALSE(rdpi_mcp4725_start(&dac, 0x123));
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_DONE);
    TEST_ASSERT_TRUE(rdpi_mcp4725_start(&dac, 0x123));
}

void test_start_sends_again_until_the_dac_answers(void)
{
    EXPECT_SENT(RDPI_I2C_FAILED, 0x01, 0x23);
    TEST_ASSERT_FALSE(rdpi_mcp4725_start(&dac, 0x123));
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_FAILED); /* of the same transfer: it is counted once */
    EXPECT_SENT_AGAIN(RDPI_I2C_BUSY, 0x01, 0x23);
    TEST_ASSERT_FALSE(rdpi_mcp4725_start(&dac, 0x123));
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_FAILED);
    TEST_ASSERT_FALSE(rdpi_mcp4725_start(&dac, 0x123));
    TEST_ASSERT_EQUAL_UINT32(2, dac.fail_count);
    EXPECT_SENT(RDPI_I2C_DONE, 0x01, 0x23);
    TEST_ASSERT_TRUE(rdpi_mcp4725_start(&dac, 0x123));
    TEST_ASSERT_EQUAL_UINT32(2, dac.fail_count);
}

void test_start_sends_nothing_on_a_bus_that_others_keep_busy(void)
{
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_BUSY);
    TEST_ASSERT_FALSE(rdpi_mcp4725_start(&dac, 0x123));
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_FAILED); /* theirs */
    EXPECT_SENT_AGAIN(RDPI_I2C_DONE, 0x01, 0x23);
    TEST_ASSERT_TRUE(rdpi_mcp4725_start(&dac, 0x123));
    TEST_ASSERT_EQUAL_UINT32(0, dac.fail_count);
}

void test_start_with_a_code_beyond_the_range_sends_nothing(void)
{
    TEST_ASSERT_FALSE(rdpi_mcp4725_start(&dac, 4096));
    TEST_ASSERT_EQUAL_UINT32(1, dac.code_count);
}

void test_the_eight_addresses_of_the_part(void)
{
    for (uint8_t address = 0x60; address <= 0x67; address++) {
        prepared(address);
        rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_DONE);
        rdpi_i2c_write_ExpectWithArray(address, ((const uint8_t[]){0x0f, 0xff}), 2, 2);
        rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_DONE);
        TEST_ASSERT_TRUE(rdpi_mcp4725_start(&dac, 4095));
    }
}

void test_nothing_is_sent_to_an_address_that_no_part_has(void)
{
    const uint8_t others[] = {0x00, 0x5f, 0x68, 0xc4, 0xe0, 0xff}; /* all parts; beside the range; shifted by one bit */
    for (unsigned k = 0; k < sizeof others; k++) {
        prepared(others[k]);
        TEST_ASSERT_FALSE(rdpi_mcp4725_start(&dac, 0x600));
        TEST_ASSERT_FALSE(rdpi_mcp4725_write(&dac, 0x600));
    }
}

void test_a_write_before_the_end_of_start_is_refused_and_counted(void)
{
    TEST_ASSERT_FALSE(rdpi_mcp4725_write(&dac, 1));
    EXPECT_SENT(RDPI_I2C_FAILED, 0x00, 0x00);
    TEST_ASSERT_FALSE(rdpi_mcp4725_start(&dac, 0));
    TEST_ASSERT_FALSE(rdpi_mcp4725_write(&dac, 1));
    TEST_ASSERT_EQUAL_UINT32(2, dac.busy_count);
}

void test_a_write_sends_the_code_with_the_power_on(void)
{
    started();
    EXPECT_SENT(RDPI_I2C_DONE, 0x01, 0x23);
    TEST_ASSERT_TRUE(rdpi_mcp4725_write(&dac, 0x123));
    EXPECT_SENT(RDPI_I2C_BUSY, 0x0a, 0xbc);
    TEST_ASSERT_TRUE(rdpi_mcp4725_write(&dac, 0xabc));
    EXPECT_SENT(RDPI_I2C_DONE, 0x00, 0x00);
    TEST_ASSERT_TRUE(rdpi_mcp4725_write(&dac, 0));
    EXPECT_SENT(RDPI_I2C_DONE, 0x0f, 0xff);
    TEST_ASSERT_TRUE(rdpi_mcp4725_write(&dac, 4095));
    TEST_ASSERT_EQUAL_UINT32(0, dac.fail_count);
}

void test_a_code_beyond_the_range_holds_the_output_and_is_counted(void)
{
    started();
    rdpi_i2c_state_IgnoreAndReturn(RDPI_I2C_DONE);
    TEST_ASSERT_FALSE(rdpi_mcp4725_write(&dac, 4096));
    TEST_ASSERT_FALSE(rdpi_mcp4725_write(&dac, UINT32_MAX));
    TEST_ASSERT_EQUAL_UINT32(2, dac.code_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.busy_count);
}

void test_a_code_that_is_not_acknowledged_is_told_at_once_by_a_board_that_sends_at_once(void)
{
    started();
    EXPECT_SENT(RDPI_I2C_FAILED, 0x01, 0x23);
    TEST_ASSERT_FALSE(rdpi_mcp4725_write(&dac, 0x123));
    TEST_ASSERT_EQUAL_UINT32(1, dac.fail_count);
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_FAILED); /* still of that transfer */
    EXPECT_SENT_AGAIN(RDPI_I2C_DONE, 0x01, 0x24);
    TEST_ASSERT_TRUE(rdpi_mcp4725_write(&dac, 0x124));
    TEST_ASSERT_EQUAL_UINT32(1, dac.fail_count);
}

void test_a_code_that_is_not_acknowledged_is_counted_one_write_later_by_a_board_that_sends_later(void)
{
    started();
    EXPECT_SENT(RDPI_I2C_BUSY, 0x01, 0x23);
    TEST_ASSERT_TRUE(rdpi_mcp4725_write(&dac, 0x123));
    TEST_ASSERT_EQUAL_UINT32(0, dac.fail_count);
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_FAILED);
    EXPECT_SENT_AGAIN(RDPI_I2C_BUSY, 0x01, 0x24);
    TEST_ASSERT_TRUE(rdpi_mcp4725_write(&dac, 0x124));
    TEST_ASSERT_EQUAL_UINT32(1, dac.fail_count);
}

static const uint8_t *sending;

static void remember(uint8_t address, const uint8_t *bytes, size_t count, int calls)
{
    (void)address;
    (void)count;
    (void)calls;
    sending = bytes;
}

void test_a_write_during_a_transfer_is_refused_and_counted_and_spoils_nothing(void)
{
    started();
    rdpi_i2c_write_StubWithCallback(remember);
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_DONE);
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_BUSY);
    TEST_ASSERT_TRUE(rdpi_mcp4725_write(&dac, 0x123));
    rdpi_i2c_state_IgnoreAndReturn(RDPI_I2C_BUSY);
    TEST_ASSERT_FALSE(rdpi_mcp4725_write(&dac, 0x555));
    TEST_ASSERT_FALSE(rdpi_mcp4725_write(&dac, 4096));
    const uint8_t expected[] = {0x01, 0x23};
    TEST_ASSERT_EQUAL_UINT8_ARRAY(expected, sending, 2);
    TEST_ASSERT_EQUAL_UINT32(2, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.code_count);
}

void test_counters_saturate(void)
{
    started();
    dac.busy_count = UINT32_MAX;
    dac.code_count = UINT32_MAX - 1;
    dac.fail_count = UINT32_MAX - 1;
    rdpi_i2c_state_ExpectAndReturn(RDPI_I2C_BUSY);
    rdpi_mcp4725_write(&dac, 0);
    rdpi_i2c_state_IgnoreAndReturn(RDPI_I2C_FAILED);
    rdpi_i2c_write_Ignore();
    for (int k = 0; k < 2; k++) {
        rdpi_mcp4725_write(&dac, 4096);
        rdpi_mcp4725_write(&dac, 0);
    }
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, dac.code_count);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, dac.fail_count);
}

void test_the_safe_frame_is_a_fast_write_and_nothing_is_sent(void)
{
    const uint8_t expected[][RDPI_MCP4725_SAFE_BYTES] = {{0x0a, 0xbc}, {0x0f, 0xff}};
    const uint32_t codes[] = {0xabc, UINT32_MAX}; /* beyond the range no other bit changes: 4x or 6x is another command */
    for (int k = 0; k < 2; k++) {
        uint8_t bytes[RDPI_MCP4725_SAFE_BYTES];
        rdpi_mcp4725_safe_frames(codes[k], bytes); /* the mocked bus expects nothing */
        TEST_ASSERT_EQUAL_HEX8_ARRAY(expected[k], bytes, RDPI_MCP4725_SAFE_BYTES);
    }
}

void test_the_frame_of_power_up_writes_the_eeprom_and_nothing_is_sent(void)
{
    const uint8_t expected[][RDPI_MCP4725_POWER_UP_BYTES] = {{0x60, 0xab, 0xc0}, {0x60, 0x00, 0x10}, {0x60, 0xff, 0xf0}};
    const uint32_t codes[] = {0xabc, 0x1001, UINT32_MAX};
    for (int k = 0; k < 3; k++) {
        uint8_t bytes[RDPI_MCP4725_POWER_UP_BYTES];
        rdpi_mcp4725_power_up_frame(codes[k], bytes);
        TEST_ASSERT_EQUAL_HEX8_ARRAY(expected[k], bytes, RDPI_MCP4725_POWER_UP_BYTES);
    }
}
