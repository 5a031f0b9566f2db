"""Static nonlinearity: a curved scale of the actuator or the sensor, the same on both branches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ... import firmware
from ...data import Recording
from ...firmware import Block
from ...model import Model, loop_ends_um, operators
from .base import Effect, Parameter, Residuals, Values
from .gain_change import GainChange
from .treatment import Treatment, folded, left_out

PIECES = 8  # of the saturation stage at most, as the library allows without being told more
POINTS = 2001  # at which the error of the pieces is measured


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

    def block(self, values: Values, model: Model, sample_time_s: float = 0.0) -> Block:
        return Block(firmware.CUBIC, (model.offset_um, model.stroke_um / 2, values["linear"], values["quadratic"],
                                      values["cubic"]))

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        d, weights, offset_um = folded_into.deadzones_um, folded_into.deadzone_weights, folded_into.offset_um
        low, high = loop_ends_um(folded_into)
        v = np.unique(np.concatenate([np.linspace(min(low, 0.0), max(high, d[-1]), POINTS), d]))
        z = firmware.Bank([self.block(values, model)]).run(operators.saturation(v, d, weights) + offset_um)[0]
        corners = _corners(v[v >= 0], z[v >= 0])
        at = np.interp(corners, v, z)
        slopes = np.diff(at) / np.diff(corners)
        if not len(slopes) or not np.all(slopes > 0):
            return left_out("it does not increase everywhere, so that it has no inverse")
        changed = replace(folded_into, deadzones_um=corners[:-1], deadzone_weights=np.diff(slopes, prepend=0.0),
                          offset_um=float(at[0]))
        seen = (low <= v) & (v <= high)
        made = operators.saturation(v[seen], changed.deadzones_um, changed.deadzone_weights) + changed.offset_um
        plain = operators.saturation(v[seen], d, weights) + offset_um
        off, whole = (float(np.max(np.abs(z[seen] - other))) / model.stroke_um for other in (made, plain))
        if off > whole / 2:  # S has no corners below 0
            return left_out(f"pieces of the saturation stage would be off by {100 * off:.2g} % of the stroke, the "
                            f"effect is {100 * whole:.2g} %")
        return folded(f"into {len(slopes)} pieces of the saturation stage, which are off by up to {100 * off:.2g} % of "
                      "the stroke", changed)

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        return [self.absent()]


def _corners(v_um: np.ndarray, z_um: np.ndarray) -> np.ndarray:
    """Ends of at most PIECES straight pieces through a curve, the next one always where the others are furthest off."""
    corners = [0, len(v_um) - 1]
    while len(corners) <= PIECES:
        corners.sort()
        off = np.abs(np.interp(v_um, v_um[corners], z_um[corners]) - z_um)
        if off[worst := int(np.argmax(off))] <= 1e-12 * np.ptp(z_um):
            break
        corners.append(worst)
    return v_um[np.unique(corners)]
