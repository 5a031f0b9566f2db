"""Thermal drift: the zero wanders with time, or with the temperature where that was recorded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...data import Recording
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .planned import PlannedDrive, Shown, time_text
from .treatment import Addend, Treatment, left_out

COLUMNS = "time_s", "temperature_degC"  # whose parameters stand in this order


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
    look = ("If the residual over time shows a step rather than a slope, something slipped or the sensor's zero "
            "jumped.")
    of_column = COLUMNS[0]
    disturbance = True
    slow = True
    moves_zero = True
    chance_gain = 0.10, 0.10

    @classmethod
    def variants(cls, runs: Sequence[Recording]) -> list[Effect]:
        return [cls(column=column) for column in COLUMNS]

    @staticmethod
    def wrong_column(column: object) -> str | None:
        return None if column in COLUMNS else f"must be one of {', '.join(COLUMNS)}"

    @property
    def differs_anyway(self) -> bool:
        return self.column == self.of_column

    @property
    def fitted(self) -> tuple[str, ...]:
        return (self.parameters[COLUMNS.index(self.column)].name,)

    def columns(self, run: Recording, values: Values, model: Model) -> np.ndarray:
        wandering = run.columns.get(self.column, np.zeros(len(run)))
        return (wandering - wandering[0])[:, None]

    def summary(self, values: Values, sizes: Sequence[np.ndarray], samples: Sequence[int]) -> dict[str, float]:
        parameter = self.parameters[COLUMNS.index(self.column)]
        usual = np.average([one[0] for one in sizes], weights=samples)
        return {parameter.name: float(np.clip(usual, *parameter.ends))}

    def usual_sizes(self, values: Values) -> np.ndarray:
        return np.array([values[self.parameters[COLUMNS.index(self.column)].name]])

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        if self.column == COLUMNS[0]:
            return left_out("it follows no recorded quantity, so that it cannot be foretold; log temperature_degC")
        (size,) = self.usual_sizes(values)
        return Treatment("compensated", f"by the application, which subtracts {size:.4g} um per unit of {self.column} "
                         "since the start", addend=Addend(self.column, float(size), True))

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        seen = [self.column in run.columns and np.ptp(run.columns[self.column]) > 0 for run in residuals.runs]
        return [{}] if all(seen) else []

    def shown(self, drive: PlannedDrive) -> Shown | None:
        return Shown(f"{time_text(len(drive.u) * drive.step_s)} are too short; log {COLUMNS[1]} in longer "
                     "recordings")
