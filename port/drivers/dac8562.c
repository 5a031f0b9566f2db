#include "dac8562.h"

#include "rdpi_spi.h"

/* First bytes: command and address. */
#define WRITE_INPUT 0x00u             /* channel A, + CHANNEL_B for B */
#define SET_GAIN 0x02u
#define WRITE_INPUT_UPDATE_BOTH 0x10u /* like WRITE_INPUT */
#define WRITE_UPDATE 0x18u            /* like WRITE_INPUT */
#define CHANNEL_B 0x01u
#define SET_POWER 0x20u
#define RESET 0x28u
#define SET_LDAC 0x30u
#define SET_REFERENCE 0x38u

#define GAIN_BOTH_1 3u
#define GAIN_BOTH_2 0u
#define POWER_UP_BOTH 3u
#define RESET_ALL 1u
#define LDAC_ACTIVE_BOTH 0u
#define REFERENCE_ON 1u
#define REFERENCE_OFF 0u

static void put(uint8_t *frame, uint8_t command, uint32_t data)
{
    frame[0] = command;
    frame[1] = (uint8_t)(data >> 8);
    frame[2] = (uint8_t)(data & 0xFFu);
}

static void count(uint32_t *counter)
{
    if (*counter < UINT32_MAX) {
        ++*counter;
    }
}

void rdpi_dac8562_init(rdpi_dac8562_t *self, const rdpi_dac8562_config_t *config)
{
    self->busy_count = 0;
    self->code_count = 0;
    self->config.external_reference = config->external_reference; /* field by field, or compilers call memcpy */
    self->config.gain_2 = config->gain_2;
    self->config.ldac_driven = config->ldac_driven;
    self->step = 0;
    self->ready = false;
}

bool rdpi_dac8562_start(rdpi_dac8562_t *self)
{
    if (self->ready) {
        return true;
    }
    if (rdpi_spi_busy()) {
        return false;
    }
    switch (self->step) {
    case 0:
        put(self->bytes, RESET, RESET_ALL);
        break;
    case 1:
        put(self->bytes, SET_LDAC, LDAC_ACTIVE_BOTH);
        break;
    case 2:
        put(self->bytes, SET_REFERENCE, self->config.external_reference ? REFERENCE_OFF : REFERENCE_ON);
        break;
    case 3: /* after the reference, which changes the gains */
        put(self->bytes, SET_GAIN, self->config.gain_2 ? GAIN_BOTH_2 : GAIN_BOTH_1);
        break;
    case 4:
        put(self->bytes, SET_POWER, POWER_UP_BOTH);
        break;
    default:
        self->ready = true;
        return true;
    }
    self->step++;
    rdpi_spi_write(self->bytes, RDPI_DAC8562_FRAME_BYTES, 1);
    return false;
}

/* Whether a write may fill self->bytes. */
static bool accepts(rdpi_dac8562_t *self, uint32_t larger_code)
{
    if (!self->ready || rdpi_spi_busy()) {
        count(&self->busy_count);
        return false;
    }
    if (larger_code > RDPI_DAC8562_MAX_CODE) {
        count(&self->code_count);
        return false;
    }
    return true;
}

bool rdpi_dac8562_write(rdpi_dac8562_t *self, uint32_t code_a, uint32_t code_b)
{
    if (!accepts(self, code_a > code_b ? code_a : code_b)) {
        return false;
    }
    put(self->bytes, WRITE_INPUT, code_a);
    put(self->bytes + RDPI_DAC8562_FRAME_BYTES,
        self->config.ldac_driven ? WRITE_INPUT + CHANNEL_B : WRITE_INPUT_UPDATE_BOTH + CHANNEL_B, code_b);
    rdpi_spi_write(self->bytes, RDPI_DAC8562_FRAME_BYTES, 2);
    return true;
}

bool rdpi_dac8562_write_channel(rdpi_dac8562_t *self, rdpi_dac8562_channel_t channel, uint32_t code)
{
    if (!accepts(self, code)) {
        return false;
    }
    if (channel == RDPI_DAC8562_B) {
        put(self->bytes, self->config.ldac_driven ? WRITE_INPUT + CHANNEL_B : WRITE_UPDATE + CHANNEL_B, code);
    } else {
        put(self->bytes, self->config.ldac_driven ? WRITE_INPUT : WRITE_UPDATE, code);
    }
    rdpi_spi_write(self->bytes, RDPI_DAC8562_FRAME_BYTES, 1);
    return true;
}

void rdpi_dac8562_safe_frames(uint32_t code_a, uint32_t code_b, uint8_t *bytes)
{
    put(bytes, WRITE_INPUT, code_a & RDPI_DAC8562_MAX_CODE);
    put(bytes + RDPI_DAC8562_FRAME_BYTES, WRITE_INPUT_UPDATE_BOTH + CHANNEL_B, code_b & RDPI_DAC8562_MAX_CODE);
}
