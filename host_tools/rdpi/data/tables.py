"""Tables of numbers in text files, whatever wrote them: the separators, and what the lines above the numbers say.

Oscilloscopes and loggers put there names, units below the names or in lines of their own ("Vertical Units,V,V"), and
settings ("Sample Interval,4e-9"), some of them beside the names ("X,CH1,Start,Increment" over
"Sequence,Volt,-0.1,1e-5").
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from ..errors import BadInput
from .units import known_unit, split_unit

SNIFFED_LINES = 200
MAX_COLUMNS = 10_000
DIALECT_NAMES = {";": "semicolon-separated", "\t": "tab-separated", ",": "comma-separated", None: "white space"}

_NUMBER = re.compile(r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?|nan|inf)", re.ASCII | re.IGNORECASE)
_HEXADECIMAL = re.compile(r"0x[0-9a-f]+", re.ASCII | re.IGNORECASE)  # of a scope's digital channels: text like other
_DIALECTS = ((";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (None, "."), (None, ","))
_COUNTED = {"sequence", "samples", "sample", "points", "point", "index"}  # in place of a unit: the rows are counted
_NO_UNIT = {"", "-", "value", "bit"}
_STEPS = {"increment", "tinc", "xinc", "xincrement", "sampleinterval"}  # names of what one count is, in s
_STARTS = {"start", "t0", "xorigin"}
_MAX_EXTRA = 4  # fields beside the names
_MAX_CHANNEL = 64  # whose number may be its name


@dataclass(frozen=True)
class Preamble:
    """What the lines above the numbers say."""

    metadata: dict[str, str] = field(default_factory=dict)  # of `# key: value`
    names: list[str] = field(default_factory=list)  # one a column, the unit in brackets; "" for none
    line: int | None = None  # of the names, from 1
    settings: dict[str, float] = field(default_factory=dict)
    clock: tuple[float, float] | None = None  # column 0 counts: start and step in s


@dataclass(frozen=True)
class Layout:
    """Where a text's numbers begin, and how they are separated."""

    delimiter: str | None  # None: white space
    decimal: str
    first: int  # index of the first line of numbers
    preamble: Preamble


def decode(data: bytes) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = data.decode("utf-16", errors="replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")  # old instruments write µ in one byte
    return text.replace("\r\n", "\n").replace("\r", "\n")


def layout(path: str, text: str) -> Layout:
    """Recognise a table by its first lines. Raises BadInput where there is none."""
    head = text.split("\n", SNIFFED_LINES)[:SNIFFED_LINES]
    delimiter, decimal, first, count, filled = _sniff(path, head)
    if count > MAX_COLUMNS:
        raise BadInput(f"{path}:{first + 1}: has {count} columns; the limit is {MAX_COLUMNS}. Write one line for each "
                       "sample")
    preamble = _preamble(head[:first], delimiter, decimal, count, filled)
    rows = [row for row in (fields(line, delimiter) for line in head[first:]) if any(row)]
    for column in range(count):
        if not any(column < len(row) and row[column] for row in rows):
            preamble.names[column] = ""  # such as X_Value of a LabVIEW file without times
    return Layout(delimiter, decimal, first, preamble)


def fields(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    try:
        values = [value.strip() for value in next(csv.reader([line.strip(" ")], delimiter=delimiter), [""])]
    except csv.Error:  # such as an endless field in a file that is no table
        return [line]
    return values[:-1] if len(values) > 1 and not values[-1] else values  # many instruments end every line with one


def begins_a_preamble(lines: Sequence[str], delimiter: str | None) -> bool:
    """Whether lines amid numbers begin another table: one without any number, or two that begin with words."""
    words = [[not _all_numbers([value], ".") and not _all_numbers([value], ",") for value in fields(line, delimiter)]
             for line in [line for line in lines if line.strip()][:2]]
    return all(words[0]) or len(words) == 2 and words[0][0] and words[1][0]


def _sniff(path: str, head: Sequence[str]) -> tuple[str | None, str, int, int, int]:
    """From a file's first lines: delimiter, decimal sign, index of the first line of numbers, number of columns, and
    of those up to the last one that holds something.
    """
    full = [index for index, line in enumerate(head) if line.strip()]
    for delimiter, decimal in _DIALECTS:
        parted = [index for index in full if delimiter is None or delimiter in head[index]]
        rows = {index: fields(head[index], delimiter) for index in parted}
        numeric = {index: len(row) for index, row in rows.items()
                   if _all_numbers([value for value in row if not _HEXADECIMAL.fullmatch(value)], decimal)}
        for index, following in zip(full, [*full[1:], None]):
            # A lone number may be part of a preamble; two equal rows are a table.
            if index in numeric and (following is None or numeric.get(following) == numeric[index]):
                count = numeric[index]
                filled = _filled(head[index:], delimiter, decimal, count)
                return (delimiter, decimal, _first_row(head, delimiter, decimal, index, count, filled), count, filled)
    for delimiter in (";", "\t", ","):  # a table that also has columns of text: names, then rows with some numbers
        rows = [(index, fields(head[index], delimiter)) for index in full if not head[index].lstrip().startswith("#")]
        for (_, names), (index, row), below in zip(rows, rows[1:], [*rows[2:], None]):
            if len(names) < 2 or any(map(_NUMBER.fullmatch, names)):
                continue
            for decimal in (".", ",") if delimiter != "," else (".",):
                first, count, most = index, len(row), len(row)
                if below is not None:
                    filled = _filled(head[below[0]:], delimiter, decimal, len(below[1]))
                    if _units(row, len(below[1]), filled):
                        first, count, most = below[0], len(below[1]), len(below[1]) + _MAX_EXTRA
                if count <= len(names) <= most and _any_number(fields(head[first], delimiter), decimal):
                    return delimiter, decimal, first, count, _filled(head[first:], delimiter, decimal, count)
    raise BadInput(f"{path}:1: there is no table of numbers in the first {min(len(head), SNIFFED_LINES)} lines; give "
                   "columns of numbers separated by comma, semicolon, tab or white space")


def _filled(lines: Sequence[str], delimiter: str | None, decimal: str, count: int) -> int:
    """Columns of a table's first lines up to the last that holds something: below settings beside the names, some
    instruments pad the rows.
    """
    filled = 0
    for line in lines:
        row = fields(line, delimiter)
        if any(row) and not _any_number(row, decimal):
            break  # another table may begin
        if len(row) == count:
            filled = max(filled, *(column for column, value in enumerate(row, 1) if value), 0)
    return filled


def _first_row(head: Sequence[str], delimiter: str | None, decimal: str, index: int, count: int, filled: int) -> int:
    """Move up over rows that hold numbers and a mistake: they must be reported, not taken for a preamble."""
    highest = index
    for above in range(index - 1, -1, -1):
        line = head[above]
        if not line.strip():
            continue
        row = fields(line, delimiter)
        if _header(_uncomment(line), delimiter, count) or _units(row, count, filled):
            return highest
        if line != _uncomment(line) or not _any_number(row, decimal):
            break
        highest = above
        if len(row) == count:
            index = above
    return index


def _all_numbers(row: Sequence[str], decimal: str) -> bool:
    """Empty fields pass: a missing value in the first row is reported with its place later, if the column is taken."""
    if decimal == ",":
        row = [value.replace(",", ".") if "." not in value else "." for value in row]
    return any(row) and all(_NUMBER.fullmatch(value) for value in row if value)


def _any_number(row: Sequence[str], decimal: str) -> bool:
    return any(_all_numbers([value], decimal) for value in row)


def _preamble(lines: Sequence[str], delimiter: str | None, decimal: str, count: int, filled: int) -> Preamble:
    metadata: dict[str, str] = {}
    rows: list[tuple[int, list[str], list[str] | None]] = []  # line, fields, names if it may hold them
    for number, line in enumerate(lines, 1):
        key, colon, value = (part.strip() for part in line.strip().removeprefix("#").partition(":"))
        if line.lstrip().startswith("#") and key and colon and len(fields(value, delimiter)) != count:
            metadata[key] = value
        elif (text := _uncomment(line)).strip():
            rows.append((number, fields(text, delimiter) or [""], _header(text, delimiter, count)))
    settings = _settings([row for _, row, _ in rows], decimal)
    if not rows or rows[-1][2] is None and not _units(rows[-1][1], count, filled):
        return Preamble(metadata, [""] * count, None, settings)

    number, row, names = rows[-1]
    units = _units(row, count, filled)
    above = rows[-2] if len(rows) > 1 else None
    over = (above[2] or _numbered(above[1], count)) if above is not None and units is not None else None
    if over is not None:
        number, names = above[0], over[:count]
        settings.update((name, _number(value, decimal)) for name, value in zip(over[filled:], row[filled:])
                        if _all_numbers([value], decimal) and value)
    else:
        units = None
    for text in rows[-1][2] or []:  # "tInc = 2e-08"
        name, _, value = (part.strip() for part in text.partition("="))
        if value and _all_numbers([value], decimal):
            settings[name] = _number(value, decimal)
    if names is None:
        return Preamble(metadata, [""] * count, None, settings)
    names = names[:count]
    clock = None
    if units is not None and units[0].lower() in _COUNTED:
        step = next((value for name, value in settings.items() if plain(name) in _STEPS), None)
        start = next((value for name, value in settings.items() if plain(name) in _STARTS), 0.0)
        clock = (start, step) if step else None
        units[0] = "s" if clock else ""
    if units is not None:
        names = [f"{name} [{unit}]" if known_unit(unit) else name for name, unit in zip(names, units)]
    else:
        units = _labelled_units([row for _, row, _ in rows[:-1]], count)
        names = [f"{name} [{unit}]" if unit and split_unit(name)[1] is None else name
                 for name, unit in zip(names, units)]
    return Preamble(metadata, names, number, settings, clock)


def _header(line: str, delimiter: str | None, count: int) -> list[str] | None:
    """The names in a line of `count` columns, perhaps with some fields more, or None when it holds something else."""
    options = [fields(line, delimiter)]
    most = count + _MAX_EXTRA
    if delimiter is None:  # "Time (s)  Voltage (V)"
        most = count
        joined = " ".join(line.split()).replace(" [", "_[").replace(" (", "_(")
        options += [re.split(r"\s{2,}|\t", line.strip()), joined.split(), fields(line, ",")]
    for names in options:
        if count <= len(names) <= most and not any(map(_NUMBER.fullmatch, names)):
            return [name.strip().strip('"').strip() for name in names]
    return None


def _units(row: Sequence[str], count: int, filled: int) -> list[str] | None:
    """The units in a line that holds nothing else, but perhaps numbers behind those of the columns that are filled."""
    units = [value.strip("[]() ") for value in row[:count]]
    units[filled:] = ["" if _NUMBER.fullmatch(unit) else unit for unit in units[filled:]]
    told = [unit for unit in units if unit.lower() not in _NO_UNIT]
    if not told or not filled <= len(row) <= count + _MAX_EXTRA:
        return None
    if any(known_unit(unit) is None and unit.lower() not in _COUNTED for unit in told):
        return None
    return units + [""] * (count - len(units))


def _numbered(row: Sequence[str], count: int) -> list[str] | None:
    """Names of which some are the channels' numbers, such as "x-axis,1,2"; only units below tell that."""
    if not count <= len(row) <= count + _MAX_EXTRA or not row[0] or _NUMBER.fullmatch(row[0]):
        return None
    numbers = [value for value in row[1:count] if _NUMBER.fullmatch(value)]
    good = all(value.isdigit() and 0 < int(value) <= _MAX_CHANNEL for value in numbers)
    return list(row) if good else None


def _labelled_units(rows: Sequence[Sequence[str]], count: int) -> list[str]:
    """Units from lines of their own, such as "Vertical Units,V,V"."""
    units = [""] * count
    for row in rows:
        label, given = plain(row[0]), [value.rpartition(":")[2].strip("[]() ") for value in row[1:]]  # CH1:V
        if label == "xdimension" and set(given) == {"Time"}:
            units[0] = "s"
        if "unit" not in label or not all(given):
            continue
        if len(given) == 1 and label.startswith(("h", "x")):
            units[0] = given[0]
        elif len(given) == count:
            units = given
        elif len(given) == count - 1:
            units[1:] = given
    return units


def _settings(rows: Sequence[Sequence[str]], decimal: str) -> dict[str, float]:
    """Numbers that a line gives a name: "Sample Interval,4e-9", or the same for every channel."""
    settings = {}
    for row in rows:
        values = {value for value in row[1:] if value}
        if row[0] and not _NUMBER.fullmatch(row[0]) and len(values) == 1 and _all_numbers(list(values), decimal):
            settings[row[0].rstrip(": ")] = _number(values.pop(), decimal)
    return settings


def _number(text: str, decimal: str) -> float:
    return float(text.replace(decimal, "."))


def plain(text: str) -> str:
    """Letters and digits of a name, lower case."""
    return re.sub("[^a-z0-9]", "", text.lower())


def _uncomment(line: str) -> str:
    return re.sub(r"^\s*[#%]+\s*", "", line)
