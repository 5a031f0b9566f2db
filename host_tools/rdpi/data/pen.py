"""What every drive is drawn with: limits, a pen that respects them, and checks of what the user asks for."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..errors import BadInput
from .recording import RATES_HZ

MAX_SAMPLES = 20_000_000
MAX_V = 1e6
LEAST = 1e-9  # of rates, frequencies and times: what is smaller is a slip, and divides badly
SAMPLES_PER_PERIOD = 10  # fewer no longer draw a sine or a triangle
QUANTUM_V = 1e-9  # voltages are whole nanovolts: short to print, and the last bit of a sine does not matter
DEFAULT_LINES, PHASE_DRAWS = 16, 200  # of a multisine
MOVE_S = 0.1  # a move between waveforms crosses the whole range in this time


@dataclass(frozen=True)
class Limits:
    """What the drive must respect. Volts, samples per second, volts per second."""

    min_V: float = 0.0
    max_V: float = 10.0
    rest_V: float | None = None  # None: the middle, where a sweep can decay from both sides
    sample_rate_hz: float = 10_000.0
    slew_V_per_s: float | None = None
    sweep_V: tuple[float, float] | None = None  # ends of the sweep at the start; None: those of the drive

    @property
    def span_V(self) -> float:
        return self.max_V - self.min_V

    @property
    def middle_V(self) -> float:
        return (self.max_V + self.min_V) / 2


@dataclass
class Pen:
    """Draws a voltage sample by sample within the limits."""

    limits: Limits
    rest_V: float
    pieces: list[np.ndarray] = field(default_factory=list)
    at_V: float = 0.0
    count: int = 1
    parts: list[tuple[str, int]] = field(default_factory=list)  # name and the samples drawn before

    def __post_init__(self) -> None:
        self.at_V = self.rest_V
        self.pieces.append(np.array([self.rest_V]))

    @property
    def slew(self) -> float:
        # Rounding to whole nanovolts may add a quantum per sample.
        slew = self.limits.slew_V_per_s
        return np.inf if slew is None else slew - 2 * QUANTUM_V * self.limits.sample_rate_hz

    def samples(self, duration_s: float) -> int:
        """Whole samples in at least this time, at least one."""
        count = max(1.0, np.ceil(duration_s * self.limits.sample_rate_hz * (1 - 1e-12)))
        self._check_size(count)
        return int(count)

    def part(self, name: str) -> None:
        """What is drawn from here on is a part of this name, until the next one."""
        self.parts.append((name, self.count - 1))

    def ramp(self, to_V: float, duration_s: float = 0.0) -> None:
        """Straight line to a voltage, which is reached exactly; longer than asked for when the slew limit says so."""
        count = self.samples(max(duration_s, abs(to_V - self.at_V) / self.slew))
        self._add(self.at_V + (to_V - self.at_V) * np.arange(1, count + 1) / count)
        self.at_V = to_V

    def ramp_at(self, rate_V_per_s: float, to_V: float) -> None:
        """Straight line to a voltage at this rate, or as fast as the slew limit lets it."""
        self.ramp(to_V, abs(to_V - self.at_V) / rate_V_per_s)

    def move(self, to_V: float) -> None:
        """Straight line to where the next waveform starts."""
        if to_V != self.at_V:
            self.ramp(to_V, MOVE_S * abs(to_V - self.at_V) / self.limits.span_V)

    def hold(self, duration_s: float) -> None:
        self._add(np.full(self.samples(duration_s), self.at_V))

    def wave(self, voltage: np.ndarray, what: str, remedy: str) -> None:
        """A smooth waveform, after a move to its first sample. Raises BadInput if it is too fast."""
        self.move(float(voltage[0]))
        steepest = float(np.abs(np.diff(voltage)).max()) * self.limits.sample_rate_hz
        if steepest > self.slew:
            raise BadInput(f"`slew_V_per_s` {self.limits.slew_V_per_s:g}: {what} needs {steepest:.4g} V/s; {remedy} or a "
                           "smaller range of `min_V` and `max_V`")
        self._add(voltage[1:])
        self.at_V = float(voltage[-1])

    def _add(self, piece: np.ndarray) -> None:
        self._check_size(len(piece))
        self.pieces.append(piece)
        self.count += len(piece)

    def _check_size(self, more: float) -> None:
        if not self.count + more <= MAX_SAMPLES:
            raise BadInput(f"the drive would have over {MAX_SAMPLES:,} samples; lower `sample_rate_hz`, or use "
                           "shorter or faster waveforms")


def check_limits(limits: Limits) -> float:
    """The rest voltage, if the limits make sense."""
    for name, value in (("min_V", limits.min_V), ("max_V", limits.max_V)):
        if not abs(value) <= MAX_V:
            raise BadInput(f"`{name}` {value:g}: give a finite number of volts, at most {MAX_V:g}")
    if not limits.span_V >= 1e3 * QUANTUM_V:
        raise BadInput(f"`max_V` {limits.max_V:g}: must be above `min_V` {limits.min_V:g}")
    rest_V = limits.middle_V if limits.rest_V is None else limits.rest_V
    if not limits.min_V <= rest_V <= limits.max_V:
        raise BadInput(f"`rest_V` {rest_V:g}: is outside `min_V` {limits.min_V:g} to `max_V` {limits.max_V:g}")
    if limits.sweep_V is not None:
        low, high = limits.sweep_V
        if not -MAX_V <= low <= limits.min_V or not limits.max_V <= high <= MAX_V:
            raise BadInput(f"`sweep_V` {low:g},{high:g}: must hold the drive, `min_V` {limits.min_V:g} to `max_V` "
                           f"{limits.max_V:g}, within {MAX_V:g} V")
    rate = limits.sample_rate_hz
    if not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        raise BadInput(f"`sample_rate_hz` {rate:g}: give a positive number of Hz, {RATES_HZ[0]:g} to {RATES_HZ[1]:g}")
    if limits.slew_V_per_s is not None and positive("slew_V_per_s", limits.slew_V_per_s, "V/s") <= 4 * QUANTUM_V * rate:
        raise BadInput(f"`slew_V_per_s` {limits.slew_V_per_s:g}: is only a few nanovolts per sample; give a "
                       "higher slew or a lower `sample_rate_hz`")
    return rest_V


def check_rate(pen: Pen, rate: float) -> None:
    slew = pen.limits.slew_V_per_s
    if slew is not None and rate > slew:
        raise BadInput(f"`slew_V_per_s` {slew:g}: a wave of {rate:g} V/s is faster; use rates up to the slew limit (for "
                       f"a triangular wave over the whole range: up to {slew / (2 * pen.limits.span_V):.4g} Hz)")
    fastest = 2 * pen.limits.span_V * pen.limits.sample_rate_hz / SAMPLES_PER_PERIOD
    if rate > fastest * (1 + 1e-9):
        raise BadInput(f"`rates_V_per_s` {rate:g}: gives fewer than {SAMPLES_PER_PERIOD // 2} samples from `min_V` to "
                       f"`max_V`; use at most {fastest:g} V/s, or raise `sample_rate_hz`")


def check_frequency(pen: Pen, frequency_hz: float, samples: int = SAMPLES_PER_PERIOD) -> float:
    """A frequency in Hz that so many samples per period draw."""
    highest = pen.limits.sample_rate_hz / samples
    if positive("frequencies_hz", frequency_hz, "Hz") > highest * (1 + 1e-9):
        raise BadInput(f"`frequencies_hz` {frequency_hz:g}: gives fewer than {samples} samples per period; "
                       f"use at most {highest:g} Hz, or raise `sample_rate_hz`")
    return frequency_hz


def highest_hz(pen: Pen, steepness: float, samples: int = SAMPLES_PER_PERIOD) -> float:
    """Highest frequency for waves over the whole range whose steepest slope is steepness · range · frequency."""
    return min(pen.limits.sample_rate_hz / samples, 0.999 * pen.slew / (steepness * pen.limits.span_V))


def positive(name: str, value: float, unit: str) -> float:
    if not LEAST <= value < np.inf:
        raise BadInput(f"`{name}` {value:g}: give a positive number of {unit}, {LEAST:g} or more")
    return value


def whole(name: str, value: int) -> int:
    if not 1 <= value <= 100_000:
        raise BadInput(f"`{name}` {value}: give a whole number from 1 to 100000")
    return value


def low_crest(lines: np.ndarray, draws: int, count: int, seed: int) -> np.ndarray:
    """One period of a sum of sines, from 0 to 1, amplitudes falling as 1/sqrt(f): (count,).

    `lines` are whole numbers of periods. Of many random phases, `draws` for each trial, the best crest factor is taken.
    """
    trials = 2 * np.pi * np.random.default_rng(seed).random((PHASE_DRAWS, draws))

    def signal(phases: np.ndarray, samples: int) -> np.ndarray:
        spectrum = np.zeros(samples // 2 + 1, dtype=complex)
        spectrum[lines] = np.exp(1j * phases[:len(lines)]) / np.sqrt(lines)
        return np.fft.irfft(spectrum, samples)

    coarse = 8 * int(lines[-1])  # samples enough to compare heights
    wave = signal(min(trials, key=lambda phases: np.ptp(signal(phases, coarse))), count)
    return (wave - wave.min()) / np.ptp(wave)
