/* Whatever the samples are, what the ring takes arrives, and what is missing is counted, however long the ring is full
 * and wherever the line loses, changes or adds a byte. Decoder, CRC and layout are written from telemetry.h. */
#include "bytes.h"

#define RING_BYTES 256u /* two infos: soon full */
#include "../../port/cortex_m/ring.h"
#include "../../port/drivers/telemetry.c"

#define SAMPLE_BODY 25u
#define INFO_BODY 106u
#define AROUND_BODY 4u /* COBS, CRC, zero */

/* A frame in the ring. */
typedef struct {
    uint8_t content[INFO_BODY + 2u]; /* body and CRC */
    size_t count;                    /* bytes of the body */
    uint32_t samples;                /* offered before it */
} sent_t;

static ring_t ring;
static sent_t sent[RING_BYTES]; /* a ring too: of frames, none of which is shorter than a byte */
static size_t first, end;       /* of the frames in the ring, counted since the start */
static sent_t offered;          /* what the encoder is given */
static uint32_t samples;        /* offered since the start */

/* ---- board ---- */

static uint16_t crc16(const uint8_t *bytes, size_t count)
{
    unsigned crc = 0xFFFFu;
    for (size_t k = 0; k < 8u * count; k++) {
        unsigned bit = bytes[k / 8u] >> (7u - k % 8u) & 1u;
        crc = (crc << 1 ^ ((crc >> 15 ^ bit) != 0u ? 0x1021u : 0u)) & 0xFFFFu;
    }
    return (uint16_t)crc;
}

/* Adds a number to what is offered. */
static void add(uint64_t value, size_t bytes)
{
    for (; bytes > 0; bytes--) {
        offered.content[offered.count++] = (uint8_t)value;
        value >>= 8;
    }
}

static void add_real(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    add(bits, sizeof bits);
}

bool rdpi_port_send(const uint8_t *bytes, size_t count)
{
    size_t free = RING_BYTES - (ring.put_count - ring.taken_count);
    bool taken = ring_put(&ring, bytes, count);
    CHECK(taken == (count <= free));
    CHECK(count == offered.count + AROUND_BODY && count <= RDPI_TELEMETRY_MAX_BYTES);
    if (taken) {
        uint16_t crc = crc16(offered.content, offered.count);
        offered.content[offered.count] = (uint8_t)crc;
        offered.content[offered.count + 1u] = (uint8_t)(crc >> 8);
        sent[end++ % RING_BYTES] = offered;
    }
    return taken;
}

static void offer_sample(rdpi_telemetry_t *line)
{
    rdpi_telemetry_t before = *line;
    rdpi_telemetry_sample_t sample;
    size_t frames = end;
    take(&sample, sizeof sample);
    offered = (sent_t){.samples = samples++};
    add(1, 1);
    add(before.offered_count, 2);
    add(sample.tick, 4);
    add(sample.reference, 4);
    add(sample.rate, 4);
    add(sample.dac_code, 4);
    add((uint32_t)sample.adc_counts, 4);
    add(sample.flags, 2);
    CHECK(offered.count == SAMPLE_BODY);
    bool taken = rdpi_telemetry_sample(line, &sample);
    CHECK(taken == (end == frames + 1u));
    CHECK(line->offered_count == before.offered_count + 1u);
    CHECK(line->refused_count == before.refused_count + (!taken && before.refused_count < UINT32_MAX));
}

static void offer_info(const rdpi_telemetry_t *line)
{
    rdpi_telemetry_t before = *line;
    rdpi_telemetry_run_t run;
    rdpi_telemetry_counts_t counts;
    size_t frames = end;
    take(&run, sizeof run);
    take(&counts, sizeof counts);
    offered = (sent_t){.samples = samples};
    add(2, 1);
    add(1, 1);
    add(counts.state, 1);
    add((uint8_t)counts.status, 1);
    add(run.rate_hz, 4);
    add(run.dac_bits, 1);
    add(run.numbers, 1);
    const double reals[7] = {run.min_V, run.max_V, run.um_per_reference, run.reference_0_um, run.um_per_s_per_rate,
                             run.um_per_count, run.count_0_um};
    for (size_t k = 0; k < 7u; k++) {
        add_real(reals[k]);
    }
    const uint32_t counters[10] = {before.offered_count, before.refused_count, counts.overruns, counts.guard_count,
                                   counts.clip_count, counts.input_count, counts.missed_count, counts.held_count,
                                   counts.longest_tick_cycles, run.cycles_per_s};
    for (size_t k = 0; k < 10u; k++) {
        add(counters[k], 4);
    }
    CHECK(offered.count == INFO_BODY);
    bool taken = rdpi_telemetry_info(line, &run, &counts);
    CHECK(taken == (end == frames + 1u));
    CHECK(memcmp(&before, line, sizeof before) == 0);
}

/* ---- host ---- */

static uint8_t arrived[2u * RING_BYTES]; /* since the latest zero */
static size_t arrived_count;
static bool any_sample; /* has come, and this was the latest: */
static uint16_t latest_number;
static uint32_t latest_samples;

/* COBS in place. Returns the bytes of the body, 0 if this is no frame. */
static size_t decode(uint8_t *bytes, size_t count)
{
    size_t to = 0, from = 0;
    while (from < count) {
        size_t block = bytes[from];
        if (from + block > count) {
            return 0;
        }
        memmove(&bytes[to], &bytes[from + 1u], block - 1u);
        to += block - 1u;
        from += block;
        if (block < 255u && from < count) {
            bytes[to++] = 0;
        }
    }
    bool good = to > 2u && (bytes[to - 2u] | bytes[to - 1u] << 8) == crc16(bytes, to - 2u);
    return good ? to - 2u : 0;
}

/* Returns the bytes of the body that is then in `arrived`, 0 if the byte is not the end of a frame. */
static size_t arrive(uint8_t byte)
{
    size_t count = arrived_count;
    if (byte != 0u) {
        if (arrived_count < sizeof arrived) { /* beyond that it is no frame */
            arrived[arrived_count++] = byte;
        }
        return 0;
    }
    arrived_count = 0;
    return decode(arrived, count);
}

/* The host has this frame: it knows from the numbers how many samples it has not. */
static void accept(const sent_t *frame)
{
    CHECK(memcmp(arrived, frame->content, frame->count) == 0);
    if (arrived[0] == 1u) {
        uint16_t number = (uint16_t)(arrived[1] | arrived[2] << 8);
        CHECK(!any_sample || (uint16_t)(number - latest_number) == frame->samples - latest_samples);
        any_sample = true;
        latest_number = number;
        latest_samples = frame->samples;
    }
}

/* ---- the line ---- */

typedef enum { INTACT, LOST, CHANGED, TWICE, INSERTED } fate_t;

static size_t carried;           /* bytes of the first frame */
static unsigned faults, hidden;  /* in it so far; of those, such that a CRC-16 need not see them */

/* Carries one byte over the line. */
static void carry(fate_t fate, uint8_t other)
{
    uint8_t byte = 0xA5;
    bool any = first != end;
    CHECK(ring_empty(&ring) == !any && ring_take(&ring, &byte) == any);
    if (!any) {
        CHECK(byte == 0xA5);
        return;
    }
    const sent_t *frame = &sent[first % RING_BYTES];
    size_t at = carried++;
    bool last = carried == frame->count + AROUND_BODY, lost_end = false;
    CHECK((byte == 0u) == last);

    size_t count = 0;
    if (fate == CHANGED && (other == byte || other == 0u)) {
        fate = other == byte ? INTACT : INSERTED;
    }
    faults += fate != INTACT;
    switch (fate) {
    case INTACT:
        count = arrive(byte);
        break;
    case LOST:
        lost_end = last;
        hidden++;
        break;
    case CHANGED: /* in the content: eight bits at most that follow one another, which a CRC-16 always sees */
        hidden += at == 0u || last || frame->content[at - 1u] == 0u;
        lost_end = last;
        (void)arrive(other);
        break;
    case TWICE:
        hidden++;
        count = arrive(byte);
        (void)arrive(byte); /* an end, and an empty frame */
        break;
    case INSERTED:
        hidden++;
        (void)arrive(other);
        count = arrive(byte);
    }
    if (last) {
        if (faults == 0u) {
            CHECK(count == frame->count);
            accept(frame);
        } else if (hidden == 0u && faults == 1u) {
            CHECK(count == 0u);
        }
        first++;
        carried = 0;
        faults = hidden = lost_end; /* which runs into the next */
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input = data;
    input_left = size;
    first = end = carried = arrived_count = 0;
    faults = hidden = samples = 0;
    any_sample = false;
    ring.put_count = ring.taken_count = take_u32();
    rdpi_telemetry_t line = {.offered_count = take_u32(), .refused_count = take_u32()};
    while (input_left > 0) {
        uint8_t what = take_u8();
        if (what < 64) {
            offer_sample(&line);
        } else if (what < 96) {
            offer_info(&line);
        } else if (what < 192) {
            for (unsigned bytes = what - 95u; bytes > 0; bytes--) {
                carry(INTACT, 0);
            }
        } else {
            carry((fate_t)(LOST + what % 4u), take_u8());
        }
    }
    while (first != end) {
        carry(INTACT, 0);
    }
    CHECK(ring_empty(&ring));
    return 0;
}
