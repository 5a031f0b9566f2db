"""Static nonlinearity: a curved scale of the actuator or the sensor, the same on both branches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...data import Recording
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .gain_change import GainChange


class StaticNonlinearity(Effect):
    """z + (stroke / 2) (linear p + quadratic p^2 + cubic p^3), p = -1 to 1 over the model's stroke.

    `linear` is the scale that goes with the curve: which straight line a curve departs from is a convention.
    """

    name = "static_nonlinearity"
    title = "static nonlinearity"
    what = "the sensor's or the actuator's scale is curved"
    remedy = "calibrate the sensor against a reference, or identify with more dead zones"
    needs = "both branches of a loop; their mean against position shows the curve"
    article = "a"
    stages = "sensor", "actuator"
    parameters = (Parameter("linear", "1", -2.0, 2.0), Parameter("quadratic", "1", -2.0, 2.0),
                  Parameter("cubic", "1", -2.0, 2.0))
    linear = True
    contains = GainChange  # by `linear`
    chance_gain = 0.0, 0.2  # beside a refitted model: what the plays' own misfit lends

    @classmethod
    def variants(cls, runs: Sequence[Recording]) -> list[Effect]:
        return [cls()]  # a curve of the actuator looks like one of the sensor

    def act(self, z_um: np.ndarray, run: Recording, values: Values, model: Model) -> np.ndarray:
        half = model.stroke_um / 2
        p = (z_um - model.offset_um) / half - 1
        return z_um + half * p * (values["linear"] + p * (values["quadratic"] + p * values["cubic"]))

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        return [self.absent()]
