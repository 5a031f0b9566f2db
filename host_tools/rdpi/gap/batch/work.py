"""What a worker does: fit and diagnose one actuator. It never raises; what went wrong is part of what it returns."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

from ... import version
from ...data import make_folder, read_recording
from ...errors import BadInput, printable
from ...identify import FitDocument, Options, fit, kept, summary
from ...model import read_model, write_model
from .. import report as gap_report
from ..diagnosis import diagnose
from ..sections import GapDocument
from .plan import Task, sha256_of
from .results import Row

Documents = dict[str, dict[str, Any]]  # "fit", "gap": as their commands write them with --json


class Outcome(NamedTuple):
    row: Row
    documents: Documents


def work(task: Task, report: str | None = None) -> Outcome:
    """Results of a task. With `report`, a folder, the actuator's pages are written to a folder of its name in there."""
    begin = time.monotonic()
    row = Row(task.actuator, model_path=task.model, tool=version(), started_at=now())
    documents: Documents = {}
    try:
        if task.refused:
            raise BadInput(task.refused)
        row.inputs_sha256 = task.digest()  # before they are read: what changes meanwhile has changed
        _work(task, report, row, documents)
        row.status = "done"
    except BadInput as error:
        row.error = printable(str(error))
    except MemoryError:
        row.error = "there is not enough memory; give shorter recordings, or fewer --jobs"
    except OSError as error:
        row.error = printable(f"{error.filename or task.model}: {error.strerror or error}")
    except Exception as error:  # noqa: BLE001 - the others go on
        row.error = f"this is a fault of rdpi, please report it: " \
            f"{type(error).__name__}: {printable(str(error))}"
    row.seconds = round(time.monotonic() - begin, 3)
    return Outcome(row, documents)


def lost(task: Task, why: str) -> Outcome:
    """Results of a task whose worker was lost."""
    return Outcome(Row(task.actuator, model_path=task.model, tool=version(), started_at=now(), error=why), {})


def now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="seconds")


def _work(task: Task, report: str | None, row: Row, documents: Documents) -> None:
    pages = None if report is None else os.path.join(report, task.actuator)
    if task.runs["fit"]:
        document = _fit(task, pages)
        documents["fit"] = document.to_json()
        row.fit_rms_percent = _worst(document, held_out=False)
        row.held_out_rms_percent = _worst(document, held_out=True)
    row.model_sha256 = sha256_of(task.model_file)
    if task.runs["gap"]:
        found = _gap(task, pages)
        documents["gap"] = found.to_json()
        row.verdict, row.gap_percent = found.verdict, found.gap.percent_of_stroke
        row.effect = ", ".join(one.name for one in found.effects) or None
        row.shrink = found.promised.shrink


def _fit(task: Task, pages: str | None) -> FitDocument:
    fitted, held = ([read_recording(path) for path in task.runs[name]] for name in ("fit", "hold_out"))
    options = {name: value for name, value in task.options.items() if name != "without"}
    result = fit(fitted, Options(**{"actuator": task.actuator, **options}), held)
    document = result.document(task.model, False)
    make_folder(Path(task.model_file).parent)
    if pages is not None:
        summary.write_report(pages, result, [*fitted, *held], document)
    write_model(task.model_file, result.model)
    return document


def _worst(document: FitDocument, held_out: bool) -> float | None:
    return max((run.rms_percent for run in document.runs if run.held_out == held_out), default=None)


def _gap(task: Task, pages: str | None) -> GapDocument:
    model = read_model(task.model_file)
    runs, before = ([read_recording(path) for path in task.runs[name]] for name in ("gap", "earlier"))
    told: list[str] = []
    if not before:
        before, told = kept.earlier(model, runs)
    found = diagnose(model, runs, task.options.get("without", ()), earlier=before)
    document = replace(found.document, model=task.model, model_digest=model.digest(),
                       notes=[*told, *found.document.notes])
    if pages is not None:
        gap_report.write(document, gap_report.Pictures(found.runs, found.before_um, found.after_um, found.table,
                                                       found.spectrum_after), pages)
    return document
