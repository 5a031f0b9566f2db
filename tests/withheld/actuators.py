"""Virtual actuators for the withheld-effect check: command in volts to sensor reading in um, with effects put in.

Nothing here comes from rdpi, and the mathematics differ: the loops are Preisach operators by their Everett function, a
Bouc-Wen equation or a Duhem equation, creep is a spectrum of Kelvin-Voigt elements, the mechanics are a spring and a
mass, and all of it runs on a grid four times finer than the samples. A reading is taken at the end of its sample's
hold, so that sampling itself is no delay.

An effect is a `Put`: a name, a size from 0 up and what else it needs. Its size alone says how strong it is, so that one
search serves all effects; `Effect` names the largest size that makes sense and what the size means. No effect contains
another: a lag has unit gain at rest, a sensor curve no linear part, a wider loop the same ends.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import cos, exp, pi, sin
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np
from scipy.signal import cont2discrete, lfilter

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))
from bench_laws import BoucWen, Preisach  # noqa: E402

SUPPLY = 0.02  # of the range
FINER = 4  # steps of the simulation per sample
RATE_SCALE = 80.0  # half ranges per second: a triangle over the whole range at 20 Hz
BRANCH, STEP = np.linspace(-1, 1, 400, retstep=True)


# --- loops -----------------------------------------------------------------------------------------------------------

@dataclass
class PowerPreisach(Preisach):
    """Preisach operator whose loops open as a power of their height: sharper turns than the exponential density's."""

    power: float = 1.4

    def everett(self, high: float, low: float) -> float:
        return (1 + self.skew * (high + low) / 2) * (high - low) ** self.power


@dataclass
class Duhem:
    """Duhem equation dh/du = a sign(du) (u - h) + b, which has other rates of approach rising and falling.

    Its minor loops do not close, as no play's or Preisach operator's do.
    """

    rising: float = 2.5
    falling: float = 3.0
    stiffness: float = 0.3

    def __call__(self, u: np.ndarray) -> np.ndarray:
        du = np.diff(u, prepend=u[0])
        approach = np.where(du > 0, self.rising, self.falling)
        keep = np.exp(-approach * np.abs(du))
        pull = (1 - keep) * np.sign(du) * (self.stiffness - 1) / approach
        lag, result = 0.0, []
        for k, p in zip(keep.tolist(), pull.tolist()):
            lag = k * lag + p
            result.append(lag)
        return u + np.array(result)


def _preisach(shape: Mapping[str, float]) -> Callable[[np.ndarray], np.ndarray]:
    make = PowerPreisach if "power" in shape else Preisach
    return lambda u: make(rate_dependence=0.0, **shape).switch(u, 1.0)[1]


RAW_LOOPS: dict[str, Callable[[Mapping[str, float]], Callable[[np.ndarray], np.ndarray]]] = {
    "preisach": _preisach,
    "power-preisach": _preisach,
    "bouc-wen": lambda shape: lambda u: BoucWen(rate_dependence=0.0, **shape).internal(u, np.ones_like(u)),
    "duhem": lambda shape: Duhem(**shape),
}


class Loop:
    """A hysteresis operator as a loop of half width 1 about nothing, and a bow that is no hysteresis.

    The mean of the great loop's branches between u = -1 and 1 is taken out: scaling what is left changes the loop's
    width, and neither stroke nor mean curve. The bow is that mean without its straight line.
    """

    def __init__(self, kind: str, shape: Mapping[str, float]) -> None:
        self.raw = RAW_LOOPS[kind](shape)
        h = self.raw(np.concatenate([BRANCH, -BRANCH, BRANCH, -BRANCH]))[2 * len(BRANCH):]
        rising, falling = h[:len(BRANCH)], h[:len(BRANCH) - 1:-1]
        mean = (rising + falling) / 2
        self.half_width = (np.interp(0, BRANCH, falling) - np.interp(0, BRANCH, rising)) / 2
        # straight on for the little that an amplifier overshoots
        self.mean = mean[0] - 0.2 * (mean[1] - mean[0]) / STEP, *mean, mean[-1] + 0.2 * (mean[-1] - mean[-2]) / STEP
        self.line = (mean[-1] + mean[0]) / 2, (mean[-1] - mean[0]) / 2

    def __call__(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Loop and bow, for u after u, the first value being where it all begins."""
        mean = np.interp(u, (-1.2, *BRANCH, 1.2), self.mean)
        return (self.raw(u) - mean) / self.half_width, (mean - self.line[0] - self.line[1] * u) / self.half_width


# --- machine, recordings, effects ------------------------------------------------------------------------------------

@dataclass
class Machine:
    """One actuator with amplifier and sensor. Volts, um, seconds; shares are of the stroke."""

    kind: str = "preisach"
    shape: dict[str, float] = field(default_factory=dict)
    sample_rate_hz: float = 1000.0
    held: bool = False  # whether the command is a staircase; else it is played finer than it is recorded
    low_V: float = 0.0
    high_V: float = 100.0
    stroke_um: float = 15.0
    width: float = 0.12  # of the loop
    curve: float = 0.03
    rate_law: float = 0.0  # growth of the width at RATE_SCALE
    rate_power: float = 0.7
    amplifier_hz: float = 2000.0
    amplifier_damping: float = 0.7
    creep: float = 0.002  # share per decade
    creep_power: float = 0.0
    offset_um: float = 2.0
    noise: float = 2e-4  # white, share
    flicker: float = 1e-4  # 1/f, share
    unrest: float = 0.0  # spread from run to run of drift and of gain: room and actuator are never quite the same
    adc_bits: int = 16
    monitor: bool = False

    @property
    def step_s(self) -> float:
        return 1 / (FINER * self.sample_rate_hz)

    @cached_property
    def loop(self) -> Loop:
        return Loop(self.kind, self.shape)


@dataclass
class Run:
    """What a recording is made with: the command, what came before it, the neighbouring axis, whether it was swept."""

    kind: str
    command_V: np.ndarray
    other_axis_V: np.ndarray
    past_V: np.ndarray  # turning points before the first sample
    reset: bool  # said to have been swept
    seed: int
    cache: dict[object, np.ndarray] = field(default_factory=dict, repr=False)

    def random(self, what: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, crc32(what.encode())])


class Put(NamedTuple):
    """An effect as it is put in. `where` says at which of its places, `form` is a number in 0..1 that shapes it."""

    name: str
    size: float
    where: str = ""
    form: float = 0.5


class Effect(NamedTuple):
    largest: float
    size: str  # what the size means
    places: tuple[str, ...] = ("",)


IN_CATALOGUE: dict[str, Effect] = {
    "delay": Effect(0.03, "s", ("command", "sensor")),
    "lag": Effect(0.03, "time constant, s", ("amplifier", "sensor")),
    "slew_limit": Effect(2.0, "s per range"),
    "rail_saturation": Effect(0.6, "share of the range cut off", ("top", "bottom", "both")),
    "quantisation": Effect(0.2, "step, share of the range", ("dac", "sensor")),
    "rate_dependence": Effect(4.0, "added growth of the width at RATE_SCALE"),
    "hysteresis_change": Effect(1.0, "change of the width, share", ("wider", "narrower")),
    "creep": Effect(0.15, "added share per decade"),
    "gain_change": Effect(0.5, "share", ("more", "less")),
    "initial_memory": Effect(1.0, "excursion before the run, share of what is left of the range"),
    "static_nonlinearity": Effect(0.5, "share of the stroke", ("sensor",)),
    "thermal_drift": Effect(2.0, "share of the stroke"),
    "resonance": Effect(0.05, "period, s"),
    "backlash": Effect(0.3, "share of the stroke"),
    "periodic_disturbance": Effect(1.0, "amplitude, share of the stroke"),
    "cross_coupling": Effect(1.0, "share of the stroke over the neighbour's range"),
}
OUT_OF_CATALOGUE: dict[str, Effect] = {
    "dead_band": Effect(0.5, "share of the range around its middle in which the amplifier gives half"),
    "stick_slip": Effect(0.5, "height of the jumps, share of the stroke"),
    "spikes": Effect(2.0, "height, share of the stroke"),
    "gain_wobble": Effect(0.9, "amplitude, share"),
    "delay_wobble": Effect(0.02, "amplitude, s"),
    "dropouts": Effect(0.9, "share of the time in which the sensor repeats its last reading"),
    "noise_bursts": Effect(2.0, "rms in a burst, share of the stroke"),
    "sensor_hysteresis": Effect(0.5, "width, share of the stroke"),
}
EFFECTS = IN_CATALOGUE | OUT_OF_CATALOGUE
BEFORE_STRAIN = {"delay", "lag", "slew_limit", "rail_saturation", "quantisation", "rate_dependence",
                 "hysteresis_change", "initial_memory", "dead_band"}


# --- the chain -------------------------------------------------------------------------------------------------------

def simulate(machine: Machine, run: Run, effects: Sequence[Put] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Amplifier output in V and sensor input's reading in um, one per sample, without noise and grid of the sensor."""
    puts = {put.name: put for put in effects}
    early = tuple(put for put in effects if put.name in BEFORE_STRAIN and put.where != "sensor")
    if early not in run.cache:
        volts = _amplifier(machine, run, puts)
        run.cache[early] = np.array([volts, _strain(machine, run, volts, puts)])
    volts, strain = run.cache[early]
    moved = _mechanics(machine, run, strain, puts)
    return volts[FINER - 1::FINER], _sensor(machine, run, moved, puts)


def record(machine: Machine, run: Run, effects: Sequence[Put] = (), seed: int = 0) -> dict[str, np.ndarray]:
    """Columns of a recording. `seed` draws the noise: the same run recorded again has another."""
    # The converter rounds last, what noise there is before it included.
    coarse = [put for put in effects if put.name == "quantisation" and put.where == "sensor"]
    monitor, reading = simulate(machine, run, [put for put in effects if put not in coarse])
    random = np.random.default_rng([run.seed, seed, 1])
    n, stroke = len(reading), machine.stroke_um
    drift, gain = machine.unrest * random.standard_normal(2)
    reading = reading + drift * stroke * np.linspace(0, 1, n) + gain * (reading - np.mean(reading))
    reading = reading + stroke * (machine.noise * random.standard_normal(n)
                                  + machine.flicker * (flicker(n, random) + random.standard_normal()))
    step = max([2 * stroke / 2**machine.adc_bits, *(put.size * stroke for put in coarse)])
    reading = step * np.round(reading / step)
    range_V = machine.high_V - machine.low_V
    columns = {"time_s": np.arange(n) / machine.sample_rate_hz, "command_V": run.command_V,
               "displacement_um": np.round(reading, 6), "other_axis_V": run.other_axis_V}
    if machine.monitor:
        step = 1.2 * range_V / 2**16
        monitor = monitor + 2e-5 * range_V * random.standard_normal(n)
        columns["monitor_V"] = np.round(step * np.round(monitor / step), 5)
    return columns


def flicker(n: int, random: np.random.Generator) -> np.ndarray:
    """Noise whose power falls as 1/f, of unit standard deviation."""
    frequency = np.arange(n // 2 + 1)
    lines = random.standard_normal((2, len(frequency))) / np.sqrt(np.maximum(frequency, 1))
    lines[:, 0] = 0
    noise = np.fft.irfft(lines[0] + 1j * lines[1], n)
    return noise / np.std(noise)


def played(machine: Machine, command_V: np.ndarray, delay_s: float) -> np.ndarray:
    """The command on the fine grid, late by any time: a straight line from sample to sample, or a staircase.

    Of the staircase every value is its mean over a step, so that what follows sees any delay.
    """
    late = delay_s / machine.step_s
    if not machine.held:
        sample = (np.arange(FINER * len(command_V)) - (FINER - 1) - late) / FINER
        return np.interp(sample, np.arange(len(command_V)), command_V)
    stairs = np.repeat(command_V, FINER)
    whole = int(late)
    padded = np.concatenate([np.full(whole + 1, stairs[0]), stairs])[:len(stairs) + 1]
    return (1 - (late - whole)) * padded[1:] + (late - whole) * padded[:-1]


def second_order(signal: np.ndarray, frequency_hz: float, damping: float, step_s: float, method: str) -> np.ndarray:
    """Unit gain at rest; from rest at the first value."""
    w = 2 * pi * frequency_hz
    b, a, _ = cont2discrete(([w * w], [1, 2 * damping * w, w * w]), step_s, method)
    return signal[0] + lfilter(b[0], a, signal - signal[0])


def first_order(signal: np.ndarray, time_constant_s: float, step_s: float, held: bool) -> np.ndarray:
    """Lag of unit gain, exact for a signal that is held within each step, or straight within each step."""
    if time_constant_s <= 0:
        return signal
    q = step_s / time_constant_s
    keep = exp(-q)
    b = [1 - keep, 0] if held else [1 - (1 - keep) / q, (1 - keep) / q - keep]
    return signal[0] + lfilter(b, [1, -keep], signal - signal[0])


def shift(signal: np.ndarray, delay_steps: np.ndarray | float) -> np.ndarray:
    """Delayed by interpolation; what lies before the first value equals it."""
    grid = np.arange(len(signal))
    return np.interp(grid - delay_steps, grid, signal)


def _amplifier(machine: Machine, run: Run, puts: Mapping[str, Put]) -> np.ndarray:
    step_s, range_V = machine.step_s, machine.high_V - machine.low_V
    command = run.command_V
    if (put := puts.get("quantisation")) and put.where == "dac" and put.size > 0:
        step = put.size * range_V
        command = machine.low_V + step * np.round((command - machine.low_V) / step)
    put = puts.get("delay")
    volts = played(machine, command, put.size if put and put.where == "command" else 0.0)
    if (put := puts.get("slew_limit")) and put.size > 0:
        most, now, limited = range_V / put.size * step_s, float(volts[0]), []
        for target in volts.tolist():
            now = now + min(max(target - now, -most), most)
            limited.append(now)
        volts = np.array(limited)
    if (put := puts.get("lag")) and put.where == "amplifier":
        volts = first_order(volts, put.size, step_s, machine.held)
    volts = second_order(volts, machine.amplifier_hz, machine.amplifier_damping, step_s,
                         "zoh" if machine.held else "foh")
    # The supply ends a little beyond the range: an overshoot, but no more.
    volts = np.clip(volts, machine.low_V - SUPPLY * range_V, machine.high_V + SUPPLY * range_V)
    if put := puts.get("rail_saturation"):
        cut = put.size * range_V * (0.5 if put.where == "both" else 1.0)
        volts = np.clip(volts, machine.low_V + cut if put.where != "top" else -np.inf,
                        machine.high_V - cut if put.where != "bottom" else np.inf)
    if (put := puts.get("dead_band")) and put.size > 0:
        # steeper outside by as much as it is flatter inside: the ends stay where they are
        middle, half = machine.low_V + range_V * (0.35 + 0.3 * put.form), put.size * range_V / 2
        volts = machine.low_V + (volts - machine.low_V - (half + np.clip(volts - middle, -half, half)) / 2) / (
            1 - put.size / 2)
    return volts


def _strain(machine: Machine, run: Run, volts: np.ndarray, puts: Mapping[str, Put]) -> np.ndarray:
    """Displacement in um that the loop and the curve make of the voltage."""
    def normal(v: np.ndarray) -> np.ndarray:
        return (2 * v - machine.low_V - machine.high_V) / (machine.high_V - machine.low_V)

    past = normal(run.past_V)
    if (put := puts.get("initial_memory")) and put.size > 0:
        start = normal(volts[:1])
        end = 1.0 if put.form < 0.5 else -1.0
        past = np.concatenate([past, start + put.size * (end - start)])
    u = normal(volts)
    bent, bow = (part[len(past):] for part in machine.loop(np.concatenate([past, u])))
    width = 1.0
    if put := puts.get("hysteresis_change"):
        width = 1 + put.size if put.where == "wider" else 1 / (1 + put.size)
    growth = machine.rate_law + (puts["rate_dependence"].size if "rate_dependence" in puts else 0.0)
    if growth > 0:
        rate = np.abs(np.diff(u, prepend=u[0])) / machine.step_s / RATE_SCALE
        rate = first_order(rate / (1 + rate / 4), 1e-3, machine.step_s, held=True)
        bent = bent * (1 + growth * np.maximum(rate, 0) ** machine.rate_power)
    return machine.stroke_um / 2 * (u + machine.curve * (1 - u**2) + machine.width * (bow + width * bent))


def creep(machine: Machine, run: Run, moved: np.ndarray, per_decade: float) -> np.ndarray:
    """What Kelvin-Voigt elements add, two per decade from 30 ms to 1000 s, weighted as a power of time.

    A swept run starts at rest; another was elsewhere some seconds ago.
    """
    coarse = moved[FINER - 1::FINER]
    random = run.random("creep")
    away = 0.0 if run.reset else random.uniform(-0.4, 0.4) * machine.stroke_um
    rest_s = random.uniform(2, 20)
    added = np.zeros_like(coarse)
    for time_s in 10.0 ** np.arange(-1.5, 3.1, 0.5):
        keep = exp(-1 / (machine.sample_rate_hz * time_s))
        start = coarse[0] + away * exp(-rest_s / time_s)
        follower, _ = lfilter([1 - keep], [1, -keep], coarse, zi=[keep * start])
        added += per_decade / 2 * time_s**machine.creep_power * follower
    return np.interp(np.arange(len(moved)), np.arange(FINER - 1, len(moved), FINER), added)


def _mechanics(machine: Machine, run: Run, strain: np.ndarray, puts: Mapping[str, Put]) -> np.ndarray:
    stroke = machine.stroke_um
    gain = 1.0
    if put := puts.get("gain_change"):
        gain = 1 + put.size if put.where == "more" else 1 / (1 + put.size)
    moved = gain * strain
    per_decade = machine.creep + (puts["creep"].size if "creep" in puts else 0.0)
    if per_decade > 0:
        moved = moved + creep(machine, run, moved, per_decade)
    if (put := puts.get("gain_wobble")) and put.size > 0:
        time = np.arange(len(moved)) * machine.step_s
        moved = moved * (1 + put.size * np.sin(2 * pi * (0.3 * time + run.random(put.name).random())))
    if (put := puts.get("resonance")) and put.size > 3 / machine.sample_rate_hz:
        damping = 0.015 * 10**put.form  # 0.015 to 0.15
        moved = second_order(moved, 1 / put.size, damping, machine.step_s, "foh")
    if (put := puts.get("backlash")) and put.size > 0:
        half = put.size * stroke / 2
        at = float(moved[0]) + half * run.random(put.name).uniform(-1, 1)
        dragged = []
        for x in moved.tolist():
            at = at if x - half < at < x + half else (x - half if at <= x - half else x + half)
            dragged.append(at)
        moved = np.array(dragged)
    if (put := puts.get("stick_slip")) and put.size > 0:
        # a jump each time that a random length of way has been made, and back to the middle in the mean
        random = run.random(put.name)
        way = np.cumsum(np.abs(np.diff(moved, prepend=moved[0]))) / stroke
        marks = np.cumsum(random.exponential(0.4, 4 + int(way[-1] / 0.2)))
        heights = np.concatenate([[0.0], random.uniform(-1, 1, len(marks))])
        moved = moved + put.size * stroke * heights[np.searchsorted(marks, way)]
    return moved


def _sensor(machine: Machine, run: Run, moved: np.ndarray, puts: Mapping[str, Put]) -> np.ndarray:
    """Environment and sensor; the reading at the end of each sample's hold."""
    stroke, step_s = machine.stroke_um, machine.step_s
    fine_s = np.arange(len(moved)) * step_s
    if put := puts.get("periodic_disturbance"):
        frequency = 28 * 4**put.form  # 28 to 112 Hz
        moved = moved + put.size * stroke * np.sin(2 * pi * (frequency * fine_s + run.random(put.name).random()))
    if put := puts.get("thermal_drift"):
        # the beginning of an exponential approach: heating or cooling that differs from run to run
        random = run.random(put.name)
        end = random.choice([-1, 1]) * random.uniform(0.5, 1.5)
        moved = moved + put.size * stroke * end * -np.expm1(-fine_s / (fine_s[-1] * (1 + 3 * put.form)))
    if put := puts.get("cross_coupling"):
        other = np.repeat(run.other_axis_V, FINER) / 100
        moved = moved + put.size * stroke * other
    if (put := puts.get("sensor_hysteresis")) and put.size > 0:
        moved = moved + put.size * stroke / 2 * Loop("duhem", {})(2 * moved / stroke)[0]
    if (put := puts.get("static_nonlinearity")) and put.size > 0:
        x = 2 * moved / stroke
        angle = 2 * pi * put.form
        moved = moved + put.size * stroke * (cos(angle) * (3 * x**2 - 1) / 2 + sin(angle) * (5 * x**3 - 3 * x) / 2)
    if (put := puts.get("lag")) and put.where == "sensor":
        moved = first_order(moved, put.size, step_s, held=False)
    if (put := puts.get("delay")) and put.where == "sensor":
        moved = shift(moved, put.size / step_s)
    if put := puts.get("delay_wobble"):
        moved = shift(moved, put.size / step_s * np.sin(2 * pi * (0.7 * fine_s + run.random(put.name).random())))
    reading = machine.offset_um + stroke / 2 + moved[FINER - 1::FINER]
    n = len(reading)
    if (put := puts.get("quantisation")) and put.where == "sensor" and put.size > 0:
        reading = put.size * stroke * np.round(reading / (put.size * stroke))
    if put := puts.get("spikes"):
        random = run.random(put.name)
        hit = random.random(n) < 0.004
        reading = reading + put.size * stroke * hit * random.choice([-1, 1], n) * random.uniform(0.5, 1, n)
    if put := puts.get("noise_bursts"):
        random = run.random(put.name)
        length = max(1, round(0.15 * machine.sample_rate_hz))
        on = np.repeat(random.random(n // length + 1) < 0.2, length)[:n]
        reading = reading + put.size * stroke * on * random.standard_normal(n)
    if (put := puts.get("dropouts")) and put.size > 0:
        length = max(2, round(0.03 * machine.sample_rate_hz))
        frozen = np.repeat(run.random(put.name).random(n // length + 1) < put.size, length)[:n]
        frozen[0] = False
        reading = reading[np.maximum.accumulate(np.where(frozen, 0, np.arange(n)))]
    return reading


# --- waveforms -------------------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Form:
    """What differs between the set to tune on and the set to report on: machines and waveforms."""

    kinds: tuple[str, ...]
    rates_hz: tuple[float, ...]
    widths: tuple[float, float]
    curves: tuple[float, float]
    saw_hz: tuple[float, float]  # slowest and fastest triangle, before a spread of 20 %
    lines_hz: tuple[float, float]  # of multisines
    hold_s: tuple[float, float]
    edge_s: tuple[float, float]
    small: tuple[float, float]  # half amplitude of the small multisine, share of the range


FORMS = {
    "tune": Form(("preisach", "bouc-wen", "duhem"), (1000.0, 1600.0), (0.08, 0.14), (-0.03, 0.03), (0.9, 12.0),
                 (0.7, 40.0), (0.45, 0.75), (0.004, 0.010), (0.06, 0.12)),
    "report": Form(("power-preisach", "bouc-wen", "duhem", "preisach"), (1250.0, 2000.0), (0.06, 0.16), (-0.05, 0.05),
                   (0.6, 15.0), (0.5, 55.0), (0.35, 0.9), (0.003, 0.015), (0.05, 0.15)),
}
RICH = ("saw", "steps", "decay", "small", "two", "minor")
POOR = ("track", "sine")


def make_machine(form: Form, index: int, random: np.random.Generator) -> Machine:
    """The index walks through kinds, monitor and rate law, each in its own step, so that small sets hold all."""
    kind = form.kinds[index % len(form.kinds)]
    shapes = {
        "preisach": lambda: {"spread": random.uniform(0.7, 2.5), "skew": random.uniform(-0.4, 0.4)},
        "power-preisach": lambda: {"power": random.uniform(1.3, 1.7), "skew": random.uniform(-0.3, 0.3)},
        "bouc-wen": lambda: {"length": random.uniform(0.4, 0.8), "power": random.uniform(1.1, 1.6),
                             "skew": random.uniform(-0.25, 0.25)},
        "duhem": lambda: {"rising": (a := random.uniform(2.0, 3.5)), "falling": a * random.uniform(0.8, 1.25)},
    }
    noise = 10 ** random.uniform(-4, -3)
    low_V = random.choice([0.0, -20.0])
    return Machine(
        kind=kind, shape=shapes[kind](), sample_rate_hz=float(random.choice(form.rates_hz)),
        held=bool(random.random() < 0.25), low_V=low_V, high_V=float(random.choice([100.0, 120.0, 150.0])),
        stroke_um=random.uniform(10, 40), width=random.uniform(*form.widths), curve=random.uniform(*form.curves),
        rate_law=0.0 if index % 5 in (2, 3) else random.uniform(0.1, 0.4), rate_power=random.uniform(0.5, 1.0),
        amplifier_hz=random.uniform(1500, 4000), amplifier_damping=random.uniform(0.6, 1.0),
        creep=random.uniform(0, 0.004), creep_power=random.uniform(-0.05, 0.05), offset_um=random.uniform(0, 5),
        noise=noise, flicker=noise * random.uniform(0.2, 1.0), unrest=10 ** random.uniform(-4.0, -3.3),
        monitor=(index + index // len(form.kinds)) % 2 == 1)


def make_run(kind: str, machine: Machine, form: Form, seed: int, reset: bool = True) -> Run:
    """A run of a kind of WAVES. Swept runs end a decaying sweep at their first voltage; others come from anywhere."""
    random = np.random.default_rng([seed, 7])
    scale = np.sqrt(1000.0 / machine.sample_rate_hz)  # shorter at higher rates: not that many more samples
    share = np.clip(WAVES[kind](machine.sample_rate_hz, scale, form, random), 0, 1)
    # A sweep erases the memory only if it decays from both sides: it ends in the middle, as those of `rdpi excite` do.
    way = np.linspace(0.5, share[0], round(0.1 * machine.sample_rate_hz), endpoint=False)
    share = np.concatenate([np.full(8, 0.5), way, share])
    range_V = machine.high_V - machine.low_V
    command = np.round(machine.low_V + range_V * share, 5)
    if reset:
        left = np.linspace(1, 0, 40, endpoint=False) * np.tile([1, -1], 20)
        past = command[0] + left * np.where(left > 0, machine.high_V - command[0], command[0] - machine.low_V)
    else:
        past = machine.low_V + range_V * random.random(6)
    moves = _moves(machine.sample_rate_hz, len(command) / machine.sample_rate_hz, (0.3, 1.2), 0.2, random)
    return Run(kind, command, np.round(100 * moves[:len(command)], 5), past, reset, seed)


def _path(rate_hz: float, times_s: Sequence[float], values: Sequence[float]) -> np.ndarray:
    return np.interp(np.arange(int(times_s[-1] * rate_hz)) / rate_hz, times_s, values)


def _moves(rate_hz: float, duration_s: float, each_s: tuple[float, float], rest_s: float,
           random: np.random.Generator) -> np.ndarray:
    """Smooth moves between random places in 0..1 with rests between them; at least `duration_s`."""
    pieces, at, count = [], random.random(), 0
    while count < duration_s * rate_hz:
        to = random.random()
        n = int(rate_hz * random.uniform(*each_s))
        s = np.arange(1, n + 1) / n
        pieces += [at + (to - at) * s**3 * (10 - 15 * s + 6 * s**2),
                   np.full(int(rate_hz * rest_s * random.random()), to)]
        count, at = count + len(pieces[-1]) + n, to
    return np.concatenate(pieces)


def _sines(rate_hz: float, duration_s: float, form: Form, random: np.random.Generator) -> np.ndarray:
    """Multisine between -1 and 1, amplitudes falling as 1/sqrt(f)."""
    t = np.arange(int(duration_s * rate_hz)) / rate_hz
    wave = sum(np.sin(2 * pi * (f * t + random.random())) / np.sqrt(f)
               for f in np.geomspace(*form.lines_hz, 12) * random.uniform(0.9, 1.1, 12))
    return wave / np.abs(wave).max()


def _saw(rate_hz: float, scale: float, form: Form, random: np.random.Generator) -> np.ndarray:
    times, values = [0.0], [0.0]
    for f in np.geomspace(*form.saw_hz, 4) * random.uniform(0.8, 1.2, 4):
        for _ in range(max(1, round(1.2 * scale * f))):
            times += [times[-1] + 0.5 / f, times[-1] + 1 / f]
            values += [1.0, 0.0]
    return _path(rate_hz, times, values)


def _steps(rate_hz: float, scale: float, form: Form, random: np.random.Generator) -> np.ndarray:
    levels = np.concatenate([[0.0], random.permutation(np.linspace(0, 1, 7))])
    times, values = [], []
    at = 0.0
    for level in levels:
        times += [at, at + 1.5 * scale * random.uniform(*form.hold_s)]
        values += [level, level]
        at = times[-1] + random.uniform(*form.edge_s)
    return _path(rate_hz, times, values)


def _decay(rate_hz: float, scale: float, form: Form, random: np.random.Generator) -> np.ndarray:
    t = np.arange(int(3.5 * scale * rate_hz)) / rate_hz
    wave = 0.5 + 0.5 * (1 - t / t[-1]) * np.sin(2 * pi * random.uniform(3, 6) * t)
    return wave if random.random() < 0.5 else wave[::-1]  # growing, it keeps what was before it to the end


def _small(rate_hz: float, scale: float, form: Form, random: np.random.Generator) -> np.ndarray:
    bias = random.uniform(0.3, 0.7)
    return bias + random.uniform(*form.small) * _sines(rate_hz, 4 * scale, form, random)


def _two(rate_hz: float, scale: float, form: Form, random: np.random.Generator) -> np.ndarray:
    wave = _sines(rate_hz, 2.5 * scale, form, random)
    small = random.uniform(0.25, 0.4) * _sines(rate_hz, 2.5 * scale, form, random)
    bridge = np.linspace(wave[-1], small[0], int(0.1 * rate_hz))
    return 0.5 + 0.5 * np.concatenate([wave, bridge, small])


def _minor(rate_hz: float, scale: float, form: Form, random: np.random.Generator) -> np.ndarray:
    speed = random.uniform(2, 5) / scale  # ranges per second
    values = [0.0, 1.0]
    for _ in range(14):
        away = random.uniform(0.1, 0.6)
        turn = np.clip(values[-1] + (away if values[-1] < 0.5 else -away), 0, 1)
        values += [turn, np.clip(values[-1] + random.uniform(-0.1, 0.1), 0, 1)]
    values += [1.0, 0.0]
    return _path(rate_hz, np.concatenate([[0], np.cumsum(np.abs(np.diff(values)) / speed)]), values)


def _track(rate_hz: float, scale: float, form: Form, random: np.random.Generator) -> np.ndarray:
    return _moves(rate_hz, 4 * scale, (0.06, 0.4), 0.15, random)


def _sine(rate_hz: float, scale: float, form: Form, random: np.random.Generator) -> np.ndarray:
    t = np.arange(int(4 * scale * rate_hz)) / rate_hz
    return 0.5 - random.uniform(0.35, 0.5) * np.cos(2 * pi * random.uniform(0.8, 2.5) * t)


WAVES: dict[str, Callable[..., np.ndarray]] = {
    "saw": _saw, "steps": _steps, "decay": _decay, "small": _small, "two": _two, "minor": _minor, "track": _track,
    "sine": _sine,
}
