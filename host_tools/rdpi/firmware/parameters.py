"""From a model to the numbers of the library's parameter structs, field by field: lib/include/rdpi/f32.h and q31.h say
what each one is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from ..errors import BadInput
from ..model import LEAST_SAMPLE_S, MAX_REFERENCE_UM, TOLERANCE, Drive, Model, intercepts, inverse_saturation

ONE, MAX_DRIVE, MIN_SLOPE = 2**30, 2**29, 2**24  # RDPI_Q31_...
NO_REFERENCE, INT32_MAX, UINT32_MAX = -(2**31), 2**31 - 1, 2**32 - 1
LARGEST_DRIVE = MAX_DRIVE - 256  # leaves room for rounding, of states once per play
MIN_SPAN, MIN_CODE = 2**20, 16  # drive units in the output range, and in one step of the DAC


@dataclass(frozen=True)
class F32:
    """rdpi_f32_params_t without schema and digest; every number as `dtype` rounds it. Rows of tables are C structs."""

    plays: int
    deadzones: int
    dac_bits: int
    curve_pieces: int
    noise_shaping: int
    sweep_cycles: int
    offset_um: float
    rate_window_s: float
    rate_filter_s: float
    max_um_per_s: float
    min_slope_ratio: float
    min_V: float
    max_V: float
    slew_V_per_s: float
    sweep_V_per_s: float
    sweep_end_V: float
    sweep_forgotten: float
    min_sample_time_s: float
    max_sample_time_s: float
    last_code: float
    V_per_code: float
    play: np.ndarray  # (n + 1, 5): r, slope, slope_rate, intercept, intercept_rate
    saturation: np.ndarray  # (m + 1, 2): d, weight
    inverse_saturation: np.ndarray  # (m + 1, 4): from, to, slope, intercept
    curve: np.ndarray  # (1 to 8, 13): the fields of rdpi_f32_line_t in their order
    memory_um: np.ndarray  # (n + 1,)


def f32(model: Model, dtype: type = np.float32) -> F32:
    """Parameters in single precision, or with np.float64 those of the library compiled for double.

    What follows from other fields is computed from these as rounded, so that it fits what is flashed. Nothing is
    checked but lengths: numbers that the library must refuse pass through.
    """
    model.validate_lengths()

    def rounded(values: np.ndarray | float) -> np.ndarray:
        return np.asarray(values, dtype).astype(float)

    rate, drive = model.rate, model.drive
    with np.errstate(all="ignore"):
        r, slopes, slope_rates = map(rounded, (model.thresholds_um, model.slopes, model.slope_rate_s_per_um))
        d, weights = map(rounded, (model.deadzones_um, model.deadzone_weights))
        limits_V = float(rounded(drive.min_V)), float(rounded(drive.max_V))
        corners, inverse = inverse_saturation(d, weights)
        numbers = dict(
            offset_um=model.offset_um,
            rate_window_s=rate.window_s, rate_filter_s=rate.filter_s, max_um_per_s=rate.max_um_per_s,
            min_slope_ratio=rate.min_slope_ratio, min_V=drive.min_V, max_V=drive.max_V,
            slew_V_per_s=drive.slew_V_per_s or 0.0, sweep_V_per_s=drive.sweep_speed(), sweep_end_V=model.sweep_end(),
            sweep_forgotten=1 - model.memory.followed_share(), **_sample_times(model),
            **_codes(*limits_V, drive.dac_bits or 0, dtype))
        curve = _curve(model, *limits_V, rounded)
        play = (r, slopes, slope_rates, intercepts(r, slopes), intercepts(r, slope_rates))
        return F32(
            len(r), len(d), drive.dac_bits or 0, len(curve), int(drive.noise_shaping), drive.sweep_cycles,
            **{key: float(rounded(value)) for key, value in numbers.items()},
            play=np.stack(play, axis=1).astype(dtype), saturation=np.stack([d, weights], axis=1).astype(dtype),
            inverse_saturation=_pieces(d, corners, np.cumsum(inverse), float(rounded(model.offset_um))).astype(dtype),
            curve=curve.astype(dtype), memory_um=np.array(model.memory.plays_um, dtype))


def _sample_times(model: Model) -> dict[str, float]:
    if not model.drive.sweep_speed() > 0 or model.shortest_sample_s() > 1:  # the library refuses the sweep
        return {"min_sample_time_s": 0.0, "max_sample_time_s": 0.0}
    shortest_s, longest_s = model.sample_times_s()
    return {"min_sample_time_s": shortest_s, "max_sample_time_s": longest_s}


def _codes(min_V: float, max_V: float, bits: int, dtype: type) -> dict[str, float]:
    """From DAC codes to drives."""
    if not (bits and max_V > min_V):
        return {"last_code": 0.0, "V_per_code": 0.0}
    last = 2**bits - 1
    # The last code is inside the range with it, rounded once or twice.
    step_V = dtype(np.float64(max_V - min_V) / last)
    while step_V > 0 and max(min_V + last * float(step_V), dtype(min_V) + dtype(last) * step_V) > max_V:
        step_V = np.nextafter(step_V, dtype(0))
    return {"last_code": last, "V_per_code": step_V}


def _curve(model: Model, min_V: float, max_V: float, rounded: Callable[[float], np.ndarray]) -> np.ndarray:
    """Rows of the input curve, from x to DAC codes and back. Pieces end at codes, where there are codes."""
    ends_V, step_V = _ends(model.drive, min_V, max_V)
    gain, offset_V = float(rounded(model.gain_um_per_V)), float(rounded(model.offset_V))
    rows = []
    for k, (from_V, to_V) in enumerate(zip(ends_V, ends_V[1:])):
        if model.drive.curve_V:
            ends_um = [model.gain_um_per_V * (model.drive.at_plays(volt) - model.offset_V) for volt in (from_V, to_V)]
            gain = float(rounded((ends_um[1] - ends_um[0]) / (to_V - from_V)))
            offset_V = float(rounded(to_V - ends_um[1] / gain))
        codes = [0.0] * 6
        if step_V and gain:
            codes = [np.rint((from_V - min_V) / step_V), np.rint((to_V - min_V) / step_V), 1 / (gain * step_V),
                     (offset_V - min_V) / step_V + 0.5, gain * step_V, gain * (min_V - offset_V)]
        middle_um, reach_um = gain * ((from_V + to_V) / 2 - offset_V), abs(gain) * (to_V - from_V) / 2
        rows.append([to_V, gain * (to_V - offset_V), middle_um, reach_um, gain, 1 / gain if gain else 0.0, offset_V,
                     *codes])
    return np.array([[float(rounded(value)) for value in row] for row in rows])


def _ends(drive: Drive, min_V: float, max_V: float) -> tuple[list[float], float]:
    """Where the pieces of the input curve end, in V, the codes next to its corners; and the step of the codes."""
    bits = drive.dac_bits or 0
    step_V = np.float64(max_V - min_V) / (2**bits - 1) if bits and max_V > min_V else 0.0
    inner = [volt for volt, _ in drive.curve_V[1:-1]]
    if step_V:
        inner = [min_V + step_V * np.rint((volt - min_V) / step_V) for volt in inner]
    return [min_V, *inner, max_V], step_V


def _pieces(d: np.ndarray, corners: np.ndarray, slopes: np.ndarray, offset_um: float) -> np.ndarray:
    """Rows of S^-1, (m + 1, 4), which passes through d at z = `corners`."""
    ends = [-MAX_REFERENCE_UM, *(corners[1:] + offset_um), MAX_REFERENCE_UM]
    return np.stack([ends[:-1], ends[1:], slopes, d - slopes * corners], axis=1)


@dataclass(frozen=True)
class Scale:
    """What the integers of rdpi_q31_params_t stand for."""

    V_per_drive: float  # of the gain's sign
    offset_V: float  # of drive 0
    um_per_drive: float  # of the bank's input, states and thresholds, whose unit is that of straight drives
    um_per_v: float  # of the bank's output
    um_per_reference: float
    offset_um: float  # of reference 0
    um_per_s_per_rate: float


@dataclass(frozen=True)
class Q31:
    """rdpi_q31_params_t without schema and digest, and what its numbers stand for. Rows of tables are C structs."""

    slew_per_us: int
    sweep_per_us: int
    plays: int
    deadzones: int
    dac_bits: int
    curve_pieces: int
    noise_shaping: int
    sweep_cycles: int
    saturation_shift: int
    inverse_shift: int
    code_shift: int
    drive_shift: int
    guard_exponent: int
    min_slope_ratio: int
    guard_mantissa: int
    rate_window_ns: int
    rate_filter_ns: int
    min_drive: int
    max_drive: int
    min_x: int
    max_x: int
    min_mV: int
    max_mV: int
    unit_mantissa: int
    unit_exponent: int
    drive_of_code_0: int
    codes_per_drive: int
    drive_per_code: int
    sweep_end: int
    sweep_forgotten: int
    min_sample_time_ns: int
    max_sample_time_ns: int
    play: np.ndarray  # int32 (n + 1, 3): r, slope, slope_rate
    saturation: np.ndarray  # int32 (m + 1, 2): d, weight
    inverse_saturation: np.ndarray  # int32 (m + 1, 2)
    curve: np.ndarray  # int32 (1 to 8, 6): the fields of rdpi_q31_line_t in their order
    memory: np.ndarray  # int32 (n + 1,)
    scale: Scale


def q31(model: Model) -> Q31:
    """Parameters in fixed point, of a valid model. Raises BadInput, naming key and remedy, where 32 bits do not do."""
    model.validate_lengths()
    model = _straight(model)
    rate, drive = model.rate, model.drive

    def refuse(key: str, what: str) -> None:
        raise BadInput(f"{model.where}: no fixed point: {key}: {what}")

    # drives, the operator's input x, thresholds and states share one unit
    limits_um = sorted(model.gain_um_per_V * (volt - model.offset_V) for volt in (drive.min_V, drive.max_V))
    range_um = sorted(float(model.x_of(volt)) for volt in (drive.min_V, drive.max_V))
    largest_um = max(np.max(np.abs(values)) for values in (limits_um, range_um, model.thresholds_um, model.memory.plays_um))
    per_um = LARGEST_DRIVE / largest_um
    min_drive, max_drive = (round(end * per_um) for end in limits_um)
    curve = _q31_curve(model, per_um)
    min_x, max_x = (round(end * per_um) for end in range_um)
    steps = MIN_CODE * (2 ** (drive.dac_bits or 0) - 1)
    if min(max_drive - min_drive, max_x - min_x) < max(MIN_SPAN, steps):
        refuse("drive", f"the range {drive.min_V:g} to {drive.max_V:g} V is {max_drive - min_drive} units where the "
                        f"largest drive, threshold or state is {LARGEST_DRIVE}; move offset_V to its middle, or use "
                        "float")
    r = np.array([round(threshold * per_um) for threshold in model.thresholds_um])
    if np.any(np.diff(r) <= 0):
        refuse("thresholds_um", f"two lie within {1 / per_um:.3g} um; leave one out")

    # slopes: the largest is ONE
    ends = np.array([model.slopes, model.slopes_at(rate.max_um_per_s)])
    per_slope = ONE / np.max(ends)
    rest, fastest = np.rint(ends * per_slope).astype(int)
    if min(rest.min(), fastest.min()) < MIN_SLOPE:
        refuse("slopes", f"at rest or at the guard they span {ends.min():.3g} to {ends.max():.3g}, more than 1 : "
                         f"{ONE // MIN_SLOPE}; raise min_slope_ratio, lower max_um_per_s, or use float")
    ratio = min(int(rate.min_slope_ratio * 65536), *(fastest * 65536 // rest).tolist())
    if ratio < 1:
        refuse("rate.min_slope_ratio", f"{rate.min_slope_ratio:g} is below 1 / 65536; raise it")

    # saturation: reference units such that the reach is about ONE
    um_per_v = float(np.max(ends)) / per_um
    lag = np.abs(ends[:, :-1] - ends[:, -1:]) @ np.diff(model.thresholds_um)
    v_um = float(np.max(max(-range_um[0], range_um[1]) * ends[:, -1] + lag))
    d, weights = model.deadzones_um, model.deadzone_weights
    um_per_reference = max(float(np.clip(v_um - d, 0, None) @ weights), float(weights[0]) * v_um) / ONE
    corners, inverse = inverse_saturation(d, weights)
    saturation, saturation_shift = _stage(d / um_per_v, weights * (um_per_v / um_per_reference))
    inverse, inverse_shift = _stage(corners / um_per_reference, inverse * (um_per_reference / um_per_v))
    for stage in (saturation, inverse):
        beyond = np.sum(np.abs(stage[:, 1])) > INT32_MAX
        if beyond or np.any(np.cumsum(stage[:, 1]) <= 0) or np.any(np.diff(stage[:, 0]) <= 0):
            refuse("deadzones_um", "two lie too close together, or their pieces' slopes too far apart, for 32 bits; "
                                   "fit with fewer dead zones, or use float")

    for key, seconds in (("window_s", rate.window_s), ("filter_s", rate.filter_s)):
        if not seconds * 1e9 < 2**32 - 1:
            refuse(f"rate.{key}", f"is {seconds:g} s; at most 4.29 s fit 32 bits of ns")
    mantissa, exponent = _floating(rate.max_um_per_s * 1e-9 / um_per_reference)
    per_volt_per_us = abs(model.gain_um_per_V) * per_um * 1e-6 * 2**32
    slew, sweep = (min(round(speed * per_volt_per_us), 2**64 - 1) for speed in (drive.slew_V_per_s or 0.0,
                                                                               drive.sweep_speed()))
    if sweep < 1:
        refuse("drive.sweep_V_per_s", f"a start-up sweep of {drive.sweep_speed():g} V/s is too slow for 32 bits; "
                                      "allow a faster one")
    rising = model.gain_um_per_V > 0
    codes = Fraction(2 ** (drive.dac_bits or 0) - 1, max_drive - min_drive) * (1 if rising else -1)
    (per_drive, code_shift), (per_code, drive_shift) = map(_shifted, (codes, 1 / codes)) if codes else ((0, 1), (0, 1))
    memory_um = model.memory.plays_um.copy()
    memory_um[0] = min(max(memory_um[0], range_um[0]), range_um[1])
    return Q31(
        slew, sweep, len(r), len(d), drive.dac_bits or 0, len(curve), int(drive.noise_shaping), drive.sweep_cycles,
        saturation_shift, inverse_shift, code_shift, drive_shift, exponent, ratio, mantissa, round(rate.window_s * 1e9), round(rate.filter_s * 1e9),
        min_drive, max_drive, min_x, max_x,
        _millivolts(drive.min_V), _millivolts(drive.max_V), *_floating(um_per_reference),
        min_drive if rising else max_drive, per_drive, per_code,
        round(model.gain_um_per_V * (model.sweep_end() - model.offset_V) * per_um), round((1 - model.memory.followed_share()) * ONE),
        max(round(LEAST_SAMPLE_S * 1e9), -(-1000 // sweep)), min(round(model.sample_times_s()[1] * 1e9), UINT32_MAX),
        np.stack([r, rest, fastest - rest], axis=1).astype(np.int32),
        saturation.astype(np.int32), inverse.astype(np.int32), curve, states(memory_um, 1 / per_um, r, math.inf),
        Scale(1 / (per_um * model.gain_um_per_V), model.offset_V, 1 / per_um, um_per_v, um_per_reference,
              model.offset_um, rate.max_um_per_s / ONE))


def _millivolts(volt: float) -> int:
    """Rounded, and limited to what an int32 holds."""
    return int(min(max(round(volt * 1000), -INT32_MAX), INT32_MAX))


def _straight(model: Model) -> Model:
    """The model without a curve where that is one straight line, which gain and offset can hold."""
    points = model.drive.curve_V
    if len(points) != 2:
        return model
    (from_V, from_plays_V), (to_V, to_plays_V) = points
    slope = (to_plays_V - from_plays_V) / (to_V - from_V)
    return replace(model, gain_um_per_V=model.gain_um_per_V * slope, drive=replace(model.drive, curve_V=()),
                   offset_V=from_V - (from_plays_V - model.offset_V) / slope)


def _q31_curve(model: Model, per_um: float) -> np.ndarray:
    """Rows of the input curve, in the order of the drive. A single one is not read."""
    if not model.drive.curve_V:
        return np.zeros((1, 6), np.int32)
    ends_V = np.array(_ends(model.drive, model.drive.min_V, model.drive.max_V)[0])
    drives, x = (sorted(round(value * per_um) for value in values.tolist())
                 for values in (model.gain_um_per_V * (ends_V - model.offset_V), model.x_of(ends_V)))
    rows = []
    for k in range(len(ends_V) - 1):
        slope = Fraction(max(x[k + 1] - x[k], 1), max(drives[k + 1] - drives[k], 1))
        (x_per_drive, x_shift), (drive_per_x, drive_shift) = _shifted(slope), _shifted(1 / slope)
        rows.append([drives[k], x[k], x_per_drive, drive_per_x, x_shift, drive_shift])
    return np.array(rows, np.int32)


def integers(values: np.ndarray | float, unit: float, zero: float = 0.0) -> np.ndarray:
    """Values in units as int32, rounded and saturated; NaN becomes NO_REFERENCE, which is nothing else."""
    with np.errstate(over="ignore"):
        scaled = np.rint((np.asarray(values, float) - zero) / unit)
    return np.where(np.isnan(scaled), NO_REFERENCE, np.clip(scaled, -INT32_MAX, INT32_MAX)).astype(np.int32)


def states(y_um: np.ndarray, um_per_drive: float, r: np.ndarray, tolerance: float = TOLERANCE) -> np.ndarray:
    """States of the plays of integer thresholds r as integers, int32 (n + 1,). What rounding, or the model's own
    `tolerance`, puts beyond what one history can leave goes back there; what is further off is left to be refused.
    """
    result = integers(y_um, um_per_drive).astype(int)
    for i, gap in enumerate(np.diff(r), start=1):
        nearest = min(max(result[i], result[i - 1] - gap), result[i - 1] + gap)
        if abs(nearest - result[i]) <= 2 + tolerance * (r[-1] + abs(result[i])):
            result[i] = nearest
    return result.astype(np.int32)


def _stage(thresholds: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, int]:
    """Rows d, weight of a saturation stage in integers, (m + 1, 2), and the weights' shift: as large as they allow."""
    slopes = [Fraction(float(slope)) for slope in np.cumsum(weights)]
    for shift in range(62, -1, -1):
        sums = [0, *(round(slope * 2**shift) for slope in slopes)]
        rounded = [above - below for below, above in zip(sums, sums[1:])]
        if sum(map(abs, rounded)) <= INT32_MAX:
            break
    largest = INT32_MAX - np.arange(len(thresholds))[::-1]  # beyond all reach, in their order
    return np.stack([np.minimum(np.rint(thresholds), largest).astype(int), rounded], axis=1), shift


def _floating(value: float) -> tuple[int, int]:
    """Mantissa, 2^31 to 2^32 - 1, and exponent of a positive number."""
    fraction, exponent = math.frexp(value)
    return int(fraction * 2**32), exponent - 32


def _shifted(value: Fraction) -> tuple[int, int]:
    """An integer of up to 31 bits and the shift, 1 to 62, that make the number."""
    shift = next(shift for shift in range(62, 0, -1) if abs(round(value * 2**shift)) <= INT32_MAX)
    return round(value * 2**shift), shift
