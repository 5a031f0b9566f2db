#include "ad5683r.h"

#include "rdpi_spi.h"

/* Commands, DB23 .. DB20. */
#define WRITE_INPUT 1u
#define WRITE_INPUT_AND_DAC 3u
#define WRITE_CONTROL 4u

/* Of the control register, in the place of the code: bit 15 is DB19. */
#define CONTROL_RESET (1u << 15)
#define CONTROL_REFERENCE_OFF (1u << 12)
#define CONTROL_GAIN_2 (1u << 11)

static void put(uint8_t *frame, uint32_t command, uint32_t data)
{
    uint32_t word = command << 20 | data << 4;
    frame[0] = (uint8_t)(word >> 16);
    frame[1] = (uint8_t)(word >> 8 & 0xFFu);
    frame[2] = (uint8_t)(word & 0xFFu);
}

static void send(rdpi_ad5683r_t *self, uint32_t command, uint32_t data)
{
    put(self->bytes, command, data);
    rdpi_spi_write(self->bytes, RDPI_AD5683R_FRAME_BYTES, 1);
}

/* The control register without reset, in the place of the code. */
static uint32_t control(const rdpi_ad5683r_config_t *config)
{
    return (config->external_reference ? CONTROL_REFERENCE_OFF : 0u) | (config->gain_2 ? CONTROL_GAIN_2 : 0u);
}

static void count(uint32_t *counter)
{
    if (*counter < UINT32_MAX) {
        ++*counter;
    }
}

void rdpi_ad5683r_init(rdpi_ad5683r_t *self, const rdpi_ad5683r_config_t *config)
{
    self->busy_count = 0;
    self->code_count = 0;
    self->config.external_reference = config->external_reference; /* field by field, or compilers call memcpy */
    self->config.gain_2 = config->gain_2;
    self->config.ldac_driven = config->ldac_driven;
    self->step = 0;
    self->ready = false;
}

bool rdpi_ad5683r_start(rdpi_ad5683r_t *self)
{
    if (self->ready) {
        return true;
    }
    if (rdpi_spi_busy()) {
        return false;
    }
    switch (self->step) {
    case 0:
        send(self, WRITE_CONTROL, CONTROL_RESET);
        break;
    case 1:
        send(self, WRITE_CONTROL, control(&self->config));
        break;
    default:
        self->ready = true;
        return true;
    }
    self->step++;
    return false;
}

bool rdpi_ad5683r_write(rdpi_ad5683r_t *self, uint32_t code)
{
    if (!self->ready || rdpi_spi_busy()) {
        count(&self->busy_count);
        return false;
    }
    if (code > RDPI_AD5683R_MAX_CODE) {
        count(&self->code_count);
        return false;
    }
    send(self, self->config.ldac_driven ? WRITE_INPUT : WRITE_INPUT_AND_DAC, code);
    return true;
}

void rdpi_ad5683r_safe_frames(const rdpi_ad5683r_config_t *config, uint32_t code, uint8_t *bytes)
{
    put(bytes, WRITE_CONTROL, control(config));
    put(bytes + RDPI_AD5683R_FRAME_BYTES, WRITE_INPUT_AND_DAC, code & RDPI_AD5683R_MAX_CODE);
}
