"""Hysteresis change: loops wider or narrower than identified, the stroke unchanged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .treatment import Treatment, folded

LEAST = 0.02  # no slope falls below this share of the last one


class HysteresisChange(Effect):
    """Play weights w_i (eq. 16, i >= 1) times 1 + scale + shape (2 r_i / r_n - 1), all rescaled to the same stroke."""

    name = "hysteresis_change"
    title = "changed hysteresis"
    what = "the loops have become wider or narrower through ageing, temperature, load or another operating point"
    remedy = "identify the model again"
    needs = "the same loop at low rates"
    stages = ("actuator",)
    parameters = Parameter("scale", "1", -0.9, 5.0), Parameter("shape", "1", -2.0, 2.0)
    linear = True
    changes_loops = True
    hides_rate = True

    def operator(self, model: Model, values: Values) -> Model:
        if len(model.thresholds_um) < 2:
            return model
        place = 2 * model.thresholds_um / model.thresholds_um[-1] - 1
        return replace(model, slopes=widened(model, 1 + values["scale"] + values["shape"] * place))

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        as_predicted = replace(folded_into, drive=model.drive)  # whose stroke stays, whatever rails leave of the range
        return folded("into the slopes of the plays", replace(self.operator(as_predicted, values), drive=folded_into.drive))

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        return [self.absent()] if len(residuals.model.thresholds_um) > 1 else []


def widened(model: Model, factor: np.ndarray) -> np.ndarray:
    """Slopes W_i (n + 1,) once each play weight but the first is multiplied by its factor, over the same stroke.

    Over a full drive a the ends of the loop lie sum of w_i max(a - 2 r_i, 0) apart: a play of r_i > a / 2 rests.
    """
    r, last = model.thresholds_um, model.slopes[-1]
    weights = np.diff(model.slopes, prepend=0.0)
    changed = np.where(r > 0, weights * factor, 0.0)
    changed[0] = last - np.sum(changed)
    slopes = np.maximum(np.cumsum(changed), LEAST * last)
    reach = abs(model.gain_um_per_V) * (model.drive.max_V - model.drive.min_V)
    before, after = (np.diff(w, prepend=0.0) @ np.maximum(reach - 2 * r, 0.0) for w in (model.slopes, slopes))
    return slopes * before / after
