"""How well a reference was tracked: error, and the delay with which the actuator followed."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..data import Recording, check_sizes
from ..errors import BadInput

COLUMNS = "time_s", "reference_um", "displacement_um"
AROUND = 50  # samples by which a bad start may move the delay that fits best
LONGEST = 0.1  # of a recording, looked for as a delay
ALIKE, NOTHING = 1.02, 1e-6  # delays fit as well whose squares differ by less, relative or of the reference's square
WORST = 1e6  # rms error in stroke: a percentage beyond is a mistake


class Tracked(NamedTuple):
    """How one recording follows its reference. Percentages are of the reference's peak-to-peak."""

    rms_um: float
    max_um: float
    rms_percent: float
    max_percent: float
    max_at_s: float  # where in time_s
    offset_um: float  # mean of displacement - reference; in the figures above unless it was removed
    delay_s: float  # by which the displacement follows the reference; below 0: leads it
    rms_percent_without_delay: float  # of the reference delayed so; offset removed


def track(run: Recording, remove_offset: bool = False) -> Tracked:
    """Compare the columns displacement_um and reference_um of a recording.

    The delay minimises the rms error, mean removed, within LONGEST of the recording either way; between samples it is
    the vertex of a parabola. Raises BadInput if the reference does not move, and for absurd numbers.
    """
    check_sizes(run.columns, lambda row: f"{run.path}, sample {row}")
    reference_um, displacement_um = run.columns["reference_um"], run.displacement_um
    size_um, error = float(np.ptp(reference_um)), displacement_um - reference_um
    if not size_um > 0 or not np.sqrt(np.mean(error**2)) <= WORST * size_um:
        raise BadInput(f"{run.path}: reference_um spans {size_um:g} um: the error cannot be given in percent; "
                       "check the data")
    offset = float(np.mean(error))
    error = error - offset if remove_offset else error
    samples, square = _delay(reference_um, displacement_um)
    scale = 100 / size_um
    worst = int(np.argmax(np.abs(error)))
    rms, most = float(np.sqrt(np.mean(error**2))), float(abs(error[worst]))
    return Tracked(rms, most, rms * scale, most * scale, float(run.time_s[worst]), offset, samples * run.sample_time_s,
                   square**0.5 * scale)


def without_start(run: Recording, skip_s: float) -> Recording:
    """The recording without its first seconds; times stay. Raises BadInput if they are all of it, or none at all."""
    if not 0 <= skip_s < run.time_s[-1] - run.time_s[0]:
        raise BadInput(f"--skip {skip_s:g}: must be a time in s, from 0 to the {run.time_s[-1] - run.time_s[0]:g} s of {run.path}")
    first = int(np.ceil(skip_s / run.sample_time_s - 1e-6))
    return replace(run, columns={name: values[first:] for name, values in run.columns.items()})


def _delay(reference: np.ndarray, displacement: np.ndarray) -> tuple[float, float]:
    """The delay in samples, and the variance of what is left."""
    count = len(reference)
    most = max(1, int(LONGEST * count))
    shifts = np.arange(-most, most + 1)
    squares = _variances(reference - np.mean(reference), displacement - np.mean(displacement), shifts)
    slack = NOTHING * np.var(reference)
    near = np.flatnonzero(squares <= ALIKE * squares.min() + slack)  # a period later, say
    at = _lowest_from(int(near[np.argmin(np.abs(shifts[near]))]), squares)
    short = _lowest_from(most, squares)
    if abs(shifts[short]) < abs(shifts[at]):  # on the same samples: a start that is bad is left out
        first, last = max(shifts[at], shifts[short], 0), count + min(shifts[at], shifts[short], 0)
        around = np.arange(max(short - AROUND, 0), min(short + AROUND + 1, len(shifts)))
        around = around[(first >= shifts[around]) & (last - shifts[around] <= count)]
        same = [float(np.var(displacement[first:last] - reference[first - shift:last - shift]))
                for shift in (*shifts[around], shifts[at])]
        best = int(np.argmin(same[:-1]))  # a bad start moves the low, too
        at = int(around[best]) if same[best] <= ALIKE * same[-1] + slack else at
    if not 0 < at < len(shifts) - 1:
        return float(shifts[at]), float(squares[at])
    left, middle, right = squares[at - 1:at + 2]
    bend = left - 2 * middle + right
    step = float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend > 0 else 0.0
    return float(shifts[at] + step), max(float(middle - 0.25 * (left - right) * step), 0.0)


def _lowest_from(at: int, squares: np.ndarray) -> int:
    """Where a walk downhill ends."""
    while 0 < at < len(squares) - 1 and min(squares[at - 1], squares[at + 1]) < squares[at]:
        at += 1 if squares[at + 1] < squares[at - 1] else -1
    return at


def _variances(reference: np.ndarray, displacement: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Variance of displacement[k] - reference[k - shift] over the samples that both have, for each shift."""
    count = len(reference)
    size = 1 << (2 * count - 1).bit_length()
    products = np.fft.irfft(np.fft.rfft(displacement, size) * np.conj(np.fft.rfft(reference, size)), size)[shifts]
    first, last = np.maximum(shifts, 0), count + np.minimum(shifts, 0)  # of the displacement's samples

    def sums(values: np.ndarray, ends: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        whole = np.concatenate([[0.0], np.cumsum(values)])
        return whole[ends[1]] - whole[ends[0]]

    here, there = (first, last), (first - shifts, last - shifts)
    square = sums(displacement**2, here) + sums(reference**2, there) - 2 * products
    mean = (sums(displacement, here) - sums(reference, there)) / (last - first)
    return np.maximum(square / (last - first) - mean**2, 0.0)
