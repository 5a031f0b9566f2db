"""Rate dependence: loops that change with the rate otherwise than the model says, or at all."""

from __future__ import annotations

import numpy as np

from ... import firmware
from ...firmware import Block
from ...model import Model, loop_ends_um, operators
from .base import Effect, Parameter, Residuals, Values
from .treatment import Treatment, left_out

RATES = 3.0  # the fastest and the slowest recorded motion must differ by this
STARTS = [(widening, exponent) for widening in (-0.1, 0.1) for exponent in (1.0, 0.5)]


class RateDependence(Effect):
    """z + (rate / top)^exponent (widening h + change (z - middle)), top being the highest identified rate.

    h is the hysteresis itself: what z departs from the straight line between the ends of the greatest loop. At the rate
    top the loops are wider by `widening` and the stroke larger by `change`; slopes that change in proportion to the
    rate (eq. 14 of Ang et al. 2003) are nearly that with exponent 1.
    """

    name = "rate_dependence"
    title = "rate dependence of the hysteresis"
    what = "the loops widen and the slopes fall with increasing rate, but not as in the model"
    remedy = "identify the model again with recordings at several rates (without --rate-independent)"
    needs = "two or more rates at two amplitudes"
    stages = ("actuator",)
    parameters = (Parameter("widening", "1", -1.0, 10.0), Parameter("change", "1", -0.9, 2.0),
                  Parameter("exponent", "1", 0.2, 1.5, 1.0))
    changes_loops = True
    grows_with_rate = True

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        if values["widening"] == 0 and values["change"] == 0:
            return None
        law = model.rate
        top = law.identified_um_per_s or law.max_um_per_s
        (low_V, low_um), (high_V, high_um) = _ends(model)
        slope = (high_um - low_um) / (high_V - low_V)
        return Block(firmware.WIDEN, (top, values["exponent"], values["widening"], values["change"],
                                      low_um - slope * low_V, slope, (low_um + high_um) / 2),
                     rate=(law.window_s, law.filter_s, sample_time_s))

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        # Slopes that change with the rate do so about the control input 0, the effect about the middle of the range.
        return left_out("folded into the slopes' rates, it would move the zero with the rate; identify the model again "
                        "with recordings at several rates")

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        speeds = np.concatenate([np.abs(np.diff(predicted)) / run.sample_time_s
                                 for run, predicted in zip(residuals.runs, residuals.predicted_um)])
        slow, fast = np.percentile(speeds[speeds > 0], (20, 99)) if np.any(speeds > 0) else (0.0, 0.0)
        return [{"widening": widening, "change": 0.0, "exponent": exponent}
                for widening, exponent in STARTS] if fast > RATES * slow else []


def _ends(model: Model) -> tuple[tuple[float, float], tuple[float, float]]:
    """Drive in V and displacement in um at both ends of the greatest loop, lower drive first."""
    v = np.array(loop_ends_um(model))[::1 if model.gain_um_per_V > 0 else -1]
    z = operators.saturation(v, model.deadzones_um, model.deadzone_weights) + model.offset_um
    return (model.drive.min_V, float(z[0])), (model.drive.max_V, float(z[1]))
