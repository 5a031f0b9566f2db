"""Rail saturation: the amplifier's supply cuts the drive off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ... import firmware
from ...data import Recording
from ...firmware import Block
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .treatment import Treatment, folded, left_out

SHARES = 0.02, 0.06, 0.12, 0.2, 0.3  # of the commands' range cut off, where a fit starts


class RailSaturation(Effect):
    """min(max(V, V_min), V_max)."""

    name = "rail_saturation"
    title = "saturation at the supply's rails"
    what = "the amplifier cannot reach the lowest or highest drive that is requested"
    remedy = "reduce the drive's range (drive.min_V, drive.max_V), or raise the supply"
    needs = "a flat top at one command level"
    stages = ("amplifier",)
    parameters = Parameter("V_min", "V", -np.inf, np.inf, -np.inf), Parameter("V_max", "V", -np.inf, np.inf, np.inf)

    @staticmethod
    def refusal(values: Values) -> str | None:
        return None if values["V_min"] < values["V_max"] else "V_min must lie below V_max"

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        return Block(firmware.CLAMP, (values["V_min"], values["V_max"]))

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        drive = folded_into.drive
        low, high = max(drive.min_V, values["V_min"]), min(drive.max_V, values["V_max"])
        if (low, high) == (drive.min_V, drive.max_V):
            return folded("into nothing: the drive's range lies within the rails", folded_into)
        if not low < high:
            return left_out(f"the rails leave nothing of the drive's range, {drive.min_V:g} to {drive.max_V:g} V")
        if drive.dac_bits:
            return left_out(f"the DAC's codes span {drive.min_V:g} to {drive.max_V:g} V, so that the range cannot be "
                            f"made smaller; keep the reference within what {low:.4g} to {high:.4g} V reach")
        end = None if drive.sweep_end_V is None else float(np.clip(drive.sweep_end_V, low, high))
        return folded(f"into the drive's range, {low:.4g} to {high:.4g} V", replace(
            folded_into, drive=replace(drive, min_V=low, max_V=high, sweep_end_V=end)))

    def within(self, values: Values, runs: Sequence[Recording]) -> Values:
        low, high = _ends(runs)
        return {"V_min": values["V_min"] if values["V_min"] > low else -np.inf,
                "V_max": values["V_max"] if values["V_max"] < high else np.inf}

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        low, high = _ends(residuals.runs)
        far = high - low  # beyond which no command goes: a rail there has no part in a fit
        return [{"V_min": low + below, "V_max": high - above} for cut in far * np.array(SHARES)
                for below, above in ((-far, cut), (cut, -far), (cut, cut))] if high > low else []


def _ends(runs: Sequence[Recording]) -> tuple[float, float]:
    """The lowest and the highest command, in V."""
    return min(float(np.min(run.command_V)) for run in runs), max(float(np.max(run.command_V)) for run in runs)
