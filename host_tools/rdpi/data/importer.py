"""Tables, MATLAB files and NumPy arrays to recordings.

A source is a list of columns, some with names; the user (`Request`) or an obvious name says which is what and in which
unit. The recording keeps where it came from: `source`, `source_digest`, `source_columns` and `rows`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import BadInput
from . import tables
from .recording import UNFINISHED, Recording, check_metadata, check_rate, check_samples, is_column_name, sample_times
from .resample import resample
from .sources import Source, open_source
from .units import UNITS, known_unit, split_unit, units_of

# Letters and digits, lower case, of names of single numbers that give the sample rate, or the sample time in s
_RATE_NAMES = frozenset("sampleratehz samplerate ratehz fs samplingrate samplingfrequency".split())
_SAMPLE_TIME_NAMES = frozenset("sampletimes sampletime ts dt tinterval sampleinterval samplinginterval deltax deltat "
                               "increment xincrement xinc tinc".split())


@dataclass(frozen=True)
class Role:
    """A column of the recording, its unit, and the names (lower case, letters and digits only) that give it away."""

    column: str
    unit: str
    names: frozenset[str]


def _role(column: str, unit: str, names: str) -> Role:
    return Role(column, unit, frozenset(names.split()))


ROLES = {
    "time": _role("time_s", "s", "time t times timestamp timestamps seconds sec zeit"),
    "command": _role("command_V", "V", "command cmd voltage volt volts drive drivevoltage commandvoltage "
                     "controlvoltage inputvoltage appliedvoltage piezovoltage piezodrive input u v vin vi vcmd vdrive uin"),
    "displacement": _role("displacement_um", "um", "displacement disp position pos measured measureddisplacement "
                          "measuredposition piezoposition stageposition sensor extension elongation output z y d do"),
    "reference": _role("reference_um", "um", "reference ref desired desireddisplacement desiredposition setpoint "
                       "target demand zref xref di"),
    "monitor": _role("monitor_V", "V", "monitor monitorvoltage voltagemonitor vmon amplifieroutput measuredvoltage"),
    "temperature": _role("temperature_degC", "degC", "temperature temp"),
}
PURPOSES = {"run": ("command", "displacement"), "drive": ("command",), "reference": ("reference",)}


@dataclass(frozen=True)
class Request:
    """What the user says about the sources.

    `columns` maps keys of ROLES to "COLUMN" or "COLUMN:SCALE" (a name or a number from 0; a unit of UNITS or a factor
    to the base unit), `also` maps names of covariates to the same. `rows` selects data rows before anything is checked.
    `command_gain` multiplies the command (a fixed-gain amplifier behind the recorded voltage). `purpose` is a key of
    PURPOSES and says which columns a file must give. `resample_hz` puts the recording on a uniform grid of this rate.
    """

    columns: dict[str, str] = field(default_factory=dict)
    also: dict[str, str] = field(default_factory=dict)
    rate_hz: float | None = None
    rows: slice = field(default_factory=lambda: slice(None))  # unhashable, so no plain default
    command_gain: float = 1.0
    purpose: str = "run"
    resample_hz: float | None = None
    metadata: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Choice:
    """One column of the source taken as one column of the recording: value = raw · factor · 10^exponent."""

    column: str
    number: int
    unit: str
    exponent: int = 0
    factor: float = 1.0
    why: str = ""

    def scale(self, raw: np.ndarray) -> np.ndarray:
        # Dividing by a power of ten rounds correctly: 1234.5 nm becomes 1.2345 µm, not 1.2345000000000002.
        power = 10.0 ** abs(self.exponent)
        return (raw * power if self.exponent >= 0 else raw / power) * self.factor


def import_recording(path: str, request: Request) -> tuple[Recording, list[str]]:
    """Read any supported file as a recording; also the lines that tell the user what was taken for what.

    Raises BadInput for files that cannot be read, columns that cannot be found, and what makes a recording unusable.
    """
    if not np.isfinite(request.command_gain) or request.command_gain == 0:
        raise BadInput(f"--command-gain {request.command_gain:g}: give a finite factor other than 0")
    source = open_source(path)
    chosen = _choose(source, request)
    cut = source.read([choice.number for choice in chosen], request.rows)
    columns = {choice.column: _scaled(source, request, choice, raw) for choice, raw in zip(chosen, cut.columns)}
    rows = f"{cut.start}:{cut.start + len(cut.columns[0])}"

    metadata = _metadata(source, request, chosen, cut.start, rows)
    rate, rate_from = _rate(source, request, has_time="time_s" in columns)
    if rate is not None:
        metadata["sample_rate_hz"] = f"{rate:.12g}"

    def key_place(key: str) -> str:
        return rate_from if key == "sample_rate_hz" else path

    check_metadata(metadata, key_place)
    if "time_s" not in columns:
        if rate is None:
            raise BadInput(f"{path}: no column looks like time; name it with --time COLUMN, or give --rate HZ; "
                           f"{source.listing()}")
        columns = {"time_s": sample_times(len(cut.columns[0]), rate), **columns}
    where = f"{path}, rows {rows} of {cut.total}"
    resampled = None
    if request.resample_hz is not None:
        resampled = resample(where, columns, request.resample_hz, cut.place)
        check_rate(columns["time_s"], metadata, key_place)
        columns = resampled.columns
        metadata |= {"sample_rate_hz": f"{request.resample_hz:.12g}", "resampled": resampled.describe()}
    check_samples(where, columns, cut.place, cut.start)
    check_rate(columns["time_s"], metadata, key_place)
    recording = Recording(path, metadata, columns)
    lines = _describe(source, request, recording, chosen, cut.total, rate_from)
    if resampled is not None:
        lines.append(f"  resampled {resampled.describe()}")
    return recording, lines


# --- which column is what ------------------------------------------------------------------------------------------

def _choose(source: Source, request: Request) -> list[Choice]:
    """Columns in the order of the recording: the roles as asked for or recognised, then the covariates."""
    chosen = []
    needed = PURPOSES[request.purpose]
    for key, role in ROLES.items():
        if key in request.columns:
            chosen.append(_asked(source, f"--{key}", role.column, role.unit, request.columns[key]))
        elif not (key == "time" and request.rate_hz is not None):
            taken = {choice.number for choice in chosen}
            found = _recognised(source, key, role, taken)
            if found is not None:
                chosen.append(found)
            elif key in needed:
                raise BadInput(f"{source.path}: no column looks like the {key}; name it with --{key} COLUMN; "
                               f"{source.listing()}")
    for name, spec in request.also.items():
        if not is_column_name(name):
            raise BadInput(f"--also {name!r}: is not valid as a name of a column; use UTF-8 without commas, quotation "
                           "marks, line ends or a leading #")
        chosen.append(_asked(source, f"--also {name}", name, None, spec))
    return chosen


def _asked(source: Source, option: str, column: str, unit: str | None, spec: str) -> Choice:
    """The column that an option names; `unit` is that of the recording's column, None for a covariate."""
    number, scale = _find(source, spec), None
    if number is None and ":" in spec:
        name, _, scale = spec.rpartition(":")
        number = _find(source, name)
    if number is None:
        raise BadInput(f"{source.path}: {option} {spec}: no such column; {source.listing()}")
    if scale is None:
        _, named = split_unit(source.names[number])
        if unit is None or named is None:
            return Choice(column, number, unit or "", why="not converted" if unit is None else "assumed")
        dimension, exponent = UNITS.get(named, (None, 0))
        if dimension != unit:
            raise BadInput(f"{source.path}: {option} {spec}: the unit in the name {source.names[number]!r} is {named}, "
                           f"not {unit}; give the factor to {unit}, e.g. {option} {spec}:0.5")
        return Choice(column, number, named, exponent, why="by its name")
    known = known_unit(scale)
    if known is not None:
        dimension, exponent = UNITS[known]
        if unit is not None and dimension != unit:
            raise BadInput(f"{source.path}: {option} {spec}: {known} cannot be converted to {unit}; "
                           f"give one of {units_of(unit)}, or the factor to {unit}")
        return Choice(column, number, known, exponent)
    try:
        factor = float(scale)
    except ValueError:
        factor = np.nan
    if not np.isfinite(factor) or factor == 0:
        raise BadInput(f"{source.path}: {option} {spec}: {scale!r} is neither a unit nor a factor; give one of "
                       f"{units_of(unit)}, or a number that multiplies the column")
    return Choice(column, number, f"x {factor:g}", factor=factor)


def _scaled(source: Source, request: Request, choice: Choice, raw: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        values = choice.scale(raw) * (request.command_gain if choice.column == "command_V" else 1.0)
    if not np.isfinite(values).all():
        raise BadInput(f"{source.path}: {choice.column} becomes infinite when {_name(source, choice.number)} is "
                       "scaled; give a smaller factor or gain, or exclude such rows with --rows")
    return values


def _find(source: Source, wanted: str) -> int | None:
    """A column by its name (exactly, else ignoring case, else without its unit) or by its number from 0."""
    for match in (lambda name: name, str.lower, lambda name: split_unit(name)[0].lower()):
        hits = [index for index, name in enumerate(source.names) if name and match(name) == match(wanted)]
        if len(hits) > 1:
            raise BadInput(f"{source.path}: several columns are called {wanted!r}; choose one by its number; "
                           f"{source.listing()}")
        if hits:
            return hits[0]
    if wanted.isascii() and wanted.isdigit() and int(wanted) < len(source.names):
        return int(wanted)
    return None


def _recognised(source: Source, key: str, role: Role, taken: set[int]) -> Choice | None:
    hits = []
    for number, name in enumerate(source.names):
        base, named = split_unit(name)
        dimension, exponent = UNITS.get(named or role.unit, (None, 0))
        if number in taken or dimension != role.unit or tables.plain(base) not in role.names:
            continue
        why = "recognised" if named else "recognised, unit assumed"
        choice = Choice(role.column, number, named or role.unit, exponent, why=why)
        if name == role.column:
            return choice
        hits.append(choice)
    if len(hits) > 1:
        names = ", ".join(_name(source, choice.number) for choice in hits)
        raise BadInput(f"{source.path}: {names} all look like the {key}; name one with --{key} COLUMN")
    return hits[0] if hits else _only_time(source, taken) if key == "time" else None


def _only_time(source: Source, taken: set[int]) -> Choice | None:
    """The one column that is in a unit of time, whatever it is called: X, x-axis."""
    hits = []
    for number, name in enumerate(source.names):
        named = split_unit(name)[1]
        dimension, exponent = UNITS.get(named or "", (None, 0))
        if number not in taken and dimension == "s":
            hits.append(Choice(ROLES["time"].column, number, named or "", exponent, why="by its unit"))
    return hits[0] if len(hits) == 1 else None


def _name(source: Source, number: int) -> str:
    return f"column {number}" + (f" {source.names[number]!r}" if source.names[number] else "")


def _rate(source: Source, request: Request, has_time: bool) -> tuple[float | None, str]:
    """Sample rate and where it is stated: the option, else the file."""
    if request.rate_hz is not None:
        return request.rate_hz, "--rate"
    if "sample_rate_hz" in source.metadata:
        check_metadata(source.metadata, lambda key: source.path)
        return float(source.metadata["sample_rate_hz"]), f"{source.path}: its header"
    if not has_time:
        for name, value in source.scalars.items():
            base = tables.plain(name.rpartition(".")[2])
            if value > 0 and base in _RATE_NAMES:
                return value, f"{source.path}: {name}"
            if value > 0 and base in _SAMPLE_TIME_NAMES:
                return 1 / value, f"{source.path}: {name}"
    return None, ""


def _metadata(source: Source, request: Request, chosen: Sequence[Choice], start: int, rows: str) -> dict[str, str]:
    metadata = dict(source.metadata)
    metadata.pop(UNFINISHED, None)
    if start > 0:
        metadata.pop("memory", None)  # it was about a sample that is now left out
    for key, text in request.metadata.items():
        if re.search("[\ud800-\udfff]", text):
            raise BadInput(f"--{key} {text!r}: is not UTF-8; set a UTF-8 locale, or use letters without accents")
    metadata |= request.metadata
    metadata["source"] = Path(source.path).name.encode(errors="replace").decode()
    metadata["source_digest"] = source.digest
    metadata["source_columns"] = " ".join(f"{c.column}={c.number}" + (f":{c.unit.removeprefix('x ')}" if c.unit else "")
                                          for c in chosen)
    metadata["rows"] = rows
    if request.command_gain != 1:
        metadata["command_gain"] = f"{request.command_gain:g}"
    return metadata


def _describe(source: Source, request: Request, recording: Recording, chosen: Sequence[Choice], total: int,
              rate_from: str) -> list[str]:
    lines = [f"{source.path}: {source.kind}, {total} rows, {len(source.names)} columns"]
    width = max(len(name) for name in recording.columns)
    if not any(choice.column == "time_s" for choice in chosen):
        lines.append(f"  {'time_s':{width}}  from {recording.sample_rate_hz:g} samples per second ({rate_from})")
    for choice in chosen:
        gain = request.command_gain if choice.column == "command_V" else 1
        told = choice.unit + (f", {choice.why}" if choice.why else "") + (f", times gain {gain:g}" if gain != 1 else "")
        lines.append(f"  {choice.column:{width}}  from {_name(source, choice.number)}, {told.lstrip(', ')}")
    taken = {choice.number for choice in chosen}
    left = [name for number, name in enumerate(source.names) if number not in taken and name]
    if left:
        more = " …" if len(left) > 12 else ""
        lines.append(f"  not used: {', '.join(left[:12])}{more} (keep one with --also NAME=COLUMN)")
    duration = len(recording) * recording.sample_time_s
    lines.append(f"  rows {recording.metadata['rows']}: {len(recording)} samples, {recording.sample_rate_hz:g} per "
                 f"second, {duration:.6g} s")
    return lines
