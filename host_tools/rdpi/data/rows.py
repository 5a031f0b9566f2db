"""Rows of numbers, and where in a file the first one is that is none."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ..errors import BadInput

NUMBER = re.compile(r"[+-]?(\d+(?:\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)
_CLOCK = re.compile(r"\d:\d\d", re.ASCII)
_LINES_PER_BLOCK = 1 << 14

Place = Callable[[int], str]  # data row, counted from 0 -> "file:line"


def parse_rows(path: str, body: str, first_line: int, names: Sequence[str], delimiter: str | None = ",",
               usecols: Sequence[int] | None = None) -> np.ndarray:
    """Numbers of a table's body, shape (rows, len(names)).

    `body` starts at line `first_line` of the file; `delimiter` None means white space. `usecols` are the numbers of the
    columns called `names`; without it the rows must hold exactly these columns.
    Raises BadInput with the line of the first thing that is not a finite number.
    """
    if not body.strip():
        return np.empty((0, len(names)))
    table = _load(body, len(names), delimiter, usecols)
    if table is None:
        _explain_rows(path, body, first_line, names, delimiter, usecols)
        raise BadInput(f"{path}: is not a table of numbers; save it as CSV again")
    return table


def line_of_row(path: str, body: str, first_line: int) -> Place:
    """A function that gives the place "file:line" of a data row."""

    def place(row: int) -> str:
        return next(f"{path}:{line}" for index, (line, _) in enumerate(_lines(body, first_line)) if index == row)

    return place


def _load(body: str, width: int, delimiter: str | None, usecols: Sequence[int] | None) -> np.ndarray | None:
    """Rows of `width` finite numbers, or None when it is anything else."""
    # Bytes behind a text layer: a StringIO would hold four bytes per character.
    stream = io.TextIOWrapper(io.BytesIO(body.encode()), "utf-8")
    try:
        table = np.loadtxt(stream, delimiter=delimiter, usecols=usecols, comments=None, quotechar='"', ndmin=2)
    except ValueError:
        return None
    return table if table.shape[1] == width and np.isfinite(table).all() else None


def _explain_rows(path: str, body: str, first_line: int, names: Sequence[str], delimiter: str | None,
                  usecols: Sequence[int] | None) -> None:
    """Raise BadInput for the first field that is no finite number, or row of the wrong length."""
    numbers = range(len(names)) if usecols is None else usecols
    needed = max(numbers) + 1
    lines = body.split("\n")
    for start in range(0, len(lines), _LINES_PER_BLOCK):  # reading a good block again is faster than looking at it
        block = "\n".join(lines[start:start + _LINES_PER_BLOCK])
        if not block.strip() or _load(block, len(names), delimiter, usecols) is not None:
            continue
        for line, text in _lines(block, first_line + start):
            fields = [value.strip().strip('"') for value in text.split(delimiter)]
            if len(fields) < needed or (usecols is None and len(fields) > needed):
                raise BadInput(f"{path}:{line}: {len(fields)} value(s) instead of {needed}; "
                               "complete the line or remove it")
            for name, number in zip(names, numbers):
                _explain_field(f"{path}:{line}: column {name}", fields[number])


def _explain_field(place: str, value: str) -> None:
    needed = place.endswith(("time_s", "command_V", "displacement_um"))
    if _NOT_FINITE.fullmatch(value) or NUMBER.fullmatch(value) and not np.isfinite(float(value)):
        raise BadInput(f"{place} is {shortened(value)}; every sample needs a finite number: cut the recording there"
                       + (" or interpolate" if needed else ", interpolate, or remove the column"))
    if _CLOCK.search(value):
        raise BadInput(f"{place} is {quoted(value)}, a time of day; write seconds, or do not take the column and give --rate HZ")
    if not NUMBER.fullmatch(value):
        what = f"is {quoted(value)}, not a number" if value else "is empty"
        raise BadInput(f"{place} {what}; correct the value, or remove the line" + " or the column" * (not needed))


def _lines(body: str, first_line: int) -> Iterator[tuple[int, str]]:
    """Line numbers and texts of the lines that are not blank."""
    for line, text in enumerate(body.split("\n"), first_line):
        if text.strip():
            yield line, text


def quoted(text: str) -> str:
    return repr(shortened(text))


def shortened(text: str) -> str:
    return text if len(text) <= 40 else text[:40] + "…"
