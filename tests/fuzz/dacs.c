/* Whatever is called in whatever order, with any code, any wiring, a bus that is busy for as long as it likes and an I2C
 * that fails now and then, the DAC drivers send what the frame format says: a DAC of each kind, simulated from the tables
 * in ad5683r.h, dac8562.h, mcp4922.h and mcp4725.h, outputs the codes that were taken and holds them where they were
 * refused. */
#include "bytes.h"

#include "../../port/drivers/ad5683r.h"
#include "../../port/drivers/dac8562.h"
#include "../../port/drivers/mcp4725.h"
#include "../../port/drivers/mcp4922.h"

#include "rdpi_i2c.h"
#include "rdpi_spi.h"

/* They have static functions of the same names. */
#define count ad5683r_count
#define put ad5683r_put
#define send ad5683r_send
#include "../../port/drivers/ad5683r.c"
#undef count
#undef put
#undef send
#undef WRITE_INPUT
#define count dac8562_count
#define put dac8562_put
#define accepts dac8562_accepts
#include "../../port/drivers/dac8562.c"
#undef count
#undef put
#undef accepts
#undef CHANNEL_B
#define count mcp4922_count
#define put mcp4922_put
#define accepts mcp4922_accepts
#include "../../port/drivers/mcp4922.c"
#undef count
#undef put
#undef accepts
#define count mcp4725_count
#define send mcp4725_send
#include "../../port/drivers/mcp4725.c"
#undef count
#undef send

typedef enum { AD5683R, DAC8562, MCP4922, MCP4725, PARTS } part_t;
static part_t part; /* on the bus */

/* Its registers. One channel or two. */
typedef struct {
    bool reset, reference, gain_2, buffered, powered, transparent; /* transparent: outputs do not wait for LDAC */
    uint16_t input[2], output[2];
    unsigned frames;
} dac_t;

static dac_t dac;

static const size_t frame_bytes[PARTS] = {3, 3, 2, 2};
static const uint32_t max_code[PARTS] = {65535, 65535, 4095, 4095};

static bool has_two(void)
{
    return part == DAC8562 || part == MCP4922;
}

/* Whether it needs no start: it has nothing to be set up. */
static bool is_ready_at_once(void)
{
    return part == MCP4922;
}

/* ---- the parts ---- */

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

/* One frame of the table in mcp4922.h: the whole configuration, and a code. The output follows at once if LDAC is low. */
static void mcp4922_takes(uint32_t word)
{
    unsigned channel = word >> 15;
    CHECK(word >> 12 & 1u); /* the output is on */
    dac.buffered = word >> 14 & 1u;
    dac.gain_2 = (word >> 13 & 1u) == 0u;
    dac.input[channel] = (uint16_t)(word & 0xFFFu);
    if (dac.transparent) {
        dac.output[channel] = dac.input[channel];
    }
}

/* A fast write; no other command reaches the EEPROM's neighbourhood. */
static void mcp4725_takes(uint32_t word)
{
    CHECK(word >> 12 == 0u);
    dac.output[0] = (uint16_t)word;
}

static void dac_takes(const uint8_t *bytes, size_t frames)
{
    static void (*const takes[PARTS])(uint32_t) = {ad5683r_takes, dac8562_takes, mcp4922_takes, mcp4725_takes};
    for (size_t k = 0; k < frames; k++) {
        uint32_t word = 0;
        uint16_t before[2] = {dac.output[0], dac.output[1]};
        for (size_t i = 0; i < frame_bytes[part]; i++) {
            word = word << 8 | bytes[k * frame_bytes[part] + i];
        }
        takes[part](word);
        /* Of two frames the first does not show, both outputs change together; but those of an MCP4922 with LDAC low. */
        CHECK(k + 1u == frames || dac.transparent || memcmp(before, dac.output, sizeof before) == 0);
        dac.frames++;
    }
}

/* ---- the bus ---- */

static const uint8_t *sending; /* NULL: free */
static uint8_t as_begun[6];
static size_t sending_frames;
static unsigned busy_polls;       /* for which it stays busy, from now on */
static bool asked;                /* and found free, since the latest write */
static bool fails, failed, known; /* the transfer on the I2C will not be acknowledged; the latest was not; the driver saw */

static void begin(const uint8_t *bytes, size_t frames)
{
    CHECK(asked && sending == NULL && (frames == 1u || (frames == 2u && has_two())));
    asked = false;
    sending = bytes;
    sending_frames = frames;
    memcpy(as_begun, bytes, frames * frame_bytes[part]);
    busy_polls = take_u8() % 4u;
}

/* The transfer ends: the bytes go out as they are at this moment, as by DMA. */
static void finish_transfer(void)
{
    if (sending != NULL) {
        CHECK(memcmp(sending, as_begun, sending_frames * frame_bytes[part]) == 0);
        if (!fails) {
            dac_takes(sending, sending_frames);
        }
        failed = fails;
        known = false;
        sending = NULL;
    }
}

static bool is_busy(void)
{
    if (busy_polls > 0) {
        busy_polls--;
    } else {
        finish_transfer();
        asked = true;
    }
    return sending != NULL;
}

bool rdpi_spi_busy(void)
{
    CHECK(part != MCP4725);
    return is_busy();
}

void rdpi_spi_write(const uint8_t *bytes, size_t of_frame, size_t frames)
{
    CHECK(part != MCP4725 && of_frame == frame_bytes[part]);
    fails = false;
    begin(bytes, frames);
}

/* What the driver, once the bus is free, must have made of the calls. */
static struct {
    bool external_reference, gain_2, buffered, ldac_driven, ready;
    uint8_t address;
    uint16_t input[2], output[2];
    uint16_t sent; /* the code of the latest transfer on the I2C */
    uint32_t busy_count, code_count, fail_count;
} expected;

static void increase(uint32_t *counter)
{
    *counter += *counter < UINT32_MAX;
}

rdpi_i2c_state_t rdpi_i2c_state(void)
{
    CHECK(part == MCP4725);
    if (is_busy()) {
        return RDPI_I2C_BUSY;
    }
    if (!known) { /* the driver sees how it ended */
        known = true;
        if (failed) {
            increase(&expected.fail_count);
        } else {
            expected.output[0] = expected.sent;
        }
    }
    return failed ? RDPI_I2C_FAILED : RDPI_I2C_DONE;
}

void rdpi_i2c_write(uint8_t address, const uint8_t *bytes, size_t count)
{
    CHECK(part == MCP4725 && address == expected.address && address >= 0x60 && address <= 0x67 && count == 2u);
    begin(bytes, 1);
    fails = take_u8() % 4u == 0u;
    expected.sent = (uint16_t)(bytes[0] << 8 | bytes[1]);
}

/* ---- the application ---- */

static rdpi_ad5683r_t ad5683r;
static rdpi_dac8562_t dac8562;
static rdpi_mcp4922_t mcp4922;
static rdpi_mcp4725_t mcp4725;

static uint32_t *busy_count(void)
{
    uint32_t *const of[PARTS] = {&ad5683r.busy_count, &dac8562.busy_count, &mcp4922.busy_count, &mcp4725.busy_count};
    return of[part];
}

static uint32_t *code_count(void)
{
    uint32_t *const of[PARTS] = {&ad5683r.code_count, &dac8562.code_count, &mcp4922.code_count, &mcp4725.code_count};
    return of[part];
}

static void check(void)
{
    CHECK(*busy_count() == expected.busy_count);
    CHECK(*code_count() == expected.code_count);
    CHECK(part != MCP4725 || mcp4725.fail_count == expected.fail_count);
    if (!expected.ready || sending != NULL || (part == MCP4725 && !known)) {
        return;
    }
    if (part == AD5683R || part == DAC8562) {
        CHECK(dac.reset && dac.powered && !dac.transparent && dac.reference == !expected.external_reference);
    }
    if (part != MCP4725 && dac.frames > 0u) {
        CHECK(dac.gain_2 == expected.gain_2 && dac.buffered == expected.buffered);
    }
    CHECK(memcmp(dac.input, expected.input, sizeof dac.input) == 0);
    CHECK(memcmp(dac.output, expected.output, sizeof dac.output) == 0);
}

/* The part as a warm start of the microcontroller has left it. */
static void dac_was(uint8_t how, uint8_t old)
{
    dac = (dac_t){.reference = how & 8u, .gain_2 = how & 16u, .transparent = how & 32u,
                  .input = {old, old}, .output = {old, old}};
    if (part == MCP4922) {
        dac.transparent = !expected.ldac_driven;
        memcpy(expected.input, dac.input, sizeof dac.input);
        memcpy(expected.output, dac.output, sizeof dac.output);
    } else if (part == MCP4725) {
        memset(dac.input, 0, sizeof dac.input);
        dac.output[1] = 0;
        memcpy(expected.output, dac.output, sizeof dac.output);
    }
}

/* With a bus that is free. */
static void do_init(void)
{
    uint8_t how = take_u8(), old = take_u8();
    finish_transfer();
    busy_polls = 0;
    known = true;
    failed = how & 128u; /* of somebody else */
    memset(&expected, 0, sizeof expected);
    expected.external_reference = how & 1u;
    expected.gain_2 = how & 2u;
    expected.ldac_driven = how & 4u;
    expected.buffered = part == MCP4922 && (how & 1u);
    expected.address = part != MCP4725 ? 0u : (old % 8u == 0u ? how : (uint8_t)(0x60u | how % 8u));
    expected.ready = is_ready_at_once();
    memset(&ad5683r, old, sizeof ad5683r);
    memset(&dac8562, old, sizeof dac8562);
    memset(&mcp4922, old, sizeof mcp4922);
    memset(&mcp4725, old, sizeof mcp4725);
    dac_was(how, old);
    const rdpi_ad5683r_config_t of_ad5683r = {expected.external_reference, expected.gain_2, expected.ldac_driven};
    const rdpi_dac8562_config_t of_dac8562 = {expected.external_reference, expected.gain_2, expected.ldac_driven};
    const rdpi_mcp4922_config_t of_mcp4922 = {expected.buffered, expected.gain_2};
    const rdpi_mcp4725_config_t of_mcp4725 = {expected.address};
    rdpi_ad5683r_init(&ad5683r, &of_ad5683r);
    rdpi_dac8562_init(&dac8562, &of_dac8562);
    rdpi_mcp4922_init(&mcp4922, &of_mcp4922);
    rdpi_mcp4725_init(&mcp4725, &of_mcp4725);
    CHECK(sending == NULL);
    check();
    if (how & 64u) { /* as after as many refusals */
        uint32_t refused = UINT32_MAX - how % 4u;
        *busy_count() = *code_count() = mcp4725.fail_count = refused;
        expected.busy_count = expected.code_count = expected.fail_count = refused;
    }
}

/* A code that is as likely inside as outside the range. */
static uint32_t take_code(void)
{
    uint8_t how = take_u8();
    uint32_t max = max_code[part];
    return how < 128 ? take_u16() & max : (how < 192 ? max + 1u + take_u16() : take_u32());
}

static bool address_exists(void)
{
    return expected.address >= 0x60 && expected.address <= 0x67;
}

static bool start_mcp4725(unsigned begun)
{
    uint32_t code = take_code();
    bool done = rdpi_mcp4725_start(&mcp4725, code);
    if (!expected.ready && code > 4095u) {
        increase(&expected.code_count);
        CHECK(!done);
    }
    CHECK(!done || (address_exists() && (expected.ready || (known && !failed))));
    begun = dac.frames + (sending != NULL) - begun;
    CHECK(begun == 0u || (address_exists() && code <= 4095u));
    return done;
}

static void do_start(void)
{
    unsigned frames = dac.frames + (sending != NULL);
    bool done = part == AD5683R   ? rdpi_ad5683r_start(&ad5683r)
                : part == DAC8562 ? rdpi_dac8562_start(&dac8562)
                : part == MCP4725 ? start_mcp4725(frames)
                                  : true;
    unsigned begun = dac.frames + (sending != NULL) - frames;
    CHECK(part == MCP4725 || (begun <= 1u && (begun == 0u || !expected.ready)));
    CHECK(!expected.ready || done);
    if (done && !expected.ready) {
        CHECK(sending == NULL && (part == MCP4725 || dac.frames == (part == DAC8562 ? 5u : 2u)));
        expected.ready = true;
    }
}

/* What the driver returns for a code on channel A, on B, or on both. */
static bool write_codes(bool a, bool b, uint32_t code_a, uint32_t code_b)
{
    switch (part) {
    case AD5683R:
        return rdpi_ad5683r_write(&ad5683r, code_a);
    case MCP4725:
        return rdpi_mcp4725_write(&mcp4725, code_a);
    case DAC8562:
        return a && b ? rdpi_dac8562_write(&dac8562, code_a, code_b)
                      : rdpi_dac8562_write_channel(&dac8562, a ? RDPI_DAC8562_A : RDPI_DAC8562_B, a ? code_a : code_b);
    default:
        return a && b ? rdpi_mcp4922_write(&mcp4922, code_a, code_b)
                      : rdpi_mcp4922_write_channel(&mcp4922, a ? RDPI_MCP4922_A : RDPI_MCP4922_B, a ? code_a : code_b);
    }
}

/* The bytes of a transfer that a driver has begun are its own. */
static const uint8_t *own_bytes(void)
{
    const uint8_t *const of[PARTS] = {ad5683r.bytes, dac8562.bytes, mcp4922.bytes, mcp4725.bytes};
    return of[part];
}

static void do_write(uint8_t how)
{
    bool a = !has_two() || how % 4u != 1u, b = has_two() && how % 4u != 0u;
    uint32_t code_a = a ? take_code() : 0u, code_b = b ? take_code() : 0u;
    bool free = expected.ready && (sending == NULL || busy_polls == 0u);
    bool fits = code_a <= max_code[part] && code_b <= max_code[part];
    bool taken = write_codes(a, b, code_a, code_b);
    if (!free) {
        increase(&expected.busy_count);
    } else if (!fits) {
        increase(&expected.code_count);
    } else if (part == MCP4725) { /* which may know already how it ended */
        CHECK(expected.sent == code_a && (sending == NULL || sending == own_bytes()));
        CHECK(taken == (sending != NULL || !failed));
        return;
    } else {
        CHECK(sending == own_bytes() && sending_frames == (a && b ? 2u : 1u));
        for (unsigned channel = 0; channel < 2u; channel++) {
            if (channel == 0u ? a : b) {
                expected.input[channel] = (uint16_t)(channel == 0u ? code_a : code_b);
                if (!expected.ldac_driven) {
                    expected.output[channel] = expected.input[channel];
                }
            }
        }
    }
    CHECK(taken == (free && fits));
}

/* An edge of LDAC, after the frames. */
static void do_ldac(void)
{
    if (part == MCP4725) {
        return;
    }
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
    const rdpi_ad5683r_config_t of_ad5683r = {expected.external_reference, expected.gain_2, expected.ldac_driven};
    const rdpi_mcp4922_config_t of_mcp4922 = {expected.buffered, expected.gain_2};
    uint32_t code_a = take_code(), code_b = take_code();
    uint8_t bytes[6];
    if (how % 2u == 0u) {
        finish_transfer();
    }
    sending = NULL;
    switch (part) {
    case AD5683R:
        rdpi_ad5683r_safe_frames(&of_ad5683r, code_a, bytes);
        break;
    case DAC8562:
        rdpi_dac8562_safe_frames(code_a, code_b, bytes);
        break;
    case MCP4922:
        rdpi_mcp4922_safe_frames(&of_mcp4922, code_a, code_b, bytes);
        break;
    default:
        rdpi_mcp4725_safe_frames(code_a, bytes);
    }
    dac_takes(bytes, part == MCP4725 ? 1 : 2);
    if (part == MCP4922 && expected.ldac_driven) { /* which rdpi_port_safe pulls low */
        memcpy(dac.output, dac.input, sizeof dac.output);
    }
    CHECK(code_a > max_code[part] || dac.output[0] == code_a);
    CHECK(!has_two() || code_b > max_code[part] || dac.output[1] == code_b);
    CHECK(part == DAC8562 || part == MCP4725 || dac.gain_2 == expected.gain_2);
    CHECK(part != AD5683R || dac.reference == !expected.external_reference);
    do_init();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input = data;
    input_left = size;
    sending = NULL;
    asked = fails = failed = false;
    part = (part_t)(take_u8() % PARTS);
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
