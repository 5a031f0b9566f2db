"""Candidates: each effect fitted to the gap by itself, and the gap in numbers small enough to judge them by.

A candidate's prediction is p0 + D + J (theta - theta_hat): D at the parameters that fit best, J its slope there. The
gap and the columns D and J of all candidates are reduced to one Gram matrix per block of each recording. Leaving
recordings out, joining effects, refitting the model and telling one effect from another is then linear algebra.

All samples of all recordings stand in one long vector, each recording without its mean; where there is a monitor, what
it shows follows the displacement, in um.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from .. import firmware
from ..data import Recording
from ..errors import BadInput
from ..model import Model, guarded
from ..simulate import chain, effects, signals
from ..simulate.effects import Acting, Effect, View

BLOCKS = 8  # of each recording
STEPS = 6  # of Gauss-Newton
ENOUGH = 1e-3  # relative change of the sum of squares at which they end
PROBE = 1e-3  # change of the prediction that a slope is taken over, as a share of the stroke
ROWS = 200_000  # samples used for the Gram matrices; more say no more
REACH = 0.5  # of a candidate's change: how far its slopes are taken to be true
OWN = 2.0  # times a line's amplitude: from there a recording moves at its frequency itself
LEFT_OUT = 4  # parts of the only recording that are left out in turn
REMEMBERED = 2  # responses of the operator that a rig keeps
POSITIONS = 41  # tried for an unknown start of the memory
REFIT_FREEDOM = 0.2  # how far refitting moves a slope, as a share of it: the standard deviation of its prior
CORRELATED = 30  # samples of the residual that count as one: what the model misses is no white noise


@dataclass
class Rig:
    """One recording beside its model, ready to be predicted again and again with other effects.

    With a monitor the actuator is driven by it, and what lies before it is judged by the monitor itself.
    """

    recording: Recording
    model: Model  # without effects
    start_um: np.ndarray  # the plays before the first sample, (n + 1,)
    rate_um_per_s: np.ndarray  # settled, (samples,)
    smoothing_s: float
    monitored: bool
    _last: dict = field(default_factory=dict, repr=False)

    @property
    def input_V(self) -> np.ndarray:
        return self.recording.columns["monitor_V" if self.monitored else "command_V"]

    @property
    def um_per_V(self) -> float:
        """Near enough to weigh both sides of a monitor alike."""
        return self.model.gain_um_per_V * float(self.model.slopes[-1])

    def start(self, start_um: np.ndarray) -> None:
        """Let the plays start here."""
        self.start_um = start_um
        self._last.clear()
        self.__dict__.pop("base_columns", None)

    def respond(self, acting: Sequence[Acting], start_um: np.ndarray | None = None) -> np.ndarray:
        """Displacement in um (samples,) with these effects, disturbances apart."""
        shown = [one for one in acting if not (self.monitored and one.effect.before_monitor)]
        driven, z = self._remembered(shown) if start_um is None else self._operate(shown, start_um)
        return effects.moved(shown, z, driven, self.model)

    def _remembered(self, shown: Sequence[Acting]) -> tuple[Recording, np.ndarray]:
        """_operate, which takes longest, only where an effect ahead of the displacement differs from the last two."""
        key = tuple((repr(one.effect), *one.values.items()) for one in shown if one.effect.ahead)
        if key not in self._last:
            while len(self._last) >= REMEMBERED:
                del self._last[next(iter(self._last))]
            self._last[key] = self._operate(shown, None)
        return self._last[key]

    def missed_um(self, acting: Sequence[Acting]) -> float:
        """Mean of what the displacement misses, in um."""
        return float(np.mean(self.recording.displacement_um - self.respond(acting)))

    def amplified(self, acting: Sequence[Acting]) -> np.ndarray:
        """What monitor_V shows with these effects, in um."""
        shown = [one for one in acting if one.effect.before_monitor]
        return self.um_per_V * effects.driven(shown, self.recording.command_V, self.recording, self.model)

    def _operate(self, shown: Sequence[Acting], start_um: np.ndarray | None) -> tuple[Recording, np.ndarray]:
        """The recording as it was driven, and what the operator makes of that: with the rate of the model's own
        prediction, then with that of the result. One sweep is enough, because effects change the rate little.
        """
        run, drive_V = self.recording, effects.driven(shown, self.input_V, self.recording, self.model)
        model = effects.operator(shown, self.model)
        driven = replace(run, columns={**run.columns, "command_V": drive_V})
        if start_um is None:
            start_um = self.start_um
            if run.memory == "reset" and drive_V[0] != self.input_V[0]:
                start_um = np.full(len(start_um), model.x_of(drive_V[0]))  # the sweep ended where it was driven to
        engine = self._engine if model is self.model else chain.operator_from(model, driven, start_um)

        def forward(rate_um_per_s: np.ndarray) -> np.ndarray:
            engine.memory_um = start_um
            return engine.forward(drive_V, rate_um_per_s)

        z, rate = forward(self.rate_um_per_s), model.rate
        if np.any(model.slope_rate_s_per_um):
            moving, smoothing_s = (z, self.smoothing_s) if rate.source == "displacement" else (model.x_of(drive_V), 0.0)
            z = forward(signals.rate(moving, run.sample_time_s, rate.window_s, rate.filter_s, smoothing_s))
        return driven, z

    @cached_property
    def _engine(self) -> firmware.Firmware:
        """The model's own operator; making one takes longer than running it."""
        return chain.operator_from(self.model, self.recording, self.start_um)

    @cached_property
    def base_columns(self) -> np.ndarray:
        """Slopes of the prediction in the model's own parameters: W_i, with a rate law c_i times the highest rate, and
        the dead zones' weights; (samples, parameters).
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
        return np.hstack(parts)


def rigs(model: Model, runs: Sequence[Recording], monitored: bool) -> list[Rig]:
    """Each recording set up, its memory as `rdpi simulate` takes it."""
    inputs = [replace(run, columns={**run.columns, "command_V": run.columns["monitor_V"]}) if monitored else run
              for run in runs]
    kept = effects.entries(one for one in effects.acting(model) if not (monitored and one.effect.before_monitor))
    plain = replace(model, effects=[])
    return [Rig(run, plain, found.start_um, found.rate_um_per_s, found.smoothing_s, monitored)
            for run, found in zip(runs, chain.simulate(replace(model, effects=kept), inputs))]


class Bench:
    """All recordings of one diagnosis as one long vector, and the block of each sample."""

    def __init__(self, model: Model, runs: Sequence[Recording], earlier: Sequence[Recording] = (),
                 monitored: bool = True) -> None:
        """With `monitored` the actuator is driven by monitor_V, where every recording has it.

        With `earlier` recordings, one of each run's drive and length, what the model misses of them is taken off what
        is measured: what is left is new. Effects of the model that are marked "new" had not acted then.
        """
        self.monitored = monitored and all("monitor_V" in run.columns for run in (*runs, *earlier))
        self.model, self.rigs = model, rigs(model, runs, self.monitored)
        self.lengths = [len(run) for run in runs]
        self.measured = self.join([run.displacement_um for run in runs],
                                  [rig.um_per_V * rig.recording.columns["monitor_V"] for rig in self.rigs]
                                  if self.monitored else None)
        sides = 1 + self.monitored
        self.block = np.concatenate([np.arange(length) * BLOCKS // length + BLOCKS * (sides * k + side)
                                     for k, length in enumerate(self.lengths) for side in range(sides)])
        self.run_of_block = np.repeat(np.arange(len(runs)), BLOCKS * sides)
        self.of_monitor = np.tile(np.repeat(np.arange(sides), BLOCKS), len(runs)).astype(bool)
        self.earlier, self.missed_then, self.acting_then = None, np.zeros(0), []
        if earlier:
            before = replace(model, effects=[entry for entry in model.effects if not entry.get("new")])
            self.earlier, self.acting_then = Bench(before, earlier, monitored=self.monitored), effects.acting(before)
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

    def base_columns(self) -> np.ndarray:
        """Slopes of the prediction in the model's own parameters, as Rig.base_columns, less those of what it missed
        earlier: (samples, parameters).
        """
        own = self.join([rig.base_columns for rig in self.rigs])
        return own - self.earlier.base_columns() if self.earlier else own

    def predict(self, acting: Sequence[Acting]) -> np.ndarray:
        """The prediction with these effects, disturbances apart."""
        return self.join([rig.respond(acting) for rig in self.rigs],
                         [rig.amplified(acting) for rig in self.rigs] if self.monitored else None)

    def restart(self, acting: Sequence[Acting]) -> None:
        """Estimate anew, beside these effects, how recordings of unknown memory start."""
        unknown = [rig for rig in self.rigs if rig.recording.memory == "unknown"]
        if unknown:
            model = replace(self.model, effects=effects.entries(acting))
            for rig, found in zip(unknown, rigs(model, [rig.recording for rig in unknown], self.monitored)):
                rig.start(found.start_um)

    def view(self, predicted: np.ndarray) -> View:
        """What effects look at, beside a long vector that was predicted."""
        left = self.measured - predicted
        return View(self.model, [rig.recording for rig in self.rigs], self.split(predicted), self.split(left),
                    self.split(left, self.monitored))


def moved(model: Model, move: np.ndarray) -> Model:
    """The model with its parameters moved as Rig.base_columns counts them, as far as it stays a model."""
    n, law = len(model.slopes), bool(np.any(model.slope_rate_s_per_um))
    top = model.rate.identified_um_per_s or model.rate.max_um_per_s
    for damping in (1.0, 0.5, 0.25, 0.1):
        step = damping * move
        slopes = model.slopes * (1 + step[:n])
        changes = model.slope_rate_s_per_um + (model.slopes * step[n:2 * n] / top if law else 0.0)
        weights = model.deadzone_weights + np.r_[0.0, step[n * (1 + law):]]
        new = guarded(replace(model, slopes=slopes, slope_rate_s_per_um=changes, deadzone_weights=weights),
                      effects.GUARD_SLACK * (1 - model.rate.min_slope_ratio), model.rate.max_um_per_s)
        try:
            new.validate()
            return new
        except BadInput:
            pass
    return model


@dataclass
class Candidate:
    """An effect at the parameters that fit best, beside those that act already."""

    effect: Effect
    values: dict[str, float]
    free: tuple[str, ...]  # names of the parameters that `slopes` has columns of; those of a disturbance have none
    change: np.ndarray  # D, long vector
    slopes: np.ndarray  # J, (len(D), len(free)), or what a disturbance fits to each recording
    memory_um: list[np.ndarray] | None = None  # plays before the first sample, per recording
    synchronous: float = 0.0  # share of a line that goes with the recordings' own movement

    @property
    def per_run(self) -> bool:
        return self.effect.disturbance


def search(bench: Bench, effect: Effect, acting: Sequence[Acting], before: np.ndarray) -> Candidate | None:
    """The effect fitted to what `before`, the prediction with those that act, leaves; None if nothing excites it."""
    view = bench.view(before)
    left = bench.measured - before
    starts = effect.starts(view)
    if not starts:
        return None
    if effect.name == "initial_memory":
        return _memory(bench, effect, acting, before)
    if effect.disturbance:
        return _disturbance(bench, effect, starts, left)

    plain = bench.predict(acting)

    def change(values: dict[str, float]) -> np.ndarray:
        return bench.predict(effects.in_order([*acting, Acting(effect, values)])) - plain

    free = effect.free
    tried = [(change(values), values) for values in starts]
    at, values = min(tried, key=lambda one: _square(left - one[0]))
    tangent = _slopes(change, at, effect, values, free, bench)
    for _ in range(STEPS if free else 0):
        move = np.linalg.lstsq(tangent, left - at, rcond=1e-9)[0]
        best = _square(left - at)
        for damping in (1.0, 0.5, 0.25, 0.06):
            new = bounded(effect, values, dict(zip(free, damping * move)))
            if effect.refusal(new) is not None:
                continue
            there = change(new)
            if _square(left - there) < best:
                break
        else:
            break
        gained = best - _square(left - there)
        values, at = new, there
        tangent = _slopes(change, at, effect, values, free, bench)
        if gained < ENOUGH * best:
            break
    return Candidate(effect, values, free, at, tangent)


def slopes(bench: Bench, one: Candidate, others: Sequence[Acting]) -> np.ndarray:
    """J of a candidate that acts beside others, disturbances apart."""
    def predict(values: dict[str, float]) -> np.ndarray:
        return bench.predict(effects.in_order([*others, Acting(one.effect, values)]))

    return _slopes(predict, predict(one.values), one.effect, one.values, one.free, bench)


def _slopes(change: Callable[[dict[str, float]], np.ndarray], at: np.ndarray, effect: Effect, values: dict[str, float],
            free: Sequence[str], bench: Bench) -> np.ndarray:
    columns = [_slope(change, at, values, parameter, bench.model.stroke_um) for parameter in effect.parameters
               if parameter.name in free]
    return np.column_stack(columns) if columns else np.zeros((len(at), 0))


def _square(vector: np.ndarray) -> float:
    return float(vector @ vector)


def bounded(effect: Effect, values: dict[str, float], move: dict[str, float]) -> dict[str, float]:
    return {parameter.name: float(np.clip(values[parameter.name] + move.get(parameter.name, 0.0), *parameter.ends))
            for parameter in effect.parameters}


def _slope(change: Callable[[dict[str, float]], np.ndarray], at: np.ndarray, values: dict[str, float],
           parameter: effects.Parameter, stroke_um: float) -> np.ndarray:
    """Derivative of the change by one parameter: a difference over a step that moves the prediction by PROBE."""
    value = values[parameter.name]
    above, below = parameter.high - value, value - parameter.low
    sign, room = (1.0, above) if above >= below else (-1.0, below)
    step = min(0.01 * (abs(value) or 1.0), room)
    for _ in range(4):
        moved = change({**values, parameter.name: value + sign * step}) - at
        size = np.sqrt(np.mean(moved**2)) / (PROBE * stroke_um)
        if 0.1 < size < 10 or size == 0 or size < 0.1 and step == room:
            break
        step = min(step / np.clip(size, 1e-3, 1e3), room)
    return sign * moved / step


def _memory(bench: Bench, effect: Effect, acting: Sequence[Acting], before: np.ndarray) -> Candidate:
    """The position from which each recording was entered that explains its beginning best."""
    states, shown, values = [], [], {}
    for rig, predicted, measured in zip(bench.rigs, bench.split(before), bench.split(bench.measured)):
        r = rig.model.thresholds_um
        x0 = float(rig.start_um[0])
        best = (_square(measured - predicted), rig.start_um, predicted, x0)
        if rig.recording.memory != "unknown":
            for position in x0 + np.linspace(-r[-1], r[-1], POSITIONS):
                start = chain.states_after(position, x0, r)
                z = rig.respond(acting, start)
                z = z - np.mean(z)
                best = min(best, (_square(measured - z), start, z, position), key=lambda one: one[0])
        states.append(best[1])
        shown.append(best[2] - predicted)
        values.setdefault("position_um", float(best[3]))
    return Candidate(effect, values, (), bench.join(shown), np.zeros((len(before), 0)), states)


def _disturbance(bench: Bench, effect: Effect, starts: list[dict[str, float]], left: np.ndarray) -> Candidate:
    """Columns for each recording; the frequency of a line is sought to a fraction of what the recordings resolve."""
    missed = bench.split(left)

    def columns(values: dict[str, float]) -> list[np.ndarray]:
        parts = [effect.columns(rig.recording, values, rig.model) for rig in bench.rigs]
        return [part - np.mean(part, axis=0) for part in parts]

    def amplitudes(parts: list[np.ndarray]) -> list[np.ndarray]:
        return [np.linalg.lstsq(part, rest, rcond=None)[0] for part, rest in zip(parts, missed)]

    def explained(values: dict[str, float]) -> float:
        parts = columns(values)
        return sum(_square(part @ found) for part, found in zip(parts, amplitudes(parts)))

    values = dict(starts[0])
    if "frequency_hz" in values:
        values = max(starts, key=explained)
        span = 1 / max(len(rig.recording) * rig.recording.sample_time_s for rig in bench.rigs)
        while span > 0.02 / max(len(rig.recording) * rig.recording.sample_time_s for rig in bench.rigs):
            span /= 2
            values = max(({**values, "frequency_hz": values["frequency_hz"] + sign * span} for sign in (-1, 0, 1)),
                         key=explained)
    parts = columns(values)
    found = amplitudes(parts)
    if "frequency_hz" in values:
        values["amplitude_um"] = float(np.sqrt(np.mean([_square(one) for one in found])))
    else:
        parameter = next(parameter for parameter in effect.parameters if parameter.name == effect.free[0])
        usual = np.average([one[0] for one in found], weights=bench.lengths)
        values = {parameter.name: float(np.clip(usual, *parameter.ends))}
    one = Candidate(effect, values, (), bench.join([part @ size for part, size in zip(parts, found)]),
                    bench.join(parts))
    one.synchronous = _synchronous(bench, values, found)
    return one


def _synchronous(bench: Bench, values: dict[str, float], found: list[np.ndarray]) -> float:
    """Share of a line's energy in recordings that move at its frequency themselves: that goes with the drive."""
    if "frequency_hz" not in values:
        return 0.0
    whole = drowned = 0.0
    for rig, size in zip(bench.rigs, found):
        asked = rig.respond([])
        turn = np.exp(-2j * np.pi * values["frequency_hz"] * np.arange(len(asked)) * rig.recording.sample_time_s)
        window = np.hanning(len(asked))
        moved = 2 * abs(np.sum(window * (asked - np.mean(asked)) * turn)) / np.sum(window)
        energy = len(asked) * _square(size)
        whole, drowned = whole + energy, drowned + energy * (moved > OWN * np.sqrt(_square(size)))
    return drowned / whole if whole > 0 else 0.0


class Grams:
    """The gap and every candidate as one Gram matrix per block: (blocks, columns, columns)."""

    def __init__(self, bench: Bench, left: np.ndarray, candidates: Sequence[Candidate],
                 acting: Sequence[Candidate] = ()) -> None:
        """`left` is what the prediction with the effects that act already misses; those are adjusted along with every
        candidate.
        """
        self.bench, self.candidates = bench, list(candidates)
        shared = [one.slopes for one in acting if not one.per_run]
        own = [one.slopes for one in acting if one.per_run]
        parts, at = [left[:, None], *shared, *own], 1
        self.adjusted = np.arange(at, at := at + sum(part.shape[1] for part in shared))
        self.own = np.arange(at, at := at + sum(part.shape[1] for part in own))
        self.change, self.slopes = [], []
        for one in self.candidates:
            parts += [one.change[:, None], one.slopes]
            self.change.append(at)
            self.slopes.append(slice(at + 1, at + 1 + one.slopes.shape[1]))
            at += 1 + one.slopes.shape[1]
        parts.append(bench.base_columns())
        self.base = slice(at, at + parts[-1].shape[1])
        self.blocks = self._reduce(parts)

    def _reduce(self, parts: list[np.ndarray]) -> np.ndarray:
        block, step = self.bench.block, max(1, -(-len(self.bench.block) // ROWS))
        edges = np.flatnonzero(np.diff(block, prepend=-1, append=-1))
        grams = np.zeros((len(self.bench.run_of_block), *[sum(part.shape[1] for part in parts)] * 2))
        for start, stop in zip(edges[:-1], edges[1:]):
            rows = np.hstack([part[start:stop:step] for part in parts])
            grams[block[start]] += step * (rows.T @ rows)
        return grams

    def folds(self, within: bool = False) -> list[np.ndarray]:
        """What is left out in turn, (blocks,) of bool each: recordings; `within` them, or in the only one, parts."""
        runs = self.bench.run_of_block
        if runs[-1] > 0 and not within:
            return [runs == run for run in range(runs[-1] + 1)]
        parts = np.arange(len(runs)) % BLOCKS * LEFT_OUT // BLOCKS
        return [parts == part for part in range(LEFT_OUT)]

    def held_out(self, chosen: int | None = None, base: bool = False, within: bool = False) -> np.ndarray:
        """Sum of squares (blocks,) that is left in blocks that were not used to fit the effect, nor the base with it.

        A disturbance is fitted to every other block of each recording and judged on the rest.
        """
        return self._leave_out(chosen, base, within)[0]

    def moves(self) -> np.ndarray:
        """How far the parameters of those that act already move when each fold is left out: (folds, parameters)."""
        return np.array(self._leave_out(None, False, False)[1])

    def fitted_base(self, chosen: int) -> np.ndarray:
        """How far refitting the model beside a candidate moves the parameters of Rig.base_columns."""
        shared, _, target = self._layout(chosen, True)
        move = self._solve(np.sum(self.blocks, axis=0), shared, target, self._ridge(shared), self.candidates[chosen],
                           chosen)
        return move[len(self.adjusted):len(self.adjusted) + self.base.stop - self.base.start]

    def _layout(self, chosen: int | None, base: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns fitted to all recordings together, and to each by itself; and what they are fitted to, as a sum of
        columns.
        """
        columns = np.arange(self.blocks.shape[1])
        one = None if chosen is None else self.candidates[chosen]
        slopes = columns[slice(0, 0) if one is None else self.slopes[chosen]]
        per_run = one is not None and one.per_run
        shared = np.r_[self.adjusted, columns[self.base] if base else [], [] if per_run else slopes].astype(int)
        own = np.r_[self.own, slopes if per_run else []].astype(int)
        target = np.zeros(len(columns))
        target[0] = 1.0
        if one is not None:
            target[self.change[chosen]] = -1.0
        return shared, own, target

    def _leave_out(self, chosen: int | None, base: bool, within: bool) -> tuple[np.ndarray, list[np.ndarray]]:
        one = None if chosen is None else self.candidates[chosen]
        shared, own, target = self._layout(chosen, base)
        left, moves = np.empty(len(self.blocks)), []
        ridge = self._ridge(shared) if base else np.zeros(len(shared))
        for held in self.folds(within):
            move = self._solve(np.sum(self.blocks[~held], axis=0), shared, target, ridge, one, chosen)
            moves.append(move)
            rest = target.copy()
            rest[shared] -= move
            for run in np.unique(self.bench.run_of_block[held]):
                inside = held & (self.bench.run_of_block == run)
                if len(own):
                    self._judge_halves(np.flatnonzero(inside), own, rest, left)
                else:
                    left[inside] = np.einsum("i,kij,j->k", rest, self.blocks[inside], rest)
        return np.maximum(left, 0.0), moves

    def _judge_halves(self, inside: np.ndarray, own: np.ndarray, rest: np.ndarray, left: np.ndarray) -> None:
        """Every other block of one recording with its own columns fitted to those between."""
        for parity in (0, 1):
            judged, fitted = inside[inside % 2 == parity], inside[inside % 2 != parity]
            gram, final = np.sum(self.blocks[fitted], axis=0), rest.copy()
            final[own] -= _normal(gram[np.ix_(own, own)], gram[own] @ rest)
            left[judged] = np.einsum("i,kij,j->k", final, self.blocks[judged], final)

    def _ridge(self, shared: np.ndarray) -> np.ndarray:
        """Prior on the base's slopes: as probable to move by REFIT_FREEDOM as the gap is to be what it is."""
        total = np.sum(self.blocks[:, 0, 0]) * CORRELATED / max(1, len(self.bench.block))
        return np.where((shared >= self.base.start) & (shared < self.base.stop), total / REFIT_FREEDOM**2, 0.0)

    def _solve(self, gram: np.ndarray, shared: np.ndarray, target: np.ndarray, ridge: np.ndarray,
               one: Candidate | None, chosen: int | None) -> np.ndarray:
        if not len(shared):
            return np.zeros(0)
        move = _normal(gram[np.ix_(shared, shared)] + np.diag(ridge), gram[shared] @ target)
        if one is not None and not one.per_run and one.free:
            own = slice(len(shared) - len(one.free), len(shared))
            move[own] = self._within_reach(one, chosen, move[own])
        return move

    def _within_reach(self, one: Candidate, chosen: int, move: np.ndarray) -> np.ndarray:
        """The move of an effect's parameters within their bounds, and no further than its slopes are true."""
        if not one.effect.linear and len(move):
            whole = np.sum(self.blocks, axis=0)
            moved = float(move @ whole[self.slopes[chosen], self.slopes[chosen]] @ move)
            reach = REACH**2 * float(whole[self.change[chosen], self.change[chosen]])
            move = move * min(1.0, np.sqrt(reach / moved)) if moved > 0 else move
        ends = {parameter.name: np.array(parameter.ends) for parameter in one.effect.parameters}
        return np.array([np.clip(step, *(ends[name] - one.values[name])) for name, step in zip(one.free, move)])

    def reproduced(self) -> np.ndarray:
        """Share of each candidate's signature (row) that another (column) reproduces, fitted to it: R^2, 0 to 1."""
        count = len(self.candidates)
        result = np.zeros((count, count))
        for i in range(count):
            row = self.change[i]
            energy = float(np.sum(self.blocks[:, row, row]))
            for j in range(count):
                columns = np.r_[self.change[j], self.slopes[j]].astype(int)
                result[i, j] = self._share(row, columns, self.candidates[j].per_run) / energy if energy > 0 else 0.0
        return np.clip(result, 0.0, 1.0)

    def _share(self, row: int, columns: np.ndarray, per_run: bool) -> float:
        runs = self.bench.run_of_block
        groups = [runs == run for run in range(runs[-1] + 1)] if per_run else [np.full(len(runs), True)]
        total = 0.0
        for group in groups:
            gram = np.sum(self.blocks[group], axis=0)
            across = gram[columns, row]
            total += float(across @ _normal(gram[np.ix_(columns, columns)], across))
        return total


def _normal(gram: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Solution of the normal equations, each column scaled to 1; what is not determined stays 0."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.linalg.lstsq(gram / np.outer(scale, scale), across / scale, rcond=1e-8)[0] / scale
