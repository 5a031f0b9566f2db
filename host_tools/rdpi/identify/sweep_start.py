"""Where a decaying sweep leaves this actuator: the share of the model's memory, from the recordings of a fit.

Two things show it. The beginning of a recording that is marked reset and starts aside of the middle of the range: there
the share moves the plays (model/sweep.py). Where there is none, inner loops: plays keep what they remember until it is
wiped out, and so follow a sweep all the way, share 1. Actuators whose inner loops drift forget it as the input moves
on, and rest at the input after the many swings of a sweep, share 0. Plays that forget describe these much better:

    dy_i = forgetting (x - y_i) |dx|, beside eq. 1.

Both kinds of plays, weighted as the recordings ask for, are compared. What amplifier and mechanics do beside them is
left to delayed and low-passed copies of the displacement that the plays explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .. import firmware
from ..data import Recording
from ..model import swept_states
from ..simulate import memory
from . import thresholds as tuned
from .document import ShownBy, Sweep
from .strokes import along_path

SHARES = np.linspace(0, 1, 5)
FORGETTINGS = 0.5, 1.0, 2.0  # per half range
PATH = 0.03  # half ranges between samples that are used; turning points are used all
MAX_SAMPLES = 16_000  # so many are used at most
TAPS_S = *np.arange(1, 21) * 2e-4, *np.arange(5, 13) * 1e-3
LAGS_S = 0.01, 0.02, 0.04, 0.1, 0.3, 1.0, 3.0
LEAST_LOOP = 1e-6  # strokes: narrower ones are the rounding of recorded numbers
ASIDE = 0.1  # half ranges from the middle: nearer beginnings show nothing


class SweepStart(NamedTuple):
    """What was found."""

    share: float
    shown_by: ShownBy
    remembers: float | None  # rms that plays which remember leave, over that of the loops; None: no loops are seen
    forgets: float | None  # the same of plays which forget
    drifts: bool  # plays which forget describe the inner loops, or the beginnings, much better
    thresholds_um: np.ndarray
    range_um: tuple[float, float]  # control inputs at the ends of the drive

    def states_um(self, x_um: float) -> np.ndarray:
        """The plays after a sweep that ended at this control input."""
        return swept_states(x_um, self.thresholds_um, self.range_um, self.share)

    def record(self) -> Sweep:
        """The key `sweep` of the document."""
        return Sweep(share=self.share, shown_by=self.shown_by, remembers_rms=self.remembers, forgets_rms=self.forgets)

    def line(self) -> str:
        """For people."""
        text = ("after a decaying sweep that ends aside of the middle of the range, plays stay behind by "
                f"{100 * self.share:.3g} % of what ideal plays would")
        if self.remembers is None:
            return f"{text}: assumed, for these recordings show no loops to tell"
        compared = f"of the loops' rms, plays that remember miss {100 * self.remembers:.3g} %, plays that forget " \
                   f"{100 * self.forgets:.3g} %"
        return text + {
            "beginnings": f", as the beginnings of these recordings show: {compared}",
            "inner loops": f", as inner loops show: {compared}",
            "nothing": f": assumed, for the loops do not look forgotten ({compared}), and no recording begins after a sweep that "
                       "ended aside of the middle"}[self.shown_by]


class _Part(NamedTuple):
    """One recording; x in half ranges from the middle, the displacement in strokes."""

    x: np.ndarray
    z: np.ndarray
    start: float  # x where a sweep ended; 0 where none did
    rate: np.ndarray  # of x, half ranges per s
    used: np.ndarray  # indices of samples
    first: int  # how many of these depend on an unknown memory
    begin: int  # how many depend on where a sweep aside of the middle left the plays
    sample_time_s: float


def sweep_start(runs: Sequence[Recording], gain_um_per_V: float, offset_V: float, thresholds_um: np.ndarray,
                ends_V: tuple[float, float]) -> SweepStart:
    """What these runs show; `ends_V` are those of the drive's range."""
    range_um = tuple(gain_um_per_V * (end_V - offset_V) for end_V in ends_V)
    middle, half = sum(range_um) / 2, abs(range_um[1] - range_um[0]) / 2 or 1.0
    r = np.minimum(thresholds_um / half, 1.0)
    stroke = max(float(np.ptp(run.displacement_um)) for run in runs)
    parts = [_part(run, (gain_um_per_V * (run.command_V - offset_V) - middle) / half, run.displacement_um / stroke,
                   r[-1], MAX_SAMPLES // len(runs)) for run in runs]
    unseen = SweepStart(1.0, "nothing", None, None, False, thresholds_um, range_um)
    if all(part.first == len(part.used) for part in parts):
        return unseen
    begins = any(part.begin for part in parts)
    shares = SHARES if begins else SHARES[-1:]
    kinds = [(0.0, share) for share in shares] + [(forgetting, 0.0) for forgetting in FORGETTINGS]
    left, beginning = _rms_left(parts, r, np.array(kinds)).T
    if not np.min(left) < 1:  # what is taken for loops is smaller than what no plays explain
        return unseen
    remember, kept, forget = left[:len(shares)], *(float(np.min(part)) for part in np.split(beginning, [len(shares)]))
    best = float(np.min(remember))
    share, shown_by = 1.0, "nothing"
    drifts = forget < tuned.FORGETS * kept and kept**2 - forget**2 > tuned.FORGETS_LOOP
    if drifts:
        share, shown_by = 0.0, "beginnings" if begins else "inner loops"
    elif best < tuned.SWEEP_SHOWN * remember[-1]:
        share, shown_by = _lowest(shares, remember**2), "beginnings"
    elif best < tuned.SWEEP_SHOWN * remember[0]:
        shown_by = "beginnings"
    return SweepStart(share, shown_by, kept, forget, drifts, thresholds_um, range_um)


def _part(run: Recording, x: np.ndarray, z: np.ndarray, reach: float, most: int) -> _Part:
    used = along_path(x, PATH)[:most]
    swept = run.memory == "reset"
    start = float(x[0]) if swept else 0.0
    depend = int(np.searchsorted(used, memory.warm_up(x, reach)))
    rate = np.abs(np.gradient(x)) / run.sample_time_s
    return _Part(x, z, start, rate, used, 0 if swept else depend, depend if abs(start) > ASIDE else 0,
                 run.sample_time_s)


def _rms_left(parts: Sequence[_Part], r: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """What plays of each kind, (forgetting, share), leave of the displacement: rms over that of the loops; (kinds, 2).

    First of all samples, then of beginnings aside of the middle, where plays that forget differ most from those that
    remember; without such beginnings, of all.
    """
    plays = [_walk(part, r, kinds) for part in parts]
    top = max(float(np.max(part.rate)) for part in parts) or 1.0
    rates = [part.rate[part.used, None] / top for part in parts]
    usual = [_columns(one[:, -1 - len(FORGETTINGS)], rate) for one, rate in zip(plays, rates)]  # remember, share 1
    z = _stacked([part.z[part.used, None] for part in parts], parts)
    weights = np.linalg.lstsq(_stacked(usual, parts), z, rcond=1e-9)[0]
    for _ in range(2):  # what is delayed is then no longer in the weights
        beside = [_delayed(part, r, weights[:, 0], top) for part in parts]
        both = _stacked([np.hstack(pair) for pair in zip(usual, beside)], parts)
        weights = np.linalg.lstsq(both, z, rcond=1e-9)[0][:usual[0].shape[1]]
    basis, strengths, _ = np.linalg.svd(_stacked(beside, parts), full_matrices=False)
    basis = basis[:, strengths > 1e-9 * strengths[0]]

    begun = np.concatenate([np.arange(part.first, len(part.used)) < part.begin for part in parts])
    begun |= not np.any(begun)

    def left(columns: list[np.ndarray]) -> list[float]:
        sums = _stacked(columns, parts)
        for _ in range(2):  # the second time with a curve of what the plays sum up to
            both = np.hstack([sums, z])
            both -= basis @ (basis.T @ both)
            found = np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=1e-9)[0]
            sum_of = (sums @ found)[:, None]
            sums = np.hstack([sums, sum_of**2, sum_of**3])
        squares = (both[:, -1] - both[:, :-1] @ found) ** 2
        return [float(np.sqrt(np.mean(some))) for some in (squares, squares[begun])]

    explained = _stacked(usual, parts)
    curve = explained[:, [0, -2, -1]]
    loop = explained @ weights
    loop -= curve @ np.linalg.lstsq(curve, loop, rcond=1e-9)[0]
    width = float(np.sqrt(np.mean(loop**2)))
    if width < LEAST_LOOP:
        return np.full((len(kinds), 2), np.inf)
    return np.array([left([_columns(one[:, k], rate) for one, rate in zip(plays, rates)])
                     for k in range(len(kinds))]) / width


def _walk(part: _Part, r: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """Plays of each kind along the samples used; (samples, kinds, n + 1)."""
    x = part.x[part.used]
    keep = np.exp(-np.abs(np.diff(x, prepend=x[0]))[:, None] * kinds[:, 0])[:, :, None]
    states = x[0] - np.outer(kinds[:, 1] * part.start, r)
    found = np.empty((len(x), *states.shape))
    for k, x_k in enumerate(x.tolist()):  # np.clip takes ten times as long
        states = found[k] = x_k + np.minimum(np.maximum((states - x_k) * keep[k], -r), r)
    return found


def _columns(plays: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """x and how far plays are behind it, at rest and growing with the rate; curves of their sum and of x."""
    x = plays[:, :1]
    behind = plays[:, 1:] - x
    return np.hstack([x, behind, behind * rate, plays.sum(axis=1, keepdims=True) ** 2, x**2, x**3])


def _superposed(plays: np.ndarray, rate: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """_columns @ weights, for which the columns need not be there."""
    x, n = plays[:, 0], plays.shape[1] - 1
    rest, growing = weights[1:n + 1], weights[n + 1:2 * n + 1]
    square, x2, x3 = weights[2 * n + 1:]
    behind, grown, together = (plays[:, 1:] @ np.stack([rest, growing, np.ones(n)], axis=1)).T
    return (x * (weights[0] - np.sum(rest)) + behind + rate * (grown - x * np.sum(growing))
            + square * (x + together) ** 2 + x2 * x**2 + x3 * x**3)


def _delayed(part: _Part, r: np.ndarray, weights: np.ndarray, top: float) -> np.ndarray:
    """How much later copies of the displacement that the usual plays explain differ from it; at the samples used."""
    from scipy.signal import lfilter

    z = _superposed(firmware.plays(part.x, r, part.x[0] - part.start * r)[0], part.rate / top, weights)
    z -= z[0]
    columns = [z[np.maximum(part.used - max(1, round(tap_s / part.sample_time_s)), 0)] for tap_s in TAPS_S]
    for lag_s in LAGS_S:
        keep = np.exp(-part.sample_time_s / lag_s)
        columns.append(lfilter([1 - keep], [1, -keep], z)[part.used])
    return np.stack(columns, axis=1) - z[part.used, None]


def _stacked(blocks: Sequence[np.ndarray], parts: Sequence[_Part]) -> np.ndarray:
    """Blocks of all recordings, each without its mean, because each has an offset of its own."""
    rows = [block[part.first:] for block, part in zip(blocks, parts) if part.first < len(part.used)]
    return np.vstack([block - block.mean(axis=0) for block in rows])


def _lowest(shares: np.ndarray, cost: np.ndarray) -> float:
    """Where the cost is lowest: at an end, or where a parabola through the lowest inner point and its neighbours is."""
    k = int(np.argmin(cost))
    if k in (0, len(shares) - 1):
        return float(shares[k])
    bend, slope, _ = np.polyfit(shares[k - 1:k + 2] - shares[k], cost[k - 1:k + 2], 2)
    return round(float(shares[k] - slope / (2 * bend)), 3)
