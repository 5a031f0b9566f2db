"""A plan worked off: what is new, changed or failed is done, and each result is written as it comes."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence

from ...data import reserved
from .plan import Task, sha256_of
from .results import Results, Row
from .work import work
from .workers import on_cluster, on_this_machine

Ended = Callable[[Row, int, int], None]


def run(tasks: Sequence[Task], path: str, jobs: int | None = None, scheduler: str | None = None,
        everything: bool = False, report: str | None = None, ended: Ended = lambda row, done, of: None,
        words: Callable[[str], str] = str) -> list[Row]:
    """Rows of all tasks, in their order; those done now are written to the results at `path` as each ends.

    `ended` is called with each such row, how many are done and how many there are to do; `words` puts what went wrong
    into the words of the plan. Raises BadInput for results that cannot be written, that another rdpi is writing, and for
    a scheduler that is not there.
    """
    with reserved(path), Results.open(path) as results:
        known = results.rows()
        todo = [task for task in tasks if everything or not _is_done(task, known.get(task.actuator))]
        doing = functools.partial(work, report=None if report is None else os.path.abspath(report))
        outcomes = on_this_machine(todo, doing, min(jobs or os.cpu_count() or 1, len(todo))) if scheduler is None else \
            on_cluster(todo, doing, scheduler)
        for done, (row, documents) in enumerate(outcomes if todo else (), 1):
            row.error = None if row.error is None else words(row.error)
            results.write(row, documents)
            ended(row, done, len(todo))
        rows = results.rows()
    return [rows[task.actuator] for task in tasks]


def _is_done(task: Task, row: Row | None) -> bool:
    """Whether the results are those of the same files and options, and the model is still the one that was made."""
    if row is None or row.status != "done" or task.refused:
        return False
    try:
        return task.digest() == row.inputs_sha256 and sha256_of(task.model_file) == row.model_sha256
    except OSError:
        return False
