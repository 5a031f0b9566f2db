"""Virtual rigs: command in volts to sensor reading in um, with the ordinary sins of real rigs. Nothing comes from rdpi.

    rig = make_rig("duhem", seed=3)
    reading_um = rig.run(command_V, 10_000.0)           # after the rig's own decaying sweep
    plain = rig.without("delay", "lag")                 # exactly the same rig without these sins
    rig.truth["lag"]                                    # {"time_constant_s": 0.00031}

The chain: DAC, delay, lag, overshoot, input curve, loop with rate dependence and static curve, relaxation, creep,
resonance, noise, ADC. It runs on a grid at least four times finer than the samples. Sampling itself is no delay:

* Without the sin "hold" the drive is a straight line from command to command. A reading is taken where the line reaches
  its command, so delay and lag have their true sizes to a small part of a sample.
* With "hold" the drive is a staircase. A reading is taken in the middle of its command's hold. A delay of less than
  half a sample is then invisible unless something smooths the steps.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import ceil, pi
from pathlib import Path
from zlib import crc32

import numpy as np
from loops import FAMILIES, WIPE_OUT, Operator
from scipy.signal import cont2discrete, lfilter
from sealed import SEALED

Signal = Callable[[np.ndarray], np.ndarray]
Sins = Mapping[str, Mapping[str, float]]

FINEST_S = 50e-6  # longest step of the simulation
LEAST_STEPS = 4  # per sample
WIDTHS = 0.05, 0.20  # of great loops, share of the stroke
DRIFTING = 0.05, 0.10  # likewise, of families whose minor loops drift: wider ones would drift as no piezo stack does
SUPPLY = 0.02  # of the range: the amplifier's supply ends that far beyond it
CREEP_S = 0.025, 1000.0  # shortest and longest time constant of the creep
CREEP_PER_DECADE = 2.5  # elements
RATE_S = 1e-3  # the loop's width follows the rate with this time constant
RATE_SCALE = 40.0  # half ranges per second: a triangle over the whole range at 10 Hz
BRANCH = np.linspace(-1, 1, 401)


# --- sins ------------------------------------------------------------------------------------------------------------

def _log(random: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _relaxation(random: np.random.Generator) -> dict[str, float]:
    slow = random.random() < 0.2
    return {"share": random.uniform(0.02, 0.08),
            "time_constant_s": _log(random, 5e-3, 2e-2) if slow else _log(random, 3e-4, 5e-3)}


def _rate(random: np.random.Generator) -> dict[str, float]:
    return {"growth": random.uniform(0.05, 0.25), "form": float(random.integers(len(RATE_FORMS))),
            "power": random.uniform(0.4, 0.8)}


# Parameters of each sin, drawn; in the chain's order.
SINS: dict[str, Callable[[np.random.Generator], dict[str, float]]] = {
    "dac": lambda random: {"bits": 16},
    "hold": lambda random: {},
    "delay": lambda random: {"delay_s": _log(random, 5e-5, 1e-3)},
    "lag": lambda random: {"time_constant_s": _log(random, 5e-5, 1e-3)},
    "overshoot": lambda random: {"f0_hz": _log(random, 2000, 6000), "damping": random.uniform(0.62, 0.85)},
    "input_curve": lambda random: {"quadratic": random.uniform(-0.06, 0.06), "cubic": random.uniform(-0.08, 0.08)},
    "rate": _rate,
    "relaxation": _relaxation,
    "creep": lambda random: {"percent_per_decade": random.uniform(0.5, 2.0), "power": random.uniform(-0.08, 0.08)},
    "resonance": lambda random: {"f0_hz": _log(random, 200, 2000), "damping": _log(random, 0.01, 0.08)},
    "edge_start": lambda random: {"share": float(random.random() < 0.25)},
    "noise": lambda random: {"white": _log(random, 5e-5, 3e-4), "flicker": _log(random, 3e-5, 2e-4)},
    "adc": lambda random: {"bits": 16},
}
# What has no name in rdpi. No rig has it unless it is put in.
STRANGE: dict[str, Callable[[np.random.Generator], dict[str, float]]] = {
    "leakage": lambda random: {"share": random.uniform(0.05, 0.2), "time_constant_s": _log(random, 0.3, 3)},
    "softening": lambda random: {"share": random.uniform(0.04, 0.12), "time_constant_s": _log(random, 0.3, 3)},
    "settling": lambda random: {"share": random.uniform(0.03, 0.08), "time_constant_s": _log(random, 0.1, 1)},
    "second_resonance": lambda random: {"share": random.uniform(0.1, 0.4), "f0_hz": _log(random, 80, 300),
                                        "damping": _log(random, 0.01, 0.08)},
    "stick_slip": lambda random: {"share": random.uniform(0.015, 0.05)},
    "dropouts": lambda random: {"per_s": random.uniform(2, 8), "hold_s": _log(random, 0.005, 0.03)},
}
# What stands between the displacement and the reading. No rig has it unless it is put in.
SENSOR: dict[str, Callable[[np.random.Generator], dict[str, float]]] = {
    "sensor_delay": lambda random: {"delay_s": _log(random, 1e-4, 1e-3)},
    "sensor_lag": lambda random: {"time_constant_s": _log(random, 1e-4, 1e-3)},
}
EVERY = SINS | STRANGE | SENSOR
SOME = {"hold": 0.25, "rate": 0.5, "edge_start": 0.4}  # share of the rigs that have the sin; all have the others
CHAIN = "delay", "lag", "overshoot", "relaxation", "creep", "resonance"  # what has a memory in time
RATE_FORMS: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {  # growth of the width over rate / RATE_SCALE
    "power": lambda rate, power: rate**power,
    "logarithm": lambda rate, power: np.log10(1 + 10 * rate),
    "saturating": lambda rate, power: 2 * rate / (1 + rate),
}


def input_curve(share: np.ndarray, quadratic: float, cubic: float) -> np.ndarray:
    """Monotone curve over the range whose ends stay where they are."""
    arch = share * (1 - share)
    return share + quadratic * arch + cubic * arch * (1 - 2 * share)


# --- blocks of the chain ---------------------------------------------------------------------------------------------

class Linear:
    """A transfer function of unit gain at rest, from rest at its first value; its state carries over."""

    def __init__(self, numerator: Sequence[float], denominator: Sequence[float], step_s: float, held: bool) -> None:
        """`held`: the input is constant within a step, exactly; else it is a straight line."""
        b, self.a, _ = cont2discrete((numerator, denominator), step_s, "zoh" if held else "foh")
        self.b = np.append(b[0][1:], 0.0) if held else b[0]  # at the end of the step, where SciPy gives its beginning
        self.state = np.zeros(len(self.a) - 1)
        self.rest: float | None = None

    def __call__(self, signal: np.ndarray) -> np.ndarray:
        if self.rest is None:
            self.rest = float(signal[0])
        output, self.state = lfilter(self.b, self.a, signal - self.rest, zi=self.state)
        return self.rest + output


def first_order(time_constant_s: float, step_s: float, held: bool) -> Linear:
    return Linear([1.0], [time_constant_s, 1.0], step_s, held)


def second_order(f0_hz: float, damping: float, step_s: float, held: bool) -> Linear:
    w = 2 * pi * f0_hz
    return Linear([w * w], [1.0, 2 * damping * w, w * w], step_s, held)


class Sum:
    """Weighted sum of blocks, and the signal itself."""

    def __init__(self, gain: float, parts: Sequence[tuple[float, Linear]]) -> None:
        self.gain, self.parts = gain, parts

    def __call__(self, signal: np.ndarray) -> np.ndarray:
        result = self.gain * signal
        for weight, block in self.parts:
            result += weight * block(signal)
        return result


class Delay:
    """Late by any number of steps."""

    def __init__(self, steps: float) -> None:
        self.whole, self.part = int(steps), steps - int(steps)
        self.past: np.ndarray | None = None

    def __call__(self, signal: np.ndarray) -> np.ndarray:
        if self.past is None:
            self.past = np.full(self.whole + 1, signal[0])
        line = np.concatenate([self.past, signal])
        self.past = line[len(line) - len(self.past):]
        n = len(signal)
        return (1 - self.part) * line[1:n + 1] + self.part * line[:n]


class Softening:
    """Motion warms the actuator: the stroke grows about its middle, by `share` where all goes as fast as RATE_SCALE."""

    def __init__(self, share: float, time_constant_s: float, step_s: float) -> None:
        self.share, self.step_s, self.before = share, step_s, None
        self.warmth = first_order(time_constant_s, step_s, True)

    def __call__(self, signal: np.ndarray) -> np.ndarray:
        moved = np.diff(signal, prepend=signal[0] if self.before is None else self.before)
        self.before = signal[-1]
        warmth = self.warmth(2 * np.abs(moved) / self.step_s / RATE_SCALE)
        return 0.5 + (1 + self.share * warmth) * (signal - 0.5)


class StickSlip:
    """The stage sticks until it is `share` of the stroke behind, then slips all the way."""

    def __init__(self, share: float) -> None:
        self.share, self.at = share, None

    def __call__(self, signal: np.ndarray) -> np.ndarray:
        result, at = np.empty(len(signal)), signal[0] if self.at is None else self.at
        for k, value in enumerate(signal):
            if abs(value - at) > self.share:
                at = value
            result[k] = at
        self.at = at
        return result


class Loop:
    """The family's operator with its share of the stroke, and the growth of its width with the rate.

    From -1..1 to 0..1: a straight line, the static curve, and the operator without its own line, scaled so that the
    great loop has the rig's width. The growth leaves the mean of the great loop's branches alone.
    """

    def __init__(self, operator: Operator, width: float, curve: tuple[float, float], rate: Mapping[str, float] | None,
                 step_s: float) -> None:
        self.raw = copy.deepcopy(operator)
        great = copy.deepcopy(operator)(np.concatenate([BRANCH, BRANCH[::-1]] * 4))
        rising, falling = np.split(great[-2 * len(BRANCH):], 2)
        falling = falling[::-1]
        apart = falling - rising
        self.gain = width / float(apart[np.argmax(np.abs(apart))])
        mean = (rising + falling) / 2
        self.middle, self.slope = (mean[-1] + mean[0]) / 2, (mean[-1] - mean[0]) / 2
        # straight on for the little that an amplifier overshoots
        self.mean = np.concatenate([[2 * mean[0] - mean[40]], mean, [2 * mean[-1] - mean[-41]]])
        self.curve, self.rate, self.step_s = curve, rate, step_s
        self.before: float | None = None
        self.smooth = first_order(RATE_S, step_s, True)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        raw = self.raw(u)
        mean = np.interp(u, [-1.2, *BRANCH, 1.2], self.mean)
        loop = raw - mean
        if self.rate:
            moved = np.diff(u, prepend=u[0] if self.before is None else self.before)
            rate = self.smooth(np.abs(moved) / self.step_s) / RATE_SCALE
            self.before = float(u[-1])
            form = [*RATE_FORMS.values()][int(self.rate["form"])]
            loop = loop * (1 + self.rate["growth"] * form(np.maximum(rate, 0), self.rate["power"]))
        quadratic, cubic = self.curve
        static = (u + 1) / 2 + quadratic * (1 - u * u) + cubic * u * (1 - u * u)
        return static + self.gain * (mean - self.middle - self.slope * u + loop)


# --- the rig ---------------------------------------------------------------------------------------------------------

@dataclass
class Rig:
    """One actuator with amplifier, converters and sensor; made by make_rig. Shares are of stroke or range."""

    family: str
    seed: int
    sins: dict[str, dict[str, float]]
    low_V: float
    high_V: float
    stroke_um: float
    offset_um: float
    width: float  # of the great loop
    curve: tuple[float, float]  # quadratic and cubic share of the static curve
    sweep_cycles: int
    sweep_hz: float
    rest_s: float  # after the sweep
    # amplifier's output in the last run
    monitor_V: np.ndarray = field(default_factory=lambda: np.empty(0), repr=False, compare=False)
    # displacement in the last run, without noise and converter
    true_um: np.ndarray = field(default_factory=lambda: np.empty(0), repr=False, compare=False)
    runs: int = field(default=0, repr=False, compare=False)

    @property
    def truth(self) -> dict[str, object]:
        """What the rig is made of; each sin that it has, with its parameters."""
        return {"family": self.family, "seed": self.seed, "range_V": (self.low_V, self.high_V),
                "stroke_um": self.stroke_um, "width": self.width, "curve": self.curve, **copy.deepcopy(self.sins)}

    @property
    def start_share(self) -> float:
        """Where in the range this rig's drives start."""
        return self.sins["edge_start"]["share"] if "edge_start" in self.sins else 0.5

    def without(self, *names: str) -> Rig:
        """The same rig, not played yet, without these sins."""
        _check(names)
        return self._with({name: values for name, values in self.sins.items() if name not in names})

    def put(self, name: str, **values: float) -> Rig:
        """The same rig, not played yet, with this sin as its seed draws it, or with these parameters."""
        _check([name])
        drawn = EVERY[name](self._random(name))
        if wrong := set(values) - set(drawn):
            raise ValueError(f"{name} has no parameter {', '.join(sorted(wrong))}: {', '.join(drawn)}")
        return self._with({**self.sins, name: {**drawn, **values}})

    def _with(self, sins: Sins) -> Rig:
        ordered = {name: dict(sins[name]) for name in EVERY if name in sins}
        return Rig(self.family, self.seed, ordered, self.low_V, self.high_V, self.stroke_um, self.offset_um,
                   self.width, self.curve, self.sweep_cycles, self.sweep_hz, self.rest_s)

    @cached_property
    def operator(self) -> Operator:
        return {**FAMILIES, **SEALED}[self.family](self._random("loop"))

    def _random(self, what: str) -> np.random.Generator:
        return _random(self.family, self.seed, what)

    def volts(self, share: np.ndarray | float) -> np.ndarray:
        return self.low_V + (self.high_V - self.low_V) * np.asarray(share)

    def run(self, command_V: np.ndarray, sample_rate_hz: float, start: str = "swept") -> np.ndarray:
        """Readings in um, one per command.

        start: "swept": the rig rests in the middle, plays its decaying sweep onto the first command, and rests there;
        "rested": it rests in the middle and goes to the first command; "unknown": it comes from three random places;
        "carried": the run follows the one before at once.
        """
        command_V = np.asarray(command_V, float)
        if command_V.ndim != 1 or not len(command_V) or not np.all(np.isfinite(command_V)):
            raise ValueError("command_V must be one-dimensional, finite and not empty")
        random = self._random(f"run {self.runs}")
        if start == "carried":
            if getattr(self, "_rate_hz", None) != sample_rate_hz:
                raise ValueError("carried: there is no run before at this sample rate")
        elif start in ("swept", "rested", "unknown"):
            self._rate_hz, self._chain = sample_rate_hz, self._make_chain(sample_rate_hz)
            make = {"swept": self._sweep, "rested": self._from_middle, "unknown": self._visits}[start]
            self._play(make(float(command_V[0]), sample_rate_hz, random))
        else:
            raise ValueError(f"start {start!r}: swept, rested, unknown or carried")
        self.runs += 1
        share = self._play(command_V)
        self.true_um = self.offset_um + self.stroke_um * share
        return self._read(share, random, sample_rate_hz)

    def _sweep(self, end_V: float, rate_hz: float, random: np.random.Generator) -> np.ndarray:
        n = round(self.sweep_cycles / self.sweep_hz * rate_hz)
        left = 1 - np.arange(n) / n
        middle, half = (self.low_V + self.high_V) / 2, (self.high_V - self.low_V) / 2
        wave = np.sin(2 * pi * self.sweep_hz * np.arange(n) / rate_hz)
        return np.append(end_V + left * (middle - end_V + half * wave), np.full(round(self.rest_s * rate_hz), end_V))

    def _from_middle(self, end_V: float, rate_hz: float, random: np.random.Generator) -> np.ndarray:
        n = round(0.5 * rate_hz)
        return np.concatenate([np.full(n, self.volts(0.5)), np.linspace(self.volts(0.5), end_V, n)])

    def _visits(self, end_V: float, rate_hz: float, random: np.random.Generator) -> np.ndarray:
        places = [*self.volts(random.random(3)), end_V, end_V]
        times = np.cumsum([0.0, *random.uniform(0.1, 0.4, 4)])
        return np.interp(np.arange(round(times[-1] * rate_hz)) / rate_hz, times, places)

    def _make_chain(self, rate_hz: float) -> list[tuple[str, Signal]]:
        self._steps = 2 * max(LEAST_STEPS // 2, ceil(0.5 / (rate_hz * FINEST_S) - 1e-9))  # even: there is a middle
        step_s = 1 / (rate_hz * self._steps)
        self._end: float | None = None
        sins, chain, held = self.sins, [], "hold" in self.sins
        if sin := sins.get("delay"):
            # a fraction of a step: of a staircase the mean over the step, of a line the value between its points
            chain.append(("delay", Delay(sin["delay_s"] / step_s)))
        if sin := sins.get("lag"):
            chain.append(("lag", first_order(sin["time_constant_s"], step_s, held)))
            held = False
        if sin := sins.get("overshoot"):
            chain.append(("overshoot", second_order(sin["f0_hz"], sin["damping"], step_s, held)))
            held = False
        chain.append(("supply", lambda share: np.clip(share, -SUPPLY, 1 + SUPPLY)))
        if sin := sins.get("leakage"):
            chain.append(("leakage", Sum(1.0, [(-sin["share"], first_order(sin["time_constant_s"], step_s, held))])))
        if sin := sins.get("input_curve"):
            chain.append(("input_curve", lambda share, sin=sin: input_curve(share, **sin)))
        loop = Loop(self.operator, self.width, self.curve, sins.get("rate"), step_s)
        chain.append(("loop", lambda share: loop(2 * share - 1)))
        if sin := sins.get("relaxation"):
            chain.append(("relaxation", Sum(1 - sin["share"], [
                (sin["share"], first_order(sin["time_constant_s"], step_s, held))])))
        if sin := sins.get("creep"):
            chain.append(("creep", self._creep(sin["percent_per_decade"], sin["power"], step_s, held)))
        if sin := sins.get("resonance"):
            chain.append(("resonance", second_order(sin["f0_hz"], sin["damping"], step_s, held)))
        return chain + self._put_in(step_s, held)

    def _put_in(self, step_s: float, held: bool) -> list[tuple[str, Signal]]:
        """Blocks behind the resonance that no rig has unless they are put in."""
        sins, chain = self.sins, []
        if sin := sins.get("softening"):
            chain.append(("softening", Softening(**sin, step_s=step_s)))
        if sin := sins.get("settling"):
            chain.append(("settling", Sum(1.0, [(sin["share"], first_order(sin["time_constant_s"], step_s, held))])))
        if sin := sins.get("second_resonance"):
            chain.append(("second_resonance", Sum(1 - sin["share"], [
                (sin["share"], second_order(sin["f0_hz"], sin["damping"], step_s, held))])))
        if sin := sins.get("stick_slip"):
            chain.append(("stick_slip", StickSlip(**sin)))
        if sin := sins.get("sensor_delay"):
            chain.append(("sensor_delay", Delay(sin["delay_s"] / step_s)))
        if sin := sins.get("sensor_lag"):
            chain.append(("sensor_lag", first_order(sin["time_constant_s"], step_s, held)))
        return chain

    def _creep(self, percent_per_decade: float, power: float, step_s: float, held: bool) -> Sum:
        """Kelvin-Voigt elements whose times scatter about even ones; weights as a power of time, 1 at one second."""
        low, high = np.log10(CREEP_S)
        count = round((high - low) * CREEP_PER_DECADE)
        even = low + (np.arange(count) + 0.5) / CREEP_PER_DECADE
        times = 10 ** (even + self._random("creep times").uniform(-0.1, 0.1, count))
        share = percent_per_decade / 100 / CREEP_PER_DECADE
        return Sum(1.0, [(share * time**power, first_order(time, step_s, held)) for time in times])

    def _play(self, command_V: np.ndarray) -> np.ndarray:
        """Shares of the stroke, one per command, without noise; the monitor on the way."""
        share = (command_V - self.low_V) / (self.high_V - self.low_V)
        if sin := self.sins.get("dac"):
            share = np.round(share * (2 ** sin["bits"] - 1)) / (2 ** sin["bits"] - 1)
        if "hold" in self.sins:
            signal, read = np.repeat(share, self._steps), slice(self._steps // 2 - 1, None, self._steps)
        else:
            before = np.concatenate([share[:1] if self._end is None else [self._end], share[:-1]])
            way = np.arange(1, self._steps + 1) / self._steps
            signal = (before[:, None] + (share - before)[:, None] * way).ravel()
            read = slice(self._steps - 1, None, self._steps)
        self._end = share[-1]
        for name, block in self._chain:
            signal = block(signal)
            if name == "supply":
                self.monitor_V = self.volts(signal[read])
        return signal[read]

    def _read(self, share: np.ndarray, random: np.random.Generator, rate_hz: float) -> np.ndarray:
        n = len(share)
        noise = random.standard_normal((2, n))
        if sin := self.sins.get("noise"):
            share = share + sin["white"] * noise[0] + sin["flicker"] * _flicker(noise[1])
        if sin := self.sins.get("adc"):  # over 1.5 strokes
            codes = 2 ** sin["bits"] / 1.5
            share = np.round(share * codes) / codes
        if sin := self.sins.get("dropouts"):  # the reading before is repeated
            hold = max(1, round(sin["hold_s"] * rate_hz))
            lost = np.convolve(random.random(n) < sin["per_s"] / rate_hz, np.ones(hold))[:n] > 0
            share = share[np.maximum.accumulate(np.where(lost, 0, np.arange(n)))]
        return self.offset_um + self.stroke_um * share


def _flicker(white: np.ndarray) -> np.ndarray:
    """Noise whose power falls as 1/f, of unit standard deviation."""
    lines = np.fft.rfft(white)
    lines /= np.sqrt(np.maximum(np.arange(len(lines)), 1))
    lines[0] = 0
    noise = np.fft.irfft(lines, len(white))
    return noise / max(float(np.std(noise)), 1e-30)


def _random(family: str, seed: int, what: str) -> np.random.Generator:
    """Each thing that is drawn has a generator of its own: leaving one out changes no other."""
    return np.random.default_rng([seed, crc32(family.encode()), crc32(what.encode())])


def _check(names: Collection[str]) -> None:
    if wrong := set(names) - set(EVERY):
        raise ValueError(f"no sin {', '.join(sorted(wrong))}: {', '.join(EVERY)}")


def make_rig(family: str, seed: int, sins: Sins | Collection[str] | None = None, without: Collection[str] = ()) -> Rig:
    """The rig of a family (FAMILIES, or SEALED) with this seed.

    sins: None: as the seed draws them; names: these, with the parameters that the seed draws; a mapping from names to
    parameters: these, its parameters in place of the drawn ones. `without` takes some away. All else stays the same.
    """
    if family not in FAMILIES and family not in SEALED:
        raise ValueError(f"no family {family!r}: {', '.join(FAMILIES)}; sealed: {', '.join(SEALED)}")
    random = _random(family, seed, "rig")
    widths = WIDTHS if family in WIPE_OUT or family in SEALED else DRIFTING
    low_V, high_V = [(0.0, 100.0), (0.0, 150.0), (-20.0, 120.0), (-30.0, 130.0), (0.0, 10.0)][random.integers(5)]
    rig = Rig(family, seed, {}, low_V, high_V, stroke_um=random.uniform(8, 60), offset_um=random.uniform(-2, 5),
              width=random.uniform(*widths), curve=(random.uniform(-0.03, 0.03), random.uniform(0, 0.04)),
              sweep_cycles=int(random.integers(15, 41)), sweep_hz=random.uniform(15, 40),
              rest_s=random.uniform(0.2, 0.5))
    present = {name: random.random() < SOME.get(name, 1.0) for name in SINS}
    wanted = [name for name in SINS if present[name]] if sins is None else list(sins)
    for name in wanted:
        rig = rig.put(name, **(sins[name] if isinstance(sins, Mapping) else {}))
    return rig.without(*without)


def write_recording(path: Path | str, rig: Rig, sample_rate_hz: float, start: str, columns: Mapping[str, np.ndarray]
                    ) -> None:
    """A recording or a drive as rdpi reads it: metadata, then `time_s` and these columns."""
    memory = {"swept": "reset"}.get(start, start)
    count = len(next(iter(columns.values())))
    lines = [f"# actuator: {rig.family} {rig.seed}", f"# sample_rate_hz: {sample_rate_hz:.10g}", f"# memory: {memory}",
             ",".join(["time_s", *columns])]
    table = np.column_stack([np.arange(count) / sample_rate_hz, *columns.values()])
    np.savetxt(path, table, "%.8g", ",", header="\n".join(lines), comments="")


def record(rig: Rig, path: Path | str, command_V: np.ndarray, sample_rate_hz: float, start: str = "swept",
           monitor: bool = False) -> np.ndarray:
    """Run, write the recording, and return the readings in um."""
    command_V = np.round(command_V, 6)
    reading = rig.run(command_V, sample_rate_hz, start)
    columns = {"command_V": command_V, "displacement_um": reading}
    if monitor:
        columns["monitor_V"] = rig.monitor_V
    write_recording(path, rig, sample_rate_hz, start, columns)
    return reading
