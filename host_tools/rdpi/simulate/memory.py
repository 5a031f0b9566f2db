"""Where the memory of an inverse starts, and what it can reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import firmware
from ..firmware import Firmware
from ..model import Memory, Model, operators


def rest_at(model: Model, displacement_um: float) -> Memory:
    """Memory that a decaying sweep ending at `displacement_um`, at rate 0, or at the nearest end of the range leaves.

    The states that sweeps leave are linear in x, and increase with it. So is v, their output.
    """
    v = operators.saturation_inverse(displacement_um - model.offset_um, model.deadzones_um, model.deadzone_weights)
    ends = sorted(float(model.x_of(volt)) for volt in (model.drive.min_V, model.drive.max_V))
    outputs = [float(-np.diff(model.swept(x), append=0.0) @ model.slopes) for x in ends]
    x = float(np.interp(v, outputs, ends))
    return replace(model.memory, x_um=x, plays_um=model.swept(x))


def within_drive(model: Model) -> Memory:
    """The model's memory, its plays moved to the nearest drive that may be output."""
    low, high = sorted((model.x_of(model.drive.min_V), model.x_of(model.drive.max_V)))
    states = model.memory.plays_um
    nearest = np.clip(states[:1], low, high)
    states = firmware.plays(nearest, model.thresholds_um, states)[1]
    return replace(model.memory, x_um=float(states[0]), plays_um=states)


def reachable_um(model: Model) -> tuple[float, float]:
    """Lowest and highest displacement within the drive's range, at rest, after moving over all of it."""
    ends = np.tile([model.drive.min_V, model.drive.max_V], 2)
    engine = Firmware(replace(model, memory=within_drive(model)), 1.0, "f64")
    low, high = engine.forward(ends, np.zeros(4))[2:]
    return float(min(low, high)), float(max(low, high))
