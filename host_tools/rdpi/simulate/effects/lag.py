"""Lag: a first-order low-pass in the amplifier or in the sensor."""

from __future__ import annotations

import numpy as np

from ...data import Recording
from ...model import Model
from .base import Effect, Parameter, Residuals, Values, low_pass


class Lag(Effect):
    """y' = (u - y) / time_constant_s."""

    name = "lag"
    title = "first-order lag"
    what = "an amplifier with a capacitive load, or a sensor's output filter, follows late and rounds fast changes off"
    remedy = "raise the bandwidth: use a stronger amplifier, or a faster output filter of the sensor"
    needs = "frequencies above sqrt(2 e) / (2 pi T); T is the time constant, e the model's relative error"
    article = "a"
    stages = "amplifier", "sensor"
    of_rig = True
    parameters = (Parameter("time_constant_s", "s", 0.0, 1.0),)

    def act(self, signal: np.ndarray, run: Recording, values: Values, model: Model) -> np.ndarray:
        time_constant_s = values["time_constant_s"]
        return low_pass(signal, run.sample_time_s, time_constant_s) if time_constant_s > 0 else signal

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        return [{"time_constant_s": 0.5 * min(run.sample_time_s for run in residuals.runs)}]
