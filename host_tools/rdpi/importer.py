"""Tables, MATLAB files and NumPy arrays to recordings.

A source is a list of columns, some with names; the user (`Request`) or an obvious name says which is what and in which
unit. The recording keeps where it came from: `source`, `source_digest`, `source_columns` and `rows`.
"""

from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .errors import BadInput
from .foreign import Unreadable, read_arrays
from .recording import (Place, Recording, check_metadata, check_rate, check_samples, is_column_name,
                        line_of_row, parse_rows, read_bytes, sample_times)

# unit -> dimension (by its base unit), power of ten to the base unit
UNITS = {
    "V": ("V", 0), "mV": ("V", -3), "kV": ("V", 3),
    "m": ("um", 6), "mm": ("um", 3), "um": ("um", 0), "nm": ("um", -3), "pm": ("um", -6),
    "s": ("s", 0), "ms": ("s", -3), "us": ("s", -6),
    "degC": ("degC", 0),
}
_SPELLINGS = {"µm": "um", "μm": "um", "micron": "um", "microns": "um", "µs": "us", "μs": "us", "sec": "s",
              "seconds": "s", "volt": "V", "volts": "V", "c": "degC", "°c": "degC",
              **{unit.lower(): unit for unit in UNITS}}

_RATE_NAMES = ("sample_rate_hz", "samplerate", "sample_rate", "rate_hz", "fs")
_SAMPLE_TIME_NAMES = ("sample_time_s", "sampletime", "sample_time", "ts", "dt")
_SNIFFED_LINES = 200


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
                     "controlvoltage inputvoltage input u v vin vi vcmd vdrive uin"),
    "displacement": _role("displacement_um", "um", "displacement disp position pos measured measureddisplacement "
                          "measuredposition sensor extension elongation output z y d do"),
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
    PURPOSES and says which columns a file must give.
    """

    columns: dict[str, str] = field(default_factory=dict)
    also: dict[str, str] = field(default_factory=dict)
    rate_hz: float | None = None
    rows: slice = field(default_factory=lambda: slice(None))  # unhashable, so no plain default
    command_gain: float = 1.0
    purpose: str = "run"
    metadata: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Cut:
    """Some rows of some columns: finite float64 numbers, equally long."""

    columns: list[np.ndarray]
    start: int  # row of the first
    total: int  # rows of the whole source
    place: Place  # row of the cut -> where it is in the file


@dataclass(frozen=True)
class Source:
    """A file's columns before anyone knows what they mean."""

    path: str
    kind: str
    names: list[str]  # "" for a column without a name
    read: Callable[[list[int], slice], Cut]  # column numbers, rows
    digest: str
    metadata: dict[str, str] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=dict)

    def listing(self) -> str:
        if not any(self.names):
            return f"there are {len(self.names)} columns without names, 0 to {len(self.names) - 1}"
        shown = ", ".join(f"{index} {name!r}" for index, name in enumerate(self.names[:24]))
        return f"there are {shown}" + (f" and {len(self.names) - 24} more" if len(self.names) > 24 else "")


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
            raise BadInput(f"{path}: no column looks like time; say which with --time COLUMN, or give --rate HZ; "
                           f"{source.listing()}")
        columns = {"time_s": sample_times(len(cut.columns[0]), rate), **columns}
    check_samples(f"{path}, rows {rows} of {cut.total}", columns, cut.place, cut.start)
    check_rate(columns["time_s"], metadata, key_place)
    recording = Recording(path, metadata, columns)
    return recording, _describe(source, request, recording, chosen, cut.total, rate_from)


def open_source(path: str) -> Source:
    """Recognise the format by its first bytes (a MATLAB 4 file by its suffix). Raises BadInput."""
    data = read_bytes(path)
    packed = data.startswith(b"PK\x03\x04")
    if data.startswith(b"\x93NUMPY") or packed and Path(path).suffix.lower() != ".xlsx":
        return _arrays(path, data, "NumPy archive" if packed else "NumPy array", "NumPy data",
                       "save plain numeric arrays with numpy.save or numpy.savez")
    if packed or data.startswith(b"\xd0\xcf\x11\xe0"):
        raise BadInput(f"{path}: an Excel workbook; save the sheet as CSV and import that")
    if data.startswith(b"MATLAB 7.3") or data.startswith(b"\x89HDF"):
        raise BadInput(f"{path}: a MATLAB 7.3 (HDF5) file; in MATLAB load it and save it again with "
                       "save('run.mat', ..., '-v7')")
    if data.startswith(b"MATLAB 5.0") or Path(path).suffix.lower() == ".mat":
        return _arrays(path, data, "MATLAB file", "a MATLAB file",
                       "in MATLAB save it again with save('run.mat', ..., '-v7')")
    return _table(path, data)


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
                raise BadInput(f"{source.path}: no column looks like the {key}; say which with --{key} COLUMN; "
                               f"{source.listing()}")
    for name, spec in request.also.items():
        if not is_column_name(name):
            raise BadInput(f"--also {name!r}: no name for a column; leave out commas, quotation marks, line ends, # in "
                           "front and what is not UTF-8")
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
        _, named = _split_unit(source.names[number])
        if unit is None or named is None:
            return Choice(column, number, unit or "", why="taken as it is" if unit is None else "assumed")
        dimension, exponent = UNITS.get(named, (None, 0))
        if dimension != unit:
            raise BadInput(f"{source.path}: {option} {spec}: the name {source.names[number]!r} says {named}, not "
                           f"{unit}; give the factor to {unit}, e.g. {option} {spec}:0.5")
        return Choice(column, number, named, exponent, why="by its name")
    known = _unit(scale)
    if known is not None:
        dimension, exponent = UNITS[known]
        if unit is not None and dimension != unit:
            raise BadInput(f"{source.path}: {option} {spec}: {known} cannot be converted to {unit}; "
                           f"give one of {_units_of(unit)}, or the factor to {unit}")
        return Choice(column, number, known, exponent)
    try:
        factor = float(scale)
    except ValueError:
        factor = np.nan
    if not np.isfinite(factor) or factor == 0:
        raise BadInput(f"{source.path}: {option} {spec}: {scale!r} is no unit and no factor; give one of "
                       f"{_units_of(unit)}, or a number that multiplies the column")
    return Choice(column, number, f"x {factor:g}", factor=factor)


def _scaled(source: Source, request: Request, choice: Choice, raw: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        values = choice.scale(raw) * (request.command_gain if choice.column == "command_V" else 1.0)
    if not np.isfinite(values).all():
        raise BadInput(f"{source.path}: {choice.column} becomes infinite when {_name(source, choice.number)} is "
                       "scaled; give a smaller factor or gain, or leave such rows out with --rows")
    return values


def _find(source: Source, wanted: str) -> int | None:
    """A column by its name (exactly, else ignoring case, else without its unit) or by its number from 0."""
    for match in (lambda name: name, str.lower, lambda name: _split_unit(name)[0].lower()):
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
        base, named = _split_unit(name)
        dimension, exponent = UNITS.get(named or role.unit, (None, 0))
        if number in taken or dimension != role.unit or re.sub("[^a-z0-9]", "", base.lower()) not in role.names:
            continue
        why = "recognised" if named else "recognised, unit assumed"
        choice = Choice(role.column, number, named or role.unit, exponent, why=why)
        if name == role.column:
            return choice
        hits.append(choice)
    if len(hits) > 1:
        names = ", ".join(_name(source, choice.number) for choice in hits)
        raise BadInput(f"{source.path}: {names} all look like the {key}; say which with --{key} COLUMN")
    return hits[0] if hits else None


def _split_unit(name: str) -> tuple[str, str | None]:
    """("pos", "nm") of "pos_nm", "pos [nm]", "pos (nm)", "pos/nm" or "pos nm"; the unit is None when there is none.

    An unknown unit in brackets is returned as it is written: better an error than a wrong scale.
    """
    bracket = re.fullmatch(r"(.+?)[\s_]*[\[(]\s*([^\])]+?)\s*[\])]", name)
    if bracket:
        return bracket[1], _unit(bracket[2]) or bracket[2]
    plain = re.fullmatch(r"(.+?)\s*[_\s/]\s*([^_\s/]+)", name)
    if plain and _unit(plain[2]):
        return plain[1], _unit(plain[2])
    return name, None


def _unit(text: str) -> str | None:
    return text if text in UNITS else _SPELLINGS.get(text.lower())


def _units_of(unit: str | None) -> str:
    return ", ".join(name for name, (dimension, _) in UNITS.items() if unit in (None, dimension))


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
            base = name.rpartition(".")[2].lower()
            if value > 0 and base in _RATE_NAMES:
                return value, f"{source.path}: {name}"
            if value > 0 and base in _SAMPLE_TIME_NAMES:
                return 1 / value, f"{source.path}: {name}"
    return None, ""


def _metadata(source: Source, request: Request, chosen: Sequence[Choice], start: int, rows: str) -> dict[str, str]:
    metadata = dict(source.metadata)
    if start > 0:
        metadata.pop("memory", None)  # it was about a sample that is now left out
    for key, text in request.metadata.items():
        if re.search("[\ud800-\udfff]", text):
            raise BadInput(f"--{key} {text!r}: not UTF-8; set a UTF-8 locale, or use letters without accents")
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
        lines.append(f"  left out: {', '.join(left[:12])}{more} (--also NAME=COLUMN keeps one)")
    duration = len(recording) * recording.sample_time_s
    lines.append(f"  rows {recording.metadata['rows']}: {len(recording)} samples, {recording.sample_rate_hz:g} per "
                 f"second, {duration:.6g} s")
    return lines


# --- MATLAB and NumPy ----------------------------------------------------------------------------------------------

def _arrays(path: str, data: bytes, kind: str, what: str, remedy: str) -> Source:
    """The columns of a file's arrays; the longer side of a matrix is time."""
    try:
        arrays = read_arrays(data)
    except Unreadable as error:
        raise BadInput(f"{path}: cannot be read as {what} ({error}); {remedy}") from None
    names: list[str] = []
    columns: list[np.ndarray] = []
    scalars: dict[str, float] = {}
    for name, value in arrays:
        if value.size == 1:
            scalars[name] = float(value.reshape(()))
            continue
        matrix = np.squeeze(value)
        if matrix.ndim == 1:
            names.append(name)
            columns.append(matrix)
        elif matrix.ndim == 2:
            rows = matrix if matrix.shape[0] < matrix.shape[1] else matrix.T
            names += [f"{name}.{index}" if name else "" for index in range(len(rows))]
            columns += list(rows)
    if not columns:
        raise BadInput(f"{path}: no numeric vectors in it; save time, command and displacement as plain vectors of "
                       "numbers (of a MATLAB timeseries: its Time and Data)")

    def read(numbers: list[int], rows: slice) -> Cut:
        told = [f"{number} {names[number]!r}" if names[number] else str(number) for number in numbers]
        lengths = [len(columns[number]) for number in numbers]
        if len(set(lengths)) > 1:
            raise BadInput(f"{path}: columns of unequal length: "
                           + ", ".join(f"{name} has {length}" for name, length in zip(told, lengths))
                           + "; choose columns that were recorded together")
        start = rows.indices(lengths[0])[0]
        taken = [np.ascontiguousarray(columns[number][rows], dtype=np.float64) for number in numbers]
        for name, values in zip(told, taken):
            bad = ~np.isfinite(values)
            if bad.any():
                row = int(np.argmax(bad))
                raise BadInput(f"{path}, row {start + row}: column {name} is {values[row]}; every sample needs a "
                               "finite number: leave such rows out with --rows, or interpolate")
        return Cut(taken, start, lengths[0], lambda row: f"{path}, row {start + row}")

    return Source(path, kind, names, read, _digest(data), scalars=scalars)


# --- tables --------------------------------------------------------------------------------------------------------

_TABLE_NUMBER = re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|nan|inf)", re.ASCII | re.IGNORECASE)
_DIALECTS = ((";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (None, "."), (None, ","))
_DIALECT_NAMES = {";": "semicolon-separated", "\t": "tab-separated", ",": "comma-separated", None: "white space"}


def _table(path: str, data: bytes) -> Source:
    text = _decode(data)
    if not text.strip():
        raise BadInput(f"{path}: empty file; give a table of numbers, a MATLAB .mat or a NumPy .npy or .npz file")
    head = text.split("\n", _SNIFFED_LINES)[:_SNIFFED_LINES]
    delimiter, decimal, first, count = _sniff(path, head)
    metadata, names, header_line = _preamble(head[:first], delimiter, count)
    body = text.split("\n", first)[first]
    if decimal == ",":
        body = body.replace(",", ".")
    kind = _DIALECT_NAMES[delimiter] + (", decimal comma" if decimal == "," else "")
    kind += f", names in line {header_line}" if header_line else ", no names"

    def read(numbers: list[int], rows: slice) -> Cut:
        # Cut before parsing: what is wrong elsewhere in the file is then no obstacle.
        lines = body.split("\n")
        full = [index for index, line in enumerate(lines) if line.strip()]
        taken = full[rows]
        begin, end = (taken[0], taken[-1] + 1) if taken else (0, 0)
        part, first_line = "\n".join(lines[begin:end]), first + 1 + begin
        labels = [f"{number} {names[number]!r}" if names[number] else str(number) for number in numbers]
        table = parse_rows(path, part, first_line, labels, delimiter, numbers)
        return Cut([np.ascontiguousarray(values) for values in table.T], rows.indices(len(full))[0], len(full),
                   line_of_row(path, part, first_line))

    return Source(path, kind, names, read, _digest(data), metadata)


def _decode(data: bytes) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = data.decode("utf-16", errors="replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")  # old instruments write µ in one byte
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _sniff(path: str, head: Sequence[str]) -> tuple[str | None, str, int, int]:
    """Delimiter, decimal sign, index of the first line of numbers and number of columns, from a file's first lines."""
    full = [index for index, line in enumerate(head) if line.strip()]
    for delimiter, decimal in _DIALECTS:
        parted = [index for index in full if delimiter is None or delimiter in head[index]]
        rows = {index: _fields(head[index], delimiter) for index in parted}
        numeric = {index: len(row) for index, row in rows.items() if _all_numbers(row, decimal)}
        for index, following in zip(full, [*full[1:], None]):
            # A lone number may be part of a preamble; two equal rows are a table.
            if index in numeric and (following is None or numeric.get(following) == numeric[index]):
                return delimiter, decimal, _first_row(head, delimiter, decimal, index, numeric[index]), numeric[index]
    for delimiter in (";", "\t", ","):  # a table that also has columns of text: names, then rows with some numbers
        rows = [(index, _fields(head[index], delimiter)) for index in full if not head[index].lstrip().startswith("#")]
        for (_, names), (index, row) in zip(rows, rows[1:]):
            if 1 < len(names) == len(row) and not any(map(_TABLE_NUMBER.fullmatch, names)):
                for decimal in (".", ",") if delimiter != "," else (".",):
                    if any(_all_numbers([value], decimal) for value in row if value):
                        return delimiter, decimal, index, len(row)
    raise BadInput(f"{path}:1: no table of numbers in the first {min(len(head), _SNIFFED_LINES)} lines; give columns "
                   "of numbers separated by comma, semicolon, tab or white space")


def _first_row(head: Sequence[str], delimiter: str | None, decimal: str, index: int, count: int) -> int:
    """Move up over rows that hold numbers and a mistake: they must be reported, not taken for a preamble."""
    highest = index
    for above in range(index - 1, -1, -1):
        line = head[above]
        if not line.strip():
            continue
        if _header_fields(_uncomment(line), delimiter, count):
            return highest
        row = _fields(line, delimiter)
        if line != _uncomment(line) or not any(_all_numbers([value], decimal) for value in row):
            break
        highest = above
        if len(row) == count:
            index = above
    return index


def _fields(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    try:
        fields = [value.strip() for value in next(csv.reader([line.strip(" ")], delimiter=delimiter), [""])]
    except csv.Error:  # such as an endless field in a file that is no table
        return [line]
    return fields[:-1] if len(fields) > 1 and not fields[-1] else fields  # many instruments end every line with one


def _all_numbers(row: Sequence[str], decimal: str) -> bool:
    """Empty fields pass: a missing value in the first row is reported with its place later, if the column is taken."""
    if decimal == ",":
        row = [value.replace(",", ".") if "." not in value else "." for value in row]
    return any(row) and all(_TABLE_NUMBER.fullmatch(value) for value in row if value)


def _preamble(lines: Sequence[str], delimiter: str | None, count: int) -> tuple[dict[str, str], list[str], int | None]:
    """Metadata, column names and the number of the line with the names, from the lines above the numbers."""
    metadata, candidates = {}, []
    for number, line in enumerate(lines, 1):
        comment = re.fullmatch(r"\s*#\s*([^:]*\S)\s*:\s*(.*?)\s*", line)
        if comment and len(_fields(comment[2], delimiter)) != count:
            metadata[comment[1]] = comment[2]
        elif line.strip():
            candidates.append((number, _header_fields(_uncomment(line), delimiter, count)))
    if not candidates or candidates[-1][1] is None:
        return metadata, [""] * count, None
    number, names = candidates[-1]
    units = [unit.strip("[]() ") for unit in names]
    above = candidates[-2][1] if len(candidates) > 1 else None
    if above and all(not unit or _unit(unit) for unit in units):
        number = candidates[-2][0]
        names = [f"{name} [{unit}]" if unit else name for name, unit in zip(above, units)]
    return metadata, names, number


def _header_fields(line: str, delimiter: str | None, count: int) -> list[str] | None:
    """The `count` names in a line, or None when it holds something else."""
    options = [_fields(line, delimiter)]
    if delimiter is None:  # "Time (s)  Voltage (V)"
        options += [re.split(r"\s{2,}|\t", line.strip()), re.sub(r"\s+(?=[\[(])", "_", line).split(),
                    _fields(line, ",")]
    for names in options:
        if len(names) == count and not any(map(_TABLE_NUMBER.fullmatch, names)):
            return [name.strip().strip('"').strip() for name in names]
    return None


def _uncomment(line: str) -> str:
    return re.sub(r"^\s*[#%]+\s*", "", line)


def _digest(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"
