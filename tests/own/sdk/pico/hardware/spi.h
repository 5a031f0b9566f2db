#pragma once
#include <stddef.h>
#include <stdint.h>
typedef struct spi_inst spi_inst_t;
extern spi_inst_t *const spi0;
int spi_write_blocking(spi_inst_t *spi, const uint8_t *source, size_t length);
