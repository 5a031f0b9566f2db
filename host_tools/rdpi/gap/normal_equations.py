"""The gap in numbers small enough to judge candidates by: normal equations, block by block.

The gap and the columns D and J of all candidates (candidates.py) are reduced to one Gram matrix per block of each
recording. Leaving recordings out, joining effects, refitting the model and telling one effect from another is then
linear algebra.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import combinations

import numpy as np

from ..simulate import signals
from . import thresholds
from .candidates import Candidate
from .dataset import BLOCKS, Dataset

ROWS = 200_000  # samples used for the Gram matrices; more say no more
LEFT_OUT = 4  # parts of the only recording that are left out in turn


class NormalEquations:
    """The gap and every candidate as one Gram matrix per block: (blocks, columns, columns)."""

    def __init__(self, dataset: Dataset, left: np.ndarray, candidates: Sequence[Candidate],
                 acting: Sequence[Candidate] = ()) -> None:
        """`left` is what the prediction with the effects that act already misses; those are adjusted along with every
        candidate.
        """
        self.dataset, self.candidates, self._folds = dataset, list(candidates), {}
        shared = [one.jacobian for one in acting if not one.per_run]
        own = [one.jacobian for one in acting if one.per_run]
        parts, at = [left[:, None], *shared, *own], 1
        self.adjusted = np.arange(at, at := at + sum(part.shape[1] for part in shared))
        self.own = np.arange(at, at := at + sum(part.shape[1] for part in own))
        self.change, self.jacobian = [], []  # of each candidate: column of D, columns of J
        for one in self.candidates:
            parts += [one.change[:, None], one.jacobian]
            self.change.append(at)
            self.jacobian.append(slice(at + 1, at + 1 + one.jacobian.shape[1]))
            at += 1 + one.jacobian.shape[1]
        parts.append(dataset.model_jacobian())
        self.model = slice(at, at + parts[-1].shape[1])
        self.blocks = self._reduce(parts)

    def _reduce(self, parts: list[np.ndarray]) -> np.ndarray:
        block, step = self.dataset.block, max(1, -(-len(self.dataset.block) // ROWS))
        edges = np.flatnonzero(np.diff(block, prepend=-1, append=-1))
        grams = np.zeros((len(self.dataset.run_of_block), *[sum(part.shape[1] for part in parts)] * 2))
        for start, stop in zip(edges[:-1], edges[1:]):
            at = signals.uneven(start, stop, step) if step > 1 else slice(start, stop)
            rows = np.hstack([part[at] for part in parts])
            grams[block[start]] += step * (rows.T @ rows)
        return grams

    @cached_property
    def whole(self) -> np.ndarray:
        """The Gram matrix of all blocks."""
        return np.sum(self.blocks, axis=0)

    @cached_property
    def by_run(self) -> np.ndarray:
        """The Gram matrix of each recording, (recordings, columns, columns)."""
        return _summed(self.blocks, self.dataset.run_of_block)

    def folds(self, within: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Which fold each block is in, (blocks,), and the Gram matrix of all blocks of the others, (folds, columns,
        columns). Left out in turn are recordings; `within` them, or in the only one, parts.
        """
        runs = self.dataset.run_of_block
        within |= runs[-1] == 0
        if within not in self._folds:
            fold = np.arange(len(runs)) % BLOCKS * LEFT_OUT // BLOCKS if within else runs
            self._folds[within] = fold, self.whole - _summed(self.blocks, fold)
        return self._folds[within]

    def held_out(self, chosen: int | None = None, refit: bool = False, within: bool = False) -> np.ndarray:
        """Sum of squares (blocks,) that is left in blocks not used to fit the effect, nor to `refit` the model.

        A disturbance is fitted to every other block of each recording and judged on the rest.
        """
        return self._leave_out(chosen, refit, within)[0]

    def moves(self, within: bool = False) -> np.ndarray:
        """How far the parameters of those that act already move when each fold is left out, (folds, parameters); nan
        where hardly anything of what shows a parameter is left.
        """
        left = self.folds(within)[1][:, self.adjusted, self.adjusted]
        return np.where(left > thresholds.SHOWN_LEFT * self.whole[self.adjusted, self.adjusted],
                        self._leave_out(None, False, within)[1], np.nan)

    def refitted_model(self, chosen: int) -> np.ndarray:
        """How far refitting the model beside a candidate moves the parameters of ModelRun.model_jacobian."""
        shared, _, target = self._layout(chosen, True)
        move, = self._solve(self.whole[None], shared, target, self._ridge(shared), chosen)
        return move[len(self.adjusted):len(self.adjusted) + self.model.stop - self.model.start]

    def _layout(self, chosen: int | None, refit: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns fitted to all recordings together, and to each by itself; and what they are fitted to, as a sum of
        columns.
        """
        columns = np.arange(self.blocks.shape[1])
        one = None if chosen is None else self.candidates[chosen]
        slopes = columns[slice(0, 0) if one is None else self.jacobian[chosen]]
        per_run = one is not None and one.per_run
        shared = np.r_[self.adjusted, columns[self.model] if refit else [], [] if per_run else slopes].astype(int)
        own = np.r_[self.own, slopes if per_run else []].astype(int)
        target = np.zeros(len(columns))
        target[0] = 1.0
        if one is not None:
            target[self.change[chosen]] = -1.0
        return shared, own, target

    def _leave_out(self, chosen: int | None, refit: bool, within: bool) -> tuple[np.ndarray, np.ndarray]:
        """Sum of squares (blocks,) that is left in what is left out, and the moves (folds, shared) by what is not."""
        shared, own, target = self._layout(chosen, refit)
        fold, others = self.folds(within)
        moves = self._solve(others, shared, target, self._ridge(shared) if refit else np.zeros(len(shared)), chosen)
        rest = np.tile(target, (len(moves), 1))
        rest[:, shared] -= moves
        rest = rest[fold]
        if len(own):
            rest[:, own] -= self._own_moves(own, rest, fold)
        used = np.flatnonzero(np.any(rest != 0, axis=0))
        rest, blocks = rest[:, used], self.blocks[:, used[:, None], used]
        return np.maximum(np.einsum("ki,kij,kj->k", rest, blocks, rest), 0.0), moves

    def _own_moves(self, own: np.ndarray, rest: np.ndarray, fold: np.ndarray) -> np.ndarray:
        """Each recording's own columns, fitted to every other block of what is left out of it for those between:
        (blocks, own).
        """
        _, part = np.unique((fold[-1] + 1) * self.dataset.run_of_block + fold, return_inverse=True)
        half = 2 * part + np.arange(len(rest)) % 2
        across = _summed(np.einsum("kij,kj->ki", self.blocks[:, own], rest), half)
        return _solution(_summed(self.blocks[:, own[:, None], own], half), across)[half ^ 1]

    def _ridge(self, shared: np.ndarray) -> np.ndarray:
        """Prior on the model's slopes: as likely to move by REFIT_FREEDOM as the gap is to be what it is."""
        total = np.sum(self.blocks[:, 0, 0]) * thresholds.CORRELATED / max(1, len(self.dataset.block))
        of_model = (shared >= self.model.start) & (shared < self.model.stop)
        return np.where(of_model, total / thresholds.REFIT_FREEDOM**2, 0.0)

    def _solve(self, grams: np.ndarray, shared: np.ndarray, target: np.ndarray, ridge: np.ndarray, chosen: int | None
               ) -> np.ndarray:
        """By each of the Gram matrices how far the shared columns move: (matrices, shared)."""
        if not len(shared):
            return np.zeros((len(grams), 0))
        moves = _solution(grams[:, shared[:, None], shared] + np.diag(ridge), grams[:, shared] @ target)
        one = None if chosen is None else self.candidates[chosen]
        if one is not None and not one.per_run and one.fitted:
            own = slice(len(shared) - len(one.fitted), len(shared))
            moves[:, own] = [self._within_reach(one, chosen, move) for move in moves[:, own]]
        return moves

    def _within_reach(self, one: Candidate, chosen: int, move: np.ndarray) -> np.ndarray:
        """The move of an effect's parameters within their bounds, and no further than its slopes are true."""
        if not one.effect.linear and len(move):
            energy = float(move @ self.whole[self.jacobian[chosen], self.jacobian[chosen]] @ move)
            reach = thresholds.REACH**2 * float(self.whole[self.change[chosen], self.change[chosen]])
            move = move * min(1.0, np.sqrt(reach / energy)) if energy > 0 else move
        ends = {parameter.name: np.array(parameter.ends) for parameter in one.effect.parameters}
        return np.array([np.clip(step, *(ends[name] - one.values[name])) if np.isfinite(one.values[name]) else 0.0
                         for name, step in zip(one.fitted, move)])

    def reproduced(self) -> np.ndarray:
        """Share of each candidate's signature (row) that another (column) reproduces, fitted to it: R^2, 0 to 1."""
        count = len(self.candidates)
        result = np.zeros((count, count))
        for i in range(count):
            row = self.change[i]
            energy = float(self.whole[row, row])
            for j in range(count):
                columns = np.r_[self.change[j], self.jacobian[j]].astype(int)
                result[i, j] = self._share(row, columns, self.candidates[j].per_run) / energy if energy > 0 else 0.0
        return np.clip(result, 0.0, 1.0)

    def together(self) -> np.ndarray:
        """Sum of squares that two candidates leave together, to first order: (candidates, candidates), infinite for a
        disturbance and for a candidate with itself.
        """
        count, whole = len(self.candidates), self.whole
        result = np.full((count, count), np.inf)
        shared = [k for k, one in enumerate(self.candidates) if not one.per_run]
        for i, j in combinations(shared, 2):
            columns = np.r_[self.adjusted, self.change[i], self.jacobian[i], self.change[j], self.jacobian[j]].astype(int)
            across = whole[columns, 0]
            gained = float(across @ _solution(whole[np.ix_(columns, columns)], across))
            result[i, j] = result[j, i] = max(0.0, whole[0, 0] - gained)
        return result

    def _share(self, row: int, columns: np.ndarray, per_run: bool) -> float:
        grams = self.by_run if per_run else self.whole[None]
        across = grams[:, columns, row]
        return float(np.sum(across * _solution(grams[:, columns[:, None], columns], across)))


def _summed(blocks: np.ndarray, of: np.ndarray) -> np.ndarray:
    """The sum over the blocks of each number in `of`, (numbers, ...)."""
    result = np.zeros((np.max(of) + 1, *blocks.shape[1:]))
    np.add.at(result, of, blocks)
    return result


def _solution(gram: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Solution of the normal equations, (..., columns), each column scaled to 1; what is not determined stays 0."""
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 1e-300))
    inverse = np.linalg.pinv(gram / (scale[..., :, None] * scale[..., None, :]), rcond=1e-8, hermitian=True)
    return np.einsum("...ij,...j->...i", inverse, across / scale) / scale
