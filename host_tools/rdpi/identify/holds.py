"""Holds: what moves on while the drive stands still is creep, or no effect that a fit looks for.

Over whole recordings creep also makes up for what the operator cannot show of slow movements. Holds are free of that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy

import numpy as np

from ..data import Recording
from ..model import Model
from ..simulate.effects import Effect
from . import thresholds as tuned

STILL = 1e-3  # [range of the command] within which the drive stands still
LEAST_S = 0.4  # that a hold lasts
SETTLED_S = 0.2  # after its start: what else comes late has come
PARTS = 8  # of each hold, one of which the jackknife leaves out


def limited(effect: Effect, runs: Sequence[Recording], model: Model) -> Effect | None:
    """The effect, if holds have a say in it no larger than they show; None: they do not show it."""
    if effect.in_holds is None:
        return effect
    most = most_shown(effect, effect.in_holds, runs, model)
    low, high = effect.on_rig[effect.in_holds]
    if most <= low:
        return None
    narrower = copy(effect)
    narrower.on_rig = {**effect.on_rig, effect.in_holds: (low, min(high, most))}
    return narrower


def is_limited(effect: Effect) -> bool:
    """Whether `limited` made it."""
    return effect.on_rig != type(effect).on_rig


def most_shown(effect: Effect, name: str, runs: Sequence[Recording], model: Model) -> float:
    """The most that a parameter, to which the movement is in proportion, may be by what these recordings' holds show;
    infinite without holds.

    Its error is that from part to part of the holds and, as drift looks alike, how far a straight line beside it moves
    the estimate.
    """
    sums, beside = [], []
    for run in runs:
        z_um = run.displacement_um
        moved_um = effect.displacement(z_um, run, {name: 1.0}, model) - z_um
        for hold in _holds(run):
            seen, shape = (part[hold] - np.mean(part[hold]) for part in (z_um, moved_um))
            sums += [(a @ b, a @ a) for a, b in zip(np.array_split(shape, PARTS), np.array_split(seen, PARTS))]
            line = np.linspace(-1, 1, len(seen))
            bent = shape - line * (line @ shape) / (line @ line)
            beside.append((bent @ seen, bent @ bent))
    across, energy = np.array(sums).reshape(-1, 2).T
    if not np.sum(energy) > 0:
        return np.inf
    value = np.sum(across) / np.sum(energy)
    without = (np.sum(across) - across) / np.maximum(np.sum(energy) - energy, np.finfo(float).tiny)
    scatter = (len(without) - 1) * np.var(without)
    with_line, left = np.sum(beside, axis=0)
    drift = with_line / left - value if left > 0 else np.inf
    return float((1 + tuned.HOLD_SLACK) * value + tuned.HOLD_ERRORS * np.sqrt(scatter + drift**2))


def _holds(run: Recording) -> Iterator[slice]:
    """Where the drive has stood still for a while."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    size, command = round(LEAST_S / run.sample_time_s), run.command_V
    if not 2 <= size <= len(run):
        return
    half = size // 2
    span = maximum_filter1d(command, size) - minimum_filter1d(command, size)
    centres = span[half:len(run) - (size - 1 - half)] < STILL * np.ptp(command)  # of stretches within the recording
    ends = np.flatnonzero(np.diff(np.r_[False, centres, False]))
    settled = round(SETTLED_S / run.sample_time_s)
    for first, beyond in zip(ends[::2], ends[1::2]):
        part = slice(first + settled, beyond - 1 + size)
        if part.stop - part.start >= 2 * PARTS:
            yield part
