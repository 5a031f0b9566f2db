"""Beside the others: what the forward selection took is asked again once all is there.

It takes each effect while those to come are missing. The first may be a mixture of two, and of two that hide each other
none explains much. So pairs of effects are tried as well, and then each effect in turn is searched anew beside the
others:

* what is best there takes its place;
* an effect that brings too little there is dropped;
* what cannot be told from it there is a rival as well.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from ..errors import BadInput
from . import thresholds
from .augmented import AugmentedModel
from .candidates import Candidate
from .selection import Excess, Round, Score, Selection, equations_of, one_round, shrink_interval, shrink_of

PAIRS = 4  # of effects, those that leave least to first order, that are fitted
ASKED = 9  # times that an effect is searched beside the others at most


def settled(selection: Selection, gap: Excess) -> Selection:
    """The selection with every effect that was accepted asked again beside the others."""
    if any(done.refitted for done in selection.rounds):
        return selection
    reached = _asked_for_pairs(selection, gap)
    if not reached.chosen:
        return selection
    rivals: dict[str, tuple[Score, ...]] = {}
    if reached is selection.reached:  # the last was searched beside the others
        rivals[reached.chosen[-1].effect.name] = selection.rounds[len(reached.chosen) - 1].rivals
    asked: dict[frozenset[str], Round] = {}
    for _ in range(ASKED):
        place = next((k for k, one in reversed([*enumerate(reached.chosen)]) if one.effect.name not in rivals), None)
        if place is None or len(reached.chosen) < 2:
            break
        name, others = reached.chosen[place].effect.name, _lacking(selection.given, reached, place)
        done = None if gap.is_left_little(others.squares) else one_round(
            others, gap, _hopeless(selection, others), guesses=_found(selection, reached))
        if done is None or done.best is None:
            reached, rivals, asked = _accepting(selection.given, others.chosen), {}, {}
            continue
        asked[_names(others)] = done
        if done.best.name != name:
            there = others.accept(done.best.candidate)
            if there.squares < (1 - thresholds.RIVAL_MARGIN) * reached.squares:
                rivals, asked = {}, {}
            reached, name = there, done.best.name
        rivals[name] = done.rivals
    if len(reached.chosen) > 1:
        reached = _largest_first(selection.given, reached)
    if len(reached.chosen) == 1:  # of single ones, the first round has told the best
        reached, rivals = selection.states[1] if len(selection.states) > 1 else selection.given, {}
    return _rewritten(selection, reached, rivals, asked, gap)


def _names(state: AugmentedModel) -> frozenset[str]:
    return frozenset(one.effect.name for one in state.chosen)


def _found(selection: Selection, reached: AugmentedModel) -> list[Candidate]:
    """What was found so far, the last of each effect last."""
    return [*(score.candidate for done in selection.rounds for score in done.scores), *reached.chosen]


def _accepting(given: AugmentedModel, chosen: Iterable[Candidate]) -> AugmentedModel:
    for one in chosen:
        given = given.accept(one)
    return given


def _largest_first(given: AugmentedModel, state: AugmentedModel) -> AugmentedModel:
    """With its effects in the order of what is left without each. What took another's place was put last."""
    without = _without_each(given, state)
    order = sorted(range(len(without)), key=lambda place: -without[place])
    return replace(state, chosen=tuple(state.chosen[place] for place in order))


def _without_each(given: AugmentedModel, state: AugmentedModel) -> list[float]:
    """Squares that are left without each accepted effect, the others as they are."""
    return [_lacking(given, state, place).squares for place in range(len(state.chosen))]


def _lacking(given: AugmentedModel, state: AugmentedModel, place: int) -> AugmentedModel:
    """Without one of the accepted effects, the others as they are."""
    others = state.chosen[:place] + state.chosen[place + 1:]
    if state.chosen[place].memory_um is not None:
        return _accepting(given, others)
    return replace(state, chosen=others)


def _hopeless(selection: Selection, others: AugmentedModel) -> tuple[str, ...]:
    """Effects that are not to be tried, or that by the first round leave too much beside one of the others; it does not
    tell that of disturbances.
    """
    first, names = selection.rounds[0], {one.effect.name for one in others.chosen}
    beside = [k for k, one in enumerate(first.scores) if one.name in names]
    least: dict[str, float] = {}
    for one, left in zip(first.scores, np.min(first.together[:, beside], axis=1, initial=np.inf)):
        least[one.name] = min(left, least.get(one.name, np.inf))
    most = thresholds.HOPELESS * min(least.values())
    return *selection.without, *(name for name, left in least.items() if most < left < np.inf)


def _asked_for_pairs(selection: Selection, gap: Excess) -> AugmentedModel:
    """What was reached, or two effects together that leave clearly less."""
    given, first, reached = selection.given, selection.rounds[0], selection.reached
    clear = gap.ratio and first.evidence > gap.threshold
    if not clear or any(gap.is_left_little(state.squares) for state in selection.states[1:2]):
        return reached
    for one, other in _promising(first):
        try:
            pair = _accepting(given, (one.candidate, other.candidate))
        except BadInput:  # numbers beyond the library's
            continue
        # Two that are each larger than the gap, and cancel, make up for what the model missed anyway.
        if max(_without_each(given, pair)) < thresholds.CANCELS * given.squares and \
                pair.squares < (1 - thresholds.RIVAL_MARGIN) * reached.squares:
            reached = pair
    return reached


def _promising(first: Round) -> list[tuple[Score, Score]]:
    """Pairs that leave least to first order."""
    pairs = sorted(combinations(range(len(first.scores)), 2), key=lambda pair: first.together[pair])
    found = [(first.scores[i], first.scores[j]) for i, j in pairs if np.isfinite(first.together[i, j])]
    return [(one, other) for one, other in found if one.name != other.name][:PAIRS]


def _rewritten(selection: Selection, reached: AugmentedModel, rivals: dict[str, tuple[Score, ...]],
               asked: dict[frozenset[str], Round], gap: Excess) -> Selection:
    """The selection as if its rounds had led there; `asked` are rounds beside effects of these names."""
    states, rounds = [], []
    names, before = ([one.effect.name for one in state.chosen] for state in (reached, selection.reached))
    if not names:
        return selection
    for k, one in enumerate(reached.chosen):
        if k < len(selection.rounds) and before[:k] == names[:k]:
            state, done = selection.states[k], selection.rounds[k]
        else:
            state = states[-1].accept(reached.chosen[k - 1])
            done = asked.get(_names(state)) or one_round(
                state, gap, tuple(selection.without), guesses=_found(selection, reached))
        place = next((place for place, score in enumerate(done.scores) if score.effect.is_as(one.effect)), None)
        if place is None:  # beside fewer effects nothing excites it
            return selection
        best, beside = done.scores[place], rivals.get(one.effect.name, ())
        if best is done.best:  # beside what only makes up for the model's own error, too little seems to be a rival
            names_known = {rival.name for rival in done.rivals}
            beside = (*done.rivals, *(rival for rival in beside if rival.name not in names_known))
        else:
            best = _joined(best, one, state, reached if k + 1 == len(reached.chosen) else state.accept(one))
            done = replace(done, scores=_with(done.scores, place, best), rejected=_with(done.rejected, place, None),
                           best=best)
        rounds.append(replace(done, rivals=beside))
        states.append(state)
    if names == before:
        rounds += selection.rounds[len(names):]
    return replace(selection, reached=reached, accepted=reached, rounds=tuple(rounds), states=(*states, reached))


def _joined(score: Score, one: Candidate, before: AugmentedModel, after: AugmentedModel) -> Score:
    """The score of an effect with which the others moved far: what it brought with all fitted together."""
    now, then = (equations_of(state).held_out() for state in (after, before))
    return replace(score, candidate=one, shrink=shrink_of(now, then),
                   shrink_ci=shrink_interval(now, then, len(before.recordings)))


def _with(values: tuple[Any, ...], place: int, new: Any) -> tuple[Any, ...]:
    return (*values[:place], new, *values[place + 1:])
