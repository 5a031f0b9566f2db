"""Input curve: the actuator answers a volt more in one part of the drive's range than in another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ... import firmware
from ...firmware import Block
from ...model import LARGEST, MAX_CURVE_PIECES, Model, along
from .base import Effect, Parameter, Residuals, Values
from .planned import PlannedDrive, Shown
from .treatment import Treatment, folded

BOW = 0.05  # what `rdpi excite` tries: small enough to be linear in it
GRID, LEAST_ERROR = 4097, 1e-9  # where the pieces may end in the range; what is straight, of the range
LEAST_SLOPE = 0.1  # of the curve against the straight line between its ends; an inverse has at most one over it
LEAST_GAIN = 0.4  # less is the misfit of the plays: on plants that are the model it takes away up to a fifth


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
    parameters = (Parameter("quadratic", "1", -1.0, 1.0), Parameter("cubic", "1", -1.0, 1.0),
                  Parameter("low_V", "V", -LARGEST, LARGEST, internal=True),
                  Parameter("high_V", "V", -LARGEST, LARGEST, internal=True))
    linear = True
    # A curve at the input is built in. Sought on actuators that got none, it names no gap of 100 withheld cases better,
    # and makes one ambiguous: it is a twin of the curve at the output.
    comes_up = False
    chance_gain = 0.0, 0.2  # beside a refitted model: what the plays' own misfit lends

    def least_gain(self, values: Values) -> float:
        return LEAST_GAIN

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

    def block(self, values: Values, model: Model | None = None, sample_time_s: float = 0.0) -> Block | None:
        if not (values["quadratic"] or values["cubic"]):
            return None
        return Block(firmware.BENT, tuple(values[parameter.name] for parameter in self.parameters))

    def bent(self, drive_V: np.ndarray, values: Values) -> np.ndarray:
        """What the plays get of drives, both in V."""
        block = self.block(values)
        return drive_V if block is None else firmware.Bank([block]).run(drive_V)[0]

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        drive = folded_into.drive
        if not (values["quadratic"] or values["cubic"]):
            return folded("into nothing: it is straight", folded_into)
        points, off_V = self.pieces(values, drive.min_V, drive.max_V, drive.dac_bits)
        low_V, high_V = values["low_V"], values["high_V"]
        beside = f"; its own range, {low_V:g} to {high_V:g} V, lies beside the drive's: check low_V and high_V" \
            if high_V <= drive.min_V or low_V >= drive.max_V else ""
        return folded(f"into {len(points) - 1} pieces between the plays and the drive, which are off by up to "
                      f"{100 * off_V / (drive.max_V - drive.min_V):.2g} % of the range{beside}",
                      replace(folded_into, drive=replace(drive, curve_V=points)))

    def pieces(self, values: Values, min_V: float, max_V: float, dac_bits: int | None
               ) -> tuple[tuple[tuple[float, float], ...], float]:
        """The curve over a range of the drive as at most eight straight pieces, as Drive.curve_V holds them, and how far
        they are from it at most, in V at the plays. Their ends are chosen for the least largest error, and lie at codes.
        """
        grid_V = np.linspace(min_V, max_V, GRID)
        plays_V = self.bent(grid_V, values)
        low, high = LEAST_ERROR * (max_V - min_V), float(np.max(np.abs(plays_V - grid_V))) + max_V - min_V
        while high > low * 1.001:  # bisection: the least error for which eight pieces do
            middle = max((low * high) ** 0.5, low * 1.0005)
            low, high = (low, middle) if _corners(grid_V, plays_V, middle) else (middle, high)
        ends_V = grid_V[_corners(grid_V, plays_V, high)]
        if dac_bits is not None:
            step_V = (max_V - min_V) / (2**dac_bits - 1)
            ends_V = min_V + step_V * np.unique(np.rint((ends_V - min_V) / step_V))
        ends_V[[0, -1]] = min_V, max_V
        heights_V = self.bent(ends_V, values)
        missing_V = plays_V - along(grid_V, ends_V, heights_V)  # of one sign along a piece: half of it to either side
        piece = np.clip(np.searchsorted(ends_V, grid_V) - 1, 0, len(ends_V) - 2)
        largest_V = np.array([max(missing_V[piece == k], key=abs, default=0.0) for k in range(len(ends_V) - 1)])
        heights_V += np.convolve(largest_V, [0.25, 0.25]) * np.where(np.isin(ends_V, ends_V[[0, -1]]), 2, 1)
        error_V = float(np.max(np.abs(along(grid_V, ends_V, heights_V) - plays_V)))
        return tuple(zip(ends_V.tolist(), heights_V.tolist())), error_V

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        drive = residuals.model.drive
        return [{"quadratic": 0.0, "cubic": 0.0, "low_V": drive.min_V, "high_V": drive.max_V}]

    def shown(self, drive: PlannedDrive) -> Shown | None:
        range_V = drive.model.drive
        bow = drive.change(self, quadratic=BOW, cubic=0.0, low_V=range_V.min_V, high_V=range_V.max_V)
        least = float(drive.least([bow], instead_of="bends")[0]) * BOW / 4  # height in the middle of the range
        return Shown(f"bows of {100 * least:.2g} % of the range or more; a bent displacement (saturation stage) looks "
                     "nearly alike", least, None, "of the range")


def _corners(x: np.ndarray, y: np.ndarray, error: float) -> list[int]:
    """Where straight pieces end that begin and end on the curve and are within `error` of it, one after the other as
    long as can be; nowhere, if they are more than eight.
    """
    found = [0]
    while found[-1] < len(x) - 1:
        if len(found) > MAX_CURVE_PIECES:
            return []
        start = found[-1]
        near, far = start + 1, len(x) - 1
        while near < far:
            end = (near + far + 1) // 2
            chord = along(x[start:end + 1], x[[start, end]], y[[start, end]])
            near, far = (end, far) if np.max(np.abs(chord - y[start:end + 1])) <= error else (near, end - 1)
        found.append(near)
    return found


def _least_slope(quadratic: float, cubic: float) -> float:
    """Of the curve within its range: 1 + quadratic s + cubic (3 s^2 - 1) / 2, s = 1 - 2 u."""
    least = 1 - abs(quadratic) + cubic
    if 3 * cubic > abs(quadratic):  # the parabola turns within
        least = 1 - cubic / 2 - quadratic**2 / (6 * cubic)
    return least
