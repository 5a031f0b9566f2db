"""Gain change: everything moves more, or less, than identified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ... import firmware
from ...data import Recording
from ...firmware import Block
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .treatment import Treatment, folded


class GainChange(Effect):
    """factor times the displacement from the model's offset."""

    name = "gain_change"
    title = "changed gain"
    what = "the actuator's stroke, its load or the sensor's scale has changed"
    remedy = "calibrate the sensor and check the load; then identify the model again, or scale it"
    needs = "any motion, with the model frozen"
    article = "a"
    stages = "actuator", "sensor"
    parameters = (Parameter("factor", "1", 0.05, 20.0, 1.0, digits=5),)  # near 1, what counts lies behind it
    linear = True
    hides_rate = True

    @classmethod
    def variants(cls, runs: Sequence[Recording]) -> list[Effect]:
        return [cls()]  # a sensor's scale looks like the actuator's

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        return Block(firmware.LINE, (model.offset_um * (1 - values["factor"]), values["factor"]))

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        factor, law = values["factor"], folded_into.rate
        top = law.identified_um_per_s
        rate = replace(law, max_um_per_s=factor * law.max_um_per_s,
                       identified_um_per_s=None if top is None else factor * top)
        return folded("into the weights of the saturation stage", replace(
            folded_into, deadzone_weights=factor * folded_into.deadzone_weights, rate=rate,
            stroke_um=factor * folded_into.stroke_um,
            slope_rate_s_per_um=folded_into.slope_rate_s_per_um / factor))

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        return [self.absent()]
