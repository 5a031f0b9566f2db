"""Slew limit: the amplifier's current into the actuator's capacitance bounds dV/dt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ... import firmware
from ...firmware import Block
from ...model import Model
from .. import signals
from .base import Effect, Parameter, Residuals, Values
from .treatment import Treatment, folded

SHARES = 0.95 * 0.75 ** np.arange(14)  # of the fastest move, where a fit starts


class SlewLimit(Effect):
    """|dV/dt| <= V_per_s."""

    name = "slew_limit"
    title = "slew limit of the amplifier"
    what = "the amplifier's current limits how fast the actuator is charged"
    remedy = "slow the fastest moves down (drive.slew_V_per_s), or use an amplifier with more current"
    needs = "a large fast move; the effect vanishes at small amplitude"
    article = "a"
    stages = ("amplifier",)
    grows_with_rate = True
    parameters = (Parameter("V_per_s", "V/s", 1e-9, np.inf, np.inf),)

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        limit = values["V_per_s"] * sample_time_s
        return Block(firmware.SLEW, (limit,)) if np.isfinite(limit) else None

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        drive, limit = folded_into.drive, values["V_per_s"]
        if not np.isfinite(limit):
            return folded("into nothing: it is no limit", folded_into)
        slew = min(limit, drive.slew_V_per_s or np.inf)
        sweep = None if drive.sweep_V_per_s is None else min(drive.sweep_V_per_s, slew)
        return folded(f"into the drive's slew limit, {slew:.4g} V/s", replace(
            folded_into, drive=replace(drive, slew_V_per_s=slew, sweep_V_per_s=sweep)))

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        fastest = signals.fastest_V_per_s(residuals.runs)
        return [{"V_per_s": share * fastest} for share in SHARES if fastest > 0]
