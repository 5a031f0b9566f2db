"""Joint identification: what stands around the operator is found together with it.

    measured = F(S(sum_i W_i(rho) y_i(H(command)))) + offset

H are the effects ahead of the operator, F those behind it. With their parameters given, the rest is the regression of
regression.py on the command that H passes on and on the displacement without F(z) - z, which the prediction z tells
free of noise. Its residual

    sum_i W_i(rho) (y_i - y_(i+1)) + offset - sum_j U_j seg_j(measured - (F(z) - z))

is linearised in slopes, pieces and parameters together (separable least squares, Golub and Pereyra 1973) and reduced to
one Gram matrix per block of each recording. Steps, leaving blocks out and intervals are linear algebra on those.

A resonance passes on far more than it gets: there F(z) - z, too, follows the slopes, the pieces and H. Where blocks are
left out it stays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np

from ..data import Recording
from ..simulate import effects
from ..simulate.effects import Acting, Residuals
from . import thresholds as tuned
from .hypothesis import Hypothesis, Setting, Unknowns, bounds, scale_of, shifted
from .regression import prior

BLOCKS = 8  # of each recording
STEPS = 16  # of Levenberg and Marquardt
DAMPING = 0.01  # that they begin with, and go on with where less was too little
MOST_DAMPING = 10.0  # beyond which a step moves nothing
ENOUGH = 1e-3  # relative change of the squares at which they end
SINGULAR = 1e-12  # of a column's squares, added to them: columns that are alike have a solution all the same
PROBE = 1e-3  # change of the prediction that a derivative is taken over, share of the stroke


class _Predicted(NamedTuple):
    """A run as parameters and unknowns have it: um, (samples,) or (counted samples,)."""

    counted: np.ndarray  # y_i - y_(i+1), (counted samples, plays)
    target: np.ndarray  # measured without F(z) - z, counted
    v: np.ndarray  # the operator's output before its saturation
    z: np.ndarray  # and behind it
    driven: Recording  # by what H passes on
    shown: np.ndarray  # F(z)


class Linearised:
    """A hypothesis at parameters and unknowns: what it predicts, and its residual to first order."""

    def __init__(self, setting: Setting, hypothesis: Hypothesis, found: Unknowns, joins: Sequence[Acting] = ()) -> None:
        """`joins` are effects that may join it: their columns are there too."""
        self.setting, self.hypothesis, self.found, self.joins = setting, hypothesis, found, list(joins)
        n, m = len(found.rest), len(found.pieces)
        self.linear = np.r_[np.arange(n * (1 + hypothesis.rated)), 2 * n + np.arange(m)]
        at = 2 * n + m
        self.free = [(place, name) for place, one in enumerate(hypothesis.acting) for name in one.effect.fitted]
        self.own_start = at
        self.own = at + np.arange(len(self.free))
        # Effects whose derivatives hold near by only: no linear ones, and no delay, which takes its time x the slope.
        self.curved = [place for place, one in enumerate(hypothesis.acting)
                       if not (one.effect.linear or one.effect.late_by)]
        self.whole = at + len(self.free) + np.arange(len(self.curved))  # all that each of these does
        at += len(self.free) + len(self.curved)
        self.join_columns = []
        for one in self.joins:
            self.join_columns.append((at, np.arange(at + 1, at + 1 + len(one.effect.fitted))))
            at += 1 + len(one.effect.fitted)
        self.predicted_um: list[np.ndarray] = []  # with all that acts
        self._kept: list[_Predicted] = []
        self._displaced = [effects.Displaced() for _ in setting.runs]
        for k in range(len(setting.runs)):
            self._predict(k)

    # --- columns

    @cached_property
    def blocks(self) -> np.ndarray:
        """Gram matrices, (blocks of every run, columns, columns): of the linear columns, the own parameters, what each
        effect does that may be stopped, what may join, and seg_0.
        """
        return self._blocks(self.rings)

    @cached_property
    def still(self) -> np.ndarray:
        """`blocks` where F(z) - z stays what it is: ringing would make of what is left out many times as much."""
        return self._blocks(False) if self.rings else self.blocks

    def _blocks(self, rung: bool) -> np.ndarray:
        grams = self._grams([self._rows(k, rung) for k in range(len(self.setting.runs))])
        self._displaced = [effects.Displaced() for _ in self.setting.runs]
        return grams

    @property
    def rings(self) -> bool:
        """Whether F does, and passes on far more than it gets."""
        return any(one.effect.rings for one in self.hypothesis.acting)

    def _grams(self, rows: Sequence[np.ndarray]) -> np.ndarray:
        """Of each block, every run without what is no matter of the model; in units of the stroke."""
        grams = []
        for columns, aside in zip(rows, self.setting.asides):
            columns = (columns - aside @ (aside.T @ columns)) / self.setting.model.stroke_um
            grams += [part.T @ part for part in np.array_split(columns, BLOCKS)]
        return np.array(grams)

    def _predict(self, k: int) -> None:
        setting, run, found = self.setting, self.setting.runs[k], self.found
        acting, at = list(self.hypothesis.acting), setting.rows[k]
        driven = setting.driven(k, acting)
        counted, v = setting.superposed(k, driven.command_V, found)
        target = run.displacement_um
        for _ in range(2):  # the offset is that of what F leaves
            offset = np.mean(setting.straightened(target[at], found) - v[at])
            z = setting.bent(v + offset, found)
            shown = self._displaced[k](acting, z, driven, setting.model)
            target = run.displacement_um - (shown - z)
        self.predicted_um.append(shown)
        self._kept.append(_Predicted(counted, target[at], v, z, driven, shown))

    def _rows(self, k: int, rung: bool) -> np.ndarray:
        setting, found, displaced = self.setting, self.found, self._displaced[k]
        acting, at = list(self.hypothesis.acting), setting.rows[k]
        share = setting.shares[k][at]
        counted, target, v, z, driven, shown = self._kept[k]
        slope = self._slope(target)

        def change(new: Sequence[Acting], ahead: bool) -> np.ndarray:
            """Of the residual, with these in place of those that act."""
            if not ahead:
                return slope * (displaced(new, z, driven, setting.model) - shown)[at]
            drive_V = setting.driven(k, new).command_V
            if rung:
                moved_um = setting.superposed(k, drive_V, found)[1] - v
                return moved_um[at] + self._rung(k, new, target, [moved_um])[:, 0]
            moved = setting.plays(k, drive_V) - counted
            return moved @ found.rest + (share * (moved @ found.change) if np.any(found.change) else 0.0)

        linear = self._linear(k, acting, driven.command_V, counted, target, rung)
        columns = [linear[:, :-1]]
        columns += [self._derivative(acting, place, name, change)[:, None] for place, name in self.free]
        columns += [change([*acting[:place], *acting[place + 1:]], acting[place].effect.ahead)[:, None]
                    for place in self.curved]
        for join in self.joins:
            new = [*acting, join]
            there = change(effects.in_order(new), join.effect.ahead)
            columns += [there[:, None], *(self._derivative(new, len(acting), name, change, there)[:, None]
                                          for name in join.effect.fitted)]
        return np.hstack([*columns, linear[:, -1:]])

    def _linear(self, k: int, acting: Sequence[Acting], drive_V: np.ndarray, counted: np.ndarray, target: np.ndarray,
                rung: bool) -> np.ndarray:
        """Columns of the linear unknowns, and last seg_0, of a run whose operator is driven by `drive_V`.

        Unknowns move z, and with it F(z) - z. Where F rings, that is far more than what they move themselves.
        """
        setting, kept, share = self.setting, self._kept[k], self.setting.shares[k]
        segments = setting.segments(target)
        columns = np.hstack([counted, counted * share[setting.rows[k], None], -segments[:, 1:], segments[:, :1]])
        if rung:
            plays, beyond = setting.all_plays(k, drive_V).T, setting.segments(kept.z)[:, 1:]
            law = (share * one for one in plays) if self.hypothesis.rated else ()
            moved = chain(plays, law, -beyond.T, [kept.v - beyond @ self.found.pieces])
            columns[:, np.r_[self.linear, -1]] += self._rung(k, acting, target, moved)
        return columns

    def _rung(self, k: int, acting: Sequence[Acting], target: np.ndarray, moved_um: Iterable[np.ndarray]) -> np.ndarray:
        """What a ringing F adds to the residual's change, (counted samples, columns), where the operator's output moves
        by one of these, (samples,), before its saturation.
        """
        kept, at, columns = self._kept[k], self.setting.rows[k], []
        slope = self._slope(kept.z)
        for moved in moved_um:
            shown = moved = moved / slope
            for one in acting:
                if one.effect.rings:
                    shown = one.effect.displacement(shown, kept.driven, one.values, self.setting.model)
            columns.append(shown[at] - moved[at])
        return self._slope(target)[:, None] * np.array(columns).T

    def _slope(self, displacement_um: np.ndarray) -> np.ndarray:
        """Of the inverse saturation."""
        return np.r_[1.0, self.found.pieces][np.searchsorted(self.setting.corners_um, displacement_um)]

    def _derivative(self, acting: Sequence[Acting], place: int, name: str,
                    change: Callable[[Sequence[Acting], bool], np.ndarray], at: np.ndarray | float = 0.0) -> np.ndarray:
        """Of the residual by a parameter: a difference over a step that moves it by about PROBE."""
        one = acting[place]
        value, (low, high) = one.values[name], bounds(one, name)
        sign, room = (1.0, high - value) if high - value >= value - low else (-1.0, value - low)
        step = min(0.01 * abs(value) or 1e-4, room)
        for last in (False, False, True):
            moved = Acting(one.effect, {**one.values, name: value + sign * step})
            difference = change(effects.in_order([*acting[:place], moved, *acting[place + 1:]]), one.effect.ahead) - at
            size = float(np.sqrt(np.mean(difference**2))) / (PROBE * self.setting.model.stroke_um)
            if 0.05 < size < 20 or size == 0 or size < 0.05 and step == room or last:
                break
            step = min(step / float(np.clip(size, 1e-3, 1e3)), room)
        return sign * difference / step

    # --- linear algebra

    @property
    def ends(self) -> list[bool]:
        """Which of the own parameters stand at a bound."""
        result = []
        for place, name in self.free:
            one = self.hypothesis.acting[place]
            low, high = bounds(one, name)
            result.append(not low < one.values[name] < high)
        return result

    @property
    def at_ends(self) -> list[Acting]:
        """Effects with a parameter at a bound."""
        return [self.hypothesis.acting[place] for (place, _), end in zip(self.free, self.ends) if end]

    @property
    def at_most(self) -> list[Acting]:
        """Effects with a parameter at its upper bound."""
        return [one for one in self.at_ends for name in one.effect.fitted if one.values[name] >= bounds(one, name)[1]]

    def solve(self, kept: np.ndarray, used: np.ndarray, rated: bool, target: np.ndarray, residual: float) -> np.ndarray:
        """Coefficients of the residual with the columns `used` fitted to these blocks, (columns,)."""
        left, right = self._normal_equations(kept, used, rated, target, residual)
        size = np.sqrt(np.maximum(np.diag(left), 1e-300))
        found = np.linalg.solve(left / np.outer(size, size) + SINGULAR * np.eye(len(size)), right / size) / size
        weights = -target
        weights[used] += found
        return weights

    def _normal_equations(self, kept: np.ndarray, used: np.ndarray, rated: bool, target: np.ndarray, residual: float
                          ) -> tuple[np.ndarray, np.ndarray]:
        """Of the columns `used` on these blocks, the prior of the linear ones included."""
        gram = np.sum(kept, axis=0)
        samples = self.setting.samples * len(kept) / (BLOCKS * len(self.setting.runs))
        rows, wish = self._prior(rated)
        linear = rows.shape[1]
        left, right = gram[np.ix_(used, used)], gram[used] @ target
        left[:linear, :linear] += samples * residual**2 * rows.T @ rows
        right[:linear] += samples * residual**2 * rows.T @ wish
        return left, right

    def _prior(self, rated: bool) -> tuple[np.ndarray, np.ndarray]:
        """Its rows and targets for slopes at rest and their change, instead of slopes at both ends of the rate."""
        n, m = len(self.found.rest), len(self.found.pieces)
        rows, wish = prior(n, n * (1 + rated), m, tuned.CHAIN_LAW)
        return (np.hstack([rows[:, :n] + rows[:, n:2 * n], rows[:, n:]]) if rated else rows), wish

    @property
    def target(self) -> np.ndarray:
        """seg_0 as a sum of columns."""
        return _last(self.blocks)

    @cached_property
    def here(self) -> tuple[Unknowns, float, float]:
        """`best` of its own blocks."""
        return self.best(self.blocks)

    @property
    def squares(self) -> float:
        """Left with the best unknowns, relative to the stroke."""
        return self.here[1]

    @property
    def residual(self) -> float:
        """Relative rms with the best unknowns."""
        return self.here[2]

    def best(self, blocks: np.ndarray) -> tuple[Unknowns, float, float]:
        """Unknowns at the present parameters, the squares they leave, and these as a relative rms."""
        n, m, residual = len(self.found.rest), len(self.found.pieces), 3e-3
        for _ in range(3):  # the prior follows the residual
            weights = self.solve(blocks, self.linear, self.hypothesis.rated, _last(blocks), residual)
            squares = max(float(np.einsum("i,bij,j->", weights, blocks, weights)), 0.0)
            residual = max(float(np.sqrt(squares / self.setting.samples)), 1e-6)
        pieces = np.clip(weights[2 * n:2 * n + m], *tuned.PIECE_RANGE)
        return Unknowns(weights[:n], weights[n:2 * n], pieces), squares, residual

    def trial(self, acting: Sequence[Acting]) -> tuple[Unknowns, float]:
        """Unknowns and squares with other parameters of the same effects, where those at hand changed F(z) - z alone or
        H alone, or none changed.
        """
        before, setting, rows = self.hypothesis.acting, self.setting, []
        ahead = any(one.values != other.values for one, other in zip(acting, before) if one.effect.ahead)
        behind = any(one.values != other.values for one, other in zip(acting, before) if not one.effect.ahead)
        for k, (counted, target, _, z, driven, shown) in enumerate(self._kept):
            drive_V = driven.command_V
            if ahead:
                drive_V = setting.driven(k, acting).command_V
                counted = setting.plays(k, drive_V)
            if behind:
                target = target - (effects.displaced(acting, z, driven, setting.model) - shown)[setting.rows[k]]
            rows.append(self._linear(k, acting, drive_V, counted, target, self.rings))
        found, squares, _ = self.best(self._grams(rows))
        return found, squares

    def step(self, damping: float) -> tuple[np.ndarray, float]:
        """Of Levenberg and Marquardt in the own parameters, by factors where those move in their logarithm; and the
        squares that it takes away to first order.

        Those at a bound stay there if they would leave it.
        """
        found, _, residual = self.here
        weights = -self.target
        weights[:self.own_start] = np.r_[found.rest, found.change, found.pieces]
        split = len(self.linear)
        left, _ = self._normal_equations(self.blocks, np.r_[self.linear, self.own], self.hypothesis.rated, self.target,
                                         residual)
        scale = np.array([scale_of(self.hypothesis.acting[place], name) for place, name in self.free])
        across = left[split:, :split]
        curvature = (left[split:, split:] - across @ np.linalg.lstsq(left[:split, :split], across.T, rcond=1e-13)[0]
                     ) * np.outer(scale, scale)
        slope = self._all[self.own] @ weights * scale
        step, open_ = np.zeros(len(slope)), np.ones(len(slope), bool)
        for _ in slope:
            inside = curvature[np.ix_(open_, open_)]
            size = np.sqrt(np.maximum(np.diag(inside), 1e-300))
            step[:] = 0.0
            step[open_] = -np.linalg.lstsq(inside / np.outer(size, size) + damping * np.eye(len(size)),
                                           slope[open_] / size, rcond=1e-12)[0] / size
            leaving = open_ & np.array([self._leaves(place, name, step[j])
                                        for j, (place, name) in enumerate(self.free)])
            if not np.any(leaving):
                break
            open_ &= ~leaving
        return step, -float(step @ (2 * slope + curvature @ step))

    def _leaves(self, place: int, name: str, step: float) -> bool:
        one = self.hypothesis.acting[place]
        low, high = bounds(one, name)
        return one.values[name] <= low and step < 0 or one.values[name] >= high and step > 0

    @cached_property
    def residuals(self) -> Residuals:
        """What it misses, for effects that may join it."""
        left = []
        for run, predicted, first in zip(self.setting.runs, self.predicted_um, self.setting.first):
            miss = run.displacement_um - predicted
            miss -= np.mean(miss[first:])
            miss[:first] = 0.0  # an unknown memory is no effect
            left.append(miss)
        return Residuals(self.setting.model, self.setting.runs, self.predicted_um, left, left)

    def seen(self) -> list[Recording]:
        """The recordings as the operator alone would have made them.

        What is left of them is what is missed behind F. Where F rings, the operator has to add far less for it.
        """
        found = []
        for run, kept in zip(self.setting.runs, self._kept):
            missed = run.displacement_um - kept.shown
            for effect, values in self.hypothesis.acting:
                missed = effect.before(missed, kept.driven, values)
            found.append(replace(kept.driven, columns={**kept.driven.columns, "displacement_um": kept.z + missed}))
        return found

    # --- leaving out

    @cached_property
    def foldings(self) -> list[list[np.ndarray]]:
        """Blocks that are left out in turn: parts of every recording; and whole recordings, where none of them holds so
        much, or moves so far, that the others make no operator.
        """
        block, rows = np.arange(BLOCKS * len(self.setting.runs)), [len(at) for at in self.setting.rows]
        whole = max(rows) < tuned.MOST_LEFT_OUT * sum(rows) and self.setting.others_cover
        owners = [block % BLOCKS] + ([block // BLOCKS] if whole else [])
        return [[owner == one for one in range(owner[-1] + 1)] for owner in owners]

    def held_out(self, rated: bool | None = None, join: int | None = None) -> np.ndarray:
        """Squares in each block by what was fitted without it, (foldings, blocks); with a rate law, with an effect that
        joins.

        No effect that acts moves further than its derivatives hold.
        """
        rated = self.hypothesis.rated if rated is None else rated
        n, m = len(self.found.rest), len(self.found.pieces)
        used = np.r_[np.arange(n * (1 + rated)), 2 * n + np.arange(m), self.own[~np.array(self.ends, bool)]]
        target, residual = _last(self.still), self._still_residual
        if join is not None:
            used = np.r_[used, self.join_columns[join][1]]
            target[self.join_columns[join][0]] = -1.0
        result = np.zeros((len(self.foldings), len(self.still)))
        for row, folds in zip(result, self.foldings):
            for fold in folds:
                weights = self._solve_within_reach(self.still[~fold], used.astype(int), rated, target, residual)
                row[fold] = np.maximum(np.einsum("i,bij,j->b", weights, self.still[fold], weights), 0.0)
        return result

    @cached_property
    def _still_residual(self) -> float:
        return self.best(self.still)[2] if self.rings else self.residual

    def _solve_within_reach(self, kept: np.ndarray, used: np.ndarray, rated: bool, target: np.ndarray, residual: float
                            ) -> np.ndarray:
        """`solve`, where effects that would move too far stop on their way and the others are fitted beside them."""
        weights = self.solve(kept, used, rated, target, residual)
        stopped, target, everything = [], target.copy(), np.sum(self.still, axis=0)
        for place, whole in zip(self.curved, self.whole):
            own = [self.own_start + j for j, (at, _) in enumerate(self.free) if at == place]
            move = weights[own]
            energy = tuned.REACH**2 * everything[whole, whole]
            moved = float(move @ everything[np.ix_(own, own)] @ move)
            if moved > energy:
                stopped += own
                target[own] = -move * np.sqrt(energy / moved)
        return self.solve(kept, np.setdiff1d(used, stopped), rated, target, residual) if stopped else weights

    @cached_property
    def _all(self) -> np.ndarray:
        """Of all blocks."""
        return np.sum(self.blocks, axis=0)

    def errors(self) -> list[dict[str, float]]:
        """Standard errors of the parameters of each effect that acts; none for one at a bound.

        Jackknife over the blocks: what the operator cannot show makes neighbouring samples err alike, not blocks.
        """
        moving = self.own[~np.array(self.ends, bool)]
        used = np.r_[self.linear, moving].astype(int)
        count = len(self.blocks)
        moves = np.array([self.solve(np.delete(self.blocks, block, axis=0), used, self.hypothesis.rated, self.target,
                                     self.residual)[moving] for block in range(count)])
        errors = np.sqrt((count - 1) / count * np.sum((moves - np.mean(moves, axis=0)) ** 2, axis=0))
        result: list[dict[str, float]] = [{} for _ in self.hypothesis.acting]
        for column, error in zip(moving, errors):
            place, name = self.free[column - self.own_start]
            if error > 0:
                result[place][name] = float(error)
        return result


def _last(blocks: np.ndarray) -> np.ndarray:
    """The last of their columns as a sum of columns."""
    return np.eye(blocks.shape[1])[-1]


def refined(setting: Setting, hypothesis: Hypothesis, found: Unknowns, steps: int = STEPS) -> Linearised:
    """The least squares from there on (Levenberg and Marquardt)."""
    state, damping = Linearised(setting, hypothesis, found), DAMPING
    state = Linearised(setting, hypothesis, state.trial(hypothesis.acting)[0])
    for _ in range(steps if state.free else 0):
        before = state.squares
        while damping <= MOST_DAMPING:
            step, promised = state.step(damping)
            if promised < ENOUGH * before:
                return state
            acting = tuple(shifted(one, {name: step[j] for j, (at, name) in enumerate(state.free) if at == place})
                           for place, one in enumerate(state.hypothesis.acting))
            found, squares = state.trial(acting)
            if squares < before:
                break
            damping = max(10 * damping, DAMPING)
        else:
            break
        if before - squares < ENOUGH * before:
            break
        better = Linearised(setting, replace(hypothesis, acting=acting), found)
        if better.squares < before:
            state, damping = better, max(damping / 10, 1e-6)
            if before - better.squares < ENOUGH * before:
                break
        elif better.squares - before < ENOUGH * before:
            break
        else:  # the trial held F(z) - z at the unknowns before, and they moved too far
            damping = max(10 * damping, DAMPING)
    return state
