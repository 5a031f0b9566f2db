"""The chain from command to displacement, and from reference to drive, as the model file describes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .. import firmware
from ..data import ENDS, Recording, arguments, check_sizes, taken
from ..errors import BadInput
from ..firmware import Firmware, Steps
from ..model import LARGEST, Memory, Model, operators
from . import effects, numpy_inverse
from .inverse import Inverse, inverse_of
from .memory import plays_of, reachable_um, rest_at, swept_ticks, within_drive
from .plant import Plant, State, unlimited
from .start import estimated

__all__ = ["Prediction", "Score", "follow", "operator_from", "reachable_um", "rest_at", "score", "simulate",
           "within_drive"]

Engine = Callable[[Model, np.ndarray], Steps]
MEMORIES = "auto", "model", "reset", *ENDS, "estimate"
MAX_REFERENCE_UM = operators.MAX_REFERENCE_UM
ALONE = ("memory is carried, but no recording comes before it; give the one that it follows ahead of it, or state another "
         "memory")
WORST = 1e9  # strokes of error: more is no prediction


@dataclass(frozen=True, eq=False)
class Prediction:
    """Displacement predicted for one run."""

    predicted_um: np.ndarray  # (samples,)
    start: State
    end: State
    operated_um: np.ndarray  # what the operator alone made of the drive that reached it, (samples,)
    driven_V: np.ndarray  # that drive, (samples,)
    rate_um_per_s: np.ndarray  # (samples,), before the guard
    memory: str  # where the start came from: "reset", "low", "high", "carried", "model" or "estimated"

    @property
    def start_um(self) -> np.ndarray:
        """Plays before the first sample, (n + 1,)."""
        return self.start.plays_um


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

    memory: "auto" follows each run's metadata, as Plant has the states: reset, low, high; carried: all that the run
    before ended with; unknown: estimated from how it begins where there is a displacement, or the model's memory.
    The others impose theirs on every run. The model's effects act, disturbances among them as this
    very run shows them.

    Raises BadInput for a carried run that has another sample time than the one before, or that is the first and has no
    displacement to estimate the start from.
    """
    arguments.one_of(memory, MEMORIES, "memory")
    runs = taken(runs, ["command_V"])
    effects.acting(model)  # what is wrong with them is told before anything else
    model.validate_lengths()
    plants: dict[float, Plant] = {}
    predictions: list[Prediction] = []
    for run in runs:
        check_sizes(run.columns, lambda row, path=run.path: f"{path}, sample {row}")
        plant = plants.setdefault(run.sample_time_s, Plant(model, run.sample_time_s))
        kind, start = _start(plant, run, memory, predictions[-1].end if predictions else None)
        try:
            ran = plant.run(run.command_V, start, run.columns)
        except BadInput as error:
            raise BadInput(f"{run.path}: {error}") from None
        driven = replace(run, columns={**run.columns, "command_V": ran.driven_V})
        shown = effects.disturbed(plant.acting, ran.displacement_um, driven, model)
        predictions.append(Prediction(shown, start, ran.state, ran.operated_um, ran.driven_V, ran.rate_um_per_s, kind))
    return predictions


def _start(plant: Plant, run: Recording, memory: str, before: State | None) -> tuple[str, State]:
    """Where the state of a run came from, and the state; `before` is that at the end of the run before it."""
    kind = {"auto": run.memory, "estimate": "unknown"}.get(memory, memory)
    measured = run.displacement_um is not None
    if measured and any(one.effect.starts_memory for one in plant.acting):
        kind = "unknown"
    first_V = float(run.command_V[0])
    if kind == "unknown" and run.past is not None:
        return "estimated", plant.after(first_V, plays_of(run.past, plant.operator), run.past)
    if kind == "carried" and before is not None:
        return kind, before
    if kind == "carried" and not measured:
        raise BadInput(f"{run.path}: {ALONE}")
    if kind == "reset":
        return kind, plant.swept(first_V)
    if kind in ENDS:
        rested_s = run.metadata.get("rested_s")
        return kind, plant.held(first_V, kind, None if rested_s is None else float(rested_s))
    if kind == "model" or not measured:
        return "model", plant.after(first_V, plant.model.memory.plays_um)
    return "estimated", estimated(plant, run).state


def follow(model: Model, run: Recording, column: str = "reference_um", engine: str | Engine = "f32",
           remove_offset: bool = False, sweep: bool = False, by: Inverse | None = None) -> tuple[Steps, float]:
    """The drive that makes the actuator follow a column of `run`, sample by sample as the firmware computes it.

    `by` says what of the model's effects is compensated; None: inverse_of(model). Where the firmware needs the
    reference ahead of time, the column's own future is that; its last value holds at the end.

    Before the first sample the plays are as the metadata `memory` says: reset, a decaying sweep ended at the first
    reference, SWEPT_S ago (memory.py); low or high, a rest at that end, where the run also has a command; else estimated if it
    also has command and displacement, or the model's own. With `sweep` they are, whatever the metadata say, as the start-up sweep leaves them, from the model's
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
    if run.command_V is None:
        return inverted.memory
    plant = Plant(inverted if by.alone else model, run.sample_time_s)  # shows every effect, whatever is compensated
    if run.memory in ENDS:
        states = plant.held(float(run.command_V[0]), run.memory).plays_um
    elif run.displacement_um is None:
        return inverted.memory
    else:
        states = estimated(plant, run).plays_um
    return within_drive(replace(inverted, memory=replace(inverted.memory, x_um=float(states[0]), plays_um=states)))


def operator_from(model: Model, run: Recording, states_um: np.ndarray) -> Firmware:
    """The compiled forward operator with these states, for this run."""
    largest_V = float(np.max(np.abs(run.command_V)))
    if largest_V > LARGEST:
        raise BadInput(f"{run.path}: the drive reaches {largest_V:.3g} V, beyond ±{LARGEST:g} V, the firmware's limit; "
                       "check the unit of command_V")
    return unlimited(model, run.sample_time_s, states_um)
