"""Drives that make an actuator show what a model needs to know.

Every drive starts and ends at the rest voltage, stays within the limits, and is a pure function of its options: the
same options give the same bytes. Unless told otherwise it begins with a decaying sweep, after which what the hysteresis
remembers is known whatever it was before. Frequencies that the user did not ask for yield to slew limit and sample
rate; those asked for are kept, or refused.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..errors import BadInput
from .recording import RATES_HZ, sample_times

MAX_SAMPLES = 20_000_000
MAX_V = 1e6
LEAST = 1e-9  # of rates, frequencies and times: what is smaller is a slip, and divides badly
SAMPLES_PER_PERIOD = 10  # fewer no longer draw a sine or a triangle
QUANTUM_V = 1e-9  # voltages are whole nanovolts: short to print, and the last bit of a sine does not matter
DEFAULT_LINES, PHASE_DRAWS = 16, 200  # of a multisine
SWEEP_CYCLES, SWEEP_HZ = 20, 20.0
FREQUENCIES_HZ = (1.0, 2.0, 5.0, 10.0, 20.0)
MOVE_S = 0.1  # a move between waveforms crosses the whole range in this time


@dataclass(frozen=True)
class Limits:
    """What the drive must respect. Volts, samples per second, volts per second."""

    min_V: float = 0.0
    max_V: float = 10.0
    rest_V: float | None = None  # None: the middle, where a sweep can decay from both sides
    sample_rate_hz: float = 10_000.0
    slew_V_per_s: float | None = None

    @property
    def span_V(self) -> float:
        return self.max_V - self.min_V

    @property
    def middle_V(self) -> float:
        return (self.max_V + self.min_V) / 2


@dataclass
class _Pen:
    """Draws a voltage sample by sample within the limits."""

    limits: Limits
    rest_V: float
    pieces: list[np.ndarray] = field(default_factory=list)
    at_V: float = 0.0
    count: int = 1

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

    def ramp(self, to_V: float, duration_s: float = 0.0) -> None:
        """Straight line to a voltage, which is reached exactly; longer than asked for when the slew limit says so."""
        count = self.samples(max(duration_s, abs(to_V - self.at_V) / self.slew))
        self._add(self.at_V + (to_V - self.at_V) * np.arange(1, count + 1) / count)
        self.at_V = to_V

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
            raise BadInput(f"--slew {self.limits.slew_V_per_s:g}: {what} needs {steepest:.4g} V/s; {remedy} or a "
                           "smaller range of --min-V and --max-V")
        self._add(voltage[1:])
        self.at_V = float(voltage[-1])

    def _add(self, piece: np.ndarray) -> None:
        self._check_size(len(piece))
        self.pieces.append(piece)
        self.count += len(piece)

    def _check_size(self, more: float) -> None:
        if not self.count + more <= MAX_SAMPLES:
            raise BadInput(f"the drive would have over {MAX_SAMPLES:,} samples; lower --sample-rate, or use "
                           "shorter or faster waveforms")


def make_drive(kind: str, limits: Limits, sweep: bool = True,
               **options: object) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Columns `time_s` and `command_V` and the metadata of one drive.

    `kind` is a key of KINDS and `options` are parameters of that function. Raises BadInput for limits and options that
    contradict each other or have no meaning for the kind.
    """
    draw = KINDS[kind]
    rest_V = _check_limits(limits)
    known = {name: parameter.default for name, parameter in list(inspect.signature(draw).parameters.items())[1:]}
    for name in options:
        if name not in known:
            raise BadInput(f"--{OPTION_NAMES[name]}: is not valid for {kind}; valid are "
                           + ", ".join(f"--{OPTION_NAMES[other]}" for other in known))
    pen = _Pen(limits, rest_V)
    swept = sweep and kind != "startup"  # which is the sweep itself
    if swept:
        _decay(pen, rest_V, SWEEP_CYCLES, _sweep_hz(pen))
    swept_samples = pen.count
    used = known | options
    used |= draw(pen, **used)
    if kind != "startup":
        pen.move(rest_V)
    voltage = np.clip(np.round(np.concatenate(pen.pieces), 9), limits.min_V, limits.max_V)
    rate = limits.sample_rate_hz
    metadata = {"drive": kind, "min_V": _text(limits.min_V), "max_V": _text(limits.max_V), "rest_V": _text(rest_V)}
    if limits.slew_V_per_s is not None:
        metadata["slew_V_per_s"] = _text(limits.slew_V_per_s)
    metadata |= {name: _text(value) for name, value in used.items() if value is not None}
    metadata |= {"sample_rate_hz": _text(rate), "memory": "unknown"}
    if swept:
        metadata["sweep_s"] = _text((swept_samples - 1) / rate)
    return {"time_s": sample_times(len(voltage), rate), "command_V": voltage}, metadata


# --- the kinds: each returns the options that it worked out itself ---------------------------------------------------

def sawtooth(pen: _Pen, frequencies_hz: Sequence[float] | None = None, rates_V_per_s: Sequence[float] | None = None,
             cycles: int = 3) -> dict[str, object]:
    """Triangular waves over the whole range, one after another at several rates: slopes against rate."""
    if frequencies_hz and rates_V_per_s:
        raise BadInput("--frequencies and --rates: give one of them; a triangular wave of f Hz has a rate of "
                       "2 f (max - min)")
    span = pen.limits.span_V
    if rates_V_per_s:
        rates = [_positive("rates", rate, "V/s") for rate in rates_V_per_s]
    else:
        frequencies_hz = frequencies_hz or _default_frequencies(pen, 2)
        rates = [2 * span * _frequency(pen, f) for f in frequencies_hz]
    for rate in rates:
        _check_rate(pen, rate)
    pen.move(pen.limits.min_V)
    for rate in rates:
        for _ in range(_whole("cycles", cycles)):
            pen.ramp(pen.limits.max_V, span / rate)
            pen.ramp(pen.limits.min_V, span / rate)
    return {"frequencies_hz": frequencies_hz, "rates_V_per_s": rates}


def minor_loops(pen: _Pen, levels: int = 6, rates_V_per_s: Sequence[float] | None = None) -> dict[str, object]:
    """Reversals shrinking towards the middle, then loops hung on the rising and the falling branch: every amplitude."""
    low, span = pen.limits.min_V, pen.limits.span_V
    levels = _whole("levels", levels)
    rates = rates_V_per_s or (min(2 * span, pen.slew),)
    for rate in rates:
        _check_rate(pen, _positive("rates", rate, "V/s"))

        def to(fraction: float) -> None:
            target = pen.limits.max_V if fraction == 1 else low + span * fraction
            if target != pen.at_V:
                pen.ramp(target, abs(target - pen.at_V) / rate)

        pen.move(low)
        for level in range(levels):
            half = 0.5 * (1 - level / levels)
            to(0.5 + half)
            to(0.5 - half)
        to(0)
        for rising in (True, False):
            for level in range(1, levels + 1):
                reached = level / levels
                for depth in (reached / 2, reached / 4):
                    for fraction in (reached, reached - depth, reached):
                        to(fraction if rising else 1 - fraction)
            to(1 if rising else 0)
    return {"rates_V_per_s": rates}


def steps(pen: _Pen, levels: int = 4, hold_s: float = 5.0) -> dict[str, object]:
    """Up and down a staircase, holding each step (one sample high, or as fast as --slew lets it): creep."""
    levels = _whole("levels", levels)
    hold_s = _positive("hold", hold_s, "s")
    pen.move(pen.limits.min_V)
    for level in [*range(1, levels + 1), *range(levels - 1, -1, -1)]:
        pen.ramp(pen.limits.max_V if level == levels else pen.limits.min_V + pen.limits.span_V * level / levels)
        pen.hold(hold_s)
    return {}


def multisine(pen: _Pen, frequencies_hz: Sequence[float] | None = None, duration_s: float | None = None,
              seed: int = 0) -> dict[str, object]:
    """Sum of sines with random phases of low crest factor, half the time over the whole range, half over a tenth of it.

    Frequencies are moved to whole periods of half the duration. Amplitudes fall as 1/sqrt(f).
    """
    if duration_s is None:
        duration_s = max(10.0, 20 * pen.limits.span_V / pen.slew)
    period_s = _positive("duration", duration_s, "s") / 2
    count = pen.samples(period_s)
    rate = pen.limits.sample_rate_hz
    line_count = DEFAULT_LINES if frequencies_hz is None else len(frequencies_hz)
    draws = 2 * np.pi * np.random.default_rng(seed).random((PHASE_DRAWS, line_count))

    def one_period(frequencies_hz: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Lines in periods per `count` samples, and the signal from 0 to 1, its first sample repeated at the end."""
        lines = np.unique([round(_frequency(pen, f) * count / rate) for f in frequencies_hz])
        if lines[0] < 1:
            raise BadInput(f"--frequencies {min(frequencies_hz):g}: no full period fits into half of --duration "
                           f"{duration_s:g}; give a longer duration or higher frequencies")

        def signal(phases: np.ndarray, samples: int) -> np.ndarray:
            spectrum = np.zeros(samples // 2 + 1, dtype=complex)
            spectrum[lines] = np.exp(1j * phases[:len(lines)]) / np.sqrt(lines)
            return np.fft.irfft(spectrum, samples)

        coarse = 8 * int(lines[-1])  # samples enough to compare heights
        wave = signal(min(draws, key=lambda phases: np.ptp(signal(phases, coarse))), count)
        wave = (wave - wave.min()) / np.ptp(wave)
        return lines, np.append(wave, wave[0])

    if frequencies_hz is not None:
        lines, wave = one_period(frequencies_hz)
    else:
        highest = min(50.0, rate / SAMPLES_PER_PERIOD)
        while True:
            lines, wave = one_period(np.geomspace(max(highest / 100, 1 / period_s), highest, DEFAULT_LINES))
            if highest * period_s <= 2 or np.abs(np.diff(wave)).max() * pen.limits.span_V * rate <= pen.slew:
                break
            highest *= 0.8
    for share in (1.0, 0.1):
        low = pen.limits.middle_V - share * pen.limits.span_V / 2
        pen.wave(low + share * pen.limits.span_V * wave, "this multisine",
                 "ask for lower --frequencies, a longer --duration,")
    return {"frequencies_hz": lines * rate / count, "duration_s": duration_s}


def sine(pen: _Pen, frequencies_hz: Sequence[float] | None = None, cycles: int = 5) -> dict[str, object]:
    """Sines over the whole range, one after another at several frequencies: loops, and delay or lag."""
    cycles = _whole("cycles", cycles)
    frequencies_hz = frequencies_hz or _default_frequencies(pen, np.pi)
    for frequency in frequencies_hz:
        count = pen.samples(cycles / _frequency(pen, frequency))
        phase = 2 * np.pi * cycles * np.arange(count + 1) / count
        pen.wave(pen.limits.middle_V - pen.limits.span_V / 2 * np.cos(phase), f"a sine of {frequency:g} Hz",
                 "ask for lower --frequencies")
    return {"frequencies_hz": frequencies_hz}


def chirp(pen: _Pen, frequencies_hz: Sequence[float] | None = None, duration_s: float = 10.0) -> dict[str, object]:
    """A sine whose frequency runs from the first to the second, equally long per octave: resonance (keep it small)."""
    if frequencies_hz is None:
        highest = min(500.0, _highest_hz(pen, np.pi))
        frequencies_hz = (min(1.0, highest / 10), highest)
    if len(frequencies_hz) != 2 or frequencies_hz[0] == frequencies_hz[1]:
        raise BadInput("--frequencies: a chirp needs two different frequencies, e.g. --frequencies 1,500")
    first, last = (_frequency(pen, f) for f in frequencies_hz)
    count = pen.samples(_positive("duration", duration_s, "s"))
    ratio = np.log(last / first)
    phase = 2 * np.pi * first * duration_s / ratio * np.expm1(ratio * np.arange(count + 1) / count)
    pen.wave(pen.limits.middle_V - pen.limits.span_V / 2 * np.cos(phase), f"a chirp to {max(first, last):g} Hz",
             "ask for lower --frequencies")
    return {"frequencies_hz": frequencies_hz}


def startup(pen: _Pen, end_V: float | None = None, frequencies_hz: Sequence[float] | None = None,
            cycles: int = SWEEP_CYCLES) -> dict[str, object]:
    """Oscillation from the whole range down to nothing at the end voltage: wipes out what the hysteresis remembers."""
    frequencies_hz = frequencies_hz or (min(_sweep_hz(pen), _highest_hz(pen, 2)),)
    if len(frequencies_hz) != 1:
        raise BadInput("--frequencies: the start-up sweep needs exactly one frequency")
    _check_rate(pen, 2 * pen.limits.span_V * _frequency(pen, frequencies_hz[0]))
    end_V = pen.rest_V if end_V is None else end_V
    if not pen.limits.min_V <= end_V <= pen.limits.max_V:
        raise BadInput(f"--end-V {end_V:g}: is outside --min-V {pen.limits.min_V:g} to --max-V {pen.limits.max_V:g}")
    _decay(pen, end_V, _whole("cycles", cycles), frequencies_hz[0])
    return {"end_V": end_V, "frequencies_hz": frequencies_hz}


KINDS: dict[str, Callable[..., dict[str, object]]] = {
    "sawtooth": sawtooth, "minor-loops": minor_loops, "steps": steps, "multisine": multisine, "sine": sine,
    "chirp": chirp, "startup": startup,
}
OPTION_NAMES = {"frequencies_hz": "frequencies", "rates_V_per_s": "rates", "cycles": "cycles", "levels": "levels",
                "hold_s": "hold", "duration_s": "duration", "seed": "seed", "end_V": "end-V"}


def _decay(pen: _Pen, end_V: float, cycles: int, frequency_hz: float) -> None:
    """Triangles around the end voltage, the first from limit to limit, each smaller than the one before."""
    high, low, half_s = pen.limits.max_V - end_V, pen.limits.min_V - end_V, 0.5 / frequency_hz
    for cycle in range(cycles):
        left = 1 - cycle / cycles
        pen.ramp(end_V + high * left, half_s)
        pen.ramp(end_V + low * left, half_s)
    pen.ramp(end_V, half_s)


def _sweep_hz(pen: _Pen) -> float:
    return min(SWEEP_HZ, pen.limits.sample_rate_hz / SAMPLES_PER_PERIOD)


def _check_limits(limits: Limits) -> float:
    """The rest voltage, if the limits make sense."""
    for name, value in (("min-V", limits.min_V), ("max-V", limits.max_V)):
        if not abs(value) <= MAX_V:
            raise BadInput(f"--{name} {value:g}: give a finite number of volts, at most {MAX_V:g}")
    if not limits.span_V >= 1e3 * QUANTUM_V:
        raise BadInput(f"--max-V {limits.max_V:g}: must be above --min-V {limits.min_V:g}")
    rest_V = limits.middle_V if limits.rest_V is None else limits.rest_V
    if not limits.min_V <= rest_V <= limits.max_V:
        raise BadInput(f"--rest-V {rest_V:g}: is outside --min-V {limits.min_V:g} to --max-V {limits.max_V:g}")
    rate = limits.sample_rate_hz
    if not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        raise BadInput(f"--sample-rate {rate:g}: give a positive number of Hz, {RATES_HZ[0]:g} to {RATES_HZ[1]:g}")
    if limits.slew_V_per_s is not None and _positive("slew", limits.slew_V_per_s, "V/s") <= 4 * QUANTUM_V * rate:
        raise BadInput(f"--slew {limits.slew_V_per_s:g}: is only a few nanovolts per sample; give a higher slew or a "
                       "lower --sample-rate")
    return rest_V


def _check_rate(pen: _Pen, rate: float) -> None:
    slew = pen.limits.slew_V_per_s
    if slew is not None and rate > slew:
        raise BadInput(f"--slew {slew:g}: a wave of {rate:g} V/s is faster; use rates up to the slew limit (for a "
                       f"triangular wave over the whole range: up to {slew / (2 * pen.limits.span_V):.4g} Hz)")
    fastest = 2 * pen.limits.span_V * pen.limits.sample_rate_hz / SAMPLES_PER_PERIOD
    if rate > fastest * (1 + 1e-9):
        raise BadInput(f"--rates {rate:g}: gives fewer than {SAMPLES_PER_PERIOD // 2} samples from --min-V to --max-V; "
                       f"use at most {fastest:g} V/s, or raise --sample-rate")


def _frequency(pen: _Pen, frequency_hz: float) -> float:
    highest = pen.limits.sample_rate_hz / SAMPLES_PER_PERIOD
    if _positive("frequencies", frequency_hz, "Hz") > highest * (1 + 1e-9):
        raise BadInput(f"--frequencies {frequency_hz:g}: gives fewer than {SAMPLES_PER_PERIOD} samples per period; use "
                       f"at most {highest:g} Hz, or raise --sample-rate")
    return frequency_hz


def _highest_hz(pen: _Pen, steepness: float) -> float:
    """Highest frequency for waves over the whole range whose steepest slope is steepness · range · frequency."""
    return min(pen.limits.sample_rate_hz / SAMPLES_PER_PERIOD, 0.999 * pen.slew / (steepness * pen.limits.span_V))


def _default_frequencies(pen: _Pen, steepness: float) -> tuple[float, ...]:
    scale = min(1.0, _highest_hz(pen, steepness) / FREQUENCIES_HZ[-1])
    return tuple(scale * frequency for frequency in FREQUENCIES_HZ)


def _positive(option: str, value: float, unit: str) -> float:
    if not LEAST <= value < np.inf:
        raise BadInput(f"--{option} {value:g}: give a positive number of {unit}, {LEAST:g} or more")
    return value


def _whole(option: str, value: int) -> int:
    if not 1 <= value <= 100_000:
        raise BadInput(f"--{option} {value}: give a whole number from 1 to 100000")
    return value


def _text(value: object) -> str:
    return " ".join(f"{part:.12g}" for part in np.atleast_1d(value).tolist())
