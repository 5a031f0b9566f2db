"""Rail saturation: the amplifier's supply cuts the drive off."""

from __future__ import annotations

import numpy as np

from ...data import Recording
from ...model import Model
from .base import Effect, Parameter, Residuals, Values

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

    def act(self, drive_V: np.ndarray, run: Recording, values: Values, model: Model) -> np.ndarray:
        return np.clip(drive_V, values["V_min"], values["V_max"])

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        low = min(float(np.min(run.command_V)) for run in residuals.runs)
        high = max(float(np.max(run.command_V)) for run in residuals.runs)
        cuts = [share * (high - low) for share in SHARES]
        return [{"V_min": low + below, "V_max": high - above} for cut in cuts
                for below, above in ((0.0, cut), (cut, 0.0), (cut, cut))] if high > low else []
