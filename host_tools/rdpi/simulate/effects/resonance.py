"""Resonance: mass and stiffness behind the actuator ring."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ... import firmware
from ...data import Recording
from ...firmware import Block
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .planned import PlannedDrive, Shown, time_text
from .treatment import Treatment

DAMPINGS = 0.02, 0.1, 0.3
PER_OCTAVE = 3  # of the grid, on which only strongly damped ones are found
SHARP = 0.005, 0.02, 0.08  # dampings tried where the residual has a peak
PEAKS, BANDS = 3, 400
AROUND, COARSE = 4, 0.008  # steps tried on either side of a peak, of its damping or of the spectrum's grid
LEAST_PERIOD = 3.0  # samples of a period that can be simulated
OCTAVES = 8
LATE_PER_OCTAVE, LATE_DAMPINGS = 24, (0.01, 0.03, 0.1)  # of the grid for one that what it gets reaches late
LATEST_S, LATEST_TURN, TIMES_PER_OCTAVE = 0.05, 0.5, 2  # by which that may be late; [periods] which all look alike
PROMISING = 3  # starts that are kept by what they explain as they are, and as many by what a multiple of them explains
LEAST_GAIN, BROAD = 0.3, 0.1  # less is what a delay or lag leaves; the sharper it is, the less is like it; damping
SHOWN_DAMPING, RING_PERIODS = 0.05, 5  # what is asked of a drive: so many periods in its longest hold, or in a stroke
FAR = 10.0  # sample rates: a resonance beyond does nothing that such samples show


class Resonance(Effect):
    """x'' + 2 damping w0 x' + w0^2 x = w0^2 z, w0 = 2 pi f0_hz: second order, unit gain at rest."""

    name = "resonance"
    title = "mechanical resonance"
    what = "the moved mass rings on the actuator's stiffness"
    remedy = "stay below a third of f0 or shape the reference; stiffen or lighten the mechanics"
    rings = True
    grows_with_rate = True
    needs = "steps, chirps or multisines that reach its frequency"
    article = "a"
    stages = ("mechanics",)
    of_rig = True
    needs_rates = True
    on_rig = in_gap = {"damping": (1e-3, 0.3)}  # what is damped more does not ring: it is late, as by a delay or lag
    parameters = Parameter("f0_hz", "Hz", 1e-3, np.inf, np.inf), Parameter("damping", "1", 1e-3, 0.95, 0.05)

    def least_gain(self, values: Values) -> float:
        return LEAST_GAIN * min(1.0, values["damping"] / BROAD)

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        """Exact for a signal that is straight between samples (first-order hold)."""
        turn = values["f0_hz"] * sample_time_s  # per sample
        return firmware.ring_block(*_filter(2 * np.pi * turn, values["damping"])) if turn < 0.5 else None

    def missing_in(self, run: Recording, values: Values) -> str:
        turn = values["f0_hz"] * run.sample_time_s
        return f"has {run.sample_rate_hz:g} samples per second, too few for {values['f0_hz']:.4g} Hz" \
            if 0.5 <= turn < FAR else ""

    def before(self, shown_um: np.ndarray, run: Recording, values: Values) -> np.ndarray:
        """conj(F) / max(1, |F|^2) of it, with F the response: 1 / F as far as F amplifies; faster signals, which hardly
        pass, are not made larger.
        """
        from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

        count = next_fast_len(2 * len(shown_um), real=True)
        turn = rfftfreq(count, run.sample_time_s) / values["f0_hz"]
        response = _response(turn, values["damping"])
        mean = float(np.mean(shown_um))
        spectrum = rfft(shown_um - mean, count) * np.conj(response) / np.maximum(1, np.abs(response) ** 2)
        return mean + irfft(spectrum, count)[:len(shown_um)]

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        w = 2 * np.pi * values["f0_hz"]
        return Treatment("compensated", f"by the lead, well below {values['f0_hz']:.4g} Hz; references that excite it "
                         "still make it ring", lead=(2 * values["damping"] / w, 1 / w**2))

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        lowest, highest = _ends_hz(residuals)
        octaves = np.arange(0, min(OCTAVES, np.log2(highest / lowest)), 1 / PER_OCTAVE)
        grid = [(highest / 2**octave, damping) for octave in octaves for damping in DAMPINGS]
        # A slightly damped one is too narrow for a grid, but rings at its own frequency.
        grid += [(peak * (1 + step * max(damping, COARSE)), damping) for peak in _peaks(residuals, lowest, highest)
                 for damping in SHARP for step in range(-AROUND, AROUND + 1)]
        return [{"f0_hz": float(f0), "damping": damping} for f0, damping in _promising(residuals, grid)]

    def late_starts(self, residuals: Residuals) -> list[tuple[dict[str, float], float]]:
        """None as well if that hardly explains more than what is late and does not ring.

        A quarter of a period late, it rings so far out of step that neither it nor a delay alone explains anything.
        """
        spectra = residuals.spectra
        lowest, highest = _ends_hz(residuals)
        octaves = np.arange(0, min(OCTAVES, np.log2(highest / lowest)), 1 / LATE_PER_OCTAVE)
        f0_hz, damping = (axis.reshape(-1, 1) for axis in np.meshgrid(highest / 2**octaves, LATE_DAMPINGS))
        late_s = np.r_[0, LATEST_S / 2 ** np.arange(0, np.log2(4 * LEAST_PERIOD * highest * LATEST_S), 1 / TIMES_PER_OCTAVE)]
        turn = spectra.hertz / f0_hz
        still = np.ones((1, len(spectra.hertz)))
        product, energy = spectra.explained_late(np.vstack([still, _response(turn, damping)]), late_s)
        rounded = 1e-12 * np.sum(spectra.power_um2)  # a change by nothing has no energy
        as_they_are, multiples = 2 * product - energy, product**2 / np.maximum(energy, rounded)
        missed = sum(float(left @ left) for left in residuals.residual_um)
        found = {}
        for squares in (multiples, as_they_are):
            among = np.where(f0_hz * late_s <= LATEST_TURN, squares[1:], -np.inf)
            ringing, time = np.unravel_index(np.argmax(among), among.shape)
            values = {"f0_hz": float(f0_hz[ringing, 0]), "damping": float(damping[ringing, 0])}
            if missed - among[ringing, time] < (1 - self.least_gain(values)) * (missed - max(np.max(squares[0]), 0.0)):
                found[ringing, time] = values, float(late_s[time])
        return list(found.values())

    def amplification(self, values: Values, highest_hz: float) -> float:
        damping = values["damping"]
        turn = min(highest_hz / values["f0_hz"], float(np.sqrt(max(0.0, 1 - 2 * damping**2))))  # where |F| is largest
        return float(abs(_response(turn, damping)))

    def rings_within(self, stroke_s: float, values: Values) -> bool:
        return values["f0_hz"] * stroke_s > RING_PERIODS

    def shown(self, drive: PlannedDrive) -> Shown | None:
        lowest, highest = RING_PERIODS / drive.hold_s, drive.rate_hz / LEAST_PERIOD
        if lowest >= highest:
            return Shown("no hold is long enough for it to ring; give a longer --duration")
        grid = np.geomspace(lowest, highest, 1 + int(PER_OCTAVE * np.log2(highest / lowest)))
        changes = (drive.change(self, f0_hz=f0_hz, damping=SHOWN_DAMPING) for f0_hz in grid)
        # On its slow side it looks like delay and lag.
        seen = drive.least(changes, [drive.later(), drive.lagged(2 * drive.step_s)]) <= 1
        if not seen.any():
            return Shown("the edges are too slow to make it ring; allow a higher --slew or faster --rates")
        # The edge's spectrum has gaps; above the first one only some resonances would ring.
        first = int(np.argmax(seen))
        last = len(seen) - 1 if seen[first:].all() else first + int(np.argmin(seen[first:])) - 1
        why = (f"a period must have {LEAST_PERIOD:g} samples" if last == len(seen) - 1 else
               f"edges of {time_text(drive.edge_s)} do not make a higher one ring")
        return Shown(f"from {grid[first]:.4g} to {grid[last]:.4g} Hz, with a damping of {SHOWN_DAMPING:g}; {why}",
                     float(grid[first]), float(grid[last]), "Hz")


def _response(turn: np.ndarray | float, damping: np.ndarray | float) -> np.ndarray | complex:
    """At frequencies f0_hz times these."""
    return 1 / (1 - turn**2 + 2j * damping * turn)


def _ends_hz(residuals: Residuals) -> tuple[float, float]:
    """Between which recordings can show a frequency."""
    rate = min(run.sample_rate_hz for run in residuals.runs)
    longest = max(len(run) * run.sample_time_s for run in residuals.runs)
    return 4 / longest, rate / LEAST_PERIOD


def _peaks(residuals: Residuals, lowest_hz: float, highest_hz: float) -> list[float]:
    """Frequencies at which the residual is strongest beside what was asked for, of the recordings together."""
    from scipy.fft import next_fast_len, rfft, rfftfreq

    edges = np.geomspace(lowest_hz, highest_hz, BANDS + 1)
    ratio, lines = np.zeros(BANDS), []
    for run, residual, predicted in zip(residuals.runs, residuals.residual_um, residuals.predicted_um):
        count = next_fast_len(len(run), real=True)
        hertz = rfftfreq(count, run.sample_time_s)
        window = np.hanning(len(run))
        missed, asked = (np.abs(rfft(window * signal, count)) ** 2
                         for signal in (residual, np.gradient(predicted - np.mean(predicted))))
        floor = max(1e-3 * np.mean(asked), 1e-9 * np.mean(missed), np.finfo(float).tiny)
        inside = (hertz > lowest_hz) & (hertz < highest_hz)
        band = np.searchsorted(edges, hertz[inside]) - 1
        ratio += (np.bincount(band, missed[inside], BANDS)
                  / np.maximum(np.bincount(band, asked[inside] + floor, BANDS), np.finfo(float).tiny))
        lines.append((hertz, missed / max(np.sum(missed), np.finfo(float).tiny)))
    finest_hz, found = min(hertz[1] for hertz, _ in lines), []
    for _ in range(PEAKS):
        best = int(np.argmax(ratio))
        ratio[max(0, best - 10):best + 11] = 0
        # A sharp resonance is narrower than a band.
        grid = np.arange(edges[best], edges[best + 1], finest_hz)
        found.append(float(grid[np.argmax(sum(np.interp(grid, *line) for line in lines))]))
    return found


def _promising(residuals: Residuals, grid: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Those of (f0_hz, damping) that explain most of the residual."""
    spectra = residuals.spectra
    f0_hz, damping = np.array(grid).T[:, :, None]
    turn = spectra.hertz / f0_hz
    product, energy = spectra.explained(_response(turn, damping) - 1)
    as_they_are, multiples = 2 * product - energy, product**2 / np.maximum(energy, np.finfo(float).tiny)
    best = [k for squares in (as_they_are, multiples) for k in np.argsort(-squares)[:PROMISING]]
    return [grid[k] for k in dict.fromkeys(best)]


@lru_cache(maxsize=256)
def _filter(w: float, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator; w in radians per sample."""
    from scipy.signal import cont2discrete

    numerator, denominator, _ = cont2discrete(([w * w], [1, 2 * damping * w, w * w]), 1.0, method="foh")
    return np.ravel(numerator), denominator
