"""`rdpi gap`: where a fitted model and its actuator part ways, which effect is behind it, and how far adding it helps.

The model is driven by the recorded command; the gap is what is left of the displacement, each recording's mean removed.
Every effect is fitted to it with the model frozen and with the model refitted, and judged on recordings that were left
out. Thresholds come from simulated 'none' controls (tests/withheld), not from p-values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from . import candidates, chain, effects, excite, firmware, intake, localise, passport, signals, version
from .candidates import BLOCKS, Bench, Candidate, Grams
from .effects import CATALOGUE, Acting
from .errors import BadInput
from .model import Model
from .model import guard_rates as model_guard
from .recording import Recording

SCHEMA = "rdpi-gap/1"
MOST = 3  # effects
# --- thresholds, learnt on the tuning set of tests/withheld
DETECTED = 0.30  # evidence from which there is a gap
USUAL_SPREAD = 0.2  # of the passport; a poorer one's ratio counts less
SHRINK_WEIGHT = 1.0  # of the best shrink in that evidence, beside the logarithm of the ratio to the passport
BORN_IN, BORN_IN_FEW = 0.25, 0.45  # shrink that alone makes an effect where nothing exceeds the passport; few recordings
FEW = 4
FREE = {"thermal_drift": 0.10, "periodic_disturbance": 0.08, "initial_memory": 0.03}  # what disturbances gain anyway
FREE_BESIDE = {**FREE, "static_nonlinearity": 0.2}  # ... and what the plays' own misfit lends, the model refitted
LEAST_SHARE = 0.15  # of the excess that an effect must explain
LEAST_SHRINK = 0.04
FURTHER_EXCESS, FURTHER_SHARE, FURTHER_SHRINK = 1.4, 0.3, 0.1  # what a second and third effect must find and bring
EXPLAINED, LEFT_OVER = 0.6, 1.5  # of the excess that all explain, or the ratio they leave, or the gap is unknown
SAME = 0.08  # relative excess of the squares left by a rival, below which these recordings cannot tell it
WITHIN = {"static_nonlinearity": "gain_change"}  # effects that hold a simpler one ...
HOLDS = 0.2  # ... and what they must leave less than it
SIMPLER = 0.05  # ... that every further parameter must bring
GRID = 1.5  # times the passport's step: a coarser grid is a new one
WIDEN = 1.6  # of bootstrapped intervals, so that 90 % is 90 %
DRAWS = 400


@dataclass
class Judged:
    """A candidate and what it explains; shrinks are of the rms of recordings that were left out."""

    candidate: Candidate
    left: float  # sum of squares left, model frozen; mean of leaving recordings out and parts of them
    shrink: float
    shrink_ci: tuple[float, float] | None
    refitted_shrink: float  # beyond what refitting the model alone brings
    refitted_left: float
    share: float  # of the excess over the passport
    monitor_left: float = 0.0
    rejected: str | None = None

    @property
    def name(self) -> str:
        return self.candidate.effect.name

    @property
    def size(self) -> int:
        """Parameters, as far as a comparison must pay for them."""
        return len(self.candidate.free) or 1 + self.candidate.slopes.shape[1]


@dataclass
class Round:
    """One round of the forward selection."""

    judged: list[Judged]
    best: Judged | None
    rivals: list[Judged]
    names: list[str]
    reproduced: np.ndarray  # (candidates, candidates)
    refit_alone: float  # shrink by refitting the model
    refitted: bool  # whether the best was judged with the model refitted
    before: float  # sum of squares before it


@dataclass
class Diagnosis:
    """What `rdpi gap` found: the document for --json, the improved model, and residuals for the pictures."""

    document: dict[str, Any]
    improved: Model
    runs: list[Recording]
    before_um: list[np.ndarray]
    after_um: list[np.ndarray]
    table: localise.Table
    spectrum_after: localise.Axis | None


def diagnose(model: Model, runs: Sequence[Recording], without: Sequence[str] = (),
             progress: Callable[[float], None] = lambda fraction: None) -> Diagnosis:
    """Diagnose the gap between a model and recordings of its actuator; effects named in `without` are not known.

    Raises BadInput for recordings that cannot be this model's.
    """
    notes = _check(model, runs)
    known = passport.read(model)
    state = _Diagnosis(model, runs, without, progress)
    before = state.bench.split(state.first)
    coords = [localise.coordinates(rig.recording, predicted, rig.rate_um_per_s)
              for rig, predicted in zip(state.bench.rigs, state.bench.split(state.bench.measured - state.first))]
    gap = excess(state, known, coords)
    rounds = select(state, gap)
    verdict = _verdict(state, gap, rounds)
    if verdict == "unknown":
        notes += _partly(rounds)
        state.forget()
    after = state.bench.split(state.rest)
    noise = float(np.median([signals.noise_um(run.displacement_um) for run in runs]))
    axes = localise.localise(runs, before, coords, known, noise)
    document = {
        "schema": SCHEMA, "tool": f"rdpi {version()}", "verdict": verdict, "detection": state.detection,
        "effects": _effects(state, rounds), "candidates": _candidates(state, rounds),
        "gap": _gap(state, noise), "where": _where(state, gap, axes, before), "runs": _runs(state, gap, before, after),
        "passport": None if known is None else {"ratio": gap.ratio, "rms_um": float(np.sqrt(gap.floor / state.samples)),
                                                "held_out": known["held_out"], "spread": gap.spread},
        "promised": _promised(state), "refit": {"shrink": rounds[0].refit_alone},
        "numerics": numerics(model, runs), "not_excited": _not_excited(state, rounds),
        "leftover": _leftover(state, gap), "matrix": _matrix(rounds[0]), "next_experiment": _next(state, rounds, verdict), "notes": notes,
    }
    entries = [{key: entry[key] for key in ("name", "stage", "column", "parameters") if key in entry}
               for entry in document["effects"]]
    progress(1.0)
    return Diagnosis(document, replace(state.model, effects=[*model.effects, *entries]), list(runs), before, after,
                     localise.table(before, coords),
                     next(axis for axis in localise.localise(runs, after, coords, known, noise)
                          if axis.name == "frequency_hz") if state.chosen else None)


class _Diagnosis:
    """The state of one diagnosis: which effects act, and what they leave."""

    def __init__(self, model: Model, runs: Sequence[Recording], without: Sequence[str],
                 progress: Callable[[float], None]) -> None:
        self.model, self.runs, self.without, self.progress = model, list(runs), set(without), progress
        self.bench, self.known = Bench(model, runs), effects.acting(model)
        self.chosen: list[Candidate] = []
        self.detection = -np.inf  # the evidence for a gap
        self.rest = self.bench.measured - self.predict()
        self.first = self.rest

    @property
    def samples(self) -> int:
        return sum(self.bench.lengths)

    # --- prediction

    def acting(self) -> list[Acting]:
        return effects.in_order([*self.known, *(Acting(one.effect, one.values) for one in self.chosen
                                                if not one.per_run)])

    def predict(self) -> np.ndarray:
        """With all that act, disturbances as every recording shows them."""
        shared = self.bench.predict(self.acting())
        own = [one.slopes for one in self.chosen if one.per_run and one.slopes.shape[1]]
        own += [self.bench.join([one.effect.columns(rig.recording, one.values, self.model) for rig in self.bench.rigs])
                for one in self.known if one.effect.disturbance and one.effect.name != "initial_memory"]
        return shared + (self._fitted(np.hstack(own), self.bench.measured - shared) if own else 0.0)

    def _fitted(self, columns: np.ndarray, left: np.ndarray) -> np.ndarray:
        """What the columns take up of what is left, in each recording by itself."""
        result = np.zeros(len(left))
        run = self.bench.run_of_block[self.bench.block]
        for k in range(len(self.runs)):
            inside = run == k
            result[inside] = columns[inside] @ np.linalg.lstsq(columns[inside], left[inside], rcond=None)[0]
        return result

    def accept(self, one: Candidate) -> None:
        """Let it act, and fit all that act together."""
        if one.memory_um is not None:
            for rig, start_um in zip(self.bench.rigs, one.memory_um):
                rig.start(start_um)
        self.chosen.append(one)
        for _ in range(candidates.STEPS):
            before = self.predict()
            left = float(np.sum((self.bench.measured - before) ** 2))
            shared = [other for other in self.chosen if not other.per_run]
            for other in shared:
                others = [item for item in self.acting() if item.effect is not other.effect]
                other.slopes = candidates.slopes(self.bench, other, others)
            if len(shared) < 2 and len(self.chosen) < 2:
                break
            if not self._adjust(shared, before, left):
                break
        self.rest = self.bench.measured - self.predict()

    def _adjust(self, shared: list[Candidate], before: np.ndarray, left: float) -> bool:
        """One Gauss-Newton step of all shared parameters; whether it was worth it."""
        own = [one.slopes for one in self.chosen if one.per_run and one.slopes.shape[1]]
        columns = np.hstack([one.slopes for one in shared]) if shared else np.zeros((len(before), 0))
        if not columns.shape[1]:
            return False
        target = self.bench.measured - before
        if own:
            taken = np.hstack(own)
            columns = columns - np.column_stack([self._fitted(taken, column) for column in columns.T])
        move = np.linalg.lstsq(columns, target, rcond=1e-9)[0]
        old = [dict(one.values) for one in shared]
        for damping in (1.0, 0.3):
            at = 0
            for one, values in zip(shared, old):
                step = dict(zip(one.free, damping * move[at:at + len(one.free)]))
                one.values = candidates.bounded(one.effect, values, step)
                at += len(one.free)
            now = float(np.sum((self.bench.measured - self.predict()) ** 2))
            if now < left:
                return left - now > candidates.ENOUGH * left
        for one, values in zip(shared, old):
            one.values = values
        return False

    def forget(self) -> None:
        """Let no effect act."""
        self.chosen, self.rest = [], self.first

    def refit(self, one: Candidate, move: np.ndarray) -> None:
        """Move the model's parameters, as Grams.fitted_base has them, and let the effect act beside that model."""
        self.model = _moved(self.model, move)
        self.bench = Bench(self.model, self.runs)
        self.rest = self.bench.measured - self.predict()
        again = candidates.search(self.bench, one.effect, self.acting(), self.bench.measured - self.rest)
        self.accept(again or one)

    # --- one round

    def tried(self) -> list[candidates.Effect]:
        """Every effect of the catalogue that this diagnosis has not added, where it may act."""
        taken = {one.effect.name for one in self.chosen} | self.without
        result = []
        for name, kind in CATALOGUE.items():
            if name in taken:
                continue
            if name == "cross_coupling":
                columns = dict.fromkeys(column for run in self.runs for column in effects.covariates(run))
                result += [kind(column=column) for column in columns]
            elif name == "quantisation" or self.bench.monitored and name != "static_nonlinearity":
                result += [kind(stage) for stage in kind.stages]
            else:
                result.append(kind())
        return result

    def round(self, floor: float) -> tuple[list[Judged], Grams]:
        """Every effect fitted and judged; `floor` is the sum of squares to be expected."""
        before = self.bench.measured - self.rest
        acting, found = self.acting(), []
        tried = self.tried()
        for k, effect in enumerate(tried):
            one = candidates.search(self.bench, effect, acting, before)
            if one is not None:
                found.append(one)
            self.progress((k + 1) / len(tried))
        grams = Grams(self.bench, self.rest, found, self.chosen)
        zero, zero_within = grams.held_out(), grams.held_out(within=True)
        base, base_within = grams.held_out(base=True), grams.held_out(base=True, within=True)
        total = float(np.sum(zero_within) + np.sum(zero)) / 2
        side = grams.bench.of_monitor
        judged = []
        lowest = max(min(np.sum(zero), np.sum(base)), 1e-300)
        for k, one in enumerate(found):
            left, within = grams.held_out(k), grams.held_out(k, within=True)
            refitted, refitted_within = grams.held_out(k, base=True), grams.held_out(k, base=True, within=True)
            kept = float(np.sum(within) + np.sum(left)) / 2
            if one.effect.name == "quantisation" and one.effect.stage == "sensor":
                kept = min(kept, self.beside_grid(one.values["step"], total, floor))
            judged.append(Judged(
                one, kept, _shrink(left, zero), self.interval(left, zero), float(1 - np.sqrt(np.sum(refitted) / lowest)),
                float(np.sum(refitted) + np.sum(refitted_within)) / 2, (total - kept) / max(total - floor, 1e-9 * total, 1e-300),
                float(np.sum(within[side]))))
        self.zero, self.base, self.total = zero, base, total
        self.least = min(total, float(np.sum(base) + np.sum(base_within)) / 2)
        return judged, grams

    def beside_grid(self, step_um: float, total: float, floor: float) -> float:
        """What the noise of a grid of readings leaves to others: step^2 / 12 a sample, which no prediction takes away.

        A grid that was there at commissioning is part of the passport.
        """
        before = max((run["step_um"] for run in (self.model.passport or {}).get("runs", [])), default=0.0)
        if step_um <= GRID * before:
            return total
        return max(floor, total - sum(self.bench.lengths) * (step_um**2 - before**2) / 12)

    def interval(self, after: np.ndarray, before: np.ndarray, percent: float = 95) -> tuple[float, float] | None:
        """Interval of the shrink: recordings drawn anew, then their blocks; widened. None for a single recording."""
        if len(self.runs) < 2:
            return None
        sides = len(after) // (len(self.runs) * BLOCKS)
        pairs = np.stack([after, before]).reshape(2, len(self.runs), sides, BLOCKS).sum(axis=2)
        random = np.random.default_rng(0)
        runs = random.integers(len(self.runs), size=(DRAWS, len(self.runs)))
        blocks = random.integers(BLOCKS, size=(DRAWS, len(self.runs), BLOCKS))
        sums = pairs[:, runs[:, :, None], blocks].sum(axis=(2, 3))
        drawn = 1 - np.sqrt(sums[0] / np.maximum(sums[1], 1e-300))
        middle, (low, high) = _shrink(after, before), np.percentile(drawn, (50 - percent / 2, 50 + percent / 2))
        return float(middle - WIDEN * (middle - low)), float(min(1.0, middle + WIDEN * (high - middle)))


@dataclass
class Excess:
    """The gap against the passport; sums of squares over all samples."""

    total: float
    floor: float
    ratio: float | None  # of rms, None without a passport
    spread: float
    ratios: list[float] | None  # per recording

    @property
    def evidence(self) -> float:
        return float(np.log(self.ratio)) * min(1.0, USUAL_SPREAD / max(self.spread, 1e-9)) if self.ratio else 0.0

    def left(self, total: float) -> float:
        """Ratio to the passport of what is left of the squares."""
        return float(np.sqrt(total / max(self.floor, 1e-300)))


def excess(state: _Diagnosis, known: dict[str, Any] | None, coords: Sequence[localise.Coordinates]) -> Excess:
    """How far the gap exceeds what the passport expects of these recordings."""
    left = state.bench.split(state.first)
    total = float(np.sum(state.first**2))
    noise = float(sum(signals.noise_um(part) ** 2 * len(part) for part in left))
    if known is None:
        return Excess(total, noise, None, 0.0, None)
    found = passport.ratio(known, left, coords)
    floor = float(np.sum(found.expected_um**2 * state.bench.lengths))
    # What a monitor shows ahead of the actuator adds to what the displacement misses behind it.
    return Excess(total, min(floor, total), float(np.sqrt(total / floor)), found.spread, found.ratio.tolist())


def select(state: _Diagnosis, gap: Excess) -> list[Round]:
    """Forward selection: the best effect joins as long as it explains what is not excused yet."""
    rounds: list[Round] = []
    while len(state.chosen) < MOST:
        if rounds and gap.left(float(np.sum(state.rest**2))) < FURTHER_EXCESS:
            break
        judged, grams = state.round(gap.floor)
        best, refitted = _best(judged, state, gap, bool(rounds))
        rounds.append(Round(judged, best, _rivals(judged, best, refitted, state) if best else [],
                            [repr(one.candidate.effect) for one in judged], grams.reproduced(),
                            _shrink(state.base, state.zero), refitted,
                            float(np.sum(state.zero))))
        if best is None:
            break
        if refitted:
            state.refit(best.candidate, grams.fitted_base(judged.index(best)))
        else:
            state.accept(best.candidate)
    return rounds


def _gain(one: Judged, state: _Diagnosis) -> float:
    """Shrink beyond what a disturbance gains from nothing; of a grid, what it explains."""
    if one.name == "quantisation" and one.candidate.effect.stage == "sensor":
        return float(1 - np.sqrt(one.left / max(state.total, 1e-300)))
    return one.shrink - FREE.get(one.name, 0.0)


def _best(judged: list[Judged], state: _Diagnosis, gap: Excess, further: bool) -> tuple[Judged | None, bool]:
    """The candidate to accept, if any, and whether the model was refitted beside it."""
    share, shrink = (FURTHER_SHARE, FURTHER_SHRINK) if further else (LEAST_SHARE, LEAST_SHRINK)
    born_in = BORN_IN_FEW if len(state.runs) < FEW else BORN_IN
    evidence = gap.evidence + SHRINK_WEIGHT * max([_gain(one, state) for one in judged] + [0.0])
    state.detection = max(state.detection, evidence)
    for one in judged:
        gain = _gain(one, state)
        one.rejected = None
        if one.share <= share or gain <= shrink:
            one.rejected = "explains too little of the gap"
        elif not (gap.ratio and evidence > DETECTED) and min(gain, one.refitted_shrink) < born_in:
            one.rejected = "the gap is no larger than the passport expects"
    open_ = [one for one in judged if one.rejected is None]
    if open_:
        lowest = min(one.left for one in open_)
        near = [one for one in open_ if one.left <= lowest * (1 + SAME)]
        best = min(near, key=lambda one: one.left * (1 + SIMPLER * one.size))
        held = [one for one in open_ if one.name == WITHIN.get(best.name) and one.left <= best.left * (1 + HOLDS)]
        return (held or [best])[0], False
    # Born in: what the fit took up hides an effect until the model is refitted beside it.
    hidden = [one for one in judged if not further and one.refitted_shrink - FREE_BESIDE.get(one.name, 0.0) > born_in
              and one.refitted_left < state.least * (1 - born_in)]
    if hidden:
        best = min(hidden, key=lambda one: one.refitted_left * (1 + SIMPLER * one.size))
        best.rejected = None
        return best, True
    return None, False


def _rivals(judged: list[Judged], best: Judged, refitted: bool, state: _Diagnosis) -> list[Judged]:
    """Those that leave as little as the best: what these recordings cannot tell from it."""
    def left(one: Judged) -> float:
        return one.refitted_left if refitted else one.left

    result = []
    for one in judged:
        if one is best or one.name == best.name:
            continue
        same = left(one) <= (1 + SAME) * left(best)
        if same and one.candidate.effect.before_monitor and best.candidate.effect.before_monitor and state.bench.monitored:
            same = one.monitor_left <= (1 + 3 * SAME) * best.monitor_left
        if same and WITHIN.get(one.name) != best.name:
            result.append(one)
    return sorted(result, key=left)


def _shrink(after: np.ndarray, before: np.ndarray) -> float:
    return float(1 - np.sqrt(np.sum(after) / np.sum(before))) if np.sum(before) > 0 else 0.0




# --- what the document says

def _verdict(state: _Diagnosis, gap: Excess, rounds: list[Round]) -> str:
    first = rounds[0]
    if first.best is None:
        return "unknown" if gap.ratio and state.detection > DETECTED else "none"
    if gap.ratio and not first.refitted:
        left = float(np.sum(state.rest**2))
        for one in state.chosen:
            if one.effect.name == "quantisation" and one.effect.stage == "sensor":
                left = state.beside_grid(one.values["step"], left, 0.0)
        explained = (gap.total - left) / max(gap.total - gap.floor, 1e-300)
        if explained < EXPLAINED and gap.left(left) > LEFT_OVER:
            return "unknown"
    return "ambiguous" if any(one.rivals for one in rounds) else "effect"


def _partly(rounds: list[Round]) -> list[str]:
    best = rounds[0].best
    return [] if best is None else [f"{best.name} takes up a part of the gap, but leaves too much to be its cause"]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _effects(state: _Diagnosis, rounds: list[Round]) -> list[dict[str, Any]]:
    """The accepted effects, in the order added, with their final parameters."""
    if not state.chosen:
        return []
    grams = Grams(state.bench, state.rest, [], state.chosen)
    moves = grams.moves()
    errors = WIDEN * 1.96 * np.sqrt((len(moves) - 1) * np.mean((moves - moves.mean(axis=0))**2, axis=0))
    found, at = [], 0
    for one, done in zip(state.chosen, rounds):
        widths = {}
        if not one.per_run:
            widths = dict(zip(one.free, errors[at:at + len(one.free)]))
            at += len(one.free)
        judged = done.best
        rms = float(np.sqrt(done.before / state.samples))
        found.append({
            "name": one.effect.name, "stage": one.effect.stage, **_column(one.effect),
            "parameters": _parameters(one, widths),
            "held_out_rms_um": {"before": rms, "after": rms * (1 - judged.shrink)},
            "shrink": judged.shrink, "shrink_ci95": judged.shrink_ci, "confidence": _confidence(done),
            "confusable_with": list(dict.fromkeys(rival.name for rival in done.rivals))})
    return found


def _column(effect: effects.Effect) -> dict[str, str]:
    return {"column": effect.column} if isinstance(effect, effects.CrossCoupling) else {}


def _parameters(one: Candidate, widths: dict[str, float]) -> dict[str, dict[str, Any]]:
    result = {}
    for parameter in one.effect.parameters:
        value, width = one.values[parameter.name], widths.get(parameter.name)
        ends = None if width is None else [float(max(parameter.low, value - width)),
                                           float(min(parameter.high, value + width))]
        unit = parameter.unit
        if one.effect.name == "quantisation" and parameter.name != "dither":
            unit = "um" if one.effect.stage == "sensor" else "V"
        result[parameter.name] = {"value": _finite(value), "ci95": ends, "unit": unit}
    return result


def _confidence(done: Round) -> float:
    """Weight of the best among those tried, by the squares they leave; SAME apart is worth e^-1."""
    def left(one: Judged) -> float:
        return one.refitted_left if done.refitted else one.left

    best = max(left(done.best), 1e-12 * done.before)
    weights = [np.exp(-(left(one) / best - 1) / SAME) for one in done.judged if one.name != done.best.name]
    return float(1 / (1 + sum(weights)))


def _candidates(state: _Diagnosis, rounds: list[Round]) -> list[dict[str, Any]]:
    """Every effect that was tried, each at its stage that explains most, as the first round judged it."""
    first, accepted = rounds[0], [one.effect.name for one in state.chosen]
    result = {}
    for one in sorted(first.judged, key=lambda one: one.left):
        if one.name in result:
            continue
        rejected = one.rejected
        if one.name in accepted:
            rejected = None
        elif one is first.best:
            rejected = "takes up a part of the gap, but leaves too much to be its cause"
        elif rejected is None and one not in first.rivals:
            rejected = f"{first.best.name} explains more of the gap"
        result[one.name] = {
            "name": one.name, "stage": one.candidate.effect.stage, "shrink": one.shrink, "shrink_ci95": one.shrink_ci,
            "refitted_shrink": one.refitted_shrink, "parameters": _parameters(one.candidate, {}), "excited": True,
            "share_of_excess": one.share, "rejected_because": rejected}
    for name, kind in CATALOGUE.items():
        if name not in result:
            result[name] = {"name": name, "stage": kind.stages[0], "shrink": 0.0, "shrink_ci95": None,
                            "refitted_shrink": 0.0, "parameters": {}, "excited": False,
                            "rejected_because": "these recordings do not excite it"}
    return list(result.values())


def _not_excited(state: _Diagnosis, rounds: list[Round]) -> list[dict[str, str]]:
    tried = {one.name for one in rounds[0].judged}
    return [{"name": name, "needs": kind.needs} for name, kind in CATALOGUE.items()
            if name not in tried and name not in state.without]


def _rms(parts: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(list(parts)) ** 2)))


def _gap(state: _Diagnosis, noise_um: float) -> dict[str, Any]:
    before, after = _rms(state.bench.split(state.first)), _rms(state.bench.split(state.rest))
    stroke = max(float(np.ptp(run.displacement_um)) for run in state.runs)
    return {"rms_um": before, "percent_of_stroke": 100 * before / stroke, "noise_floor_um": noise_um,
            "explained_um": float(np.sqrt(max(before**2 - after**2, 0.0))), "remaining_um": after}


def _where(state: _Diagnosis, gap: Excess, axes: Sequence[localise.Axis], before: Sequence[np.ndarray]
           ) -> dict[str, Any]:
    energy = [float(np.sum(part**2)) for part in before]
    ranked = sorted(range(len(energy)), key=lambda k: -energy[k])
    stages = None
    if state.bench.monitored:
        side = state.bench.of_monitor[state.bench.block]
        ahead = float(np.sum(state.first[side] ** 2))
        whole = ahead + float(np.sum(state.first[~side] ** 2))
        stages = {"before_monitor": ahead / whole, "after_monitor": 1 - ahead / whole}
    if state.chosen:
        stage = " or ".join(dict.fromkeys(
            stage for stage in ([state.chosen[0].effect.stage] if state.bench.monitored
                                else state.chosen[0].effect.stages)))
    elif stages:
        stage = "before the monitor" if stages["before_monitor"] > 0.5 else "after the monitor"
    else:
        stage = "not known"
    return {"stage": stage, "stages": stages, "runs": [state.runs[k].path for k in ranked],
            "axes": {axis.name: axis.to_json() for axis in axes}, "dominant": localise.dominant(axes).name}


def _runs(state: _Diagnosis, gap: Excess, before: Sequence[np.ndarray], after: Sequence[np.ndarray]
          ) -> list[dict[str, Any]]:
    whole = max(float(sum(np.sum(part**2) for part in before)), 1e-300)
    return [{"file": run.path, "digest": run.digest, "samples": len(run),
             "rms_um": {"before": _rms([one]), "after": _rms([other])},
             "offset_um": float(np.mean(run.displacement_um - rig.respond(effects.in_order(state.known)))),
             "noise_floor_um": signals.noise_um(run.displacement_um),
             "percent_of_stroke": 100 * _rms([one]) / float(np.ptp(run.displacement_um)),
             "ratio": None if gap.ratios is None else gap.ratios[k], "share": float(np.sum(one**2)) / whole}
            for k, (run, rig, one, other) in enumerate(zip(state.runs, state.bench.rigs, before, after))]


def _promised(state: _Diagnosis) -> dict[str, Any]:
    """Shrink of the gap's rms by all effects together, in recordings left out in turn."""
    if not state.chosen:
        return {"shrink": None, "ci90": None, "why_no_interval": "no effect was accepted"}
    after = Grams(state.bench, state.rest, [], state.chosen).held_out()
    before = np.bincount(state.bench.block, state.first**2, len(after))
    return {"shrink": _shrink(after, before), "ci90": state.interval(after, before, 90),
            "why_no_interval": None if len(state.runs) > 1 else "one recording shows no spread between recordings"}


def _leftover(state: _Diagnosis, gap: Excess) -> dict[str, Any]:
    """What is left with the effects: against the passport, and whether it still goes with something."""
    left = np.concatenate(state.bench.split(state.rest))
    drive = [run.command_V - np.mean(run.command_V) for run in state.runs]
    signals_ = {"command": drive, "command_squared": [u**2 for u in drive],
                "rate": [np.abs(np.gradient(u)) / run.sample_time_s for u, run in zip(drive, state.runs)],
                "direction": [np.sign(np.gradient(u)) for u in drive]}
    related = {name: float(np.corrcoef(left, np.concatenate(parts))[0, 1]) if np.ptp(np.concatenate(parts)) else 0.0
               for name, parts in signals_.items()}
    spread = float(np.mean(left**2))
    return {"ratio": gap.left(float(np.sum(state.rest**2))) if gap.ratio else None, "correlation": related,
            "kurtosis": float(np.mean(left**4) / spread**2) if spread > 0 else None}


def _matrix(done: Round) -> dict[str, Any]:
    """Share of a true signature (row) that another effect (column) reproduces in these recordings."""
    rank = sorted(range(len(done.judged)), key=lambda k: done.judged[k].left)
    kept = list({done.judged[k].name: k for k in reversed(rank)}.values())
    kept.sort(key=rank.index)
    return {"names": [done.judged[k].name for k in kept],
            "r2": [[_finite(done.reproduced[i, j]) for j in kept] for i in kept]}


# --- intake

GAIN_SPREAD = 3.0  # between the model's um per volt and a recording's
UNITS = 200.0  # ... from which it is a matter of units
MOST_GAP = 0.25  # of the stroke, from which the recordings hardly belong to the model


def _check(model: Model, runs: Sequence[Recording]) -> list[str]:
    """Remarks; raises BadInput for recordings that are not this actuator's, or not in these units."""
    notes = []
    for run in runs:
        intake.check_run(run)
    intake.check_together(runs, [])
    usual = abs(model.gain_um_per_V) * float(model.slopes[-1])
    for run in runs:
        if intake.correlation(run) * model.gain_um_per_V < 0:
            raise BadInput(f"{run.path}: moves opposite to the model; check the sign of command and displacement")
        gain = float(np.ptp(run.displacement_um) / np.ptp(run.command_V))
        times = max(gain / usual, usual / gain)
        if times > UNITS:
            raise BadInput(f"{run.path}: moves {gain:.3g} um/V, the model {usual:.3g}: these are other units; give volts "
                           "at the amplifier's input as at commissioning, and displacement in um (`rdpi import`)")
        if times > GAIN_SPREAD:
            notes.append(f"{run.path} moves {gain:.3g} um/V and the model {usual:.3g}: is it the same actuator?")
        name = run.metadata.get("actuator", "")
        if name and model.actuator and name != model.actuator:
            notes.append(f"{run.path} was recorded from {name}, the model is of {model.actuator}")
        stays = intake.stays_at_an_end(run)
        if stays:
            notes.append(f"{run.path}: {stays} samples stand at the very highest or lowest reading while the command "
                         "moves: a clipped sensor looks like saturation of the amplifier or a curved scale")
        low, high = float(np.min(run.command_V)), float(np.max(run.command_V))
        beyond = max(model.drive.min_V - low, high - model.drive.max_V)
        if beyond > 0.05 * (model.drive.max_V - model.drive.min_V):
            notes.append(f"{run.path}: the command goes {beyond:.3g} V beyond what the model was fitted to")
    if model.passport is None:
        notes.append("the model has no passport: what it always missed cannot be told from what is new; "
                     "fit it again to get one")
    if len(runs) == 1:
        notes.append("one recording only: effects were judged on parts of it that were left out, which promises more "
                     "than other recordings keep; give several with different waveforms")
    return notes


# --- numerics, settled without any data of the actuator's

ENGINES = "f32", "q31"
NUMERIC_SAMPLES = 20_000


def numerics(model: Model, runs: Sequence[Recording]) -> dict[str, Any] | None:
    """How far the compiled inverse's drive in f32 and q31 departs from double, in um rms, at the recorded rate and at
    four times it; None for an engine that refuses the model. The reference is the model's own stroke as recorded.
    """
    run = max(runs, key=lambda one: float(np.ptp(one.displacement_um)))
    reference = signals.smoothed(run.displacement_um, run.sample_time_s, 9 * run.sample_time_s)[:NUMERIC_SAMPLES]
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


def _moved(model: Model, move: np.ndarray) -> Model:
    """The model with its parameters moved as Rig.base_columns counts them, as far as it stays a model."""
    n, law = len(model.slopes), bool(np.any(model.slope_rate_s_per_um))
    top = model.rate.identified_um_per_s or model.rate.max_um_per_s
    for damping in (1.0, 0.5, 0.25, 0.1):
        step = damping * move
        slopes = model.slopes * (1 + step[:n])
        changes = model.slope_rate_s_per_um + (model.slopes * step[n:2 * n] / top if law else 0.0)
        weights = model.deadzone_weights + np.r_[0.0, step[n * (1 + law):]]
        singular = float(np.min(model_guard(slopes, changes))) if np.all(slopes > 0) else 0.0
        guard = min(model.rate.max_um_per_s, effects.GUARD_SLACK * (1 - model.rate.min_slope_ratio) * singular)
        new = replace(model, slopes=slopes, slope_rate_s_per_um=changes, deadzone_weights=weights,
                      rate=replace(model.rate, max_um_per_s=guard,
                                   singular_um_per_s=singular if np.isfinite(singular) else None))
        try:
            new.validate()
            return new
        except BadInput:
            pass
    return model


# --- the next experiment

CANNED: tuple[tuple[str, dict[str, Any]], ...] = (
    ("sawtooth", {"cycles": 2}), ("steps", {"levels": 3, "hold_s": 1.0}), ("steps", {"levels": 2, "hold_s": 5.0}),
    ("minor-loops", {"levels": 4}), ("multisine", {"duration_s": 10.0}), ("sine", {"cycles": 3}),
    ("chirp", {"duration_s": 5.0}), ("startup", {}))
LONGEST = 120_000  # samples of a drive that is simulated


def _next(state: _Diagnosis, rounds: list[Round], verdict: str) -> dict[str, Any] | None:
    """The canned recording that would tell the survivors apart best per second of bench time."""
    if verdict == "unknown":
        return {"command": _command(state, "steps", {"levels": 3, "hold_s": 1.0}), "seconds": None,
                "why": "fast edges and holds in between show what kind of motion is missing; record monitor_V beside it"}
    open_ = next((done for done in rounds if done.rivals), None) if verdict == "ambiguous" else None
    if open_ is None:
        return None
    truth, rivals = open_.best.candidate, open_.rivals
    floor = float(np.mean(state.rest**2))
    best = None
    for kind, options in CANNED:
        try:
            columns, _ = excite.make_drive(kind, _limits(state), **options)
        except BadInput:
            continue
        if len(columns["time_s"]) > LONGEST:
            continue
        seconds = float(columns["time_s"][-1])
        apart = min(_apart(state, truth, rival.candidate, columns) for rival in rivals)
        worth = apart / seconds / max(floor, 1e-300)
        if best is None or worth > best[0]:
            best = worth, apart / len(columns["time_s"]), kind, options, seconds
    if best is None:
        return None
    names = " and ".join([truth.effect.name, *dict.fromkeys(rival.name for rival in rivals)])
    why = f"of the canned recordings it tells {names} apart best per second"
    if best[1] < floor / 4:
        why += "; if it does not, monitor_V beside it will tell what lies before the actuator from what lies after"
    return {"command": _command(state, best[2], best[3]), "why": why, "seconds": best[4]}


def _limits(state: _Diagnosis) -> excite.Limits:
    drive = state.model.drive
    return excite.Limits(drive.min_V, drive.max_V, sample_rate_hz=max(run.sample_rate_hz for run in state.runs),
                         slew_V_per_s=drive.slew_V_per_s)


def _command(state: _Diagnosis, kind: str, options: dict[str, Any]) -> str:
    limits = _limits(state)
    parts = ["rdpi excite", kind, "-o next.csv", f"--min-V {limits.min_V:g}", f"--max-V {limits.max_V:g}",
             f"--sample-rate {limits.sample_rate_hz:g}"]
    if limits.slew_V_per_s is not None:
        parts.append(f"--slew {limits.slew_V_per_s:g}")
    return " ".join(parts + [f"--{excite.OPTION_NAMES[name]} {value:g}" for name, value in options.items()])


def _apart(state: _Diagnosis, truth: Candidate, rival: Candidate, columns: dict[str, np.ndarray]) -> float:
    """Sum of squares that the rival, fitted to it, leaves of what the truth would show in this drive."""
    metadata = {"memory": "reset", "sample_rate_hz": f"{_limits(state).sample_rate_hz:.12g}"}
    drive = Recording("next.csv", metadata, {**columns, "displacement_um": columns["command_V"]})
    rig = candidates.rigs(state.model, [drive])[0]
    shown = rig.respond([Acting(truth.effect, truth.values)])
    if truth.per_run:
        shown = shown + truth.effect.columns(drive, truth.values, state.model) @ _sizes(truth)
    bench = Bench(state.model, [replace(drive, columns={**drive.columns, "displacement_um": shown})])
    before = bench.predict([])
    found = candidates.search(bench, rival.effect, [], before)
    left = bench.measured - before
    return float(np.sum((left if found is None else left - found.change) ** 2))


def _sizes(truth: Candidate) -> np.ndarray:
    """Typical coefficients of a disturbance's columns."""
    size = truth.values.get("amplitude_um") or truth.values.get("um_per_s") or truth.values.get("um_per_degC") or 0.0
    return np.r_[size, np.zeros(truth.slopes.shape[1])][:truth.slopes.shape[1]]
