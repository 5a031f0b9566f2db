"""The regression behind a fit: recordings as columns, reduced to a triangular factor, and the search that works on it.

With the dead zones given, the model (Ang et al. 2003, eq. 8, 9, 14-17) is linear in its parameters once the saturation
stage stands on the side of the displacement:

    sum_i W_i(rho) (y_i - y_(i+1)) + offset = sum_j U_j seg_j(z),     W_i(rho) = A_i (1 - rho / top) + B_i rho / top

y_i are the outputs of the plays, U_j the slopes of the inverse saturation on its pieces (U_0 = 1) and seg_j the part of
z on piece j. A_i and B_i are the slopes at rest and at the highest rate, so that keeping every slope positive over the
whole range of rates is a lower bound on each unknown. The data are reduced to one small triangular factor; the outer
search over dead zones and the strength of the prior work on that alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .. import firmware
from ..data import ENDS, Recording
from ..model import Model
from ..simulate import memory, signals
from . import thresholds as tuned
from .checks import reversals

CHUNK = 1 << 12  # samples held as columns at a time: what fits into a processor's cache


@dataclass
class Run:
    """A recording prepared for the regression."""

    recording: Recording
    x_um: np.ndarray
    rate_um_per_s: np.ndarray
    states_um: np.ndarray
    first: int  # samples before this depend on unknown memory
    steps: np.ndarray  # samples up to which a play adds a constant, where its start is an estimate, (steps,)

    def asides(self, part: slice) -> np.ndarray:
        """What is no matter of the model, (samples of the part, columns); the first is the offset."""
        always = signals.asides(self.recording)[part]
        return np.hstack([always, np.arange(part.start, part.start + len(always))[:, None] < self.steps])


class Solution(NamedTuple):
    """A candidate: slopes at rest and at the highest rate, inverse saturation, and how well it fits."""

    rest: np.ndarray  # A_i
    fast: np.ndarray  # B_i
    picks: tuple[int, ...]  # dead zones, as indices into the grid
    pieces: np.ndarray  # U_0 ... U_m
    cost: float
    residual: float  # rms, as a share of the stroke


class Columns(NamedTuple):
    """Layout of the regression's columns: plays (twice with a rate law), candidate dead zones, displacement."""

    thresholds_um: np.ndarray
    grid_um: np.ndarray
    top_um_per_s: float  # 0: rate-independent

    @property
    def plays(self) -> int:
        return len(self.thresholds_um) * (2 if self.top_um_per_s else 1)

    def blocks(self, run: Run, every: int = 1) -> Iterator[np.ndarray]:
        """Blocks of at most CHUNK rows, one row for `every` samples, warm-up left out; first the columns of
        Run.asides.
        """
        states = run.states_um
        z = run.recording.displacement_um
        for start in range(0, len(z), CHUNK):
            part = slice(start, start + CHUNK)
            outputs, states = firmware.plays(run.x_um[part], self.thresholds_um, states)
            outputs[:, :-1] -= outputs[:, 1:]
            if self.top_um_per_s:
                share = (run.rate_um_per_s[part] / self.top_um_per_s)[:, None]
                outputs = np.hstack([outputs * (1 - share), outputs * share])
            zone = np.maximum(z[part, None] - self.grid_um, 0)
            block = np.hstack([run.asides(part), outputs, zone, z[part, None]])
            block = block[max(0, run.first - start)::every]
            if len(block):
                yield block


class Reduced(NamedTuple):
    """What the regression needs of one run; displacements in units of the stroke."""

    factor: np.ndarray  # triangular, of all columns without what is no matter of the model: each run has its own offset
    means: np.ndarray  # of the columns, beside what goes on creeping
    samples: int


def reduce(runs: Sequence[Run], columns: Columns, stroke: float,
            progress: Callable[[float], None] = lambda fraction: None, every: int = 1) -> list[Reduced]:
    reduced: list[Reduced] = []
    everything, done = sum(len(run.x_um) for run in runs), 0
    for run in runs:
        aside = run.asides(slice(0, 1)).shape[1]
        factor, samples = np.zeros((0, aside + columns.plays + len(columns.grid_um) + 1)), 0
        for block in columns.blocks(run, every):
            block[:, aside:] /= stroke
            factor = np.linalg.qr(np.vstack([factor, block]), mode="r")
            samples += len(block)
            progress(min(1.0, (done + samples) * every / everything))
        done += samples
        means = np.linalg.lstsq(factor[:aside, :aside], factor[:aside, aside:], rcond=None)[0][0]
        reduced.append(Reduced(factor[aside:, aside:], means, samples))
    return reduced


def joined(reduced: Sequence[Reduced]) -> tuple[np.ndarray, int]:
    """Triangular factor of several runs together, and their samples."""
    factor = reduced[0].factor[:0]
    for run in reduced:
        factor = np.linalg.qr(np.vstack([factor, run.factor]), mode="r")
    return factor, sum(run.samples for run in reduced)


def assemble(rows: np.ndarray, columns: Columns, picks: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Design matrix [plays, -seg_1 ... -seg_m] and target seg_0, for dead zones at grid[picks]."""
    zones = rows[:, [columns.plays + j for j in picks]]
    parts = np.hstack([rows[:, -1:], zones])
    parts[:, :-1] -= zones
    return np.hstack([rows[:, :columns.plays], -parts[:, 1:]]), parts[:, 0]


def prior(n: int, plays: int, m: int, law: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Rows and targets that keep the loading curve smooth, the rate law smooth and small, the saturation straight.

    For n slopes in as many columns, `plays`, or with a rate law twice as many, and m dead zones. `law` is a factor on
    what holds the rate law.
    """
    return _prior(n, plays, m, tuned.PRIOR_BEND, law * tuned.PRIOR_RATE_BEND, law * tuned.PRIOR_RATE,
                  tuned.PRIOR_SATURATION)


@lru_cache(maxsize=16)
def _prior(n: int, plays: int, m: int, curve_bend: float, rate_bend: float, rate: float, saturation: float
           ) -> tuple[np.ndarray, np.ndarray]:
    bend, none = np.diff(np.eye(n), 2, axis=0), np.zeros
    rows = [curve_bend * np.hstack([bend, none((len(bend), plays + m - n))])]
    if plays > n:
        rows.append(rate_bend * np.hstack([-bend, bend, none((len(bend), m))]))
        rows.append(rate * np.hstack([-np.eye(n), np.eye(n), none((n, m))]))
    straight = saturation * np.hstack([none((m, plays)), np.eye(m)])
    rows.append(straight)
    return np.vstack(rows), np.r_[none(sum(map(len, rows)) - m), straight.sum(axis=1)]


def solve(factor: np.ndarray, columns: Columns, picks: tuple[int, ...], samples: int, residual: float) -> Solution:
    """Slopes and pieces for given dead zones; `residual` is the relative error that the prior is weighed against."""
    from scipy.optimize import lsq_linear

    n, m = len(columns.thresholds_um), len(picks)
    design, target = assemble(factor, columns, picks)
    wanted, wish = (residual * np.sqrt(samples) * part for part in prior(n, columns.plays, m))
    low = np.r_[np.full(columns.plays, tuned.SLOPE_FLOOR), np.full(m, tuned.PIECE_RANGE[0])]
    high = np.r_[np.full(columns.plays, np.inf), np.full(m, tuned.PIECE_RANGE[1])]
    both = np.vstack([design, wanted]), np.r_[target, wish]
    found = np.linalg.lstsq(*both, rcond=None)[0]
    if np.any(found < low) or np.any(found > high):
        found = lsq_linear(*both, (low, high), method="bvls").x
    left = np.sum((design @ found - target) ** 2)
    cost = np.sum((both[0] @ found - both[1]) ** 2)
    rest = found[:n]
    fast = found[n:2 * n] if columns.top_um_per_s else rest
    return Solution(rest, fast, picks, np.r_[1.0, found[columns.plays:]], float(cost), float(np.sqrt(left / samples)))


def search(factor: np.ndarray, columns: Columns, m: int, samples: int) -> Solution:
    """Outer search over the dead zones, one at a time until none moves; the prior follows the residual."""
    spread = np.linspace(0, len(columns.grid_um) - 1, m + 2)[1:-1]
    solution = solve(factor, columns, tuple(int(round(j)) for j in spread), samples, 1e-3)
    for _ in range(4):
        residual = solution.residual
        solution = solve(factor, columns, solution.picks, samples, residual)
        before = solution.picks
        for j in range(m):
            lowest = solution.picks[j - 1] + tuned.GRID_GAP if j else 0
            highest = solution.picks[j + 1] - tuned.GRID_GAP if j + 1 < m else len(columns.grid_um) - 1
            for place in range(lowest, highest + 1):
                picks = (*solution.picks[:j], place, *solution.picks[j + 1:])
                solution = min(solution, solve(factor, columns, picks, samples, residual), key=lambda p: p.cost)
        if solution.picks == before:
            break
    return solution


def without_rate(factor: np.ndarray, columns: Columns) -> tuple[np.ndarray, Columns]:
    """The same regression with slopes that do not depend on rate: both columns of a play added."""
    n = len(columns.thresholds_um)
    return np.hstack([factor[:, :n] + factor[:, n:2 * n], factor[:, 2 * n:]]), columns._replace(top_um_per_s=0.0)


def offset_of(means: np.ndarray, columns: Columns, solution: Solution) -> float:
    """Offset of one run, in units of the stroke: what its means leave."""
    design, target = assemble(means[None, :], columns, solution.picks)
    slopes = np.r_[solution.rest, solution.fast] if columns.top_um_per_s else solution.rest
    return float((target - design @ np.r_[slopes, solution.pieces[1:]])[0])


def saturation_of(corners_um: np.ndarray, pieces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d_j and ws_j of S from the corners of its inverse (in um of z, positive, increasing) and the slopes U_j of
    that.
    """
    deadzones = np.r_[0.0, np.cumsum(np.diff(corners_um, prepend=0.0) * pieces[:-1])]
    return deadzones, np.diff(1 / pieces, prepend=0.0)


def smoothing_times_s(runs: Sequence[Recording]) -> list[float]:
    return [signals.smoothing_time_s(run.displacement_um, run.sample_time_s) for run in runs]


def prepare(runs: Sequence[Recording], bare: Model, smoothing_s: Sequence[float], swept: Callable[[float], np.ndarray]
            ) -> list[Run]:
    """`bare` has gain, offset, thresholds and rate estimator; `swept` gives the states of the plays after a sweep that
    ended at a control input.
    """
    law = bare.rate
    prepared: list[Run] = []
    end: np.ndarray | None = None
    for run, smoothing in zip(runs, smoothing_s):
        x = bare.gain_um_per_V * (run.command_V - bare.offset_V)
        rate = rate_of(run, x, law.source, law.window_s, law.filter_s, smoothing)
        states, first = start_of(run, x, bare, swept, end)
        steps = np.zeros(0, int)
        if run.past is not None:
            moved = np.unique(memory.first_moved(x, bare.thresholds_um, states))
            steps = moved[(moved > 0) & (moved < len(x))]
        prepared.append(Run(run, x, rate, states, first, steps))
        end = firmware.plays(x, bare.thresholds_um, states)[1]
    return prepared


def start_of(run: Recording, x_um: np.ndarray, bare: Model, swept: Callable[[float], np.ndarray], end: np.ndarray | None
             ) -> tuple[np.ndarray, int]:
    """The plays before a run, (n + 1,), and the first sample that does not depend on them where they are not known.

    Where such a run never erases them, or hardly goes on from there, it counts all the same, as if a sweep had ended
    there, until they are estimated.
    """
    if run.past is not None:
        return memory.plays_of(run.past, bare), 0
    if run.memory == "carried" and end is not None:
        return np.array(end), 0
    if run.memory in ENDS:
        return memory.entered_plays(bare, float(x_um[0]), run.memory), 0
    states, first = swept(float(x_um[0])), 0
    if run.memory != "reset":
        first = memory.warm_up(x_um, bare.thresholds_um[-1])
        enough = len(x_um) - first >= 2 * tuned.MIN_SAMPLES_PER_UNKNOWN * len(bare.thresholds_um)  # two slopes per play
        first = first if enough and reversals(x_um, 0.1, first) else 0
    return states, first


def parts_of(run: Run, thresholds_um: np.ndarray, parts: Sequence[slice]) -> Iterator[Run]:
    """Parts of a run, one after the other from its first sample on, each with the plays as they are where it begins."""
    states = run.states_um
    for part in parts:
        recording = replace(run.recording, columns={name: column[part] for name, column in
                                                    run.recording.columns.items()})
        yield replace(run, recording=recording, x_um=run.x_um[part], rate_um_per_s=run.rate_um_per_s[part],
                      states_um=states, first=max(0, run.first - part.start),
                      steps=run.steps[(run.steps > part.start) & (run.steps < part.stop)] - part.start)
        states = firmware.plays(run.x_um[part], thresholds_um, states)[1]


def rate_of(run: Recording, x_um: np.ndarray, source: str, window_s: float, filter_s: float,
            smoothing_s: float) -> np.ndarray:
    """The rate that modulates the slopes; the command is free of noise and is not smoothed."""
    if source == "control":
        return signals.rate(x_um, run.sample_time_s, window_s, filter_s, 0.0)
    rate = signals.rate(run.displacement_um, run.sample_time_s, window_s, filter_s, smoothing_s)
    if run.past is not None and filter_s > 0:
        rate += run.past.rate_um_per_s * np.exp(-np.arange(len(rate)) * run.sample_time_s / filter_s)
    return rate


def rerated(runs: Sequence[Run], source: str, window_s: float, filter_s: float, smoothing_s: Sequence[float]
            ) -> list[Run]:
    """The same runs with another rate."""
    return [replace(run, rate_um_per_s=rate_of(run.recording, run.x_um, source, window_s, filter_s, smoothing))
            for run, smoothing in zip(runs, smoothing_s)]


def top_rate(runs: Sequence[Run]) -> float:
    """The highest rate, um/s, but for one sample in a thousand; samples of an unknown memory do not count."""
    return float(np.percentile(np.concatenate([run.rate_um_per_s[run.first:] for run in runs]), 99.9))
