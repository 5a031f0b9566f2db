"""Lag: a first-order low-pass in the amplifier or in the sensor."""

from __future__ import annotations

import numpy as np

from ... import firmware
from ...firmware import Block
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .planned import PlannedDrive, Shown, time_text
from .treatment import Sensor, Treatment


class Lag(Effect):
    """y' = (u - y) / time_constant_s."""

    name = "lag"
    title = "first-order lag"
    what = "an amplifier with a capacitive load, or a sensor's output filter, follows late and rounds fast changes off"
    remedy = "raise the bandwidth: use a stronger amplifier, or a faster output filter of the sensor"
    needs = "frequencies above sqrt(2 e) / (2 pi T); T is the time constant, e the model's relative error"
    article = "a"
    stages = "amplifier", "sensor"
    of_rig = True
    comes_late = True
    grows_with_rate = True
    late_by = "time_constant_s"
    parameters = (Parameter("time_constant_s", "s", 0.0, 1.0),)

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        time_constant_s = values["time_constant_s"]
        return firmware.lags_block(sample_time_s, [time_constant_s], [1.0]) if time_constant_s > 0 else None

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        lag_s = values["time_constant_s"]
        return Treatment("compensated", f"in the drive, with {time_text(lag_s)} of its rate", lag_s=lag_s)

    def less_sensor(self, values: Values, sensor: Sensor) -> tuple[Values, Sensor]:
        taken_s = min(values["time_constant_s"], sensor.lag_s)
        return ({**values, "time_constant_s": values["time_constant_s"] - taken_s},
                sensor._replace(lag_s=sensor.lag_s - taken_s))

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        return [{"time_constant_s": 0.5 * min(run.sample_time_s for run in residuals.runs)}]

    def shown(self, drive: PlannedDrive) -> Shown | None:
        times_s, sensor = drive.times_s(), Lag("sensor")
        changes = (drive.change(sensor, time_constant_s=time_s) for time_s in times_s)
        seen = times_s[drive.least(changes, [drive.later()]) <= 1]
        if not len(seen):
            return Shown("it looks like a delay, because no edge is fast enough; allow a higher --slew or "
                         "--sample-rate")
        return Shown(f"time constants from {time_text(seen[0])} to {time_text(seen[-1])}; a shorter one looks like a "
                     "delay", float(seen[0]), float(seen[-1]), "s")
