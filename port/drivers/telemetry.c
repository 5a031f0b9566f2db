#include "telemetry.h"

#include <stddef.h>
#include <string.h>

#include "rdpi_port.h"

#define SAMPLE_FRAME 1u
#define INFO_FRAME 2u

typedef char a_double_has_64_bits[sizeof(double) == 8u ? 1 : -1];

/* A frame in the making: encoded as it is written. */
typedef struct {
    uint8_t bytes[RDPI_TELEMETRY_MAX_BYTES];
    size_t end;
    size_t mark; /* where the distance to the next zero goes */
    uint16_t crc;
} frame_t;

static void put_byte(frame_t *frame, uint8_t byte)
{
    /* CRC-16, four bits at a time */
    static const uint16_t nibble[16] = {
        0x0000u, 0x1021u, 0x2042u, 0x3063u, 0x4084u, 0x50A5u, 0x60C6u, 0x70E7u,
        0x8108u, 0x9129u, 0xA14Au, 0xB16Bu, 0xC18Cu, 0xD1ADu, 0xE1CEu, 0xF1EFu,
    };
    uint32_t crc = frame->crc;
    crc = (crc << 4) ^ nibble[((crc >> 12) ^ (uint32_t)(byte >> 4)) & 15u];
    crc = (crc << 4) ^ nibble[((crc >> 12) ^ byte) & 15u];
    frame->crc = (uint16_t)crc;

    if (byte == 0u) { /* COBS: says instead how far it is from the zero before */
        frame->bytes[frame->mark] = (uint8_t)(frame->end - frame->mark);
        frame->mark = frame->end;
    }
    frame->bytes[frame->end] = byte;
    frame->end++;
}

static void put(frame_t *frame, uint32_t value, unsigned bytes)
{
    for (unsigned k = 0; k < bytes; k++) {
        put_byte(frame, (uint8_t)(value >> (8u * k)));
    }
}

static void put_double(frame_t *frame, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put(frame, (uint32_t)bits, 4);
    put(frame, (uint32_t)(bits >> 32), 4);
}

static void begin(frame_t *frame, uint8_t type, uint8_t axis)
{
    frame->mark = 0;
    frame->end = 1;
    frame->crc = 0xFFFFu;
    put_byte(frame, (uint8_t)(type | (uint32_t)axis << 4));
}

static bool finish(frame_t *frame)
{
    put(frame, frame->crc, 2);
    frame->bytes[frame->mark] = (uint8_t)(frame->end - frame->mark);
    frame->bytes[frame->end] = 0;
    return rdpi_port_send(frame->bytes, frame->end + 1u);
}

bool rdpi_telemetry_sample(rdpi_telemetry_t *self, const rdpi_telemetry_sample_t *sample)
{
    frame_t frame;
    begin(&frame, SAMPLE_FRAME, self->axis);
    put(&frame, self->offered_count, 2);
    put(&frame, sample->tick, 4);
    put(&frame, sample->reference, 4);
    put(&frame, sample->rate, 4);
    put(&frame, sample->dac_code, 4);
    put(&frame, (uint32_t)sample->adc_counts, 4);
    put(&frame, sample->flags, 2);
    self->offered_count++;
    bool taken = finish(&frame);
    if (!taken && self->refused_count < UINT32_MAX) {
        self->refused_count++;
    }
    return taken;
}

bool rdpi_telemetry_info(const rdpi_telemetry_t *self, const rdpi_telemetry_run_t *run,
                         const rdpi_telemetry_counts_t *counts)
{
    frame_t frame;
    begin(&frame, INFO_FRAME, self->axis);
    put(&frame, RDPI_TELEMETRY_VERSION, 1);
    put(&frame, counts->state, 1);
    put(&frame, (uint8_t)counts->status, 1);
    put(&frame, run->rate_hz, 4);
    put(&frame, run->dac_bits, 1);
    put(&frame, run->numbers, 1);
    put_double(&frame, run->min_V);
    put_double(&frame, run->max_V);
    put_double(&frame, run->um_per_reference);
    put_double(&frame, run->reference_0_um);
    put_double(&frame, run->um_per_s_per_rate);
    put_double(&frame, run->um_per_count);
    put_double(&frame, run->count_0_um);
    put(&frame, self->offered_count, 4);
    put(&frame, self->refused_count, 4);
    put(&frame, counts->overruns, 4);
    put(&frame, counts->guard_count, 4);
    put(&frame, counts->clip_count, 4);
    put(&frame, counts->input_count, 4);
    put(&frame, counts->missed_count, 4);
    put(&frame, counts->held_count, 4);
    put(&frame, counts->longest_tick_cycles, 4);
    put(&frame, run->cycles_per_s, 4);
    return finish(&frame);
}
