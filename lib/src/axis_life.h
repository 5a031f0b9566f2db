/* The life of an axis: the part of rdpi_f32_axis.c and rdpi_q31_axis.c that is the same for both number types. Before the
 * include, each of them defines
 *
 *   AXIS(name), CHAIN(name)   what its own names and those of its chain begin with, such as rdpi_f32_axis_##name
 *   REQUEST, NUMBER, SPEED    rdpi_f32_request_t; the type of references and drives; the type of a speed
 *   NO_DISPLACEMENT           in place of a displacement
 *   DRIVE                     the field `drive_V` or `drive`, and so on for
 *   AT, TARGET, STEP          the fields of a ramp to a drive, and PER_TIME that of a request
 *
 * and these functions:
 *
 *   drive_is_good, speed_is_good   whether stop and fault take it
 *   own_limits                     what follows from the parameters of the chain, which are new
 *   own_limits_are_sane            whether that can be so still
 *   limit                          sets the slew limit of the chain to that of the ramp, or back
 *   is_reached                     a step towards the reference; whether that limit did not hold it back
 *   begin_ramp, go_on              a ramp to a drive: its fields; one sample of it, true with the last one
 *   put_on_ramp                    a ramp to a drive goes on from the present one
 *   drive_of_code                  the drive of a DAC code; false if the parameters have no such code */
#ifndef RDPI_AXIS_LIFE_H
#define RDPI_AXIS_LIFE_H

#include <stddef.h>

/* What a request asks for. */
enum { START, RESTART, STOP, HAND_OVER, TAKE_BACK, FAULT, EXCHANGE };

/* ---- modes ---- */

/* The drive is held, and the chain follows it. Returns the displacement. */
static NUMBER hold(AXIS(t) *self)
{
    return CHAIN(forward)(&self->chain, self->DRIVE);
}

static void enter(AXIS(t) *self, rdpi_axis_mode_t mode)
{
    self->mode = mode;
    self->to_drive = false;
    limit(self, mode == RDPI_AXIS_RAMP);
}

static void enter_fault(AXIS(t) *self, NUMBER drive)
{
    enter(self, RDPI_AXIS_FAULT);
    self->known = false;
    self->DRIVE = drive;
}

static void enter_sweep(AXIS(t) *self)
{
    if (self->mode == RDPI_AXIS_FAULT) {
        CHAIN(reset)(&self->chain);
    }
    enter(self, RDPI_AXIS_SWEEP);
    (void)hold(self); /* ends a sweep that runs; the new one begins at this drive */
}

static void enter_stop(AXIS(t) *self, NUMBER drive, SPEED speed)
{
    enter(self, RDPI_AXIS_RAMP);
    limit(self, false);
    self->to_drive = true;
    begin_ramp(self, drive, speed);
}

static void exchange(AXIS(t) *self, CHAIN(t) *spare)
{
    limit(self, false);
    self->exchanged = CHAIN(inherit)(spare, &self->chain);
    if (self->exchanged == RDPI_OK) {
        self->chain = *spare;
        own_limits(self);
        self->DRIVE = self->chain.axis.DRIVE; /* the same in the units of the new parameters, which may be others */
        if (self->mode == RDPI_AXIS_RUN) { /* the new parameters ask for another drive */
            self->mode = RDPI_AXIS_RAMP;
        }
    }
    limit(self, self->mode == RDPI_AXIS_RAMP);
}

/* Whether the axis takes this call in its mode. */
static bool takes(const AXIS(t) *self, uint8_t call)
{
    if (!self->sane || ((call == RESTART || call == TAKE_BACK) && !self->known)) {
        return false;
    }
    switch (self->mode) {
    case RDPI_AXIS_STOPPED:
        return call != TAKE_BACK;
    case RDPI_AXIS_SWEEP:
        return call == START || call == STOP || call == HAND_OVER || call == FAULT;
    case RDPI_AXIS_RAMP:
    case RDPI_AXIS_RUN:
        return call != RESTART && call != TAKE_BACK && !(call == EXCHANGE && self->to_drive);
    case RDPI_AXIS_MANUAL:
        return call != START && call != RESTART;
    case RDPI_AXIS_FAULT:
        return call == START || call == STOP || call == HAND_OVER || call == FAULT;
    default:
        return false;
    }
}

/* A call that this mode does not take, in place of a sample: the drive is held, and no play moves. Returns the
 * displacement where the chain follows the held drive. */
static NUMBER refuse(AXIS(t) *self)
{
    if (self->mode == RDPI_AXIS_SWEEP) {
        CHAIN(missed)(&self->chain, 1); /* it goes on where it was */
    } else if (self->mode == RDPI_AXIS_RUN || (self->mode == RDPI_AXIS_RAMP && !self->to_drive)) {
        (void)CHAIN(step)(&self->chain, NO_DISPLACEMENT); /* as a reference that cannot be used */
    } else {
        return hold(self);
    }
    return NO_DISPLACEMENT;
}

/* What has been asked for since the sample before. */
static void obey(AXIS(t) *self)
{
    const uint8_t posted = self->posted;
    if (posted == self->taken) {
        return;
    }
    self->taken = posted;
    const volatile REQUEST *request = &self->request[posted % 2u];
    const uint8_t call = request->call;
    if (!takes(self, call)) {
        return;
    }
    switch (call) {
    case START:
        enter_sweep(self);
        break;
    case RESTART:
    case TAKE_BACK:
        enter(self, RDPI_AXIS_RAMP);
        break;
    case STOP:
        enter_stop(self, request->DRIVE, request->PER_TIME);
        break;
    case HAND_OVER:
        enter(self, RDPI_AXIS_MANUAL);
        break;
    case FAULT:
        enter_fault(self, request->DRIVE);
        break;
    default: {
        CHAIN(t) *spare = request->spare;
        exchange(self, spare);
        break;
    }
    }
}

/* The drive of the chain is that of the axis. */
static NUMBER publish(AXIS(t) *self)
{
    self->flags = self->chain.axis.flags;
    self->DRIVE = self->chain.axis.DRIVE;
    self->dac_code = self->chain.axis.dac_code;
    return self->DRIVE;
}

/* After init has accepted the parameters: it begins, at the drive that is output. */
static rdpi_status_t accept(AXIS(t) *self, NUMBER drive)
{
    if (!drive_is_good(self, drive)) {
        return RDPI_ERR_MEMORY;
    }
    self->exchanged = RDPI_OK;
    self->taken = self->posted;
    self->sane = true;
    self->known = true;
    self->DRIVE = drive;
    enter(self, RDPI_AXIS_STOPPED);
    (void)hold(self);
    (void)publish(self);
    return RDPI_OK;
}

/* Plays and poles are made anew at the drive that is output. Where that does not repair the state, nothing of the chain
 * is used any more: its indices may lead anywhere. */
static void repair(AXIS(t) *self)
{
    CHAIN(t) *chain = &self->chain;
    self->mode = RDPI_AXIS_FAULT;
    self->known = false;
    self->to_drive = false;
    if (chain->params != NULL && chain->params->schema == RDPI_PARAMS_SCHEMA && chain->params->axis != NULL &&
        chain->axis.params != NULL) {
        chain->axis.params = chain->params->axis;
        limit(self, false);
        own_limits(self);
        CHAIN(reset)(chain);
        self->sane = CHAIN(is_sane)(chain);
    }
}

/* A damaged state and requests, before a sample. Returns whether the chain can be used in it. */
static bool prepare(AXIS(t) *self)
{
    if (self->mode == RDPI_AXIS_OFF) {
        return false;
    }
    if (!self->sane) {
        repair(self);
    }
    obey(self);
    return self->sane;
}

NUMBER AXIS(step)(AXIS(t) *self, NUMBER ahead)
{
    if (!prepare(self)) {
        return self->DRIVE;
    }
    if (self->mode == RDPI_AXIS_RUN) {
        (void)CHAIN(step)(&self->chain, ahead);
    } else if (self->mode == RDPI_AXIS_SWEEP) {
        if (!CHAIN(sweep)(&self->chain)) {
            self->known = true;
            enter(self, RDPI_AXIS_RAMP);
        }
    } else if (self->mode != RDPI_AXIS_RAMP) {
        (void)hold(self);
    } else if (self->to_drive) {
        if (go_on(self)) {
            enter(self, RDPI_AXIS_STOPPED);
        }
    } else if (is_reached(self, ahead)) {
        enter(self, RDPI_AXIS_RUN);
    } else {
        /* still on the way */
    }
    return publish(self);
}

uint32_t AXIS(block)(AXIS(t) *self, const NUMBER *reference, uint32_t *codes, uint32_t n)
{
    uint32_t followed = 0, flags = 0;
    if (self == NULL) {
        return 0;
    }
    if (reference == NULL || codes == NULL) {
        self->flags = RDPI_FLAG_INPUT;
        return 0;
    }
    const uint32_t end = n + self->chain.preview_samples;
    for (uint32_t k = 0; k < n; k++) {
        uint32_t ahead = followed + self->chain.preview_samples; /* after an exchange, those of other parameters */
        (void)AXIS(step)(self, reference[ahead < end ? ahead : end - 1u]);
        codes[k] = self->dac_code;
        flags |= self->flags;
        followed += self->mode == RDPI_AXIS_RUN ? 1u : 0u;
    }
    self->flags = flags;
    return followed;
}

void AXIS(missed)(AXIS(t) *self, uint32_t ticks)
{
    if (self->mode != RDPI_AXIS_OFF && self->sane) {
        CHAIN(missed)(&self->chain, ticks);
    }
}

NUMBER AXIS(follow)(AXIS(t) *self, NUMBER drive)
{
    if (!prepare(self)) {
        self->flags = RDPI_FLAG_INPUT;
        return NO_DISPLACEMENT;
    }
    bool manual = self->mode == RDPI_AXIS_MANUAL;
    NUMBER displacement = manual ? CHAIN(forward)(&self->chain, drive) : refuse(self);
    (void)publish(self);
    self->flags |= manual ? 0u : RDPI_FLAG_INPUT;
    return displacement;
}

/* Where the drive that has been output leads on from, in each mode. */
static void resume(AXIS(t) *self, NUMBER before)
{
    switch (self->mode) {
    case RDPI_AXIS_STOPPED:
        enter_stop(self, before, 0); /* back to where it has stopped */
        break;
    case RDPI_AXIS_RAMP:
        if (self->to_drive) {
            put_on_ramp(self);
        } else {
            limit(self, false); /* the ramp begins anew */
            enter(self, RDPI_AXIS_RAMP);
        }
        break;
    case RDPI_AXIS_RUN:
        enter(self, RDPI_AXIS_RAMP);
        break;
    default: /* a sweep begins anew; MANUAL and FAULT hold the drive */
        break;
    }
}

NUMBER AXIS(replayed)(AXIS(t) *self, uint32_t dac_code)
{
    NUMBER drive = 0;
    if (!prepare(self)) {
        self->flags = RDPI_FLAG_INPUT;
        return NO_DISPLACEMENT;
    }
    const NUMBER before = self->DRIVE;
    const bool good = drive_of_code(self->chain.params->axis, dac_code, &drive);
    const NUMBER displacement = good ? CHAIN(forward)(&self->chain, drive) : refuse(self);
    (void)publish(self);
    if (good) {
        self->DRIVE = drive; /* in FAULT, too */
        self->dac_code = dac_code;
        resume(self, before);
    } else {
        self->flags |= RDPI_FLAG_INPUT;
    }
    return displacement;
}

/* ---- requests ---- */

/* A request that no sample has obeyed yet gives way to one that matters as much or more: nothing takes back a fault, and no
 * start a stop. */
static int rank(uint8_t call)
{
    return call == FAULT ? 3 : (call == STOP ? 2 : (call == HAND_OVER ? 1 : 0));
}

static bool gives_way(const AXIS(t) *self, uint8_t call)
{
    const uint8_t posted = self->posted;
    return posted == self->taken || rank(call) >= rank(self->request[posted % 2u].call);
}

/* For the next sample. The request that a sample may be reading is the other one. */
static rdpi_status_t post(AXIS(t) *self, uint8_t call, NUMBER drive, SPEED speed, CHAIN(t) *spare)
{
    if (self == NULL) {
        return RDPI_ERR_NULL;
    }
    if (!takes(self, call) || !gives_way(self, call)) {
        return RDPI_ERR_MODE;
    }
    uint8_t next = (uint8_t)(self->posted + 1u);
    if (next == self->taken) { /* 256 of them, and no sample: it must not look obeyed */
        next = (uint8_t)(next + 2u);
    }
    volatile REQUEST *request = &self->request[next % 2u];
    request->call = call;
    request->DRIVE = drive;
    request->PER_TIME = speed;
    request->spare = spare;
    if (call == EXCHANGE) {
        self->exchanged = RDPI_ERR_MODE; /* until a sample has obeyed: another request may take its place */
    }
    self->posted = next;
    return RDPI_OK;
}

rdpi_status_t AXIS(start)(AXIS(t) *self)
{
    return post(self, START, 0, 0, NULL);
}

rdpi_status_t AXIS(restart)(AXIS(t) *self)
{
    return post(self, RESTART, 0, 0, NULL);
}

rdpi_status_t AXIS(stop)(AXIS(t) *self, NUMBER drive, SPEED speed)
{
    if (self != NULL && takes(self, STOP)) {
        if (!drive_is_good(self, drive)) {
            return RDPI_ERR_MEMORY;
        }
        if (!speed_is_good(self, speed)) {
            return RDPI_ERR_RATE;
        }
    }
    return post(self, STOP, drive, speed, NULL);
}

rdpi_status_t AXIS(hand_over)(AXIS(t) *self)
{
    return post(self, HAND_OVER, 0, 0, NULL);
}

rdpi_status_t AXIS(take_back)(AXIS(t) *self)
{
    return post(self, TAKE_BACK, 0, 0, NULL);
}

rdpi_status_t AXIS(fault)(AXIS(t) *self, NUMBER drive)
{
    if (self != NULL && takes(self, FAULT) && !drive_is_good(self, drive)) {
        return RDPI_ERR_MEMORY;
    }
    return post(self, FAULT, drive, 0, NULL);
}

rdpi_status_t AXIS(exchange)(AXIS(t) *self, CHAIN(t) *spare)
{
    return spare == NULL ? RDPI_ERR_NULL : post(self, EXCHANGE, 0, 0, spare);
}

bool AXIS(check)(AXIS(t) *self)
{
    if (self == NULL) {
        return false;
    }
    if (self->mode == RDPI_AXIS_OFF) {
        return false;
    }
    bool sane = false;
    for (unsigned looks = 0; looks < 2u && !sane; looks++) { /* a sample in between makes the first one of two moments */
        sane = self->mode <= RDPI_AXIS_FAULT && CHAIN(is_sane)(&self->chain) && own_limits_are_sane(self);
    }
    if (!sane) {
        self->sane = false;
    }
    return self->sane;
}

#endif
