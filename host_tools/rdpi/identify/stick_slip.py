"""Readings that stand still while the actuator should move, and then catch up in a jump.

A stage or mount that sticks and slips does that, and a sensor whose samples are lost. No effect of the catalogue does:
what a delay, a dead zone or backlash holds back comes as slowly as it was driven, or not at all.
"""

from __future__ import annotations

import numpy as np

from ..simulate import signals
from . import thresholds as tuned

LONGEST = 8  # samples that a jump takes at most: 1, 2, 4, … are tried
FEWEST = 9  # readings that tell their own noise
FIRST_LOOK = 64  # samples before a jump, and twice as many as long as they stand still


def stuck(reading_um: np.ndarray, predicted_um: np.ndarray) -> np.ndarray:
    """Samples of a recording, up to the jump, in which its reading stood still; (samples,) of bool.

    `predicted_um` is where a model of the actuator moves meanwhile, (samples,). A sensor that is slower than the recording
    repeats each reading about as often: that is no standing still.
    """
    anew = _read_anew(reading_um)
    found = _stuck(reading_um[anew], predicted_um[anew])
    return np.repeat(found, np.diff(np.append(anew, len(reading_um))))


def _stuck(reading_um: np.ndarray, predicted_um: np.ndarray) -> np.ndarray:
    """The same of a sensor that reads every sample."""
    found = np.zeros(len(reading_um), bool)
    if len(reading_um) < FEWEST:
        return found
    still_um = tuned.STILL * max(signals.noise_um(reading_um), signals.grid_step(reading_um),
                                 tuned.LEAST_STILL * float(np.ptp(reading_um)))
    samples = 1
    while samples <= min(LONGEST, (len(reading_um) - 1) // 3):
        jumps_um, moves_um = (values[samples:] - values[:-samples] for values in (reading_um, predicted_um))
        jumps = np.abs(jumps_um) > np.maximum(tuned.JUMP * np.abs(moves_um), 2 * still_um)
        still = np.maximum(np.abs(jumps_um[samples:-samples]), np.abs(jumps_um[:-2 * samples])) <= still_um
        for at in np.flatnonzero(jumps[2 * samples:] & still) + 2 * samples:
            start = _still_since(reading_um, int(at), still_um)
            jump, missed_um = float(jumps_um[at]), float(predicted_um[at + samples] - predicted_um[start])
            if (at - start >= 2 * samples and missed_um * np.sign(jump) >= tuned.CAUGHT_UP * abs(jump)
                    and tuned.JUMP * np.max(np.abs(moves_um[start:at + 1])) < abs(jump)):
                found[start:at + 1] = True
        samples *= 2
    return found


def _read_anew(reading_um: np.ndarray) -> np.ndarray:
    """Samples at which the sensor reads anew: every one, or where readings change, and as often while they do not."""
    every = signals.repeats(reading_um)
    if every == 1:
        return np.arange(len(reading_um))
    starts = np.r_[0, np.flatnonzero(np.diff(reading_um)) + 1]
    ends = np.r_[starts[1:], len(reading_um)]
    return np.concatenate([np.arange(start, max(start + 1, end - every // 2), every) for start, end in zip(starts, ends)])


def share(residual_um: np.ndarray, where: np.ndarray) -> float:
    """Of the energy of a residual, its mean removed, that lies in these samples; (samples,) both."""
    square = (residual_um - np.mean(residual_um)) ** 2
    return float(np.sum(square[where]) / max(np.sum(square), np.finfo(float).tiny))


def remark(path: str, residual_um: np.ndarray, reading_um: np.ndarray, where: np.ndarray) -> str | None:
    """What to say of a recording whose reading stands still in these samples; None: too little to be told."""
    part = share(residual_um, where)
    if part < tuned.STUCK:
        return None
    times = int(np.count_nonzero(np.diff(where.astype(int), prepend=0) > 0))
    return (f"{path}: the reading stands still while the actuator should move, and then catches up in a jump, "
            f"{times} time{'s' * (times > 1)}; {100 * part:.0f} % of what is missed lies there; "
            f"{_why(reading_um, where)}")


def _why(reading_um: np.ndarray, where: np.ndarray) -> str:
    """A sensor that is lost repeats its last reading to the last digit; one that reads a stage at rest shows its noise."""
    same = np.diff(reading_um) == 0
    moving, resting = (float(np.mean(same[part[1:]])) if np.any(part[1:]) else 0.0 for part in (~where, where))
    if signals.repeats(reading_um) > 1 or moving > 0.5:
        return "the stage or its mount sticks and slips, or samples are lost"
    return "samples are lost: the last one is repeated to the last digit" if resting > 0.5 else \
        "the stage or its mount sticks and slips"


def _still_since(reading_um: np.ndarray, at: int, still_um: float) -> int:
    """The first sample from which on all readings up to this one lie close to it."""
    look = FIRST_LOOK
    while True:
        first = max(0, at - look)
        aside = np.flatnonzero(np.abs(reading_um[first:at] - reading_um[at]) > still_um)
        if len(aside):
            return first + int(aside[-1]) + 1
        if not first:
            return 0
        look *= 2
