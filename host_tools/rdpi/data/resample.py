"""A recording on a uniform grid: for clocks that jitter, for rates higher than needed, for thinning out and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..errors import BadInput
from .recording import RATES_HZ, check_count, check_rising, check_sizes
from .rows import Place

GAP = 1.5  # steps of the usual size from which samples are missing
MOST = 10  # times the recorded rate: more says nothing new
NEAR = 0.98  # of the recorded rate: down to here the new rate holds what the old one held
PASS, STOP = 0.4, 0.5  # of the new rate: the filter keeps what is below the one, and takes what is above the other
ATTENUATION_DB = 80.0


class Resampled(NamedTuple):
    """Columns on a uniform grid, and what was found of the old one."""

    columns: dict[str, np.ndarray]
    recorded_hz: float  # mean rate
    jitter: float  # rms of the steps, of the sample time
    steps_s: tuple[float, float]  # shortest, longest
    filtered: bool

    def describe(self) -> str:
        shortest, longest = self.steps_s
        return (f"from {self.recorded_hz:.6g} samples per second with steps of {shortest:.4g} to {longest:.4g} s, "
                f"jitter {100 * self.jitter:.2g} % rms"
                + (", low-pass" if self.filtered else ""))


@np.errstate(over="ignore", invalid="ignore")  # absurd times are refused by their rate
def resample(path: str, columns: Mapping[str, np.ndarray], rate_hz: float, place: Place) -> Resampled:
    """All columns at rate_hz from the first time on, by monotone cubic interpolation, which adds no overshoot.

    Where the new rate is below NEAR of the recorded one, a linear-phase low-pass of ATTENUATION_DB comes first.
    Raises BadInput for times that do not rise, for gaps, and for rates far above the recorded one.
    """
    from scipy.interpolate import PchipInterpolator

    time_s = columns["time_s"]
    check_count(path, time_s)
    check_rising(time_s, place)
    check_sizes(columns, place)
    steps = np.diff(time_s)
    usual, recorded_hz = float(np.median(steps)), float((len(time_s) - 1) / (time_s[-1] - time_s[0]))
    if steps.max() > GAP * usual:
        row = int(np.argmax(steps > GAP * usual)) + 1
        raise BadInput(f"{place(row)}: time_s steps by {steps[row - 1]:.6g} s here and by {usual:.6g} elsewhere: "
                       "samples are missing there, and --resample does not fill gaps; cut the recording there with "
                       "--rows")
    if not RATES_HZ[0] <= rate_hz <= min(MOST * recorded_hz, RATES_HZ[1]):
        raise BadInput(f"{path}: --resample {rate_hz:g}: the recording has {recorded_hz:.6g} samples per second; "
                       f"choose a rate of at most {MOST} times that")
    times = 1 if rate_hz >= NEAR * recorded_hz else int(np.ceil(recorded_hz / rate_hz))  # of the grid to filter on
    count = int((time_s[-1] - time_s[0]) * rate_hz * (1 + 1e-9)) + 1
    check_count(f"{path}, at {rate_hz:g} per second", range(count))
    fine = np.minimum(time_s[0] + np.arange((count - 1) * times + 1) / (rate_hz * times), time_s[-1])
    taps = _low_pass(times) if times > 1 else None
    found = {"time_s": np.round(time_s[0] + np.arange(count) / rate_hz, 9)}
    for name, values in columns.items():
        if name != "time_s":
            size = float(np.abs(values).max()) or 1.0  # its quotients of steps neither overflow nor vanish
            even = PchipInterpolator(time_s, values / size)(fine)
            found[name] = size * (even if taps is None else _filtered(even, taps)[::times])
    return Resampled(found, recorded_hz, float(np.std(steps) / np.mean(steps)),
                     (float(steps.min()), float(steps.max())), taps is not None)


def at_times(time_s: np.ndarray, columns: Mapping[str, np.ndarray], wanted_s: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of uniform samples at other uniform times, as `resample` interpolates; beyond the ends the last value."""
    from scipy.interpolate import PchipInterpolator

    times = (len(time_s) - 1) / (time_s[-1] - time_s[0]) * (wanted_s[-1] - wanted_s[0]) / (len(wanted_s) - 1)
    taps = _low_pass(times) if times > 1 / NEAR else None
    return {name: PchipInterpolator(time_s, values if taps is None else _filtered(values, taps))(
        np.clip(wanted_s, time_s[0], time_s[-1])) for name, values in columns.items()}


def _low_pass(times: float) -> np.ndarray:
    """An odd number of taps, for the grid that is `times` as fine as the new one."""
    from scipy.signal import firwin, kaiserord

    taps, beta = kaiserord(ATTENUATION_DB, 2 * (STOP - PASS) / times)
    return firwin(taps | 1, (PASS + STOP) / times, window=("kaiser", beta))


def _filtered(values: np.ndarray, taps: np.ndarray) -> np.ndarray:
    """Without delay; beyond the ends the signal goes on as its mirror image turned about the end."""
    from scipy.signal import fftconvolve

    half = len(taps) // 2
    return fftconvolve(np.pad(values, half, mode="reflect", reflect_type="odd"), taps, mode="valid")


def thinned(values: np.ndarray, every: int) -> np.ndarray:
    """Every n-th sample from the first on, behind the low-pass of `resample`; as many as reach the last sample."""
    padded = np.pad(values, (0, -(len(values) - 1) % every), mode="reflect", reflect_type="odd")
    return _filtered(padded, _low_pass(every))[::every]


def filled(values: np.ndarray, every: int, count: int) -> np.ndarray:
    """`count` samples of which `thinned` kept every n-th: the smooth signal through them."""
    taps = _low_pass(every)
    beyond = len(taps) // 2 // every + 1  # what the filter sees of them beyond the ends
    fine = np.zeros((len(values) + 2 * beyond) * every)
    fine[::every] = every * np.pad(values, beyond, mode="reflect", reflect_type="odd")
    return _filtered(fine, taps)[beyond * every:][:count]
