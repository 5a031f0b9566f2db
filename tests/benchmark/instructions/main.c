/* Counts the instructions of one engine's step on an emulated board: over a profile, mean and worst, and in a search
 * for inputs that cost more. With BLOCK, over the profile in blocks of so many samples instead. What it prints is read by
 * ../instructions.py.
 *
 * Under `-icount shift=10` the emulated time moves by 1024 ns per instruction and SysTick by 25.6 at 25 MHz, so every
 * difference of two readings is that of exactly one count of instructions. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "case.h"
#include ENGINE

#include "random_bits.h"

typedef reference_t step_t(state_t *self, reference_t reference);

/* ---- counting ---- */

#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)
#define SYST_MAX 0xFFFFFFu

static uint32_t loop_ticks, empty_count;

#define LOOP_COUNT 400002u

__attribute__((naked, noipa)) static reference_t loop(state_t *self, reference_t reference)
{
    (void)self;
    (void)reference;
    __asm__ volatile(".syntax unified\n ldr r2, =200000\n 0: subs r2, #1\n bne 0b\n bx lr\n .ltorg");
}

/* One instruction: bx lr. */
__attribute__((naked, noipa)) static reference_t empty(state_t *self, reference_t reference)
{
    (void)self;
    (void)reference;
    __asm__ volatile("bx lr");
}

__attribute__((noipa)) static uint32_t ticks_of(step_t *call, state_t *self, reference_t reference)
{
    uint32_t begin = SYST_CVR;
    (void)call(self, reference);
    return (begin - SYST_CVR) & SYST_MAX;
}

static uint32_t instructions(uint32_t ticks)
{
    return (uint32_t)(((uint64_t)ticks * (LOOP_COUNT - 1u) + loop_ticks / 2u) / loop_ticks);
}

/* Of the call alone, from its first instruction to its return. */
static uint32_t count(step_t *call, state_t *self, reference_t reference)
{
    return instructions(ticks_of(call, self, reference)) - empty_count + 1u;
}

static void calibrate(void)
{
    SYST_RVR = SYST_MAX;
    SYST_CVR = 0;
    SYST_CSR = 5; /* on, the processor's clock */
    uint32_t none = ticks_of(empty, NULL, 0);
    loop_ticks = ticks_of(loop, NULL, 0) - none; /* of LOOP_COUNT less the one in `empty` */
    empty_count = instructions(none);
    if (loop_ticks < 4u * LOOP_COUNT || count(loop, NULL, 0) != LOOP_COUNT || count(empty, NULL, 0) != 1u) {
        printf("SysTick does not count instructions: run this under -icount shift=10\n");
        exit(1);
    }
}

/* ---- what is measured ---- */

typedef struct {
    unsigned missed; /* samples before this one */
    reference_t reference;
} sample_t;

typedef enum { ORDINARY, FIRST, AFTER_MISSED, REFUSED, KINDS } kind_t;
static const char *const kind_name[KINDS] = {"ordinary", "first", "after missed", "refused"};

/* A path is a sequence of samples from power up; state[i] is that before sample i. */
#define LONGEST 8u
#define CHANGES 60u /* tried per climb */
#define HALVINGS 28u
static state_t state[LONGEST + 1u];
static sample_t path[LONGEST];

/* The worst of each kind of sample, and how to get there. */
static struct {
    uint32_t count;
    size_t length;
    sample_t path[LONGEST];
} worst[KINDS];

/* Sample i of the path, counted. */
static uint32_t play(size_t i, sample_t sample)
{
    state_t *self = &state[i + 1u];
    bool after_refused = i > 0u && (FLAGS(state[i]) & RDPI_FLAG_INPUT) != 0u;
    path[i] = sample;
    *self = state[i];
    if (sample.missed > 0u) {
        ENGINE_MISSED(self, sample.missed);
    }
    uint32_t cost = count(ENGINE_STEP, self, sample.reference);
    kind_t kind = (FLAGS(*self) & RDPI_FLAG_INPUT) != 0u ? REFUSED
                  : i == 0u                             ? FIRST
                  : sample.missed > 0u || after_refused ? AFTER_MISSED
                                                        : ORDINARY;
    if (cost > worst[kind].count) {
        worst[kind].count = cost;
        worst[kind].length = i + 1u;
        memcpy(worst[kind].path, path, sizeof path);
    }
    return cost;
}

#define CANDIDATES (sizeof candidate / sizeof *candidate)

/* Sample i for references closer and closer to where its count changes: there a play is about to engage, and what is
 * output may be on the other side of that than what was solved for. */
static void search_corners(size_t i)
{
    for (size_t j = 1; j < CANDIDATES; j++) {
        reference_t low = candidate[j - 1u], high = candidate[j];
        uint32_t at_low = play(i, (sample_t){0, low}), at_high = play(i, (sample_t){0, high});
        for (unsigned halving = 0; halving < HALVINGS && at_low != at_high; halving++) {
            reference_t middle = (reference_t)(low + ((double)high - low) / 2);
            uint32_t at_middle = play(i, (sample_t){0, middle});
            if (at_middle == at_low) {
                low = middle;
            } else {
                high = middle;
                at_high = at_middle;
            }
        }
    }
}

/* From power up or one end of the range to any candidate, held there for a sample or not, and on to any other, at once
 * or late: all combinations of plays that are engaged, left behind and engaged anew, at rates that are high or 0. */
static void search_pairs(void)
{
    const reference_t from[] = {candidate[0], candidate[CANDIDATES - 1u]};
    for (size_t begin = 0; begin <= sizeof from / sizeof *from; begin++) {
        size_t i = 0;
        if (begin > 0u) {
            play(i++, (sample_t){0, from[begin - 1u]});
        }
        search_corners(i);
        for (size_t k = 0; k < CANDIDATES; k++) {
            play(i, (sample_t){0, candidate[k]});
            for (size_t j = 0; j < CANDIDATES; j++) {
                play(i + 1u, (sample_t){0, candidate[j]});
                play(i + 1u, (sample_t){RDPI_MAX_MISSED, candidate[j]});
            }
            if (k % (CANDIDATES / 32u + 1u) == 0u) { /* at most 32 of them, or it takes too long */
                search_corners(i + 1u);
            }
            play(i + 1u, (sample_t){0, candidate[k]});
            for (size_t j = 0; j < CANDIDATES; j++) {
                play(i + 2u, (sample_t){0, candidate[j]});
            }
        }
    }
}

/* From `reference` some of the way to a candidate: any part from 2^-32 of it to the whole, of all sizes alike. */
static reference_t near(reference_t reference)
{
    double way = (double)candidate[random_bits() % CANDIDATES] - reference;
    return (reference_t)(reference + way * random_length() / 4294967296.0);
}

static unsigned some_missed(void)
{
    return 1u + random_bits() % (RDPI_MAX_MISSED + 2u);
}

/* In place of sample i of the path. */
static sample_t any_sample(size_t i, bool gaps)
{
    sample_t sample = {0, candidate[random_bits() % CANDIDATES]};
    bool usable_before = i > 0u && (FLAGS(state[i]) & RDPI_FLAG_INPUT) == 0u;
    switch (random_bits() % 6u) {
    case 0:
        sample.reference = near(sample.reference);
        break;
    case 1:
        sample.reference = usable_before ? near(path[i - 1u].reference) : sample.reference;
        break;
    case 2:
        sample.missed = gaps ? some_missed() : 0u;
        break;
    case 3:
        sample.reference = gaps ? NO_REFERENCE : sample.reference;
        break;
    default:
        break;
    }
    return sample;
}

/* Sample i of the path, changed. */
static sample_t changed_sample(size_t i, bool gaps)
{
    sample_t sample = path[i];
    bool usable = (FLAGS(state[i + 1u]) & RDPI_FLAG_INPUT) == 0u;
    switch (random_bits() % 4u) {
    case 0:
        return any_sample(i, gaps);
    case 1:
        sample.missed = gaps ? some_missed() : 0u;
        break;
    default:
        break;
    }
    sample.reference = usable ? near(sample.reference) : sample.reference;
    return sample;
}

/* Hill climbing over short paths, from the worst so far of a kind of sample or, if there is none, a random one: one
 * sample is changed, and stays so unless the last of the path gets cheaper. Then the last is taken to the corners. */
static void climb(uint32_t kind, bool gaps)
{
    static state_t kept_state[LONGEST + 1u];
    sample_t kept_path[LONGEST];
    uint32_t reached = 0;
    bool known = kind < KINDS && worst[kind].length > 0u;
    size_t length = known ? worst[kind].length : 2u + random_bits() % (LONGEST - 1u);
    for (size_t i = 0; i < length; i++) {
        reached = play(i, known ? worst[kind].path[i] : any_sample(i, gaps));
    }
    for (unsigned change = 0; change < CHANGES; change++) {
        uint32_t cost = 0;
        size_t first = random_bits() % length;
        memcpy(kept_state, state, sizeof state);
        memcpy(kept_path, path, sizeof path);
        for (size_t i = first; i < length; i++) {
            cost = play(i, i == first ? changed_sample(i, gaps) : path[i]);
        }
        if (cost >= reached) {
            reached = cost;
        } else {
            memcpy(state, kept_state, sizeof state);
            memcpy(path, kept_path, sizeof path);
        }
    }
    search_corners(length - 1u);
}

static void run_profile(void)
{
    static state_t self;
    uint64_t sum = 0;
    uint32_t largest = 0;
    self = state[0];
    for (size_t k = 0; k < sizeof profile / sizeof *profile; k++) {
        uint32_t cost = count(ENGINE_STEP, &self, profile[k]);
        sum += cost;
        largest = cost > largest ? cost : largest;
    }
    printf("mean: %.6f\nprofile: %lu\n", (double)sum / (sizeof profile / sizeof *profile), (unsigned long)largest);
}

#ifdef BLOCK

typedef uint32_t block_t(state_t *self, const reference_t *reference, uint32_t *codes, uint32_t n);

/* One instruction: bx lr. */
__attribute__((naked, noipa)) static uint32_t empty_block(state_t *self, const reference_t *reference, uint32_t *codes, uint32_t n)
{
    (void)self;
    (void)reference;
    (void)codes;
    (void)n;
    __asm__ volatile("bx lr");
}

__attribute__((noipa)) static uint32_t ticks_of_block(block_t *call, state_t *self, const reference_t *reference, uint32_t *codes)
{
    uint32_t begin = SYST_CVR;
    (void)call(self, reference, codes, BLOCK);
    return (begin - SYST_CVR) & SYST_MAX;
}

/* The profile in blocks that begin at any sample, and the same samples one by one: the codes are the same. */
static bool run_blocks(void)
{
    static state_t single, self;
    const size_t samples = sizeof profile / sizeof *profile, preview = state[0].preview_samples;
    const uint32_t nothing = instructions(ticks_of_block(empty_block, NULL, NULL, NULL));
    uint64_t sum = 0, single_sum = 0, count_of_samples = 0;
    uint32_t largest = 0;
    for (size_t first = preview; first < preview + BLOCK; first++) {
        single = state[0];
        for (size_t k = 0; k < first; k++) {
            (void)ENGINE_STEP(&single, profile[k]);
        }
        self = single;
        for (size_t k = first; k + BLOCK <= samples; k += BLOCK) {
            uint32_t codes[BLOCK];
            uint32_t cost = instructions(ticks_of_block(ENGINE_BLOCK, &self, &profile[k - preview], codes)) - nothing + 1u;
            sum += cost;
            count_of_samples += BLOCK;
            largest = cost > largest ? cost : largest;
            for (size_t i = 0; i < BLOCK; i++) {
                single_sum += count(ENGINE_STEP, &single, profile[k + i]);
                if (codes[i] != single.axis.dac_code) {
                    printf("sample %lu of a block has another code than by itself\n", (unsigned long)(k + i));
                    return false;
                }
            }
        }
    }
    printf("single: %.6f\nmean: %.6f\nworst: %lu\n", (double)single_sum / (double)count_of_samples,
           (double)sum / (double)count_of_samples, (unsigned long)largest);
    return true;
}

#endif

int main(void)
{
    calibrate();
    if (!start(&state[0])) {
        printf("the parameters were refused\n");
        return 1;
    }
#ifdef BLOCK
    return run_blocks() ? 0 : 1;
#endif
    run_profile();
    random_state = SEED;
    search_pairs();
    for (unsigned k = 0; k < CLIMBS; k++) {
        climb(random_bits() % (2u * KINDS), k % 2u != 0u); /* half of them from random paths */
    }
    for (kind_t kind = 0; kind < KINDS; kind++) {
        printf("%s: %lu, from power up:", kind_name[kind], (unsigned long)worst[kind].count);
        for (size_t i = 0; i < worst[kind].length; i++) {
            const sample_t *sample = &worst[kind].path[i];
            if (sample->missed > 0u) {
                printf(" (%u missed)", sample->missed);
            }
            printf(" %.9g", (double)sample->reference);
        }
        printf("\n");
    }
    return 0;
}
