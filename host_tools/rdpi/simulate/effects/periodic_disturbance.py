"""Periodic disturbance: mains hum, a pump, a fan: one frequency whatever the drive does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...data import Recording
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .treatment import Treatment, left_out

PEAKS = 3
LEAST_PERIODS = 4  # in the longest recording


class PeriodicDisturbance(Effect):
    """A sine of frequency_hz; amplitude and phase are free in every recording."""

    name = "periodic_disturbance"
    title = "periodic disturbance"
    what = "mains hum, a pump or a fan shakes the stage or leaks into the sensor"
    remedy = "find the source at this frequency (ground loop, fan, pump), or average over its period"
    needs = "a few periods of the disturbance in any recording"
    article = "a"
    stages = ("environment",)
    parameters = Parameter("frequency_hz", "Hz", 0.0, np.inf), Parameter("amplitude_um", "um", 0.0, np.inf)
    disturbance = True
    several = True  # lines at other frequencies
    frequency = "frequency_hz"
    chance_gain = 0.08, 0.08

    def columns(self, run: Recording, values: Values, model: Model) -> np.ndarray:
        if values["frequency_hz"] == 0:
            return np.zeros((len(run), 0))
        phase = 2 * np.pi * values["frequency_hz"] * (run.time_s - run.time_s[0])
        return np.column_stack([np.sin(phase), np.cos(phase)])

    def summary(self, values: Values, sizes: Sequence[np.ndarray], samples: Sequence[int]) -> dict[str, float]:
        return {**values, "amplitude_um": float(np.sqrt(np.mean([float(one @ one) for one in sizes])))}

    def usual_sizes(self, values: Values) -> np.ndarray:
        return np.array([values["amplitude_um"], 0.0] if values["frequency_hz"] else [])

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        return left_out("the drive does not cause it, and its phase is another in each run")

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        """The strongest lines of the residual, each recording's spectrum weighed by its length."""
        rate = min(run.sample_rate_hz for run in residuals.runs)
        longest = max(len(run) * run.sample_time_s for run in residuals.runs)
        fine = 1 / (4 * longest)
        frequencies = np.arange(LEAST_PERIODS / longest, 0.45 * rate, fine)
        if not len(frequencies):
            return []
        power = np.zeros(len(frequencies))
        for run, residual in zip(residuals.runs, residuals.residual_um):
            size = 1 << int(np.ceil(np.log2(max(len(run), run.sample_rate_hz / fine))))
            spectrum = np.abs(np.fft.rfft(residual, size)) ** 2 / len(run)
            power += np.interp(frequencies, np.arange(len(spectrum)) * run.sample_rate_hz / size, spectrum)
        starts = []
        for _ in range(PEAKS):
            best = int(np.argmax(power))
            if power[best] <= 0:
                break
            starts.append({"frequency_hz": float(frequencies[best]), "amplitude_um": 0.0})
            power[max(0, best - 12):best + 13] = 0
        return starts
