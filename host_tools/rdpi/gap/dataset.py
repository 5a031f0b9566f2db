"""Recordings beside their model: each one predicted again and again, and all of them as one long vector.

All samples of all recordings stand in one long vector, each recording without its mean; where there is a monitor, what
it shows follows the displacement, in um.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from .. import firmware
from ..data import Recording
from ..model import Model
from ..simulate import chain, effects, operating
from ..simulate.effects import Acting, Residuals

BLOCKS = 8  # of each recording
REMEMBERED = 2  # responses of the operator that a model run keeps


@dataclass(frozen=True, eq=False)
class ModelRun:
    """One recording beside its model, predicted with whatever effects are asked for.

    With a monitor the actuator is driven by it, and what lies before it is judged by the monitor itself.
    """

    recording: Recording
    model: Model  # without effects
    start_um: np.ndarray  # the plays before the first sample, (n + 1,)
    start_known: bool  # not estimated
    swept: bool  # it is where a sweep left the plays
    rate_um_per_s: np.ndarray  # of the model's own prediction, (samples,)
    monitored: bool
    _last: dict = field(default_factory=dict, init=False, repr=False)  # responses of the operator
    _displaced: effects.Displaced = field(default_factory=effects.Displaced, init=False, repr=False)

    @property
    def input_V(self) -> np.ndarray:
        return self.recording.columns["monitor_V" if self.monitored else "command_V"]

    @property
    def um_per_V(self) -> float:
        """Near enough to weigh both sides of a monitor alike."""
        return self.model.gain_um_per_V * float(self.model.slopes[-1])

    def starting(self, start_um: np.ndarray) -> ModelRun:
        """The same with plays that start here."""
        return replace(self, start_um=start_um, swept=self.swept and np.array_equal(start_um, self.start_um))

    def predict(self, acting: Sequence[Acting], start_um: np.ndarray | None = None) -> np.ndarray:
        """Displacement in um (samples,) with these effects, disturbances apart."""
        shown = [one for one in acting if not (self.monitored and one.effect.before_monitor)]
        if start_um is not None:
            driven, z = self._operate(shown, start_um)
            return effects.displaced(shown, z, driven, self.model)
        driven, z = self._remembered(shown)
        return self._displaced(shown, z, driven, self.model)

    def _remembered(self, shown: Sequence[Acting]) -> tuple[Recording, np.ndarray]:
        """_operate, which takes longest, only where an effect ahead of the displacement differs from the last two."""
        key = tuple(one.key for one in shown if one.effect.ahead)
        if key not in self._last:
            while len(self._last) >= REMEMBERED:
                del self._last[next(iter(self._last))]
            self._last[key] = self._operate(shown, None)
        return self._last[key]

    def mean_residual_um(self, acting: Sequence[Acting]) -> float:
        """Mean of what the displacement misses, in um."""
        return float(np.mean(self.recording.displacement_um - self.predict(acting)))

    def predict_monitor(self, acting: Sequence[Acting]) -> np.ndarray:
        """What monitor_V shows with these effects, in um."""
        shown = [one for one in acting if one.effect.before_monitor]
        return self.um_per_V * effects.driven(shown, self.recording.command_V, self.recording, self.model)

    def _operate(self, shown: Sequence[Acting], start_um: np.ndarray | None) -> tuple[Recording, np.ndarray]:
        """The recording as it was driven, and what the operator makes of that."""
        run, drive_V = self.recording, effects.driven(shown, self.input_V, self.recording, self.model)
        model = effects.operator(shown, self.model)
        driven = replace(run, columns={**run.columns, "command_V": drive_V})
        if start_um is None:
            start_um = self.start_um
            if self.swept and drive_V[0] != self.input_V[0]:
                start_um = model.swept(float(model.x_of(drive_V[0])))  # the sweep ended where it was driven to
        bank = self._bank if model is self.model else _operating(model, run.sample_time_s)
        bank.start(float(drive_V[0]), start_um)
        return driven, bank.run(drive_V)[0]

    @cached_property
    def _bank(self) -> firmware.Bank:
        """The model's own operator; making one takes longer than running it."""
        return _operating(self.model, self.recording.sample_time_s)

    @cached_property
    def model_jacobian(self) -> np.ndarray:
        """Slopes of the prediction in the model's own parameters: W_i, with a rate law c_i times the highest rate, and
        the dead zones' weights; (samples, parameters), in single precision.
        """
        model = self.model
        outputs, _ = firmware.plays(model.x_of(self.input_V), model.thresholds_um, self.start_um)
        outputs[:, :-1] -= outputs[:, 1:]
        rate = np.minimum(self.rate_um_per_s, model.rate.max_um_per_s)
        v = np.einsum("ki,ki->k", outputs, model.slopes_at(rate))
        slope = np.cumsum(model.deadzone_weights)[np.searchsorted(model.deadzones_um[1:], v)]
        columns = slope[:, None] * outputs * model.slopes
        parts = [columns]
        if np.any(model.slope_rate_s_per_um):
            parts.append(columns * (rate / (model.rate.identified_um_per_s or model.rate.max_um_per_s))[:, None])
        parts.append(np.maximum(v[:, None] - model.deadzones_um[1:], 0))
        return np.hstack(parts, dtype=np.float32)


def _operating(model: Model, sample_time_s: float) -> firmware.Bank:
    return firmware.Bank([operating(model, sample_time_s)])


def model_runs(model: Model, runs: Sequence[Recording], monitored: bool, paired: bool = False) -> list[ModelRun]:
    """Each recording beside the model, its memory as `rdpi simulate` takes it.

    Where inner loops drift, as the passport tells, plays do not say where a recording after a sweep starts. What they
    miss is taken off where recordings are `paired`; else the start is estimated, lest it be named as a change.
    """
    drifts = bool((model.passport or {}).get("drifts")) and not paired
    known = [run.memory != "unknown" and not (drifts and run.memory == "reset" and "displacement_um" in run.columns)
             for run in runs]
    inputs = [replace(run, columns={**run.columns, "command_V": run.columns["monitor_V"]}) if monitored else run
              for run in runs]
    inputs = [run if sure else replace(run, metadata={**run.metadata, "memory": "unknown"})
              for run, sure in zip(inputs, known)]
    kept = effects.entries(one for one in effects.acting(model) if not (monitored and one.effect.before_monitor))
    plain, known_model = replace(model, effects=[]), replace(model, effects=kept)
    return [ModelRun(run, plain, found.start_um, sure, sure and run.memory == "reset", found.rate_um_per_s, monitored)
            for run, sure, found in zip(runs, known, chain.simulate(known_model, inputs))]


class Dataset:
    """All recordings of one diagnosis beside a model, as one long vector, and the block of each sample. It does not
    change: other starts of the memory make another one.
    """

    def __init__(self, model: Model, runs: Sequence[Recording], earlier: Sequence[Recording] = (),
                 monitored: bool = True, paired: bool = False) -> None:
        """With `monitored` the actuator is driven by monitor_V, where every recording has it.

        With `earlier` recordings, one of each run's drive and length, what the model misses of them is taken off what
        is measured: what is left is new. Effects of the model that are marked "new" had not acted then, or otherwise.
        """
        self.monitored = monitored and all("monitor_V" in run.columns for run in (*runs, *earlier))
        self.model, self.recordings = model, list(runs)
        self.paired = paired or bool(earlier)
        self.model_runs = model_runs(model, runs, self.monitored, self.paired)
        self.lengths = [len(run) for run in runs]
        self.measured = self.join([run.displacement_um for run in runs],
                                  [one.um_per_V * one.recording.columns["monitor_V"] for one in self.model_runs]
                                  if self.monitored else None)
        sides = 1 + self.monitored
        self.block = np.concatenate([np.arange(length) * BLOCKS // length + BLOCKS * (sides * k + side)
                                     for k, length in enumerate(self.lengths) for side in range(sides)])
        self.run_of_block = np.repeat(np.arange(len(runs)), BLOCKS * sides)
        self.of_monitor = np.tile(np.repeat(np.arange(sides), BLOCKS), len(runs)).astype(bool)
        self.earlier: Dataset | None = None
        self.missed_then, self.acting_then = np.zeros(0), []
        if earlier:
            before = effects.then(model)
            self.earlier = Dataset(before, earlier, monitored=self.monitored, paired=True)
            self.acting_then = effects.acting(before)
            self.missed_then = self.earlier.measured - self.earlier.predict(self.acting_then)
            self.measured -= self.missed_then

    def join(self, shown: Sequence[np.ndarray], amplified: Sequence[np.ndarray] | None = None) -> np.ndarray:
        """One long vector, or matrix, of what each recording's displacement and monitor show; the latter 0 if None."""
        parts = []
        for k, part in enumerate(shown):
            parts.append(part - np.mean(part, axis=0))
            if self.monitored:
                parts.append(np.zeros_like(part) if amplified is None else amplified[k] - np.mean(amplified[k], axis=0))
        return np.concatenate(parts)

    def split(self, vector: np.ndarray, monitor: bool = False) -> list[np.ndarray]:
        """The displacement's part of a long vector, or the monitor's, per recording."""
        starts = np.cumsum([0, *self.lengths]) * (1 + self.monitored)
        return [vector[start:start + length]
                for start, length in zip(starts[:-1] + monitor * np.array(self.lengths), self.lengths)]

    def model_jacobian(self) -> np.ndarray:
        """Slopes of the prediction in the model's own parameters, as ModelRun.model_jacobian, less those of what it
        missed earlier: (samples, parameters).
        """
        own = self.join([one.model_jacobian for one in self.model_runs])
        return own - self.earlier.model_jacobian() if self.earlier else own

    def predict(self, acting: Sequence[Acting]) -> np.ndarray:
        """The prediction with these effects, disturbances apart."""
        return self.join([one.predict(acting) for one in self.model_runs],
                         [one.predict_monitor(acting) for one in self.model_runs] if self.monitored else None)

    def copied(self) -> Dataset:
        """For another thread: recordings remember what was asked of them last."""
        return self.starting([one.start_um for one in self.model_runs])

    def starting(self, start_um: Sequence[np.ndarray]) -> Dataset:
        """The same with plays that start there, per recording."""
        result = copy.copy(self)
        result.model_runs = [one.starting(start) for one, start in zip(self.model_runs, start_um)]
        return result

    def restarted(self, acting: Sequence[Acting]) -> Dataset:
        """The same with the starts that are not known estimated anew, beside these effects."""
        unknown = [one.recording for one in self.model_runs if not one.start_known]
        if not unknown:
            return self
        beside = replace(self.model, effects=effects.entries(acting))
        found = iter(model_runs(beside, unknown, self.monitored, self.paired))
        result = copy.copy(self)
        result.model_runs = [one if one.start_known else one.starting(next(found).start_um)
                             for one in self.model_runs]
        return result

    def residuals(self, predicted: np.ndarray) -> Residuals:
        """What effects look at, beside a long vector that was predicted."""
        left = self.measured - predicted
        return Residuals(self.model, self.recordings, self.split(predicted), self.split(left),
                         self.split(left, self.monitored))
