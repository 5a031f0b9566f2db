"""What a model asks of the build that flashes it."""

from __future__ import annotations

import math

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
