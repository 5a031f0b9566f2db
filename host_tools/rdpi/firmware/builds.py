"""What a model asks of the build that flashes it."""

from __future__ import annotations

import math

import numpy as np

from ..errors import BadInput
from ..model import Model
from .chain import Chain

DEFAULTS = {"RDPI_MAX_PLAYS": 16, "RDPI_MAX_DEADZONES": 8, "RDPI_MAX_WINDOW": 16,
            "RDPI_MAX_POLES": 12}  # lib/include/rdpi/types.h
USUAL_SAMPLE_S = 1e-6  # no firmware takes samples faster, so that a shorter limit need not be told


def build_options(model: Model, rate_hz: float | None = None, chain: Chain = Chain()) -> dict[str, int]:
    """Macros that the library and its users must be compiled with, by name, where the default is too small.

    The rate window depends on `rate_hz`, in samples per second; without it, its macro is left out.
    """
    needs = {"RDPI_MAX_PLAYS": len(model.slopes), "RDPI_MAX_DEADZONES": len(model.deadzones_um),
             "RDPI_MAX_POLES": len(chain.poles)}
    if rate_hz is not None:
        needs["RDPI_MAX_WINDOW"] = math.ceil(model.rate.window_s * rate_hz) + 1
    return {name: need for name, need in needs.items() if need > DEFAULTS[name]}


def beyond_sample_times(model: Model, sample_time_s: float) -> str:
    """Why the firmware does not take the model at this sample time; empty if it does."""
    shortest_s, longest_s = model.sample_times_s()
    if np.float32(shortest_s) <= np.float32(sample_time_s) <= np.float32(longest_s):
        return ""
    why = (f"with fewer samples the start-up sweep, {model.drive.sweep_speed():.4g} V/s, would jump"
           if sample_time_s > longest_s else "no controller computes more, or rounding would swallow the start-up sweep")
    return (f"sample_time_s is {sample_time_s:g}, and the firmware takes {shortest_s:.4g} to {longest_s:.4g} s, "
            f"{1 / longest_s:.4g} to {1 / shortest_s:.4g} samples per second; {why}")


def check_sample_time(model: Model, sample_time_s: float) -> None:
    """Raise BadInput for a sample time at which the firmware does not take the model."""
    if why := beyond_sample_times(model, sample_time_s):
        raise BadInput(f"{model.where}: {why}; take another rate, or another speed of the start-up sweep "
                       "(rdpi header --sweep-rate)")


def build_notes(model: Model, chain: Chain = Chain()) -> list[str]:
    """What to know before a valid model is compiled in, one line each: macros and sample rates."""
    notes = [f"compile the library and its users with -D{name}={need} (default {DEFAULTS[name]})"
             for name, need in build_options(model, chain=chain).items()]
    if model.rate.window_s:
        notes.append(f"the rate window is {model.rate.window_s:g} s long; if that is more than "
                     f"{DEFAULTS['RDPI_MAX_WINDOW']} samples, compile with -DRDPI_MAX_WINDOW=...")
    if model.shortest_sample_s() > USUAL_SAMPLE_S:
        notes.append(f"the start-up sweep, {model.drive.sweep_speed():.4g} V/s, is too slow for more than "
                     f"{1 / model.shortest_sample_s():.3g} samples per second; rdpi_f32_init refuses a higher rate")
    return notes
