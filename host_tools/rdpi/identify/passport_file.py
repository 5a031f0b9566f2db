"""The residual passport as a model file holds it: what it must have, and how it is checked before it is used."""

from __future__ import annotations

from typing import Any, NoReturn, get_args

import numpy as np

from ..errors import BadInput
from ..model import Model, Passport, records

OTHER_RUNS, LEFT_OUT, FITTED = SOURCES = get_args(records.HeldOut)  # of residuals, best first
AXES = "rate_um_per_s", "position_um", "amplitude_um", "since_reversal_s", "direction"
SHAPE_AXES = AXES[:2]  # those that, multiplied, foretold best where a residual lies
TERMS = "constant", "std", "std²", "rate²"  # whose sum is the expected mean square
LEVEL_LISTS = "std_um", "span_um", "loop_um", "rate_um_per_s", "rms_um", "weight"  # a value for each part of a run
LARGEST, MAX_OCTAVE = 1e15, 100  # of what is read
REMEDY = "fit the model again with `rdpi fit`, or set passport to null"


def read(model: Model) -> Passport | None:
    """The model's passport, checked; None if it has none. Raises BadInput that names the key and a remedy."""
    if model.passport is None:
        return None
    known = _Checked(model.passport, f"{model.where}: passport")
    schema = known.item("schema")
    if schema != Passport.SCHEMA:
        known.refuse("schema", f"is {schema!r}, but this version reads {Passport.SCHEMA}")
    for name in ("noise_um", "rms_um", "expected_um", "kurtosis", "spread"):
        known.number(name)
    if known.item("held_out") not in SOURCES:
        known.refuse("held_out", f"must be one of {', '.join(SOURCES)}")
    if not isinstance(known.item("runs"), list):
        known.refuse("runs", "must be a list")
    for k, run in enumerate(known.item("runs")):
        of_run = _Checked(run, f"{model.where}: passport.runs[{k}]")
        of_run.number("step_um")
        for name, low, high in ("offset_um", -LARGEST, LARGEST), ("sample_rate_hz", 0.0, LARGEST), ("stuck", 0.0, 1.0):
            if of_run.get(name) is not None:
                of_run.number(name, low, high)
    for name in AXES:
        axis = known.section("axes").section(name)
        edges = axis.numbers("edges", low=-np.inf)
        if len(edges) < 2 or np.any(np.diff(edges) < 0):
            axis.refuse("edges", "must be at least two numbers that do not decrease")
        for part in ("rms_um", "occupancy"):
            axis.numbers(part, len(edges) - 1)
        if name in SHAPE_AXES and not np.all(axis.numbers("factor", len(edges) - 1) > 0):
            axis.refuse("factor", "must be positive")
    for name in ("absolute", "relative"):
        part = known.section("octaves").section(name)
        part.octave("first")
        if not np.any(part.numbers("share")):
            part.refuse("share", "is 0 everywhere")
    if known.section("octaves").get("moved") is not None:
        part = known.section("octaves").section("moved")
        part.octave("first")
        peaks = part.numbers("peak_um")
        if part.get("missed") is not None:
            part.numbers("missed", len(peaks))
    if known.get("drifts") not in (None, True, False):
        known.refuse("drifts", "must be true or false")
    level = known.section("level")
    level.numbers("coefficients", len(TERMS))
    windows = len(level.numbers("rms_um"))
    for name in LEVEL_LISTS:
        level.numbers(name, windows)
    for name in ("least_std_um", "drift_um"):
        if level.get(name) is not None:
            level.number(name, high=2 * float(np.max(level.numbers("span_um"))))
    for name in ("rms_um", "weight"):
        if not np.all(level.numbers(name) > 1 / LARGEST):
            level.refuse(name, "must be positive")
    return Passport.from_json(model.passport, f"{model.where}: passport")


class _Checked:
    """An object of a passport that was read; what is missing or malformed raises BadInput with its key."""

    def __init__(self, value: Any, place: str) -> None:
        self._value, self._place = value, place
        if not isinstance(value, dict):
            raise BadInput(f"{place}: must be an object; {REMEDY}")

    def refuse(self, name: str, what: str) -> NoReturn:
        raise BadInput(f"{self._place}.{name}: {what}; {REMEDY}")

    def item(self, name: str) -> Any:
        if name not in self._value:
            self.refuse(name, "is missing")
        return self._value[name]

    def get(self, name: str) -> Any:
        return self._value.get(name)

    def octave(self, name: str) -> None:
        value = self.item(name)
        if type(value) is not int or abs(value) > MAX_OCTAVE:
            self.refuse(name, f"must be a whole number, -{MAX_OCTAVE} to {MAX_OCTAVE}")

    def section(self, name: str) -> _Checked:
        return _Checked(self.item(name), f"{self._place}.{name}")

    def number(self, name: str, low: float = 0.0, high: float = LARGEST) -> None:
        value = self.item(name)
        if type(value) not in (int, float) or not low <= value <= high:
            self.refuse(name, f"must be a number from {low:g} to {high:g}")

    def numbers(self, name: str, length: int | None = None, low: float = 0.0) -> np.ndarray:
        values = self.item(name)
        if not isinstance(values, list) or not values or any(type(value) not in (int, float) for value in values):
            self.refuse(name, "must be a list of numbers")
        if length is not None and len(values) != length:
            self.refuse(name, f"has {len(values)} values, expected {length}")
        if not all(max(low, -LARGEST) <= value <= LARGEST for value in values):  # refuses NaN too
            self.refuse(name, f"must lie within {max(low, -LARGEST):g} to {LARGEST:g}")
        return np.array(values, float)
