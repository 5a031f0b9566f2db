/* The AD5683R driver: every byte it sends, in which order, and what it refuses. The bus is a mock of
 * port/include/rdpi_spi.h. The bytes are written out from the table in ad5683r.h, none is computed. */
#include "unity.h"

#include "ad5683r.h"
#include "mock_rdpi_spi.h"

TEST_SOURCE_FILE("port/drivers/ad5683r.c")

/* One transfer of one frame of these bytes; the bus was asked first, and was free. */
#define EXPECT_SENT(...)                                                                                \
    rdpi_spi_busy_ExpectAndReturn(false);                                                               \
    rdpi_spi_write_ExpectWithArray(((const uint8_t[]){__VA_ARGS__}), 3, 3, 1)

static rdpi_ad5683r_t dac;

void setUp(void)
{
}

void tearDown(void)
{
}

/* An instance that start has been done with. */
static void started(bool ldac_driven)
{
    const rdpi_ad5683r_config_t config = {.ldac_driven = ldac_driven};
    rdpi_ad5683r_init(&dac, &config);
    rdpi_spi_busy_IgnoreAndReturn(false);
    rdpi_spi_write_Ignore();
    TEST_ASSERT_FALSE(rdpi_ad5683r_start(&dac));
    TEST_ASSERT_FALSE(rdpi_ad5683r_start(&dac));
    TEST_ASSERT_TRUE(rdpi_ad5683r_start(&dac));
    rdpi_spi_busy_StopIgnore();
    rdpi_spi_write_StopIgnore();
}

/* The two frames of start, of which the second depends on the configuration. */
static void starts_with(rdpi_ad5683r_config_t config, uint8_t first, uint8_t second)
{
    rdpi_ad5683r_init(&dac, &config);
    EXPECT_SENT(0x48, 0x00, 0x00);
    TEST_ASSERT_FALSE(rdpi_ad5683r_start(&dac));
    EXPECT_SENT(first, second, 0x00);
    TEST_ASSERT_FALSE(rdpi_ad5683r_start(&dac));
    rdpi_spi_busy_ExpectAndReturn(false);
    TEST_ASSERT_TRUE(rdpi_ad5683r_start(&dac));
}

void test_start_resets_then_sets_the_control_register(void)
{
    starts_with((rdpi_ad5683r_config_t){0}, 0x40, 0x00);
}

void test_start_sets_gain_2(void)
{
    starts_with((rdpi_ad5683r_config_t){.gain_2 = true}, 0x40, 0x80);
}

void test_start_switches_the_internal_reference_off_for_an_external_one(void)
{
    starts_with((rdpi_ad5683r_config_t){.external_reference = true}, 0x41, 0x00);
}

void test_start_sets_gain_2_with_an_external_reference(void)
{
    starts_with((rdpi_ad5683r_config_t){.external_reference = true, .gain_2 = true}, 0x41, 0x80);
}

void test_start_is_the_same_when_ldac_is_driven(void)
{
    starts_with((rdpi_ad5683r_config_t){.ldac_driven = true}, 0x40, 0x00);
}

void test_init_sends_nothing_and_clears_the_counters(void)
{
    started(false);
    rdpi_spi_busy_ExpectAndReturn(true);
    rdpi_ad5683r_write(&dac, 0);
    rdpi_spi_busy_ExpectAndReturn(false);
    rdpi_ad5683r_write(&dac, 65536);
    starts_with((rdpi_ad5683r_config_t){0}, 0x40, 0x00);
    TEST_ASSERT_EQUAL_UINT32(0, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.code_count);
}

void test_start_skips_no_frame_while_the_bus_is_busy(void)
{
    const rdpi_ad5683r_config_t config = {0};
    rdpi_ad5683r_init(&dac, &config);
    rdpi_spi_busy_ExpectAndReturn(true);
    TEST_ASSERT_FALSE(rdpi_ad5683r_start(&dac));
    EXPECT_SENT(0x48, 0x00, 0x00);
    TEST_ASSERT_FALSE(rdpi_ad5683r_start(&dac));
    rdpi_spi_busy_ExpectAndReturn(true);
    TEST_ASSERT_FALSE(rdpi_ad5683r_start(&dac));
    EXPECT_SENT(0x40, 0x00, 0x00);
    TEST_ASSERT_FALSE(rdpi_ad5683r_start(&dac));
    rdpi_spi_busy_ExpectAndReturn(true);
    TEST_ASSERT_FALSE(rdpi_ad5683r_start(&dac));
    rdpi_spi_busy_ExpectAndReturn(false);
    TEST_ASSERT_TRUE(rdpi_ad5683r_start(&dac));
    TEST_ASSERT_EQUAL_UINT32(0, dac.busy_count);
}

void test_start_sends_nothing_once_done(void)
{
    started(false);
    TEST_ASSERT_TRUE(rdpi_ad5683r_start(&dac));
    TEST_ASSERT_TRUE(rdpi_ad5683r_start(&dac));
}

void test_a_write_before_the_end_of_start_is_refused_and_counted(void)
{
    const rdpi_ad5683r_config_t config = {0};
    rdpi_ad5683r_init(&dac, &config);
    TEST_ASSERT_FALSE(rdpi_ad5683r_write(&dac, 1));
    EXPECT_SENT(0x48, 0x00, 0x00);
    TEST_ASSERT_FALSE(rdpi_ad5683r_start(&dac));
    TEST_ASSERT_FALSE(rdpi_ad5683r_write(&dac, 1));
    TEST_ASSERT_EQUAL_UINT32(2, dac.busy_count);
}

void test_a_write_sends_the_code_and_updates_the_output(void)
{
    started(false);
    EXPECT_SENT(0x31, 0x23, 0x40);
    TEST_ASSERT_TRUE(rdpi_ad5683r_write(&dac, 0x1234));
    EXPECT_SENT(0x3a, 0xbc, 0xd0);
    TEST_ASSERT_TRUE(rdpi_ad5683r_write(&dac, 0xabcd));
}

void test_a_write_updates_nothing_when_ldac_is_driven(void)
{
    started(true);
    EXPECT_SENT(0x1a, 0xbc, 0xd0);
    TEST_ASSERT_TRUE(rdpi_ad5683r_write(&dac, 0xabcd));
}

void test_the_ends_of_the_range(void)
{
    started(false);
    EXPECT_SENT(0x30, 0x00, 0x00);
    TEST_ASSERT_TRUE(rdpi_ad5683r_write(&dac, 0));
    EXPECT_SENT(0x3f, 0xff, 0xf0);
    TEST_ASSERT_TRUE(rdpi_ad5683r_write(&dac, 65535));
}

void test_a_code_beyond_the_range_holds_the_output_and_is_counted(void)
{
    started(false);
    rdpi_spi_busy_IgnoreAndReturn(false);
    TEST_ASSERT_FALSE(rdpi_ad5683r_write(&dac, 65536));
    TEST_ASSERT_FALSE(rdpi_ad5683r_write(&dac, UINT32_MAX));
    TEST_ASSERT_EQUAL_UINT32(2, dac.code_count);
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
    started(false);
    rdpi_spi_write_StubWithCallback(remember);
    rdpi_spi_busy_ExpectAndReturn(false);
    TEST_ASSERT_TRUE(rdpi_ad5683r_write(&dac, 0x1234));
    rdpi_spi_busy_IgnoreAndReturn(true);
    TEST_ASSERT_FALSE(rdpi_ad5683r_write(&dac, 0x5555));
    TEST_ASSERT_FALSE(rdpi_ad5683r_write(&dac, 65536));
    const uint8_t expected[] = {0x31, 0x23, 0x40};
    TEST_ASSERT_EQUAL_UINT8_ARRAY(expected, sending, 3);
    TEST_ASSERT_EQUAL_UINT32(2, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(0, dac.code_count);
}

void test_counters_saturate(void)
{
    started(false);
    dac.busy_count = UINT32_MAX;
    dac.code_count = UINT32_MAX - 1;
    rdpi_spi_busy_ExpectAndReturn(true);
    rdpi_ad5683r_write(&dac, 0);
    rdpi_spi_busy_IgnoreAndReturn(false);
    rdpi_ad5683r_write(&dac, 65536);
    rdpi_ad5683r_write(&dac, 65536);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, dac.busy_count);
    TEST_ASSERT_EQUAL_UINT32(UINT32_MAX, dac.code_count);
}

void test_the_safe_frames_set_the_control_register_without_reset_and_then_output_the_code(void)
{
    const rdpi_ad5683r_config_t wirings[] = {{.gain_2 = true}, {.external_reference = true, .ldac_driven = true}};
    const uint8_t expected[][RDPI_AD5683R_SAFE_BYTES] = {{0x40, 0x80, 0x00, 0x3a, 0xbc, 0xd0},
                                                         {0x41, 0x00, 0x00, 0x3a, 0xbc, 0xd0}};
    for (int k = 0; k < 2; k++) {
        uint8_t bytes[RDPI_AD5683R_SAFE_BYTES];
        rdpi_ad5683r_safe_frames(&wirings[k], 0xabcd, bytes); /* the mocked bus expects nothing */
        TEST_ASSERT_EQUAL_HEX8_ARRAY(expected[k], bytes, RDPI_AD5683R_SAFE_BYTES);
    }
}
