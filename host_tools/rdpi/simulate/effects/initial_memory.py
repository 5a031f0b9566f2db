"""Initial memory: the hysteresis started elsewhere than the recording says."""

from __future__ import annotations

import numpy as np

from ...data import Recording
from ...model import Model
from .base import Effect, Parameter, Values, View


class InitialMemory(Effect):
    """The plays start as after a straight move from position_um; sought anew in every recording.

    The chain does it: with this effect every run is treated as one whose memory is unknown.
    """

    name = "initial_memory"
    title = "unknown start of the memory"
    what = "the hysteresis remembered something else at the first sample than the recording says"
    remedy = "run the start-up sweep first, and mark recordings memory: reset only then"
    needs = "a first pass that differs from the second"
    stages = ("actuator",)
    parameters = (Parameter("position_um", "um", -np.inf, np.inf),)
    disturbance = True

    def starts(self, view: View) -> list[dict[str, float]]:
        known = [run for run in view.runs if run.memory != "unknown"]
        return [{}] if known and len(view.model.thresholds_um) > 1 else []

    def columns(self, run: Recording, values: Values, model: Model) -> np.ndarray:
        return np.zeros((len(run), 0))
