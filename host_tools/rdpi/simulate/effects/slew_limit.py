"""Slew limit: the amplifier's current into the actuator's capacitance bounds dV/dt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...data import Recording
from ...model import Model
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
    parameters = (Parameter("V_per_s", "V/s", 1e-9, np.inf, np.inf),)

    def act(self, drive_V: np.ndarray, run: Recording, values: Values, model: Model) -> np.ndarray:
        limit = values["V_per_s"] * run.sample_time_s
        return limited(drive_V, limit) if np.isfinite(limit) else drive_V

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        drive, limit = folded_into.drive, values["V_per_s"]
        if not np.isfinite(limit):
            return folded("into nothing: it is no limit", folded_into)
        slew = min(limit, drive.slew_V_per_s or np.inf)
        sweep = None if drive.sweep_V_per_s is None else min(drive.sweep_V_per_s, slew)
        return folded(f"into the drive's slew limit, {slew:.4g} V/s", replace(
            folded_into, drive=replace(drive, slew_V_per_s=slew, sweep_V_per_s=sweep)))

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        fastest = max(float(np.max(np.abs(np.diff(run.command_V)))) / run.sample_time_s for run in residuals.runs)
        return [{"V_per_s": share * fastest} for share in SHARES if fastest > 0]


def limited(signal: np.ndarray, limit: float) -> np.ndarray:
    """The signal following with at most `limit` per sample; only where it is too fast is it gone through in turn."""
    result = signal.copy()
    fast = np.flatnonzero(np.abs(np.diff(signal)) > limit) + 1
    k = 0
    while k < len(fast):
        i = int(fast[k])
        value = float(result[i - 1])
        while i < len(signal):
            target = float(signal[i])
            if abs(target - value) <= limit:
                break
            value += limit if target > value else -limit
            result[i] = value
            i += 1
        k = max(k + 1, int(np.searchsorted(fast, i + 1)))
    return result
