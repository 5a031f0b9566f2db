"""Choice: which effects stand around the operator, and whether its slopes depend on the rate.

Forward selection: every candidate is fitted together with all that act already and judged on recordings that were left
out in turn. Of those that no standard error tells apart the one with the fewest parameters joins. Then backwards: what
does not bring more than its standard error leaves again (the one-standard-error rule, Breiman et al. 1984).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..simulate.effects import Acting, Effect, Residuals
from . import thresholds as tuned
from .joint import Hypothesis, Linearised, Setting, Unknowns, refined, shifted

STARTS = 3


@dataclass(frozen=True, eq=False)
class Judged:
    """A hypothesis fitted, and the squares that it leaves in each block when fitted without it."""

    state: Linearised
    held_out: np.ndarray

    @property
    def hypothesis(self) -> Hypothesis:
        return self.state.hypothesis

    @property
    def left(self) -> float:
        return float(np.sum(self.held_out))


def judged(setting: Setting, hypothesis: Hypothesis, found: Unknowns) -> Judged:
    state = refined(setting, hypothesis, found)
    return Judged(state, state.held_out())


def gains(before: Judged, after: Judged) -> bool:
    """Whether it leaves less by more than its standard error, and by enough to matter."""
    gain = before.held_out - after.held_out
    error = np.sqrt(len(gain)) * np.std(gain, ddof=1)
    return bool(np.sum(gain) > max(error, tuned.CHAIN_LEAST * before.left))


def tried(state: Linearised, candidates: Sequence[Effect]) -> list[Acting]:
    """Where fits of effects start that do not act yet: each effect's most promising starts."""
    setting = state.setting
    left = [run.displacement_um - predicted for run, predicted in zip(setting.runs, state.predicted_um)]
    left = [miss - np.mean(miss) for miss in left]
    seen = Residuals(setting.model, setting.runs, state.predicted_um, left, left)
    names = {one.effect.name for one in state.hypothesis.acting}
    result = []
    for effect in candidates:
        if effect.name in names:
            continue
        starts = [shifted(Acting(effect, {**effect.absent(), **values}), dict.fromkeys(effect.fitted, 0.0))
                  for values in effect.starts(seen)]
        if len(starts) > STARTS:
            starts = sorted(starts, key=lambda one: -explained(one, seen))[:STARTS]
        result += starts
    return result


def explained(one: Acting, seen: Residuals) -> float:
    """Squares that any size of the change takes away."""
    across = energy = 0.0
    for run, predicted, miss in zip(seen.runs, seen.predicted_um, seen.residual_um):
        change = one.effect.displacement(predicted, run, one.values, seen.model) - predicted
        change = change - np.mean(change)
        across, energy = across + float(change @ miss), energy + float(change @ change)
    return across**2 / energy if energy else 0.0


def choose(setting: Setting, found: Unknowns, candidates: Sequence[Effect], rate_law: bool, log=lambda *a: None
           ) -> Judged:
    now = judged(setting, Hypothesis(), found)
    log("plain", rms(now))
    while True:
        better = _round(setting, now, candidates, rate_law, log)
        if better is None:
            break
        now = better
    now = _pruned(setting, now, log)
    full = _full(setting, now, candidates, log)
    log("full", rms(full), show(full))
    full = _pruned(setting, full, log)
    log("pruned", rms(full), show(full), gains(now, full))
    return full if gains(now, full) else now


def _full(setting, now, candidates, log):
    """With every effect."""
    state = now.state
    for effect in candidates:
        names = {one.effect.name for one in state.hypothesis.acting}
        starts = tried(state, [effect])
        if effect.name in names or not starts:
            continue
        wide = Linearised(setting, state.hypothesis, state.found, starts)
        k = min(range(len(starts)), key=lambda k: float(np.sum(wide.held_out(join=k))))
        there = refined(setting, state.hypothesis.having(starts[k]), state.found)
        if there.best(there.blocks)[1] >= state.best(state.blocks)[1]:
            continue
        state = there
        log("    +", effect.name, show(Judged(state, state.held_out())))
    state = refined(setting, state.hypothesis, state.found, 20)
    return Judged(state, state.held_out())


def _round(setting, now, candidates, rate_law, log):
    """The best that joins, or None."""
    wide = Linearised(setting, now.hypothesis, now.state.found, tried(now.state, candidates))
    options = {}
    for k, one in enumerate(wide.joins):
        left = float(np.sum(wide.held_out(join=k)))
        name = one.effect.name
        if name not in options or left < options[name][0]:
            options[name] = left, now.hypothesis.having(one)
    if rate_law and not now.hypothesis.rated:
        options["rate"] = float(np.sum(wide.held_out(rated=True))), replace(now.hypothesis, rated=True)
    found = []
    for name, (left, hypothesis) in options.items():
        if left > (1 - tuned.CHAIN_LEAST) * now.left:
            continue
        one = judged(setting, hypothesis, now.state.found)
        log("  ", name, "%.4f -> %.4f" % (rms2(setting, left), rms(one)), gains(now, one), show(one))
        if gains(now, one):
            found.append(one)
    if not found:
        return None
    best = min(found, key=lambda one: one.left)
    simple = [one for one in found if one is best or one.hypothesis.size < best.hypothesis.size and not gains(one, best)]
    return min(simple, key=lambda one: (one.hypothesis.size, one.left))


def _pruned(setting, now, log=lambda *a: None):
    while True:
        options = [now.hypothesis.lacking(one) for one in now.hypothesis.acting]
        if now.hypothesis.rated:
            options.append(replace(now.hypothesis, rated=False))
        brought = {}
        for k, hypothesis in enumerate(options):
            less = judged(setting, hypothesis, now.state.found)
            log("  less", "%.4f" % rms(less), "keep" if gains(less, now) else "drop", show(less))
            if not gains(less, now):
                now = less
                break
            brought[show(now)[k][0] if k < len(now.hypothesis.acting) else "rate"] = 1 - now.left / less.left
        else:
            object.__setattr__(now, "brought", brought)
            return now


def show(one):
    return [(a.effect.name, *("%.4g" % v for v in a.values.values())) for a in one.hypothesis.acting] + ["rated"] * one.hypothesis.rated


def rms(one):
    return rms2(one.state.setting, one.left)


def rms2(setting, squares):
    return 100 * float(np.sqrt(squares / setting.samples))
