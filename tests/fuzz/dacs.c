/* Whatever is called in whatever order, with any code, any wiring and a bus that is busy for as long as it likes, the
 * DAC drivers send what the frame format says: a DAC of each kind, simulated from the tables in ad5683r.h and dac8562.h,
 * outputs the codes that were taken and holds them where they were refused. */
#include "bytes.h"

#include "../../port/drivers/ad5683r.h"
#include "../../port/drivers/dac8562.h"

#include "rdpi_spi.h"

/* Both have static functions of the same names. */
#define count ad5683r_count
#define put ad5683r_put
#include "../../port/drivers/ad5683r.c"
#undef count
#undef put
#undef WRITE_INPUT
#define count dac8562_count
#define put dac8562_put
#include "../../port/drivers/dac8562.c"
#undef count
#undef put

/* The DAC on the bus: its registers. One channel or two. */
typedef struct {
    bool reset, reference, gain_2, powered, transparent; /* transparent: outputs do not wait for the LDAC pin */
    uint16_t input[2], output[2];
    unsigned frames;
} dac_t;

static dac_t dac;
static bool is_dac8562;

/* ---- the bus ---- */

static const uint8_t *sending; /* NULL: free */
static uint8_t as_begun[2 * RDPI_SPI_FRAME_BYTES];
static size_t sending_frames;
static unsigned busy_polls; /* for which it stays busy, from now on */
static bool asked;          /* and found free, since the latest write */

/* One command of the table in ad5683r.h. DB3 .. DB0 are 0: some parts of the family read them. */
static void ad5683r_takes(uint32_t word)
{
    uint16_t value = (uint16_t)(word >> 4 & 0xFFFFu);
    CHECK((word & 0xFu) == 0u);
    switch (word >> 20) {
    case 1:
        dac.input[0] = value;
        break;
    case 3:
        dac.input[0] = dac.output[0] = value;
        break;
    case 4:
        CHECK((value & 0x67FFu) == 0u); /* DB18 and DB17 power down, DB14 chains; the rest is reserved */
        if (value & 0x8000u) {
            CHECK(value == 0x8000u);
            dac = (dac_t){.reset = true, .reference = true, .powered = true, .frames = dac.frames};
        } else {
            dac.reference = (value & 0x1000u) == 0u;
            dac.gain_2 = (value & 0x0800u) != 0u;
        }
        break;
    default:
        CHECK(!"a command of the table");
    }
}

/* One command of the table in dac8562.h. */
static void dac8562_takes(uint32_t word)
{
    uint16_t value = (uint16_t)word;
    unsigned channel = word >> 16 & 1u;
    switch (word >> 16) {
    case 0x00:
    case 0x01:
        dac.input[channel] = value;
        break;
    case 0x11:
        dac.input[channel] = value;
        dac.output[0] = dac.input[0];
        dac.output[1] = dac.input[1];
        break;
    case 0x18:
    case 0x19:
        dac.input[channel] = dac.output[channel] = value;
        break;
    case 0x02:
        CHECK(value == 0u || value == 3u);
        dac.gain_2 = value == 0u;
        break;
    case 0x20:
        CHECK(value == 3u);
        dac.powered = true;
        break;
    case 0x28:
        CHECK(value == 1u);
        dac = (dac_t){.reset = true, .frames = dac.frames};
        break;
    case 0x30:
        CHECK(value == 0u);
        dac.transparent = false;
        break;
    case 0x38:
        CHECK(value <= 1u);
        dac.reference = dac.gain_2 = value == 1u;
        break;
    default:
        CHECK(!"a command of the table");
    }
}

static void dac_takes(const uint8_t *bytes, size_t frames)
{
    for (size_t k = 0; k < frames; k++) {
        const uint8_t *frame = &bytes[k * RDPI_SPI_FRAME_BYTES];
        uint32_t word = (uint32_t)frame[0] << 16 | (uint32_t)frame[1] << 8 | frame[2];
        uint16_t before[2] = {dac.output[0], dac.output[1]};
        (is_dac8562 ? dac8562_takes : ad5683r_takes)(word);
        /* Of two frames the first does not show: both outputs change together. */
        CHECK(k + 1u == frames || memcmp(before, dac.output, sizeof before) == 0);
        dac.frames++;
    }
}

/* The transfer ends: the bytes go out as they are at this moment, as by DMA. */
static void finish_transfer(void)
{
    if (sending != NULL) {
        CHECK(memcmp(sending, as_begun, sending_frames * RDPI_SPI_FRAME_BYTES) == 0);
        dac_takes(sending, sending_frames);
        sending = NULL;
    }
}

bool rdpi_spi_busy(void)
{
    if (busy_polls > 0) {
        busy_polls--;
    } else {
        finish_transfer();
        asked = true;
    }
    return sending != NULL;
}

void rdpi_spi_write(const uint8_t *bytes, size_t frames)
{
    CHECK(asked && sending == NULL && (frames == 1u || (frames == 2u && is_dac8562)));
    asked = false;
    sending = bytes;
    sending_frames = frames;
    memcpy(as_begun, bytes, frames * RDPI_SPI_FRAME_BYTES);
    busy_polls = take_u8() % 4u;
}

/* ---- the application ---- */

/* What the driver, once the bus is free, must have made of the calls. */
static struct {
    bool external_reference, gain_2, ldac_driven, ready;
    uint16_t input[2], output[2];
    uint32_t busy_count, code_count;
} expected;

static rdpi_ad5683r_t ad5683r;
static rdpi_dac8562_t dac8562;

static void check(void)
{
    CHECK((is_dac8562 ? dac8562.busy_count : ad5683r.busy_count) == expected.busy_count);
    CHECK((is_dac8562 ? dac8562.code_count : ad5683r.code_count) == expected.code_count);
    if (expected.ready && sending == NULL) {
        CHECK(dac.reset && dac.powered && !dac.transparent);
        CHECK(dac.reference == !expected.external_reference && dac.gain_2 == expected.gain_2);
        CHECK(memcmp(dac.input, expected.input, sizeof dac.input) == 0);
        CHECK(memcmp(dac.output, expected.output, sizeof dac.output) == 0);
    }
}

/* With a bus that is free, and a DAC that a warm start has left as it was. */
static void do_init(void)
{
    uint8_t how = take_u8(), old = take_u8();
    finish_transfer();
    busy_polls = 0;
    memset(&expected, 0, sizeof expected);
    expected.external_reference = how & 1u;
    expected.gain_2 = how & 2u;
    expected.ldac_driven = how & 4u;
    memset(&ad5683r, old, sizeof ad5683r);
    memset(&dac8562, old, sizeof dac8562);
    dac = (dac_t){.reference = how & 8u, .gain_2 = how & 16u, .transparent = how & 32u,
                  .input = {old, old}, .output = {old, old}};
    if (is_dac8562) {
        const rdpi_dac8562_config_t config = {expected.external_reference, expected.gain_2, expected.ldac_driven};
        rdpi_dac8562_init(&dac8562, &config);
    } else {
        const rdpi_ad5683r_config_t config = {expected.external_reference, expected.gain_2, expected.ldac_driven};
        rdpi_ad5683r_init(&ad5683r, &config);
    }
    CHECK(sending == NULL);
    check();
    if (how & 64u) { /* as after as many refusals */
        uint32_t refused = UINT32_MAX - how % 4u;
        ad5683r.busy_count = ad5683r.code_count = dac8562.busy_count = dac8562.code_count = refused;
        expected.busy_count = expected.code_count = refused;
    }
}

static void do_start(void)
{
    unsigned frames = dac.frames + (sending != NULL);
    bool done = is_dac8562 ? rdpi_dac8562_start(&dac8562) : rdpi_ad5683r_start(&ad5683r);
    unsigned begun = dac.frames + (sending != NULL) - frames;
    CHECK(begun <= 1u && (begun == 0u || !expected.ready) && (!expected.ready || done));
    if (done && !expected.ready) {
        CHECK(sending == NULL && dac.frames == (is_dac8562 ? 5u : 2u));
        expected.ready = true;
    }
}

/* A code that is as likely inside as outside the range. */
static uint32_t take_code(void)
{
    uint8_t how = take_u8();
    return how < 128 ? take_u16() : (how < 192 ? 65536u + take_u16() : take_u32());
}

static void do_write(uint8_t how)
{
    bool a = !is_dac8562 || how % 4u != 1u, b = is_dac8562 && how % 4u != 0u;
    uint32_t code_a = a ? take_code() : 0u, code_b = b ? take_code() : 0u;
    bool free = expected.ready && (sending == NULL || busy_polls == 0u);
    bool fits = code_a <= 65535u && code_b <= 65535u;
    bool taken;
    if (!is_dac8562) {
        taken = rdpi_ad5683r_write(&ad5683r, code_a);
    } else if (a && b) {
        taken = rdpi_dac8562_write(&dac8562, code_a, code_b);
    } else {
        taken = rdpi_dac8562_write_channel(&dac8562, a ? RDPI_DAC8562_A : RDPI_DAC8562_B, a ? code_a : code_b);
    }
    CHECK(taken == (free && fits));
    if (!free) {
        expected.busy_count += expected.busy_count < UINT32_MAX;
    } else if (!fits) {
        expected.code_count += expected.code_count < UINT32_MAX;
    } else {
        const uint8_t *bytes = is_dac8562 ? dac8562.bytes : ad5683r.bytes;
        CHECK(sending == bytes && sending_frames == (a && b ? 2u : 1u));
        for (unsigned channel = 0; channel < 2u; channel++) {
            if (channel == 0u ? a : b) {
                expected.input[channel] = (uint16_t)(channel == 0u ? code_a : code_b);
                if (!expected.ldac_driven) {
                    expected.output[channel] = expected.input[channel];
                }
            }
        }
    }
}

/* An edge of LDAC, after the frames. */
static void do_ldac(void)
{
    finish_transfer();
    busy_polls = 0;
    if (expected.ldac_driven && expected.ready) {
        memcpy(dac.output, dac.input, sizeof dac.output);
        memcpy(expected.output, expected.input, sizeof dac.output);
    }
}

/* A fault, perhaps amid a transfer, of which the DAC discards the frame: its outputs go to the safe codes. */
static void do_safe(uint8_t how)
{
    const rdpi_ad5683r_config_t config = {expected.external_reference, expected.gain_2, expected.ldac_driven};
    uint32_t code_a = take_code(), code_b = take_code();
    uint8_t bytes[2 * RDPI_SPI_FRAME_BYTES];
    if (how % 2u == 0u) {
        finish_transfer();
    }
    sending = NULL;
    if (is_dac8562) {
        rdpi_dac8562_safe_frames(code_a, code_b, bytes);
    } else {
        rdpi_ad5683r_safe_frames(&config, code_a, bytes);
    }
    dac_takes(bytes, 2);
    CHECK(code_a > 65535u || dac.output[0] == code_a);
    CHECK(!is_dac8562 || code_b > 65535u || dac.output[1] == code_b);
    CHECK(is_dac8562 || (dac.reference == !expected.external_reference && dac.gain_2 == expected.gain_2));
    do_init();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input = data;
    input_left = size;
    sending = NULL;
    asked = false;
    is_dac8562 = take_u8() % 2u == 1u;
    do_init();
    while (input_left > 0) {
        uint8_t what = take_u8();
        switch (what % 8u) {
        case 0:
        case 1:
            do_start();
            break;
        case 2:
            do_ldac();
            break;
        case 3:
            if (what >= 224) {
                do_init();
            } else if (what >= 192) {
                do_safe(what / 8u);
            }
            break;
        default:
            do_write(what / 8u);
        }
        check();
    }
    return 0;
}
