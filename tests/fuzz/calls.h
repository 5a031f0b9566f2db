/* Any order of calls, with what the manual promises checked after each. Written once for both libraries: f32.h and
 * q31.h say what their types, fields and numbers are called, then include this. */
#ifndef CALLS_H
#define CALLS_H

#define ALL_FLAGS (RDPI_FLAG_GUARD | RDPI_FLAG_RANGE | RDPI_FLAG_SLEW | RDPI_FLAG_INPUT | RDPI_FLAG_MISSED)

/* What holds after every call. */
static void check_state(const axis_t *self)
{
    const params_t *params = self->params;
    CHECK(self->DRIVE >= params->MIN_DRIVE && self->DRIVE <= params->MAX_DRIVE);
    CHECK(self->RATE >= 0 && self->RATE <= guard_of(params));
    CHECK(params->dac_bits > 0 ? self->dac_code < 1u << params->dac_bits : self->dac_code == 0);
    CHECK((self->flags & ~(uint32_t)ALL_FLAGS) == 0);
}

/* The manual counts steps by their flags. */
static void check_counts(const axis_t *before, const axis_t *after)
{
    CHECK(after->guard_count == before->guard_count + ((after->flags & RDPI_FLAG_GUARD) != 0));
    CHECK(after->clip_count == before->clip_count + ((after->flags & (RDPI_FLAG_RANGE | RDPI_FLAG_SLEW)) != 0));
    CHECK(after->input_count == before->input_count + ((after->flags & RDPI_FLAG_INPUT) != 0));
    CHECK(after->missed_count == before->missed_count);
}

/* The output, and what the actuator remembers, are the same. */
static void check_held(const axis_t *before, const axis_t *after)
{
    number_t of_before[RDPI_MAX_PLAYS], of_after[RDPI_MAX_PLAYS];
    CHECK(after->DRIVE == before->DRIVE && after->dac_code == before->dac_code);
    rdpi(get_memory)(before, of_before);
    rdpi(get_memory)(after, of_after);
    CHECK(memcmp(of_before, of_after, before->params->plays * sizeof *of_before) == 0);
}

static void do_step(axis_t *self, number_t reference)
{
    axis_t before = *self;
    number_t drive = rdpi(step)(self, reference);
    CHECK(drive == self->DRIVE);
    check_counts(&before, self);
    CHECK((self->flags == RDPI_FLAG_INPUT) == !usable_reference(reference));
    if (!usable_reference(reference)) {
        check_held(&before, self);
    }
}

static void do_missed(axis_t *self, uint32_t ticks)
{
    axis_t before = *self;
    rdpi(missed)(self, ticks);
    CHECK(self->missed_count >= before.missed_count && self->missed_count - before.missed_count <= ticks);
    check_held(&before, self);
}

static void do_sweep(axis_t *self, unsigned samples)
{
    bool more = true;
    for (; more && samples > 0; samples--) {
        axis_t before = *self;
        more = rdpi(sweep)(self);
        check_counts(&before, self);
        check_state(self);
    }
    if (!more) {
        rdpi(forget_sweep)(self);
        check_state(self);
    }
}

static void do_predict(const axis_t *self, number_t drive, number_t rate)
{
    axis_t before = *self;
    number_t displacement = rdpi(predict)(self, drive, rate);
    CHECK(memcmp(&before, self, sizeof before) == 0);
    if (!usable_drive(drive, rate)) {
        CHECK(is_nothing(displacement));
    } else if (drive >= self->params->MIN_DRIVE && drive <= self->params->MAX_DRIVE) {
        CHECK(is_finite(displacement));
    }
}

static void do_forward(axis_t *self, number_t drive, number_t rate)
{
    axis_t before = *self;
    number_t predicted = rdpi(predict)(self, drive, rate);
    number_t displacement = rdpi(forward)(self, drive, rate);
    CHECK(is_finite(displacement));
    check_counts(&before, self);
    if (self->flags & RDPI_FLAG_INPUT) {
        check_held(&before, self);
    } else {
        CHECK(usable_drive(drive, rate) && displacement == predicted);
    }
}

/* What get_memory gives is taken back, bit for bit, unless forward has left it outside the range. */
static void do_memory(axis_t *self)
{
    number_t y[RDPI_MAX_PLAYS], after[RDPI_MAX_PLAYS];
    axis_t before = *self;
    rdpi(get_memory)(self, y);
    CHECK(memcmp(&before, self, sizeof before) == 0);
    if (inside_range(self->params, y[0])) {
        CHECK(rdpi(set_memory)(self, y) == RDPI_OK);
        rdpi(get_memory)(self, after);
        CHECK(memcmp(y, after, self->params->plays * sizeof *y) == 0);
    }
}

/* Any memory is taken as it is or refused without a trace. */
static void do_any_memory(axis_t *self)
{
    number_t y[RDPI_MAX_PLAYS], after[RDPI_MAX_PLAYS];
    axis_t before = *self;
    rdpi(get_memory)(self, y);
    for (size_t i = 0; i < self->params->plays; i++) {
        uint8_t how = take_u8();
        if (how % 4 == 0) {
            y[i] = take_any();
        } else if (how % 4 == 1) {
            y[i] = (number_t)((double)y[i] + take_between(-1, 1) * (double)self->params->play[i].THRESHOLD);
        }
    }
    if (rdpi(set_memory)(self, y) == RDPI_OK) {
        rdpi(get_memory)(self, after);
        CHECK(memcmp(y, after, self->params->plays * sizeof *y) == 0);
    } else {
        CHECK(memcmp(&before, self, sizeof before) == 0);
    }
}

static void do_reset(axis_t *self)
{
    number_t y[RDPI_MAX_PLAYS];
    rdpi(reset)(self);
    rdpi(get_memory)(self, y);
    CHECK(memcmp(y, self->params->MEMORY, self->params->plays * sizeof *y) == 0);
    CHECK(self->flags == 0 && self->RATE == 0);
    CHECK(self->guard_count == 0 && self->clip_count == 0 && self->input_count == 0 && self->missed_count == 0);
}

static number_t any_or_between(double low, double high)
{
    return take_u8() % 8 == 0 ? take_any() : (number_t)take_between(low, high);
}

/* A little more than the range, so that clips are frequent but not the rule. */
static number_t take_drive(const params_t *params)
{
    double low = (double)params->MIN_DRIVE, high = (double)params->MAX_DRIVE, margin = (high - low) / 8;
    return any_or_between(fmax(low - margin, LOWEST_DRIVE), fmin(high + margin, -LOWEST_DRIVE));
}

/* Calls in the order that the rest of the input gives; references mostly within `low` .. `high`. */
static void call_everything(axis_t *self, double low, double high)
{
    check_state(self);
    for (unsigned calls = 0; input_left > 0 && calls < 400; calls++) {
        uint8_t what = take_u8();
        switch (what % 16) {
        case 0:
            do_missed(self, what < 128 ? what / 16 : take_u32());
            break;
        case 1:
            do_sweep(self, 1u + what);
            break;
        case 2: {
            number_t drive = take_drive(self->params);
            do_predict(self, drive, any_or_between(0, (double)guard_of(self->params)));
            break;
        }
        case 3: {
            number_t drive = take_drive(self->params);
            do_forward(self, drive, any_or_between(0, (double)guard_of(self->params)));
            break;
        }
        case 4:
            do_memory(self);
            break;
        case 5:
            do_any_memory(self);
            break;
        case 6:
            if (what >= 128) {
                do_reset(self);
            }
            break;
        case 7:
            do_step(self, take_any());
            break;
        default:
            do_step(self, (number_t)take_between(low, high));
        }
        check_state(self);
    }
}

#endif
