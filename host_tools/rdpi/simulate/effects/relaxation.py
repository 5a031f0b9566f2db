"""Relaxation: a share of every move follows late."""

from __future__ import annotations

import numpy as np

from ... import firmware
from ...firmware import Block
from ...model import Model
from .base import Effect, Parameter, Residuals, Values
from .gain_change import GainChange
from .planned import PlannedDrive, Shown, time_text
from .treatment import Treatment

SHORTEST_S, LONGEST_S = 1e-4, 1.0
SLOWEST_S = 0.05  # that `fit` and `gap` look for: slower is how creep begins, beside a new gain as well
PER_DECADE = 3  # time constants that are tried
PROMISING = 3  # of them, from which a fit starts
SHARES_SHOWN = 0.02, 0.08  # for which `rdpi excite` says the time constants that a drive shows
RESOLVED = 0.5, 0.25  # time constants that recordings resolve: from half a sample to a quarter of the longest


class Relaxation(Effect):
    """z + share (l - z), l' = (z - l) / time_constant_s: one first-order lag beside the direct way.

    A share below 0: the actuator relaxes less than the model.
    """

    name = "relaxation"
    title = "relaxation"
    what = "a share of each move comes late, because domains go on turning or a glue line yields"
    remedy = "wait a few time constants after fast moves, or stiffen the mount and its glue"
    needs = "steps, or frequencies on both sides of 1 / (2 pi T); T is the time constant"
    stages = ("actuator",)
    of_rig = True
    comes_late = True
    grows_with_rate = True
    needs_rates = True
    parameters = (Parameter("share", "1", -0.2, 0.5), Parameter("time_constant_s", "s", SHORTEST_S, LONGEST_S, 0.01))
    # Glue lines yield by more than the ceramic; a larger share is a lag.
    in_gap = {"share": (0.0, 0.3), "time_constant_s": (SHORTEST_S, SLOWEST_S)}  # a share below 0 would be early
    # As much as stacks relax; a larger share is a lag.
    on_rig = {"share": (0.0, 0.12), "time_constant_s": (SHORTEST_S, SLOWEST_S)}
    contains = GainChange  # slower than the recordings, its share is missing from every move

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        share = values["share"]
        return firmware.lags_block(sample_time_s, [values["time_constant_s"]], [share], of_actuator=True) if share else None

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        share, time_s = values["share"], values["time_constant_s"]
        return Treatment("compensated", f"exactly, by a pole of {time_text(time_s)}", direct=1 - share,
                         poles=((share, time_s),) if share else ())

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        """Of time constants a third of a decade apart those that explain most of the residual, with their shares."""
        low = max(SHORTEST_S, RESOLVED[0] * min(run.sample_time_s for run in residuals.runs))
        high = min(LONGEST_S, RESOLVED[1] * max(len(run) * run.sample_time_s for run in residuals.runs))
        if not low < high:
            return []
        times_s = np.geomspace(low, high, 1 + int(np.ceil(PER_DECADE * np.log10(high / low))))
        spectra = residuals.spectra
        late = 1 / (1 + 2j * np.pi * spectra.hertz * times_s[:, None]) - 1
        product, energy = spectra.explained(late)
        energy = np.maximum(energy, np.finfo(float).tiny)
        best = np.sort(np.argsort(-product**2 / energy)[:PROMISING])
        share = np.clip(product / energy, *self.parameters[0].ends)
        return [{"share": float(share[k]), "time_constant_s": float(times_s[k])} for k in best]

    def shown(self, drive: PlannedDrive) -> Shown | None:
        times_s = drive.times_s()
        times_s = times_s[(times_s >= drive.step_s) & (times_s <= SLOWEST_S)]
        changes = (drive.change(self, share=1.0, time_constant_s=time_s) for time_s in times_s)
        least = drive.least(changes, [drive.later(), drive.lagged(drive.step_s), drive.slow()])
        seen = {share: times_s[least <= share] for share in SHARES_SHOWN if np.any(least <= share)}
        if not seen:
            return Shown(f"a share of {100 * SHARES_SHOWN[-1]:g} % looks like delay, lag and creep; give a longer "
                         "--duration or allow a higher --slew")
        texts = [f"shares of {100 * share:g} %: time constants from {time_text(times[0])} to {time_text(times[-1])}"
                 for share, times in seen.items()]
        first = next(iter(seen.values()))
        return Shown("; ".join([*texts, "faster looks like lag, slower like creep"]), float(first[0]),
                     float(first[-1]), "s")
