// Every path that the float library can take, whatever its numbers are: lib/src/rdpi_f32.c as it is, compiled with a
// number type whose comparisons go both ways. What is known of a number is used: constants, and that finite numbers lie
// between the infinities. So the set of paths is a superset of the real ones, and it is finite: it is walked from every
// index state that the bank can have, and every state at the end must be one of these again. AddressSanitizer watches
// the arrays, which are exactly as long as the parameters say.
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <type_traits>
#include <vector>

static std::vector<bool> way;     // what was chosen on the path so far
static std::size_t chosen;        // how many of these the present run has taken again
static unsigned long long paths;
static unsigned long long asked; // see operator<

static bool choose()
{
    if (chosen == way.size()) {
        way.push_back(false);
    }
    return way[chosen++];
}

// To the next path; false after the last.
static bool next_path()
{
    paths++;
    asked = 0;
    way.resize(chosen);
    chosen = 0;
    while (!way.empty() && way.back()) {
        way.pop_back();
    }
    if (way.empty()) {
        return false;
    }
    way.back() = true;
    return true;
}

struct Number {
    enum Kind : std::uint8_t { Known, Finite, Any, Beyond } kind = Finite;
    double value = 0;
    unsigned long long id = ++ids; // copies share it

    static unsigned long long ids;
    Number() = default;
    template <class T, class = std::enable_if_t<std::is_arithmetic<T>::value>> Number(T known) : kind(Known), value(known) {}
    Number(std::uint32_t) {} // a code
    Number(Kind k, double v) : kind(k), value(v) {}
    template <class T, class = std::enable_if_t<std::is_arithmetic<T>::value>> explicit operator T() const
    {
        return kind == Known ? T(value) : T((sizeof(T) == 2) + choose()); // 16 bits has the window, 1 or 2 samples
    }
    Number operator-() const { return {used().kind, -value}; }
    const Number &used() const
    {
        if (kind == Beyond) { // references to what is one behind an array's end are no matter of the sanitizer
            std::printf("f32_paths: a number beyond the end of an array is used\n");
            std::exit(1);
        }
        return *this;
    }
    bool nan() const { return kind == Known && std::isnan(value); }
    bool infinite() const { return kind == Known && std::isinf(value); }
};

unsigned long long Number::ids = 0;

static Number either(Number a, Number b, double known)
{
    if (a.used().nan() || b.used().nan()) {
        return NAN;
    }
    if (a.kind == Number::Known && b.kind == Number::Known) {
        return known;
    }
    bool any = a.kind == Number::Any || b.kind == Number::Any || a.infinite() || b.infinite();
    return {any ? Number::Any : Number::Finite, 0};
}
static Number operator+(Number a, Number b)
{
    if (a.infinite() && b.kind == Number::Finite) {
        return a;
    }
    return b.infinite() && a.kind == Number::Finite ? b : either(a, b, a.value + b.value);
}
static Number operator-(Number a, Number b) { return a + -b; }
static Number operator*(Number a, Number b) { return either(a, b, a.value * b.value); }
static Number operator/(Number a, Number b) { return either(a, b, a.value / b.value); }
static Number &operator+=(Number &a, Number b) { return a = a + b; }
static Number &operator-=(Number &a, Number b) { return a = a - b; }
static Number &operator*=(Number &a, Number b) { return a = a * b; }
static Number &operator/=(Number &a, Number b) { return a = a / b; }

// Whether a comparison has one outcome only; what is no more than finite has the value 0.
static bool settled(Number a, Number b)
{
    if (a.used().nan() || b.used().nan()) {
        return true;
    }
    return a.kind != Number::Any && b.kind != Number::Any &&
           ((a.kind == Number::Known && b.kind == Number::Known) || a.infinite() || b.infinite());
}
// A number asked twice in a row whether it is above 0 says the same.
static bool answer;
static bool operator<(Number a, Number b)
{
    if (settled(a, b)) {
        return a.value < b.value;
    }
    if (a.kind != Number::Known || a.value != 0) {
        return choose();
    }
    if (asked != b.id) {
        asked = b.id;
        answer = choose();
    }
    return answer;
}
static bool operator>(Number a, Number b) { return b < a; }
static bool operator<=(Number a, Number b) { return settled(a, b) ? a.value <= b.value : choose(); }
static bool operator>=(Number a, Number b) { return b <= a; }
static bool operator==(Number a, Number b) { return settled(a, b) ? a.value == b.value : choose(); }
static bool operator!=(Number a, Number b) { return !(a == b); }
static Number fabs(Number a) { return {a.used().kind, std::fabs(a.value)}; }
static bool isfinite(Number a) { return a.kind == Number::Any ? choose() : std::isfinite(a.value); }

#define RDPI_REAL Number
#ifndef PLAYS
#define PLAYS 2
#endif
#define WINDOW 2
#define RDPI_MAX_PLAYS (PLAYS + 1) // what is behind those used is Number::Beyond
#define RDPI_MAX_WINDOW (WINDOW + 1)
#define RDPI_MAX_DEADZONES 2
#define RDPI_CRC_H // says nothing of the paths
static std::uint32_t rdpi_crc32(std::uint32_t crc, std::uint32_t) { return crc; }
static std::uint32_t rdpi_crc32_wide(std::uint32_t crc, std::uint64_t) { return crc; }
#include "rdpi_f32.c"

static void check(bool holds, const char *function, const char *what, unsigned plays, unsigned engaged)
{
    if (!holds) {
        std::printf("f32_paths: after %s with %u plays, %u engaged: %s\n", function, plays, engaged, what);
        std::exit(1);
    }
}

struct Actuator {
    std::unique_ptr<rdpi_f32_play_t[]> play;
    std::unique_ptr<rdpi_f32_deadzone_t[]> saturation;
    std::unique_ptr<rdpi_f32_piece_t[]> inverse;
    std::unique_ptr<rdpi_f32_line_t[]> curve; // as many pieces as S^-1 has
    std::unique_ptr<Number[]> memory;
    rdpi_f32_params_t params{};

    explicit Actuator(unsigned plays, unsigned deadzones)
        : play(new rdpi_f32_play_t[plays]), saturation(new rdpi_f32_deadzone_t[deadzones]),
          inverse(new rdpi_f32_piece_t[deadzones]), curve(new rdpi_f32_line_t[deadzones]), memory(new Number[plays])
    {
        params.plays = static_cast<std::uint16_t>(plays);
        params.deadzones = static_cast<std::uint8_t>(deadzones);
        params.curve_pieces = static_cast<std::uint8_t>(RDPI_MAX_CURVE_PIECES > 1 ? deadzones : 1);
        params.sweep_cycles = 2;
        params.play = play.get();
        params.saturation = saturation.get();
        params.inverse_saturation = inverse.get();
        params.curve = curve.get();
        params.memory_um = memory.get();
    }
};

static unsigned states(unsigned plays) { return plays > 1 ? plays : 2; } // one play alone uses y_1 for its own ends

// What holds of every instance between two calls.
static void check_state(const rdpi_f32_t &self, const char *function, unsigned engaged)
{
    const rdpi_f32_params_t *params = self.params;
    unsigned plays = params->plays;
    check(self.bank.engaged < plays, function, "engaged is beyond the plays", plays, engaged);
    check(self.bank.last_engaged == params->play + self.bank.engaged, function,
          "last_engaged is not play[engaged]", plays, engaged);
    const rdpi_f32_rate_t &rate = self.rate_estimator;
    check(rate.oldest <= rate.window, function, "oldest is beyond the window", plays, engaged);
    if (RDPI_QUICK_STEP && self.quick) {
        check(rate.window == 1 && rate.oldest == 0, function, "quick without a sample", plays, engaged);
        check(params->dac_bits > 0, function, "quick without codes", plays, engaged);
        const rdpi_f32_piece_t *first = params->inverse_saturation;
        check(self.latest_piece >= first && self.latest_piece < first + params->deadzones, function,
              "quick without a piece", plays, engaged);
#if RDPI_MAX_CURVE_PIECES > 1
        check(self.line >= params->curve && self.line < params->curve + params->curve_pieces, function,
              "quick without a piece of the input curve", plays, engaged);
#endif
    }
    for (unsigned i = 0; i < plays; i++) { // or the search for the last play engaged might not end
        const Number &y = self.bank.y_um[i];
        check((i > 0 && i <= self.bank.engaged) || y.kind == Number::Finite || (y.kind == Number::Known && !y.infinite()),
              function, "a state may be infinite", plays, engaged);
    }
}

static void check_ends(const rdpi_f32_t &self, const char *function, unsigned engaged)
{
    const unsigned plays = self.params->plays;
    for (unsigned i = states(plays); i < RDPI_MAX_PLAYS; i++) {
        check(self.bank.y_um[i].kind == Number::Beyond, function, "a state beyond the plays is written", plays, engaged);
    }
    for (unsigned k = self.rate_estimator.window; k < RDPI_MAX_WINDOW; k++) {
        check(self.rate_estimator.z_um[k].kind == Number::Beyond, function, "a sample beyond the window is written",
              plays, engaged);
    }
}

// Between two calls, whatever the numbers.
struct State {
    unsigned engaged, window, oldest, missed, turns, piece;
    bool falling, quick;
};

static rdpi_f32_t instance(const Actuator &actuator, const State &state)
{
    rdpi_f32_t self{};
    self.params = &actuator.params;
    self.latest_piece = actuator.params.inverse_saturation + state.piece;
#if RDPI_MAX_CURVE_PIECES > 1
    self.line = actuator.params.curve + state.piece;
#endif
    self.sweep_turns = static_cast<std::uint16_t>(state.turns);
    self.missed = static_cast<std::uint8_t>(state.missed);
    self.quick = state.quick;
    self.rate_estimator.window = static_cast<std::uint16_t>(state.window);
    self.rate_estimator.oldest = static_cast<std::uint16_t>(state.oldest);
    self.bank.last_engaged = actuator.params.play + state.engaged;
    self.bank.engaged = static_cast<std::uint16_t>(state.engaged);
    self.bank.falling = state.falling;
    for (unsigned i = 1; i <= state.engaged; i++) {
        self.bank.y_um[i] = Number(Number::Any, 0); // implied by x: stale, or infinite
    }
    for (unsigned i = states(actuator.params.plays); i < RDPI_MAX_PLAYS; i++) {
        self.bank.y_um[i] = Number(Number::Beyond, 0);
    }
    for (unsigned k = state.window; k < RDPI_MAX_WINDOW; k++) {
        self.rate_estimator.z_um[k] = Number(Number::Beyond, 0);
    }
    return self;
}

template <class Call> static void walk_all(const char *name, const Actuator &actuator, const State &state, Call call)
{
    do {
        rdpi_f32_t self = instance(actuator, state);
        call(self);
        check_state(self, name, state.engaged);
        check_ends(self, name, state.engaged);
    } while (next_path());
}

static const Number some, nan_ = NAN, infinity = INFINITY, minus_infinity = -INFINITY;

static void from(const Actuator &actuator, State state)
{
    const unsigned plays = actuator.params.plays;
    for (Number input : {some, nan_, infinity, minus_infinity}) {
        for (unsigned missed : {0u, 1u, RDPI_MAX_MISSED + 1u}) { // more only turn the estimator's loop more often
            state.missed = missed;
            for (state.piece = 0; state.piece < (state.quick ? actuator.params.deadzones : 1u); state.piece++) {
                walk_all("step", actuator, state, [&](rdpi_f32_t &self) { rdpi_f32_step(&self, input); });
            }
            state.piece = 0;
            if (state.quick || state.window > 1 || !(input.kind == Number::Finite)) {
                break; // none are missed, or it makes no difference to what is beside the estimator
            }
        }
        walk_all("forward", actuator, state, [&](rdpi_f32_t &self) { rdpi_f32_forward(&self, input, some); });
        walk_all("forward", actuator, state, [&](rdpi_f32_t &self) { rdpi_f32_forward(&self, some, input); });
    }
    for (state.turns = 0; state.turns < 3; state.turns++) {
        walk_all("sweep", actuator, state, [&](rdpi_f32_t &self) { rdpi_f32_sweep(&self); });
    }
    state.turns = 0;
    walk_all("missed", actuator, state, [&](rdpi_f32_t &self) { rdpi_f32_missed(&self, choose() ? 3u : 0u); });
    walk_all("reset", actuator, state, [&](rdpi_f32_t &self) { rdpi_f32_reset(&self); });
    std::unique_ptr<Number[]> y(new Number[plays]);
    walk_all("set_memory", actuator, state, [&](rdpi_f32_t &self) { rdpi_f32_set_memory(&self, y.get()); });
    walk_all("get_memory", actuator, state, [&](rdpi_f32_t &self) { rdpi_f32_get_memory(&self, y.get()); });
}

static void from_init(const Actuator &actuator)
{
    bool accepted = false;
    do {
        rdpi_f32_t self{};
        self.quick = true;
        if (rdpi_f32_init(&self, &actuator.params, some) == RDPI_OK) {
            accepted = true;
            check_state(self, "init", 0);
        }
    } while (next_path());
    check(accepted, "init", "nothing is accepted", actuator.params.plays, 0);
}

// From every state: plays, codes or none, place in the bank and in the estimator's ring.
static void from_all(unsigned plays, unsigned deadzones, unsigned bits)
{
    Actuator actuator(plays, deadzones);
    actuator.params.schema = RDPI_PARAMS_SCHEMA;
    actuator.params.dac_bits = static_cast<std::uint8_t>(bits);
    actuator.params.digest = rdpi_f32_digest(&actuator.params);
    from_init(actuator);
    State state{};
    for (state.engaged = 0; state.engaged < plays; state.engaged++) {
        for (int falling = 0; falling < 2; falling++) {
            state.falling = falling != 0;
            for (state.window = 1; state.window <= WINDOW; state.window++) {
                for (state.oldest = 0; state.oldest <= state.window; state.oldest++) {
                    state.quick = false;
                    from(actuator, state);
                }
            }
            state.window = 1;
            state.oldest = 0;
            state.quick = RDPI_QUICK_STEP && bits > 0;
            if (state.quick) {
                from(actuator, state);
            }
        }
    }
}

// The bank alone, from every place in it: what the library calls in any order, to any finite x.
static void bank_from_all(unsigned plays)
{
    Actuator actuator(plays, 1);
    const rdpi_f32_play_t *play = actuator.params.play;
    std::unique_ptr<Number[]> y(new Number[plays]);
    State state{};
    state.window = 1;
    for (state.engaged = 0; state.engaged < plays; state.engaged++) {
        for (int falling = 0; falling < 2; falling++) {
            state.falling = falling != 0;
            walk_all("bank_set", actuator, state,
                     [&](rdpi_f32_t &self) { rdpi_f32_bank_set(&self.bank, play, plays, y.get()); });
            walk_all("bank_move", actuator, state, [&](rdpi_f32_t &self) {
                rdpi_f32_bank_move(&self.bank, play, plays, rdpi_f32_bank_target(some));
            });
            walk_all("bank_walk and bank_move", actuator, state, [&](rdpi_f32_t &self) {
                rdpi_real_t climb_um = rdpi_f32_bank_climb(&self.bank, some, some);
                rdpi_f32_target_t target = rdpi_f32_bank_walk(&self.bank, play, plays, some, climb_um);
                if (choose()) {
                    target.x_um = some; // where limits or a code take it
                }
                rdpi_f32_bank_move(&self.bank, play, plays, target);
            });
        }
    }
}

int main()
{
    for (unsigned plays = 1; plays <= PLAYS; plays++) {
#if PLAYS > 3
        bank_from_all(plays);
#else
        from_all(plays, RDPI_MAX_DEADZONES, 0);
        from_all(plays, RDPI_MAX_DEADZONES, 16);
#endif
        std::printf("f32_paths: %u plays, %llu paths so far\n", plays, paths);
        std::fflush(stdout);
    }
    return 0;
}
