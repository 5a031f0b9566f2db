#include "unity.h"

#include <string.h>

#include "crc.h"

/* Four letters as a word, the first one the lowest byte. */
static uint32_t word(const char *text)
{
    return (uint32_t)(unsigned char)text[0] | (uint32_t)(unsigned char)text[1] << 8 |
           (uint32_t)(unsigned char)text[2] << 16 | (uint32_t)(unsigned char)text[3] << 24;
}

static uint32_t of_text(const char *text)
{
    uint32_t crc = 0;
    for (size_t k = 0; k < strlen(text); k += 4) {
        crc = rdpi_crc32(crc, word(text + k));
    }
    return crc;
}

void setUp(void)
{
}

void tearDown(void)
{
}

/* What zlib's crc32 gives for these bytes. */
void test_known_texts(void)
{
    TEST_ASSERT_EQUAL_HEX32(0x9BE3E0A3, of_text("1234"));
    TEST_ASSERT_EQUAL_HEX32(0x9AE0DAAF, of_text("12345678"));
    TEST_ASSERT_EQUAL_HEX32(0x444A08A0, of_text("The quick brown fox jumps over the lazy dogs"));
}

void test_words_of_nothing_but_zeros_and_ones(void)
{
    uint32_t words[8];
    memset(words, 0, sizeof words);
    TEST_ASSERT_EQUAL_HEX32(0x190A55AD, rdpi_crc32_block(0, words, sizeof words));
    memset(words, 0xFF, sizeof words);
    TEST_ASSERT_EQUAL_HEX32(0xFF6CAB0B, rdpi_crc32_block(0, words, sizeof words));
}

void test_no_words_leave_the_checksum_as_it_is(void)
{
    TEST_ASSERT_EQUAL_HEX32(0x9BE3E0A3, rdpi_crc32_block(0x9BE3E0A3, "", 0));
}

void test_of_eight_bytes_the_low_word_comes_first(void)
{
    TEST_ASSERT_EQUAL_HEX32(0x9AE0DAAF, rdpi_crc32_wide(0, word("1234") | (uint64_t)word("5678") << 32));
}

void test_a_block_is_its_words_one_after_the_other(void)
{
    const uint32_t words[2] = {word("1234"), word("5678")};
    TEST_ASSERT_EQUAL_HEX32(0x9AE0DAAF, rdpi_crc32_block(0, words, sizeof words));
}

void test_every_single_bit_counts(void)
{
    for (unsigned bit = 0; bit < 64; bit++) {
        uint64_t wrong = (word("1234") | (uint64_t)word("5678") << 32) ^ (uint64_t)1 << bit;
        TEST_ASSERT_NOT_EQUAL_HEX32(0x9AE0DAAF, rdpi_crc32_wide(0, wrong));
    }
}
