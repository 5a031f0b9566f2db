"""Not known from commissioning: where recordings move as the passport's never did.

What the model misses there is not known, so it cannot be said to be new.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..data import Recording
from ..identify import localise, passport
from ..model import Passport
from . import thresholds
from .sections import NotKnown


def not_known(known: Passport | None, runs: Sequence[Recording], residuals_um: Sequence[np.ndarray],
              coords: Sequence[localise.Coordinates], spectrum: localise.Axis, noise_um: float) -> list[NotKnown]:
    """Frequencies and positions of a part of the gap that commissioning did not show; `spectrum` is the gap's."""
    squares = np.concatenate([(left - np.mean(left)) ** 2 for left in residuals_um])
    if known is None or np.mean(squares) < (thresholds.ABOVE_NOISE * noise_um) ** 2:
        return []
    found = [*_frequencies(known, runs, coords, spectrum), *_positions(known, squares, coords, noise_um),
             *_movements(known, residuals_um, coords, noise_um)]
    return [one for one in found if one.share > thresholds.BIN_SHARE]


def _frequencies(known: Passport, runs: Sequence[Recording], coords: Sequence[localise.Coordinates],
                 spectrum: localise.Axis) -> list[NotKnown]:
    """Octaves side by side are one band."""
    new = hardly_moved(known, runs, coords, spectrum)
    if not np.any(new):
        return []
    then, now = _moved(known, runs, coords, spectrum)
    ends = np.flatnonzero(np.diff(np.r_[False, new, False])).reshape(-1, 2)
    highest_hz = max(run.sample_rate_hz for run in runs) / 2
    return [NotKnown(axis="frequency_hz", low=float(spectrum.edges[low]),
                     high=min(float(spectrum.edges[high]), highest_hz), unit="Hz",
                     share=float(np.sum(spectrum.share[low:high])), moved_um=float(np.max(now[low:high])),
                     commissioned_um=float(np.max(then[low:high]))) for low, high in ends]


def hardly_moved(known: Passport, runs: Sequence[Recording], coords: Sequence[localise.Coordinates],
                 spectrum: localise.Axis) -> np.ndarray:
    """Octaves in which commissioning hardly moved beside these recordings; (octaves,) of bool."""
    moved = known.octaves.moved
    if moved is None:  # a model of before
        return np.zeros(len(spectrum.rms_um), bool)
    then, now = _moved(known, runs, coords, spectrum)
    # What is slower than any recording of commissioning is a rest to it.
    return (_octaves(spectrum) >= moved.first) & (now > thresholds.HARDLY_MOVED * then) & (now > spectrum.rms_um)


def missed_as_much(known: Passport, runs: Sequence[Recording], coords: Sequence[localise.Coordinates],
                   spectrum: localise.Axis) -> np.ndarray:
    """Octaves in which these recordings move further than commissioning, and the model missed as large a share of what
    moves there; (octaves,) of bool.

    The level knows how far recordings move in all. A drive with corners rings a stage far more than a smooth one does.
    """
    moved = known.octaves.moved
    if moved is None or moved.missed is None:
        return np.zeros(len(spectrum.rms_um), bool)
    octaves, power = _octaves(spectrum), np.zeros(len(spectrum.rms_um))
    for run, at in zip(runs, coords):
        found = passport.octaves(at["position_um"] - np.mean(at["position_um"]), run.sample_rate_hz)
        power += len(run) * _at(octaves, found.first, found.power)
    usual_um = _at(octaves, moved.first, moved.missed) * np.sqrt(power / sum(map(len, runs)))
    as_much = ((usual_um > thresholds.MISSED_MORE * spectrum.expected_um)
               & (spectrum.rms_um < thresholds.MISSED_AS_MUCH * usual_um))
    if np.any(as_much):  # how far they moved takes a transform for each octave
        then, now = _moved(known, runs, coords, spectrum)
        as_much &= now > then
    return as_much


def _octaves(spectrum: localise.Axis) -> np.ndarray:
    return np.round(np.log2(spectrum.edges[:-1])).astype(int)


def _moved(known: Passport, runs: Sequence[Recording], coords: Sequence[localise.Coordinates],
           spectrum: localise.Axis) -> tuple[np.ndarray, np.ndarray]:
    """How far commissioning and these recordings moved in each octave, um."""
    moved, octaves = known.octaves.moved, _octaves(spectrum)
    now = [_at(octaves, *passport.moved_um(at["position_um"], run.sample_rate_hz)) for run, at in zip(runs, coords)]
    return _at(octaves, moved.first, moved.peak_um), np.max(now, axis=0)


def _at(octaves: np.ndarray, first: int, values: Sequence[float]) -> np.ndarray:
    """Values of the octaves from `first` on, at these; 0 where there is none."""
    there = np.isin(octaves, first + np.arange(len(values)))
    found = np.zeros(len(octaves))
    found[there] = np.asarray(values)[octaves[there] - first]
    return found


def _positions(known: Passport, squares: np.ndarray, coords: Sequence[localise.Coordinates], noise_um: float
               ) -> list[NotKnown]:
    """Below and above all that commissioning reached."""
    low, *_, high = known.axes.position_um.edges
    beside = thresholds.BEYOND_ENDS * (high - low)
    position = np.concatenate([at["position_um"] for at in coords])
    whole = max(float(np.sum(squares)) - len(squares) * noise_um**2, 1e-300)
    found = []
    for ends, inside in (((float(np.min(position)), low), position < low - beside),
                         ((high, float(np.max(position))), position > high + beside)):
        if np.any(inside):
            share = (float(np.sum(squares[inside])) - np.count_nonzero(inside) * noise_um**2) / whole
            found.append(NotKnown(axis="position_um", low=ends[0], high=ends[1], unit="um",
                                  share=float(np.clip(share, 0, 1))))
    return found


def _movements(known: Passport, residuals_um: Sequence[np.ndarray], coords: Sequence[localise.Coordinates],
               noise_um: float) -> list[NotKnown]:
    """Smaller ones than in any recording of commissioning."""
    small = np.array([passport.too_small(known, at) > thresholds.TOO_SMALL for at in coords])
    if not np.any(small):
        return []
    squares = np.array([max(0.0, float(np.var(left)) - noise_um**2) * len(left) for left in residuals_um])
    moved = [float(np.std(at["position_um"])) for at, one in zip(coords, small) if one]
    return [NotKnown(axis="movement_um", low=min(moved), high=max(moved), unit="um", moved_um=max(moved),
                     share=float(np.sum(squares[small]) / max(float(np.sum(squares)), 1e-300)),
                     commissioned_um=known.level.least_std_um)]


def remark(one: NotKnown) -> str:
    """A part of the gap that is not known from commissioning, for people."""
    where = f"lies at {one.low:.4g} to {one.high:.4g} {one.unit}, where commissioning "
    if one.axis == "position_um":
        where += "did not go"
    elif one.axis == "frequency_hz":
        where += f"moved by {one.commissioned_um:.2g} um and these recordings by {one.moved_um:.2g} um"
    else:
        where = (f"lies in recordings that move by {one.moved_um:.2g} um rms or less by the model, and commissioning by "
                 f"{one.commissioned_um:.2g} um or more")
    return (f"{100 * one.share:.0f} % of the gap {where}; what the model misses there is not known from commissioning and "
            "need not be new")
