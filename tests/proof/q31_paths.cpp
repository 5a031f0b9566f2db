// A proof about the fixed-point bank and what calls it: lib/src/q31_bank.h, q31_play.h and rdpi_q31.c as they are,
// compiled with integers that are terms of a solver (Z3). Every path that any numbers can take is walked; on each, the
// solver shows for all numbers that take it that no 32-bit sum or product overflows and, at its end, that the invariant
// holds again. See README.md for what is assumed and what is left out.
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <vector>
#include <z3++.h>

extern "C" __attribute__((weak)) void __sanitizer_print_stack_trace();

static z3::context context;
static z3::solver solver(context, "QF_LIA");
static std::vector<z3::expr> terms;
struct Choice {
    bool yes, open; /* open: the other way is for a later path */
};
static std::vector<Choice> way; // what was chosen on the path so far
static std::size_t chosen;     // how many of these the present path has taken again
static std::size_t fresh_names;
static unsigned long paths, proved;
static std::string running;

static bool possible(const z3::expr &fact)
{
    z3::expr_vector facts(context);
    facts.push_back(fact);
    z3::check_result result = solver.check(facts);
    if (result == z3::unknown) {
        std::printf("q31_paths: %s: the solver does not know\n", running.c_str());
        std::exit(1);
    }
    return result == z3::sat;
}

static bool new_here() { return chosen == way.size(); } // not walked by an earlier path

static void prove(const z3::expr &fact, const char *what)
{
    if (!new_here()) {
        return;
    }
    proved++;
    if (possible(!fact)) {
        std::printf("q31_paths: %s: cannot prove: %s\n", running.c_str(), what);
        std::fflush(stdout);
        if (__sanitizer_print_stack_trace != nullptr) {
            __sanitizer_print_stack_trace(); // where
        }
        std::exit(1);
    }
}

// What is asked on the way; later paths take the answer again.
static bool ask(const z3::expr &condition, bool both)
{
    if (new_here()) {
        bool can_be = possible(condition), can_fail = possible(!condition);
        way.push_back({can_be && !can_fail, both && can_be && can_fail});
    }
    return way[chosen++].yes;
}

// Whether it holds on this path for all numbers that take it.
static bool surely(const z3::expr &condition) { return ask(condition, false); }

// Which way a condition goes, of those that it can.
static bool branch(const z3::expr &condition)
{
    z3::expr simple = condition.simplify();
    if (simple.is_true() || simple.is_false()) {
        return simple.is_true();
    }
    bool yes = ask(simple, true);
    solver.add(yes ? simple : !simple);
    return yes;
}

static bool either()
{
    if (new_here()) {
        way.push_back({false, true});
    }
    return way[chosen++].yes;
}

static z3::expr number(long long value) { return context.int_val(static_cast<std::int64_t>(value)); }
static z3::expr unknown() { return context.int_const(("n" + std::to_string(fresh_names++)).c_str()); }
static z3::expr within(const z3::expr &x, long long low, long long high) { return x >= number(low) && x <= number(high); }

static const int beyond = -1; // id of the states behind those of the plays

template <int bits> struct Int {
    int id;
    Int() : Int(0) {}
    template <class T, class = std::enable_if_t<std::is_arithmetic<T>::value || std::is_enum<T>::value>>
    Int(T value) : Int(number(static_cast<long long>(value))) {}
    Int(const z3::expr &term) : id(static_cast<int>(terms.size())) { terms.push_back(term.simplify()); }
    template <int other, class = std::enable_if_t<other == 32 && bits == 64>> Int(Int<other> narrow) : id(narrow.id) {}
    template <int other, class = std::enable_if_t<other == 64 && bits == 32>, class = void>
    explicit Int(Int<other> wide) : Int(narrowed(wide.term()))
    {
    }
    template <class T, class = std::enable_if_t<std::is_arithmetic<T>::value>> explicit operator T() const { return T(0); }
    z3::expr term() const
    {
        if (id == beyond) {
            std::printf("q31_paths: %s: a number beyond the plays is used\n", running.c_str());
            std::exit(1);
        }
        return terms[static_cast<std::size_t>(id)];
    }

    // Implementation-defined where it does not fit; then it may be anything.
    static z3::expr narrowed(const z3::expr &wide)
    {
        if (surely(within(wide, INT32_MIN, INT32_MAX))) {
            return wide;
        }
        z3::expr narrow = unknown();
        solver.add(within(narrow, INT32_MIN, INT32_MAX));
        solver.add(z3::implies(within(wide, INT32_MIN, INT32_MAX), narrow == wide));
        return narrow;
    }
};
using I32 = Int<32>;
using I64 = Int<64>;

static I32 checked(const z3::expr &term, I32)
{
    z3::expr simple = term.simplify();
    prove(within(simple, INT32_MIN, INT32_MAX), "no 32-bit overflow");
    return I32(simple);
}
static I64 checked(const z3::expr &term, I64) { return I64(term); } // 64-bit sums: see README.md

template <int a, int b> using Wider = Int<(a > b ? a : b)>;

static std::vector<z3::expr> products; // a, b, a b of the latest

static z3::expr product(const z3::expr &a, const z3::expr &b)
{
    const bool linear = a.is_numeral() || b.is_numeral();
    z3::expr p = linear ? a * b : unknown(), one = number(1LL << 30);
    // what the signs say, and for a slope a, |a| <= 2^30
    solver.add(z3::implies(a >= 0 && b >= 0, p >= 0));
    solver.add(z3::implies(a <= 0 && b >= 0, p <= 0));
    solver.add(z3::implies(a >= 0 && b <= 0, p <= 0));
    solver.add(z3::implies(a <= 0 && b <= 0, p >= 0));
    // for a rate b, 0 <= b <= 2^30
    solver.add(z3::implies(b >= 0 && b <= one && a >= 0, p <= one * a));
    solver.add(z3::implies(b >= 0 && b <= one && a <= 0, p >= one * a));
    products.push_back(a);
    products.push_back(b);
    products.push_back(p);
    return p;
}

static z3::expr shifted(const z3::expr &a, unsigned bits) // floor(a / 2^bits)
{
    if (a.is_numeral() && bits == 0) {
        return a;
    }
    z3::expr q = unknown(), unit = number(1LL << bits);
    solver.add(q * unit <= a && a < q * unit + unit);
    return q;
}

#define OPERATOR(sign, result)                                                                                        \
    template <int m, int n> Wider<m, n> operator sign(Int<m> x, Int<n> y)                                              \
    {                                                                                                                  \
        z3::expr a = x.term(), b = y.term();                                                                           \
        return checked(result, Wider<m, n>());                                                                         \
    }                                                                                                                  \
    template <int m, class T, class = std::enable_if_t<std::is_arithmetic<T>::value>>                                  \
    Wider<m, (sizeof(T) > 4 ? 64 : 32)> operator sign(Int<m> x, T y)                                                   \
    {                                                                                                                  \
        return x sign Int<(sizeof(T) > 4 ? 64 : 32)>(y);                                                               \
    }                                                                                                                  \
    template <int m, class T, class = std::enable_if_t<std::is_arithmetic<T>::value>>                                  \
    Wider<m, (sizeof(T) > 4 ? 64 : 32)> operator sign(T x, Int<m> y)                                                   \
    {                                                                                                                  \
        return Int<(sizeof(T) > 4 ? 64 : 32)>(x) sign y;                                                               \
    }                                                                                                                  \
    template <int m, class T> Int<m> &operator sign##=(Int<m> &x, T y)                                                 \
    {                                                                                                                  \
        return x = Int<m>(x sign y);                                                                                   \
    }
OPERATOR(+, a + b)
OPERATOR(-, a - b)
OPERATOR(*, product(a, b))

#define COMPARISON(sign)                                                                                               \
    template <int m, int n> bool operator sign(Int<m> x, Int<n> y) { return branch(x.term() sign y.term()); }          \
    template <int m, class T, class = std::enable_if_t<std::is_arithmetic<T>::value>> bool operator sign(Int<m> x, T y)\
    {                                                                                                                  \
        return branch(x.term() sign number(y));                                                                        \
    }
COMPARISON(<)
COMPARISON(>)
COMPARISON(<=)
COMPARISON(>=)
COMPARISON(==)
COMPARISON(!=)

template <int m> Int<m> operator-(Int<m> x) { return checked(-x.term(), x); }
template <int m> Int<m> operator>>(Int<m> x, unsigned bits) { return Int<m>(shifted(x.term(), bits)); }
template <int m> Int<m> operator<<(Int<m> x, unsigned bits) { return Int<m>(x.term() * number(1LL << bits)); }
template <int m> Int<m> operator/(Int<m> x, unsigned y) // towards 0
{
    z3::expr a = x.term(), q = unknown(), d = number(y);
    solver.add(z3::implies(a >= 0, q * d <= a && a < q * d + d));
    solver.add(z3::implies(a <= 0, q * d >= a && a > q * d - d));
    return Int<m>(q);
}

// What becomes of an int32_t that is cast to uint32_t.
struct U32 {
    z3::expr term;
    explicit U32(I32 x) : term(z3::ite(x.term() < 0, x.term() + number(1LL << 32), x.term())) {}
    bool operator>(const U32 &other) const { return branch(term > other.term); }
};

#define int32_t I32
#define int64_t I64
#include "rdpi/q31.h"

// lib/src/q31_math.h by its contracts.
#define RDPI_Q31_MATH_H
#define RDPI_Q31_SELDOM
#define RDPI_Q31_HOT inline
static I32 rdpi_q31_clamp(I64 value, I32 low, I32 high)
{
    return value < low ? low : (value > high ? high : I32(value));
}
static I64 rdpi_q31_widen(I32 drive) { return I64(drive) << 32; }
static I32 rdpi_q31_fresh(I32 same) { return same; }
static const rdpi_q31_params_t *coded; // whose codes are put out: see README.md, "codes"
static I64 rdpi_q31_mul(I32 a, I32 b)
{
    z3::expr p = product(a.term(), b.term());
    if (coded != nullptr && b.id == coded->drive_per_code.id) {
        z3::expr zero = coded->drive_of_code_0.term(), unit = number(1LL << 31), half = number(1LL << 30);
        solver.add(unit * (coded->min_drive.term() - 2 - zero) <= p + half);
        solver.add(p + half < unit * (coded->max_drive.term() + 3 - zero));
    }
    return I64(p);
}
static I64 rdpi_q31_mul_rate(I32 a, I32 rate) { return rdpi_q31_mul(a, rate); }
// 0 <= quotient, and quotient divisor <= dividend: so it is not more than a factor whose product with the divisor
// reaches the dividend.
static I32 rdpi_q31_divide(I64 dividend, I32 divisor)
{
    z3::expr quotient = unknown();
    solver.add(within(quotient, 0, INT32_MAX));
    for (std::size_t k = 0; k < products.size(); k += 3) {
        if (z3::eq(products[k], divisor.term())) {
            solver.add(z3::implies(dividend.term() <= products[k + 2] && products[k + 1] >= 0,
                                   quotient <= products[k + 1]));
        }
    }
    return I32(quotient);
}

// The saturation stage and the rate estimator: any numbers of their ranges.
#define RDPI_Q31_SATURATION_H
#define RDPI_Q31_RATE_H
#define RDPI_CRC_H
static uint32_t rdpi_crc32(uint32_t crc, uint32_t) { return crc; }
static uint32_t rdpi_crc32_wide(uint32_t crc, uint64_t) { return crc; }
static uint32_t rdpi_crc32_block(uint32_t crc, const void *, std::size_t) { return crc; }
static I32 any32(long long low, long long high)
{
    z3::expr x = unknown();
    solver.add(within(x, low, high));
    return I32(x);
}
static I32 rdpi_q31_saturation(const rdpi_q31_deadzone_t *, std::size_t, unsigned, I32, I32)
{
    return any32(-INT32_MAX, INT32_MAX);
}
static bool rdpi_q31_piece_find(rdpi_q31_piece_t *, const rdpi_q31_deadzone_t *, std::size_t, unsigned, I32)
{
    return true; // what there is instead is a special case of any v
}
static bool rdpi_q31_piece_holds(const rdpi_q31_piece_t *, I32) { return either(); }
static I64 rdpi_q31_piece_at(const rdpi_q31_piece_t *, I32) { return I64(unknown()); }
static void rdpi_q31_rate_reset(rdpi_q31_rate_t *rate) { rate->direct = false; }
static rdpi_status_t rdpi_q31_rate_init(rdpi_q31_rate_t *, const rdpi_q31_params_t *, uint32_t) { return RDPI_OK; }
static uint32_t rdpi_q31_rate_direct_limit(const rdpi_q31_rate_t *) { return 1; }
static uint32_t rdpi_q31_rate_direct_distance(rdpi_q31_rate_t *, I32) { return either() ? 2 : 0; }
static I32 rdpi_q31_rate_direct(const rdpi_q31_rate_t *, uint32_t) { return any32(0, 1LL << 30); }
static I32 rdpi_q31_rate_step(rdpi_q31_rate_t *rate, I32, unsigned)
{
    rate->direct = either();
    return any32(0, 1LL << 30); // beyond the guard: see rdpi_q31_rate_direct_distance
}

#include "q31_play.h"
#define uint32_t U32
#include "q31_bank.h"
#undef uint32_t
#include "rdpi_q31.c"

// ---- the invariant ----

static const long long format = 1LL << 29;

static z3::expr drawn(I32 &into) // an unknown number
{
    z3::expr x = unknown();
    into = I32(x);
    return x;
}

struct Actuator {
    std::unique_ptr<rdpi_q31_play_t[]> play;
    rdpi_q31_params_t params;
    rdpi_q31_deadzone_t term;

    // Parameters of any kind; the shifts are one choice of many.
    explicit Actuator(unsigned plays, unsigned bits) : play(new rdpi_q31_play_t[plays])
    {
        std::memset(static_cast<void *>(&params), 0, sizeof params);
        params.plays = static_cast<std::uint16_t>(plays);
        params.deadzones = 1;
        params.dac_bits = static_cast<std::uint8_t>(bits);
        params.curve_pieces = 1;
        params.sweep_cycles = 3;
        params.code_shift = 40;
        params.drive_shift = 20;
        params.play = play.get();
        params.saturation = params.inverse_saturation = &term;
        for (unsigned i = 0; i < plays; i++) {
            for (I32 *member : {&play[i].r, &play[i].slope, &play[i].slope_rate}) {
                *member = any32(INT32_MIN, INT32_MAX);
            }
        }
        for (I32 *member : {&params.min_drive, &params.max_drive, &params.sweep_end, &params.drive_of_code_0,
                            &params.codes_per_drive, &params.drive_per_code}) {
            *member = any32(INT32_MIN, INT32_MAX);
        }
        params.min_x = params.min_drive; // the input curve is straight: init sees to it
        params.max_x = params.max_drive;
    }

    // What holds of those that init accepts.
    z3::expr accepted() const
    {
        z3::expr all = play[0].r.term() == 0;
        for (unsigned i = 0; i < params.plays; i++) {
            z3::expr r = play[i].r.term(), slope = play[i].slope.term();
            if (i > 0) {
                all = all && r > play[i - 1].r.term() && r <= number(format);
            }
            all = all && within(slope, 1 << 24, 1 << 30) && within(slope + play[i].slope_rate.term(), 1 << 24, 1 << 30);
        }
        z3::expr min = params.min_drive.term(), max = params.max_drive.term(), end = params.sweep_end.term();
        z3::expr zero = params.drive_of_code_0.term();
        return all && number(-format) <= min && min < max && max <= number(format) && min <= end && end <= max &&
               (zero == min || zero == max);
    }
};

static z3::expr in_drive_range(const rdpi_q31_params_t &params, const z3::expr &x)
{
    return params.min_drive.term() <= x && x <= params.max_drive.term();
}

// x, or the end of the range that it is beyond.
static z3::expr nearest(const rdpi_q31_params_t &params, const z3::expr &x)
{
    z3::expr min = params.min_drive.term(), max = params.max_drive.term();
    return z3::ite(x < min, min, z3::ite(x > max, max, x));
}

static z3::expr lag(const rdpi_q31_params_t &params, const I32 *y, unsigned i, unsigned j)
{
    z3::expr apart = y[j].term() - y[i].term(), most = params.play[j].r.term() - params.play[i].r.term();
    return -most <= apart && apart <= most;
}

// What holds of the bank between two calls.
static z3::expr invariant(const rdpi_q31_params_t &params, const rdpi_q31_bank_t &bank)
{
    const I32 *y = bank.y;
    z3::expr side = number(bank.falling ? -1 : 1), x = side * y[0].term(), room = bank.room.term();
    z3::expr all = within(room, 0, 2 * format) &&
                   (room == 0 || x + room <= side * (bank.falling ? params.min_drive : params.max_drive).term());
    for (unsigned i = 0; i < params.plays; i++) {
        const z3::expr r = params.play[i].r.term(), corner = side * y[i].term() + r;
        all = all && within(y[i].term(), -format, format);
        if (i > 0) {
            all = all && side * y[i].term() - r <= x; // x is not before where it turned round
            all = all && (i <= bank.engaged ? corner <= x : x + room <= corner);
        }
        if (i > 1) {
            all = all && lag(params, y, i - 1, i); // the states of where x turned round are those of one history
        }
    }
    return all;
}

struct State {
    unsigned engaged;
    bool falling;
};

static void clear(rdpi_q31_t &self, unsigned plays)
{
    std::memset(static_cast<void *>(&self), 0, sizeof self);
    for (unsigned i = plays; i < RDPI_MAX_PLAYS; i++) {
        self.bank.y[i].id = beyond;
    }
}

// An instance in any state that the invariant allows.
static bool whole = true; // all of the library, and not the bank alone

static void draw(rdpi_q31_t &self, const Actuator &actuator, const State &state)
{
    const rdpi_q31_params_t &params = actuator.params;
    self.params = &params;
    self.bank.engaged = static_cast<std::uint16_t>(state.engaged);
    self.bank.falling = state.falling;
    self.bank.last_engaged = params.play + state.engaged;
    for (unsigned i = 0; i < params.plays; i++) {
        drawn(self.bank.y[i]);
    }
    drawn(self.bank.room);
    self.bank.f_at_rest = I64(unknown());
    self.bank.f_rate = I64(unknown());
    solver.add(invariant(params, self.bank));
    z3::expr drive = drawn(self.drive), x = self.bank.y[0].term(), ramp = unknown();
    solver.add(drive == nearest(params, x));
    self.rate_estimator.direct = whole && either();
    if (self.rate_estimator.direct) {
        solver.add(drive == x);
    }
    self.ramp = I64(ramp);
    solver.add(params.min_drive.term() * number(1LL << 32) <= ramp && ramp <= params.max_drive.term() * number(1LL << 32));
    self.slew = I64(unknown());
    self.sweep_step = I64(unknown());
    solver.add(self.slew.term() >= 0 && self.sweep_step.term() >= 1);
    solver.add(within(drawn(self.rate), 0, 1 << 30));
    self.direct_output = whole && params.dac_bits > 0 && either();
    if (self.direct_output) {
        solver.add(self.slew.term() == 0);
    } else {
        self.x = self.drive; // the input curve is straight
    }
}

static void prove_state(const rdpi_q31_t &self)
{
    const rdpi_q31_params_t &params = *self.params;
    prove(context.bool_val(self.bank.engaged < params.plays), "engaged is one of the plays");
    prove(context.bool_val(self.bank.last_engaged == params.play + self.bank.engaged), "last_engaged is play[engaged]");
    z3::expr drive = self.drive.term(), x = self.bank.y[0].term(), ramp = self.ramp.term(), wide = number(1LL << 32);
    for (unsigned i = params.plays; i < RDPI_MAX_PLAYS; i++) {
        prove(context.bool_val(self.bank.y[i].id == beyond), "no state beyond the plays is written");
    }
    prove(in_drive_range(params, drive) && drive == nearest(params, x), "the drive is x, inside the range");
    prove(params.min_drive.term() * wide <= ramp && ramp <= params.max_drive.term() * wide, "the ramp is inside");
    prove(invariant(params, self.bank), "the bank's invariant");
    if (self.rate_estimator.direct) {
        prove(drive == x, "the drive is x where the quick way is open");
    }
    if (whole && !self.direct_output) {
        prove(self.x.term() == drive, "the drive has been kept as x");
    }
}

template <class Body> static void walk_paths(const std::string &name, Body body)
{
    running = name;
    way.clear();
    for (;;) {
        solver.reset();
        terms.clear();
        terms.push_back(number(0));
        products.clear();
        fresh_names = 0;
        chosen = 0;
        body();
        paths++;
        way.resize(chosen);
        while (!way.empty() && !way.back().open) {
            way.pop_back();
        }
        if (way.empty()) {
            if (std::getenv("RDPI_PROOF_COUNT") != nullptr) {
                std::fprintf(stderr, "%s: %lu paths, %lu facts\n", running.c_str(), paths, proved);
            }
            return;
        }
        way.back() = {true, false};
    }
}

template <class Call> static void walk_all(const char *name, unsigned plays, unsigned bits, const State &state, Call call)
{
    walk_paths(name + std::string(" from ") + std::to_string(state.engaged) + " engaged of " + std::to_string(plays) +
                   (state.falling ? ", falling" : ", rising"),
               [&] {
                   Actuator actuator(plays, bits);
                   rdpi_q31_t self;
                   clear(self, plays);
                   solver.add(actuator.accepted());
                   coded = &actuator.params;
                   draw(self, actuator, state);
                   call(self);
                   prove_state(self);
               });
}

// What init accepts is what accepted() says, and what it leaves is what the invariant says.
static void init(unsigned plays, unsigned bits)
{
    unsigned long accepted = 0;
    coded = nullptr;
    walk_paths("init with " + std::to_string(plays) + " plays, " + std::to_string(bits) + " bits", [&] {
        Actuator actuator(plays, bits);
        rdpi_q31_params_t &params = actuator.params;
        std::unique_ptr<I32[]> memory(new I32[plays]);
        for (unsigned i = 0; i < plays; i++) {
            memory[i] = any32(INT32_MIN, INT32_MAX);
        }
        params.schema = RDPI_PARAMS_SCHEMA;
        params.guard_mantissa = 1u << 31;
        params.min_slope_ratio = 1; // larger ones refuse more
        params.sweep_per_us = 1000;
        params.memory = memory.get();
        actuator.term.weight = 1 << 30;
        rdpi_q31_t self;
        clear(self, plays);
        if (rdpi_q31_init(&self, &params, 1000) == RDPI_OK) {
            accepted++;
            prove(actuator.accepted(), "what init accepts");
            prove_state(self);
        }
    });
    if (accepted == 0) {
        std::printf("q31_paths: %s: nothing is accepted\n", running.c_str());
        std::exit(1);
    }
}

static void from(unsigned plays, unsigned bits, const State &state)
{
    walk_all("step", plays, bits, state, [](rdpi_q31_t &self) { rdpi_q31_step(&self, any32(INT32_MIN, INT32_MAX)); });
    walk_all("forward", plays, bits, state, [](rdpi_q31_t &self) {
        rdpi_q31_forward(&self, any32(INT32_MIN, INT32_MAX), any32(INT32_MIN, INT32_MAX));
    });
    for (std::uint16_t turns : {0, 1, 2, 3, 6, 7}) {
        walk_all("sweep", plays, bits, state, [turns](rdpi_q31_t &self) {
            self.sweep_turns = turns;
            rdpi_q31_sweep(&self);
        });
    }
    walk_all("missed", plays, bits, state, [](rdpi_q31_t &self) { rdpi_q31_missed(&self, either() ? 0 : 9); });
    walk_all("set_memory", plays, bits, state, [plays](rdpi_q31_t &self) {
        std::unique_ptr<I32[]> y(new I32[plays]);
        for (unsigned i = 0; i < plays; i++) {
            y[i] = any32(INT32_MIN, INT32_MAX);
        }
        rdpi_q31_set_memory(&self, y.get());
    });
    walk_all("get_memory and reset", plays, bits, state, [plays](rdpi_q31_t &self) {
        std::unique_ptr<I32[]> y(new I32[plays]);
        rdpi_q31_get_memory(&self, y.get());
        for (unsigned i = 0; i < plays; i++) {
            prove(within(y[i].term(), -format, format), "states are in their format");
            if (i > 0) {
                prove(lag(*self.params, y.get(), i - 1, i), "states are those of one history");
            }
        }
        rdpi_q31_params_t params = *self.params;
        params.memory = y.get();
        if (rdpi_q31_in_range(&params, y[0]) == y[0]) { // as init has checked
            self.params = &params;
            rdpi_q31_reset(&self);
            prove_state(self);
        }
        self.params = coded;
    });
}

// The bank alone, as rdpi_q31.c uses it.
static void bank_from(unsigned plays, const State &state)
{
    walk_all("bank_solve and what follows", plays, 0, state, [](rdpi_q31_t &self) {
        const rdpi_q31_params_t &params = *self.params;
        rdpi_q31_bank_t *bank = &self.bank;
        bool beyond = false;
        solver.add(in_drive_range(params, bank->y[0].term()));
        I32 before = bank->y[0], wish = rdpi_q31_bank_solve(bank, &params, any32(0, 1LL << 30), I64(unknown()), &beyond);
        prove(in_drive_range(params, wish.term()), "the solution is inside the range");
        I32 rounded;
        z3::expr code = drawn(rounded); // what is output instead: up to 2 units beyond the range, where it is a code
        solver.add(params.min_drive.term() - 2 <= code && code <= params.max_drive.term() + 2);
        if (!rdpi_q31_bank_try_slide(bank, rounded)) {
            rounded = rdpi_q31_in_range(&params, rounded);
            rdpi_q31_bank_move(bank, &params, before, rounded);
        }
        self.drive = rounded;
        self.rate_estimator.direct = true;
    });
    walk_all("bank_move", plays, 0, state, [](rdpi_q31_t &self) {
        I32 x = any32(-format, format);
        rdpi_q31_bank_move(&self.bank, self.params, self.bank.y[0], x);
        put_drive(&self, x);
        self.rate_estimator.direct = false;
    });
    walk_all("bank_at", plays, 0, state, [](rdpi_q31_t &self) {
        rdpi_q31_bank_at(&self.bank, self.params, any32(0, 1LL << 30), any32(-format, format));
    });
    walk_all("set_memory", plays, 0, state, [plays](rdpi_q31_t &self) {
        std::unique_ptr<I32[]> y(new I32[plays]);
        for (unsigned i = 0; i < plays; i++) {
            y[i] = any32(INT32_MIN, INT32_MAX);
        }
        rdpi_q31_set_memory(&self, y.get());
    });
}

// q31_paths init|bank|all PLAYS
int main(int argc, char **argv)
{
    const std::string what = argc > 1 ? argv[1] : "all";
    const bool bank = what == "bank", all = what == "all";
    whole = !bank;
    const unsigned most = argc > 2 ? static_cast<unsigned>(std::atoi(argv[2])) : 1;
    for (unsigned plays = 1; plays <= most; plays++) {
        for (unsigned bits = 0; what == "init" && bits <= 16; bits += 16) {
            init(plays, bits);
        }
        for (unsigned engaged = 0; bank && engaged < plays; engaged++) {
            bank_from(plays, {engaged, false});
            bank_from(plays, {engaged, true});
        }
        for (unsigned bits : {16u, 0u}) {
            for (unsigned engaged = 0; all && engaged < plays; engaged++) {
                from(plays, bits, {engaged, false});
                from(plays, bits, {engaged, true});
            }
        }
        std::printf("q31_paths: %u plays: %lu paths, %lu facts proved so far\n", plays, paths, proved);
        std::fflush(stdout);
    }
    return 0;
}
