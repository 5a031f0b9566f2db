"""Candidates: each effect fitted to the gap by itself.

A candidate's prediction is p0 + D + J (theta - theta_hat): D at the parameters that fit best, J its Jacobian there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ..errors import BadInput
from ..model import Model, guarded
from ..simulate import effects, memory
from ..simulate.effects import Acting, Effect
from . import thresholds
from .dataset import Dataset, ModelRun

STEPS = 6  # of Gauss-Newton
ENOUGH = 1e-3  # relative change of the sum of squares at which they end
PROBE = 1e-3  # change of the prediction that a derivative is taken over, as a share of the stroke
POSITIONS, CLOSER = 13, 4  # tried for a start of the memory, and steps of half the way to the best one's neighbours
RESTARTS = 2  # of recordings of unknown memory, beside each effect


def perturbed(model: Model, move: np.ndarray) -> Model:
    """The model with its parameters moved as ModelRun.model_jacobian counts them, as far as it stays a model."""
    n, law = len(model.slopes), bool(np.any(model.slope_rate_s_per_um))
    top = model.rate.identified_um_per_s or model.rate.max_um_per_s
    for damping in (1.0, 0.5, 0.25, 0.1):
        step = damping * move
        slopes = model.slopes * (1 + step[:n])
        changes = model.slope_rate_s_per_um + (model.slopes * step[n:2 * n] / top if law else 0.0)
        weights = model.deadzone_weights + np.r_[0.0, step[n * (1 + law):]]
        new = guarded(replace(model, slopes=slopes, slope_rate_s_per_um=changes, deadzone_weights=weights,
                              operator_alone=None), model.rate.max_um_per_s)
        try:
            new.validate()
            return new
        except BadInput:
            pass
    return model


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at the parameters that fit best, beside those that act already, or in place of the same one."""

    effect: Effect
    values: dict[str, float]
    fitted: tuple[str, ...]  # names of the parameters that `jacobian` has columns of; those of a disturbance have none
    change: np.ndarray  # D, long vector
    jacobian: np.ndarray  # J, (len(D), len(fitted)), or what a disturbance fits to each recording; single precision
    memory_um: list[np.ndarray] | None = None  # plays before the first sample, per recording
    synchronous: float = 0.0  # share of a line that goes with the recordings' own movement
    held: Mapping[str, float] = field(default_factory=dict)  # parameters of the one that the model holds in its place

    @property
    def per_run(self) -> bool:
        return self.effect.disturbance

    @property
    def acting(self) -> Acting:
        return Acting(self.effect, self.values)

    @property
    def at_end(self) -> bool:
        """Whether a parameter would go beyond what rigs have, and beyond what this one had."""
        return any(self.values[name] >= high and self.values[name] > self.held.get(name, -np.inf)
                   for name, (_, high) in self.effect.in_gap.items())

    def slim(self) -> Candidate:
        """Without the long vectors, of which there are too many to keep those of every round."""
        return replace(self, change=np.zeros(0), jacobian=np.zeros((0, self.jacobian.shape[1])))


def search(dataset: Dataset, effect: Effect, acting: Sequence[Acting], before: np.ndarray,
           plain: np.ndarray | None = None, guess: Mapping[str, float] | None = None) -> Candidate | None:
    """The effect fitted to what `before`, the prediction with those that act, leaves; None if nothing excites it. `plain`
    is that prediction without disturbances, if it is at hand; `guess` what it was beside others, from where the fit
    starts then.

    If it is one of those that act, it takes that one's place: the change is from there on, and none is no change.
    """
    left, plain = dataset.measured - before, dataset.predict(acting) if plain is None else plain
    known = None if effect.disturbance else effects.replaced(acting, effect)
    without = before
    if known is not None:  # what it would have to explain if the model did not hold it
        without = before - plain + dataset.predict([one for one in acting if one is not known])
    starts = effect.starts(dataset.residuals(without)) if guess is None or effect.disturbance else [dict(guess)]
    if not starts or effect.starts_memory and not any(one.start_known for one in dataset.model_runs):
        return None
    if effect.starts_memory:
        return _memory(dataset, effect, acting, plain, left + plain)
    if effect.disturbance:
        return _disturbance(dataset, effect, starts, left)

    def change(values: dict[str, float]) -> np.ndarray:
        return dataset.predict(effects.beside(acting, Acting(effect, values))) - plain

    within = [{**values, **{name: float(np.clip(values[name], *ends)) for name, ends in effect.in_gap.items()}}
              for values in starts]
    tried = [(change(values), values) for values in within]
    found = _refined(dataset, effect, change, left, *min(tried, key=lambda one: _square(left - one[0])))
    if known is not None and guess is None:
        moved = _refined(dataset, effect, change, left, np.zeros(len(left)), dict(known.values))
        found = min((moved, found), key=lambda one: _square(left - one.change))
    found = _restarted(dataset, acting, plain, left, found)
    return replace(found, values=effect.within(found.values, dataset.recordings),
                   held={} if known is None else known.values)


def _restarted(dataset: Dataset, acting: Sequence[Acting], plain: np.ndarray, left: np.ndarray, found: Candidate
               ) -> Candidate:
    """The same with the starts that are not known estimated beside it, where that leaves less: estimated without it,
    they have taken up a part of it, or stand in its way.
    """
    for _ in range(RESTARTS):
        again = dataset.restarted(effects.beside(acting, found.acting))
        if again is dataset:
            return found

        def change(values: dict[str, float]) -> np.ndarray:
            return again.predict(effects.beside(acting, Acting(found.effect, values))) - plain

        better = _refined(again, found.effect, change, left, change(found.values), found.values)
        if _square(left - better.change) >= (1 - ENOUGH) * _square(left - found.change):
            return found
        found = replace(better, memory_um=[one.start_um for one in again.model_runs])
    return found


def _refined(dataset: Dataset, effect: Effect, change: Callable[[dict[str, float]], np.ndarray], left: np.ndarray,
             at: np.ndarray, values: dict[str, float]) -> Candidate:
    """The effect moved by Gauss-Newton from these values, which change the prediction by `at`, to leave least."""
    fitted = effect.fitted
    tangent = _jacobian(change, at, effect, values, fitted, dataset)
    for _ in range(STEPS if fitted else 0):
        missed = left - at
        move, best = np.linalg.lstsq(tangent, missed, rcond=1e-9)[0], _square(missed)
        if best - _square(missed - tangent @ move) < ENOUGH * best:
            break
        for damping in (1.0, 0.5, 0.25, 0.06):
            new = bounded(effect, values, dict(zip(fitted, damping * move)))
            if effect.refusal(new) is not None:
                continue
            there = change(new)
            if _square(left - there) < best:
                break
        else:
            break
        gained = best - _square(left - there)
        values, at = new, there
        tangent = _jacobian(change, at, effect, values, fitted, dataset)
        if gained < ENOUGH * best:
            break
    return Candidate(effect, values, fitted, at, tangent.astype(np.float32))


def jacobian(dataset: Dataset, one: Candidate, others: Sequence[Acting]) -> np.ndarray:
    """J of a candidate that acts beside others, disturbances apart."""
    def predict(values: dict[str, float]) -> np.ndarray:
        return dataset.predict(effects.beside(others, Acting(one.effect, values)))

    return _jacobian(predict, predict(one.values), one.effect, one.values, one.fitted, dataset)


def _jacobian(change: Callable[[dict[str, float]], np.ndarray], at: np.ndarray, effect: Effect,
              values: dict[str, float], fitted: Sequence[str], dataset: Dataset) -> np.ndarray:
    columns = [_derivative(change, at, values, parameter, dataset.model.stroke_um) for parameter in effect.parameters
               if parameter.name in fitted]
    return np.column_stack(columns) if columns else np.zeros((len(at), 0))


def _square(vector: np.ndarray) -> float:
    return float(vector @ vector)


def bounded(effect: Effect, values: dict[str, float], move: dict[str, float]) -> dict[str, float]:
    """Parameters moved, as far as they stay within bounds; one that the model holds beyond them may stay there."""
    moved = {}
    for parameter in effect.parameters:
        value = values[parameter.name]
        low, high = effect.in_gap.get(parameter.name, parameter.ends)
        moved[parameter.name] = float(np.clip(value + move.get(parameter.name, 0.0), min(low, value), max(high, value)))
    return moved


def _derivative(change: Callable[[dict[str, float]], np.ndarray], at: np.ndarray, values: dict[str, float],
                parameter: effects.Parameter, stroke_um: float) -> np.ndarray:
    """Derivative of the change by one parameter: a difference over a step that moves the prediction by PROBE."""
    value = values[parameter.name]
    if not np.isfinite(value):  # it is as if it were not there
        return np.zeros_like(at)
    above, below = parameter.high - value, value - parameter.low
    sign, room = (1.0, above) if above >= below else (-1.0, below)
    step = min(0.01 * (abs(value) or 1.0), room)
    for last in (False, False, False, True):
        difference = change({**values, parameter.name: value + sign * step}) - at
        size = np.sqrt(np.mean(difference**2)) / (PROBE * stroke_um)
        if 0.1 < size < 10 or size == 0 or size < 0.1 and step == room or last:
            break
        step = min(step / np.clip(size, 1e-3, 1e3), room)
    return sign * difference / step


def _memory(dataset: Dataset, effect: Effect, acting: Sequence[Acting], plain: np.ndarray, asked: np.ndarray) -> Candidate:
    """The position from which each recording was entered that explains its beginning best; `plain` is the prediction,
    `asked` what it is to be, both without disturbances.
    """
    states, shown, positions = [], [], []
    parts = zip(dataset.model_runs, dataset.split(plain), dataset.split(asked))
    for model_run, predicted, measured in parts:
        r = model_run.model.thresholds_um
        x0 = float(model_run.start_um[0])
        start, change = model_run.start_um, np.zeros(len(measured))
        if model_run.start_known:
            missed = partial(_missed, model_run, acting, x0, measured)
            found, left = _nearest(x0, float(r[-1]), missed)
            if left < _square(measured - predicted):
                start = memory.states_after(found, x0, r)
                positions.append(found)
                change = _entered(model_run, acting, x0, found) - predicted
        states.append(start)
        shown.append(change)
    values = {effect.fitted[0]: positions[0] if positions else float(dataset.model_runs[0].start_um[0])}
    return Candidate(effect, values, (), dataset.join(shown), np.zeros((len(plain), 0)), states)


def _nearest(x0_um: float, reach_um: float, miss: Callable[[float], float]) -> tuple[float, float]:
    """The position that misses least, and what it misses: looked for coarsely, then closer to the best."""
    found = {float(position): miss(position) for position in x0_um + np.linspace(-reach_um, reach_um, POSITIONS)}
    step = 2 * reach_um / (POSITIONS - 1)
    for _ in range(CLOSER):
        best, step = min(found, key=found.get), step / 2
        found |= {position: miss(position) for position in (best - step, best + step)}
    best = min(found, key=found.get)
    return best, found[best]


def _entered(model_run: ModelRun, acting: Sequence[Acting], x0_um: float, position_um: float) -> np.ndarray:
    """The prediction, less its mean, of a recording that was entered from this position."""
    z = model_run.predict(acting, memory.states_after(position_um, x0_um, model_run.model.thresholds_um))
    return z - np.mean(z)


def _missed(model_run: ModelRun, acting: Sequence[Acting], x0_um: float, measured: np.ndarray, position_um: float
            ) -> float:
    return _square(measured - _entered(model_run, acting, x0_um, position_um))


def _disturbance(dataset: Dataset, effect: Effect, starts: list[dict[str, float]], left: np.ndarray) -> Candidate:
    """Columns for each recording; the frequency of a line is sought to a fraction of what the recordings resolve."""
    missed = dataset.split(left)

    def columns(values: dict[str, float]) -> list[np.ndarray]:
        parts = [effect.columns(model_run.recording, values, model_run.model) for model_run in dataset.model_runs]
        return [part - np.mean(part, axis=0) for part in parts]

    def amplitudes(parts: list[np.ndarray]) -> list[np.ndarray]:
        return [np.linalg.lstsq(part, rest, rcond=None)[0] for part, rest in zip(parts, missed)]

    def explained(values: dict[str, float]) -> float:
        parts = columns(values)
        return sum(_square(part @ found) for part, found in zip(parts, amplitudes(parts)))

    values = dict(starts[0])
    if effect.frequency is not None:
        tried = [(explained(start), start) for start in starts]
        longest_s = max(len(run) * run.sample_time_s for run in dataset.recordings)
        span = 1 / longest_s
        while span > 0.02 / longest_s:
            span /= 2
            best = max(tried, key=lambda one: one[0])
            near = ({**best[1], effect.frequency: best[1][effect.frequency] + sign * span} for sign in (-1, 1))
            tried = [best, *((explained(one), one) for one in near)]
        values = max(tried, key=lambda one: one[0])[1]
    parts = columns(values)
    found = amplitudes(parts)
    values = effect.summary(values, found, dataset.lengths)
    synchronous = 0.0 if effect.frequency is None else _synchronous(dataset, values[effect.frequency], found)
    return Candidate(effect, values, (), dataset.join([part @ size for part, size in zip(parts, found)]),
                     dataset.join(parts).astype(np.float32), synchronous=synchronous)


def _synchronous(dataset: Dataset, frequency_hz: float, found: list[np.ndarray]) -> float:
    """Share of a line's energy in recordings that move at its frequency themselves: that goes with the drive."""
    whole = drowned = 0.0
    for model_run, size in zip(dataset.model_runs, found):
        asked = model_run.predict([])
        turn = np.exp(-2j * np.pi * frequency_hz * np.arange(len(asked)) * model_run.recording.sample_time_s)
        window = np.hanning(len(asked))
        own = 2 * abs(np.sum(window * (asked - np.mean(asked)) * turn)) / np.sum(window)
        energy = len(asked) * _square(size)
        whole, drowned = whole + energy, drowned + energy * (own > thresholds.OWN_MOTION * np.sqrt(_square(size)))
    return drowned / whole if whole > 0 else 0.0
