"""A drive before it is played: how well a model can be told from what it will show.

The drive is put on a nominal actuator (plays that make a loop a tenth of the stroke wide). Each effect is turned into
the change of the displacement that it makes. Least squares then says how well the change can be told beside all that
imitates it: the plays, their rate law, bent curves, drift, and other effects. An effect counts as shown from SURE
standard errors on.

Two things blur it: the sensor's white noise, and what the operator misses. Where the drive moves, that takes about
PER_BRANCH independent values from one reversal to the next, once per rate for triangles, which only repeat. Behind an
edge it takes one value over the first EDGE_SAMPLES and one for each further octave of time: a hold ten times as long
tells little more.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ... import firmware
from ...data import Recording
from ...model import Drive, Memory, Model, Rate
from .base import Effect

NOISE = 0.0005  # rms of a reading, of the stroke: a usual sensor
MISFIT = 0.005  # rms that an operator misses where it moves, of the move
PER_BRANCH, EDGE_SAMPLES = 4, 20
SURE = 3.0
THRESHOLDS = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.4])  # of plays, of the range
SLOPES = np.array([0.75, 0.83, 0.89, 0.94, 0.97, 1.0])
RATED = 0, 2, 4  # plays whose weights may follow the rate
SETTLED = 3.0  # time constants that a hold must last to show where a lag ends
PER_DECADE = 4  # time constants tried
SLOW_S = 10.0 ** np.arange(-1.0, 3.01, 0.5)  # what goes on for long follows by lags of all decades
THIN_PER_PERIOD, THIN_PER_OCTAVE = 50, 40  # samples looked at: of the multisine's highest line, and behind an edge


class Shown(NamedTuple):
    """From which to which size a drive shows something. Without a lowest it does not, and the text says why."""

    text: str
    low: float | None = None
    high: float | None = None
    unit: str = ""


class PlannedDrive:
    """A drive of `rdpi excite commission`, what the nominal actuator makes of it, and what least squares needs.

    `run` holds the command alone. Displacements are in shares of the range.
    """

    def __init__(self, run: Recording) -> None:
        metadata = run.metadata
        self.run, self.rate_hz, self.step_s = run, run.sample_rate_hz, run.sample_time_s
        low_V, high_V = float(metadata["min_V"]), float(metadata["max_V"])
        self.span_V = high_V - low_V
        self.model = _nominal(low_V, high_V)
        self.parts = {name: slice(*(round(float(time) * self.rate_hz) for time in times.split("-")))
                      for name, times, _ in (part.split() for part in metadata["parts"].split(", "))}
        self.u = np.asarray(self.model.x_of(run.command_V))
        self.turns = _turns(self.u)
        self.plays = self._plays(self.u)
        self.z = self.plays @ np.diff(SLOPES, prepend=0.0)
        self.speed = np.abs(np.gradient(self.u)) * self.rate_hz
        self.edges = self._edges()
        self.holds = np.append(self.edges, len(self.u))
        self.blur = self._blur()
        self.rows, self.weight = self._rows(max(float(f) for f in metadata["multisine_hz"].split()))
        self.imitators = self._imitators()

    @property
    def hold_s(self) -> float:
        """The longest hold."""
        return float(np.diff(self.holds).max()) * self.step_s

    @property
    def edge_s(self) -> float:
        """How long the move to a step lasts."""
        begin, end = self.edges[-2], self.edges[-1]
        return float(1 + np.argmax(self.u[begin:end] == self.u[end - 1])) * self.step_s

    def change(self, effect: Effect, **values: float) -> np.ndarray:
        """What an effect adds to the displacement, (samples,)."""
        command_V = self.run.command_V
        drive_V = effect.drive(command_V, self.run, values, self.model)
        z = self.z if drive_V is command_V else self._plays(np.asarray(self.model.x_of(drive_V))) @ np.diff(
            SLOPES, prepend=0.0)
        return effect.displacement(z, self.run, values, self.model) - self.z

    def later(self) -> np.ndarray:
        """Change of the displacement, per second, if all came later."""
        return -np.diff(self.z, prepend=self.z[0]) * self.rate_hz

    def lagged(self, time_s: float) -> np.ndarray:
        """Change of the displacement behind a low-pass of first order."""
        return firmware.lags(self.z, self.step_s, [time_s], [0.0])

    def slow(self) -> np.ndarray:
        """Change of a displacement that follows by one percent per decade, decade after decade."""
        return sum(self.lagged(time_s) for time_s in SLOW_S) / 200

    def times_s(self) -> np.ndarray:
        """Time constants from far under a sample to the longest hold."""
        first, last = np.log10(0.01 * self.step_s), np.log10(self.hold_s / SETTLED)
        return np.logspace(first, last, max(2, round(PER_DECADE * (last - first))))

    def least(self, changes: Iterable[np.ndarray], beside: Sequence[np.ndarray] = (), instead_of: str = ""
              ) -> np.ndarray:
        """Least multiple of each change that counts as shown, by itself beside these and the imitators, (changes,).

        `instead_of` names the imitators that are left out. `changes` may be an iterator: one at a time is held.
        """
        known = [columns for name, columns in self.imitators.items() if name != instead_of]
        design = np.column_stack([*known, *(rival[self.rows] for rival in beside)]) * self.weight[:, None]
        design /= np.maximum(np.linalg.norm(design, axis=0), np.finfo(float).tiny)
        gram, found = design.T @ design, []
        for change in changes:
            change = change[self.rows] * self.weight
            size = max(float(np.linalg.norm(change)), np.finfo(float).tiny)
            cross = design.T @ (change / size)
            left = 1 - float(cross @ np.linalg.lstsq(gram, cross, rcond=1e-10)[0])
            found.append(SURE / (size * np.sqrt(left)) if left >= 1e-9 else np.inf)
        return np.array(found)

    def _plays(self, u: np.ndarray) -> np.ndarray:
        return firmware.plays(u, THRESHOLDS, np.full(len(THRESHOLDS), u[0]))[0]

    def _edges(self) -> np.ndarray:
        """First samples of the moves that end in a hold; the first hold may follow the sawtooth directly."""
        first = self.parts["steps"].start
        moving = np.diff(self.u[first:], append=self.u[-1]) != 0
        begin = np.flatnonzero(moving & ~np.append(False, moving[:-1]))
        return np.unique(np.append(first, first + begin + 1))

    def _blur(self) -> np.ndarray:
        """Variance per sample that makes independent samples as good as what is really there."""
        blur = np.full(len(self.u), NOISE**2)
        for name in ("sweep", "multisine"):
            if part := self.parts.get(name):
                values = PER_BRANCH * max(1, np.count_nonzero((self.turns > part.start) & (self.turns < part.stop)))
                blur[part] += MISFIT**2 * max(1.0, (part.stop - part.start) / values)
        part = self.parts["sawtooth"]
        rates = np.round(np.log(np.maximum(self.speed[part], 1e-9)), 2)
        _, which, counts = np.unique(rates, return_inverse=True, return_counts=True)
        blur[part] += MISFIT**2 * np.maximum(1.0, counts[which] / (2 * PER_BRANCH))
        for edge, end in zip(self.edges, self.holds[1:]):
            # The first hold follows a triangle.
            move = 1.0 if edge == self.parts["steps"].start else np.ptp(self.u[edge - 1:end])
            first = EDGE_SAMPLES + np.argmax(self.u[edge:end] == self.u[end - 1])
            blur[edge:end] += (MISFIT * move) ** 2 * np.maximum(first, np.arange(end - edge))
        return blur

    def _rows(self, highest_hz: float) -> tuple[np.ndarray, np.ndarray]:
        """Samples that are looked at, fewer where all is smooth, and the root of the information in each."""
        every = max(1, int(self.rate_hz / (THIN_PER_PERIOD * highest_hz)))
        rows = [np.arange(0, self.edges[0], every)]
        for edge, end in zip(self.edges, self.holds[1:]):
            count = 2 + int(THIN_PER_OCTAVE * np.log2(max(2, end - edge)))
            near = min(end - edge, 2 * THIN_PER_OCTAVE + int(self.edge_s * self.rate_hz))
            rows.append(edge + np.unique(np.r_[np.arange(near), np.geomspace(1, end - edge, count).astype(int) - 1]))
        rows = np.concatenate(rows)
        return rows, np.sqrt(np.diff(rows, append=len(self.u)) / self.blur[rows])

    def _imitators(self) -> Mapping[str, np.ndarray]:
        """What is fitted in any case, by kind, each (rows, columns); the zero is free in each hold."""
        plays, z = self.plays[self.rows], self.z[self.rows]
        fast = (self.speed / self.speed.max())[self.rows]
        zeros = np.searchsorted(self.edges, self.rows, side="right")
        return {"plays": plays, "bends": np.column_stack([z**2, z**3]), "rate law": fast[:, None] * plays[:, RATED],
                "drift": (2 * self.rows / len(self.u) - 1)[:, None],
                "zeros": (zeros[:, None] == np.arange(len(self.edges) + 1)).astype(float)}


def time_text(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            break
    number = f"{seconds / size:.3g}"
    return f"{float(number):.0f} {unit}" if "e" in number else f"{number} {unit}"


def _nominal(low_V: float, high_V: float) -> Model:
    """An actuator whose stroke is 1 um."""
    none = np.zeros(len(THRESHOLDS))
    return Model(gain_um_per_V=1 / (high_V - low_V), offset_V=(low_V + high_V) / 2, offset_um=0.0, stroke_um=1.0,
                 thresholds_um=THRESHOLDS, slopes=SLOPES, slope_rate_s_per_um=none, deadzones_um=np.zeros(1),
                 deadzone_weights=np.ones(1), rate=Rate(), drive=Drive(low_V, high_V), memory=Memory())


def _turns(u: np.ndarray) -> np.ndarray:
    """Samples at which the signal turns back."""
    steps = np.diff(u)
    moving = np.flatnonzero(steps)
    return moving[1:][np.diff(np.sign(steps[moving])) != 0]
