/* Random sequences of all calls of an axis' life, for tests/property/axis_life.c and axis_life_q31.c, which define for
 * their library
 *
 *   AXIS(name), CHAIN(name), axis   rdpi_f32_axis_##name, rdpi_f32_chain_##name, the axis
 *   drive_now()        axis' drive, in units in which the range is `range` wide
 *   next_axis()        another random actuator and chain: init accepts it. Sets what follows
 *   next_spare()       the same actuator, identified again: a chain for the exchange
 *   sample(), follow(), stop(), fault(), replay()   a call with random arguments; all but the first return the drive that
 *                      they ask for, or report
 *   h_now(), pole_now(i)   displacement of the operator, and the state of a pole
 *
 * What must hold: no drive is outside the range. No drive goes further in a sample than the slew limit, or in SWEEP and
 * RAMP than the speed of the sweep or of the stop. The poles of creep follow the displacement, whoever drives, but where
 * the manual says that creep is made anew. Each mode is reached and left. */
#ifndef RDPI_TEST_AXIS_WALK_H
#define RDPI_TEST_AXIS_WALK_H

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

#define MODES 7
#define POLES 4 /* at most, and none so slow that it takes turns */

static struct {
    double low, high;                /* of the drive */
    double code, slew, sweep;        /* how far codes are apart; limits per sample, 0: none */
    double rounding, h_rounding;     /* of drives and of displacements */
    size_t poles;
    double keep[POLES];              /* share of its distance that a pole keeps in a sample */
    bool moves_later;                /* a pole moves to a sample with the next one */
} now;

static struct {
    double pole[POLES], h;
    bool known;
} creep;

static long steps, entered[MODES], left[MODES], exchanged;
static double stop_step; /* of the latest stop, per sample */

static void require(bool holds, const char *what)
{
    if (!holds) {
        printf("axis_life: step %ld, mode %d, flags %u: %s\n", steps, (int)axis.mode, (unsigned)axis.flags, what);
        exit(1);
    }
}

static void creep_as_it_is(void)
{
    for (size_t i = 0; i < now.poles; i++) {
        creep.pole[i] = pole_now(i);
    }
    creep.h = h_now();
    creep.known = true;
}

/* The poles move `samples` samples towards h. */
static void creep_moves(double h, double samples)
{
    for (size_t i = 0; i < now.poles; i++) {
        creep.pole[i] = h + (creep.pole[i] - h) * pow(now.keep[i], samples);
    }
}

static void check_creep(void)
{
    double h = h_now();
    creep_moves(now.moves_later ? creep.h : h, 1);
    creep.h = h;
    for (size_t i = 0; i < now.poles; i++) {
        require(fabs(creep.pole[i] - pole_now(i)) <= now.h_rounding, "creep jumps");
        creep.pole[i] = pole_now(i); /* no rounding adds up */
    }
}

/* How far the drive may have gone in this sample. */
static double most(rdpi_axis_mode_t before, bool obeys)
{
    double rounding = now.rounding + now.code, slew = now.slew > 0 ? now.slew : INFINITY;
    if (axis.mode == RDPI_AXIS_RUN && before == RDPI_AXIS_RUN) {
        return slew + rounding;
    }
    if ((axis.mode == RDPI_AXIS_RAMP && axis.to_drive) ||
        (axis.mode == RDPI_AXIS_STOPPED && (before != RDPI_AXIS_STOPPED || obeys))) {
        return stop_step + rounding;
    }
    if (axis.mode == RDPI_AXIS_SWEEP || axis.mode == RDPI_AXIS_RAMP || axis.mode == RDPI_AXIS_RUN) {
        return now.sweep + rounding;
    }
    return now.rounding;
}

/* One sample in which the axis itself drives. */
static void one_sample(double given)
{
    rdpi_axis_mode_t before = axis.mode;
    double was = drive_now();
    bool obeys = AXIS(pending)(&axis);
    sample();
    steps++;
    double is = drive_now();
    require(is >= now.low && is <= now.high, "outside the range");
    if (axis.mode == RDPI_AXIS_FAULT && obeys) {
        require(fabs(is - given) <= now.rounding, "the drive of the fault is not taken");
    } else {
        require(fabs(is - was) <= most(before, obeys), "too large a step");
    }
    if (axis.mode != before) {
        left[before]++;
        entered[axis.mode]++;
    }
    bool made_anew = axis.mode == RDPI_AXIS_SWEEP || axis.mode == RDPI_AXIS_FAULT || before == RDPI_AXIS_FAULT ||
                     before == RDPI_AXIS_SWEEP;
    if (made_anew || !creep.known) {
        creep_as_it_is();
    } else {
        check_creep();
    }
}

static void manual_sample(void)
{
    rdpi_axis_mode_t before = axis.mode;
    double asked = follow(), is = drive_now();
    steps++;
    if (axis.mode == RDPI_AXIS_MANUAL) {
        require(fabs(is - asked) <= now.rounding, "another drive than the one that was followed");
    }
    if (axis.mode != before) {
        left[before]++;
        entered[axis.mode]++;
    }
    if (axis.mode == before && creep.known && before == RDPI_AXIS_MANUAL) {
        check_creep();
    } else {
        creep_as_it_is();
    }
}

/* A DMA has output any code. */
static void replayed_sample(void)
{
    rdpi_axis_mode_t before = axis.mode;
    double asked = replay();
    steps++;
    require(fabs(drive_now() - asked) <= now.rounding, "another drive than that of the code");
    require(axis.mode == before || axis.mode == RDPI_AXIS_RAMP, "a code that is output again leads to another mode");
    if (axis.mode != before) {
        left[before]++;
        entered[axis.mode]++;
        stop_step = before == RDPI_AXIS_STOPPED ? now.sweep : stop_step; /* back, as fast as the sweep */
    }
    if (before == RDPI_AXIS_SWEEP || before == RDPI_AXIS_FAULT || !creep.known) {
        creep_as_it_is();
    } else {
        check_creep();
    }
}

static void some_call(void)
{
    rdpi_axis_mode_t mode = axis.mode;
    double given = drive_now();
    bool off = mode == RDPI_AXIS_OFF, known = axis.known; /* no fault since the latest sweep */
    switch (choose(9)) {
    case 0:
        (void)AXIS(start)(&axis);
        break;
    case 1:
        require((AXIS(restart)(&axis) == RDPI_OK) == (mode == RDPI_AXIS_STOPPED && known), "restart");
        break;
    case 2:
        (void)stop();
        break;
    case 3:
        require((AXIS(hand_over)(&axis) == RDPI_OK) == !off, "hand_over");
        break;
    case 4:
        require((AXIS(take_back)(&axis) == RDPI_OK) == (mode == RDPI_AXIS_MANUAL && known),
                "take_back");
        break;
    case 5:
        given = choose(8) == 0 ? fault() : given;
        break;
    case 6: {
        uint32_t ticks = (uint32_t)choose(30);
        AXIS(missed)(&axis, ticks);
        if (creep.known) {
            creep_moves(creep.h, ticks);
        }
        break;
    }
    case 7:
        require(AXIS(check)(&axis), "a sane state is called damaged");
        break;
    default:
        if (mode == RDPI_AXIS_RUN || mode == RDPI_AXIS_STOPPED) {
            double was = drive_now();
            require(AXIS(exchange)(&axis, next_spare()) == RDPI_OK, "exchange");
            creep.known = false; /* other poles */
            one_sample(given);
            require(!AXIS(pending)(&axis) && axis.exchanged == RDPI_OK, "the exchange is refused");
            require(mode != RDPI_AXIS_STOPPED || fabs(drive_now() - was) <= now.rounding, "the exchange moves the drive");
            exchanged++;
        }
        return;
    }
    one_sample(given);
}

static void walk(long at_least)
{
    while (steps < at_least) {
        next_axis();
        creep.known = false;
        for (int calls = 0; calls < 60; calls++) {
            if (choose(6) == 0 && AXIS(start)(&axis) == RDPI_OK) { /* most other calls interrupt a sweep */
                for (int k = 0; k < 3000 && axis.mode != RDPI_AXIS_RUN; k++) {
                    one_sample(drive_now());
                }
            }
            some_call();
            for (int k = choose(120); k > 0; k--) {
                if (now.code > 0 && !AXIS(pending)(&axis) && choose(300) == 0) {
                    replayed_sample();
                } else if (axis.mode == RDPI_AXIS_MANUAL) {
                    manual_sample();
                } else {
                    one_sample(drive_now());
                }
            }
        }
    }
    for (int mode = RDPI_AXIS_STOPPED; mode < MODES; mode++) {
        printf("mode %d: entered %ld times, left %ld times\n", mode, entered[mode], left[mode]);
        require(entered[mode] > 0 && left[mode] > 0, "a mode is not reached, or not left");
    }
    printf("%ld steps, %ld exchanges of parameters\n", steps, exchanged);
    require(exchanged > 0, "no exchange");
}

#endif
