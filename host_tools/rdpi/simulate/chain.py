"""The chain from command to displacement, and from reference to drive, as the model file describes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .. import firmware
from ..data import Recording, arguments, check_sizes, taken
from ..errors import BadInput
from ..firmware import Firmware, Steps
from ..model import LARGEST, Drive, Memory, Model, operators
from . import effects, numpy_inverse, signals
from .inverse import Inverse, inverse_of
from .memory import reachable_um, rest_at, swept_ticks, within_drive

__all__ = ["Prediction", "Score", "estimate_states", "follow", "operator_from", "reachable_um", "rest_at", "score",
           "simulate", "start_states", "states_after", "warm_up", "within_drive"]

Engine = Callable[[Model, np.ndarray], Steps]
MEMORIES = "auto", "model", "reset", "estimate"
MAX_REFERENCE_UM = operators.MAX_REFERENCE_UM
MAX_SWEEPS = 60
DEPTH, MIX = 6, 0.5  # sweeps remembered and damping of Anderson's mixing
# rms change that one more sweep would bring, as a share of the stroke: sought, and at most called settled
SOUGHT, SETTLED = 1e-5, 3e-4
MAX_SMOOTHINGS = 7
WORST = 1e9  # strokes of error: more is no prediction
PATIENCE = 5  # sweeps without a better one, after which the best is taken


@dataclass(frozen=True)
class Prediction:
    """Displacement predicted for one run."""

    predicted_um: np.ndarray  # (samples,)
    start_um: np.ndarray  # plays before the first sample, (n + 1,)
    states_um: np.ndarray  # plays at the end, (n + 1,)
    rate_um_per_s: np.ndarray  # (samples,), before the guard
    settled: bool  # whether the sweeps that find the rate of the prediction itself came to rest
    smoothing_s: float  # of that rate
    memory: str  # where the states at the start came from: "reset", "carried", "model" or "estimated"


class Score(NamedTuple):
    """Prediction error of one run; percentages are of the measured peak-to-peak stroke."""

    rms_um: float
    max_um: float
    rms_percent: float
    max_percent: float
    offset_um: float  # mean error, not removed from the other figures unless asked

    @property
    def mostly_offset(self) -> bool:
        """Whether a constant, where it was not removed, is more than half of what is missed."""
        return abs(self.offset_um) > self.rms_um / 2

    @property
    def beside_offset_um(self) -> float:
        """rms of what is missed besides a constant that was not removed."""
        return max(self.rms_um**2 - self.offset_um**2, 0.0) ** 0.5


def score(predicted_um: np.ndarray, measured_um: np.ndarray, remove_offset: bool = False, where: str = "run") -> Score:
    """Error of a prediction, both (samples,). Raises BadInput, naming `where`, if it cannot be given in percent."""
    predicted_um = arguments.series(predicted_um, f"{where}: predicted_um", finite=False)
    measured_um = arguments.series(measured_um, f"{where}: measured_um", finite=False)
    if len(predicted_um) != len(measured_um) or not len(measured_um):
        raise BadInput(f"{where}: {len(predicted_um)} values predicted, {len(measured_um)} measured")
    error = measured_um - predicted_um
    offset = float(np.mean(error))
    if remove_offset:
        error = error - offset
    rms, peak, stroke = float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error))), float(np.ptp(measured_um))
    if not stroke > 0 or not rms <= WORST * stroke:  # NaN neither
        raise BadInput(f"{where}: the measured range is {stroke:g} and the rms error {rms:g}: "
                       "the error cannot be given in percent; check the data")
    scale = 100 / stroke
    return Score(rms, peak, rms * scale, peak * scale, offset)


def simulate(model: Model, runs: Sequence[Recording], memory: str = "auto") -> list[Prediction]:
    """Predict the displacement of each run from its command, in order.

    memory: "auto" follows each run's metadata (reset: a decaying sweep ended at the first sample, before which creep had
    settled in the middle of the drive's range; carried: where the run before ended; unknown: one number, a previous
    position, estimated from the samples that still depend on it, or the model's memory without displacement); "model",
    "reset" and "estimate" impose theirs on every run. The model's effects act, disturbances among them as this very run
    shows them.
    """
    arguments.one_of(memory, MEMORIES, "memory")
    runs, acting = taken(runs, ["command_V"]), effects.acting(model)
    model.validate_lengths()
    plain = effects.operator(acting, replace(model, effects=[]))
    unknown = any(one.effect.starts_memory for one in acting)
    predictions: list[Prediction] = []
    for run in runs:
        check_sizes(run.columns, lambda row, path=run.path: f"{path}, sample {row}")
        run = effects.driven_run(acting, run, model)
        if memory != "auto":
            run = replace(run, metadata={**run.metadata, "memory": "reset" if memory == "reset" else "unknown"})
        kind = run.memory if memory == "auto" else memory
        if unknown and run.displacement_um is not None:
            kind = "unknown"
        x0 = float(model.x_of(run.command_V[0]))
        if kind == "carried" and predictions:
            states = predictions[-1].states_um
        elif kind == "reset":
            states = model.swept(x0)
        elif kind == "model" or run.displacement_um is None:
            kind, states = "model", model.memory.plays_um
        else:
            kind, states = "estimated", estimate_states(plain, run, acting)
        found = _predict(plain, run, states, kind)
        shown = effects.disturbed(acting, effects.displaced(acting, found.predicted_um, run, plain), run, model)
        predictions.append(replace(found, predicted_um=shown))
    return predictions


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


def estimate_states(model: Model, run: Recording, acting: Sequence[effects.Acting] = ()) -> np.ndarray:
    """States at the first sample of a run with unknown memory, from how it begins; shape (n + 1,)."""
    return start_states(model, run, acting)[0]


def start_states(model: Model, run: Recording, acting: Sequence[effects.Acting] = (),
                 rate_um_per_s: np.ndarray | None = None) -> tuple[np.ndarray, float, float]:
    """Best states at the first sample, and the rms error in um of the samples that depend on them: with plays as a
    sweep leaves them, with the best. The displacement is what effects that act show of the operator's.

    One number is sought, the position from which the input came straight to where the run begins. The rate, (samples,),
    is the model's own where none is given.
    """
    x = model.x_of(run.command_V)
    r = model.thresholds_um
    samples = warm_up(x, r[-1])
    rest = states_after(x[0], x[0], r)
    if samples < 2 or len(r) == 1:
        return rest, 0.0, 0.0
    used = slice(0, 3 * samples)
    beginning = replace(run, columns={name: values[used] for name, values in run.columns.items()})
    rate = (_predict(model, beginning, rest, "estimated").rate_um_per_s if rate_um_per_s is None else
            rate_um_per_s[used])
    measured = run.displacement_um[used]
    engine = operator_from(model, run, rest)  # making one takes longer than running it

    def miss_um(states_um: np.ndarray) -> float:
        engine.memory_um = states_um
        z = engine.forward(beginning.command_V, rate)
        error = measured - effects.displaced(acting, z, beginning, model)
        error -= np.mean(error[samples:])  # drift since the fit, and plays that never move, are not to pass for memory
        return float(np.sqrt(np.mean(error[:samples] ** 2)))

    positions = x[0] + np.linspace(-r[-1], r[-1], 41)
    starts = [states_after(position, x[0], r) for position in positions]
    misses = [miss_um(states) for states in starts]
    best = int(np.argmin(misses))
    return starts[best], miss_um(model.swept(float(x[0]))), misses[best]


def follow(model: Model, run: Recording, column: str = "reference_um", engine: str | Engine = "f32",
           remove_offset: bool = False, sweep: bool = False, by: Inverse | None = None) -> tuple[Steps, float]:
    """The drive that makes the actuator follow a column of `run`, sample by sample as the firmware computes it.

    `by` says what of the model's effects is compensated; None: inverse_of(model). Where the firmware needs the
    reference ahead of time, the column's own future is that; its last value holds at the end.

    Before the first sample the plays are as the metadata `memory` says: reset, a decaying sweep ended at the first
    reference, SWEPT_S ago (memory.py); unknown, estimated if the run also has command and displacement, else the
    model's own. With `sweep` they are, whatever the metadata say, as the start-up sweep leaves them, from the model's
    own. Engines "f32" and "q31" are
    the firmware library, "f64" the first in double, "numpy" the independent reference, which has no sweep; a function
    makes the steps of operator and reference, and the sweep before them and the chain are its own affair. Returns the
    steps and the offset in um that was removed from the reference: with `remove_offset` the mean error of the model's
    prediction of this run.
    """
    arguments.of_kind(model, Model, "model")
    if not callable(engine):
        arguments.one_of(engine, (*firmware.ENGINES, "numpy"), "engine")
    (run,) = taken([run], [column], "run")
    others = {name: values for name, values in run.columns.items() if name != column}  # the reference is judged below
    check_sizes(others, lambda row: f"{run.path}, sample {row}")
    by = inverse_of(model) if by is None else by
    reference = by.wanted_um(run, run.columns[column])
    usable = reference[np.abs(reference) <= MAX_REFERENCE_UM]
    if not len(usable):
        raise BadInput(f"{run.path}: {column} has no value within ±{MAX_REFERENCE_UM:g} um, the largest reference; "
                       "check its unit")
    offset = _offset_um(model, run) if remove_offset else 0.0
    if sweep:
        if engine == "numpy":
            raise BadInput("the engine numpy has no start-up sweep; use f64, f32 or q31")
        inverted = by.model
    else:
        inverted = replace(by.model, memory=_memory_before(model, by, run, float(usable[0] - offset)))
    if callable(engine):
        return engine(inverted, reference - offset), offset
    asked = reference - offset
    swept = swept_ticks(run.sample_time_s) if run.memory == "reset" and not sweep else None
    if engine == "numpy":
        asked = firmware.ahead(asked, by.chain.preview_samples(run.sample_time_s))
        return numpy_inverse.step(inverted, by.chain, asked, run.sample_time_s, swept)[0], offset
    if engine == "f32":
        by.check_sweep(run)
    library = firmware.engine(inverted, run.sample_time_s, engine, by.chain if by.chain.acts else None,
                              any_sample_time=True)
    if sweep:
        library.sweep()
    elif swept is not None:
        library.swept(swept)
    return library.step(firmware.ahead(asked, library.preview_samples)), offset


def _offset_um(model: Model, run: Recording) -> float:
    """Mean error of the model's prediction of a recording."""
    if run.command_V is None or run.displacement_um is None:
        raise BadInput(f"{run.path}: an offset can only be removed from a recording "
                       "(command_V and displacement_um)")
    return score(simulate(model, [run])[0].predicted_um, run.displacement_um, where=run.path).offset_um


def _memory_before(model: Model, by: Inverse, run: Recording, first_um: float) -> Memory:
    """Memory of the operator to invert before the first reference of `run`; see follow."""
    inverted = by.model
    if run.memory == "reset":
        return rest_at(inverted, first_um, by.chain, run.sample_time_s)
    if run.command_V is None or run.displacement_um is None:
        return inverted.memory
    # the recording shows every effect, whatever is compensated
    acting = effects.acting(inverted if by.alone else model)
    plain = effects.operator(acting, replace(inverted if by.alone else model, effects=[]))
    states = estimate_states(plain, effects.driven_run(acting, run, model), acting)
    return within_drive(replace(inverted, memory=replace(inverted.memory, x_um=float(states[0]), plays_um=states)))


def operator_from(model: Model, run: Recording, states_um: np.ndarray) -> Firmware:
    """The compiled forward operator with these states, for this run.

    The model's drive range is what the inverse may output. An actuator goes wherever it is driven, and an effect ahead
    of it may drive it beyond the range: the operator takes every drive that the firmware has numbers for.
    """
    largest_V = float(np.max(np.abs(run.command_V)))
    if largest_V > LARGEST:
        raise BadInput(f"{run.path}: the drive reaches {largest_V:.3g} V, beyond ±{LARGEST:g} V, the firmware's limit; "
                       "check the unit of command_V")
    # The control input at the ends must be a number that the firmware takes, too.
    reach_V = 0.999 * LARGEST / abs(model.gain_um_per_V)
    low_V = min(float(np.min(run.command_V)), max(-LARGEST, model.offset_V - reach_V))
    high_V = max(float(np.max(run.command_V)), min(LARGEST, model.offset_V + reach_V))
    unlimited = replace(model, drive=Drive(low_V, high_V),
                        memory=Memory(float(states_um[0]), np.asarray(states_um, float)))
    return Firmware(unlimited, run.sample_time_s, "f64", any_sample_time=True)


def _predict(model: Model, run: Recording, states_um: np.ndarray, memory: str) -> Prediction:
    command_V, sample_time_s, rate = run.command_V, run.sample_time_s, model.rate

    def rate_of(signal_um: np.ndarray, smoothing_s: float) -> np.ndarray:
        return signals.rate(signal_um, sample_time_s, rate.window_s, rate.filter_s, smoothing_s)

    def forward(rate_um_per_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        engine = operator_from(model, run, states_um)
        return engine.forward(command_V, rate_um_per_s), engine.memory_um

    rho = rate_of(model.x_of(command_V), 0.0)
    predicted, end = forward(rho)
    first = Prediction(predicted, states_um, end, rho, True, 0.0, memory)
    if rate.source == "control" or not np.any(model.slope_rate_s_per_um):
        return first
    # The rate is that of the displacement, which depends on the rate. A strong law amplifies what is fast: where the
    # fixed point is not found, or does not exist, the rate is smoothed more and more until it is.
    smoothing_s = rate.smoothing_s
    for _ in range(MAX_SMOOTHINGS):
        found = _fixed_point(first, forward, lambda signal_um: rate_of(signal_um, smoothing_s), model.stroke_um)
        found = replace(found, smoothing_s=smoothing_s)
        if found.settled:
            break
        smoothing_s = max(2 * smoothing_s, 8 * sample_time_s)
    return found


def _fixed_point(first: Prediction, forward: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
                 rate_of: Callable[[np.ndarray], np.ndarray], stroke_um: float) -> Prediction:
    """Sweeps from prediction to rate to prediction; Anderson's mixing, because plain sweeps overshoot at reversals."""
    predicted, end, rho = first.predicted_um, first.states_um, first.rate_um_per_s
    points: list[np.ndarray] = []
    misses: list[np.ndarray] = []
    best, best_change, waited = first, np.inf, 0
    for _ in range(MAX_SWEEPS):
        swept = rate_of(predicted)
        change = float(np.sqrt(np.mean((forward(swept)[0] - predicted) ** 2))) / stroke_um
        waited += 1
        if change < best_change:
            best = replace(first, predicted_um=predicted, states_um=end, rate_um_per_s=rho, settled=change < SETTLED)
            best_change, waited = change, 0
        if best_change < SOUGHT or waited == PATIENCE:
            break
        miss = swept - rho
        points, misses = [*points[-DEPTH:], rho], [*misses[-DEPTH:], miss]
        rho = rho + MIX * miss
        if len(points) > 1:
            moves, changes = np.diff(points, axis=0), np.diff(misses, axis=0)
            rho = rho - np.linalg.lstsq(changes.T, miss, rcond=None)[0] @ (moves + MIX * changes)
        rho = np.maximum(rho, 0)
        predicted, end = forward(rho)
    return best
