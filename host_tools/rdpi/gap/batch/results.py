"""RESULTS.sqlite: a row per actuator, written as each ends, and the whole documents of `rdpi fit` and `rdpi gap`."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple, dataclass, fields
from typing import Any

from ...errors import BadInput


@dataclass
class Row:
    """What is known of an actuator; None where it does not apply."""

    actuator: str
    status: str = "failed"  # or "done"
    error: str | None = None  # why it failed
    verdict: str | None = None  # of the diagnosis
    effect: str | None = None  # names of the accepted effects, separated by ", "
    shrink: float | None = None  # share of the gap that they promise to explain on new recordings
    gap_percent: float | None = None  # rms of the gap, % of stroke
    fit_rms_percent: float | None = None  # largest rms error of the fitted recordings, % of stroke
    held_out_rms_percent: float | None = None  # the same of those held out
    model_path: str | None = None  # as in the plan
    model_sha256: str | None = None
    inputs_sha256: str | None = None  # of the recordings, of a model that is not fitted, and of the options
    tool: str | None = None  # version of rdpi
    started_at: str | None = None  # UTC, ISO 8601
    seconds: float | None = None


NAMES = tuple(one.name for one in fields(Row))
TYPES = {"str": "TEXT", "float": "REAL"}  # of SQLite, by the first word of a field's type
DOCUMENTS = "actuator", "kind", "document"  # columns of the other table
LOCKED_S = 60  # that another program may hold the file while a row is to be written
TABLES = f"""
CREATE TABLE IF NOT EXISTS results ({", ".join(
    f"{one.name} {TYPES[str(one.type).split()[0]]}{' PRIMARY KEY' if one.name == 'actuator' else ''}"
    for one in fields(Row))});
CREATE TABLE IF NOT EXISTS documents (actuator TEXT, kind TEXT, document TEXT, PRIMARY KEY (actuator, kind));
"""


class Results:
    """The file, open. Methods raise BadInput for a file that cannot be read or written; what was written stays."""

    def __init__(self, path: str, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection

    @classmethod
    @contextmanager
    def open(cls, path: str) -> Iterator[Results]:
        """Open the file, which is made if it is not there. Raises BadInput for one that holds something else."""
        with _explained(path):
            connection = sqlite3.connect(path)
        try:
            with _explained(path):
                tables = {name for name, in connection.execute("SELECT name FROM sqlite_master")}
                results, documents = ({row[1] for row in connection.execute(f"PRAGMA table_info({table})")}
                                      for table in ("results", "documents"))
                if tables and not results >= {*NAMES} or documents and not documents >= {*DOCUMENTS}:
                    raise BadInput(f"{path}: is a database of something else; give another name")
                # Whether it can be written to is found out before the work.
                connection.executescript(f"{TABLES} BEGIN; DELETE FROM results WHERE 0; ROLLBACK; "
                                         f"PRAGMA busy_timeout = {1000 * LOCKED_S}")
            yield cls(path, connection)
        finally:
            connection.close()

    def rows(self) -> dict[str, Row]:
        """By actuator, in the order of their names. Raises BadInput for rows that rdpi has not written."""
        with _explained(self.path):
            found = self._connection.execute(f"SELECT {', '.join(NAMES)} FROM results ORDER BY actuator").fetchall()
        for values in found:
            for one, value in zip(fields(Row), values):
                needed = {"str": str, "float": (float, int)}[str(one.type).split()[0]]
                if not isinstance(value, needed) and not (value is None and str(one.type).endswith("None")):
                    raise BadInput(f"{self.path}: the row of {values[0]} has {one.name} {value!r}, which rdpi does not "
                                   "write; correct it, or delete the row")
        return {values[0]: Row(*values) for values in found}

    def write(self, row: Row, documents: Mapping[str, Mapping[str, Any]]) -> None:
        """In place of what was known of the actuator, all in one step."""
        texts = [(row.actuator, kind, json.dumps(document, allow_nan=False)) for kind, document in documents.items()]
        with _explained(self.path), self._connection:
            self._connection.execute("DELETE FROM documents WHERE actuator = ?", (row.actuator,))
            self._connection.executemany(f"INSERT INTO documents ({', '.join(DOCUMENTS)}) VALUES (?, ?, ?)", texts)
            self._connection.execute(f"REPLACE INTO results ({', '.join(NAMES)}) "
                                     f"VALUES ({', '.join('?' * len(NAMES))})", astuple(row))


@contextmanager
def _explained(path: str) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise BadInput(f"{path}: {error}; check the file, its permissions, the disk, and that no other program holds "
                       "it. What `rdpi batch` wrote to it is not lost: the same command goes on from there") from None
