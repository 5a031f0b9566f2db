"""Where the memory of an inverse starts, what a sweep leaves of creep, and what can be reached."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .. import firmware
from ..data import ENDS, Past, Recording
from ..firmware import Chain, Firmware
from ..model import Memory, Model, operators


# [s] What a decaying sweep leaves of creep: it swings about a centre that leaves the middle of the range, where creep
# had settled, and is as good as at its end for so long. Chosen on seeds 5300 and 5301 of tests/rigs, whose sweeps take
# 0.5 to 1.7 s and rest for 0.2 to 0.5 s. The mean error of positions at the edge of the range is 0.91 % of the stroke,
# with twice the time 0.99 %; 1.33 % if creep is taken to have settled where the sweep ended. Where the actuator rested
# before is of little matter: had it been at the edge, 0.86 % against 1.46 %.
SWEPT_S = 0.5


def swept_ticks(sample_time_s: float) -> int:
    """Samples in SWEPT_S."""
    return max(1, round(SWEPT_S / sample_time_s))


def since_sweep_s(sample_time_s: float) -> float:
    """Time at the first sample since the sweep came to its end, in a move that took one sample."""
    return (swept_ticks(sample_time_s) + 0.5) * sample_time_s


def past_of(run: Recording, model: Model) -> Past:
    """What was before a recording, as it was estimated, or as it states: after a sweep, or where its drive rested at an
    end for a stated time, the actuator came from the middle of the range.
    """
    if run.past is not None:
        return run.past
    rested_s = run.metadata.get("rested_s")
    x_um = float(model.x_of(run.command_V[0]))
    if run.memory == "reset":
        return from_middle(model, x_um, since_sweep_s(run.sample_time_s))
    if run.memory in ENDS and rested_s is not None:
        return from_middle(model, x_um, max(float(rested_s), run.sample_time_s))
    return Past()


def from_middle(model: Model, x_um: float, since_s: float) -> Past:
    """A move from the middle of the range, where creep had settled, so long ago."""
    away_um = from_middle_um(model, x_um)
    return Past(np.array([away_um]), np.array([since_s]), away_um)


def plays_of(past: Past, model: Model) -> np.ndarray:
    """The memory of the plays that an estimate found, at the thresholds of this model, um, (n + 1,)."""
    plays_V = np.interp(model.thresholds_um / abs(model.gain_um_per_V), past.thresholds_V, past.plays_V)
    return model.gain_um_per_V * (plays_V - model.offset_V)


def entered_plays(model: Model, x_um: float, end: str) -> np.ndarray:
    """States of the plays, (n + 1,), where the drive came to its "low" or "high" end from far away."""
    above = (end == "low") == (model.gain_um_per_V > 0)
    return x_um + model.thresholds_um * (1 if above else -1)


def middle_um(model: Model) -> float:
    """Displacement after a sweep that ended in the middle of the drive's range: all plays are there."""
    return _shown_um(model, _middle_v_um(model))


def swept_um(model: Model, x_um: float) -> float:
    """Displacement after a sweep that ended at this control input, creep apart."""
    return _shown_um(model, _swept_v_um(model, x_um))


def from_middle_um(model: Model, x_um: float) -> float:
    """How far `middle_um` lies from `swept_um`; both at once take half the time."""
    both = np.array([_middle_v_um(model), _swept_v_um(model, x_um)])
    middle, swept = operators.saturation(both, model.deadzones_um, model.deadzone_weights)
    return float(middle - swept)


def _middle_v_um(model: Model) -> float:
    x_um = float(model.x_of(model.drive.min_V) + model.x_of(model.drive.max_V)) / 2
    return x_um * model.slopes[-1]


def _swept_v_um(model: Model, x_um: float) -> float:
    return -np.diff(model.swept(x_um), append=0.0) @ model.slopes


def _shown_um(model: Model, v_um: float) -> float:
    return model.offset_um + float(operators.saturation(v_um, model.deadzones_um, model.deadzone_weights))


def rest_at(model: Model, displacement_um: float, chain: Chain = Chain(), sample_time_s: float = 1e-3) -> Memory:
    """Memory that a decaying sweep ending at `displacement_um`, at rate 0, or at the nearest end of the range leaves.

    The states that sweeps leave are linear in x, and increase with it. So is v, their output. The poles of the chain
    have gone a part of the way from the middle of the range.
    """
    since_s = since_sweep_s(sample_time_s)
    gone = chain.direct - sum(share * math.expm1(-since_s / time_s) for share, time_s in chain.poles)
    settled_um = middle_um(model)
    displacement_um = settled_um + (displacement_um - settled_um) / gone
    v = operators.saturation_inverse(displacement_um - model.offset_um, model.deadzones_um, model.deadzone_weights)
    ends = sorted(float(model.x_of(volt)) for volt in (model.drive.min_V, model.drive.max_V))
    outputs = [float(_swept_v_um(model, x)) for x in ends]
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
    engine = Firmware(replace(model, memory=within_drive(model)), 1.0, "f64", any_sample_time=True)
    low, high = engine.forward(ends, np.zeros(4))[2:]
    return float(min(low, high)), float(max(low, high))


def states_after(position_um: float, x0_um: float, thresholds_um: np.ndarray) -> np.ndarray:
    """States of the plays that rested at `position_um` and moved straight to `x0_um`; shape (n + 1,)."""
    return np.clip(position_um, x0_um - thresholds_um, x0_um + thresholds_um)


def warm_up(x_um: np.ndarray, largest_threshold_um: float) -> int:
    """First sample at which no play can still remember what came before the run.

    A play of threshold r forgets once the input has spanned 2 r. One that never does keeps its state once the run has
    spanned all it ever spans; a constant, which an offset takes up.
    """
    spanned = np.maximum.accumulate(x_um) - np.minimum.accumulate(x_um)
    return int(np.argmax(spanned >= min(2 * largest_threshold_um, 0.999 * spanned[-1])))


def first_moved(x_um: np.ndarray, thresholds_um: np.ndarray, states_um: np.ndarray) -> np.ndarray:
    """The sample in which each play has first moved from its state, the number of samples if none, (n + 1,). Until there
    a play that started elsewhere adds another constant, as long as it would have been moved then as well.
    """
    outputs = firmware.plays(x_um, thresholds_um, states_um)[0]
    stays = outputs == states_um
    return np.where(np.all(stays, axis=0), len(x_um), np.argmin(stays, axis=0))
