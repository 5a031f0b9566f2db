"""Curves of the operator from its parameters: where slopes reach zero, intercepts, the inverse saturation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .model import Model

GUARD_SLACK = 0.999  # rounding must not carry the guard past its limit


def guard_rates(slopes: np.ndarray, slope_rate_s_per_um: np.ndarray) -> np.ndarray:
    """Rate in um/s at which each slope reaches zero, inf where it does not fall; shape (n + 1,)."""
    falling = slope_rate_s_per_um < 0
    return np.where(falling, slopes / np.where(falling, -slope_rate_s_per_um, 1), np.inf)


def guarded(model: Model, highest_um_per_s: float, slack: float = GUARD_SLACK) -> Model:
    """The model with its guard where its first slope has fallen to rate.min_slope_ratio, at most at a rate."""
    share = slack * (1 - model.rate.min_slope_ratio)
    singular = float(np.min(guard_rates(model.slopes, model.slope_rate_s_per_um)))
    return replace(model, rate=replace(model.rate, max_um_per_s=min(share * singular, highest_um_per_s),
                                       singular_um_per_s=singular if np.isfinite(singular) else None))


def intercepts(thresholds_um: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """P_i of the loading curve W_i x - P_i: P_0 = 0, P_i = P_(i-1) + (W_i - W_(i-1)) r_i; or its change with c_i."""
    return np.cumsum(np.diff(slopes, prepend=slopes[0]) * thresholds_um)


def loop_ends_um(model: Model) -> tuple[float, float]:
    """Output of the plays, before the saturation, at the lowest and at the highest x of the greatest loop.

    There plays lag by their thresholds: v = W_n x + sum of w_i r_i at the low end, minus it at the high end. A play whose
    threshold exceeds half of the range rests in its middle.
    """
    low_um, high_um = np.sort(model.x_of(np.array([model.drive.min_V, model.drive.max_V])))
    lag_um = np.diff(model.slopes, prepend=0.0) @ np.minimum(model.thresholds_um, (high_um - low_um) / 2)
    return float(model.slopes[-1] * low_um + lag_um), float(model.slopes[-1] * high_um - lag_um)


def inverse_saturation(deadzones_um: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 13: thresholds d'_j = S(d_j), and weights w'_j whose partial sums are one over those of the weights."""
    slopes = np.cumsum(weights)
    corners = np.concatenate([[0.0], np.cumsum(slopes[:-1] * np.diff(deadzones_um))])
    return corners, np.diff(np.divide(1, slopes, out=np.zeros(len(slopes)), where=slopes != 0), prepend=0.0)


def along(values: np.ndarray | float, xs: Sequence[float], ys: Sequence[float]) -> np.ndarray | float:
    """y at each value of x on the straight pieces through the points; the first and the last piece go on beyond.

    Points ascend in x.
    """
    xs, ys = np.asarray(xs, float), np.asarray(ys, float)
    k = np.clip(np.searchsorted(xs, values) - 1, 0, len(xs) - 2)
    return ys[k] + (values - xs[k]) * ((ys[k + 1] - ys[k]) / (xs[k + 1] - xs[k]))
