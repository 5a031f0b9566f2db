"""Input curve: the actuator answers a volt more in one part of the drive's range than in another."""

from __future__ import annotations

import numpy as np

from ...data import Recording
from ...model import LARGEST, Model
from .base import Effect, Parameter, Residuals, Values
from .planned import PlannedDrive, Shown
from .treatment import Treatment, left_out

BOW = 0.05  # what `rdpi excite` tries: small enough to be linear in it
LEAST_SLOPE = 0.1  # of the curve against the straight line between its ends; an inverse has at most one over it


class InputCurve(Effect):
    """u + quadratic u (1 - u) + cubic u (1 - u) (1 - 2 u), u = 0 to 1 over low_V to high_V; straight on outside.

    The ends stay where they are: gain and offset are the model's. The range is the effect's own, so that another drive
    range of the model leaves the curve as it was identified.
    """

    name = "input_curve"
    title = "input curve"
    what = "the actuator answers a volt more strongly in one part of its range than in another, on both branches alike"
    remedy = "identify the model again over the whole range"
    needs = "loops over the whole range, and small loops at several places in it"
    article = "an"
    look = "Small loops show it: they are larger where the curve is steep."
    stages = ("actuator",)
    on_drive = True
    of_rig = True
    needs_loops = True
    least_gain = 0.4  # less is the misfit of the plays: on plants that are the model it takes away up to a fifth
    parameters = (Parameter("quadratic", "1", -1.0, 1.0), Parameter("cubic", "1", -1.0, 1.0),
                  Parameter("low_V", "V", -LARGEST, LARGEST, internal=True),
                  Parameter("high_V", "V", -LARGEST, LARGEST, internal=True))
    linear = True
    # A curve at the input is built in. Sought on actuators that got none, it names no gap of 100 withheld cases better,
    # and makes one ambiguous: it is a twin of the curve at the output.
    comes_up = False
    chance_gain = 0.0, 0.2  # beside a refitted model: what the plays' own misfit lends

    @property
    def fitted(self) -> tuple[str, ...]:
        return "quadratic", "cubic"

    @staticmethod
    def refusal(values: Values) -> str | None:
        if not (values["quadratic"] or values["cubic"]):
            return None
        if not values["low_V"] < values["high_V"]:
            return f"low_V is {values['low_V']:g} and high_V {values['high_V']:g}; the range must have a length"
        least = _least_slope(values["quadratic"], values["cubic"])
        return None if least > LEAST_SLOPE else (f"the least slope of the curve is {least:.3g} of its mean slope; "
                                                 f"must be more than {LEAST_SLOPE:g}")

    def act(self, drive_V: np.ndarray, run: Recording, values: Values, model: Model) -> np.ndarray:
        quadratic, cubic, low_V, high_V = (values[parameter.name] for parameter in self.parameters)
        if not (quadratic or cubic):
            return drive_V
        within_V = np.clip(drive_V, low_V, high_V)
        u = (within_V - low_V) / (high_V - low_V)
        bow = u * (1 - u) * (quadratic + cubic * (1 - 2 * u))
        end_slope = cubic + np.where(drive_V < low_V, quadratic, -quadratic)
        return drive_V + (high_V - low_V) * bow + end_slope * (drive_V - within_V)

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        return left_out("the inverse does not have a curve between the plays and the drive yet")

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        drive = residuals.model.drive
        return [{"quadratic": 0.0, "cubic": 0.0, "low_V": drive.min_V, "high_V": drive.max_V}]

    def shown(self, drive: PlannedDrive) -> Shown | None:
        range_V = drive.model.drive
        bow = drive.change(self, quadratic=BOW, cubic=0.0, low_V=range_V.min_V, high_V=range_V.max_V)
        least = float(drive.least([bow], instead_of="bends")[0]) * BOW / 4  # height in the middle of the range
        return Shown(f"bows of {100 * least:.2g} % of the range or more; a bent displacement (saturation stage) looks "
                     "nearly alike", least, None, "of the range")


def _least_slope(quadratic: float, cubic: float) -> float:
    """Of the curve within its range: 1 + quadratic s + cubic (3 s^2 - 1) / 2, s = 1 - 2 u."""
    least = 1 - abs(quadratic) + cubic
    if 3 * cubic > abs(quadratic):  # the parabola turns within
        least = 1 - cubic / 2 - quadratic**2 / (6 * cubic)
    return least
