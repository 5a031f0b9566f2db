#include "mcp4922.h"

#include "rdpi_spi.h"

/* Of the first byte, bits 15 .. 12 of a frame. */
#define CHANNEL_B 0x80u
#define BUFFERED 0x40u
#define GAIN_1 0x20u
#define OUTPUT_ON 0x10u

static void put(uint8_t *frame, const rdpi_mcp4922_config_t *config, uint32_t channel, uint32_t code)
{
    uint32_t bits = channel | (config->buffered ? BUFFERED : 0u) | (config->gain_2 ? 0u : GAIN_1) | OUTPUT_ON;
    frame[0] = (uint8_t)(bits | (code >> 8 & 0xFu));
    frame[1] = (uint8_t)(code & 0xFFu);
}

static void count(uint32_t *counter)
{
    if (*counter < UINT32_MAX) {
        ++*counter;
    }
}

void rdpi_mcp4922_init(rdpi_mcp4922_t *self, const rdpi_mcp4922_config_t *config)
{
    self->busy_count = 0;
    self->code_count = 0;
    self->config.buffered = config->buffered; /* field by field, or compilers call memcpy */
    self->config.gain_2 = config->gain_2;
}

/* Whether a write may fill self->bytes. */
static bool accepts(rdpi_mcp4922_t *self, uint32_t larger_code)
{
    if (rdpi_spi_busy()) {
        count(&self->busy_count);
        return false;
    }
    if (larger_code > RDPI_MCP4922_MAX_CODE) {
        count(&self->code_count);
        return false;
    }
    return true;
}

bool rdpi_mcp4922_write(rdpi_mcp4922_t *self, uint32_t code_a, uint32_t code_b)
{
    if (!accepts(self, code_a > code_b ? code_a : code_b)) {
        return false;
    }
    rdpi_mcp4922_safe_frames(&self->config, code_a, code_b, self->bytes);
    rdpi_spi_write(self->bytes, RDPI_MCP4922_FRAME_BYTES, 2);
    return true;
}

bool rdpi_mcp4922_write_channel(rdpi_mcp4922_t *self, rdpi_mcp4922_channel_t channel, uint32_t code)
{
    if (!accepts(self, code)) {
        return false;
    }
    put(self->bytes, &self->config, channel == RDPI_MCP4922_B ? CHANNEL_B : 0u, code);
    rdpi_spi_write(self->bytes, RDPI_MCP4922_FRAME_BYTES, 1);
    return true;
}

void rdpi_mcp4922_safe_frames(const rdpi_mcp4922_config_t *config, uint32_t code_a, uint32_t code_b, uint8_t *bytes)
{
    put(bytes, config, 0u, code_a);
    put(bytes + RDPI_MCP4922_FRAME_BYTES, config, CHANNEL_B, code_b);
}
