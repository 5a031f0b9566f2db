"""Drives that make an actuator show what a model needs to know.

Every drive starts at the rest voltage, stays within the limits, and is a pure function of its options: the same options
give the same bytes. Unless told otherwise, every drive but startup begins with a decaying sweep, after which what the
hysteresis remembers is known whatever it was before, and ends at the rest voltage. startup is that sweep alone; it ends
at its end voltage. Frequencies that the user did not ask for yield to slew limit and sample rate; those asked for are
kept, or refused.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence

import numpy as np

from ..errors import BadInput
from .commission import commission, edge_V_per_s
from .pen import (DEFAULT_LINES, SAMPLES_PER_PERIOD, Limits, Pen, check_frequency, check_limits, check_rate, highest_hz,
                  low_crest, positive, whole)
from .recording import sample_times

SWEEP_CYCLES, SWEEP_HZ = 20, 20.0
RINGING_SAMPLES = 4  # per period of a chirp, which looks for what rings: it need not be drawn well
FREQUENCIES_HZ = (1.0, 2.0, 5.0, 10.0, 20.0)


def make_drive(kind: str, limits: Limits, sweep: bool = True,
               **options: object) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Columns `time_s` and `command_V` and the metadata of one drive.

    `kind` is a key of KINDS and `options` are parameters of that function. Raises BadInput for limits and options that
    contradict each other or have no meaning for the kind.
    """
    draw = KINDS[kind]
    rest_V = check_limits(limits)
    known = {name: parameter.default for name, parameter in list(inspect.signature(draw).parameters.items())[1:]}
    for name in options:
        if name not in known:
            raise BadInput(f"`{name}`: is not valid for {kind}; valid are "
                           + ", ".join(f"`{other}`" for other in known))
    pen = Pen(limits, rest_V)
    swept = sweep and kind != "startup"  # which is the sweep itself
    if limits.sweep_V is not None and not swept:
        raise BadInput("`sweep_V`: this drive begins with no sweep" if kind != "startup" else
                       "`sweep_V`: startup is the sweep itself; its ends are `min_V` and `max_V`")
    ends_V = limits.sweep_V or (limits.min_V, limits.max_V)
    if swept:
        _decay(pen, ends_V, rest_V, SWEEP_CYCLES, _sweep_hz(pen))
    swept_samples = pen.count
    used = known | options
    used |= draw(pen, **used)
    if kind != "startup":
        pen.move(rest_V)
    voltage = np.clip(np.round(np.concatenate(pen.pieces), 9), *ends_V)
    rate = limits.sample_rate_hz
    metadata = {"drive": kind, "min_V": _text(limits.min_V), "max_V": _text(limits.max_V), "rest_V": _text(rest_V)}
    if limits.slew_V_per_s is not None:
        metadata["slew_V_per_s"] = _text(limits.slew_V_per_s)
    metadata |= {name: _text(value) for name, value in used.items() if value is not None}
    metadata |= {"sample_rate_hz": _text(rate), "memory": "unknown"}
    if swept:
        metadata["sweep_s"] = _text((swept_samples - 1) / rate)
        metadata |= {} if limits.sweep_V is None else {"sweep_V": _text(ends_V)}
    if pen.parts:
        begun = [("sweep", 0)] * swept + pen.parts + [("", len(voltage) - 1)]
        metadata["parts"] = ", ".join(f"{name} {first / rate:.12g}-{last / rate:.12g} s"
                                      for (name, first), (_, last) in zip(begun, begun[1:]))
    return {"time_s": sample_times(len(voltage), rate), "command_V": voltage}, metadata


# --- the kinds: each returns the options that it worked out itself ---------------------------------------------------

def sawtooth(pen: Pen, frequencies_hz: Sequence[float] | None = None, rates_V_per_s: Sequence[float] | None = None,
             cycles: int = 3) -> dict[str, object]:
    """Triangular waves over the whole range, one after another at several rates: slopes against rate."""
    if frequencies_hz and rates_V_per_s:
        raise BadInput("`frequencies_hz` and `rates_V_per_s`: give one of them; a triangular wave of f Hz has a rate of "
                       "2 f (max - min)")
    span = pen.limits.span_V
    if rates_V_per_s:
        rates = [positive("rates_V_per_s", rate, "V/s") for rate in rates_V_per_s]
    else:
        frequencies_hz = frequencies_hz or _default_frequencies(pen, 2)
        rates = [2 * span * check_frequency(pen, f) for f in frequencies_hz]
    for rate in rates:
        check_rate(pen, rate)
    pen.move(pen.limits.min_V)
    for rate in rates:
        for _ in range(whole("cycles", cycles)):
            pen.ramp(pen.limits.max_V, span / rate)
            pen.ramp(pen.limits.min_V, span / rate)
    return {"frequencies_hz": frequencies_hz, "rates_V_per_s": rates}


def minor_loops(pen: Pen, levels: int = 6, rates_V_per_s: Sequence[float] | None = None) -> dict[str, object]:
    """Reversals shrinking towards the middle, then loops hung on the rising and the falling branch: every amplitude."""
    low, span = pen.limits.min_V, pen.limits.span_V
    levels = whole("levels", levels)
    rates = rates_V_per_s or (min(2 * span, pen.slew),)
    for rate in rates:
        check_rate(pen, positive("rates_V_per_s", rate, "V/s"))

        def to(fraction: float) -> None:
            target = pen.limits.max_V if fraction == 1 else low + span * fraction
            if target != pen.at_V:
                pen.ramp_at(rate, target)

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


def steps(pen: Pen, levels: int = 4, hold_s: float = 5.0, rates_V_per_s: Sequence[float] | None = None
          ) -> dict[str, object]:
    """Up and down a staircase, holding each step: creep. Edges are as fast as those of commission, or of --rates.

    A range in one sample is more than most amplifiers follow, and pulls at the ceramic.
    """
    levels = whole("levels", levels)
    hold_s = positive("hold_s", hold_s, "s")
    rates = rates_V_per_s or (edge_V_per_s(pen),)
    if len(rates) != 1:
        raise BadInput("`rates_V_per_s`: all edges of the staircase have the same rate; give one")
    rate = min(positive("rates_V_per_s", rates[0], "V/s"), pen.slew)
    pen.move(pen.limits.min_V)
    for level in [*range(1, levels + 1), *range(levels - 1, -1, -1)]:
        pen.ramp_at(rate, pen.limits.max_V if level == levels else pen.limits.min_V + pen.limits.span_V * level / levels)
        pen.hold(hold_s)
    return {"rates_V_per_s": (rate,)}


def multisine(pen: Pen, frequencies_hz: Sequence[float] | None = None, duration_s: float | None = None,
              seed: int = 0) -> dict[str, object]:
    """Sum of sines with random phases of low crest factor, half the time over the whole range, half over a tenth of it.

    Frequencies are moved to whole periods of half the duration. Amplitudes fall as 1/sqrt(f).
    """
    if duration_s is None:
        duration_s = max(10.0, 20 * pen.limits.span_V / pen.slew)
    period_s = positive("duration_s", duration_s, "s") / 2
    count = pen.samples(period_s)
    rate = pen.limits.sample_rate_hz

    def one_period(frequencies_hz: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Lines in periods per `count` samples, and the signal from 0 to 1, its first sample repeated at the end."""
        lines = np.unique([round(check_frequency(pen, f) * count / rate) for f in frequencies_hz])
        if lines[0] < 1:
            raise BadInput(f"`frequencies_hz` {min(frequencies_hz):g}: no full period fits into half of `duration_s` "
                           f"{duration_s:g}; give a longer duration or higher frequencies")
        wave = low_crest(lines, len(frequencies_hz), count, seed)
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
                 "ask for lower `frequencies_hz`, a longer `duration_s`,")
    return {"frequencies_hz": lines * rate / count, "duration_s": duration_s}


def sine(pen: Pen, frequencies_hz: Sequence[float] | None = None, cycles: int = 5) -> dict[str, object]:
    """Sines over the whole range, one after another at several frequencies: loops, and delay or lag."""
    cycles = whole("cycles", cycles)
    frequencies_hz = frequencies_hz or _default_frequencies(pen, np.pi)
    for frequency in frequencies_hz:
        count = pen.samples(cycles / check_frequency(pen, frequency))
        phase = 2 * np.pi * cycles * np.arange(count + 1) / count
        pen.wave(pen.limits.middle_V - pen.limits.span_V / 2 * np.cos(phase), f"a sine of {frequency:g} Hz",
                 "ask for lower `frequencies_hz`")
    return {"frequencies_hz": frequencies_hz}


def chirp(pen: Pen, frequencies_hz: Sequence[float] | None = None, duration_s: float = 10.0) -> dict[str, object]:
    """A sine whose frequency runs from the first to the second, equally long per octave: resonance (keep it small)."""
    if frequencies_hz is None:
        highest = min(500.0, highest_hz(pen, np.pi, RINGING_SAMPLES))
        frequencies_hz = (min(1.0, highest / 10), highest)
    if len(frequencies_hz) != 2 or frequencies_hz[0] == frequencies_hz[1]:
        raise BadInput("`frequencies_hz`: a chirp needs two different frequencies, e.g. `frequencies_hz` 1,500")
    first, last = (check_frequency(pen, f, RINGING_SAMPLES) for f in frequencies_hz)
    count = pen.samples(positive("duration_s", duration_s, "s"))
    ratio = np.log(last / first)
    phase = 2 * np.pi * first * duration_s / ratio * np.expm1(ratio * np.arange(count + 1) / count)
    pen.wave(pen.limits.middle_V - pen.limits.span_V / 2 * np.cos(phase), f"a chirp to {max(first, last):g} Hz",
             "ask for lower `frequencies_hz`")
    return {"frequencies_hz": frequencies_hz}


def startup(pen: Pen, end_V: float | None = None, frequencies_hz: Sequence[float] | None = None,
            cycles: int = SWEEP_CYCLES) -> dict[str, object]:
    """Oscillation from the whole range down to nothing at the end voltage: wipes out what the hysteresis remembers."""
    frequencies_hz = frequencies_hz or (min(_sweep_hz(pen), highest_hz(pen, 2)),)
    if len(frequencies_hz) != 1:
        raise BadInput("`frequencies_hz`: the start-up sweep needs exactly one frequency")
    check_rate(pen, 2 * pen.limits.span_V * check_frequency(pen, frequencies_hz[0]))
    end_V = pen.rest_V if end_V is None else end_V
    if not pen.limits.min_V <= end_V <= pen.limits.max_V:
        raise BadInput(f"`end_V` {end_V:g}: is outside `min_V` {pen.limits.min_V:g} to `max_V` {pen.limits.max_V:g}")
    _decay(pen, (pen.limits.min_V, pen.limits.max_V), end_V, whole("cycles", cycles), frequencies_hz[0])
    return {"end_V": end_V, "frequencies_hz": frequencies_hz}


KINDS: dict[str, Callable[..., dict[str, object]]] = {
    "commission": commission, "sawtooth": sawtooth, "minor-loops": minor_loops, "steps": steps,
    "multisine": multisine, "sine": sine, "chirp": chirp, "startup": startup,
}
OPTION_NAMES = {"frequencies_hz": "frequencies", "rates_V_per_s": "rates", "cycles": "cycles", "levels": "levels",
                "hold_s": "hold", "duration_s": "duration", "seed": "seed", "end_V": "end-V"}


def command_line(kind: str, limits: Limits, output: str, **options: object) -> str:
    """The command that makes a drive, as `make_drive` does; to be typed."""
    parts = ["rdpi excite", kind, f"-o {output}", f"--min-V {limits.min_V:.12g}", f"--max-V {limits.max_V:.12g}",
             f"--sample-rate {limits.sample_rate_hz:.12g}"]
    if limits.sweep_V is not None:
        parts.append("--sweep-V " + ",".join(f"{one:.12g}" for one in limits.sweep_V))
    if limits.slew_V_per_s is not None:
        parts.append(f"--slew {limits.slew_V_per_s:.12g}")
    return " ".join(parts + [f"--{OPTION_NAMES[name]} " + ",".join(f"{one:g}" for one in np.atleast_1d(value))
                             for name, value in options.items()])


def _decay(pen: Pen, ends_V: tuple[float, float], end_V: float, cycles: int, frequency_hz: float) -> None:
    """Triangles around the end voltage, the first between these ends, each smaller than the one before."""
    low, high, half_s = ends_V[0] - end_V, ends_V[1] - end_V, 0.5 / frequency_hz
    for cycle in range(cycles):
        left = 1 - cycle / cycles
        pen.ramp(end_V + high * left, half_s)
        pen.ramp(end_V + low * left, half_s)
    pen.ramp(end_V, half_s)


def _sweep_hz(pen: Pen) -> float:
    return min(SWEEP_HZ, pen.limits.sample_rate_hz / SAMPLES_PER_PERIOD)


def _default_frequencies(pen: Pen, steepness: float) -> tuple[float, ...]:
    scale = min(1.0, highest_hz(pen, steepness) / FREQUENCIES_HZ[-1])
    return tuple(scale * frequency for frequency in FREQUENCIES_HZ)


def _text(value: object) -> str:
    return " ".join(f"{part:.12g}" for part in np.atleast_1d(value).tolist())
