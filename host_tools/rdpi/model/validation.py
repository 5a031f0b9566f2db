"""What makes a model's numbers no model, or none that the firmware takes: refused by key, with a remedy."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..errors import BadInput
from .curves import guard_rates, intercepts, inverse_saturation
from .limits import (LARGEST, LEAST_SLOPE, MAX_CURVE_PIECES, MAX_DAC_BITS, MAX_OFFSET, MAX_SWEEP_CYCLES, MIN_SPAN_V,
                     SOURCES, TOLERANCE, SWEEP_SAMPLES)

if TYPE_CHECKING:
    from .model import Drive, Model

Refuse = Callable[[str, str], None]  # key and what is wrong with it


def check_finite(model: Model, where: str) -> None:
    """Raise BadInput, naming the key, for a number that is not finite or beyond what the firmware takes."""
    for key, value in model.numbers().items():
        if not np.all(np.abs(value) <= LARGEST):  # refuses NaN too
            raise BadInput(f"{where}: {key}: must be finite, within ±{LARGEST:g}, as the firmware requires")


def check_curve(drive: Drive, where: str) -> None:
    """Raise BadInput unless the input curve, if there is one, has pieces over all of the range that rise."""
    if not drive.curve_V:
        return
    points = np.array(drive.curve_V, float)
    if points.ndim != 2 or points.shape[1] != 2 or not 2 <= len(points) <= MAX_CURVE_PIECES + 1:
        raise BadInput(f"{where}: drive.curve_V: must be 2 to {MAX_CURVE_PIECES + 1} points, each in V at the output "
                       "and V at the plays")
    if not np.all(np.abs(points) <= LARGEST) or np.any(np.diff(points, axis=0) <= 0):
        raise BadInput(f"{where}: drive.curve_V: must be finite and increase in both columns")
    if (points[0, 0], points[-1, 0]) != (drive.min_V, drive.max_V):
        raise BadInput(f"{where}: drive.curve_V: is from {points[0, 0]:g} to {points[-1, 0]:g} V; must be over the "
                       f"range of the drive, {drive.min_V:g} to {drive.max_V:g} V")


def check_values(model: Model, where: str) -> None:
    """Raise BadInput, naming the key and a remedy, for values that make no model. Arrays must have their lengths."""
    def refuse(key: str, what: str) -> None:
        raise BadInput(f"{where}: {key}: {what}")

    def ascending(key: str, values: np.ndarray) -> None:
        if values[0] != 0 or np.any(np.diff(values) <= 0):
            refuse(key, f"must start at 0 and increase, got {_short(values)}; sort the values, none twice")

    if not abs(model.gain_um_per_V) >= 1 / LARGEST:
        refuse("gain_um_per_V", f"is {model.gain_um_per_V:g}; x = gain (V - offset_V) needs a gain, "
                                f"at least ±{1 / LARGEST:g} um/V")
    if not model.stroke_um > 0:
        refuse("stroke_um", f"is {model.stroke_um:g}; must be positive")
    ascending("thresholds_um", model.thresholds_um)
    if not np.all(model.slopes >= LEAST_SLOPE):
        i = int(np.argmin(model.slopes))
        refuse(f"slopes[{i}]", f"is {model.slopes[i]:g}; every slope must be positive, at least {LEAST_SLOPE:g}, or "
                               "the model has no inverse")
    for key, values in (("slopes", model.slopes), ("slope_rate_s_per_um", model.slope_rate_s_per_um)):
        largest = np.max(np.abs(intercepts(model.thresholds_um, values)))
        if largest > LARGEST:
            refuse(key, f"with these thresholds_um its intercepts reach {largest:.3g}, beyond ±{LARGEST:g}, "
                        "the firmware's limit; check the units of both")
    ascending("deadzones_um", model.deadzones_um)
    pieces = np.cumsum(model.deadzone_weights)
    if not np.all(pieces > 0):
        j = int(np.argmin(pieces))
        refuse("deadzone_weights", f"the weights up to [{j}] sum to {pieces[j]:g}; every partial sum must be "
                                   "positive, or the saturation stage has no inverse")
    with np.errstate(over="ignore"):
        inverse = np.abs(inverse_saturation(model.deadzones_um, model.deadzone_weights))
    if not np.all(inverse <= LARGEST):
        refuse("deadzone_weights", f"partial sums of {pieces.min():.3g} to {pieces.max():.3g} make an inverse "
                                   f"beyond ±{LARGEST:g}, the firmware's limit; fit with fewer dead zones")
    _check_rate(model, refuse)
    _check_drive(model, refuse)
    for key, offset, scale, unit in (("offset_um", model.offset_um, model.stroke_um, "um"),
                                     ("offset_V", model.offset_V, model.drive.max_V - model.drive.min_V, "V")):
        if abs(offset) > MAX_OFFSET * scale:
            refuse(key, f"is {offset:g} {unit}, over {MAX_OFFSET:g} times the range of {scale:g} {unit}: "
                        "single precision cannot hold both; subtract the offset first")


def _check_rate(model: Model, refuse: Refuse) -> None:
    rate = model.rate
    if not isinstance(rate.source, str) or rate.source not in SOURCES:
        refuse("rate.source", f'is "{rate.source}"; must be one of {", ".join(SOURCES)}')
    for key in ("window_s", "filter_s", "smoothing_s"):
        if getattr(rate, key) < 0:
            refuse(f"rate.{key}", f"is {getattr(rate, key):g} s; must not be negative")
        if getattr(rate, key) > LARGEST:
            refuse(f"rate.{key}", f"is {getattr(rate, key):g} s; must not exceed {LARGEST:g} s")
    if rate.identified_um_per_s is not None and not rate.identified_um_per_s >= 1 / LARGEST:
        refuse("rate.identified_um_per_s", f"is {rate.identified_um_per_s:g}; must be positive, or null")
    if not rate.max_um_per_s > 0:
        refuse("rate.max_um_per_s", f"is {rate.max_um_per_s:g}; must be positive")
    if not 0 < rate.min_slope_ratio < 1:
        refuse("rate.min_slope_ratio", f"is {rate.min_slope_ratio:g}; must lie between 0 and 1")
    floor = np.maximum(rate.min_slope_ratio * (1 - TOLERANCE) * model.slopes, LEAST_SLOPE)
    fastest = model.slopes_at(rate.max_um_per_s)
    if np.any(fastest < floor):
        with np.errstate(over="ignore"):
            i = int(np.argmin(fastest / model.slopes))
        limit = (1 - rate.min_slope_ratio) * guard_rates(model.slopes, model.slope_rate_s_per_um)[i]
        refuse("rate.max_um_per_s",
               f"at {rate.max_um_per_s:g} um/s slope {i} has fallen to {fastest[i]:.3g}, below "
               f"{rate.min_slope_ratio:g} of its {model.slopes[i]:.3g} at rest; use {limit:.4g} or less")


def _check_drive(model: Model, refuse: Refuse) -> None:
    drive, memory = model.drive, model.memory
    if not drive.max_V - drive.min_V >= MIN_SPAN_V:
        refuse("drive", f"min_V {drive.min_V:g} must be below max_V {drive.max_V:g}, by {MIN_SPAN_V:g} V at least")
    if drive.slew_V_per_s is not None and not drive.slew_V_per_s > 0:
        refuse("drive.slew_V_per_s", f"is {drive.slew_V_per_s:g}; must be positive, or null for no limit")
    if drive.dac_bits is not None and not 1 <= drive.dac_bits <= MAX_DAC_BITS:
        refuse("drive.dac_bits", f"is {drive.dac_bits}; must be 1 to {MAX_DAC_BITS}, or null")
    _check_sweep(model, refuse)
    if memory.sweep_share is not None and not 0 <= memory.sweep_share <= 1:
        refuse("memory.sweep_share", f"is {memory.sweep_share:g}; must be 0 to 1, or null")
    if not math.isclose(memory.plays_um[0], memory.x_um, rel_tol=TOLERANCE, abs_tol=TOLERANCE * model.stroke_um):
        refuse("memory.plays_um[0]",
               f"is {memory.plays_um[0]:g}, but must be x_um = {memory.x_um:g} (its threshold is 0)")
    # As rdpi_f32_check_memory has it; a tenth less, for what single precision makes of the numbers.
    slack = 0.9 * TOLERANCE * (model.thresholds_um[-1] + np.abs(memory.plays_um[:-1]))
    if np.any(np.abs(np.diff(memory.plays_um)) > np.diff(model.thresholds_um) + slack):
        refuse("memory.plays_um",
               "no history leaves these states: neighbours may differ at most by the difference of their thresholds")
    with np.errstate(over="ignore"):
        start_V = model.start_V()
    slack = TOLERANCE * (drive.max_V - drive.min_V)
    if not drive.min_V - slack <= start_V <= drive.max_V + slack:
        refuse("memory.x_um", f"is held by {start_V:g} V, outside drive {drive.min_V:g} to {drive.max_V:g} V")


def _check_sweep(model: Model, refuse: Refuse) -> None:
    drive, end_V, speed = model.drive, model.sweep_end(), model.drive.sweep_speed()
    if not 1 <= drive.sweep_cycles <= MAX_SWEEP_CYCLES:
        refuse("drive.sweep_cycles", f"is {drive.sweep_cycles}; must be 1 to {MAX_SWEEP_CYCLES}")
    if not drive.min_V <= end_V <= drive.max_V:
        refuse("drive.sweep_end_V", f"is {end_V:g} V, outside drive {drive.min_V:g} to {drive.max_V:g} V")
    limited = "slew_V_per_s" if drive.slew_V_per_s else "max_V"
    given = "drive." + (limited if drive.sweep_V_per_s is None else "sweep_V_per_s")
    if not speed > 0:
        refuse(given, f"is {speed:g}; must be positive")
    if drive.slew_V_per_s is not None and speed > drive.slew_V_per_s:
        refuse("drive.sweep_V_per_s", f"is {speed:g} V/s, above slew_V_per_s, {drive.slew_V_per_s:g}; "
                                      "sweep no faster than the limit")
    if model.shortest_sample_s() > 1:
        refuse(given, f"a start-up sweep of {speed:g} V/s is too slow: in single precision the drive would not "
                      "move from one sample to the next; allow a faster one or a wider range")
    shortest_s, longest_s = model.sample_times_s()
    if shortest_s > longest_s:
        refuse(given, f"a start-up sweep of {speed:g} V/s crosses the range in {SWEEP_SAMPLES * longest_s:.3g} s, "
                      f"faster than {SWEEP_SAMPLES} samples of any controller; allow a slower one")


def _short(values: np.ndarray) -> str:
    text = ", ".join(f"{value:g}" for value in values[:6])
    return f"[{text}{', …' if len(values) > 6 else ''}]"
