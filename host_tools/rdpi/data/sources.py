"""Files of other formats as columns of numbers, before anyone knows what they mean."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import BadInput
from . import tables
from .files import read_bytes
from .foreign import Unreadable, read_arrays
from .recording import whole_lines
from .rows import Place, line_of_row, parse_rows


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


def open_source(path: str) -> Source:
    """Recognise the format by its first bytes (a MATLAB 4 file by its suffix). Raises BadInput."""
    data = whole_lines(read_bytes(path))
    packed = data.startswith(b"PK\x03\x04")
    if data.startswith(b"\x93NUMPY") or packed and Path(path).suffix.lower() != ".xlsx":
        return _arrays(path, data, "NumPy archive" if packed else "NumPy array", "NumPy data",
                       "save plain numeric arrays with numpy.save or numpy.savez")
    if packed or data.startswith(b"\xd0\xcf\x11\xe0"):
        raise BadInput(f"{path}: is an Excel workbook; save the sheet as CSV and import that")
    if data.startswith(b"MATLAB 7.3") or data.startswith(b"\x89HDF"):
        raise BadInput(f"{path}: is a MATLAB 7.3 (HDF5) file; in MATLAB, load it and save it again with "
                       "save('run.mat', ..., '-v7')")
    if data.startswith(b"MATLAB 5.0") or Path(path).suffix.lower() == ".mat":
        return _arrays(path, data, "MATLAB file", "a MATLAB file",
                       "in MATLAB, save it again with save('run.mat', ..., '-v7')")
    return _table(path, data)


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
        raise BadInput(f"{path}: contains no numeric vectors; save time, command and displacement as plain vectors of "
                       "numbers (of a MATLAB timeseries: its Time and Data)")

    def read(numbers: list[int], rows: slice) -> Cut:
        told = [f"{number} {names[number]!r}" if names[number] else str(number) for number in numbers]
        lengths = [len(columns[number]) for number in numbers]
        if len(set(lengths)) > 1:
            raise BadInput(f"{path}: the columns differ in length: "
                           + ", ".join(f"{name} has {length}" for name, length in zip(told, lengths))
                           + "; choose columns that were recorded together")
        start = rows.indices(lengths[0])[0]
        with np.errstate(over="ignore"):  # what a double does not hold is refused as infinite
            taken = [np.ascontiguousarray(columns[number][rows], dtype=np.float64) for number in numbers]
        for name, values in zip(told, taken):
            bad = ~np.isfinite(values)
            if bad.any():
                row = int(np.argmax(bad))
                raise BadInput(f"{path}, row {start + row}: column {name} is {values[row]}; every sample needs a "
                               "finite number: exclude such rows with --rows, or interpolate")
        return Cut(taken, start, lengths[0], lambda row: f"{path}, row {start + row}")

    return Source(path, kind, names, read, _digest(data), scalars=scalars)


# --- tables --------------------------------------------------------------------------------------------------------

def _table(path: str, data: bytes) -> Source:
    text = tables.decode(data)
    if not text.strip():
        raise BadInput(f"{path}: is empty; give a table of numbers, a MATLAB .mat or a NumPy .npy or .npz file")
    found = tables.layout(path, text)
    names, first, line, clock = found.preamble.names, found.first, found.preamble.line, found.preamble.clock
    body = text.split("\n", first)[first]
    if found.decimal == ",":
        body = body.replace(",", ".")
    kind = tables.DIALECT_NAMES[found.delimiter] + (", decimal comma" if found.decimal == "," else "")
    kind += f", names in line {line}" if line else ", no names"

    def read(numbers: list[int], rows: slice) -> Cut:
        # Cut before parsing: what is wrong elsewhere in the file is then no obstacle.
        lines = body.split("\n")
        full = [index for index, line in enumerate(lines) if line.strip()]
        taken, start = full[rows], rows.indices(len(full))[0]
        begin, end = (taken[0], taken[-1] + 1) if taken else (0, 0)
        part, first_line = "\n".join(lines[begin:end]), first + 1 + begin
        if len(taken) > 1 and end == len(lines):  # no end of line: the writing may have been cut off
            last, before = (len(tables.fields(lines[row], found.delimiter)) for row in (taken[-1], taken[-2]))
            if last < before:
                raise BadInput(f"{path}:{first + end}: the file ends within this line: {last} value(s), and {before} in the "
                               "line before; remove it")
        labels = [f"{number} {names[number]!r}" if names[number] else str(number) for number in numbers]
        try:
            table = parse_rows(path, part, first_line, labels, found.delimiter, numbers)
        except BadInput as error:
            raise _another_table(path, error, lines, taken, start, first + 1, found.delimiter) from None
        columns = [np.ascontiguousarray(values) for values in table.T]
        if clock is not None:
            with np.errstate(over="ignore"):  # times beyond range are refused as they are scaled
                columns = [clock[0] + clock[1] * values if number == 0 else values
                           for number, values in zip(numbers, columns)]
        return Cut(columns, start, len(full), line_of_row(path, part, first_line))

    return Source(path, kind, names, read, _digest(data), found.preamble.metadata, found.preamble.settings)


def _another_table(path: str, error: BadInput, lines: list[str], taken: list[int], start: int, first_line: int,
                   delimiter: str | None) -> BadInput:
    """What to say of rows that cannot be read: of a line of text amid them, which row it is."""
    place = re.match(re.escape(path) + r":(\d+): ", str(error))
    if place is None or (index := int(place[1]) - first_line) == taken[0] or not tables.begins_a_preamble(
            lines[index:][:9], delimiter):  # before the first row there is no table
        return error
    row = start + taken.index(index)
    return BadInput(f"{path}:{place[1]}: there is text between the numbers, in row {row}. If another table begins "
                    f"there, choose the rows of one with --rows, e.g. --rows {start}:{row}")


def _digest(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"
