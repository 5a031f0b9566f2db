"""Strokes: a drive's movements between turning points, and which effects they can show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..data import Recording
from ..simulate.effects import Effect
from . import thresholds as tuned


class Strokes(NamedTuple):
    """Whether the movements between turning points differ; where not, what depends on them looks like a loop."""

    rates_differ: bool
    sizes_differ: bool
    longest_s: float  # time of the slow ones
    shortest_s: float  # and of the fast ones

    @classmethod
    def of(cls, runs: Sequence[Recording]) -> Strokes:
        return cls.among([strokes_of(run) for run in runs])

    @classmethod
    def among(cls, strokes: Sequence[tuple[np.ndarray, np.ndarray]]) -> Strokes:
        """Of sizes in V and times in s of each run's strokes."""
        way, times = (np.concatenate(part) for part in zip(*strokes))
        return cls(_spread(way / times, way) > tuned.SEVERAL_RATES, _spread(way, way) > tuned.SEVERAL_SIZES,
                   *(_quantile(times, way, end) for end in (0.95, 0.05)))

    def show(self, kind: type[Effect]) -> bool:
        return (self.rates_differ or not kind.needs_rates) and (self.sizes_differ or not kind.needs_loops)


def strokes_of(run: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Sizes in V and times in s of a run's strokes."""
    turns = turning_points(run.command_V)
    return np.abs(np.diff(run.command_V[turns])), np.diff(turns) * run.sample_time_s


def covered(runs: Sequence[Recording]) -> list[bool]:
    """Whether the others move over enough of where each run mostly does to say something about it."""
    if len(runs) == 1:
        return [False]
    low, high = np.array([np.percentile(run.command_V, (5, 95)) for run in runs]).T
    found = []
    for k in range(len(runs)):
        others = np.arange(len(runs)) != k
        shared = min(high[k], np.max(high[others])) - max(low[k], np.min(low[others]))
        found.append(bool(shared >= tuned.COVERED * (high[k] - low[k])))
    return found


def _spread(values: np.ndarray, way: np.ndarray) -> float:
    """Ratio of the values between which nine tenths of the way lie."""
    low, high = (_quantile(values, way, end) for end in (0.05, 0.95))
    return high / low if low > 0 else np.inf


def _quantile(values: np.ndarray, way: np.ndarray, end: float) -> float:
    """The value up to which this share of the way lies."""
    order = np.argsort(values)
    share = np.cumsum(way[order]) / max(np.sum(way), 1e-300)
    return float(values[order[min(np.searchsorted(share, end), len(values) - 1)]])


def along_path(values: np.ndarray, step: float) -> np.ndarray:
    """Samples of a movement a step of the way apart, and those at which it turns round."""
    path = np.floor(np.cumsum(np.abs(np.diff(values, prepend=values[0]))) / (step or 1.0))
    use = np.diff(path, prepend=-1) > 0
    way = np.sign(np.diff(values))
    use[1:-1] |= way[1:] != way[:-1]
    return np.flatnonzero(use)


def turning_points(command: np.ndarray) -> np.ndarray:
    """Samples at which a drive turns round, between them a stroke or more; first and last sample too."""
    from scipy.signal import find_peaks

    least = tuned.STROKE * float(np.ptp(command))
    peaks = [find_peaks(sign * command, prominence=least)[0] for sign in (1, -1)]
    return np.unique(np.r_[0, *peaks, len(command) - 1])
