"""Every equation of the model in NumPy and double precision: the independent check of the compiled library.

Written from Ang et al., IROS 2003, whose equation numbers are given, and from the rate estimator's formula in
lib/src/f32_rate.h; plain rather than fast. simulate/numpy_inverse.py makes steps of them.
Arrays of samples have shape (samples,), of plays (n + 1,), of dead zones (m + 1,).
"""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from .model import Drive, Model, Rate

GUARD, RANGE, SLEW, INPUT, MISSED = 1, 2, 4, 8, 16  # RDPI_FLAG_... in lib/include/rdpi/types.h
MAX_REFERENCE_UM = 1e6  # RDPI_MAX_REFERENCE_UM
MAX_MISSED = 16  # RDPI_MAX_MISSED


# ---- plays ----

def play(x_um: float, r_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
    """Eq. 1: outputs of the plays of thresholds r at the input x, from their last outputs y; all (n + 1,)."""
    return np.maximum(x_um - r_um, np.minimum(x_um + r_um, y_um))


def plays(x_um: np.ndarray, r_um: np.ndarray, y_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 1 for each input of x (samples,): the outputs (samples, n + 1) and the states at the end (n + 1,), in um."""
    outputs = np.empty((len(x_um), len(r_um)))
    for k, x in enumerate(x_um):
        outputs[k] = y_um = play(x, r_um, y_um)
    return outputs, y_um


def play_weights(model: Model, rate_um_per_s: float | np.ndarray) -> np.ndarray:
    """Eq. 16: weights w_i = W_i - W_(i-1), w_0 = W_0, of the slopes W_i(rate) of eq. 14 and 15; shape (..., n + 1)."""
    return np.diff(model.slopes_at(rate_um_per_s), prepend=0.0)


def bank(y_um: np.ndarray, weights: np.ndarray) -> np.ndarray | float:
    """Eq. 9: v = sum of w_i y_i in um, over the last axis of both."""
    return np.sum(weights * y_um, axis=-1)


# ---- saturation stage ----

def dead_zone(v_um: np.ndarray, d_um: np.ndarray) -> np.ndarray:
    """Eq. 7: S_d(v) = max(v - d, 0) and S_0(v) = v; shape (samples, m + 1)."""
    return np.where(d_um > 0, np.maximum(np.subtract.outer(v_um, d_um), 0), np.expand_dims(v_um, -1))


def saturation(v_um: np.ndarray, d_um: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Eq. 8: z = sum of ws_j S_dj(v) in um, shape of v."""
    return dead_zone(v_um, d_um) @ weights


def saturation_inverse(z_um: np.ndarray, d_um: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Eq. 13: v = S^-1(z) in um, a saturation stage too; shape of z."""
    return saturation(z_um, inverse_thresholds(d_um, weights), inverse_weights(weights))


# ---- the model ----

def forward(model: Model, command_V: np.ndarray, rate_um_per_s: np.ndarray, states_um: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 17: displacement in um for commands and rates, all (samples,), and the states of the plays at the end."""
    outputs, states_um = plays(model.x_of(command_V), model.thresholds_um, states_um)
    v = bank(outputs, play_weights(model, guard(model.rate, rate_um_per_s)))
    return saturation(v, model.deadzones_um, model.deadzone_weights) + model.offset_um, states_um


# ---- the published inverse: exact while the weights are constant ----

def inverse_thresholds(thresholds_um: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Eq. 12 and 13: r'_i = sum over j <= i of w_j (r_i - r_j), and d'_j in the same way from d_j and ws_j."""
    return np.cumsum(weights) * thresholds_um - np.cumsum(weights * thresholds_um)


def inverse_weights(weights: np.ndarray) -> np.ndarray:
    """Eq. 12 and 13: w'_0 = 1 / w_0, w'_i = -w_i / ((w_0 + ... + w_i) (w_0 + ... + w_(i-1)))."""
    sums = np.cumsum(weights)
    return np.concatenate([1 / sums[:1], -weights[1:] / (sums[1:] * sums[:-1])])


def inverse_states(y_um: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Eq. 12: y'_i = sum over j <= i of w_j y_i + sum over j > i of w_j y_j."""
    return np.cumsum(weights) * y_um + bank(y_um, weights) - np.cumsum(weights * y_um)


def formula_inverse(model: Model, z_um: np.ndarray, rate_um_per_s: np.ndarray, states_um: np.ndarray) -> np.ndarray:
    """Eq. 10 and 18: the control input x in um (samples,) for z and the rate (samples,), plays starting at `states_um`.

    A second bank of plays on S^-1(z), its thresholds and weights computed anew from each sample's rate.
    """
    v = saturation_inverse(z_um, model.deadzones_um, model.deadzone_weights)
    weights = play_weights(model, guard(model.rate, rate_um_per_s))
    y = inverse_states(states_um, weights[0])
    x = np.empty_like(v)
    for k, w in enumerate(weights):
        y = play(v[k], inverse_thresholds(model.thresholds_um, w), y)
        x[k] = bank(y, inverse_weights(w))
    return x


# ---- the exact inverse ----

def solve(v_um: float, r_um: np.ndarray, weights: np.ndarray, y_um: np.ndarray) -> float:
    """The input x in um at which the bank's output is v: sum of w_i play_i(x) = v for plays in the states y (n + 1,).

    The sum is continuous and increasing in x, and linear between the corners y_i - r_i and y_i + r_i: evaluate it there
    by eq. 1 and interpolate. Beyond the outermost corners every play moves along.
    """
    corners = np.sort(np.concatenate([y_um - r_um, y_um + r_um]))
    heights = play(corners[:, None], r_um, y_um) @ weights
    beyond = v_um - min(max(v_um, heights[0]), heights[-1])
    return float(np.interp(v_um, heights, corners) + beyond / np.sum(weights))


# ---- rate and limits ----

def rate(z_um: np.ndarray, sample_time_s: float, window_s: float, filter_s: float) -> np.ndarray:
    """|dz/dt| in um/s (samples,): difference over the window, z_0 standing for what came before, then the low-pass."""
    window = max(1, int(np.floor(window_s / sample_time_s + 0.5)))
    before = z_um[np.maximum(np.arange(len(z_um)) - window, 0)]
    raw = np.abs(z_um - before) / (window * sample_time_s)
    blend = -np.expm1(-sample_time_s / filter_s) if filter_s > 0 else 1.0
    return np.array(list(accumulate(raw, lambda last, new: last + blend * (new - last))))


def guard(limits: Rate, rate_um_per_s: np.ndarray) -> np.ndarray:
    """The rate clamped below the singularity, um/s."""
    return np.minimum(rate_um_per_s, limits.max_um_per_s)


def limit(drive: Drive, wish_V: float, last_V: float, sample_time_s: float) -> tuple[float, int]:
    """The drive in V that range and slew leave of a wish, `last_V` being the one before, and its flags."""
    within_V = min(max(wish_V, drive.min_V), drive.max_V)
    reach_V = np.inf if drive.slew_V_per_s is None else drive.slew_V_per_s * sample_time_s
    limited_V = min(max(within_V, last_V - reach_V), last_V + reach_V)
    return limited_V, RANGE * (within_V != wish_V) | SLEW * (limited_V != within_V)


def quantise(drive: Drive, drive_V: float) -> tuple[float, int]:
    """The drive in V that the DAC makes of one inside the range, and its code; unchanged and 0 without a DAC."""
    if drive.dac_bits is None:
        return drive_V, 0
    step_V = (drive.max_V - drive.min_V) / (2**drive.dac_bits - 1)
    code = int((drive_V - drive.min_V) / step_V + 0.5)
    return min(drive.min_V + code * step_V, drive.max_V), code
