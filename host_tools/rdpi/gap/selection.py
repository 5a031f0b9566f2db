"""Selection: which effects explain the gap between a model and recordings, and which of them cannot be told apart.

Every effect is fitted to what is not explained yet, with the model frozen and with the model refitted, and scored on
recordings that were left out; the best joins and all that act are fitted together. One such round gives a `Round`,
which is complete and does not change. Thresholds come from simulated 'none' controls (tests/withheld), not from
p-values.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import BadInput
from ..identify import Strokes, localise, passport
from ..model import Model, Passport
from ..simulate import effects, signals
from ..simulate.effects import CATALOGUE, Effect
from . import candidates, thresholds
from .augmented import AugmentedModel
from .candidates import Candidate
from .dataset import BLOCKS
from .normal_equations import NormalEquations

DRAWS = 400  # of the bootstrap
LONG = 25_000  # samples of each recording, from which threads wait for each other less than they work
MANY = 600_000  # samples of all recordings, beyond which threads would take more memory than there may be
THREADS = 4  # at most
NOT_CLEAR = "the gap is not clearly larger than is usual"  # why an effect is rejected
Progress = Callable[[float], None]


# ---- what a round finds ----


@dataclass(frozen=True, eq=False)
class Score:
    """A candidate and what it explains; shrinks are of the rms of recordings that were left out."""

    candidate: Candidate  # slim in a finished round, unless it is the best
    left: float  # sum of squares left, model frozen; mean of leaving recordings out and parts of them
    shrink: float
    shrink_ci: tuple[float, float] | None
    gain: float  # shrink beyond what the effect gains from nothing; of a grid, what it explains
    share: float  # of the excess over the passport
    refitted_shrink: float  # beyond what refitting the model alone brings
    refitted_left: float
    refitted_ci: tuple[float, float] | None
    monitor_left: float
    lost: float  # squares that recordings which were left out lose, of those that others gain
    was_there: bool  # a disturbance that the earlier recordings show as well
    as_usual: bool  # recordings differ by it anyway, by what was before them, and these by no more than usual

    @property
    def effect(self) -> Effect:
        return self.candidate.effect

    @property
    def name(self) -> str:
        return self.effect.name

    @property
    def follows_drive(self) -> bool:
        """Whether it is a line at a frequency of the drive itself."""
        return self.candidate.synchronous > 0.5

    @property
    def is_new(self) -> bool:
        return not (self.was_there or self.as_usual)

    @property
    def at_end(self) -> bool:
        return self.candidate.at_end

    @property
    def size(self) -> int:
        """Parameters, as far as a comparison must pay for them."""
        return len(self.candidate.fitted) or 1 + self.candidate.jacobian.shape[1]

    def rest(self, refitted: bool) -> float:
        """Sum of squares left, the model refitted or frozen."""
        return self.refitted_left if refitted else self.left

    def contains(self, other: Score) -> bool:
        """Whether the other effect is a special case of this one."""
        return type(other.effect) is self.effect.contains


@dataclass(frozen=True, eq=False)
class Baseline:
    """What is left without another effect, of recordings that were left out; sums of squares."""

    frozen: np.ndarray  # (blocks,), the model as it is
    refitted: np.ndarray  # (blocks,), the model fitted anew
    total: float  # the model as it is; mean of leaving recordings out and parts of them
    least: float  # the same, or with the model fitted anew where that leaves less

    @property
    def refit_alone(self) -> float:
        """Shrink by fitting the model anew."""
        return shrink_of(self.refitted, self.frozen)


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the forward selection."""

    scores: tuple[Score, ...]  # of every effect that these recordings excite, at every stage
    rejected: tuple[str | None, ...]  # why, of each
    refused: dict[str, str]  # effects that could not be tried, and why
    baseline: Baseline
    shape: float  # shrink by the best of them, as far as its shape says something
    evidence: float  # for a gap
    best: Score | None  # the one to accept
    refitted: bool  # whether it was scored with the model refitted
    rivals: tuple[Score, ...]  # what cannot be told from it
    reproduced: np.ndarray  # (scores, scores), see NormalEquations.reproduced
    together: np.ndarray  # (scores, scores), see NormalEquations.together
    model_move: np.ndarray | None  # of the model's parameters, where it was refitted

    @property
    def before(self) -> float:
        """Sum of squares before it."""
        return float(np.sum(self.baseline.frozen))

    def why_rejected(self, one: Score) -> str | None:
        return self.rejected[self.scores.index(one)]


@dataclass(frozen=True, eq=False)
class Selection:
    """All rounds, and what they led to."""

    given: AugmentedModel  # without accepted effects
    reached: AugmentedModel  # with the best of every round
    accepted: AugmentedModel  # one of them, by the verdict
    rounds: tuple[Round, ...]
    without: frozenset[str]  # effects that were not to be tried
    states: tuple[AugmentedModel, ...]  # before the first round, and with the best of every further one

    @property
    def detection(self) -> float:
        """The evidence for a gap."""
        return max(done.evidence for done in self.rounds)

    @property
    def refused(self) -> dict[str, str]:
        """Effects that could not be tried, and why."""
        return {name: why for done in self.rounds for name, why in done.refused.items()}

    @cached_property
    def before_um(self) -> list[np.ndarray]:
        """What the displacement, driven by the command, misses; per recording, without its mean."""
        return self.given.residual_um

    @cached_property
    def after_um(self) -> list[np.ndarray]:
        """The same with the accepted effects."""
        return self.accepted.residual_um if self.accepted.chosen else self.before_um

    @property
    def with_starts(self) -> AugmentedModel:
        """What was accepted, with the starts of the memory that the rounds came to; for the means that are left."""
        if self.accepted is self.reached or self.reached.model is not self.given.model:
            return self.accepted
        return replace(self.accepted, dataset=self.reached.dataset, by_command_before=self.reached.by_command)

    def rejecting_all(self) -> Selection:
        """The same with no effect accepted."""
        return replace(self, accepted=self.given)

    def rejecting_last(self) -> Selection:
        """The same without the effect that was accepted last."""
        return replace(self, accepted=self.states[len(self.accepted.chosen) - 1])

    def ended_before_last(self) -> Selection:
        """The same as if the effect that was accepted last had never been found."""
        count = len(self.accepted.chosen) - 1
        state = self.states[count]
        return replace(self, accepted=state, reached=state, rounds=self.rounds[:count], states=self.states[:count + 1])

    def rivals(self, done: Round) -> tuple[Score, ...]:
        """What cannot be told from the best of a round: not what was accepted beside it."""
        others = {one.effect.name for one in self.accepted.chosen} - {done.best.name if done.best else ""}
        return tuple(one for one in done.rivals if one.name not in others)

    def final(self, done: Round) -> Candidate:
        """The best of a round as it was fitted together with those of the others, the model as it was."""
        return done.best.candidate if done.refitted else self.reached.chosen[self.rounds.index(done)]


@dataclass(frozen=True)
class Excess:
    """The gap against the passport; sums of squares over all samples."""

    total: float
    floor: float
    ratio: float | None  # of rms, None without a passport
    spread: float
    ratios: list[float] | None  # per recording
    expected_um: float | None = None  # rms by the passport
    few: bool = False  # recordings that say what is usual, or what is now
    compared: bool = False  # with earlier recordings, which take off what the model misses anyway
    little: float = 0.0  # share of the gap whose shape may be the model's own, because so little moved; 0 to 1
    wanders: float = 0.0  # share that loops which drift may make by what they remember, 0 to 1

    @property
    def trust(self) -> float:
        """What the passport's logarithms count, 0 to 1: those of a poor one less."""
        return min(1.0, thresholds.USUAL_SPREAD / max(self.spread, 1e-9))

    @property
    def evidence(self) -> float:
        return float(np.log(self.ratio)) * self.trust if self.ratio else 0.0

    def evidence_with(self, shape: float) -> float:
        """That for a gap by its size, by a shape that shrinks it by as much, or by both together. Few recordings tell little
        of what size is usual, so that a small one must not hide a shape, and a large one adds less to it. In one or two,
        what is less than usual may have the shape of an effect.
        """
        together = thresholds.TOGETHER_FEW if self.few else 1.0
        less = min(self.evidence, 0.0) if self.is_of(thresholds.FEWEST) else 0.0
        return max(self.evidence, shape + less, together * (self.evidence + shape))

    @property
    def threshold(self) -> float:
        """Evidence from which there is a gap."""
        if self.is_of(1):
            return thresholds.DETECTION_ONE
        return thresholds.DETECTION_FEW if self.few else thresholds.DETECTION

    def is_of(self, count: int) -> bool:
        """Whether so many recordings at most show it, and none from before take off what the model misses anyway."""
        return not self.compared and self.ratios is not None and len(self.ratios) <= count

    @property
    def untold(self) -> float:
        """Share of the gap whose shape says little of what is slow."""
        return max(self.little, self.wanders)

    def told(self, effect: Effect) -> float:
        """What the shape of an effect counts, 0 to 1. Loops that drift wander slowly: nothing else looks like that."""
        return 1 - (self.untold if effect.slow else self.little)

    def is_left_little(self, squares: float) -> bool:
        """Whether what is left calls for no further effect."""
        return squares < thresholds.FURTHER_RATIO**2 * self.floor

    def left(self, total: float) -> float:
        """Ratio to the passport of what is left of the squares."""
        return float(np.sqrt(total / max(self.floor, 1e-300)))


def excess(given: AugmentedModel, known: Passport | None, coords: Sequence[localise.Coordinates]) -> Excess:
    """How far the gap exceeds what the passport expects of these recordings, beside what may go on from before them."""
    total, lengths = float(np.sum(given.residual**2)), given.dataset.lengths
    few = len(given.recordings) < thresholds.FEW
    if known is None:
        noise = float(sum(signals.noise_um(part) ** 2 * len(part) for part in given.dataset.split(given.residual)))
        return Excess(total, noise, None, 0.0, None, few=few)
    # From the command, as the passport: what an amplifier always did, the model may hold already.
    by_command = given.residual_um
    found = passport.ratio(known, [left - past for left, past in zip(by_command, given.past_um(by_command))], coords)
    floor = float(np.sum(found.expected_um**2 * lengths))
    spread = found.spread
    if len(known.runs) < thresholds.FEW and not given.earlier:  # beside these, the passport counts little
        few = True
        if len(found.ratio) >= thresholds.FEW:
            # What has changed shows everywhere; what a model misses of some waveforms only may be as it always was.
            spread = float(np.hypot(spread, np.std(np.log(np.maximum(found.ratio, 1e-9)), ddof=1)))
    squares = np.maximum(found.actual_um**2 * lengths, np.finfo(float).tiny)
    little, wanders = (float(np.average([share(known, at) for at in coords], weights=squares))
                       for share in (passport.too_small, passport.remembered))
    return Excess(total, min(floor, total), found.overall, spread, found.ratio.tolist(),
                  float(np.sqrt(floor / sum(lengths))), few, bool(given.earlier), little,
                  wanders if known.level.drift_um else 0.0)


# ---- rounds ----


def select(given: AugmentedModel, gap: Excess, without: Sequence[str] = (),
           progress: Progress = lambda fraction: None) -> Selection:
    """Forward selection: the best effect joins as long as it explains what is not excused yet."""
    states, rounds = [given], []
    while len(states) <= thresholds.MOST_EFFECTS:
        state = states[-1]
        if rounds and gap.is_left_little(state.squares):
            break
        done = one_round(state, gap, without, progress)
        rounds.append(done)
        if done.best is None:
            break
        states.append(state.accept(done.best.candidate) if done.model_move is None else
                      state.refit(done.best.candidate, done.model_move))
    return Selection(given, states[-1], states[-1], tuple(rounds), frozenset(without), tuple(states))


def one_round(state: AugmentedModel, gap: Excess, without: Sequence[str] = (),
              progress: Progress = lambda fraction: None, guesses: Sequence[Candidate] = ()) -> Round:
    """Every effect fitted and scored, and the best of them chosen. `guesses`: what was found beside others; each fit
    starts from the last one of its effect.
    """
    found, refused = _fit_all(state, state.foreign.union(without), progress, guesses)
    equations = NormalEquations(state.dataset, state.residual, found, state.chosen)
    baseline = _baseline(equations)
    scores = tuple(_score(state, equations, baseline, k, gap) for k in range(len(found)))
    # What a model misses of small movements has a shape, and loops that drift look like creep: that is nothing new.
    shape = max([0.0, *(gap.told(one.effect) * one.gain for one in scores if one.is_new)])
    evidence = gap.evidence_with(shape)
    misplaced: list[Score] = []
    best, refitted, rejected = _choose(state, scores, baseline, gap, evidence, misplaced)
    while best is not None and not refitted and _misplaces(state, best):
        misplaced.append(best)
        best, refitted, rejected = _choose(state, scores, baseline, gap, evidence, misplaced)
    reproduced = equations.reproduced()
    rivals = [] if best is None else \
        [one for one in _rivals(state, scores, baseline, best, refitted, reproduced[scores.index(best)], gap.floor)
         if one not in misplaced]
    if refitted and gap.ratio and gap.ratio > thresholds.NEW_RATIO:
        # What was there before explains the whole better, and something else what is new.
        rivals += [one for one, why in zip(scores, rejected) if why is None and one.name not in
                   (best.name, *(rival.name for rival in rivals))]
    move = equations.refitted_model(scores.index(best)) if refitted else None
    kept = {one: one if one is best else replace(one, candidate=one.candidate.slim()) for one in scores}
    return Round(tuple(kept.values()), rejected, refused, baseline, shape, evidence, best, refitted,
                 tuple(kept[one] for one in rivals), reproduced, equations.together(), move)


def _fit_all(state: AugmentedModel, without: Collection[str], progress: Progress, guesses: Sequence[Candidate]
             ) -> tuple[list[Candidate], dict[str, str]]:
    """Every effect of the catalogue that was not accepted yet, where it may act; and those that cannot be tried."""
    taken, strokes = {one.effect.name for one in state.chosen} | set(without), Strokes.of(state.recordings)
    tried = [effect for name, kind in CATALOGUE.items() if name not in taken for effect in state.places(kind)]
    held = {one.effect for one in state.known}
    found, refused = [], {}
    for k, (effect, one) in enumerate(zip(tried, _searched(state, tried, guesses))):
        if isinstance(one, BadInput):  # numbers beyond the library's: the others are tried all the same
            one, refused[effect.name] = None, str(one)
        # At a single rate, what needs several is gain and phase at will, and passes for anything.
        if one is not None and (effect in held or strokes.show(type(effect))
                                or effect.rings_within(strokes.longest_s, one.values)):
            found.append(one)
        progress((k + 1) / len(tried))
    return found, refused


def _searched(state: AugmentedModel, tried: Sequence[Effect], guesses: Sequence[Candidate]
              ) -> Iterator[Candidate | None | BadInput]:
    """Of each effect what `candidates.search` finds, or raises; of long recordings on all cores."""
    acting, own = state.acting(), threading.local()
    before, plain = state.dataset.measured - state.residual, state.dataset.predict(acting)

    def search(effect: Effect) -> Candidate | None | BadInput:
        if not hasattr(own, "dataset"):
            own.dataset = state.dataset.copied()
        try:
            guess = next((one.values for one in reversed(guesses) if one.effect.is_as(effect)), None)
            return candidates.search(own.dataset, effect, acting, before, plain, guess)
        except BadInput as error:
            return error

    lengths = state.dataset.lengths
    if min(lengths) < LONG or sum(lengths) > MANY or multiprocessing.parent_process():  # `rdpi batch` has one per core
        yield from map(search, tried)
        return
    pool = ThreadPoolExecutor(min(THREADS, os.cpu_count() or 1))
    try:
        yield from pool.map(search, tried)
    finally:
        pool.shutdown(cancel_futures=True)


def _baseline(equations: NormalEquations) -> Baseline:
    frozen, frozen_within = equations.held_out(), equations.held_out(within=True)
    refitted, refitted_within = equations.held_out(refit=True), equations.held_out(refit=True, within=True)
    total = float(np.sum(frozen_within) + np.sum(frozen)) / 2
    least = min(total, float(np.sum(refitted) + np.sum(refitted_within)) / 2)
    return Baseline(frozen, refitted, total, least)


def _score(state: AugmentedModel, equations: NormalEquations, baseline: Baseline, k: int, gap: Excess) -> Score:
    """Of the k-th candidate."""
    floor = gap.floor + state.excused()  # sum of squares to be expected
    one, recordings, total = equations.candidates[k], len(state.recordings), baseline.total
    left, within = equations.held_out(k), equations.held_out(k, within=True)
    refitted, refitted_within = equations.held_out(k, refit=True), equations.held_out(k, refit=True, within=True)
    grid = state.grid_squares(one)
    kept = min(float(np.sum(within) + np.sum(left)) / 2, max(floor, total - grid))
    shrink = shrink_of(left, baseline.frozen)
    lowest = max(min(np.sum(baseline.frozen), np.sum(baseline.refitted)), 1e-300)
    refitted_shrink = float(1 - np.sqrt(np.sum(refitted) / lowest))
    if state.dataset.monitored and (one.effect.before_monitor or state.known and not one.per_run):
        from_command = _shrink_from_command(state, one)
        shrink, refitted_shrink = min(shrink, from_command), min(refitted_shrink, from_command if state.known else 1.0)
    return Score(
        candidate=one, left=kept, shrink=shrink, shrink_ci=shrink_interval(left, baseline.frozen, recordings),
        gain=float(1 - np.sqrt(kept / max(total, 1e-300))) if grid else shrink - one.effect.chance_gain[0],
        share=(total - kept) / max(total - floor, 1e-9 * total, 1e-300),
        refitted_shrink=refitted_shrink,
        refitted_left=float(np.sum(refitted) + np.sum(refitted_within)) / 2,
        refitted_ci=shrink_interval(refitted, min(baseline.frozen, baseline.refitted, key=np.sum), recordings),
        monitor_left=float(np.sum(within[state.dataset.of_monitor])),
        lost=_lost(left, baseline.frozen, state.dataset.run_of_block), was_there=state.was_there(one),
        as_usual=one.effect.differs_anyway and gap.ratio is not None and gap.ratio < 1 or
        _goes_on(state, one, floor))


def _goes_on(state: AugmentedModel, one: Candidate, floor: float) -> bool:
    """Whether it explains too little beside what may go on from before the recordings; `floor` is what they leave anyway."""
    if not np.any(state.past):
        return False
    rest = state.residual - state.past
    explained = float(rest @ one.change) ** 2 / max(float(one.change @ one.change), 1e-300)
    return explained <= thresholds.LEAST_SHARE * max(float(rest @ rest) - floor, 0.0)


def _lost(after: np.ndarray, before: np.ndarray, run_of_block: np.ndarray) -> float:
    """What recordings that were left out are predicted worse, as a share of what others are predicted better, or of the
    least that an effect must bring; squares.
    """
    more = np.bincount(run_of_block, after - before)
    gained = max(float(np.sum(np.maximum(-more, 0.0))), thresholds.LEAST_SHARE * float(np.sum(before)), 1e-300)
    return float(np.sum(np.maximum(more, 0.0))) / gained


def _shrink_from_command(state: AugmentedModel, one: Candidate) -> float:
    """What a monitor shows of the amplifier the model may hold already: only what helps from the command counts."""
    left = np.concatenate(state.residual_um)
    change = state.by_command.predict(effects.beside(state.acting(), one.acting)) - state.predicted_by_command
    return shrink_of((left - change) ** 2, left**2)


# ---- rules ----


def _choose(state: AugmentedModel, scores: Sequence[Score], baseline: Baseline, gap: Excess, evidence: float,
            misplaced: Collection[Score]) -> tuple[Score | None, bool, tuple[str | None, ...]]:
    """The score to accept, if any, whether the model was refitted beside it, and why each of the others was not."""
    born_in = thresholds.BORN_IN_FEW if len(state.recordings) < thresholds.FEW else thresholds.BORN_IN
    born_in += min(1.0, gap.untold / thresholds.TOO_SMALL) ** 2 * (1 - born_in)
    clear = bool(gap.ratio and evidence > gap.threshold)
    if gap.is_of(1) and not clear:  # a model that is refitted to one recording fits that one
        born_in = 1.0
    rejected = ["the recordings do not lie where it would take them" if one in misplaced else
                _why_rejected(one, bool(state.chosen), clear, born_in) for one in scores]
    open_ = [one for one, why in zip(scores, rejected) if why is None]
    frozen = _simplest(open_, False, state.dataset.monitored) if open_ else None
    # Born in: what the fit took up hides an effect, or half of it, until the model is refitted beside it.
    hidden = [one for one in scores if not state.chosen and not one.follows_drive and one.is_new and not one.at_end
              and one.refitted_shrink - one.effect.chance_gain[1] > born_in
              and one.refitted_left < baseline.least * (1 - born_in)]
    beside = _simplest(hidden, True, state.dataset.monitored) if hidden else None
    excused = gap.ratio is not None and gap.ratio < thresholds.CLEAR_RATIO
    if beside and (frozen is None or excused and beside.refitted_left < thresholds.BESIDE * frozen.left):
        return beside, True, tuple(None if one is beside else why for one, why in zip(scores, rejected))
    return frozen, False, tuple(rejected)


def _misplaces(state: AugmentedModel, one: Score) -> bool:
    """Whether recordings after a sweep lie where the model says without the effect, and all elsewhere with it."""
    if not one.effect.tells_zero or state.earlier:
        return False
    runs = [run for run in state.by_command.model_runs if run.recording.memory == "reset"]
    without, beside = (np.array([run.mean_residual_um(acting) for run in runs]) for acting in (
        state.acting(), effects.beside(state.acting(), one.candidate.acting)))
    return len(runs) > 1 and not zeros_agree(state.model, without) and zeros_agree(state.model, beside) \
        and abs(np.mean(beside)) > abs(np.mean(without))


def zeros_agree(model: Model, zeros: np.ndarray, compared: bool = False) -> bool:
    """Whether recordings lie off by the same, beyond what zeros scatter by: these, those of the passport unless the
    recordings are `compared` with earlier ones, and usual ones.
    """
    known = None if compared else passport.read(model)
    before = [run.offset_um for run in known.runs if run.offset_um is not None] if known else []
    groups = [group for group in (zeros, before) if len(group) > 1]
    squares = (thresholds.ZERO_SCATTER * model.stroke_um) ** 2 + sum(np.var(group) * len(group) for group in groups)
    scatter_um = np.sqrt(squares / (1 + sum(len(group) - 1 for group in groups)))
    return bool(abs(np.mean(zeros)) > thresholds.ZERO_AGREES * scatter_um)


def _why_rejected(one: Score, further: bool, clear: bool, born_in: float) -> str | None:
    """Why it is not accepted with the model frozen; None: nothing speaks against it. `clear`: there is a gap."""
    if one.as_usual:
        return "recordings of an unchanged rig may differ by as much"
    share, shrink = (thresholds.FURTHER_SHARE, thresholds.FURTHER_SHRINK) if further else \
        (thresholds.LEAST_SHARE, thresholds.LEAST_SHRINK)
    if one.share <= share or one.gain <= shrink:
        return "explains too little of the gap"
    if one.lost > thresholds.WORSE_LEFT_OUT:
        return "recordings that were left out may as well be predicted worse"
    if one.follows_drive:
        return "lies at a frequency of the drive itself"
    if one.at_end:
        return "its value would lie beyond what rigs have"
    if one.was_there:
        return "was already in the earlier recordings"
    if not clear and min(one.gain, one.refitted_shrink) < born_in:
        return NOT_CLEAR
    return None


def _simplest(near: Sequence[Score], refitted: bool, monitored: bool) -> Score:
    """The one that leaves least, simpler ones favoured where it makes no difference; of an effect at several stages that
    nothing tells apart, the first.
    """
    lowest = min(one.rest(refitted) for one in near)
    equal = [one for one in near if one.rest(refitted) <= lowest * (1 + thresholds.RIVAL_MARGIN)]
    best = min(equal, key=lambda one: one.rest(refitted) * (1 + thresholds.SIMPLER * one.size))
    if not monitored and not best.effect.shows_stage:
        best = next(one for one in equal if one.name == best.name and one.effect.column == best.effect.column)
    return next((one for one in near if best.contains(one) and one.share >= thresholds.CONTAINED * best.share), best)


def _rivals(state: AugmentedModel, scores: Sequence[Score], baseline: Baseline, best: Score, refitted: bool,
            reproduced: np.ndarray, floor: float) -> list[Score]:
    """Those that leave as little as the best: what these recordings cannot tell from it.

    What the model missed anyway, `floor`, may favour a wrong one unless earlier recordings take it off.
    """
    without = baseline.least if refitted else baseline.total
    share = 0.0 if state.dataset.earlier else thresholds.LACKING
    result, lacking = [], share * min(floor, max(0.0, without - best.rest(refitted)))
    for one, r2 in zip(scores, reproduced):
        if one.name == best.name or one.follows_drive or one.was_there or one.at_end or one.contains(best):
            continue
        more = thresholds.TWIN_MARGIN if r2 > thresholds.TWIN else thresholds.RIVAL_MARGIN
        same = one.rest(refitted) <= (1 + more) * best.rest(refitted) + lacking
        ahead = one.effect.before_monitor and best.effect.before_monitor
        if same and ahead and state.dataset.monitored:
            # A monitor's own noise is small: how an amplifier and its sampling round a delay off is not.
            margin = max(thresholds.RIVAL_MARGIN * best.monitor_left, thresholds.ROUNDED_OFF * baseline.total)
            same = one.monitor_left <= best.monitor_left + margin
        loops = one.effect.changes_loops and best.effect.changes_loops
        same |= loops and r2 > thresholds.ALIKE_LOOPS and _one_rate(state)
        if same:
            result.append(one)
    return sorted(result, key=lambda one: one.rest(refitted))


def _one_rate(state: AugmentedModel) -> bool:
    """Whether all recordings move about equally fast: a changed loop and one that follows the rate look alike."""
    fast = [float(np.percentile(one.rate_um_per_s, 95)) for one in state.dataset.model_runs]
    return max(fast) < thresholds.ONE_RATE * min(fast)


# ---- shrinks ----

def equations_of(state: AugmentedModel) -> NormalEquations:
    """Of the effects that act, all fitted together."""
    return NormalEquations(state.dataset, state.residual, [], state.chosen)



def shrink_of(after: np.ndarray, before: np.ndarray) -> float:
    """1 - rms after / rms before, of sums of squares."""
    return float(1 - np.sqrt(np.sum(after) / np.sum(before))) if np.sum(before) > 0 else 0.0


def shrink_interval(after: np.ndarray, before: np.ndarray, recordings: int) -> tuple[float, float] | None:
    """95 % interval of the shrink: recordings drawn anew, then their blocks; widened. None for a single recording."""
    return None if recordings < 2 else _drawn_interval(after, before, recordings, 95, thresholds.WIDEN)


def promised_interval(after: np.ndarray, before: np.ndarray, recordings: int) -> tuple[float, float] | None:
    """90 % interval of the shrink of new recordings of these kinds. None for a single recording.

    Few recordings drawn anew scatter less than new ones, by the variance about their own mean and Student's t.
    """
    from scipy.special import ndtri, stdtrit

    if recordings < 2:
        return None
    few = float(np.sqrt(recordings / (recordings - 1)) * stdtrit(recordings - 1, 0.95) / ndtri(0.95))
    return _drawn_interval(after, before, recordings, 90, max(thresholds.WIDEN, thresholds.WIDEN_FEW * few))


def _drawn_interval(after: np.ndarray, before: np.ndarray, recordings: int, percent: float, widen: float
                    ) -> tuple[float, float]:
    sides = len(after) // (recordings * BLOCKS)
    pairs = np.stack([after, before]).reshape(2, recordings, sides, BLOCKS).sum(axis=2)
    random = np.random.default_rng(0)
    runs = random.integers(recordings, size=(DRAWS, recordings))
    blocks = random.integers(BLOCKS, size=(DRAWS, recordings, BLOCKS))
    sums = pairs[:, runs[:, :, None], blocks].sum(axis=(2, 3))
    drawn = 1 - np.sqrt(sums[0] / np.maximum(sums[1], 1e-300))
    middle, (low, high) = shrink_of(after, before), np.percentile(drawn, (50 - percent / 2, 50 + percent / 2))
    return float(middle - widen * (middle - low)), float(min(1.0, middle + widen * (high - middle)))
