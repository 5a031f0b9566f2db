"""What a recorded signal says about itself: its noise, and its rate without that noise."""

from __future__ import annotations

import numpy as np

from . import firmware

RATE_NOISE = 0.01  # noise allowed in a smoothed rate, as a share of the peak rate
PROBE = 9  # samples of the cubic that separates noise from movement


def noise_um(z_um: np.ndarray) -> float:
    """White noise of a displacement record, um rms: what a sliding cubic leaves, by its median, so that kinks do not count."""
    from scipy.signal import savgol_coeffs, savgol_filter

    left = z_um - savgol_filter(z_um, PROBE, 3)
    share = 1 - savgol_coeffs(PROBE, 3)[PROBE // 2]  # variance of what is left, per variance of the noise
    return float(1.4826 * np.median(np.abs(left - np.median(left))) / np.sqrt(share))


def smoothing_time_s(z_um: np.ndarray, sample_time_s: float) -> float:
    """Shortest smoothing, in s, after which the noise in the rate is RATE_NOISE of the peak rate; 0 if none is needed.

    A quadratic over w samples has a slope of variance 12 sigma^2 / (w^3 T^2).
    """
    noise = noise_um(z_um)
    window = PROBE
    for _ in range(20):  # the peak rate depends on the smoothing, which depends on the peak rate
        peak = np.percentile(np.abs(np.gradient(smoothed(z_um, sample_time_s, window * sample_time_s))), 99)
        if peak == 0:
            break
        needed = (12 * (noise / (RATE_NOISE * peak)) ** 2) ** (1 / 3)
        if needed <= window:
            break
        window = min(1.2 * needed, len(z_um) / 4)
    return float(window * sample_time_s) if noise > RATE_NOISE * peak / 2 else 0.0


def smoothed(z_um: np.ndarray, sample_time_s: float, smoothing_s: float) -> np.ndarray:
    """Zero-phase smoothing by a sliding quadratic over `smoothing_s` (Savitzky-Golay); shape kept, 0 s changes nothing."""
    from scipy.signal import savgol_filter

    window = 2 * int(round(smoothing_s / sample_time_s / 2)) + 1
    window = min(window, len(z_um) - 1 + len(z_um) % 2)
    return savgol_filter(z_um, window, 2) if window > 3 else z_um


def rate(z_um: np.ndarray, sample_time_s: float, window_s: float, filter_s: float, smoothing_s: float) -> np.ndarray:
    """|dz/dt| in um/s as the firmware estimates it, after zero-phase smoothing; shape as z (samples,)."""
    return firmware.rate(smoothed(z_um, sample_time_s, smoothing_s), sample_time_s, window_s, filter_s)
