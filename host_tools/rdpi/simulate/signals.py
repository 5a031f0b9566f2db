"""What a recorded signal says about itself: its noise, and its rate without that noise."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .. import firmware
from ..data import Recording

RATE_NOISE = 0.02  # noise allowed in a smoothed rate, as a share of the peak rate
PROBE = 9  # samples of the cubic that separates noise from movement
SLOW_SENSOR = 0.8  # of all readings, repeated equally often; judged
GRID_TOLERANCE = 0.05  # of a grid's step: values written with few digits
GOLDEN = (5**0.5 - 1) / 2
PAST_DECAY = 0.3  # [recording] time constant of what goes on creeping in it from before; judged


def noise_um(z_um: np.ndarray) -> float:
    """White noise of a displacement record, um rms: the median of what a sliding cubic leaves: kinks do not count."""
    from scipy.signal import savgol_coeffs, savgol_filter

    left = z_um - savgol_filter(z_um, PROBE, 3)
    share = 1 - savgol_coeffs(PROBE, 3)[PROBE // 2]  # variance of what is left, per variance of the noise
    return float(1.4826 * np.median(np.abs(left - np.median(left))) / np.sqrt(share))


def fastest_V_per_s(runs: Iterable[Recording]) -> float:
    """Of the commands of all recordings, from sample to sample."""
    return max(float(np.max(np.abs(np.diff(run.command_V)))) / run.sample_time_s for run in runs)


def smoothing_time_s(z_um: np.ndarray, sample_time_s: float) -> float:
    """Shortest smoothing, in s, after which the noise in the rate is RATE_NOISE of the peak rate; 0 if none is needed.

    At most a quarter of the record.
    """
    z = z_um / (np.max(np.abs(z_um)) or 1.0)  # only ratios matter, and no size of z overflows
    # A quadratic c_k over 2 m + 1 samples leaves sum (c_k - c_(k-1))^2 of the variance in the difference of two
    # outputs: the first term is the two ends of the window, the second its inside; m = 1 changes nothing and gives 2.
    m = np.arange(1.0, max(2, (len(z) // 4 + 1) // 2))
    variance = (18 * (m - 1) ** 2 / (2 * m + 1) + 150 * m / (2 * m - 1)) / (2 * m + 1) / (2 * m + 3) ** 2
    noise = noise_um(z) * np.sqrt(variance)
    chosen, needed = -1, 0
    while needed > 1.02 * chosen:  # smoothing lowers the peak rate, which asks for more smoothing; 2 % is near enough
        chosen = needed
        cut = int(m[chosen])  # the window is cut at both ends of the record, where its slope is of no use
        peak = np.percentile(np.abs(np.diff(smoothed(z, 1.0, 2 * cut + 1)))[cut:-cut], 99)
        needed = min(int(np.searchsorted(-noise, -RATE_NOISE * peak)), len(m) - 1)
    return float((2 * m[chosen] + 1) * sample_time_s) if chosen else 0.0


def smoothed(z_um: np.ndarray, sample_time_s: float, smoothing_s: float) -> np.ndarray:
    """Zero-phase smoothing by a sliding quadratic over `smoothing_s` (Savitzky-Golay); shape kept, 0 s: as is."""
    from scipy.signal import savgol_filter

    window = min(2 * int(smoothing_s / sample_time_s / 2) + 1, len(z_um) - 1 + len(z_um) % 2)  # the nearest odd number
    return savgol_filter(z_um, window, 2) if window > 3 else z_um


def rate(z_um: np.ndarray, sample_time_s: float, window_s: float, filter_s: float, smoothing_s: float) -> np.ndarray:
    """|dz/dt| in um/s as the firmware estimates it, after zero-phase smoothing; shape as z (samples,)."""
    return firmware.rate(smoothed(z_um, sample_time_s, smoothing_s), sample_time_s, window_s, filter_s)


def grid_step(z_um: np.ndarray) -> float:
    """Step in um of the grid that all values stand on, 0 if there is none: most values occur but once, or no step fits.

    Unequal neighbours of a grid lie whole steps apart.
    """
    values = np.unique(z_um)
    if len(values) < 3 or len(values) > 0.5 * len(z_um):
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > GRID_TOLERANCE * 1e-3 * gaps.max()]
    step = float(np.percentile(gaps, 1))
    step = float(np.median(gaps[gaps < 1.5 * step]))
    whole = np.round(gaps / step)
    return step if np.mean(np.abs(gaps - whole * step) < GRID_TOLERANCE * step) > 0.95 else 0.0


def repeats(z_um: np.ndarray) -> int:
    """How many samples each reading stands for: 1, or more where nearly all are repeated equally often, as those of a
    sensor that is slower than the recording; where it is by no whole number, once more or less.
    """
    times = np.diff(np.flatnonzero(np.diff(z_um)))
    if not len(times):
        return 1
    usual = int(np.median(times))
    pairs = [(usual,), *([(usual, usual + 1), (usual - 1, usual)] if usual > 2 else [])]
    return usual if max(np.mean(np.isin(times, pair)) for pair in pairs) > SLOW_SENSOR else 1


def limited(signal: np.ndarray, limit: float) -> np.ndarray:
    """The signal following with at most `limit` per sample, (samples,)."""
    bank = firmware.Bank([firmware.Block(firmware.SLEW, (limit,))])
    bank.start(float(signal[0]))
    return bank.run(signal)[0]


def goes_on(samples: int) -> np.ndarray:
    """What goes on creeping in a recording from before it, where no sweep was before it; 1 at first, (samples,)."""
    return np.exp(-np.arange(samples) / (PAST_DECAY * samples))


def asides(run: Recording) -> np.ndarray:
    """What a recording shows that is no matter of the model, (samples, columns): its offset and, where nothing is known
    of what was before it, what goes on creeping in it from there.
    """
    columns = [np.ones(len(run))]
    if run.memory == "unknown":
        columns.append(goes_on(len(run)))
    return np.column_stack(columns)


def uneven(first: int, end: int, stride: int) -> np.ndarray:
    """One sample of every `stride`, not at even steps, which would always meet a periodic drive at the same places."""
    steps = np.arange(first, end, stride)
    return np.minimum(steps + (stride * (np.arange(len(steps)) * GOLDEN % 1)).astype(int), end - 1)
