"""Recordings made by habit instead of by plan: what people have who know nothing of sweeps. Nothing comes from rdpi.

    one = make_set("triggered", "duhem", seed=3)
    for take in one.fitted: take.command_V, take.reading_um      # what the person has; memory unknown
    for take in one.unseen: take.true_um                         # the same habit, and one after a decaying sweep

What a rig remembers before the first recorded sample is played, not stated: the rig's own sweep ends at 0 V, where the
amplifier is switched on; then the person tries some places, goes to where the habit starts, and rests or lets the
sine run. `played_V` holds all of that from the end of the sweep on, so whoever wants the true start states it as
"reset" and takes the past in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import asin, pi
from typing import NamedTuple
from zlib import crc32

import numpy as np
from rigs import CHAIN, Rig, make_rig
from waves import multisine, path

RATES_HZ = 1000.0, 2000.0, 5000.0  # samples per second, of a set
SCOPE_RATES_HZ = 500.0, 1000.0, 2000.0, 5000.0, 10_000.0  # of a scope's time bases
SCOPE_SAMPLES = 150  # that a period has at least, up to the fastest base
LACKING = 0.4  # share of the rigs that lack an effect of CHAIN; the rigs of make_rig have all
LONGEST_S = 2.0  # of a recording, unless that is less than LEAST_PERIODS
LEAST_PERIODS = 4
LEVEL = 0.6  # of the amplitude: triggers lie between this and its opposite, where a sine is fast
DAY_OFFSET = 0.25  # of the stroke, to both sides
REST_S = 0.5, 3.0


class Pace(NamedTuple):
    """How fast and how far one recording goes."""

    hz: float
    amplitude: float  # 1: as far as the range allows
    shape: str = "sine"


class Drive(NamedTuple):
    """Shares of the range: what is played before a recording, from the end of the rig's sweep on, and recorded."""

    past: np.ndarray
    recorded: np.ndarray


# A person records at a pace and a sample rate; what the generator draws differs from recording to recording.
Person = Callable[[Pace, float, np.random.Generator], Drive]
SHAPES: dict[str, Callable[[np.ndarray], np.ndarray]] = {  # of a phase; between -1 and 1
    "sine": np.sin,
    "triangle": lambda phase: 2 / pi * np.arcsin(np.sin(phase)),
    "two tones": lambda phase: (np.sin(phase) + 0.4 * np.sin(2.6 * phase)) / 1.4,
}
FASTEST_TONE = 2.6
LIFTED: dict[str, Callable[[np.ndarray], np.ndarray]] = {  # the same from their lowest point on; between 0 and 1
    "sine": lambda phase: (1 - np.cos(phase)) / 2,
    "triangle": lambda phase: np.arccos(np.cos(phase)) / pi,
    "two tones": lambda phase: (1.4 - np.cos(phase) - 0.4 * np.cos(2.6 * phase)) / 2.8,
}


@dataclass(eq=False, frozen=True)
class Take:
    """One recording, with what was played before it and what a perfect sensor would have read."""

    name: str
    rate_hz: float
    before: int  # samples that were played between the rig's sweep and the first recorded one; 0: memory is "reset"
    played_V: np.ndarray  # all since the sweep, as the following two
    read_um: np.ndarray
    passed_um: np.ndarray  # displacement: without noise, converter, and the sensor's offset of the day

    @property
    def memory(self) -> str:
        return "unknown" if self.before else "reset"

    @property
    def command_V(self) -> np.ndarray:
        return self.played_V[self.before:]

    @property
    def reading_um(self) -> np.ndarray:
        return self.read_um[self.before:]

    @property
    def true_um(self) -> np.ndarray:
        return self.passed_um[self.before:]


@dataclass(eq=False, frozen=True)
class Habitual:
    """What one person has of one rig, and what the person will want predicted."""

    habit: str
    rig: Rig
    fitted: tuple[Take, ...]
    unseen: tuple[Take, ...]


# --- how one gets to a start -----------------------------------------------------------------------------------------

def visits(to: float, off: float, rate_hz: float, random: np.random.Generator) -> np.ndarray:
    """From 0 V over up to three places, as one tries a set-up out. None: the actuator is on its way from rest."""
    count = int(random.integers(0, 4))
    times = np.cumsum([0.0, *random.uniform(0.1, 0.4, count + 2)])
    return path(rate_hz, times, [off, off, *random.random(count), to])


def rested(place: float, rate_hz: float, random: np.random.Generator) -> np.ndarray:
    return np.full(round(rate_hz * random.uniform(*REST_S)), place)


def periods_of(pace: Pace, least: float, most: float, random: np.random.Generator) -> float:
    return max(LEAST_PERIODS, min(random.uniform(least, most), LONGEST_S * pace.hz))


# --- habits: a person, drawn; `off` is the place of 0 V --------------------------------------------------------------

def triggered(off: float, random: np.random.Generator) -> Person:
    """A generator's sine runs; the scope starts at a level on its edge, and shows some periods."""
    middle, rises = random.uniform(0.45, 0.55), random.random() < 0.7

    def record(pace: Pace, rate_hz: float, random: np.random.Generator) -> Drive:
        half = pace.amplitude * min(middle, 1 - middle)
        level = asin(random.uniform(-LEVEL, LEVEL))
        ran = int(random.integers(5, 15)) + (level if rises else pi - level) / (2 * pi)
        before = round(ran / pace.hz * rate_hz)
        t = np.arange(before + round(random.uniform(3, 8) / pace.hz * rate_hz)) / rate_hz
        knob = np.minimum(t * pace.hz / 2, 1)  # somebody turns the amplitude up
        wave = middle + half * knob * SHAPES[pace.shape](2 * pi * pace.hz * t)
        return Drive(np.append(visits(middle, off, rate_hz, random), wave[:before]), wave[before:])

    return record


def grows(where: float, off: float, random: np.random.Generator) -> Person:
    """From rest at a place, cycle by cycle further: from an edge to one side, from the middle to both.

    Some show the rest and some trigger behind it. Some stop at the largest cycle, others let some more of it follow.
    """
    room = 1 - 2 * where if where in (0, 1) else min(where, 1 - where)
    rest_shown, goes_on = random.random() < 0.5, random.random() < 0.5

    def record(pace: Pace, rate_hz: float, random: np.random.Generator) -> Drive:
        periods = periods_of(pace, 6, 12, random)
        t = np.arange(round(periods / pace.hz * rate_hz)) / rate_hz
        growing = periods - random.uniform(1.5, 2.5) if goes_on else periods
        phase, grown = 2 * pi * pace.hz * t, pace.amplitude * np.minimum(pace.hz * t / growing, 1)
        if where in (0, 1):
            wave = where + room * grown * LIFTED[pace.shape](phase)
        else:
            wave = where + room * grown * SHAPES[pace.shape](phase)
        way, rest = visits(where, off, rate_hz, random), rested(where, rate_hz, random)
        return Drive(np.append(way, rest[:1]), np.append(rest[1:], wave)) if rest_shown else \
            Drive(np.append(way, rest), wave)

    return record


def edge(off: float, random: np.random.Generator) -> Person:
    return grows(float(random.random() < 0.25), off, random)


def middle(off: float, random: np.random.Generator) -> Person:
    return grows(random.uniform(0.42, 0.58), off, random)


def ramps(off: float, random: np.random.Generator) -> Person:
    """Small loops on slow ramps. Some begin at rest at the lower end; others log while the ramps go on."""
    at_rest = random.random() < 0.5

    def record(pace: Pace, rate_hz: float, random: np.random.Generator) -> Drive:
        small, loops = random.uniform(0.04, 0.1), int(random.integers(5, 12))
        before = 0 if at_rest else round(random.uniform(1, 2) / pace.hz * rate_hz)
        t = np.arange(before + round(random.uniform(1, 1.5) / pace.hz * rate_hz)) / rate_hz
        phase = 2 * pi * pace.hz * t
        slow, minor = 2 * LIFTED["triangle"](phase) - 1, SHAPES[pace.shape](loops * phase)
        wave = 0.5 + pace.amplitude * ((0.5 - small) * slow + small * minor)
        past = visits(wave[0], off, rate_hz, random)
        if at_rest:
            past = np.append(past, rested(wave[0], rate_hz, random))
        return Drive(np.append(past, wave[:before]), wave[before:])

    return record


def steps(off: float, random: np.random.Generator) -> Person:
    """Steps to levels with holds: a staircase up and down, or levels as they come; sharp or ramped.

    A pace's frequency is that of the levels. Its shape, if it is no sine, means levels as they come.
    """
    stairs, edge_s = random.random() < 0.5, random.choice([0.0, random.uniform(0.002, 0.01)])

    def record(pace: Pace, rate_hz: float, random: np.random.Generator) -> Drive:
        levels = np.linspace(0.0, 1.0, int(random.integers(5, 9)))
        if stairs and pace.shape == "sine":
            levels = np.concatenate([levels, levels[-2::-1]])
        else:
            levels = random.permutation(np.append(levels, random.random(3)))
        levels = 0.5 + pace.amplitude * (levels - 0.5)
        times = np.cumsum([0.0, *np.tile([1 / pace.hz - edge_s, max(edge_s, 1e-9)], len(levels))])[:-1]
        wave = path(rate_hz, times, np.repeat(levels, 2))
        return Drive(np.append(visits(levels[0], off, rate_hz, random), rested(levels[0], rate_hz, random)), wave)

    return record


def bipolar(off: float, random: np.random.Generator) -> Person:
    """Sines to both sides of 0 V, from rest there, at once at full amplitude."""

    def record(pace: Pace, rate_hz: float, random: np.random.Generator) -> Drive:
        t = np.arange(round(periods_of(pace, 4, 10, random) / pace.hz * rate_hz)) / rate_hz
        wave = off + 0.5 * pace.amplitude * SHAPES[pace.shape](2 * pi * pace.hz * t)
        return Drive(np.append(visits(off, off, rate_hz, random), rested(off, rate_hz, random)), wave)

    return record


def days(off: float, random: np.random.Generator) -> Person:
    """Triangles or sines from the lower end, a short rest before them; every day the sensor has another offset."""
    usual = random.choice(["sine", "triangle"])

    def record(pace: Pace, rate_hz: float, random: np.random.Generator) -> Drive:
        shape = usual if pace.shape == "sine" else pace.shape
        t = np.arange(round(periods_of(pace, 3, 6, random) / pace.hz * rate_hz)) / rate_hz
        wave = pace.amplitude * LIFTED[shape](2 * pi * pace.hz * t)
        way, rest = visits(0.0, off, rate_hz, random), rested(0.0, rate_hz, random)
        shown = round(random.uniform(0.05, 0.3) * rate_hz)
        return Drive(np.append(way, rest[shown:]), np.append(rest[:shown], wave))

    return record


class Habit(NamedTuple):
    person: Callable[[float, np.random.Generator], Person]
    slowest_hz: tuple[float, float]  # of a set's recordings; steps: levels per second; ramps: there and back
    fastest_hz: tuple[float, float]


HABITS: dict[str, Habit] = {
    "triggered": Habit(triggered, (1.5, 5), (20, 60)),
    "edge": Habit(edge, (2, 5), (20, 60)),
    "middle": Habit(middle, (2, 5), (20, 60)),
    "ramps": Habit(ramps, (0.3, 0.6), (0.8, 2)),
    "steps": Habit(steps, (3, 6), (8, 15)),
    "bipolar": Habit(bipolar, (1.5, 4), (15, 50)),
    "days": Habit(days, (1, 3), (8, 40)),
}


# --- sets ------------------------------------------------------------------------------------------------------------

def make_set(habit: str, family: str, seed: int) -> Habitual:
    """What a person of this habit has of a rig of this family: two to four recordings, and three unseen ones."""
    random = np.random.default_rng([seed, crc32(family.encode()), crc32(habit.encode())])
    rig = make_habit_rig(habit, family, seed, random)
    off = -rig.low_V / (rig.high_V - rig.low_V)
    person, rate_hz = HABITS[habit].person(off, random), float(random.choice(RATES_HZ))
    paces = draw_paces(HABITS[habit], random)

    def take(name: str, pace: Pace) -> Take:
        rate = scope_rate_hz(pace.hz) if habit == "triggered" else rate_hz
        offset_um = rig.stroke_um * random.uniform(-DAY_OFFSET, DAY_OFFSET) if habit == "days" else 0.0
        return play(rig, name, person(pace, rate, random), rate, offset_um)

    fitted = tuple(take(f"{pace.hz:.3g} Hz", pace) for pace in paces)
    unseen = [take(f"unseen {pace.shape} {pace.hz:.3g} Hz", pace) for pace in unseen_paces(paces, random)]
    shares = (np.concatenate([one.command_V for one in fitted]) - rig.low_V) / (rig.high_V - rig.low_V)
    wandered = wander(float(shares.min()), float(shares.max()), paces, rate_hz, random)
    return Habitual(habit, rig, fitted, (*unseen, play(rig, "unseen swept", Drive(wandered[:0], wandered), rate_hz)))


def make_habit_rig(habit: str, family: str, seed: int, random: np.random.Generator) -> Rig:
    """The rig of family and seed without some of CHAIN; for the habit "bipolar" with a range that 0 V halves."""
    rig = make_rig(family, seed).without(*(name for name in CHAIN if random.random() < LACKING))
    half_V = (rig.high_V - rig.low_V) / 2
    return replace(rig, low_V=-half_V, high_V=half_V) if habit == "bipolar" else rig


def draw_paces(habit: Habit, random: np.random.Generator) -> list[Pace]:
    """Two to four, from slow to fast; one of them, any, goes nearly all the way, the others less."""
    count = int(random.integers(2, 5))
    ends = [np.exp(random.uniform(*np.log(ends))) for ends in (habit.slowest_hz, habit.fastest_hz)]
    amplitudes = random.uniform(0.5, 1.0, count)
    amplitudes[random.integers(count)] = random.uniform(0.9, 1.0)
    return [Pace(float(hz), float(amplitude)) for hz, amplitude in zip(np.geomspace(*ends, count), amplitudes)]


def unseen_paces(paces: Sequence[Pace], random: np.random.Generator) -> list[Pace]:
    """The same shape between two recorded frequencies, and another shape; nothing faster or larger than recorded."""
    slow, fast = paces[0].hz, paces[-1].hz
    furthest = max(pace.amplitude for pace in paces)
    k = int(random.integers(1, len(paces)))
    other = str(random.choice(["triangle", "two tones"]))
    top = max(slow, fast / FASTEST_TONE)
    return [Pace(float(np.sqrt(paces[k - 1].hz * paces[k].hz)), furthest * random.uniform(0.6, 0.9)),
            Pace(float(np.exp(random.uniform(np.log(slow), np.log(top)))), furthest * random.uniform(0.7, 1.0), other)]


def wander(low: float, high: float, paces: Sequence[Pace], rate_hz: float, random: np.random.Generator) -> np.ndarray:
    """A multisine within what was recorded, faded in from the middle."""
    slow, fast = paces[0].hz, paces[-1].hz
    wave = multisine(rate_hz, max(1.5, 2 / slow), np.geomspace(slow, fast, 6), random)
    wave *= np.minimum(np.arange(len(wave)) / (0.15 * len(wave)), 1)
    return (low + high) / 2 + (high - low) / 2 * wave


def scope_rate_hz(hz: float) -> float:
    """The slowest time base that still shows a period well."""
    return next((rate for rate in SCOPE_RATES_HZ if rate >= SCOPE_SAMPLES * hz), SCOPE_RATES_HZ[-1])


def play(rig: Rig, name: str, drive: Drive, rate_hz: float, offset_um: float = 0.0) -> Take:
    command_V = np.round(rig.volts(np.append(*drive)), 6)
    reading_um = rig.run(command_V, rate_hz, "swept") + offset_um
    return Take(name, rate_hz, len(drive.past), command_V, reading_um, rig.true_um)
