"""The numerics gate: what the firmware's arithmetic alone makes of the drive, settled before any data are judged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import firmware
from ..data import Recording
from ..errors import BadInput
from ..model import Model
from ..simulate import chain, signals
from .sections import Numerics

ENGINES = "f32", "q31"
SAMPLES = 20_000


def compare(model: Model, runs: Sequence[Recording]) -> Numerics | None:
    """How far the compiled inverse's drive in f32 and q31 departs from double, in um rms, at the recorded rate and at
    four times it; None for an engine that refuses the model. The reference is the model's own stroke as recorded.
    """
    run = max(runs, key=lambda one: float(np.ptp(one.displacement_um)))
    reference = signals.smoothed(run.displacement_um, run.sample_time_s, 9 * run.sample_time_s)[:SAMPLES]
    reference = reference - np.mean(reference) + np.mean(chain.reachable_um(model))
    fine = np.interp(np.arange(4 * len(reference) - 3) / 4, np.arange(len(reference)), reference)
    found = [_departures(model, wanted, sample_time_s)
             for wanted, sample_time_s in ((reference, run.sample_time_s), (fine, run.sample_time_s / 4))]
    if None in found:
        return None
    return Numerics(engine="f32 and q31 against double", rms_um=found[0], rms_um_4x=found[1])


def _departures(model: Model, wanted_um: np.ndarray, sample_time_s: float) -> dict[str, float | None] | None:
    """rms in um by engine; None: double refuses the model as well."""
    try:
        exact = firmware.engine(model, sample_time_s, "f64", any_sample_time=True).step(wanted_um).drive_V
    except BadInput:
        return None
    found: dict[str, float | None] = {}
    for name in ENGINES:
        try:
            drive_V = firmware.engine(model, sample_time_s, name, any_sample_time=True).step(wanted_um).drive_V
            found[name] = float(abs(model.gain_um_per_V) * np.sqrt(np.mean((drive_V - exact) ** 2)))
        except BadInput:
            found[name] = None
    return found
