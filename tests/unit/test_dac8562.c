/* The DAC8562 driver: every byte it sends, in which order, and what it refuses. The bus is a mock of
 * port/include/rdpi_spi.h. The bytes are written out from the table in dac8562.h, none is computed. */
#include "unity.h"

#include "dac8562.h"
#include "mock_rdpi_spi.h"

TEST_SOURCE_FILE("port/drivers/dac8562.c")

/* One transfer of so many frames, of these bytes; the bus was asked first, and was free. */
#define EXPECT_SENT(frames, ...)                                                                        \
    rdpi_spi_busy_ExpectAndReturn(false);                                                               \
    rdpi_spi_write_ExpectWithArray(((const uint8_t[]){__VA_ARGS__}), 3 * (frames), 3, frames)

static rdpi_dac8562_t dac;

void setUp(void)
{
}

void tearDown(void)
{
}

/* An instance that start has been done with. */
static void started(bool ldac_driven)
{
    const rdpi_dac8562_config_t config = {.ldac_driven = ldac_driven};
    rdpi_dac8562_init(&dac, &config);
    rdpi_spi_busy_IgnoreAndReturn(false);
    rdpi_spi_write_Ignore();
    for (int k = 0; k < 5; k++) {
        TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    }
    TEST_ASSERT_TRUE(rdpi_dac8562_start(&dac));
    rdpi_spi_busy_StopIgnore();
    rdpi_spi_write_StopIgnore();
}

/* The five frames of start, of which those for reference and gain depend on the configuration. */
static void starts_with(rdpi_dac8562_config_t config, uint8_t reference, uint8_t gain)
{
    rdpi_dac8562_init(&dac, &config);
    EXPECT_SENT(1, 0x28, 0x00, 0x01);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    EXPECT_SENT(1, 0x30, 0x00, 0x00);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    EXPECT_SENT(1, 0x38, 0x00, reference);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    EXPECT_SENT(1, 0x02, 0x00, gain);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    EXPECT_SENT(1, 0x20, 0x00, 0x03);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    rdpi_spi_busy_ExpectAndReturn(false);
    TEST_ASSERT_TRUE(rdpi_dac8562_start(&dac));
}

void test_start_resets_then_sets_ldac_reference_gain_and_power(void)
{
    starts_with((rdpi_dac8562_config_t){0}, 0x01, 0x03);
}

void test_start_sets_gain_2_after_the_reference(void)
{
    starts_with((rdpi_dac8562_config_t){.gain_2 = true}, 0x01, 0x00);
}

void test_start_switches_the_internal_reference_off_for_an_external_one(void)
{
    starts_with((rdpi_dac8562_config_t){.external_reference = true}, 0x00, 0x03);
}

void test_start_keeps_gain_2_with_an_external_reference(void)
{
    starts_with((rdpi_dac8562_config_t){.external_reference = true, .gain_2 = true}, 0x00, 0x00);
}

void test_start_leaves_ldac_to_the_pin_when_it_is_driven(void)
{
    starts_with((rdpi_dac8562_config_t){.ldac_driven = true}, 0x01, 0x03);
}

void test_init_sends_nothing_and_clears_the_counters(void)
{
    started(false);
    rdpi_spi_busy_ExpectAndReturn(true);
    rdpi_dac8562_write(&dac, 0, 0);
    rdpi_spi_busy_ExpectAndReturn(false);
    rdpi_dac8562_write(&dac, 65536, 0);
    starts_with((rdpi_dac8562_config_t){0}, 0x01, 0x03);
    TEST_ASSERT_EQUAL_UINT32(0, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.code_count);
}

void test_start_skips_no_frame_while_the_bus_is_busy(void)
{
    const rdpi_dac8562_config_t config = {0};
    rdpi_dac8562_init(&dac, &config);
    rdpi_spi_busy_ExpectAndReturn(true);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    EXPECT_SENT(1, 0x28, 0x00, 0x01);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    rdpi_spi_busy_ExpectAndReturn(true);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    EXPECT_SENT(1, 0x30, 0x00, 0x00);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    TEST_ASSERT_EQUAL_UINT32(0, dac.busy_count);
}

void test_start_waits_for_the_end_of_its_last_frame(void)
{
    const rdpi_dac8562_config_t config = {0};
    rdpi_dac8562_init(&dac, &config);
    rdpi_spi_write_Ignore();
    for (int k = 0; k < 5; k++) {
        rdpi_spi_busy_ExpectAndReturn(false);
        TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    }
    rdpi_spi_busy_ExpectAndReturn(true);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    rdpi_spi_busy_ExpectAndReturn(false);
    TEST_ASSERT_TRUE(rdpi_dac8562_start(&dac));
}

void test_start_sends_nothing_once_done(void)
{
    started(false);
    TEST_ASSERT_TRUE(rdpi_dac8562_start(&dac));
    TEST_ASSERT_TRUE(rdpi_dac8562_start(&dac));
}

void test_a_write_before_the_end_of_start_is_refused_and_counted(void)
{
    const rdpi_dac8562_config_t config = {0};
    rdpi_dac8562_init(&dac, &config);
    TEST_ASSERT_FALSE(rdpi_dac8562_write(&dac, 1, 2));
    EXPECT_SENT(1, 0x28, 0x00, 0x01);
    TEST_ASSERT_FALSE(rdpi_dac8562_start(&dac));
    TEST_ASSERT_FALSE(rdpi_dac8562_write(&dac, 1, 2));
    TEST_ASSERT_FALSE(rdpi_dac8562_write_channel(&dac, RDPI_DAC8562_A, 1));
    TEST_ASSERT_EQUAL_UINT32(3, dac.busy_count);
}

void test_a_write_sends_a_then_b_and_updates_both(void)
{
    started(false);
    EXPECT_SENT(2, 0x00, 0x12, 0x34, 0x11, 0xab, 0xcd);
    TEST_ASSERT_TRUE(rdpi_dac8562_write(&dac, 0x1234, 0xabcd));
}

void test_a_write_updates_nothing_when_ldac_is_driven(void)
{
    started(true);
    EXPECT_SENT(2, 0x00, 0x12, 0x34, 0x01, 0xab, 0xcd);
    TEST_ASSERT_TRUE(rdpi_dac8562_write(&dac, 0x1234, 0xabcd));
}

void test_a_write_of_one_channel_is_one_frame_that_updates_it(void)
{
    started(false);
    EXPECT_SENT(1, 0x18, 0x12, 0x34);
    TEST_ASSERT_TRUE(rdpi_dac8562_write_channel(&dac, RDPI_DAC8562_A, 0x1234));
    EXPECT_SENT(1, 0x19, 0xab, 0xcd);
    TEST_ASSERT_TRUE(rdpi_dac8562_write_channel(&dac, RDPI_DAC8562_B, 0xabcd));
}

void test_a_write_of_one_channel_updates_nothing_when_ldac_is_driven(void)
{
    started(true);
    EXPECT_SENT(1, 0x00, 0x12, 0x34);
    TEST_ASSERT_TRUE(rdpi_dac8562_write_channel(&dac, RDPI_DAC8562_A, 0x1234));
    EXPECT_SENT(1, 0x01, 0xab, 0xcd);
    TEST_ASSERT_TRUE(rdpi_dac8562_write_channel(&dac, RDPI_DAC8562_B, 0xabcd));
}

void test_the_ends_of_the_range(void)
{
    started(false);
    EXPECT_SENT(2, 0x00, 0x00, 0x00, 0x11, 0xff, 0xff);
    TEST_ASSERT_TRUE(rdpi_dac8562_write(&dac, 0, 65535));
    EXPECT_SENT(2, 0x00, 0xff, 0xff, 0x11, 0x00, 0x00);
    TEST_ASSERT_TRUE(rdpi_dac8562_write(&dac, 65535, 0));
}

void test_a_code_beyond_the_range_holds_both_outputs_and_is_counted(void)
{
    started(false);
    rdpi_spi_busy_IgnoreAndReturn(false);
    TEST_ASSERT_FALSE(rdpi_dac8562_write(&dac, 65536, 0));
    TEST_ASSERT_FALSE(rdpi_dac8562_write(&dac, 0, 65536));
    TEST_ASSERT_FALSE(rdpi_dac8562_write(&dac, UINT32_MAX, UINT32_MAX));
    TEST_ASSERT_FALSE(rdpi_dac8562_write_channel(&dac, RDPI_DAC8562_B, 65536));
    TEST_ASSERT_EQUAL_UINT32(4, dac.code_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.busy_count);
}

void test_a_write_during_a_transfer_is_refused_and_counted(void)
{
    started(false);
    EXPECT_SENT(2, 0x00, 0x12, 0x34, 0x11, 0xab, 0xcd);
    TEST_ASSERT_TRUE(rdpi_dac8562_write(&dac, 0x1234, 0xabcd));
    rdpi_spi_busy_ExpectAndReturn(true);
    TEST_ASSERT_FALSE(rdpi_dac8562_write(&dac, 1, 2));
    rdpi_spi_busy_ExpectAndReturn(true);
    TEST_ASSERT_FALSE(rdpi_dac8562_write_channel(&dac, RDPI_DAC8562_A, 65536));
    TEST_ASSERT_EQUAL_UINT32(2, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.code_count);
    EXPECT_SENT(2, 0x00, 0x00, 0x01, 0x11, 0x00, 0x02);
    TEST_ASSERT_TRUE(rdpi_dac8562_write(&dac, 1, 2));
    TEST_ASSERT_EQUAL_UINT32(2, dac.busy_count);
}

static const uint8_t *sending;

static void remember(const uint8_t *bytes, size_t frame_bytes, size_t frames, int calls)
{
    (void)frame_bytes;
    (void)frames;
    (void)calls;
    sending = bytes;
}

void test_bytes_that_are_being_sent_stay_as_they_are(void)
{
    started(false);
    rdpi_spi_write_StubWithCallback(remember);
    rdpi_spi_busy_ExpectAndReturn(false);
    TEST_ASSERT_TRUE(rdpi_dac8562_write(&dac, 0x1234, 0xabcd));
    rdpi_spi_busy_IgnoreAndReturn(true);
    rdpi_dac8562_write(&dac, 0x5555, 0x5555);
    rdpi_dac8562_write_channel(&dac, RDPI_DAC8562_B, 0x5555);
    rdpi_dac8562_write(&dac, 65536, 65536);
    const uint8_t expected[] = {0x00, 0x12, 0x34, 0x11, 0xab, 0xcd};
    TEST_ASSERT_EQUAL_UINT8_ARRAY(expected, sending, 6);
}

void test_counters_saturate(void)
{
    started(false);
    dac.busy_count = UINT32_MAX;
    dac.code_count = UINT32_MAX - 1;
    rdpi_spi_busy_ExpectAndReturn(true);
    rdpi_dac8562_write(&dac, 0, 0);
    rdpi_spi_busy_IgnoreAndReturn(false);
    rdpi_dac8562_write(&dac, 65536, 0);
    rdpi_dac8562_write(&dac, 65536, 0);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, dac.code_count);
}

void test_the_safe_frames_are_those_that_update_both(void)
{
    const uint8_t expected[RDPI_DAC8562_SAFE_BYTES] = {0x00, 0x12, 0x34, 0x11, 0xab, 0xcd};
    uint8_t bytes[RDPI_DAC8562_SAFE_BYTES];
    rdpi_dac8562_safe_frames(0x1234, 0xabcd, bytes); /* the mocked bus expects nothing */
    TEST_ASSERT_EQUAL_HEX8_ARRAY(expected, bytes, RDPI_DAC8562_SAFE_BYTES);
}
