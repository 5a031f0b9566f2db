"""The model file: one identified actuator as JSON (schema rdpi-model/1), read, checked and written.

Displacements are in um, drives in V, rates in um/s. `Model.validate` refuses everything that `rdpi_f32_init` refuses,
so that a model that was read can be flashed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import sys
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from .. import arguments, version
from ..data import atomic_write, content
from ..errors import BadInput

SCHEMA = "rdpi-model/1"
SOURCES = ("displacement", "control")
MIN_SLOPE_RATIO = 0.2  # default of rate.min_slope_ratio
TOLERANCE = 1e-5  # relative; what rounding to the firmware's float may cost (ROUNDING in lib/src/rdpi_f32.c)
LARGEST, LEAST_SLOPE, MIN_SPAN_V = 1e7, 1e-7, 1e-9  # MAX_NUMBER, MIN_SLOPE and MIN_SPAN_V there
TINY, EPSILON = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).eps)
MAX_OFFSET = 1000.0  # in ranges; leaves 0.01 % of the range to rounding
MAX_PLAYS, MAX_DEADZONES = 129, 65  # of the library as firmware_build.py compiles it
MAX_EFFECTS = 100  # each takes part in every simulation
MAX_FILE_BYTES, MAX_DEPTH = 16_000_000, 50
SECTIONS = "rate", "drive", "memory"
NOT_NUMBERS = {*SECTIONS, "source", "extra", "actuator", "fit", "effects", "passport", "where", "dac_bits",
               "sweep_cycles", "singular_um_per_s", "smoothing_s", "identified_um_per_s"}
WHOLE = "dac_bits", "sweep_cycles"
MAX_DAC_BITS = 20  # RDPI_MAX_DAC_BITS
SWEEP_CYCLES, MAX_SWEEP_CYCLES, SWEEP_HZ = 20, 10_000, 20.0  # of the start-up sweep


@dataclass
class Rate:
    """How the rate is estimated and where the guard clamps it; see rdpi_f32_params_t in lib/include/rdpi/f32.h."""

    source: str = "displacement"
    window_s: float = 0.0
    filter_s: float = 0.0
    max_um_per_s: float = math.inf
    singular_um_per_s: float | None = None
    min_slope_ratio: float = MIN_SLOPE_RATIO
    smoothing_s: float = 0.0  # zero-phase smoothing before the rate, host only
    identified_um_per_s: float | None = None  # highest rate in the recordings
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass
class Drive:
    """What may be output."""

    min_V: float = 0.0
    max_V: float = 1.0
    slew_V_per_s: float | None = None
    dac_bits: int | None = None
    sweep_cycles: int = SWEEP_CYCLES  # of the start-up sweep
    sweep_V_per_s: float | None = None  # its speed; None: SWEEP_HZ over the whole range, or what the slew limit allows
    sweep_end_V: float | None = None  # where it ends; None: what holds the memory
    extra: dict[str, Any] = field(default_factory=dict)

    def sweep_speed(self) -> float:
        """Speed of the start-up sweep in V/s."""
        if self.sweep_V_per_s is not None:
            return self.sweep_V_per_s
        usual = min(2 * (self.max_V - self.min_V) * SWEEP_HZ, LARGEST)
        return usual if self.slew_V_per_s is None else min(usual, self.slew_V_per_s)


@dataclass
class Memory:
    """The plays at the first sample."""

    x_um: float = 0.0
    plays_um: np.ndarray = field(default_factory=lambda: np.zeros(0))
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass
class Model:
    """One actuator. Arrays are float64: thresholds, slopes, slope rates (n + 1,), dead zones and weights (m + 1,)."""

    gain_um_per_V: float
    offset_V: float
    offset_um: float
    stroke_um: float
    thresholds_um: np.ndarray
    slopes: np.ndarray
    slope_rate_s_per_um: np.ndarray
    deadzones_um: np.ndarray
    deadzone_weights: np.ndarray
    rate: Rate
    drive: Drive
    memory: Memory
    actuator: str = ""
    fit: dict[str, Any] = field(default_factory=dict)
    effects: list[dict[str, Any]] = field(default_factory=list)
    passport: dict[str, Any] | None = None
    extra: dict[str, Any] = field(default_factory=dict)
    where: str = "model"  # names it in messages: the file that it was read from

    def __post_init__(self) -> None:
        self._take_kinds(self.where)
        if len(self.memory.plays_um) == 0:
            self.memory.plays_um = np.zeros(len(self.thresholds_um))

    def slopes_at(self, rate_um_per_s: float | np.ndarray) -> np.ndarray:
        """W_i(rate), eq. 14; shape (..., n + 1). No guard."""
        return self.slopes + np.multiply.outer(rate_um_per_s, self.slope_rate_s_per_um)

    def x_of(self, command_V: np.ndarray | float) -> np.ndarray | float:
        """Control input in um."""
        return self.gain_um_per_V * (command_V - self.offset_V)

    def start_V(self) -> float:
        """Drive in V that holds the memory: the firmware starts from it."""
        return float(self.memory.plays_um[0] / self.gain_um_per_V + self.offset_V)

    def sweep_end(self) -> float:
        """Drive in V at which the start-up sweep ends."""
        if self.drive.sweep_end_V is not None:
            return self.drive.sweep_end_V
        return float(min(max(self.start_V(), self.drive.min_V), self.drive.max_V))

    def validate(self, where: str | None = None) -> None:
        """Raise BadInput, naming the key and a remedy, unless the firmware would take these parameters."""
        where = where or self.where
        self._take_kinds(where)
        self.validate_lengths(where)
        for key, maximum in (("thresholds_um", MAX_PLAYS), ("deadzones_um", MAX_DEADZONES)):
            length = len(getattr(self, key))
            if length > maximum:
                raise BadInput(f"{where}: {key}: has {length} values, at most {maximum}; fit a smaller model")
        self._validate_finite(where)
        self._validate_values(where)
        self._single_precision()._validate_values(f"{where}, in the firmware's single precision")

    def _take_kinds(self, where: str) -> None:
        """Lists of numbers become arrays. Raises BadInput for what is no number, array, section or text by its key."""
        for key, kind in (("rate", Rate), ("drive", Drive), ("memory", Memory), ("fit", dict), ("effects", list)):
            arguments.of_kind(getattr(self, key), kind, f"{where}: {key}")
        arguments.of_kind(self.actuator, str, f"{where}: actuator")
        for prefix, part in (("", self), *((f"{key}.", getattr(self, key)) for key in SECTIONS)):
            for item in fields(part):
                value, key = getattr(part, item.name), f"{where}: {prefix}{item.name}"
                if item.type == "np.ndarray":
                    setattr(part, item.name, arguments.series(value, key, finite=False))
                elif item.type.startswith(("float", "int")) and not (value is None and item.type.endswith("None")):
                    arguments.number(value, key, finite=item.name in WHOLE)

    def _numbers(self) -> dict[str, Any]:
        """Every number and array of numbers the firmware takes, by key."""
        numbers = {item.name: getattr(self, item.name) for item in fields(self) if item.name not in NOT_NUMBERS}
        for key in SECTIONS:
            section = getattr(self, key)
            numbers.update({f"{key}.{item.name}": getattr(section, item.name) for item in fields(section)
                            if item.name not in NOT_NUMBERS and getattr(section, item.name) is not None})
        return numbers

    def _single_precision(self) -> Model:
        """The model with every number as the firmware rounds it."""
        rounded: dict[str, dict[str, Any]] = {key: {} for key in ("", *SECTIONS)}
        with np.errstate(over="ignore"):
            for key, value in self._numbers().items():
                section, _, name = key.rpartition(".")
                single = np.asarray(value, np.float32).astype(float)
                single = np.where(np.abs(single) < TINY, 0.0, single)  # some FPUs flush what is not normal
                rounded[section][name] = single if single.ndim else float(single)
        return replace(self, **rounded[""], **{key: replace(getattr(self, key), **rounded[key]) for key in SECTIONS})

    def validate_lengths(self, where: str | None = None) -> None:
        """Raise BadInput unless every array is as long as it must be."""
        where = where or self.where
        n, m = len(self.thresholds_um), len(self.deadzones_um)
        for key, values, length, of in (
                ("slopes", self.slopes, n, "threshold"),
                ("slope_rate_s_per_um", self.slope_rate_s_per_um, n, "threshold"),
                ("deadzone_weights", self.deadzone_weights, m, "dead zone"),
                ("memory.plays_um", self.memory.plays_um, n, "threshold")):
            if len(values) != length:
                raise BadInput(f"{where}: {key}: has {len(values)} values, expected {length}, one per {of}")

    def _validate_finite(self, where: str) -> None:
        for key, value in self._numbers().items():
            if not np.all(np.abs(value) <= LARGEST):  # refuses NaN too
                raise BadInput(f"{where}: {key}: must be finite, within ±{LARGEST:g}, as the firmware requires")

    def _validate_values(self, where: str) -> None:
        def refuse(key: str, what: str) -> None:
            raise BadInput(f"{where}: {key}: {what}")

        def ascending(key: str, values: np.ndarray) -> None:
            if values[0] != 0 or np.any(np.diff(values) <= 0):
                refuse(key, f"must start at 0 and increase, got {_short(values)}; sort the values, none twice")

        if not abs(self.gain_um_per_V) >= 1 / LARGEST:
            refuse("gain_um_per_V", f"is {self.gain_um_per_V:g}; x = gain (V - offset_V) needs a gain, "
                                    f"at least ±{1 / LARGEST:g} um/V")
        if not self.stroke_um > 0:
            refuse("stroke_um", f"is {self.stroke_um:g}; must be positive")
        ascending("thresholds_um", self.thresholds_um)
        if not np.all(self.slopes >= LEAST_SLOPE):
            i = int(np.argmin(self.slopes))
            refuse(f"slopes[{i}]", f"is {self.slopes[i]:g}; every slope must be positive, at least {LEAST_SLOPE:g}, or "
                                   "the model has no inverse")
        for key, values in (("slopes", self.slopes), ("slope_rate_s_per_um", self.slope_rate_s_per_um)):
            largest = np.max(np.abs(intercepts(self.thresholds_um, values)))
            if largest > LARGEST:
                refuse(key, f"with these thresholds_um its intercepts reach {largest:.3g}, beyond ±{LARGEST:g}, "
                            "the firmware's limit; check the units of both")
        ascending("deadzones_um", self.deadzones_um)
        pieces = np.cumsum(self.deadzone_weights)
        if not np.all(pieces > 0):
            j = int(np.argmin(pieces))
            refuse("deadzone_weights", f"the weights up to [{j}] sum to {pieces[j]:g}; every partial sum must be "
                                       "positive, or the saturation stage has no inverse")
        with np.errstate(over="ignore"):
            inverse = np.abs(inverse_saturation(self.deadzones_um, self.deadzone_weights))
        if not np.all(inverse <= LARGEST):
            refuse("deadzone_weights", f"partial sums of {pieces.min():.3g} to {pieces.max():.3g} make an inverse "
                                       f"beyond ±{LARGEST:g}, the firmware's limit; fit with fewer dead zones")
        self._validate_rate(refuse)
        self._validate_drive(refuse)
        for key, offset, scale, unit in (("offset_um", self.offset_um, self.stroke_um, "um"),
                                         ("offset_V", self.offset_V, self.drive.max_V - self.drive.min_V, "V")):
            if abs(offset) > MAX_OFFSET * scale:
                refuse(key, f"is {offset:g} {unit}, over {MAX_OFFSET:g} times the range of {scale:g} {unit}: "
                            "single precision cannot hold both; subtract the offset first")

    def _validate_rate(self, refuse: Any) -> None:
        rate = self.rate
        if not isinstance(rate.source, str) or rate.source not in SOURCES:
            refuse("rate.source", f'is "{rate.source}"; must be one of {", ".join(SOURCES)}')
        for key in ("window_s", "filter_s", "smoothing_s"):
            if getattr(rate, key) < 0:
                refuse(f"rate.{key}", f"is {getattr(rate, key):g} s; must not be negative")
        if rate.identified_um_per_s is not None and not rate.identified_um_per_s >= 1 / LARGEST:
            refuse("rate.identified_um_per_s", f"is {rate.identified_um_per_s:g}; must be positive, or null")
        if not rate.max_um_per_s > 0:
            refuse("rate.max_um_per_s", f"is {rate.max_um_per_s:g}; must be positive")
        if not 0 < rate.min_slope_ratio < 1:
            refuse("rate.min_slope_ratio", f"is {rate.min_slope_ratio:g}; must lie between 0 and 1")
        floor = np.maximum(rate.min_slope_ratio * (1 - TOLERANCE) * self.slopes, LEAST_SLOPE)
        fastest = self.slopes_at(rate.max_um_per_s)
        if np.any(fastest < floor):
            with np.errstate(over="ignore"):
                i = int(np.argmin(fastest / self.slopes))
            limit = (1 - rate.min_slope_ratio) * guard_rates(self.slopes, self.slope_rate_s_per_um)[i]
            refuse("rate.max_um_per_s",
                   f"at {rate.max_um_per_s:g} um/s slope {i} has fallen to {fastest[i]:.3g}, below "
                   f"{rate.min_slope_ratio:g} of its {self.slopes[i]:.3g} at rest; use {limit:.4g} or less")

    def _validate_drive(self, refuse: Any) -> None:
        drive, memory = self.drive, self.memory
        if not drive.max_V - drive.min_V >= MIN_SPAN_V:
            refuse("drive", f"min_V {drive.min_V:g} must be below max_V {drive.max_V:g}, by {MIN_SPAN_V:g} V at least")
        if drive.slew_V_per_s is not None and not drive.slew_V_per_s > 0:
            refuse("drive.slew_V_per_s", f"is {drive.slew_V_per_s:g}; must be positive, or null for no limit")
        if drive.dac_bits is not None and not 1 <= drive.dac_bits <= MAX_DAC_BITS:
            refuse("drive.dac_bits", f"is {drive.dac_bits}; must be 1 to {MAX_DAC_BITS}, or null")
        self._validate_sweep(refuse)
        if not math.isclose(memory.plays_um[0], memory.x_um, rel_tol=TOLERANCE, abs_tol=TOLERANCE * self.stroke_um):
            refuse("memory.plays_um[0]",
                   f"is {memory.plays_um[0]:g}, but must be x_um = {memory.x_um:g} (its threshold is 0)")
        slack = TOLERANCE * (self.thresholds_um[-1] + np.abs(memory.plays_um[1:]))
        if np.any(np.abs(np.diff(memory.plays_um)) > np.diff(self.thresholds_um) + slack):
            refuse("memory.plays_um",
                   "no history leaves these states: neighbours may differ at most by the difference of their "
                   "thresholds")
        with np.errstate(over="ignore"):
            start_V = self.start_V()
        slack = TOLERANCE * (drive.max_V - drive.min_V)
        if not drive.min_V - slack <= start_V <= drive.max_V + slack:
            refuse("memory.x_um", f"is held by {start_V:g} V, outside drive {drive.min_V:g} to {drive.max_V:g} V")

    def _validate_sweep(self, refuse: Any) -> None:
        drive, end_V, speed = self.drive, self.sweep_end(), self.drive.sweep_speed()
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
        if self.shortest_sample_s() > 1:
            refuse(given, f"a start-up sweep of {speed:g} V/s is too slow: in single precision the drive would not "
                          "move from one sample to the next; allow a faster one or a wider range")

    def shortest_sample_s(self) -> float:
        """Sample time in s below which the firmware refuses: its drive could not move as slowly as the sweep."""
        return 8 * EPSILON * float(abs(self.drive.min_V) + abs(self.drive.max_V)) / float(self.drive.sweep_speed())

    def to_json(self) -> dict[str, Any]:
        """The document as written, unknown keys included."""
        arrays = ("thresholds_um", "slopes", "slope_rate_s_per_um", "deadzones_um", "deadzone_weights")
        document: dict[str, Any] = {"schema": SCHEMA, "tool": f"rdpi {version()}", "actuator": self.actuator}
        for key in ("gain_um_per_V", "offset_V", "offset_um", "stroke_um"):
            document[key] = float(getattr(self, key))
        for key in arrays:
            document[key] = [float(value) for value in getattr(self, key)]
        for key in SECTIONS:
            document[key] = _section_to_json(getattr(self, key))
        document.update(fit=self.fit, effects=self.effects, passport=self.passport)
        return {**self.extra, **document}

    def digest(self) -> str:
        """SHA-256 of what the firmware takes from the model: same behaviour, same digest."""
        bare = replace(self, extra={}, **{key: replace(getattr(self, key), extra={}) for key in SECTIONS})
        bare.rate = replace(bare.rate, smoothing_s=0.0, identified_um_per_s=None, singular_um_per_s=None)
        bare.drive = replace(bare.drive, sweep_V_per_s=self.drive.sweep_speed(), sweep_end_V=self.sweep_end())
        document = bare.to_json()
        for key in ("tool", "actuator", "fit", "effects", "passport"):
            del document[key]
        return "sha256:" + hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def guard_rates(slopes: np.ndarray, slope_rate_s_per_um: np.ndarray) -> np.ndarray:
    """Rate in um/s at which each slope reaches zero, inf where it does not fall; shape (n + 1,)."""
    falling = slope_rate_s_per_um < 0
    return np.where(falling, slopes / np.where(falling, -slope_rate_s_per_um, 1), np.inf)


def guarded(model: Model, share: float, highest_um_per_s: float) -> Model:
    """The model with its guard at this share of the rate at which its first slope reaches zero, at most at a rate."""
    singular = float(np.min(guard_rates(model.slopes, model.slope_rate_s_per_um)))
    return replace(model, rate=replace(model.rate, max_um_per_s=min(share * singular, highest_um_per_s),
                                       singular_um_per_s=singular if np.isfinite(singular) else None))


def intercepts(thresholds_um: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """P_i of the loading curve W_i x - P_i: P_0 = 0, P_i = P_(i-1) + (W_i - W_(i-1)) r_i; or its change with c_i."""
    return np.cumsum(np.diff(slopes, prepend=slopes[0]) * thresholds_um)


def inverse_saturation(deadzones_um: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 13: thresholds d'_j = S(d_j), and weights w'_j whose partial sums are one over those of the weights."""
    slopes = np.cumsum(weights)
    corners = np.concatenate([[0.0], np.cumsum(slopes[:-1] * np.diff(deadzones_um))])
    return corners, np.diff(np.divide(1, slopes, out=np.zeros(len(slopes)), where=slopes != 0), prepend=0.0)


def read_model(path: str | os.PathLike[str]) -> Model:
    """Read and validate a model file. Raises BadInput naming file, key and remedy."""
    path = str(path)
    try:
        data = content(path)
        if len(data) > MAX_FILE_BYTES:
            raise BadInput(f"{path}: has {len(data)} bytes; a model has at most {MAX_FILE_BYTES}: check that this is a "
                           "model file")
        text = data.decode("utf-8-sig")
        if not text.lstrip().startswith("{"):
            raise BadInput(f"{path}: line 1: this is not a JSON object; `rdpi fit` writes model files")
        document = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_once_each)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; check the path") from None
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: not a complete JSON document ({error}); "
                       "the file may be incomplete or edited: fit again or restore it") from None
    if _deeper(document, MAX_DEPTH):
        raise BadInput(f"{path}: objects and lists are nested more than {MAX_DEPTH} deep; fit again or restore it")
    model = _Reader(path).model(document)
    model.validate(path)
    return model


def write_model(path: str | os.PathLike[str], model: Model) -> None:
    """Validate and write atomically."""
    model.validate(str(path))
    atomic_write(path, json.dumps(model.to_json(), indent=1, allow_nan=False) + "\n")


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a JSON number")


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) < len(pairs):
        keys = sorted(key for key, _ in pairs)
        twice = next(one for one, other in zip(keys, keys[1:]) if one == other)
        raise ValueError(f"the key {twice[:40]!r} exists twice in one object")
    return document


def _deeper(value: Any, most: int) -> bool:
    """Whether objects and lists are nested more than `most` deep: to write them takes more recursion than to read."""
    level = [value]
    for _ in range(most + 1):
        level = [item for one in level if isinstance(one, (dict, list))
                 for item in (one.values() if isinstance(one, dict) else one)]
    return bool(level)


def _section_to_json(section: Rate | Drive | Memory) -> dict[str, Any]:
    document = dict(section.extra)
    for item in fields(section):
        value = getattr(section, item.name)
        if item.name == "extra":
            continue
        if isinstance(value, np.ndarray):
            value = [float(v) for v in value]
        elif value is not None and item.name not in ("source", *WHOLE):
            value = float(value)
        document[item.name] = value
    return document


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _short(values: np.ndarray) -> str:
    text = ", ".join(f"{value:g}" for value in values[:6])
    return f"[{text}{', …' if len(values) > 6 else ''}]"


class _Reader:
    """Takes typed values out of the document, or says which key is wrong."""

    def __init__(self, path: str) -> None:
        self.path = path

    def refuse(self, key: str, what: str) -> None:
        raise BadInput(f"{self.path}: {key}: {what}")

    def number(self, document: dict[str, Any], key: str, where: str = "", **default: Any) -> Any:
        value = document.pop(key, default.get("default", ...))
        if value is ...:
            self.refuse(where + key, "missing; fit again, or add it as `rdpi fit` writes it")
        if value is None and "default" in default and default["default"] is None:
            return None
        if not _is_number(value):
            self.refuse(where + key, f"must be a finite number, got {json.dumps(value)[:40]}")
        return float(value)

    def whole(self, document: dict[str, Any], key: str, where: str, default: int | None) -> int | None:
        value = self.number(document, key, where, default=default)
        if value is not None and value != int(value):
            self.refuse(where + key, f"must be a whole number, got {value:g}")
        return None if value is None else int(value)

    def numbers(self, document: dict[str, Any], key: str, where: str = "", **default: Any) -> np.ndarray:
        value = document.pop(key, default.get("default", ...))
        if value is ...:
            self.refuse(where + key, "missing; fit again, or add it as `rdpi fit` writes it")
        if not isinstance(value, list) or not all(map(_is_number, value)):
            self.refuse(where + key, "must be a list of finite numbers")
        if not value and "default" not in default:
            self.refuse(where + key, "is empty; fit again, or fill in the values")
        return np.array(value, dtype=float)

    def section(self, document: dict[str, Any], key: str, kind: type, default: Any = None) -> Any:
        value = document.pop(key, default)
        if not isinstance(value, kind):
            self.refuse(key, f"must be {'an object' if kind is dict else 'a list'}, as `rdpi fit` writes it")
        return value

    def effects(self, document: dict[str, Any]) -> list[Any]:
        effects = self.section(document, "effects", list, [])
        if len(effects) > MAX_EFFECTS:
            self.refuse("effects", f"has {len(effects)} entries, at most {MAX_EFFECTS}; remove some")
        return effects

    def model(self, document: dict[str, Any]) -> Model:
        document = dict(document)
        schema = document.pop("schema", None)
        if schema != SCHEMA:
            self.refuse("schema", f'is {json.dumps(schema)}, expected "{SCHEMA}"; this is no model file, '
                                  "or one of another version: fit again with this version of rdpi")
        document.pop("tool", None)
        rate = dict(self.section(document, "rate", dict))
        drive = dict(self.section(document, "drive", dict))
        memory = dict(self.section(document, "memory", dict, {}))
        source = rate.pop("source", "displacement")
        bits = self.whole(drive, "dac_bits", "drive.", default=None)
        cycles = self.whole(drive, "sweep_cycles", "drive.", default=SWEEP_CYCLES)
        x_um = self.number(memory, "x_um", "memory.", default=0.0)
        plays_um = self.numbers(memory, "plays_um", "memory.", default=[])
        thresholds_um = self.numbers(document, "thresholds_um")
        passport = document.pop("passport", None)
        return Model(
            **{key: self.number(document, key) for key in ("gain_um_per_V", "offset_V", "offset_um", "stroke_um")},
            thresholds_um=thresholds_um,
            **{key: self.numbers(document, key)
               for key in ("slopes", "slope_rate_s_per_um", "deadzones_um", "deadzone_weights")},
            rate=Rate(source, self.number(rate, "window_s", "rate.", default=0.0),
                      self.number(rate, "filter_s", "rate.", default=0.0), self.number(rate, "max_um_per_s", "rate."),
                      self.number(rate, "singular_um_per_s", "rate.", default=None),
                      self.number(rate, "min_slope_ratio", "rate.", default=MIN_SLOPE_RATIO),
                      self.number(rate, "smoothing_s", "rate.", default=0.0),
                      self.number(rate, "identified_um_per_s", "rate.", default=None), extra=rate),
            drive=Drive(self.number(drive, "min_V", "drive."), self.number(drive, "max_V", "drive."),
                        self.number(drive, "slew_V_per_s", "drive.", default=None),
                        bits, cycles, self.number(drive, "sweep_V_per_s", "drive.", default=None),
                        self.number(drive, "sweep_end_V", "drive.", default=None), extra=drive),
            memory=Memory(x_um, plays_um if len(plays_um) else np.clip(0.0, x_um - thresholds_um, x_um + thresholds_um),
                          extra=memory),
            actuator=str(document.pop("actuator", "")),
            fit=self.section(document, "fit", dict, {}),
            effects=self.effects(document),
            passport=passport,
            extra=document,
            where=self.path,
        )
