"""Runs of known plants, and fits to them, for the tests of identification."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from plants import Plant, quasi_static, rate_of, recording, stack, waves

from rdpi.data import Recording
from rdpi.identify.identify import Fit, Options, fit

SPAN_V = 90.0
STATIC = Options(rate_independent=True)
NOISE_UM = 0.004  # 0.03 % of the stroke


def static_run(plant: Plant | None = None, high: float = SPAN_V, low: float = 0.0, cycles: float = 3,
               rate_hz: float = 500.0, **options: object) -> Recording:
    """1 Hz at rate 0, from rest unless `plant` is given."""
    options = {"noise_um": NOISE_UM, **options}
    if plant is None:
        return recording(*from_rest(high, low, cycles, rate_hz), rate_hz, **options)
    return quasi_static(plant, waves(high, 1, cycles, rate_hz, low), rate_hz, **options)


@lru_cache(maxsize=None)
def from_rest(high: float, low: float, cycles: float, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Command in V and displacement in um of a stack at rate 0 that was swept to rest at `low`."""
    plant, command = stack(), waves(high, 1, cycles, rate_hz, low)
    plant.settle(low)
    return command, plant.respond(command, np.zeros(len(command)))


@lru_cache(maxsize=None)
def static_fit() -> Fit:
    return fit([static_run()], STATIC)


@lru_cache(maxsize=None)
def moving_run(source: str, hertz: float, rate_hz: float, law: float = 1.0) -> Recording:
    """Two full cycles and a half one, the plant's slopes following the rate of the displacement or of the control."""
    plant, name = stack(law=law), f"{hertz:g}Hz.csv"
    if source == "control":
        command = np.r_[waves(SPAN_V, hertz, 2, rate_hz), waves(SPAN_V / 2, hertz, 1, rate_hz)]
        return recording(command, plant.respond(command, 0.13 * rate_of(command, rate_hz)), rate_hz, name)
    z = np.r_[waves(12.0, hertz, 2, rate_hz), waves(6.0, hertz, 1, rate_hz)]
    return recording(plant.drive(z, rate_of(z, rate_hz)), z, rate_hz, name)


def moving_runs(source: str, noise_um: float = NOISE_UM, law: float = 1.0,
                hertz: tuple[float, ...] = (1, 5, 10, 20, 30), samples: int = 300) -> list[Recording]:
    """One run per frequency, each of `samples` per cycle."""
    runs = [moving_run(source, f, samples * f, law) for f in hertz]
    return [recording(run.command_V, run.displacement_um, run.sample_rate_hz, run.path, noise_um=noise_um)
            for run in runs]


def percent(found: np.ndarray, truth: np.ndarray) -> float:
    """Largest deviation, % of the truth."""
    return 100 * float(np.max(np.abs(found / truth - 1)))


def visited(turns: tuple[float, ...], **options: object) -> Plant:
    """A plant that was moved through these voltages, in straight lines, and left at the last."""
    plant = stack(**options)
    for low, high in zip(turns, turns[1:]):
        plant.respond(np.linspace(low, high, 50), np.zeros(50))
    return plant
