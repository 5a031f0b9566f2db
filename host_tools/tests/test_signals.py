"""Noise and rate of recorded signals."""

from __future__ import annotations

import numpy as np
import pytest

from rdpi.model import operators
from rdpi.simulate import signals

RANDOM_SEED = 3


def triangle(samples: int, periods: float, height: float = 12.0) -> np.ndarray:
    phase = periods * np.arange(samples) / samples
    return height * (1 - np.abs(2 * (phase % 1) - 1))


def noise(samples: int, seed: int = RANDOM_SEED) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(samples)


SHAPES = {
    "still": lambda n: np.full(n, 3.0),
    "sine": lambda n: 6 * np.sin(2 * np.pi * 5 * np.arange(n) / n),
    "triangle": lambda n: triangle(n, 5),
    "steps": lambda n: np.round(triangle(n, 3, 8.0)),  # 48 jumps of 1 um
    "drift and offset": lambda n: 1e3 + np.linspace(0, 50, n),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("level", [1e-4, 1e-2])
def test_noise_beside_movement(shape: str, level: float) -> None:
    """Movement, kinks and jumps do not count as noise."""
    z = SHAPES[shape](4000) + level * noise(4000)
    assert signals.noise_um(z) == pytest.approx(level, rel=0.15)


def test_noise_of_a_quantised_record() -> None:
    """The step of an ADC is as good as noise of step / sqrt(12) when the signal moves through many codes."""
    step = 0.01
    z = step * np.round(6 * np.sin(2 * np.pi * 5 * np.arange(4000) / 4000) / step)
    assert signals.noise_um(z) == pytest.approx(step / np.sqrt(12), rel=0.3)


def test_no_noise() -> None:
    assert signals.noise_um(np.zeros(100)) == 0
    assert signals.noise_um(triangle(400, 5)) < 1e-12
    assert signals.noise_um(triangle(16, 1)) < 5  # the shortest recording; a number at least


@pytest.mark.parametrize("sample_time_s", [1e-4, 1e-3])
@pytest.mark.parametrize("level", [0.002, 0.02, 0.1])
def test_smoothing_leaves_the_noise_in_the_rate_that_it_says(sample_time_s: float, level: float) -> None:
    """The shortest that does: neither more nor much less is left, and the peak rate survives."""
    samples = 8000
    clean = 6 * np.sin(2 * np.pi * 4 * np.arange(samples) / samples)
    z = clean + level * noise(samples)
    window_s = signals.smoothing_time_s(z, sample_time_s)
    assert window_s > 9 * sample_time_s
    edge = int(window_s / sample_time_s)  # nearer to the ends the window is cut
    truly, left, found = (np.diff(signal)[edge:-edge] / sample_time_s for signal in (
        clean, signals.smoothed(level * noise(samples), sample_time_s, window_s),
        signals.smoothed(z, sample_time_s, window_s)))
    peak = np.abs(truly).max()
    assert np.std(left) == pytest.approx(signals.RATE_NOISE * peak, rel=0.15)
    assert np.percentile(np.abs(found), 99) == pytest.approx(peak, rel=0.06)


def test_smoothing_grows_with_noise_not_with_the_sample_rate() -> None:
    def needed(samples: int, level: float) -> float:
        z = 6 * np.sin(2 * np.pi * 4 * np.arange(samples) / samples)  # one second
        return signals.smoothing_time_s(z + level * noise(samples), 1 / samples)

    times = [needed(4000, level) for level in (0.01, 0.03, 0.1)]
    assert times == sorted(times) and times[2] > 2 * times[0]
    assert needed(16_000, 0.03) == pytest.approx(needed(4000, 0.03), rel=0.05)


@pytest.mark.parametrize("size", [1e-300, 1e-6, 1e308])
def test_smoothing_depends_on_ratios_only(size: float) -> None:
    """Also of values whose squares and differences overflow."""
    z = triangle(1000, 5, 0.9) + 0.01 * noise(1000)
    assert signals.smoothing_time_s(size * z, 1e-3) == pytest.approx(signals.smoothing_time_s(z, 1e-3))
    assert signals.smoothing_time_s(size * np.resize([1.0, -1.0], 100), 1e-3) >= 0


@pytest.mark.parametrize("window", [5, 9, 21, 401])
def test_smoothing_takes_the_nearest_odd_window(window: int) -> None:
    """The impulse reaches as far as half the window."""
    impulse = (np.arange(1001) == 500).astype(float)
    for seconds in (1e-3 * window, 1e-3 * (window + 0.9)):
        reached = np.flatnonzero(np.abs(signals.smoothed(impulse, 1e-3, seconds)) > 1e-9)
        assert reached[-1] - reached[0] + 1 == window


@pytest.mark.parametrize("z", [np.zeros(100), triangle(1000, 5), 6 * np.sin(np.arange(1000) / 100)])
def test_no_noise_no_smoothing(z: np.ndarray) -> None:
    assert signals.smoothing_time_s(z, 1e-3) == 0
    assert signals.smoothed(z, 1e-3, 0.0) is z


def test_smoothing_is_bounded_by_the_record() -> None:
    z = noise(64)
    window_s = signals.smoothing_time_s(z, 1e-3)
    assert 0 < window_s <= 16.5e-3
    assert signals.smoothed(z, 1e-3, 1.0).shape == z.shape
    assert signals.smoothed(z[:63], 1e-3, 1.0).shape == (63,)


def test_smoothing_has_no_phase() -> None:
    """A parabola passes unchanged, a cosine about its peak stays symmetrical."""
    t = np.arange(-200, 201) * 1e-3
    assert signals.smoothed(t**2, 1e-3, 0.05) == pytest.approx(t**2, abs=1e-12)
    smooth = signals.smoothed(np.cos(40 * t), 1e-3, 0.05)
    assert smooth == pytest.approx(smooth[::-1], abs=1e-12) and smooth[200] < 1


@pytest.mark.parametrize("window_s, filter_s", [(0.0, 0.0), (0.004, 0.0), (0.0, 0.01), (0.0071, 0.003)])
def test_rate_is_the_firmwares(window_s: float, filter_s: float) -> None:
    z = triangle(500, 3.3) + 0.01 * noise(500)
    assert signals.rate(z, 1e-3, window_s, filter_s, 0.0) == pytest.approx(
        operators.rate(z, 1e-3, window_s, filter_s), rel=1e-12, abs=1e-9)
    smooth = signals.smoothed(z, 1e-3, 0.02)
    assert signals.rate(z, 1e-3, window_s, filter_s, 0.02) == pytest.approx(
        operators.rate(smooth, 1e-3, window_s, filter_s), rel=1e-12, abs=1e-9)


def test_rate_of_a_triangle() -> None:
    z = triangle(1000, 5)  # 120 um/s at 1 kHz
    rate = signals.rate(z, 1e-3, 0.0, 0.0, 0.0)
    assert rate[0] == 0 and rate[1:] == pytest.approx(120)
    smooth = signals.rate(z + 0.01 * noise(1000), 1e-3, 0.0, 0.0, 0.03)
    assert np.median(smooth) == pytest.approx(120, rel=0.03)
