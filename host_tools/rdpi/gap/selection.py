"""Selection: which effects explain the gap between a model and recordings, and which of them cannot be told apart.

Every effect is fitted to what is not explained yet, with the model frozen and with the model refitted, and judged on
recordings that were left out; the best joins and all that act are fitted together. Thresholds come from simulated
'none' controls (tests/withheld), not from p-values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..data import Recording
from ..errors import BadInput
from ..fit import localise, passport
from ..model import Model
from ..simulate import effects, signals
from ..simulate.effects import CATALOGUE, Acting
from . import candidates
from .candidates import BLOCKS, Bench, Candidate, Grams

MOST = 3  # effects
# --- thresholds, learnt on the tuning set of tests/withheld
DETECTED, DETECTED_FEW = 0.32, 0.55  # evidence from which there is a gap; with few recordings
USUAL_SPREAD = 0.2  # of the passport; a poorer one's ratio counts less
SHRINK_WEIGHT = 1.0  # of the best shrink in that evidence, beside the logarithm of the ratio to the passport
BORN_IN, BORN_IN_FEW = 0.25, 0.45  # shrink that makes an effect where nothing exceeds the passport; few recordings
FEW = 4
FREE = {"thermal_drift": 0.10, "periodic_disturbance": 0.08, "initial_memory": 0.03}  # what disturbances gain anyway
EXCESS = 1.15  # ratio from which something is new, whatever was there before
CLEAR_EXCESS, BESIDE = 1.5, 0.75  # below this ratio, refitting that leaves less than this share of the squares decides
FREE_BESIDE = {**FREE, "static_nonlinearity": 0.2}  # ... and what the plays' own misfit lends, the model refitted
LEAST_SHARE = 0.15  # of the excess that an effect must explain
LEAST_SHRINK = 0.04
FURTHER_EXCESS, FURTHER_SHARE, FURTHER_SHRINK = 1.4, 0.3, 0.06  # what a second and third effect must find and bring
ONE_RATE, LIKE = 3.0, 0.7  # times the slowest recording's rate: less is all one rate; ... and how like they look in it
TWIN, TWIN_SAME = 0.98, 1.0  # ... for one that reproduces so much of its signature: the rest may be the model's misfit
ROUNDED_OFF = 0.005  # of the gap's squares: what a monitor shows of any amplifier beside the effect looked for
SAME = 0.08  # relative excess of the squares left by a rival, below which these recordings cannot tell it
WITHIN = {"static_nonlinearity": "gain_change"}  # effects that hold a simpler one ...
HOLDS = 0.9  # ... which is enough if it explains this share of what they do
SIMPLER = 0.05  # ... that every further parameter must bring
GRID = 1.5  # times the passport's step: a coarser grid is a new one
OLD = 0.5  # times a disturbance's energy: so much in the earlier recordings, and it is not new
WIDEN = 1.3  # of bootstrapped intervals, so that 90 % is 90 %
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
    refitted_ci: tuple[float, float] | None = None
    monitor_left: float = 0.0
    old: bool = False  # a disturbance that the earlier recordings show as well
    rejected: str | None = None

    @property
    def name(self) -> str:
        return self.candidate.effect.name

    def rest(self, refitted: bool) -> float:
        """Sum of squares left, the model refitted or frozen."""
        return self.refitted_left if refitted else self.left

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
    reproduced: np.ndarray  # (candidates, candidates)
    refit_alone: float  # shrink by refitting the model
    refitted: bool  # whether the best was judged with the model refitted
    before: float  # sum of squares before it


class Selection:
    """Which effects act beside a model, and what they leave."""

    def __init__(self, model: Model, runs: Sequence[Recording], earlier: Sequence[Recording], without: Sequence[str],
                 progress: Callable[[float], None]) -> None:
        """`earlier` holds a recording of the same drive for each run, or nothing."""
        self.model, self.runs, self.without, self.progress = model, list(runs), set(without), progress
        self.earlier, self.known = list(earlier), effects.acting(model)
        self.bench = Bench(model, runs, earlier)
        self.chosen: list[Candidate] = []
        self.refused: dict[str, str] = {}  # effects that could not be tried, and why
        self.detection = -np.inf  # the evidence for a gap
        self.rest = self.bench.measured - self.predict()
        self.first, self._given = self.rest, (model, self.bench)
        self._driven: Bench | None = None
        self.before_um = self._missed(self.driven(model))

    def _missed(self, bench: Bench) -> list[np.ndarray]:
        """What the displacement, driven by the command, misses with all that act; per recording, without its mean."""
        return bench.split(bench.measured - self.predict(bench))

    def after_um(self) -> list[np.ndarray]:
        """The same with the effects that were accepted."""
        bench = self.driven(self.model)
        if bench is not self.bench and self.chosen:
            bench.restart(self.acting())
        return self._missed(bench)

    @property
    def samples(self) -> int:
        return sum(self.bench.lengths)

    # --- prediction

    def acting(self, chosen: Sequence[Candidate] | None = None) -> list[Acting]:
        return effects.in_order([*self.known, *(Acting(one.effect, one.values) for one in
                                                (self.chosen if chosen is None else chosen) if not one.per_run)])

    def predict(self, bench: Bench | None = None, chosen: Sequence[Candidate] | None = None) -> np.ndarray:
        """With all that act, disturbances as every recording shows them; also on another bench of the same, or with
        others chosen.
        """
        bench, chosen = bench or self.bench, self.chosen if chosen is None else chosen
        for one in chosen:
            for rig, start_um in zip(bench.rigs if bench is not self.bench else [], one.memory_um or []):
                rig.start(start_um)
        shared = bench.predict(self.acting(chosen))
        disturbances = [*(one for one in self.known if one.effect.disturbance),
                        *(Acting(one.effect, one.values) for one in chosen if one.per_run)]
        own = [bench.join([one.effect.columns(rig.recording, one.values, self.model) for rig in bench.rigs])
               for one in disturbances]
        return shared + (self._fitted(np.hstack(own), bench.measured - shared, bench) if own else 0.0)

    def _fitted(self, columns: np.ndarray, left: np.ndarray, bench: Bench) -> np.ndarray:
        """What the columns take up of what is left, in each recording by itself."""
        result = np.zeros(len(left))
        run = bench.run_of_block[bench.block]
        for k in range(len(self.runs) if columns.shape[1] else 0):
            inside = run == k
            result[inside] = columns[inside] @ np.linalg.lstsq(columns[inside], left[inside], rcond=None)[0]
        return result

    def driven(self, model: Model) -> Bench:
        """The bench of a model that is driven by the command, whether there is a monitor or not."""
        if not self.bench.monitored and model is self.model:
            return self.bench
        if self._driven is None or self._driven.model is not model:
            self._driven = Bench(model, self.runs, self.earlier, monitored=False)
        return self._driven

    def one_rate(self) -> bool:
        """Whether all recordings move about equally fast: a changed loop and one that follows the rate look alike."""
        fast = [float(np.percentile(rig.rate_um_per_s, 95)) for rig in self.bench.rigs]
        return max(fast) < ONE_RATE * min(fast)

    def accept(self, one: Candidate) -> None:
        """Let it act, and fit all that act together."""
        if one.memory_um is not None:
            for rig, start_um in zip(self.bench.rigs, one.memory_um):
                rig.start(start_um)
        self.chosen.append(one)
        if one.memory_um is None:
            self.bench.restart(self.acting())
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
            columns = columns - np.column_stack([self._fitted(taken, column, self.bench) for column in columns.T])
        move = np.linalg.lstsq(columns, target, rcond=1e-9)[0]
        old = [dict(one.values) for one in shared]
        for damping in (1.0, 0.3):
            at = 0
            for one, values in zip(shared, old):
                step = dict(zip(one.free, damping * move[at:at + len(one.free)]))
                moved = candidates.bounded(one.effect, values, step)
                one.values = values if one.effect.refusal(moved) else moved
                at += len(one.free)
            now = float(np.sum((self.bench.measured - self.predict()) ** 2))
            if now < left:
                return left - now > candidates.ENOUGH * left
        for one, values in zip(shared, old):
            one.values = values
        return False

    def forget(self) -> None:
        """Let no effect act."""
        (self.model, self.bench), self.chosen, self.rest = self._given, [], self.first

    def refit(self, one: Candidate, move: np.ndarray) -> None:
        """Move the model's parameters, as Grams.fitted_base has them, and let the effect act beside that model."""
        self.model = candidates.moved(self.model, move)
        self.bench = Bench(self.model, self.runs, self.earlier)
        self.rest = self.bench.measured - self.predict()
        again = candidates.search(self.bench, one.effect, self.acting(), self.bench.measured - self.rest)
        self.accept(again or one)

    # --- one round

    def tried(self) -> list[candidates.Effect]:
        """Every effect of the catalogue that this diagnosis has not added, where it may act."""
        taken = {one.effect.name for one in self.chosen} | self.without
        result = []
        for name, kind in CATALOGUE.items():
            if name not in taken:
                result += kind.variants(self.runs)
        return result

    def round(self, floor: float) -> tuple[list[Judged], Grams]:
        """Every effect fitted and judged; `floor` is the sum of squares to be expected."""
        before = self.bench.measured - self.rest
        acting, found = self.acting(), []
        tried = self.tried()
        for k, effect in enumerate(tried):
            try:
                one = candidates.search(self.bench, effect, acting, before)
            except BadInput as error:  # numbers beyond the library's: the others are tried all the same
                one, self.refused[effect.name] = None, str(error)
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
            kept = min(float(np.sum(within) + np.sum(left)) / 2, max(floor, total - self.grid_noise(one)))
            share = (total - kept) / max(total - floor, 1e-9 * total, 1e-300)
            judged.append(Judged(
                one, kept, shrink_of(left, zero), self.interval(left, zero),
                float(1 - np.sqrt(np.sum(refitted) / lowest)),
                float(np.sum(refitted) + np.sum(refitted_within)) / 2, share,
                self.interval(refitted, min(zero, base, key=np.sum)), float(np.sum(within[side])), self.is_old(one)))
        if self.bench.monitored:
            self._held_by_the_model(judged, acting)
        self.zero, self.base, self.total = zero, base, total
        self.least = min(total, float(np.sum(base) + np.sum(base_within)) / 2)
        return judged, grams

    def _held_by_the_model(self, judged: list[Judged], acting: list[Acting]) -> None:
        """What a monitor shows of the amplifier the model may hold already: only what helps from the command counts."""
        bench = self.driven(self.model)
        plain = bench.predict(acting)
        left = bench.measured - self.predict(bench)
        for one in judged:
            if one.candidate.effect.before_monitor:
                mine = Acting(one.candidate.effect, one.candidate.values)
                change = bench.predict(effects.in_order([*acting, mine])) - plain
                one.shrink = min(one.shrink, shrink_of((left - change) ** 2, left**2))

    def is_old(self, one: Candidate) -> bool:
        """Whether the earlier recordings show a disturbance too, as strong as these or nearly."""
        if not self.earlier or not one.per_run or one.memory_um is not None:
            return False
        then = self.bench.missed_then
        before, now = (float(np.sum(self._fitted(one.slopes, left, self.bench) ** 2)) for left in
                       (then, self.rest + then))
        return before > OLD * now

    def grid_noise(self, one: Candidate) -> float:
        """Sum of squares that a grid of readings leaves: step^2 / 12 a sample, which no prediction takes away.

        A grid that was there at commissioning is part of the passport, and one of the earlier recordings is not new.
        """
        if one.effect.name != "quantisation" or one.effect.stage != "sensor":
            return 0.0
        step_um = one.values["step"]
        before = max([run["step_um"] for run in (self.model.passport or {}).get("runs", [])]
                     + [signals.grid_step(run.displacement_um) for run in self.earlier], default=0.0)
        return self.samples * (step_um**2 - before**2) / 12 if step_um > GRID * before else 0.0

    def excused(self) -> float:
        """What the accepted effects leave whatever is known of them."""
        return sum(map(self.grid_noise, self.chosen))

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
        middle, (low, high) = shrink_of(after, before), np.percentile(drawn, (50 - percent / 2, 50 + percent / 2))
        return float(middle - WIDEN * (middle - low)), float(min(1.0, middle + WIDEN * (high - middle)))


@dataclass
class Excess:
    """The gap against the passport; sums of squares over all samples."""

    total: float
    floor: float
    ratio: float | None  # of rms, None without a passport
    spread: float
    ratios: list[float] | None  # per recording
    expected_um: float | None = None  # rms by the passport

    @property
    def evidence(self) -> float:
        return float(np.log(self.ratio)) * min(1.0, USUAL_SPREAD / max(self.spread, 1e-9)) if self.ratio else 0.0

    def left(self, total: float) -> float:
        """Ratio to the passport of what is left of the squares."""
        return float(np.sqrt(total / max(self.floor, 1e-300)))


def excess(state: Selection, known: dict[str, Any] | None, coords: Sequence[localise.Coordinates]) -> Excess:
    """How far the gap exceeds what the passport expects of these recordings."""
    total = float(np.sum(state.first**2))
    if known is None:
        noise = float(sum(signals.noise_um(part) ** 2 * len(part) for part in state.bench.split(state.first)))
        return Excess(total, noise, None, 0.0, None)
    # From the command, as the passport: what an amplifier always did, the model may hold already.
    found = passport.ratio(known, state.before_um, coords)
    floor = float(np.sum(found.expected_um**2 * state.bench.lengths))
    return Excess(total, min(floor, total), found.overall, found.spread, found.ratio.tolist(),
                  float(np.sqrt(floor / state.samples)))


def select(state: Selection, gap: Excess) -> list[Round]:
    """Forward selection: the best effect joins as long as it explains what is not excused yet."""
    rounds: list[Round] = []
    while len(state.chosen) < MOST:
        floor = gap.floor + state.excused()
        if rounds and np.sum(state.rest**2) - state.excused() < FURTHER_EXCESS**2 * gap.floor:
            break
        judged, grams = state.round(floor)
        best, refitted = _best(judged, state, gap, bool(rounds))
        reproduced = grams.reproduced()
        rivals = _rivals(judged, best, refitted, state, reproduced) if best else []
        if refitted and gap.ratio and gap.ratio > EXCESS:
            # What was there before explains the whole better, and something else what is new.
            rivals += [one for one in judged if one.rejected is None and one.name not in
                       (best.name, *(rival.name for rival in rivals))]
        rounds.append(Round(judged, best, rivals, reproduced, shrink_of(state.base, state.zero), refitted,
                            float(np.sum(state.zero))))
        if best is None:
            break
        if refitted:
            state.refit(best.candidate, grams.fitted_base(judged.index(best)))
        else:
            state.accept(best.candidate)
    return rounds


def detected(state: Selection) -> float:
    return DETECTED_FEW if len(state.runs) < FEW else DETECTED


def _gain(one: Judged, state: Selection) -> float:
    """Shrink beyond what a disturbance gains from nothing; of a grid, what it explains."""
    if state.grid_noise(one.candidate):
        return float(1 - np.sqrt(one.left / max(state.total, 1e-300)))
    return one.shrink - FREE.get(one.name, 0.0)


def _best(judged: list[Judged], state: Selection, gap: Excess, further: bool) -> tuple[Judged | None, bool]:
    """The candidate to accept, if any, and whether the model was refitted beside it."""
    share, shrink = (FURTHER_SHARE, FURTHER_SHRINK) if further else (LEAST_SHARE, LEAST_SHRINK)
    born_in = BORN_IN_FEW if len(state.runs) < FEW else BORN_IN
    evidence = gap.evidence + SHRINK_WEIGHT * max([_gain(one, state) for one in judged if not one.old] + [0.0])
    state.detection = max(state.detection, evidence)
    for one in judged:
        gain = _gain(one, state)
        one.rejected = None
        if one.share <= share or gain <= shrink:
            one.rejected = "explains too little of the gap"
        elif one.candidate.synchronous > 0.5:
            one.rejected = "stands at a frequency of the drive itself"
        elif one.old:
            one.rejected = "was in the earlier recordings as well"
        elif not (gap.ratio and evidence > detected(state)) and min(gain, one.refitted_shrink) < born_in:
            one.rejected = "the gap is no larger than the passport expects"
    open_ = [one for one in judged if one.rejected is None]
    frozen = _simplest(open_, lambda one: one.left) if open_ else None
    # Born in: what the fit took up hides an effect, or half of it, until the model is refitted beside it.
    hidden = [one for one in judged if not further and one.candidate.synchronous <= 0.5 and not one.old
              and one.refitted_shrink - FREE_BESIDE.get(one.name, 0.0) > born_in
              and one.refitted_left < state.least * (1 - born_in)]
    beside = _simplest(hidden, lambda one: one.refitted_left) if hidden else None
    excused = gap.ratio is not None and gap.ratio < CLEAR_EXCESS
    if beside and (frozen is None or excused and beside.refitted_left < BESIDE * frozen.left):
        beside.rejected = None
        return beside, True
    return frozen, False


def _simplest(near: list[Judged], left: Callable[[Judged], float]) -> Judged:
    """The one that leaves least, simpler ones favoured where it makes no difference."""
    lowest = min(map(left, near))
    best = min((one for one in near if left(one) <= lowest * (1 + SAME)),
               key=lambda one: left(one) * (1 + SIMPLER * one.size))
    return next((one for one in near if one.name == WITHIN.get(best.name) and one.share >= HOLDS * best.share), best)


def _rivals(judged: list[Judged], best: Judged, refitted: bool, state: Selection, reproduced: np.ndarray
            ) -> list[Judged]:
    """Those that leave as little as the best: what these recordings cannot tell from it."""
    result = []
    alike = reproduced[judged.index(best)]
    for k, one in enumerate(judged):
        if one is best or one.name == best.name or one.candidate.synchronous > 0.5 or one.old:
            continue
        same = one.rest(refitted) <= (1 + (TWIN_SAME if alike[k] > TWIN else SAME)) * best.rest(refitted)
        ahead = one.candidate.effect.before_monitor and best.candidate.effect.before_monitor
        if same and ahead and state.bench.monitored:
            # A monitor's own noise is small: how an amplifier and its sampling round a delay off is not.
            same = one.monitor_left <= best.monitor_left + max(SAME * best.monitor_left, ROUNDED_OFF * state.total)
        loops = {one.name, best.name} == {"hysteresis_change", "rate_dependence"}
        same |= loops and alike[k] > LIKE and state.one_rate()
        if same and WITHIN.get(one.name) != best.name:
            result.append(one)
    return sorted(result, key=lambda one: one.rest(refitted))


def shrink_of(after: np.ndarray, before: np.ndarray) -> float:
    return float(1 - np.sqrt(np.sum(after) / np.sum(before))) if np.sum(before) > 0 else 0.0
