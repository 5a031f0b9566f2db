"""The augmented model: a model with effects beside it, and what they leave of the recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..data import Recording
from ..model import Model
from ..simulate import effects, signals
from ..simulate.effects import Acting, Effect
from . import candidates, thresholds
from .candidates import Candidate
from .dataset import Dataset


@dataclass(frozen=True, eq=False)
class AugmentedModel:
    """A model, the effects that it had, those that were accepted beside it, and the recordings. It does not change:
    accepting an effect makes another one.
    """

    dataset: Dataset  # driven by monitor_V where there is one
    by_command_before: Dataset  # the same driven by command_V, starts as without accepted effects
    known: tuple[Acting, ...]  # what the model had
    chosen: tuple[Candidate, ...] = ()  # what was accepted, in this order

    @classmethod
    def given(cls, model: Model, runs: Sequence[Recording], earlier: Sequence[Recording]) -> AugmentedModel:
        """A model as its file says; `earlier` holds a recording of the same drive for each run, or nothing."""
        return cls(*_datasets(model, runs, earlier), tuple(effects.acting(model)))

    @property
    def model(self) -> Model:
        return self.dataset.model

    @property
    def recordings(self) -> list[Recording]:
        return self.dataset.recordings

    @property
    def earlier(self) -> list[Recording]:
        """Recordings of the same drives, one for each, or none."""
        return self.dataset.earlier.recordings if self.dataset.earlier else []

    @property
    def foreign(self) -> frozenset[str]:
        """Effects that the model does not hold and that do not come up."""
        held = {one.effect.name for one in self.known}
        return frozenset(name for name, kind in effects.CATALOGUE.items() if not kind.comes_up and name not in held)

    def acting(self) -> list[Acting]:
        """All effects that act, disturbances that were accepted apart; one that has changed as it is now."""
        return effects.beside(self.known, *(one.acting for one in self.chosen if not one.per_run))

    def places(self, kind: type[Effect]) -> list[Effect]:
        """An effect everywhere that the recordings may show it: where the model holds it, to be asked whether it has
        changed, and where they can tell it from that.
        """
        held = [one.effect for one in self.known if type(one.effect) is kind and not kind.several]

        def apart(new: Effect, old: Effect) -> bool:
            sides_told = self.dataset.monitored and new.before_monitor != old.before_monitor
            return not new.replaces(old) and (new.column != old.column or new.shows_stage or sides_told)

        return [*held, *(new for new in kind.variants(self.recordings) if all(apart(new, old) for old in held))]

    # --- prediction

    @cached_property
    def residual(self) -> np.ndarray:
        """Measured - predicted with all that act, long vector."""
        return self.dataset.measured - self._predict(self.dataset)

    @cached_property
    def by_command(self) -> Dataset:
        """The recordings driven by the command, whether there is a monitor or not."""
        if not self.dataset.monitored:
            return self.dataset
        return self.started(self.by_command_before.restarted(self.acting()) if self.chosen else self.by_command_before)

    @cached_property
    def predicted_by_command(self) -> np.ndarray:
        """Of `by_command`, disturbances apart, long vector."""
        return self.by_command.predict(self.acting())

    @cached_property
    def residual_um(self) -> list[np.ndarray]:
        """What the displacement, driven by the command, misses with all that act; per recording, without its mean."""
        left = self.by_command.measured - self._with_disturbances(self.predicted_by_command, self.by_command)
        return self.by_command.split(left)

    def residual_in(self, dataset: Dataset) -> list[np.ndarray]:
        """The same of the displacement in another dataset of the same recordings."""
        dataset = self.started(dataset)
        return dataset.split(dataset.measured - self._predict(dataset))

    def started(self, dataset: Dataset) -> Dataset:
        """With the plays where accepted effects start them."""
        for one in self.chosen:
            dataset = dataset if one.memory_um is None else dataset.starting(one.memory_um)
        return dataset

    def _predict(self, dataset: Dataset) -> np.ndarray:
        """With all that act, disturbances as every recording shows them."""
        return self._with_disturbances(dataset.predict(self.acting()), dataset)

    def _with_disturbances(self, shared: np.ndarray, dataset: Dataset) -> np.ndarray:
        disturbances = [*(one for one in self.known if one.effect.disturbance),
                        *(one.acting for one in self.chosen if one.per_run)]
        own = [dataset.join([one.effect.columns(run, one.values, self.model) for run in dataset.recordings])
               for one in disturbances]
        return shared + (projected(np.hstack(own), dataset.measured - shared, dataset) if own else 0.0)

    def unseen_by_monitor(self) -> list[Acting]:
        """Effects that the model holds ahead of the monitor, and that the monitor does not show."""
        def missed(acting: Sequence[Acting]) -> float:
            runs = self.dataset.model_runs
            return sum(len(one.recording) * float(np.var(one.um_per_V * one.recording.columns["monitor_V"]
                                                         - one.predict_monitor(acting))) for one in runs)

        ahead = [one for one in self.known if self.dataset.monitored and one.effect.before_monitor]
        return [one for one in ahead
                if missed([other for other in ahead if other is not one]) < thresholds.UNSEEN * missed(ahead)]

    def past_um(self, left_um: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Of what is left of each recording: what may go on from before it, by what the model knows to creep. A sweep
        wipes out what was before.
        """
        parts = []
        for run, left in zip(self.recordings, left_um):
            most_um = sum(one.effect.past_um(one.values, run, self.model) for one in self.known)
            if run.memory != "unknown" or not most_um:
                parts.append(np.zeros(len(run)))
                continue
            shape = signals.goes_on(len(run))
            most, shape = most_um / np.ptp(shape), shape - np.mean(shape)
            parts.append(float(np.clip(shape @ left / (shape @ shape), -most, most)) * shape)
        return parts

    @cached_property
    def past(self) -> np.ndarray:
        """The same of what is left now, long vector; a monitor shows none of it."""
        return self.dataset.join(self.past_um(self.dataset.split(self.residual)))

    # --- more effects

    def accept(self, one: Candidate) -> AugmentedModel:
        """With this effect too, all that were accepted fitted together."""
        state = replace(self, chosen=(*self.chosen, one))
        dataset = self.dataset.restarted(state.acting()) if one.memory_um is None else \
            self.dataset.starting(one.memory_um)
        state = replace(state, dataset=dataset)
        for _ in range(candidates.STEPS):
            left = state.residual
            state = state._with_jacobians()
            better = state._step(left) if len(state.chosen) > 1 else None
            if better is None:
                break
            before, now = _squares(left), _squares(better.residual)
            state = better
            if before - now <= candidates.ENOUGH * before:
                break
        return state

    def refit(self, one: Candidate, move: np.ndarray) -> AugmentedModel:
        """The model's parameters moved by what NormalEquations.refitted_model found, and the effect beside that."""
        model = candidates.perturbed(self.model, move)
        state = AugmentedModel(*_datasets(model, self.recordings, self.earlier), self.known, self.chosen)
        before = state.dataset.measured - state.residual
        return state.accept(candidates.search(state.dataset, one.effect, state.acting(), before) or one)

    def _with_jacobians(self) -> AugmentedModel:
        """Jacobians of all accepted effects at their present parameters."""
        chosen = []
        for one in self.chosen:
            if not one.per_run:
                others = [other for other in self.acting() if other.effect is not one.effect]
                one = replace(one, jacobian=candidates.jacobian(self.dataset, one, others))
            chosen.append(one)
        return replace(self, chosen=tuple(chosen))

    def _step(self, left: np.ndarray) -> AugmentedModel | None:
        """One Gauss-Newton step of all shared parameters to what is left; None: no step leaves less."""
        shared = [one for one in self.chosen if not one.per_run]
        own = [one.jacobian for one in self.chosen if one.per_run and one.jacobian.shape[1]]
        columns = np.hstack([one.jacobian for one in shared]) if shared else np.zeros((len(left), 0))
        if not columns.shape[1]:
            return None
        if own:
            taken = np.hstack(own)
            columns = columns - np.column_stack([projected(taken, column, self.dataset) for column in columns.T])
        move = np.linalg.lstsq(columns, left, rcond=1e-9)[0]
        for damping in (1.0, 0.3):
            tried = self._moved(damping * move)
            if _squares(tried.residual) < _squares(left):
                return tried
        return None

    def _moved(self, move: np.ndarray) -> AugmentedModel:
        """With the shared parameters moved, as far as they stay within bounds."""
        chosen, at = [], 0
        for one in self.chosen:
            if not one.per_run:
                step = dict(zip(one.fitted, move[at:at + len(one.fitted)]))
                values = candidates.bounded(one.effect, one.values, step)
                at += len(one.fitted)
                one = one if one.effect.refusal(values) else replace(one, values=values)
            chosen.append(one)
        return replace(self, chosen=tuple(chosen))

    # --- what no prediction takes away, and what is not new

    def grid_squares(self, one: Candidate) -> float:
        """Sum of squares that a grid of readings leaves: step^2 / 12 a sample, which no prediction takes away.

        A grid that was there at commissioning is part of the passport, and one of the earlier recordings is not new.
        """
        step_um = one.effect.reading_step_um(one.values)
        if step_um == 0:
            return 0.0
        before = max([run["step_um"] for run in (self.model.passport or {}).get("runs", [])]
                     + [signals.grid_step(run.displacement_um) for run in self.earlier], default=0.0)
        coarser = step_um > thresholds.NOISE_GRID * before
        return sum(self.dataset.lengths) * (step_um**2 - before**2) / 12 if coarser else 0.0

    def excused(self) -> float:
        """Sum of squares that the accepted effects leave whatever is known of them."""
        return sum(map(self.grid_squares, self.chosen))

    @property
    def squares(self) -> float:
        """Sum of squares left, less what is excused and what may go on from before the recordings."""
        return _squares(self.residual - self.past) - self.excused()

    @property
    def excused_um(self) -> float:
        """rms of the same."""
        return float(np.sqrt(self.excused() / sum(self.dataset.lengths)))

    def was_there(self, one: Candidate) -> bool:
        """Whether the earlier recordings show a disturbance too, as strong as these or nearly."""
        if not self.earlier or not one.per_run or one.memory_um is not None:
            return False
        then = self.dataset.missed_then
        before, now = (float(np.sum(projected(one.jacobian, left, self.dataset) ** 2)) for left in
                       (then, self.residual + then))
        return before > thresholds.STILL_THERE * now


def _datasets(model: Model, runs: Sequence[Recording], earlier: Sequence[Recording]) -> tuple[Dataset, Dataset]:
    """Driven by monitor_V where there is one, and by command_V."""
    dataset = Dataset(model, runs, earlier)
    return dataset, Dataset(model, runs, earlier, monitored=False) if dataset.monitored else dataset


def _squares(vector: np.ndarray) -> float:
    return float(np.sum(vector**2))


def projected(columns: np.ndarray, left: np.ndarray, dataset: Dataset) -> np.ndarray:
    """What the columns take up of what is left, in each recording by itself."""
    result = np.zeros(len(left))
    run = dataset.run_of_block[dataset.block]
    for k in range(len(dataset.recordings) if columns.shape[1] else 0):
        inside = run == k
        result[inside] = columns[inside] @ np.linalg.lstsq(columns[inside], left[inside], rcond=None)[0]
    return result
