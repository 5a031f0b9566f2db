"""Initial memory: the hysteresis started elsewhere than the recording says."""

from __future__ import annotations

import numpy as np

from ...data import Recording
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .treatment import Treatment, left_out


class InitialMemory(Effect):
    """The plays start as after a straight move from position_um; sought anew in every recording.

    The chain does it: with this effect the plays of every run start as if its memory were unknown.
    """

    name = "initial_memory"
    title = "unknown start of the memory"
    what = "the hysteresis had another memory at the first sample than the recording states"
    remedy = "run the start-up sweep first; mark a recording memory: reset only after that sweep"
    needs = "a first pass that differs from the second"
    article = "an"
    stages = ("actuator",)
    parameters = (Parameter("position_um", "um", -np.inf, np.inf),)
    disturbance = differs_anyway = True
    starts_memory = True
    chance_gain = 0.03, 0.03

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        return left_out("run the start-up sweep, it makes the memory known")

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        known = [run for run in residuals.runs if run.memory != "unknown"]
        return [{}] if known and len(residuals.model.thresholds_um) > 1 else []

    def columns(self, run: Recording, values: Values, model: Model) -> np.ndarray:
        return np.zeros((len(run), 0))

    def usual_sizes(self, values: Values) -> np.ndarray:
        return np.zeros(0)
