"""Delay: everything comes later by the same time."""

from __future__ import annotations

import numpy as np

from ... import firmware
from ...firmware import Block
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .planned import PlannedDrive, Shown, time_text
from .treatment import Sensor, Treatment


class Delay(Effect):
    """x(t - delay_s), straight between samples; before the first sample as at the first."""

    name = "delay"
    title = "signal delay"
    what = "the drive reaches the actuator, or the reading reaches the record, later by a fixed time"
    remedy = "shift the reference ahead by the delay, or shorten conversion and communication"
    needs = "fast segments at both ends of the record; with one end only, a clock error looks the same"
    article = "a"
    stages = "timing", "sensor"
    of_rig = True
    comes_late = True
    grows_with_rate = True
    late_by = "delay_s"
    parameters = (Parameter("delay_s", "s", 0.0, 1.0),)

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        return firmware.delay_block(values["delay_s"] / sample_time_s) if values["delay_s"] > 0 else None

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        delay_s = values["delay_s"]
        return Treatment("compensated", f"by the lead, which looks {time_text(delay_s)} ahead", delay_s=delay_s)

    def less_sensor(self, values: Values, sensor: Sensor) -> tuple[Values, Sensor]:
        taken_s = min(values["delay_s"], sensor.delay_s)
        return ({**values, "delay_s": values["delay_s"] - taken_s},
                sensor._replace(delay_s=sensor.delay_s - taken_s))

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        return [{"delay_s": 0.5 * min(run.sample_time_s for run in residuals.runs)}]

    def shown(self, drive: PlannedDrive) -> Shown | None:
        least = float(drive.least([drive.change(Delay("sensor"), delay_s=drive.step_s)])[0]) * drive.step_s
        return Shown(f"from {time_text(least)} on, {least * drive.rate_hz:.2g} of a sample, if nothing else comes late",
                     least, None, "s")
