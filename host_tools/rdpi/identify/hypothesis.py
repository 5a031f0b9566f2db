"""What may stand around the operator, as a hypothesis, and the recordings that it is held against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .. import firmware
from ..data import Recording
from ..model import Model
from ..simulate import effects, memory, signals
from ..simulate.effects import Acting
from . import thresholds as tuned
from .strokes import Strokes, covered, strokes_of

ROWS = 12_000  # about so many samples count: more say no more
FASTEST = 1.25  # of the highest rate; faster samples count as so fast


@dataclass(frozen=True)
class Hypothesis:
    """What acts beside the rate-independent operator."""

    acting: tuple[Acting, ...] = ()  # in the order of the chain
    rated: bool = False  # slopes depend on the rate

    def having(self, one: Acting) -> Hypothesis:
        return replace(self, acting=tuple(effects.in_order([*self.acting, one])))

    def lacking(self, one: Acting) -> Hypothesis:
        return replace(self, acting=tuple(other for other in self.acting if other is not one))

    def beside(self, other: Hypothesis) -> list[Acting]:
        """Effects that the other lacks."""
        names = {one.effect.name for one in other.acting}
        return [one for one in self.acting if one.effect.name not in names]

    @property
    def comes_late(self) -> bool:
        return any(one.effect.comes_late for one in self.acting)

    @property
    def size(self) -> int:
        """Number of parameters of effects. A rate law counts nothing: what it explains is not to pass for a delay."""
        return sum(len(one.effect.fitted) for one in self.acting)


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The regression's linear unknowns."""

    rest: np.ndarray  # W_i at rest
    change: np.ndarray  # W_i at the highest rate less rest
    pieces: np.ndarray  # U_1 ... U_m


@dataclass(frozen=True, eq=False)
class Setting:
    """What is the same for every hypothesis."""

    runs: Sequence[Recording]
    states_um: Sequence[np.ndarray | None]  # plays before the first sample; None: at rest where the drive begins
    first: Sequence[int]  # samples before this depend on an unknown memory
    model: Model  # gain, offset, thresholds and drive
    corners_um: np.ndarray  # of the inverse saturation, um of measured displacement
    rates_um_per_s: Sequence[np.ndarray]
    top_um_per_s: float
    rate_filter_s: float = 0.0  # of the low-pass that the rates have passed

    @cached_property
    def rows(self) -> list[np.ndarray]:
        """Samples of each run that count."""
        stride = max(1, sum(len(run) for run in self.runs) // ROWS)
        rows = []
        for run, first in zip(self.runs, self.first):
            rows.append(signals.uneven(first, len(run), stride))
        return rows

    @cached_property
    def asides(self) -> list[np.ndarray]:
        """What each run shows that is no matter of the model, (counted samples, columns), orthonormal: its offset, what
        goes on creeping in it from before, where no sweep was before it, and what depends on an unknown start of the plays.
        """
        found = []
        for run, start, rows in zip(self.runs, self.states_um, self.rows):
            columns = [np.ones(len(rows))]
            if run.memory != "reset":
                columns.append(signals.goes_on(len(run))[rows])
            if run.memory == "unknown" and start is not None:
                moved = memory.first_moved(self.model.x_of(run.command_V), self.model.thresholds_um, start)
                columns.append(rows[:, None] < moved)
            found.append(_orthonormal(np.column_stack(columns)))
        return found

    @cached_property
    def samples(self) -> int:
        return sum(map(len, self.rows))

    @cached_property
    def shares(self) -> list[np.ndarray]:
        """Rate over the highest one, per run."""
        return [np.minimum(rate / self.top_um_per_s, FASTEST) for rate in self.rates_um_per_s]

    @cached_property
    def others_cover(self) -> bool:
        """Whether each run may be left out as a whole: the others move where it does, and at several rates if all do. What
        comes late is a loop at one rate, and a model of that says nothing of others.
        """
        if not all(covered(self.runs)):
            return False
        strokes = list(map(strokes_of, self.runs))
        return not Strokes.among(strokes).rates_differ or all(
            Strokes.among([*strokes[:k], *strokes[k + 1:]]).rates_differ for k in range(len(strokes)))

    def thinned(self, shortest_s: float) -> Setting:
        """With every second sample, or every third and so on, of the runs that were sampled faster than a choice needs;
        itself if none was. Fast strokes take `shortest_s`.
        """
        enough_hz = max(tuned.CHOICE_HZ, tuned.CHOICE_STROKE / shortest_s)
        steps = [max(1, min(int(run.sample_rate_hz / enough_hz), len(run) // tuned.CHOICE_LEAST)) for run in self.runs]
        if max(steps) == 1:
            return self
        runs = [replace(run, metadata={**run.metadata, "sample_rate_hz": repr(run.sample_rate_hz / step)},
                        columns={name: np.ascontiguousarray(column[::step]) for name, column in run.columns.items()})
                for run, step in zip(self.runs, steps)]
        return replace(self, runs=runs, first=[-(-first // step) for first, step in zip(self.first, steps)],
                       rates_um_per_s=[rate[::step] for rate, step in zip(self.rates_um_per_s, steps)])

    def driven(self, k: int, acting: Sequence[Acting]) -> Recording:
        return effects.driven_run(acting, self.runs[k], self.model)

    def plays(self, k: int, drive_V: np.ndarray) -> np.ndarray:
        """y_i - y_(i+1) of a run at the samples that count, (samples, n + 1).

        Only turning points matter of all that lies between.
        """
        turns = np.flatnonzero(np.diff(np.sign(np.diff(drive_V)))) + 1
        used = np.union1d(self.rows[k], turns)
        return _differences(self._outputs(k, drive_V, used)[np.searchsorted(used, self.rows[k])])

    def superposed(self, k: int, drive_V: np.ndarray, found: Unknowns) -> tuple[np.ndarray, np.ndarray]:
        """`plays`, and what all of them sum up to at every sample, (samples,)."""
        outputs = self._outputs(k, drive_V, slice(None))
        v = outputs @ np.diff(found.rest, prepend=0.0)
        if np.any(found.change):
            v += self.shares[k] * (outputs @ np.diff(found.change, prepend=0.0))
        return _differences(outputs[self.rows[k]]), v

    def all_plays(self, k: int, drive_V: np.ndarray) -> np.ndarray:
        """`plays` at every sample."""
        return _differences(self._outputs(k, drive_V, slice(None)))

    def _outputs(self, k: int, drive_V: np.ndarray, used: np.ndarray | slice) -> np.ndarray:
        x, r, start = self.model.x_of(drive_V), self.model.thresholds_um, self.states_um[k]
        if start is not None and self.runs[k].memory == "reset":
            start = self.model.swept(float(x[0]))  # the sweep ended where it was driven to
        return firmware.plays(x[used], r, np.full(len(r), x[0]) if start is None else start)[0]

    def segments(self, z_um: np.ndarray) -> np.ndarray:
        """seg_0 ... seg_m, (samples, m + 1)."""
        beyond = np.maximum(z_um[:, None] - self.corners_um, 0)
        parts = np.hstack([z_um[:, None], beyond])
        parts[:, :-1] -= beyond
        return parts

    def straightened(self, z_um: np.ndarray, found: Unknowns) -> np.ndarray:
        """sum_j U_j seg_j."""
        return self.segments(z_um) @ np.r_[1.0, found.pieces]

    def bent(self, v_um: np.ndarray, found: Unknowns) -> np.ndarray:
        """The inverse of `straightened`."""
        if not len(self.corners_um):
            return v_um
        corners = self.corners_um
        levels = self.straightened(corners, found)
        below, above = np.minimum(v_um - levels[0], 0), np.maximum(v_um - levels[-1], 0) / found.pieces[-1]
        return np.interp(v_um, levels, corners) + below + above


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """A basis of what the columns span."""
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return basis[:, sizes > 1e-9 * sizes[0]]


def _differences(outputs: np.ndarray) -> np.ndarray:
    """Of each play and the next one; in place."""
    outputs[:, :-1] -= outputs[:, 1:]
    return outputs


def bounds(one: Acting, name: str) -> tuple[float, float]:
    """Of a parameter on a rig."""
    parameter = next(item for item in one.effect.parameters if item.name == name)
    return one.effect.on_rig.get(name, parameter.ends)


def scale_of(one: Acting, name: str) -> float:
    """A parameter that is always positive moves in its logarithm."""
    return one.values[name] if bounds(one, name)[0] > 0 else 1.0


def shifted(one: Acting, step: dict[str, float]) -> Acting:
    """With parameters moved within bounds, those in their logarithm by factors; as it was if they cannot stand
    together.
    """
    values = dict(one.values)
    for name, move in step.items():
        low, high = bounds(one, name)
        new = values[name] * np.exp(np.clip(move, -1.0, 1.0)) if low > 0 else values[name] + move
        values[name] = float(np.clip(new, low, high))
    return one if one.effect.refusal(values) else Acting(one.effect, values)
