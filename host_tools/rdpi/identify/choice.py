"""Choice: which effects stand around the operator, and whether its slopes depend on the rate.

Every hypothesis is fitted whole (joint.py) and judged on recordings that were left out in turn, or on parts of the only
one. An effect stays if what was left out is predicted better by more than the standard error of that (the
one-standard-error rule, Breiman et al. 1984; two errors where the actuator would be plain without it), and by enough to
matter. Of hypotheses that nothing tells apart the one with the fewest parameters is taken.

The search goes forward from the plain operator, then backward. It goes backward once more from all effects together,
because two of them may hide a third: a resonance is found where it is only if delay and lag are there. Where a resonance
behind a delay explains much at once, it also goes forward from both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..simulate.effects import Acting, Effect, Residuals
from . import thresholds as tuned
from .hypothesis import Hypothesis, Setting, Unknowns, bounds, shifted
from .joint import Linearised, refined

STARTS = 3  # of an effect's starts, of which derivatives are taken
FIRST_STEPS = 3  # of Levenberg and Marquardt for one effect, where all effects together follow
FULL_STEPS = 20  # for all effects together

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Judged:
    """A hypothesis fitted, and the squares that it leaves in each block by what was fitted without it."""

    state: Linearised
    held_out: np.ndarray  # (foldings, blocks)
    _tried: list[tuple[Hypothesis, Judged]] = field(default_factory=list)

    def trying(self, hypothesis: Hypothesis) -> Judged:
        """Another hypothesis, fitted from here; what was tried before is not fitted again."""
        for tried, found in self._tried:
            if tried == hypothesis:
                return found
        self._tried.append((hypothesis, judged(self.state.setting, hypothesis, self.state.found)))
        return self._tried[-1][1]

    @property
    def hypothesis(self) -> Hypothesis:
        return self.state.hypothesis

    @property
    def left(self) -> float:
        """Squares, mean of the ways to leave out."""
        return squares_of(self.held_out)

    @property
    def rms_um(self) -> float:
        """Held out."""
        setting = self.state.setting
        return setting.model.stroke_um * float(np.sqrt(self.left / setting.samples))

    def beats(self, other: Judged) -> bool:
        """Whether it leaves less than the other, by more than the standard error and by enough to matter, however
        blocks are left out.

        What comes late at the end of what rigs have is something else: slow parts of a loop look like that. A resonance
        with the most damping rings no more: it only comes late.

        What first says that the displacement comes late must show more than what comes beside it: without it the
        actuator is plain, and what the operator cannot show may look a little late. In the place of a rate law it must
        show less, but as certainly: neither actuator is plain.

        The error is that of the blocks' gains over what they leave. Fast blocks show a lag a thousand times as strongly
        as slow ones, and the scatter of the gains themselves would be as large as their sum. Where far less is left
        than usual, a loss is none.
        """
        gain, usual = other.held_out - self.held_out, np.mean(self.held_out, axis=1, keepdims=True)
        both = np.maximum(other.held_out + self.held_out + usual, np.finfo(float).tiny)
        beside = self.hypothesis.beside(other.hypothesis)
        late = [one for one in beside if one.effect.comes_late]
        further = beside and (other.hypothesis.comes_late or not late)
        if late and all(one in self.state.at_ends for one in late) or any(
                one.effect.rings and one in self.state.at_most for one in beside):
            return False
        instead = other.hypothesis.rated and not self.hypothesis.rated
        share, errors = (tuned.FURTHER_GAIN if further else tuned.INSTEAD_GAIN if late and instead else
                         tuned.FIRST_GAIN)
        gained, before = np.sum(gain, axis=1), np.sum(other.held_out, axis=1)
        certain = np.mean(gain / both, axis=1) > errors * np.std(gain / both, axis=1, ddof=1) / np.sqrt(gain.shape[1])
        matters = gained > np.maximum(share * before, tuned.CHAIN_LEAST**2 * self.state.setting.samples)
        least = max((one.effect.least_gain(one.values) for one in beside), default=0.0)
        return bool(np.all(certain & matters) and np.sum(gained) > least * np.sum(before))

    def is_better(self, other: Judged) -> bool:
        """Whether it beats the other, or leaves less with no more parameters."""
        return self.beats(other) or self.left < other.left and self.hypothesis.size <= other.hypothesis.size


@dataclass(frozen=True, eq=False)
class Kept:
    """An effect that stays."""

    acting: Acting
    ci95: dict[str, tuple[float, float]]  # of its parameters; empty before `with_intervals`
    without: Judged  # the others fitted without it
    confusable_with: tuple[str, ...]  # effects that would do as well in its place
    stage_shown: bool = False  # by monitor_V

    @property
    def of_amplifier(self) -> bool:
        """Whether monitor_V showed it. Left out, it hides behind what else comes late: what it brings is its stage."""
        return self.stage_shown and self.acting.effect.before_monitor


@dataclass(frozen=True, eq=False)
class Choice:
    """What stands around the operator."""

    plain: Judged  # the operator alone
    found: Judged
    kept: tuple[Kept, ...]  # in the order of the chain
    perhaps: Judged | None = None  # all effects together, where they leave far less than what was found, but not for certain

    @property
    def may_be_there(self) -> list[str]:
        """Names of these that were not found, and are neither nothing nor late by as much as rigs have at most."""
        if self.perhaps is None:
            return []
        state, there = self.perhaps.state, [one.effect for one in self.found.hypothesis.acting]
        return [one.effect.name for one in state.hypothesis.acting if one.effect not in there and not one.does_nothing
                and not (one.effect.comes_late and one in state.at_ends)]

    def percent(self, rms_um: float) -> float:
        """Of the stroke."""
        return 100 * rms_um / self.plain.state.setting.model.stroke_um


def squares_of(held_out: np.ndarray) -> float:
    return float(np.mean(np.sum(held_out, axis=1)))


def judged(setting: Setting, hypothesis: Hypothesis, unknowns: Unknowns) -> Judged:
    state = refined(setting, hypothesis, unknowns)
    return Judged(state, state.held_out())


def choose(setting: Setting, unknowns: Unknowns, candidates: Sequence[Effect], rate_law: bool,
           progress: Progress = lambda fraction: None) -> Choice:
    """The best hypothesis of these effects and, if wanted, a rate law; `candidates` start with the simplest."""
    plain = judged(setting, Hypothesis(), unknowns)
    grown = _grown(plain, candidates, rate_law, lambda share: progress(0.5 * share))
    now = _pruned(grown, rate_law)
    now = _late_instead(plain, now, candidates)
    now = _late_first(plain, now, candidates, rate_law)
    progress(0.6)
    full = _full(now, candidates)
    if full.beats(now):
        whole, full = full, _pruned(full, rate_law, than=now)
        if not full.is_better(now) and now.left - whole.left > tuned.FAR_LESS * now.left:  # more than looks a little late
            full = _pruned(whole, rate_law, than=now, late_counts=True)
        now = full if full.is_better(now) else now
    progress(0.8)
    now, compared = _exchanged(now, candidates)
    for _ in candidates:  # what was exchanged may show more
        if now is grown or (grown := _grown(now, candidates, rate_law)) is now:
            break
        now, compared = _exchanged(_pruned(grown, rate_law), candidates)
    matters = max(tuned.FAR_LESS * now.left, tuned.CHAIN_LEAST**2 * setting.samples)
    return Choice(plain, now, tuple(_kept(now, compared)), full if now.left - full.left > matters else None)


def forced(setting: Setting, unknowns: Unknowns, candidates: Sequence[Effect], rate_law: bool) -> Choice:
    """All of these effects, wanted by name, whether they bring something or not."""
    plain = judged(setting, Hypothesis(), unknowns)
    now = _full(plain, candidates, whatever=True)
    rated = now.trying(replace(now.hypothesis, rated=True)) if rate_law else now
    now = rated if rated.beats(now) else now
    return Choice(plain, now, tuple(_kept(now, _compared(now, ()))))


def refitted(choice: Choice, setting: Setting) -> Choice:
    """The choice made with thinned recordings, and what it was compared with, fitted to the whole ones, `setting`.
    Without effects that do nothing there.
    """
    idle: set[str] = set()

    def again(one: Judged) -> Judged:
        acting = tuple(here for here in one.hypothesis.acting if here.effect.name not in idle)
        if one.state.setting is setting and len(acting) == len(one.hypothesis.acting):
            return one
        return judged(setting, replace(one.hypothesis, acting=acting), one.state.found)

    found = again(choice.found)
    while still := {one.effect.name for one in found.hypothesis.acting if one.does_nothing}:
        idle |= still
        found = again(found)
    plain = found if choice.found is choice.plain else again(choice.plain)
    kept = (one for one in choice.kept if one.acting.effect.name not in idle)
    return Choice(plain, found, tuple(
        replace(one, acting=acting, without=again(one.without)) for one, acting in zip(kept, found.hypothesis.acting)),
        choice.perhaps)


def without_rate_law(choice: Choice, candidates: Sequence[Effect]) -> Choice:
    """The same effects where the model shall have no rate law, which only took part so that none passes for it; or what
    grows without one, if that comes late and leaves less than the law did.
    """
    now = choice.found.trying(replace(choice.found.hypothesis, rated=False))
    if not now.hypothesis.comes_late:
        other = _pruned(_grown(choice.plain, candidates, False), False)
        now = other if other.hypothesis.comes_late and other.left < choice.found.left else now
    return Choice(choice.plain, now, tuple(_kept(now, _compared(now, candidates))))


def with_rate_filter(choice: Choice, settings: Sequence[Setting], candidates: Sequence[Effect]) -> Choice:
    """A rate law whose rate passes a low-pass, alone or beside the effects, if that leaves less than what was found.

    `settings` differ in the low-pass. An actuator whose loops need time to open after a reversal looks like one that is
    late, as long as all reversals are alike.
    """
    now = choice.found
    alone = min((judged(setting, Hypothesis(rated=True), choice.plain.state.found) for setting in settings),
                key=lambda one: one.left)
    best = alone
    if now.hypothesis.acting:
        beside = judged(alone.state.setting, replace(now.hypothesis, rated=True), now.state.found)
        best = beside if beside.beats(alone) else alone
    if not best.beats(now):
        return choice
    return Choice(choice.plain, best, tuple(_kept(best, _compared(best, candidates))))


def with_intervals(choice: Choice, candidates: Sequence[Effect], rate_law: bool) -> Choice:
    """The same with intervals of the parameters; `rate_law`: the recordings can tell of one."""
    return replace(choice, kept=tuple(
        replace(one, ci95=ci95) for one, ci95 in zip(choice.kept, _intervals(choice.found, candidates, rate_law))))


def starts(state: Linearised, effect: Effect) -> list[Acting]:
    """Where a fit of an effect may start beside those that act: its most promising starts; none: it is not excited."""
    found = [shifted(Acting(effect, {**effect.absent(), **values}), dict.fromkeys(effect.fitted, 0.0))
             for values in effect.starts(state.residuals)]
    return found if len(found) <= STARTS else sorted(found, key=lambda one: -_explained(one, state.residuals))[:STARTS]


def _explained(one: Acting, seen: Residuals) -> float:
    """Squares that any multiple of its change takes away."""
    across = energy = 0.0
    for run, predicted, miss in zip(seen.runs, seen.predicted_um, seen.residual_um):
        change = one.effect.displacement(predicted, run, one.values, seen.model) - predicted
        change = change - np.mean(change)
        across, energy = across + float(change @ miss), energy + float(change @ change)
    return across**2 / energy if energy > 0 else 0.0


def _absent(state: Linearised, candidates: Sequence[Effect]) -> list[Effect]:
    names = {one.effect.name for one in state.hypothesis.acting}
    return [effect for effect in candidates if effect.name not in names]


def _to_first_order(state: Linearised, candidates: Sequence[Effect]) -> dict[str, tuple[float, Hypothesis]]:
    """Squares left, and the hypothesis, with each of these effects that the recordings excite, at its best start."""
    wide = Linearised(state.setting, state.hypothesis, state.found,
                      [start for effect in candidates for start in starts(state, effect)])
    first: dict[str, tuple[float, Hypothesis]] = {}
    for k, one in enumerate(wide.joins):
        left = squares_of(wide.held_out(join=k))
        if left < first.get(one.effect.name, (np.inf, None))[0]:
            first[one.effect.name] = left, state.hypothesis.having(one)
    return first


def _grown(now: Judged, candidates: Sequence[Effect], rate_law: bool, progress: Progress = lambda fraction: None
           ) -> Judged:
    """With all that helps, one after the other."""
    rounds = 0
    while (better := _joined(now, candidates, rate_law)) is not None:
        now, rounds = better, rounds + 1
        progress(rounds / (1 + len(candidates)))
    return now


def _late_instead(plain: Judged, now: Judged, candidates: Sequence[Effect]) -> Judged:
    """What grows without a rate law, where one was taken and nothing that comes late: if that leaves far less.

    The law stands for all that comes late, as far as that goes. Each such effect alone hardly leaves less than it does.
    """
    if not now.hypothesis.rated or now.hypothesis.comes_late:
        return now
    other = _pruned(_grown(plain, candidates, False), False)
    enough = other.hypothesis.comes_late and other.left < (1 - tuned.FIRST_GAIN[0]) * now.left
    return other if enough and other.beats(now) else now


def _ringing_late(plain: Linearised, candidates: Sequence[Effect]) -> list[Hypothesis]:
    """A resonance behind what is late by a time, where both together may start; none: nothing rings, or nothing is late."""
    late = next((one for one in candidates if one.late_by), None)
    return [Hypothesis().having(Acting(late, {**late.absent(), late.late_by: late_s})).having(Acting(effect, values))
            for effect in candidates if late for values, late_s in effect.late_starts(plain.residuals)]


def ringing_late(plain: Linearised, candidates: Sequence[Effect]) -> Linearised:
    """A resonance behind what is late by a time, if it leaves less."""
    both = (refined(plain.setting, one, plain.found) for one in _ringing_late(plain, candidates))
    return min([plain, *both], key=lambda one: one.squares)


def _late_first(plain: Judged, now: Judged, candidates: Sequence[Effect], rate_law: bool) -> Judged:
    """What grows from a resonance behind what is late by a time: if that leaves less.

    A resonance that is found first rings out of step by what comes late. It then has a frequency a little off, from which
    no step leads to both; or none of the two is found.
    """
    for other in map(plain.trying, _ringing_late(plain.state, candidates)):
        if other.left < tuned.OUT_OF_STEP * now.left:
            other = _pruned(_grown(other, candidates, rate_law), rate_law)
            now = other if other.is_better(now) else now
    return now


def _joined(now: Judged, candidates: Sequence[Effect], rate_law: bool) -> Judged | None:
    """With the effect that helps most, or the simplest of those that help as much; None: none helps."""
    state, absent = now.state, _absent(now.state, candidates)
    parted = _all_parted(state.hypothesis, absent)
    first = _to_first_order(state, [effect for effect in absent if not (parted and effect.late_by)])
    if rate_law and not state.hypothesis.rated:
        first[""] = squares_of(state.held_out(rated=True)), replace(state.hypothesis, rated=True)
    # A rate law moves delays and lags too far for the first order to say what it brings.
    promising = [hypothesis for name, (left, hypothesis) in first.items()
                 if left < (1 - tuned.FURTHER_GAIN[0]) * now.left or not name]
    fitted = [one for one in map(now.trying, [*promising, *parted]) if one.beats(now)]
    if not fitted:
        return None
    best = min(fitted, key=lambda one: one.left)
    return min((one for one in fitted if not best.beats(one)), key=lambda one: (one.hypothesis.size, one.left))


def _all_parted(hypothesis: Hypothesis, absent: Sequence[Effect]) -> list[Hypothesis]:
    """Each effect that is late by a time parted with each absent one that is."""
    return [_parted(hypothesis, one, effect) for one in hypothesis.acting if one.effect.late_by
            for effect in absent if effect.late_by]


def _parted(hypothesis: Hypothesis, one: Acting, effect: Effect) -> Hypothesis:
    """With another effect that is late by a time, which takes half of this one's: to first order they are the same."""
    half = one.values[one.effect.late_by] / 2
    less = Acting(one.effect, {**one.values, one.effect.late_by: half})
    return hypothesis.lacking(one).having(less).having(Acting(effect, {**effect.absent(), effect.late_by: half}))


def _full(now: Judged, candidates: Sequence[Effect], whatever: bool = False) -> Judged:
    """With every effect that the recordings excite and that leaves less, or `whatever` it leaves: one after the other
    and then all together.
    """
    state, absent = now.state, _absent(now.state, candidates)
    if whatever:
        state = ringing_late(state, candidates)
    for effect in [*absent, *absent]:  # what hides one that comes before it may be there by the second time
        if any(one.effect is effect for one in state.hypothesis.acting):
            continue
        found = starts(state, effect)
        if not found:
            continue
        wide = Linearised(state.setting, state.hypothesis, state.found, found)
        k = min(range(len(found)), key=lambda k: squares_of(wide.held_out(join=k)))
        there = refined(state.setting, state.hypothesis.having(found[k]), state.found, FIRST_STEPS)
        if whatever and there.squares > state.squares:  # no start is near: from where it does hardly anything
            idle = shifted(Acting(effect, effect.absent()), dict.fromkeys(effect.fitted, 0.0))
            there = min(there, refined(state.setting, state.hypothesis.having(idle), state.found, FIRST_STEPS),
                        key=lambda one: one.squares)
        if whatever or there.squares < state.squares:
            state = there
    state = refined(state.setting, state.hypothesis, state.found, FULL_STEPS)
    return Judged(state, state.held_out())


def _smaller(state: Linearised, rate_law: bool) -> Iterator[Hypothesis]:
    """The rate law left out; each effect left out, or a rate law in the place of the only one that comes late; what
    harms least first.
    """
    hypothesis = state.hypothesis
    if hypothesis.rated:
        yield replace(hypothesis, rated=False)

    def without(one: Acting) -> float:
        """Squares that are left."""
        absent = Acting(one.effect, {**one.values, **one.effect.absent()})
        return state.trial([absent if other is one else other for other in hypothesis.acting])[1]

    for one in sorted(hypothesis.acting, key=without):
        less = hypothesis.lacking(one)
        yield less
        if rate_law and not less.rated and hypothesis.comes_late and not less.comes_late:
            yield replace(less, rated=True)


def _pruned(now: Judged, rate_law: bool, than: Judged | None = None, late_counts: bool = False,
            whole: Judged | None = None) -> Judged:
    """Without what does not help, neither beside the others nor all that is left out together: `whole` has it. What is left
    stays better `than` something: of two effects that only help together, one may leave no trace of that. What comes late
    is no reason to stay, unless it counts: beside others, any actuator looks a little late.
    """
    whole = whole or now
    for hypothesis in _smaller(now.state, rate_law):
        less = now.trying(hypothesis)
        if not now.beats(less) and not whole.beats(less) and (
                than is None or now.hypothesis.comes_late and not late_counts or less.is_better(than)):
            return _pruned(less, rate_law, than, late_counts, whole)
    return now


def _intervals(now: Judged, candidates: Sequence[Effect], rate_law: bool) -> list[dict[str, tuple[float, float]]]:
    """95 % intervals of the parameters of each effect, within bounds; none for one at a bound.

    Beside the scatter from block to block counts how far the parameter moves

    - with a rate law, or without the one there is: no law is quite that of an actuator, and what it leaves goes into
      the parameters;
    - with another effect that is late by a time beside it, where nothing says that it is not there.
    """
    laws = [now.trying(replace(now.hypothesis, rated=not now.hypothesis.rated))] if rate_law else []
    parted = [other for other in map(now.trying, _all_parted(now.hypothesis, _absent(now.state, candidates)))
              if not now.beats(other)]
    found = []
    for one, errors in zip(now.hypothesis.acting, now.state.errors()):
        ends = {}
        for name, error in errors.items():
            value = one.values[name]
            moved, apart = (max((abs(_value(other, one, name) - value) for other in others), default=0.0)
                            for others in (laws, parted))
            reach = float(np.hypot(tuned.CHAIN_WIDEN * 1.96 * np.hypot(error, moved), apart))
            low, high = np.clip([value - reach, value + reach], *bounds(one, name))
            ends[name] = float(low), float(high)
        found.append(ends)
    return found


def _value(judged: Judged, one: Acting, name: str) -> float:
    """Of a parameter of an effect that acts there, too."""
    return next(other.values[name] for other in judged.hypothesis.acting if other.effect.name == one.effect.name)


@dataclass(frozen=True, eq=False)
class Compared:
    """An effect that acts, and what there is in its place."""

    without: Judged  # the others fitted without it
    rivals: list[Judged]  # with another effect in its place


def _compared(now: Judged, candidates: Sequence[Effect]) -> list[Compared]:
    """For each effect that acts."""
    found, others = [], _absent(now.state, candidates)
    for one in now.hypothesis.acting:
        less = now.trying(now.hypothesis.lacking(one))
        found.append(Compared(less, _rivals(now, one, less, others) if others else []))
    return found


def _rivals(now: Judged, one: Acting, less: Judged, others: Sequence[Effect]) -> list[Judged]:
    """What brings half as much in the place of one that acts; `less` is without it.

    To first order from where each starts, beside what acts else fitted anew or as it is: without that one it may have
    gone astray. One that is late by a time starts as late as that one.
    """
    fewer, enough = less.hypothesis, (now.left + less.left) / 2
    as_late = [effect for effect in others if effect.late_by and one.effect.late_by]
    further = [effect for effect in others if effect not in as_late]
    firsts = [_to_first_order(state, further) for state in (
        less.state, Linearised(now.state.setting, fewer, now.state.found))]
    hypotheses = [fewer.having(Acting(effect, {**effect.absent(), effect.late_by: one.values[one.effect.late_by]}))
                  for effect in as_late]
    for effect in further:
        left, hypothesis = min((first[effect.name] for first in firsts if effect.name in first),
                               key=lambda promise: promise[0], default=(np.inf, fewer))
        if left < enough:
            hypotheses.append(hypothesis)
    return [rival for rival in map(less.trying, hypotheses) if rival.left < enough]


def _exchanged(now: Judged, candidates: Sequence[Effect]) -> tuple[Judged, list[Compared]]:
    """With rivals of no more parameters in the place of effects as long as that leaves less, and the comparison."""
    compared = _compared(now, candidates)
    better = [rival for one in compared for rival in one.rivals
              if rival.hypothesis.size <= now.hypothesis.size and rival.left < tuned.CHAIN_EXCHANGE * now.left
              and rival.beats(one.without)]
    return _exchanged(min(better, key=lambda one: one.left), candidates) if better else (now, compared)


def _kept(now: Judged, compared: Sequence[Compared]) -> Iterator[Kept]:
    for one, other in zip(now.hypothesis.acting, compared):
        rivals = [effect.effect.name for rival in other.rivals if not now.beats(rival)
                  for effect in rival.hypothesis.beside(now.hypothesis)]
        yield Kept(one, {}, other.without, tuple(rivals))
