#!/usr/bin/env python3
"""Golden vectors of the fixed-point library, q31_vectors.h.

The integers are the library's own. While they are written, each drive and each rate is compared with the definitions
(eq. 1, 7, 8, 9, 13 and 16 of Ang et al., IROS 2003) in rational arithmetic, which knows no rounding: nothing gets into
the file that is further from them than rdpi/q31.h promises. tests/unit/test_q31_golden.c replays the file; so may
any other processor.

usage: q31.py            writes the file again
       q31.py --check    exit status 1 if the library would give another file
"""

from __future__ import annotations

import argparse
import ctypes
import decimal
import subprocess
import sys
import tempfile
import zlib
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
VECTORS = Path(__file__).with_name("q31_vectors.h")
ONE, MAX, NO_REFERENCE = 2**30, 2**29, -(2**31)
MAX_MISSED = 16
INPUT, MISSED = 8, 16  # flags
LIMIT = Fraction(MAX, 2**20)

# In the order of rdpi_q31_params_t from slew_per_us on: its digest is over these.
NUMBERS = {
    "slew_per_us": ctypes.c_uint64, "sweep_per_us": ctypes.c_uint64, "plays": ctypes.c_uint16,
    "deadzones": ctypes.c_uint8, "dac_bits": ctypes.c_uint8, "curve_pieces": ctypes.c_uint8,
    "noise_shaping": ctypes.c_uint8,
    "sweep_cycles": ctypes.c_uint16,
    "saturation_shift": ctypes.c_uint8, "inverse_shift": ctypes.c_uint8, "code_shift": ctypes.c_uint8,
    "drive_shift": ctypes.c_uint8, "guard_exponent": ctypes.c_int16, "min_slope_ratio": ctypes.c_uint16,
    "guard_mantissa": ctypes.c_uint32, "rate_window_ns": ctypes.c_uint32, "rate_filter_ns": ctypes.c_uint32,
    "min_drive": ctypes.c_int32, "max_drive": ctypes.c_int32, "min_x": ctypes.c_int32, "max_x": ctypes.c_int32,
    "min_mV": ctypes.c_int32, "max_mV": ctypes.c_int32, "unit_mantissa": ctypes.c_uint32, "unit_exponent": ctypes.c_int32,
    "drive_of_code_0": ctypes.c_int32,
    "codes_per_drive": ctypes.c_int32, "drive_per_code": ctypes.c_int32, "sweep_end": ctypes.c_int32,
    "sweep_forgotten": ctypes.c_int32, "min_sample_time_ns": ctypes.c_uint32, "max_sample_time_ns": ctypes.c_uint32}
ARRAYS = ("play", "saturation", "inverse_saturation", "curve", "memory")


class Params(ctypes.Structure):
    _fields_ = [("schema", ctypes.c_uint32), ("digest", ctypes.c_uint32), *NUMBERS.items(),
                *((name, ctypes.POINTER(ctypes.c_int32)) for name in ARRAYS)]


class Axis(ctypes.Structure):
    """The results that rdpi_q31_t begins with, and room for the rest."""

    _fields_ = [("drive", ctypes.c_int32), ("rate", ctypes.c_int32), ("dac_code", ctypes.c_uint32),
                ("flags", ctypes.c_uint32), ("private", ctypes.c_uint64 * 512)]


@dataclass
class Actuator:
    name: str
    sample_time_ns: int
    numbers: dict[str, int]
    play: list[tuple[int, int, int]]  # r, slope, slope_rate
    saturation: list[tuple[int, int]]  # d, weight
    inverse_saturation: list[tuple[int, int]]
    curve: list[tuple[int, ...]]  # from_drive, from_x, x_per_drive, drive_per_x, x_shift, drive_shift; none: straight
    memory: list[int]
    samples: list[tuple[int, int]] = field(default_factory=list)  # missed before it, reference

    def flat(self, name: str) -> list[int]:
        rows = getattr(self, name)
        return list(rows) if name == "memory" else [number for row in rows for number in row]

    def digest(self) -> int:
        """As rdpi_q31_digest."""
        data = b"".join(self.numbers[name].to_bytes(ctypes.sizeof(kind), "little", signed=self.numbers[name] < 0) for name, kind in NUMBERS.items())
        for name in ARRAYS:
            data += b"".join(number.to_bytes(4, "little", signed=number < 0) for number in self.flat(name))
        return zlib.crc32(data)


# ---- random numbers that are the same in every version of Python ----


class Random:
    def __init__(self, seed: int) -> None:
        self.state = seed

    def bits(self) -> int:
        self.state = (self.state * 6364136223846793005 + 1442695040888963407) % 2**64
        return self.state >> 32

    def between(self, low: int, high: int) -> int:
        return low + self.bits() * (high - low + 1) // 2**32

    def chance(self, one_in: int) -> bool:
        return self.between(1, one_in) == 1


def references(random: Random, count: int, reach: int) -> list[tuple[int, int]]:
    """Ramps, rests, turns and jumps; now and then samples missed, no reference, or one out of reach."""
    samples, now, step = [], 0, 0
    for _ in range(count):
        if random.chance(8):
            step = random.between(-(reach >> 3), reach >> 3) >> random.between(0, 8)
        if random.chance(25):
            now = random.between(-reach, reach)
        now = max(-reach, min(reach, now + step))
        missed = random.between(1, MAX_MISSED + 1) if random.chance(12) else 0
        odd = random.between(1, 40)
        samples.append((missed, {1: NO_REFERENCE, 2: 2**31 - 1, 3: -(2**31) + 1}.get(odd, now)))
    return samples


# ---- the actuators ----


def saturation(pieces: list[tuple[int, Fraction]], shift: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Weights of pieces (from d on, slope) over 2^shift, and those of their inverse."""
    stage, inverse, z, before, d_before = [], [], Fraction(0), Fraction(0), 0
    for d, slope in pieces:
        z += before * (d - d_before)
        stage.append((d, int(slope * 2**shift) - sum(weight for _, weight in stage)))
        inverse.append((int(z), int(2**shift / slope) - sum(weight for _, weight in inverse)))
        before, d_before = slope, d
    return stage, inverse


def codes(bits: int, low: int, high: int, falling: bool) -> dict[str, int]:
    if bits == 0:
        return dict(dac_bits=0, drive_of_code_0=low, codes_per_drive=0, drive_per_code=0, code_shift=0, drive_shift=0)

    sign, last = -1 if falling else 1, 2**bits - 1
    (per_drive, code_shift), (per_code, drive_shift) = quotient(Fraction(last, high - low)), quotient(
        Fraction(high - low, last))
    return dict(dac_bits=bits, drive_of_code_0=high if falling else low, codes_per_drive=sign * per_drive,
                drive_per_code=sign * per_code, code_shift=code_shift, drive_shift=drive_shift)


def quotient(value: Fraction) -> tuple[int, int]:
    shift = 1
    while value * 2**shift < ONE:
        shift += 1
    return min(round(value * 2**shift), 2**31 - 1), shift


def lines(points: list[tuple[int, int]]) -> list[tuple[int, ...]]:
    """The input curve through points of drive and x."""
    rows = []
    for (drive, x), (to_drive, to_x) in zip(points, points[1:]):
        slope = Fraction(to_x - x, to_drive - drive)
        (x_per_drive, x_shift), (drive_per_x, drive_shift) = quotient(slope), quotient(1 / slope)
        rows.append((drive, x, x_per_drive, drive_per_x, x_shift, drive_shift))
    return rows


def speed(per_sample: int, sample_time_ns: int) -> int:
    return per_sample * 2**32 * 1000 // sample_time_ns


def actuators() -> list[Actuator]:
    random, half = Random(2003), Fraction(1, 2)
    result = []

    def add(name: str, count: int, time: int, plays: list[tuple[int, int, int]], pieces: list[tuple[int, Fraction]],
            low: int, high: int, reach: int, bits: int = 0, falling: bool = False, slew: int = 0, window: int = 0,
            filter_ns: int = 0, guard: tuple[int, int] = (2**31, -28), excursions: tuple[int, ...] = (),
            shift: int = 30, curve: tuple[tuple[int, int], ...] = ()) -> None:
        stage, inverse = saturation(pieces, shift)
        memory = [0] * len(plays)
        for x in excursions:
            memory = [max(x - r, min(x + r, y)) for (r, _, _), y in zip(plays, memory)]
        numbers = dict(
            slew_per_us=speed(slew, time), sweep_per_us=speed(2**19, time), plays=len(plays), deadzones=len(pieces),
            sweep_cycles=20, saturation_shift=shift, inverse_shift=shift, guard_exponent=guard[1], min_slope_ratio=1,
            guard_mantissa=guard[0], rate_window_ns=window, rate_filter_ns=filter_ns, min_drive=low, max_drive=high,
            min_x=curve[0][1] if curve else low, max_x=curve[-1][1] if curve else high,
            curve_pieces=max(len(curve) - 1, 1), noise_shaping=0,
            min_mV=-1000, max_mV=2000, unit_mantissa=2**31, unit_exponent=-56,
            sweep_end=(low + high) // 2, sweep_forgotten=0, min_sample_time_ns=time, max_sample_time_ns=time,
            **codes(bits, low, high, falling))
        result.append(Actuator(name, time, numbers, plays, stage, inverse, lines(list(curve)), memory, references(random, count, reach)))

    rising = [(i * 20000003, ONE // 4 + i * 77777777, -(ONE // 8) - i * 5555555) for i in range(10)]
    add("as the paper's: ten plays, three pieces, a strong rate law", 150, 100000, rising,
        [(0, Fraction(1)), (10**8, Fraction(7, 8)), (2 * 10**8, Fraction(5, 8))], -MAX // 2, MAX // 4 * 3,
        2 * 10**8, filter_ns=300000, guard=(0xC0000001, -24), excursions=(3 * 10**8, -10**8, 12345678))
    uneven = [(i * 31000001, ONE - i * 10**6 if i % 2 else ONE // 2 + i, (-1) ** i * (ONE // 3)) for i in range(16)]
    add("sixteen plays whose slopes cross, falling codes, slew limit, window", 150, 50000, uneven,
        [(0, half), (5 * 10**7, Fraction(3, 2))], -MAX, MAX, 4 * 10**8, bits=14, falling=True, slew=10**8,
        window=16 * 50000, filter_ns=123457, guard=(2**32 - 1, -23), excursions=(-MAX, MAX // 2, 0), shift=28)
    add("one play of the smallest slope, eight bits", 60, 1000000, [(0, 2**24, 0)], [(0, Fraction(1))], -MAX, MAX,
        2**23, bits=8)
    jumping = [(0, ONE, 2**24 - ONE), (1, 2**24, ONE - 2**24), (MAX, ONE, 0)]
    add("the ends of the format", 80, 2**20, jumping, [(0, Fraction(1))], -MAX, MAX, 2**24, bits=20, window=2 * 2**20,
        guard=(2**31, -28))
    bent = tuple((-MAX + k * (MAX // 4), -MAX + k * (MAX // 8) + k * k * (MAX // 64)) for k in range(9))
    add("an input curve of eight pieces, falling codes", 120, 100000, rising[:6], [(0, Fraction(1))], -MAX, MAX,
        2 * 10**8, bits=16, falling=True, curve=bent)
    add("an input curve of two pieces, slew limit", 120, 100000, rising[:3], [(0, Fraction(1)), (10**8, half)], -MAX // 2,
        MAX // 2, 2 * 10**8, slew=10**7, curve=((-MAX // 2, -MAX // 4), (MAX // 8, 0), (MAX // 2, MAX)))
    return result


# ---- the definitions ----


class Exact:
    def __init__(self, actuator: Actuator) -> None:
        self.actuator, self.n = actuator, actuator.numbers
        self.y = [Fraction(y) for y in actuator.memory]
        self.ramp = self.curve(Fraction(actuator.memory[0]), 1)
        self.window = max(1, (self.n["rate_window_ns"] + actuator.sample_time_ns // 2) // actuator.sample_time_ns)
        self.blend = Fraction(1)
        if self.n["rate_filter_ns"] > 0:
            with decimal.localcontext(prec=60):
                ratio = decimal.Decimal(actuator.sample_time_ns) / self.n["rate_filter_ns"]
                self.blend = 1 - Fraction((-ratio).exp())
        self.forget()
        self.missed = 0

    def curve(self, value: Fraction, of: int) -> Fraction:
        """The input curve: of 0: x of a drive, of 1: the drive of an x."""
        if not self.actuator.curve:
            return value
        points = [*((row[0], row[1]) for row in self.actuator.curve), (self.n["max_drive"], self.n["max_x"])]
        k = sum(value >= point[of] for point in points[1:-1])
        (start, end), other = points[k:k + 2], 1 - of
        return start[other] + (value - start[of]) * Fraction(end[other] - start[other], end[of] - start[of])

    def forget(self) -> None:
        self.z: list[int] = []
        self.filtered = Fraction(0)

    def rate(self, z: int) -> Fraction:
        """Of the guard. Missed references are whole units on a straight line, rounded towards the one before."""
        if self.missed > MAX_MISSED or not self.z:
            self.forget()
        left = self.missed + 1 if self.z else 1
        self.missed = 0
        while left > 0:
            last = self.z[-1] if self.z else z
            way = abs(z - last) // left
            now = last + way if z > last else last - way
            before = self.z[max(0, len(self.z) - self.window)] if self.z else now
            self.z.append(now)
            self.filtered += self.blend * (abs(now - before) - self.filtered)
            self.filtered = Fraction(round(self.filtered * 2**200), 2**200)  # or it takes minutes
            left -= 1
        guard = Fraction(self.n["guard_mantissa"]) * Fraction(2) ** self.n["guard_exponent"]
        return min(Fraction(1), self.filtered / (guard * self.window * self.actuator.sample_time_ns))

    def output(self, rate: Fraction, x: Fraction) -> Fraction:
        v, before = Fraction(0), Fraction(0)
        for (r, slope, slope_rate), y in zip(self.actuator.play, self.y):
            now = (slope + slope_rate * rate) / ONE
            v += (now - before) * max(x - r, min(x + r, y))
            before = now
        return v

    def solution(self, rate: Fraction, v: Fraction) -> Fraction:
        """The x, within a little more than the range, at which the output is v."""
        low, high = Fraction(self.n["min_x"] - 1), Fraction(self.n["max_x"] + 1)
        for (r, _, _), y in zip(self.actuator.play, self.y):
            for corner in (y - r, y + r):
                if low < corner < high:
                    low, high = (corner, high) if self.output(rate, corner) < v else (low, corner)
        below, above = self.output(rate, low), self.output(rate, high)
        return max(low, min(high, low + (high - low) * (v - below) / (above - below)))

    def step(self, z: int) -> tuple[Fraction, Fraction]:
        """Rate, and drive before it is rounded to a code."""
        rate = self.rate(z)
        v = sum(weight * (Fraction(z) if d == 0 else max(Fraction(z - d), Fraction(0)))
                for d, weight in self.actuator.inverse_saturation) / 2 ** self.n["inverse_shift"]
        drive = self.curve(max(Fraction(self.n["min_x"]), min(Fraction(self.n["max_x"]), self.solution(rate, v))), 1)
        if self.n["slew_per_us"] > 0:
            slew = Fraction(self.n["slew_per_us"] * self.actuator.sample_time_ns, 1000 * 2**32)
            drive = max(self.ramp - slew, min(self.ramp + slew, drive))
        self.ramp = Fraction(drive)
        return rate, self.ramp

    def move(self, drive: int) -> None:
        x = round(self.curve(Fraction(drive), 0))
        self.y = [max(x - r, min(x + r, y)) for (r, _, _), y in zip(self.actuator.play, self.y)]


# ---- the library ----


# rdpi_q31_init is inline: a library exports only what it calls.
INIT = """#include "rdpi/q31.h"
rdpi_status_t init(rdpi_q31_t *self, const rdpi_q31_params_t *params, uint32_t sample_time_ns);
rdpi_status_t init(rdpi_q31_t *self, const rdpi_q31_params_t *params, uint32_t sample_time_ns)
{
    return rdpi_q31_init(self, params, sample_time_ns);
}
"""


def library(folder: Path) -> ctypes.CDLL:
    path, init = folder / "q31.so", folder / "init.c"
    init.write_text(INIT, encoding="utf-8")
    source, include = ROOT / "lib/src/rdpi_q31.c", ROOT / "lib/include"
    subprocess.run(["cc", "-std=c99", "-O1", "-fPIC", "-shared", "-I", include, source, init, "-o", path], check=True)
    return ctypes.CDLL(str(path))


def replay(lib: ctypes.CDLL, actuator: Actuator) -> list[tuple[int, ...]]:
    """Rows missed, reference, drive, rate, dac_code, flags."""
    arrays = {name: (ctypes.c_int32 * len(actuator.flat(name)))(*actuator.flat(name)) for name in ARRAYS}
    pointers = {name: ctypes.cast(array, ctypes.POINTER(ctypes.c_int32)) for name, array in arrays.items()}
    params, axis = Params(schema=8, digest=actuator.digest(), **actuator.numbers, **pointers), Axis()
    status = lib.init(ctypes.byref(axis), ctypes.byref(params), ctypes.c_uint32(actuator.sample_time_ns))
    if status != 0:
        sys.exit(f"{actuator.name}: rdpi_q31_init returns {status}")
    exact, rows = Exact(actuator), []
    for missed, reference in actuator.samples:
        lib.rdpi_q31_missed(ctypes.byref(axis), ctypes.c_uint32(missed))
        exact.missed += missed
        held = axis.drive
        drive = lib.rdpi_q31_step(ctypes.byref(axis), ctypes.c_int32(reference))
        rows.append((missed, reference, drive, axis.rate, axis.dac_code, axis.flags))
        if reference == NO_REFERENCE:
            assert drive == held and axis.flags == INPUT, f"{actuator.name}: not held"
            exact.missed += 1
            continue
        assert bool(axis.flags & MISSED) == (exact.missed > 0), f"{actuator.name}: missed samples wrongly flagged"
        rate, ideal = exact.step(reference)
        step = Fraction(actuator.numbers["max_drive"] - actuator.numbers["min_drive"],
                        2 ** actuator.numbers["dac_bits"] - 1) if actuator.numbers["dac_bits"] else Fraction(0)
        assert abs(drive - ideal) <= LIMIT + step / 2, f"{actuator.name}: drive {drive}, by definition {float(ideal)}"
        assert abs(axis.rate - rate * ONE) <= 64, f"{actuator.name}: rate {axis.rate}, by definition {rate * ONE}"
        exact.move(drive)
    return rows


# ---- the file ----


def wrapped(items: list[str]) -> str:
    lines: list[str] = []
    line = "   "
    for item in items:
        if len(line) + len(item) + 2 > 118:
            lines.append(line)
            line = "   "
        line += f" {item},"
    return "\n".join([*lines, line])


def literal(number: int) -> str:
    if number == NO_REFERENCE:
        return "INT32_MIN"
    return f"{number}{'ULL' if number >= 2**32 else 'u' if number >= 2**31 else ''}"


def table(kind: str, name: str, rows: list[tuple[int, ...]]) -> str:
    return f"static const {kind} {name}[] = {{\n" + wrapped(
        ["{" + ", ".join(map(literal, row)) + "}" for row in rows]) + "\n};\n"


def vectors(lib: ctypes.CDLL) -> str:
    text = ["/* Golden vectors of the fixed-point library, written by tests/golden/q31.py: do not edit. */",
            "#ifndef RDPI_GOLDEN_Q31_VECTORS_H", "#define RDPI_GOLDEN_Q31_VECTORS_H", "", '#include "rdpi/q31.h"', "",
            "/* One step: rdpi_q31_missed(missed), rdpi_q31_step(reference), and what it leaves. */",
            "typedef struct {",
            "    uint32_t missed;", "    int32_t reference;", "    int32_t drive;", "    int32_t rate;",
            "    uint32_t dac_code;", "    uint32_t flags;", "} golden_q31_sample_t;", "", "typedef struct {",
            "    const char *name;",
            "    rdpi_q31_params_t params;",
            "    uint32_t sample_time_ns;", "    const golden_q31_sample_t *sample;", "    size_t samples;",
            "} golden_q31_t;", ""]
    entries = []
    for k, actuator in enumerate(actuators()):
        rows = replay(lib, actuator)
        text.append(f"/* {actuator.name} */")
        text.append(table("rdpi_q31_play_t", f"golden_q31_play_{k}", actuator.play))
        text.append(table("rdpi_q31_deadzone_t", f"golden_q31_saturation_{k}", actuator.saturation))
        text.append(table("rdpi_q31_deadzone_t", f"golden_q31_inverse_{k}", actuator.inverse_saturation))
        if actuator.curve:
            text.append(table("rdpi_q31_line_t", f"golden_q31_curve_{k}", actuator.curve))
        memory = wrapped(list(map(literal, actuator.memory)))
        text.append(f"static const int32_t golden_q31_memory_{k}[] = {{\n{memory}\n}};\n")
        text.append(table("golden_q31_sample_t", f"golden_q31_sample_{k}", rows))
        fields = [".schema = RDPI_PARAMS_SCHEMA", f".digest = {actuator.digest():#010x}",
                  *(f".{name} = {literal(actuator.numbers[name])}" for name in NUMBERS),
                  f".play = golden_q31_play_{k}", f".saturation = golden_q31_saturation_{k}",
                  f".inverse_saturation = golden_q31_inverse_{k}", *([f".curve = golden_q31_curve_{k}"] if actuator.curve else []), f".memory = golden_q31_memory_{k}"]
        entries.append(f'    {{"{actuator.name}", {{\n{wrapped(fields)}\n'
                       f"    }}, {actuator.sample_time_ns}, golden_q31_sample_{k}, {len(rows)}}},")
    text.append("static const golden_q31_t golden_q31[] = {\n" + "\n".join(entries) + "\n};\n")
    text.append("#endif\n")
    return "\n".join(text)


def main() -> int:
    parser = argparse.ArgumentParser(description="Golden vectors of the fixed-point library")
    parser.add_argument("--check", action="store_true", help="compare with the file instead of writing it")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        text = vectors(library(Path(folder)))
    if not arguments.check:
        VECTORS.write_text(text)
    elif VECTORS.read_text() != text:
        print(f"{VECTORS} is not what the library gives")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
