"""Thermal drift: the zero wanders with time, or with the temperature where that was recorded."""

from __future__ import annotations

import numpy as np

from ..model import Model
from ..recording import Recording
from .base import Effect, Parameter, Values, View

COLUMN = "temperature_degC"


class ThermalDrift(Effect):
    """um_per_s times the time, or um_per_degC times `column`; estimated per recording, never extrapolated.

    A parabola beside it would take the slow noise of any sensor for drift.
    """

    name = "thermal_drift"
    title = "thermal drift"
    what = "the zero wanders as actuator, sensor or frame warm up"
    remedy = "warm up longer, shield from draught and sun, log temperature_degC, or re-zero"
    needs = "rest or repetition over a long time"
    stages = ("environment",)
    parameters = Parameter("um_per_s", "um/s", -np.inf, np.inf), Parameter("um_per_degC", "um/°C", -np.inf, np.inf)
    disturbance = True

    def __init__(self, stage: str | None = None, column: str = "time_s") -> None:
        super().__init__(stage)
        self.column = column

    @property
    def options(self) -> dict[str, str]:
        return {"column": self.column}

    @property
    def free(self) -> tuple[str, ...]:
        return (self.parameters[self.column == COLUMN].name,)

    def columns(self, run: Recording, values: Values, model: Model) -> np.ndarray:
        wandering = run.columns.get(self.column, np.zeros(len(run)))
        return (wandering - wandering[0])[:, None]

    def starts(self, view: View) -> list[dict[str, float]]:
        seen = [self.column in run.columns and np.ptp(run.columns[self.column]) > 0 for run in view.runs]
        return [{}] if all(seen) else []
