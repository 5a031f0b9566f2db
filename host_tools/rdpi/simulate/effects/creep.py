"""Creep: the displacement goes on by a share of the move for every decade of time."""

from __future__ import annotations

import numpy as np

from ... import firmware
from ...data import Recording
from ...firmware import Block
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .planned import PlannedDrive, Shown, time_text
from .treatment import Treatment

TIMES_S = 10.0 ** np.arange(-1.0, 3.01, 0.5)  # of the lags whose sum grows as the logarithm of time
COARSEST_S = TIMES_S[-1] / 10  # of sampling: beside a longer sample hardly a lag lasts
PER_DECADE = float((len(TIMES_S) - 1) / np.log10(TIMES_S[-1] / TIMES_S[0]))
FAST_S = 0.01  # a lag of this time constant may be there too
PAST_MOVE = 0.5  # [stroke] that the actuator may have been away from where a recording starts
HOLD_S = 1.0  # creep is slow: shorter recordings cannot show it


class Creep(Effect):
    """z + percent_per_decade / 100 times the mean per decade of lags of z, from 0.1 s to 1000 s.

    One-parameter logarithmic creep, z (1 + g log10(t / t_0)) after a step, as a linear operator. Creep had settled where
    a recording starts, or after a sweep in the middle of the drive's range: there it adds nothing.
    """

    name = "creep"
    title = "creep"
    what = "after a move the actuator goes on moving, in proportion to the logarithm of time"
    remedy = "wait after large moves, close the loop for slow motion, or take an inverse that knows of creep"
    needs = "steps, each with a hold after it; creep starts anew at each step"
    stages = ("actuator",)
    of_rig = True
    parameters = (Parameter("percent_per_decade", "%", -2.0, 20.0),)
    on_rig = in_gap = {"percent_per_decade": (0.0, 10.0)}
    in_holds = "percent_per_decade"
    slow = True
    linear = True
    tells_zero = True
    chance_gain = 0.15, 0.0  # what a rig's own creep brings, of which short commissioning recordings show little

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        share = values["percent_per_decade"] / 100 / PER_DECADE
        if share == 0:
            return None
        return firmware.lags_block(sample_time_s, TIMES_S, np.full(len(TIMES_S), share), len(TIMES_S) * share, of_actuator=True)

    def past_um(self, values: Values, run: Recording, model: Model) -> float:
        decades = np.log10(1 + len(run) * run.sample_time_s / TIMES_S[0])
        return float(abs(values["percent_per_decade"]) / 100 * PAST_MOVE * model.stroke_um * decades)

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        share = values["percent_per_decade"] / 100 / PER_DECADE
        return Treatment("compensated", f"exactly, by poles from {time_text(TIMES_S[0])} to {time_text(TIMES_S[-1])}",
                         poles=tuple((share, float(time_s)) for time_s in TIMES_S) if share else ())

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        longest_s = max(len(run) * run.sample_time_s for run in residuals.runs)
        coarsest_s = max(run.sample_time_s for run in residuals.runs)
        return [self.absent()] if longest_s > HOLD_S and coarsest_s < COARSEST_S else []

    def shown(self, drive: PlannedDrive) -> Shown | None:
        least = float(drive.least([drive.change(self, percent_per_decade=1.0)], [drive.lagged(FAST_S)])[0])
        highest = self.parameters[0].high
        if not least < highest:
            return Shown(f"the longest hold lasts {time_text(drive.hold_s)}; give a longer --duration")
        return Shown(f"from {least:.2g} % of a move per decade on; the longest hold lasts {time_text(drive.hold_s)}, "
                     "creep after that is extrapolated", least, highest, "%")
