"""Noise shaping: what a code misses is carried to the next one. The plant here is the operator in NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from models import random_model

from rdpi.firmware import Chain, engine
from rdpi.model import Model, operators
from rdpi.simulate import numpy_inverse

RATE_HZ, BITS, BELOW_HZ = 10_000, 12, 100.0
LEAST_DB = 10.0


def references(model: Model) -> dict[str, np.ndarray]:
    """Displacements in um about the middle of what the model reaches, one second each."""
    time_s = np.arange(RATE_HZ) / RATE_HZ
    ends_V = np.array([model.drive.min_V, model.drive.max_V])
    ends_um = operators.forward(model, np.array([*ends_V, *ends_V]), np.zeros(4), model.memory.plays_um)[0][2:]
    middle_um, reach_um = float(np.mean(ends_um)), float(np.ptp(ends_um)) / 2
    return {
        "sines of 5, 20 and 35 Hz": middle_um + 0.25 * reach_um * sum(np.sin(2 * np.pi * hz * time_s) for hz in (5, 20, 35)),
        "a sine of 1 Hz": middle_um + 0.7 * reach_um * np.sin(2 * np.pi * time_s),
        # Slow enough that plain rounding errs below 100 Hz: a faster ramp crosses codes more often than that.
        "a slow triangle": middle_um + 0.02 * reach_um * (2 * np.abs((time_s + 0.25) % 1 - 0.5) - 0.5),
        "a small sine": middle_um + 0.002 * reach_um * np.sin(2 * np.pi * 10 * time_s)}


def error_um(model: Model, reference_um: np.ndarray, kind: str) -> np.ndarray:
    """What the actuator makes of the codes, less the reference, from the second half of two rounds."""
    both_um = np.tile(reference_um, 2)
    steps = engine(model, 1 / RATE_HZ, kind).step(both_um)
    assert not np.any(steps.flags)
    made_um = operators.forward(model, steps.drive_V.astype(float), steps.rate_um_per_s.astype(float),
                                model.memory.plays_um)[0]
    return (made_um - both_um)[len(reference_um):]


def slow_rms(values_um: np.ndarray) -> float:
    spectrum = np.fft.rfft(values_um * np.hanning(len(values_um)))
    return float(np.sqrt(np.sum(np.abs(spectrum[np.fft.rfftfreq(len(values_um), 1 / RATE_HZ) < BELOW_HZ]) ** 2)))


@pytest.mark.parametrize("kind", ["f32", "q31"])
@pytest.mark.parametrize("seed", range(12))
def test_12_bit_errors_below_100_hz_are_10_dB_smaller(seed: int, kind: str) -> None:
    model = random_model(seed)
    drive = replace(model.drive, dac_bits=BITS)
    model = replace(model, rate=replace(model.rate, max_um_per_s=1e5), drive=drive,
                    slope_rate_s_per_um=model.slope_rate_s_per_um * model.rate.max_um_per_s / 1e5)
    shaped = replace(model, drive=replace(drive, noise_shaping=True))
    for what, reference_um in references(model).items():
        decibels = 20 * np.log10(slow_rms(error_um(shaped, reference_um, kind)) /
                                 slow_rms(error_um(model, reference_um, kind)))
        print(f"\n{kind}, model {seed}, {what}: {decibels:.1f} dB", end="")
        assert decibels < -LEAST_DB, what
