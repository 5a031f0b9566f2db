"""PLAN.csv: a row per actuator, what its model is fitted to and which recordings are diagnosed."""

from __future__ import annotations

import csv
import glob
import hashlib
import io
import os
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ...data import arguments, check_made, check_no_table, read_bytes, same_file
from ...errors import BadInput
from ...model import kept_with
from .page import FILES, PAGE

COLUMNS = "actuator", "fit", "hold_out", "gap", "earlier", "model", "options"
RUNS = "fit", "hold_out", "gap", "earlier"  # columns that name recordings
SEPARATOR = ";"
LONGEST = 200  # bytes of an actuator's name: file systems take 255, a model's .json included

Parse = Callable[[str, Collection[str]], dict[str, Any]]


@dataclass(frozen=True)
class Task:
    """A row of the plan. Files have absolute paths: a worker may stand elsewhere."""

    actuator: str
    runs: dict[str, tuple[str, ...]]  # by column of RUNS
    model: str  # as the plan names it: relative to the plan, unless it is absolute
    model_file: str
    options_text: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    refused: str = ""  # why nothing can be done; "": something can
    line: int = 0  # of the plan
    inputs: tuple[str, ...] = ()  # files that must stay: recordings, and those that are kept with a model that is read

    def digest(self) -> str:
        """SHA-256, in hexadecimal, of all that the results depend on: files, and how they are used. Raises OSError."""
        inputs = hashlib.sha256()
        files = [(role, path) for role in RUNS for path in self.runs[role]]
        if not self.runs["fit"]:
            files.append(("model", self.model_file))
        for role, path in files:
            inputs.update(f"{role}\0{sha256_of(path)}\0".encode())
        inputs.update(repr(self.options_text.split()).encode())
        return inputs.hexdigest()


def sha256_of(path: str) -> str:
    """Of a file, in hexadecimal. Raises OSError."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_plan(path: str, parse: Parse, outputs: Collection[str] = (), report: str | None = None) -> list[Task]:
    """Tasks of a plan, in its order; `parse` makes keywords of options for "fit", "gap" or both, and raises BadInput.

    A row whose recordings are not there makes a task that says so. Raises BadInput for what is no plan: no columns or
    unknown ones, two rows of one actuator, models that would be written over; for a file of it that is one of the
    `outputs`, which are written beside the models; and for any of these where the folder `report` will have a page.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput(f"{path}: is not text; save it as CSV in UTF-8") from None
    if "\0" in text:
        raise BadInput(f"{path}: is not text; there is a byte of zero in it. Save it as CSV in UTF-8")
    reader = csv.reader(io.StringIO(text, newline=None), strict=True)
    names: list[str] = []
    tasks: list[Task] = []
    try:
        for cells in reader:
            values = [cell.strip() for cell in cells]
            if not any(values) or values[0].startswith("#"):
                continue
            place = f"{path}:{reader.line_num}"
            if not names:
                names = _header(values, place)
                continue
            if len(values) != len(names):
                raise BadInput(f"{place}: {len(values)} value(s) instead of {len(names)}; a comma within a value needs "
                               "quotation marks around the value")
            task = _task(dict(zip(names, values)), place, os.path.dirname(os.path.abspath(path)), parse)
            tasks.append(replace(task, line=reader.line_num))
    except csv.Error as error:
        raise BadInput(f"{path}:{reader.line_num}: is not CSV ({error}); correct the line") from None
    if not tasks:
        raise BadInput(f"{path}: has no rows; give a row of names ({', '.join(COLUMNS)}) and a row for each actuator")
    _check_apart(tasks, path)
    written = {os.path.realpath(output): output for output in outputs}
    for task in tasks:
        for file in (task.model_file, *task.inputs):
            if output := written.get(os.path.realpath(file)):
                raise BadInput(f"{output}: would be written over a file of {task.actuator} in {path}; give another name")
    if report is not None:
        _check_pages(tasks, path, outputs, report)
    return tasks


def _header(names: Sequence[str], place: str) -> list[str]:
    for name in names:
        if name not in COLUMNS:
            raise BadInput(f"{place}: column {name!r} is not known; the columns are {', '.join(COLUMNS)}, with commas "
                           "between them")
        if names.count(name) > 1:
            raise BadInput(f"{place}: there are two columns {name}; remove one")
    if "actuator" not in names or not {"fit", "gap"} & set(names):
        raise BadInput(f"{place}: a plan needs the column actuator and one of fit and gap")
    return list(names)


def _task(row: dict[str, str], place: str, folder: str, parse: Parse) -> Task:
    actuator = row["actuator"]
    if not actuator:
        raise BadInput(f"{place}: column actuator is empty; give each row a name")
    if actuator in (".", "..") or set(actuator) & set("/\\") or not actuator.isprintable() or \
            len(actuator.encode()) > LONGEST:
        raise BadInput(f"{place}: actuator {arguments.shown(actuator)}: must do as the name of a folder; use at most {LONGEST} "
                       "bytes, and neither / nor \\ nor what cannot be printed")
    row = {**row, **{name: row.get(name, "").strip(f"{SEPARATOR} ") for name in RUNS}}
    if not row["fit"] and not row["gap"]:
        raise BadInput(f"{place}: give recordings in fit or in gap")
    for name, needed in (("hold_out", "fit"), ("earlier", "gap")):
        if row[name] and not row[needed]:
            raise BadInput(f"{place}: {name} needs recordings in {needed}")
    try:
        options = parse(row.get("options", ""), [name for name in ("fit", "gap") if row[name]])
    except BadInput as error:
        raise BadInput(f"{place}: options: {error}") from None
    runs, refused = {}, ""
    for name in RUNS:
        runs[name], missing = _files(row[name], folder)
        if missing and not refused:
            refused = f"{name}: there is no file {missing}; check the name"
    model = row.get("model") or f"models/{actuator}.json"
    model_file = os.path.join(folder, model)
    if not runs["fit"] and not refused and not os.path.isfile(model_file):
        refused = f"there is no model {model}; give recordings in fit, or a model that is there"
    kept = () if runs["fit"] else kept_with(model_file)
    return Task(actuator, runs, model, model_file, row.get("options", ""), options, refused,
                inputs=(*(file for files in runs.values() for file in files), *kept))


def _files(text: str, folder: str) -> tuple[tuple[str, ...], str]:
    """Paths that a cell stands for, those of a pattern by name; and the first part that stands for none."""
    found: list[str] = []
    for part in filter(None, map(str.strip, text.split(SEPARATOR))):
        file = os.path.join(folder, part)
        here = [file] if os.path.exists(file) else sorted(glob.glob(os.path.join(glob.escape(folder), part)))
        if not here or not all(map(os.path.isfile, here)):  # a folder; a device or pipe may have no end
            return tuple(found), part
        found += here
    return tuple(found), ""


def _check_apart(tasks: Sequence[Task], path: str) -> None:
    """No two rows are of one actuator, and no model is written over another or over a recording."""
    seen: dict[str, int] = {}
    written: dict[str, int] = {}
    inputs = {os.path.realpath(file) for task in tasks for file in task.inputs}
    for task in tasks:
        line, name = task.line, task.actuator.casefold()  # folders that differ in case only are one folder elsewhere
        if name in seen:
            raise BadInput(f"{path}:{line}: {task.actuator} has a row already, line {seen[name]}; give each actuator one row")
        seen[name] = line
        if not task.runs["fit"]:
            continue
        model = os.path.realpath(task.model_file)
        if model in written:
            raise BadInput(f"{path}:{line}: {task.model} would be written by line {written[model]} too; give another model")
        if model in inputs or same_file(model, path):
            raise BadInput(f"{path}:{line}: the model {task.model} would be written over an input; give another model")
        check_no_table(task.model_file)
        written[model] = line
    for task in tasks:
        model = os.path.realpath(task.model_file)
        if not task.runs["fit"] and model in written:
            raise BadInput(f"{path}:{task.line}: {task.model} is written by line {written[model]} in the same batch; give "
                           "that row's recordings in one row, or use two plans")


def _check_pages(tasks: Sequence[Task], path: str, outputs: Collection[str], report: str) -> None:
    """Each actuator can have a folder of its name, and no page there is written over any file of the batch."""
    apart = {os.path.realpath(file): file for file in
             (path, *outputs, *(file for task in tasks for file in (task.model_file, *task.inputs)))}
    for task in tasks:
        if task.actuator.casefold() == PAGE:
            raise BadInput(f"{path}:{task.line}: actuator {task.actuator!r}: --report writes a page of this name; give "
                           "another name")
        folder = os.path.join(report, task.actuator)
        check_made(folder, ())
        pages = [os.path.join(folder, name) for kind in FILES if task.runs[kind] for name in FILES[kind]]
        for file in map(os.path.realpath, (folder, *pages)):
            if file in apart:
                raise BadInput(f"{path}:{task.line}: the report of {task.actuator} would be written over {apart[file]}; "
                               "give another --report")
