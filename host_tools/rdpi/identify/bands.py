"""Slopes against rate: each band of rate fitted alone, to compare with the model's law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..data import Recording
from ..model import Model, operators
from ..simulate import chain, effects
from . import thresholds as tuned
from .document import RateBand
from .regression import Columns, Run, prepare, prior, smoothing_times_s

RATE_BINS = 8


class RateSlopes(NamedTuple):
    """Slopes fitted to narrow bands of rate one by one, to compare with the model's lines (Fig. 7 of the paper)."""

    rate_um_per_s: np.ndarray  # (bands,)
    slopes: np.ndarray  # (bands, n + 1); NaN where the band's data do not reach the interval
    samples: np.ndarray  # (bands,)

    def bands(self) -> list[RateBand]:
        """A section of the document for each band."""
        return [RateBand(rate_um_per_s=rate, slopes=[None if np.isnan(w) else w for w in slopes], samples=samples)
                for rate, slopes, samples in zip(*self)]


def rate_slopes(model: Model, runs: Sequence[Recording]) -> RateSlopes:
    """The slopes that each band of rate has when fitted alone, thresholds and saturation those of `model`."""
    return slopes_of_bands(model, prepare(_of_operator(model, runs), model, smoothing_times_s(runs), model.swept))


def _of_operator(model: Model, runs: Sequence[Recording]) -> list[Recording]:
    """The recordings as the operator alone would have made them, without the model's effects."""
    acting = effects.acting(model)
    if not acting:
        return list(runs)
    driven = [effects.driven_run(acting, run, model) for run in runs]
    alone = [one.predicted_um for one in chain.simulate(replace(model, effects=[], operator_alone=None), driven)]
    return [replace(run, columns={**run.columns, "displacement_um": run.displacement_um - (
        effects.displaced(acting, z_um, run, model) - z_um)}) for run, z_um in zip(driven, alone)]


def slopes_of_bands(model: Model, runs: Sequence[Run]) -> RateSlopes:
    from scipy.optimize import lsq_linear

    columns = Columns(model.thresholds_um, np.zeros(0), 0.0)
    n = len(model.thresholds_um)
    edges = np.linspace(0, np.percentile(np.concatenate([run.rate_um_per_s for run in runs]), 99.9), RATE_BINS + 1)
    factors = [np.zeros((0, n + 2))] * RATE_BINS
    samples, totals = np.zeros(RATE_BINS, int), np.zeros(RATE_BINS)
    for run in runs:
        start = run.first
        for block in columns.blocks(run):
            block = block[:, block.shape[1] - n - 2:]  # a slow creep is nothing that a band shows
            rate = run.rate_um_per_s[start:start + len(block)]
            start += len(block)
            block[:, -1] = operators.saturation_inverse(block[:, -1] - model.offset_um, model.deadzones_um,
                                                        model.deadzone_weights)
            bands = np.digitize(rate, edges[1:-1])
            for band in range(RATE_BINS):
                inside = bands == band
                factors[band] = np.linalg.qr(np.vstack([factors[band], block[inside]]), mode="r")
                samples[band] += np.count_nonzero(inside)
                totals[band] += np.sum(rate[inside])
    seen = samples >= 8 * n
    slopes = np.full((RATE_BINS, n), np.nan)
    for band in np.flatnonzero(seen):
        factor = factors[band] / np.sqrt(samples[band])
        factor[:, 1:] /= model.stroke_um
        residual = 1e-3
        for _ in range(3):  # the prior follows the residual, as in the fit itself
            bend = residual * np.pad(prior(n, n, 0)[0], ((0, 0), (1, 0)))
            bound = np.eye(1, n + 1) * tuned.BAND_OFFSET  # runs drift, but hardly from one rate to the next
            design = np.vstack([factor[:, :-1], bend, bound])
            target = np.r_[factor[:, -1], np.zeros(len(bend) + 1)]
            lowest = np.r_[-np.inf, np.full(n, tuned.SLOPE_FLOOR)]
            found = lsq_linear(design, target, (lowest, np.inf), method="bvls").x
            residual = float(np.linalg.norm(factor[:, :-1] @ found - factor[:, -1]))
        reached = np.linalg.norm(factor[:, 1:-1], axis=0) > 0.1 / n  # an interval the band hardly enters says nothing
        slopes[band, reached] = found[1:][reached]
    return RateSlopes(totals[seen] / samples[seen], slopes[seen], samples[seen])
