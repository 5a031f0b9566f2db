#pragma once
#include <stddef.h>
#include <stdint.h>
typedef struct spi_device_t *spi_device_handle_t;
#define SPI_TRANS_USE_TXDATA (1 << 3)
typedef struct {
    uint32_t flags;
    uint16_t cmd;
    uint64_t addr;
    size_t length;
    size_t rxlength;
    void *user;
    union {
        const void *tx_buffer;
        uint8_t tx_data[4];
    };
    union {
        void *rx_buffer;
        uint8_t rx_data[4];
    };
} spi_transaction_t;
int spi_device_polling_transmit(spi_device_handle_t device, spi_transaction_t *transaction);
