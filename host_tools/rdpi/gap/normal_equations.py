"""The gap in numbers small enough to judge candidates by: normal equations, block by block.

The gap and the columns D and J of all candidates (candidates.py) are reduced to one Gram matrix per block of each
recording. Leaving recordings out, joining effects, refitting the model and telling one effect from another is then
linear algebra.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ..identify import uneven
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
        self.dataset, self.candidates = dataset, list(candidates)
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
            at = uneven(start, stop, step) if step > 1 else slice(start, stop)
            rows = np.hstack([part[at] for part in parts])
            grams[block[start]] += step * (rows.T @ rows)
        return grams

    def folds(self, within: bool = False) -> list[np.ndarray]:
        """What is left out in turn, (blocks,) of bool each: recordings; `within` them, or in the only one, parts."""
        runs = self.dataset.run_of_block
        if runs[-1] > 0 and not within:
            return [runs == run for run in range(runs[-1] + 1)]
        parts = np.arange(len(runs)) % BLOCKS * LEFT_OUT // BLOCKS
        return [parts == part for part in range(LEFT_OUT)]

    def held_out(self, chosen: int | None = None, refit: bool = False, within: bool = False) -> np.ndarray:
        """Sum of squares (blocks,) that is left in blocks not used to fit the effect, nor to `refit` the model.

        A disturbance is fitted to every other block of each recording and judged on the rest.
        """
        return self._leave_out(chosen, refit, within)[0]

    def moves(self, within: bool = False) -> np.ndarray:
        """How far the parameters of those that act already move when each fold is left out, (folds, parameters); nan
        where hardly anything of what shows a parameter is left.
        """
        moves = np.array(self._leave_out(None, False, within)[1])
        energy = self.blocks[:, self.adjusted, self.adjusted]
        left = np.array([np.sum(energy[~held], axis=0) for held in self.folds(within)])
        return np.where(left > thresholds.SHOWN_LEFT * np.sum(energy, axis=0), moves, np.nan)

    def refitted_model(self, chosen: int) -> np.ndarray:
        """How far refitting the model beside a candidate moves the parameters of ModelRun.model_jacobian."""
        shared, _, target = self._layout(chosen, True)
        move = self._solve(np.sum(self.blocks, axis=0), shared, target, self._ridge(shared), self.candidates[chosen],
                           chosen)
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

    def _leave_out(self, chosen: int | None, refit: bool, within: bool) -> tuple[np.ndarray, list[np.ndarray]]:
        one = None if chosen is None else self.candidates[chosen]
        shared, own, target = self._layout(chosen, refit)
        left, moves = np.empty(len(self.blocks)), []
        ridge = self._ridge(shared) if refit else np.zeros(len(shared))
        for held in self.folds(within):
            move = self._solve(np.sum(self.blocks[~held], axis=0), shared, target, ridge, one, chosen)
            moves.append(move)
            rest = target.copy()
            rest[shared] -= move
            for run in np.unique(self.dataset.run_of_block[held]):
                inside = held & (self.dataset.run_of_block == run)
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
            final[own] -= _solution(gram[np.ix_(own, own)], gram[own] @ rest)
            left[judged] = np.einsum("i,kij,j->k", final, self.blocks[judged], final)

    def _ridge(self, shared: np.ndarray) -> np.ndarray:
        """Prior on the model's slopes: as likely to move by REFIT_FREEDOM as the gap is to be what it is."""
        total = np.sum(self.blocks[:, 0, 0]) * thresholds.CORRELATED / max(1, len(self.dataset.block))
        of_model = (shared >= self.model.start) & (shared < self.model.stop)
        return np.where(of_model, total / thresholds.REFIT_FREEDOM**2, 0.0)

    def _solve(self, gram: np.ndarray, shared: np.ndarray, target: np.ndarray, ridge: np.ndarray,
               one: Candidate | None, chosen: int | None) -> np.ndarray:
        if not len(shared):
            return np.zeros(0)
        move = _solution(gram[np.ix_(shared, shared)] + np.diag(ridge), gram[shared] @ target)
        if one is not None and not one.per_run and one.fitted:
            own = slice(len(shared) - len(one.fitted), len(shared))
            move[own] = self._within_reach(one, chosen, move[own])
        return move

    def _within_reach(self, one: Candidate, chosen: int, move: np.ndarray) -> np.ndarray:
        """The move of an effect's parameters within their bounds, and no further than its slopes are true."""
        if not one.effect.linear and len(move):
            whole = np.sum(self.blocks, axis=0)
            energy = float(move @ whole[self.jacobian[chosen], self.jacobian[chosen]] @ move)
            reach = thresholds.REACH**2 * float(whole[self.change[chosen], self.change[chosen]])
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
            energy = float(np.sum(self.blocks[:, row, row]))
            for j in range(count):
                columns = np.r_[self.change[j], self.jacobian[j]].astype(int)
                result[i, j] = self._share(row, columns, self.candidates[j].per_run) / energy if energy > 0 else 0.0
        return np.clip(result, 0.0, 1.0)

    def together(self) -> np.ndarray:
        """Sum of squares that two candidates leave together, to first order: (candidates, candidates), infinite for a
        disturbance and for a candidate with itself.
        """
        count, whole = len(self.candidates), np.sum(self.blocks, axis=0)
        result = np.full((count, count), np.inf)
        shared = [k for k, one in enumerate(self.candidates) if not one.per_run]
        for i, j in combinations(shared, 2):
            columns = np.r_[self.adjusted, self.change[i], self.jacobian[i], self.change[j], self.jacobian[j]].astype(int)
            across = whole[columns, 0]
            gained = float(across @ _solution(whole[np.ix_(columns, columns)], across))
            result[i, j] = result[j, i] = max(0.0, whole[0, 0] - gained)
        return result

    def _share(self, row: int, columns: np.ndarray, per_run: bool) -> float:
        runs = self.dataset.run_of_block
        groups = [runs == run for run in range(runs[-1] + 1)] if per_run else [np.full(len(runs), True)]
        total = 0.0
        for group in groups:
            gram = np.sum(self.blocks[group], axis=0)
            across = gram[columns, row]
            total += float(across @ _solution(gram[np.ix_(columns, columns)], across))
        return total


def _solution(gram: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Solution of the normal equations, each column scaled to 1; what is not determined stays 0."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.linalg.lstsq(gram / np.outer(scale, scale), across / scale, rcond=1e-8)[0] / scale
