#include "unity.h"

#include <string.h>

#include "crc.h"

static uint32_t of_text(const char *text)
{
    return rdpi_crc32(0, text, strlen(text));
}

void setUp(void)
{
}

void tearDown(void)
{
}

void test_check_value_of_the_standard(void)
{
    TEST_ASSERT_EQUAL_HEX32(0xCBF43926, of_text("123456789"));
}

void test_known_texts(void)
{
    TEST_ASSERT_EQUAL_HEX32(0xE8B7BE43, of_text("a"));
    TEST_ASSERT_EQUAL_HEX32(0x414FA339, of_text("The quick brown fox jumps over the lazy dog"));
}

void test_bytes_of_nothing_but_zeros_and_ones(void)
{
    unsigned char bytes[32];
    memset(bytes, 0, sizeof bytes);
    TEST_ASSERT_EQUAL_HEX32(0x190A55AD, rdpi_crc32(0, bytes, sizeof bytes));
    memset(bytes, 0xFF, sizeof bytes);
    TEST_ASSERT_EQUAL_HEX32(0xFF6CAB0B, rdpi_crc32(0, bytes, sizeof bytes));
}

void test_no_bytes_leave_the_checksum_as_it_is(void)
{
    TEST_ASSERT_EQUAL_HEX32(0, of_text(""));
    TEST_ASSERT_EQUAL_HEX32(0xCBF43926, rdpi_crc32(0xCBF43926, "", 0));
}

void test_pieces_one_after_the_other_give_the_checksum_of_the_whole(void)
{
    const char *text = "123456789";
    for (size_t cut = 0; cut <= 9; cut++) {
        TEST_ASSERT_EQUAL_HEX32(0xCBF43926, rdpi_crc32(rdpi_crc32(0, text, cut), text + cut, 9 - cut));
    }
}

void test_every_single_bit_counts(void)
{
    unsigned char bytes[] = "123456789";
    for (size_t bit = 0; bit < 8 * 9; bit++) {
        bytes[bit / 8] ^= (unsigned char)(1u << bit % 8);
        TEST_ASSERT_NOT_EQUAL_HEX32(0xCBF43926, rdpi_crc32(0, bytes, 9));
        bytes[bit / 8] ^= (unsigned char)(1u << bit % 8);
    }
}
