#include "mcp4725.h"

#include "rdpi_i2c.h"

#define FIRST_ADDRESS 0x60u
#define ADDRESS_PINS 0x07u
#define WRITE_EEPROM 0x60u /* C2 = 0, C1 = C0 = 1; of a fast write C2, C1 and the power-down bits are 0 */

static void count(uint32_t *counter)
{
    if (*counter < UINT32_MAX) {
        ++*counter;
    }
}

void rdpi_mcp4725_init(rdpi_mcp4725_t *self, const rdpi_mcp4725_config_t *config)
{
    self->busy_count = 0;
    self->code_count = 0;
    self->fail_count = 0;
    self->config.address = config->address;
    self->sent = false;
    self->ready = false;
}

/* How the latest transfer ended, if it has; counts one that failed. */
static rdpi_i2c_state_t outcome(rdpi_mcp4725_t *self)
{
    rdpi_i2c_state_t state = rdpi_i2c_state();
    if (state != RDPI_I2C_BUSY) {
        if (self->sent && state == RDPI_I2C_FAILED) {
            count(&self->fail_count);
        }
        self->sent = false;
    }
    return state;
}

/* Sends a code; what is known of it when rdpi_i2c_write has returned. */
static rdpi_i2c_state_t send(rdpi_mcp4725_t *self, uint32_t code)
{
    rdpi_mcp4725_safe_frames(code, self->bytes);
    self->sent = true;
    rdpi_i2c_write(self->config.address, self->bytes, RDPI_MCP4725_FRAME_BYTES);
    return outcome(self);
}

bool rdpi_mcp4725_start(rdpi_mcp4725_t *self, uint32_t code)
{
    if (self->ready) {
        return true;
    }
    if (code > RDPI_MCP4725_MAX_CODE) {
        count(&self->code_count);
        return false;
    }
    if ((self->config.address & ~ADDRESS_PINS) != FIRST_ADDRESS) {
        return false;
    }
    bool was_sent = self->sent;
    rdpi_i2c_state_t state = outcome(self);
    if (!was_sent && state != RDPI_I2C_BUSY) {
        state = send(self, code);
    }
    self->ready = state == RDPI_I2C_DONE;
    return self->ready;
}

bool rdpi_mcp4725_write(rdpi_mcp4725_t *self, uint32_t code)
{
    if (!self->ready || outcome(self) == RDPI_I2C_BUSY) {
        count(&self->busy_count);
        return false;
    }
    if (code > RDPI_MCP4725_MAX_CODE) {
        count(&self->code_count);
        return false;
    }
    return send(self, code) != RDPI_I2C_FAILED;
}

void rdpi_mcp4725_safe_frames(uint32_t code, uint8_t *bytes)
{
    bytes[0] = (uint8_t)(code >> 8 & 0xFu);
    bytes[1] = (uint8_t)(code & 0xFFu);
}

void rdpi_mcp4725_power_up_frame(uint32_t code, uint8_t *bytes)
{
    bytes[0] = WRITE_EEPROM;
    bytes[1] = (uint8_t)(code >> 4 & 0xFFu);
    bytes[2] = (uint8_t)((code & 0xFu) << 4);
}
