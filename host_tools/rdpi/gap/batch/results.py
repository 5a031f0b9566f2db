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
                tables = {name for name, in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
                columns = {row[1] for row in connection.execute("PRAGMA table_info(results)")}
                if tables and not columns >= {*NAMES}:
                    raise BadInput(f"{path}: is a database of something else; give another name")
                connection.executescript(TABLES)
            yield cls(path, connection)
        finally:
            connection.close()

    def rows(self) -> dict[str, Row]:
        """By actuator, in the order of their names."""
        with _explained(self.path):
            found = self._connection.execute(f"SELECT {', '.join(NAMES)} FROM results ORDER BY actuator").fetchall()
        return {values[0]: Row(*values) for values in found}

    def write(self, row: Row, documents: Mapping[str, Mapping[str, Any]]) -> None:
        """In place of what was known of the actuator, all in one step."""
        texts = [(row.actuator, kind, json.dumps(document, allow_nan=False)) for kind, document in documents.items()]
        with _explained(self.path), self._connection:
            self._connection.execute("DELETE FROM documents WHERE actuator = ?", (row.actuator,))
            self._connection.executemany("INSERT INTO documents VALUES (?, ?, ?)", texts)
            self._connection.execute(f"REPLACE INTO results ({', '.join(NAMES)}) "
                                     f"VALUES ({', '.join('?' * len(NAMES))})", astuple(row))


@contextmanager
def _explained(path: str) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise BadInput(f"{path}: {error}; check the file, its permissions and the disk. What was written to it is not "
                       "lost: the same command goes on from there") from None
