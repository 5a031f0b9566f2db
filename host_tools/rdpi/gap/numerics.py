"""The numerics gate: what the firmware's arithmetic alone makes of the drive, settled before any data are judged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import firmware
from ..data import Recording
from ..errors import BadInput
from ..model import Model
from ..simulate import chain, signals

ENGINES = "f32", "q31"
SAMPLES = 20_000


def compare(model: Model, runs: Sequence[Recording]) -> dict[str, Any] | None:
    """How far the compiled inverse's drive in f32 and q31 departs from double, in um rms, at the recorded rate and at
    four times it; None for an engine that refuses the model. The reference is the model's own stroke as recorded.
    """
    run = max(runs, key=lambda one: float(np.ptp(one.displacement_um)))
    reference = signals.smoothed(run.displacement_um, run.sample_time_s, 9 * run.sample_time_s)[:SAMPLES]
    reference = reference - np.mean(reference) + np.mean(chain.reachable_um(model))
    fine = np.interp(np.arange(4 * len(reference) - 3) / 4, np.arange(len(reference)), reference)
    found: dict[str, Any] = {"engine": "f32 and q31 against double"}
    for key, wanted, sample_time_s in (("rms_um", reference, run.sample_time_s),
                                       ("rms_um_4x", fine, run.sample_time_s / 4)):
        try:
            exact = firmware.engine(model, sample_time_s, "f64").step(wanted).drive_V
        except BadInput:
            return None
        found[key] = {}
        for name in ENGINES:
            try:
                drive_V = firmware.engine(model, sample_time_s, name).step(wanted).drive_V
            except BadInput:
                found[key][name] = None
                continue
            found[key][name] = float(abs(model.gain_um_per_V) * np.sqrt(np.mean((drive_V - exact) ** 2)))
    return found
