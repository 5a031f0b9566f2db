"""Cross coupling: another axis moves this one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...data import Recording
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .planned import PlannedDrive, Shown
from .treatment import Addend, Treatment

OWN = "command_V", "monitor_V"


def covariates(run: Recording) -> list[str]:
    """Columns in V of other axes that move."""
    return [name for name, values in run.columns.items() if is_axis(name) and np.ptp(values) > 0]


def is_axis(column: str) -> bool:
    """Whether a column of this name is the drive of another axis."""
    return column.endswith("_V") and column not in OWN


class CrossCoupling(Effect):
    """um_per_V times the drive of another axis, a logged column in V."""

    name = "cross_coupling"
    title = "cross coupling from another axis"
    what = "another axis of the stage moves this one, mechanically or through the supply"
    remedy = "decouple the axes, or subtract the share of the other axis from the reference"
    needs = "a recorded column of the other axis that moves, such as other_axis_V"
    stages = ("environment",)
    parameters = (Parameter("um_per_V", "um/V", -np.inf, np.inf),)
    linear = True

    of_column = "other_axis_V"

    @classmethod
    def variants(cls, runs: Sequence[Recording]) -> list[Effect]:
        return [cls(column=column) for column in dict.fromkeys(name for run in runs for name in covariates(run))]

    @staticmethod
    def wrong_column(column: object) -> str | None:
        named = isinstance(column, str) and is_axis(column)
        return None if named else "must name another axis' drive, such as other_axis_V"

    def act(self, z_um: np.ndarray, run: Recording, values: Values, model: Model) -> np.ndarray:
        other = run.columns.get(self.column)
        return z_um if other is None else self.added(z_um, other, values)

    @staticmethod
    def added(z_um: np.ndarray, other_V: np.ndarray, values: Values) -> np.ndarray:
        """With what the other axis adds; all (samples,)."""
        return z_um + values["um_per_V"] * other_V

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        return Treatment("compensated", f"by the application, which subtracts {values['um_per_V']:.4g} um per V of "
                         f"{self.column}", addend=Addend(self.column, values["um_per_V"], False))

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        return [self.absent()] if any(self.column in covariates(run) for run in residuals.runs) else []

    def shown(self, drive: PlannedDrive) -> Shown | None:
        return Shown(f"the drive moves one axis; move the other in another recording, log its drive as {self.column}")
