"""The spectrum of what is left, octave by octave, against the passport's.

What is new may lie in one octave, or in all of them with little energy: neither shows in the rms of the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..data import Recording
from ..identify import localise
from ..model import Passport
from . import thresholds, unseen


class Spectrum(NamedTuple):
    """What is left against what the passport expects; without a passport, as it expects."""

    evidence: float = 0.0  # mean of ln(rms / expected), as the energy lies: the more concentrated, the larger
    everywhere: float = 1.0  # rms / expected of an octave, geometric mean of all octaves
    known: float = 1.0  # share of the energy at octaves in which commissioning moved as well

    @property
    def breadth(self) -> float:
        """How much more it counts for being everywhere, 1 to MOST_BREADTH; little energy alone is no gap."""
        return float(np.clip(self.everywhere, 1.0, thresholds.MOST_BREADTH))


def against(known: Passport | None, runs: Sequence[Recording], left_um: Sequence[np.ndarray],
            coords: Sequence[localise.Coordinates], excused_um: float = 0.0) -> Spectrum:
    """Of what is left of each recording, its mean removed; `excused_um` is the rms of white noise to be expected too.

    An octave counts less if it has few lines. One in which commissioning hardly moved does not count.
    """
    if known is None:
        return Spectrum()
    axis = localise.along_frequency(runs, left_um, coords, known, 0.0)
    widths_hz = np.diff(axis.edges)
    lines = widths_hz * sum(len(run) * run.sample_time_s for run in runs)
    unknown = unseen.hardly_moved(known, runs, coords, axis) | unseen.missed_as_much(known, runs, coords, axis)
    weight = np.where(unknown, 0.0, lines / (lines + thresholds.FEW_LINES))
    expected = axis.expected_um**2 + excused_um**2 * widths_hz / np.sum(widths_hz)
    counts = (weight > 0) & (axis.rms_um > 0) & (expected > 0)
    share = 1 - float(np.sum(axis.share[unknown]))
    if not np.any(counts):
        return Spectrum(known=share)
    power, weight = axis.rms_um[counts] ** 2, weight[counts]
    ratio = 0.5 * np.log(power / expected[counts])
    return Spectrum(float(power @ (weight * ratio) / np.sum(power)),
                    float(np.exp(weight @ ratio / np.sum(weight))), share)
