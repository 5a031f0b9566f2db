"""The amplifier by itself: how late monitor_V comes after command_V.

    monitor_V = gain * (command_V behind a delay and a lag) + offset of the recording

A least-squares problem in two times, gain and offsets left out of it (variable projection, Golub and Pereyra, SIAM J.
Numer. Anal. 10, 1973). What comes late behind the monitor is not the amplifier's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ..data import Recording
from ..model import Model
from ..simulate import effects, signals
from ..simulate.effects import CATALOGUE, SENSOR, Acting, Effect
from . import thresholds as tuned

BLOCKS = 8  # of all recordings, at least: left out in turn
STARTS = 1.3 * 2.0 ** np.arange(-2, 12)  # [samples] times from which the search starts: a delay is no whole number of them
STEP = 0.05  # [samples] by which derivatives are taken; a shorter time is none
BETWEEN = 0.25  # [samples] by which a time is unsure because nobody knows how the drive goes from sample to sample
LONGEST = 4  # that a time goes into a recording

# What may stand before the monitor, or as well be the sensor's.
OF_AMPLIFIER = {name: kind for name, kind in CATALOGUE.items()
                if kind.late_by and kind.stages[0] in effects.BEFORE_MONITOR and SENSOR in kind.stages}


@dataclass(frozen=True)
class Amplifier:
    """What monitor_V shows."""

    acting: Sequence[Acting] = ()  # in the order of the chain
    ci95: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # of each parameter
    unsure_s: float = 0.0  # what comes late by less may be the amplifier's, too
    left: float = 0.0  # rms of the monitor that they do not explain, nor noise does, as a share of its range

    def drives(self, runs: Sequence[Recording], model: Model, without: Acting | None = None) -> list[Recording]:
        """The recordings with what drives the actuator as their command, but for one effect."""
        acting = [one for one in self.acting if one is not without]
        return [effects.driven_run(acting, run, model) for run in runs]

    def shows(self, one: Acting) -> bool:
        """Whether an effect that was found behind the monitor comes late by more than the monitor leaves unsure."""
        return one.effect.name in OF_AMPLIFIER and one.values[one.effect.late_by] > self.unsure_s

    def unplaced(self, one: Acting) -> Acting:
        """The same where it stands if nothing is known of its stage, unless the amplifier holds one of its kind."""
        usual = type(one.effect)() if one.effect.name in OF_AMPLIFIER else one.effect
        return Acting(usual, one.values) if effects.replaced(self.acting, usual) is None else one


class _Fitted(NamedTuple):
    """Times of some kinds of effects, fitted."""

    kinds: tuple[type[Effect], ...]
    times_s: np.ndarray
    reach_s: np.ndarray  # half of their 95 % intervals, from blocks left out in turn
    whole_reach_s: float  # the same of their sum
    held_out: np.ndarray  # squares of each block, by what was fitted without it

    @property
    def squares(self) -> float:
        return float(np.sum(self.held_out))

    def beats(self, other: _Fitted) -> bool:
        """Whether it leaves less of what was not fitted, by more than the standard error. A slow block shows a time a
        thousand times less than a fast one: each counts by the share of its own squares.
        """
        both = self.held_out + other.held_out
        gain = (other.held_out - self.held_out) / np.maximum(both, np.finfo(float).tiny)
        return bool(np.mean(gain) > tuned.MONITOR_ERRORS * np.std(gain, ddof=1) / np.sqrt(len(gain)))


def seen_by_monitor(runs: Sequence[Recording], model: Model, names: Sequence[str] | None) -> Amplifier:
    """What comes late before the monitor, of these names or of all. Every run has a column monitor_V."""
    kinds = [kind for name, kind in OF_AMPLIFIER.items() if names is None or name in names]
    tried = [_fitted(runs, model, some) for count in range(len(kinds) + 1) for some in combinations(kinds, count)]
    least_s = STEP * min(run.sample_time_s for run in runs)
    monitors = [run.columns["monitor_V"] for run in runs]
    ranked = sorted((one for one in tried if np.all(one.times_s >= least_s)), key=lambda one: one.squares)
    found = min((one for one in ranked if one is ranked[0] or not ranked[0].beats(one)), key=lambda one: len(one.kinds))
    ci95 = {kind.late_by: (max(0.0, float(time_s - reach_s)), float(time_s + reach_s))
            for kind, time_s, reach_s in zip(found.kinds, found.times_s, found.reach_s)}
    hidden_s = [found.whole_reach_s] if found.kinds else [
        one.times_s[0] + one.whole_reach_s for one in tried if len(one.kinds) == 1]
    squares = found.squares - sum(len(one) * signals.noise_um(one)**2 for one in monitors)
    left = float(np.sqrt(max(squares, 0.0) / sum(map(len, monitors)))) / max(map(np.ptp, monitors))
    return Amplifier(_acting(found.kinds, found.times_s), ci95, float(max(hidden_s, default=0.0)), left)


def _acting(kinds: Sequence[type[Effect]], times_s: Sequence[float]) -> list[Acting]:
    return effects.in_order(Acting(kind(), {kind.late_by: float(time_s)}) for kind, time_s in zip(kinds, times_s))


def _fitted(runs: Sequence[Recording], model: Model, kinds: tuple[type[Effect], ...]) -> _Fitted:
    from scipy.optimize import least_squares

    sample_s = min(run.sample_time_s for run in runs)
    most = max(len(run) * run.sample_time_s for run in runs) / LONGEST / sample_s  # all times in samples from here on
    measured = np.concatenate([_centred(run.columns["monitor_V"]) for run in runs])

    def driven(times: np.ndarray) -> np.ndarray:
        acting = _acting(kinds, np.maximum(times, 0) * sample_s)
        return np.concatenate([_centred(effects.driven(acting, run.command_V, run, model)) for run in runs])

    def gain_of(passed: np.ndarray) -> float:
        return float(passed @ measured) / max(float(passed @ passed), np.finfo(float).tiny)

    def missed(times: np.ndarray) -> np.ndarray:
        passed = driven(times)
        return measured - gain_of(passed) * passed

    times = np.zeros(len(kinds))
    if kinds:
        starts = STARTS[STARTS < most]
        start = min(([start / len(kinds)] * len(kinds) for start in starts), key=lambda one: np.sum(missed(one) ** 2))
        times = least_squares(missed, start, bounds=(0, most), x_scale=1.0, diff_step=1e-3).x
    passed = driven(times)
    gain = gain_of(passed)
    left, columns = measured - gain * passed, [passed]
    for k in range(len(kinds)):
        step = np.zeros(len(kinds))
        step[k] = STEP
        columns.append(gain * (driven(times + step) - passed) / STEP)
    changes, held_out = _left_out(np.column_stack(columns), left, _blocks(runs))
    times_then = np.column_stack([changes[:, 1:], np.sum(changes[:, 1:], axis=1)])
    errors = np.sqrt(len(times_then) - 1) * np.std(times_then, axis=0)
    reach_s = np.hypot(tuned.CHAIN_WIDEN * 1.96 * errors, BETWEEN) * sample_s
    return _Fitted(kinds, times * sample_s, reach_s[:-1], float(reach_s[-1]), held_out)


def _centred(values: np.ndarray) -> np.ndarray:
    return values - np.mean(values)


def _blocks(runs: Sequence[Recording]) -> list[slice]:
    """Parts of the recordings, one after the other, of all their samples."""
    parts, ends = -(-BLOCKS // len(runs)), np.cumsum([0, *map(len, runs)])
    return [slice(*map(int, pair)) for start, end in zip(ends, ends[1:])
            for cuts in [np.linspace(start, end, parts + 1).astype(int)] for pair in zip(cuts, cuts[1:])]


def _left_out(columns: np.ndarray, left: np.ndarray, blocks: Sequence[slice]) -> tuple[np.ndarray, np.ndarray]:
    """To first order: by how much the unknowns change without each block, (blocks, unknowns), and the squares that each
    leaves then.
    """
    grams = np.array([columns[block].T @ columns[block] for block in blocks])
    across = np.array([columns[block].T @ left[block] for block in blocks])
    whole, gradient = np.sum(grams, axis=0), np.sum(across, axis=0)
    changes = np.array([np.linalg.lstsq(whole - gram, gradient - part, rcond=None)[0]
                        for gram, part in zip(grams, across)])
    squares = np.array([left[block] @ left[block] for block in blocks])
    return changes, np.array([square - 2 * part @ change + change @ gram @ change
                              for square, part, change, gram in zip(squares, across, changes, grams)])
