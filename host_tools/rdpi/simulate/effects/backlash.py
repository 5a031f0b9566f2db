"""Backlash: play between actuator and stage."""

from __future__ import annotations

import numpy as np

from ... import firmware
from ...firmware import Block
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .treatment import Treatment

SHARES = 0.003, 0.01, 0.04  # of the stroke, where a fit starts


class Backlash(Effect):
    """One play operator (eq. 1) of threshold width / 2 after the actuator; starts in the middle of the gap."""

    name = "backlash"
    title = "backlash"
    what = "a joint or screw has play: after a reversal the stage stands still for a while"
    remedy = "preload the joint, or approach every position from the same side"
    needs = "reversals at several amplitudes"
    stages = ("mechanics",)
    stands_still = True
    parameters = (Parameter("width_um", "um", 0.0, np.inf),)

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        return Block(firmware.PLAY, (values["width_um"] / 2,)) if values["width_um"] else None

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        return Treatment("compensated", "by a jump of its width at each reversal of the reference, which the application "
                         "adds as the header says", jump_um=values["width_um"])

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        stroke = max(float(np.ptp(predicted)) for predicted in residuals.predicted_um)
        return [{"width_um": share * stroke} for share in SHARES]
