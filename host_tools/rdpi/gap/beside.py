"""Beside the others: what the forward selection took is asked again once all is there.

It takes each effect while those to come are missing. The first may be a mixture of two, and of two that hide each other
none explains much. So pairs of effects are tried as well, and then each effect in turn is searched anew beside the
others: another one takes its place if that leaves less, one that brings too little there is dropped, and its rivals are
those that it has beside the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import BadInput
from . import thresholds
from .augmented import AugmentedModel
from .candidates import Candidate
from .selection import Excess, Round, Score, Selection, detection_threshold, one_round

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
    for _ in range(ASKED):
        place = next((k for k, one in reversed([*enumerate(reached.chosen)]) if one.effect.name not in rivals), None)
        if place is None or len(reached.chosen) < 2:
            break
        name, others = reached.chosen[place].effect.name, _lacking(selection.given, reached, place)
        enough = _squares(others) < thresholds.FURTHER_RATIO**2 * gap.floor
        done = None if enough else one_round(others, gap, _hopeless(selection, others))
        if done is None or done.best is None:
            reached, rivals = _accepting(selection.given, others.chosen), {}
            continue
        if done.best.name != name:
            there = others.accept(done.best.candidate)
            if _squares(there) < (1 - thresholds.RIVAL_MARGIN) * _squares(reached):
                rivals = {}
            reached, name = there, done.best.name
        rivals[name] = done.rivals
    if len(reached.chosen) == 1:  # of single ones, the first round has told the best
        reached, rivals = selection.states[1] if len(selection.states) > 1 else selection.given, {}
    return _rewritten(selection, reached, rivals, gap)


def _squares(state: AugmentedModel) -> float:
    """Left, beyond what is excused."""
    return float(np.sum(state.residual**2)) - state.excused()


def _accepting(given: AugmentedModel, chosen: Iterable[Candidate]) -> AugmentedModel:
    for one in chosen:
        given = given.accept(one)
    return given


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
    enough = thresholds.FURTHER_RATIO**2 * gap.floor
    clear = gap.ratio and first.evidence > detection_threshold(given.recordings)
    if not clear or min((_squares(state) for state in selection.states[1:2]), default=np.inf) < enough:
        return reached
    for one, other in _promising(first):
        try:
            pair = given.accept(one.candidate).accept(other.candidate)
        except BadInput:  # numbers beyond the library's
            continue
        # Two that are each larger than the gap, and cancel, make up for what the model missed anyway.
        alone = max(_squares(_lacking(given, pair, place)) for place in (0, 1))
        if alone < thresholds.CANCELS * _squares(given) and \
                _squares(pair) < (1 - thresholds.RIVAL_MARGIN) * _squares(reached):
            reached = pair
    without = [_squares(_lacking(given, reached, place)) for place in range(len(reached.chosen))]
    return reached if reached is selection.reached or without[0] >= without[1] else \
        replace(reached, chosen=reached.chosen[::-1])


def _promising(first: Round) -> Iterator[tuple[Score, Score]]:
    """Pairs that leave least to first order."""
    count, found = len(first.scores), 0
    for at in np.argsort(first.together, axis=None):
        i, j = divmod(int(at), count)
        one, other = first.scores[i], first.scores[j]
        if i < j and one.name != other.name and np.isfinite(first.together[i, j]):
            yield one, other
            found += 1
            if found == PAIRS:
                return


def _rewritten(selection: Selection, reached: AugmentedModel, rivals: dict[str, tuple[Score, ...]], gap: Excess
               ) -> Selection:
    """The selection as if its rounds had led there."""
    states, rounds = [selection.given], []
    names = [one.effect.name for one in reached.chosen]
    if not names:
        return selection
    for k, one in enumerate(reached.chosen):
        known = k < len(selection.rounds) and [had.effect.name for had in selection.reached.chosen[:k]] == names[:k]
        done = selection.rounds[k] if known else one_round(states[k], gap, tuple(selection.without))
        place = next((place for place, score in enumerate(done.scores) if _alike(score, one)), None)
        if place is None:  # beside fewer effects nothing excites it
            return selection
        best, beside = done.scores[place], rivals.get(one.effect.name, ())
        if best is done.best:  # beside what only makes up for the model's own error, too little seems to be a rival
            names_known = {rival.name for rival in done.rivals}
            beside = (*done.rivals, *(rival for rival in beside if rival.name not in names_known))
        else:
            best = replace(best, candidate=one)
            done = replace(done, scores=_with(done.scores, place, best), rejected=_with(done.rejected, place, None),
                           best=best)
        rounds.append(replace(done, rivals=beside))
        states.append(states[k].accept(one))
    if names == [one.effect.name for one in selection.reached.chosen]:
        rounds += selection.rounds[len(names):]
    return replace(selection, reached=reached, accepted=reached, rounds=tuple(rounds),
                   states=(*states[:-1], reached))


def _alike(score: Score, one: Candidate) -> bool:
    had, effect = score.effect, one.effect
    return (had.name, had.stage, had.column) == (effect.name, effect.stage, effect.column)


def _with(values: tuple[Any, ...], place: int, new: Any) -> tuple[Any, ...]:
    return (*values[:place], new, *values[place + 1:])
