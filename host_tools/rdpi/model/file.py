"""The model file: one JSON object, read, checked and written."""

from __future__ import annotations

import json
import os
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..data import atomic_write, content, is_device
from ..errors import BadInput
from .limits import MIN_SLOPE_RATIO, SWEEP_CYCLES
from .model import Drive, Memory, Model, Rate

MAX_EFFECTS = 100  # each takes part in every simulation
MAX_FILE_BYTES, MAX_DEPTH = 16_000_000, 50


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
    model.uncompensated()
    return model


def write_model(path: str | os.PathLike[str], model: Model) -> None:
    """Validate and write atomically. What is kept beside the old file is found from the new one.

    Raises BadInput for a path that is one of the kept recordings.
    """
    model.validate(str(path))
    replace(model, where=str(path)).uncompensated()
    moved = replace(model, kept=_seen_from(Path(path).parent, model))
    if os.path.realpath(path) in _kept(model):
        raise BadInput(f"{path}: is a recording that is kept with the model; give the model another path")
    try:
        text = json.dumps(moved.to_json(), indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:  # a part that the caller filled in
        raise BadInput(f"{path}: not written: {error}; a model holds numbers, texts, lists and objects") from None
    atomic_write(path, text + "\n")


def kept_with(path: str | os.PathLike[str]) -> list[str]:
    """Copies of recordings that a model file names, which no output may replace; none of what is no model file."""
    if is_device(path):  # a pipe gives its model once
        return []
    try:
        return _kept(read_model(path))
    except BadInput:
        return []


def _kept(model: Model) -> list[str]:
    """Real paths of the files that the key `kept` names."""
    found = []
    for one in model.kept if isinstance(model.kept, list) else ():
        with suppress(AttributeError, TypeError, ValueError):  # no entry, no name, or one that no file can have
            found.append(os.path.realpath(beside(model, one.get("file"))))
    return found


def _seen_from(folder: Path, model: Model) -> Any:
    """The key `kept` with paths from this folder; what is no list of paths stays."""
    if not isinstance(model.kept, list):
        return model.kept
    return [{**one, "file": Path(os.path.relpath(beside(model, one["file"]), folder)).as_posix()}
            if isinstance(one, dict) and isinstance(one.get("file"), str) else one for one in model.kept]


def beside(model: Model, file: str) -> Path:
    """Where a file is that the model names by its path from the folder of the model file."""
    return Path(model.where).parent / file


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


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


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
        if schema != Model.SCHEMA:
            self.refuse("schema", f'is {json.dumps(schema)}, expected "{Model.SCHEMA}"; this is no model file, '
                                  "or one of another version: fit again with this version of rdpi")
        tool = document.pop("tool", "")
        rate = dict(self.section(document, "rate", dict))
        drive = dict(self.section(document, "drive", dict))
        memory = dict(self.section(document, "memory", dict, {}))
        source = rate.pop("source", "displacement")
        bits = self.whole(drive, "dac_bits", "drive.", default=None)
        cycles = self.whole(drive, "sweep_cycles", "drive.", default=SWEEP_CYCLES)
        x_um = self.number(memory, "x_um", "memory.", default=0.0)
        plays_um = self.numbers(memory, "plays_um", "memory.", default=[])
        sweep_share = self.number(memory, "sweep_share", "memory.", default=None)
        thresholds_um = self.numbers(document, "thresholds_um")
        passport, alone = document.pop("passport", None), document.pop("operator_alone", None)
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
            memory=Memory(x_um, plays_um, sweep_share, extra=memory),
            tool=tool if isinstance(tool, str) else "",
            actuator=str(document.pop("actuator", "")),
            fit=self.section(document, "fit", dict, {}),
            effects=self.effects(document),
            passport=passport,
            operator_alone=alone,
            kept=document.pop("kept", None),
            extra=document,
            where=self.path,
        )
