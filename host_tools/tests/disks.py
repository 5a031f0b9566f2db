"""A disk that may lose its power: what a folder can hold afterwards, at every moment of a command that runs here."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

PARTS = 8  # of what has been written since the last sync: none, all, and some between


@dataclass
class Moment:
    """Just before or after a call that changes what is on disk. Files and folders go by their inode."""

    time_s: float
    call: str
    synced_names: dict[int, dict[str, int]]  # what every folder held when it was synced last
    names: dict[int, dict[str, int]]  # and what it holds
    synced: dict[int, bytes]  # what every file held when it was synced last
    written: dict[int, bytes]

    def holds(self, root: int, renamed: bool, part: float) -> dict[str, bytes]:
        """Files by path, when the power fails now: with or without renames that are not synced, with so much of what
        has been written and is not synced."""
        return dict(self._files(root, "", self.names if renamed else self.synced_names, part))

    def _files(self, folder: int, path: str, names: dict[int, dict[str, int]], part: float
               ) -> Iterator[tuple[str, bytes]]:
        for name, inode in names.get(folder, {}).items():
            if inode in self.names:
                yield from self._files(inode, f"{path}{name}/", names, part)
            else:
                synced, written = self.synced.get(inode, b""), self.written[inode]
                sure = len(synced) if written.startswith(synced) else 0  # else it has been overwritten: anything
                yield f"{path}{name}", written[:sure + round(part * (len(written) - sure))]


class Disk:
    """Watches a folder, and all that is in it, from a state in which everything is synced."""

    CALLS = ("fsync", "replace", "rename", "link", "unlink", "remove", "mkdir", "truncate", "ftruncate")

    def __init__(self, folder: Path) -> None:
        self.folder, self.root = folder, folder.stat().st_ino
        self.moments: list[Moment] = []
        self._handles: dict[int, int] = {}  # open, so that no inode is used again
        self._names: dict[int, dict[str, int]] = {}
        self._patch = pytest.MonkeyPatch()

    def __enter__(self) -> Disk:
        self._look()
        self._synced_names, self._synced = dict(self._names), self._written()
        self._note("start")
        for call in self.CALLS:
            self._patch.setattr(os, call, self._noted(call, getattr(os, call)))
        return self

    def __exit__(self, *_: object) -> None:
        self._patch.undo()
        self._note("end")
        for handle in self._handles.values():
            os.close(handle)

    def cuts(self) -> Iterator[tuple[Moment, dict[str, bytes]]]:
        """All that the folder may have held after a cut, and when."""
        for moment in self.moments:
            for renamed in (False, True):
                for part in range(PARTS):
                    yield moment, moment.holds(self.root, renamed, part / (PARTS - 1))

    def sure(self) -> dict[str, bytes]:
        """What it holds for certain in the end."""
        return self.moments[-1].holds(self.root, False, 0)

    def _noted(self, call: str, work: Callable) -> Callable:
        def noted(target: object, *arguments: object, **options: object) -> object:
            self._note(f"before {call}")
            result = work(target, *arguments, **options)
            self._look()
            if call == "fsync":
                inode = os.fstat(target).st_ino
                if inode in self._names:
                    self._synced_names[inode] = self._names[inode]
                elif inode in self._handles:
                    self._synced[inode] = self._content(inode)
            self._note(f"after {call}")
            return result

        return noted

    def _note(self, call: str) -> None:
        self._look()
        self.moments.append(Moment(time.monotonic(), call, dict(self._synced_names), self._names, dict(self._synced),
                                   self._written()))

    def _look(self) -> None:
        self._names = {}
        for folder, _, _ in os.walk(self.folder):
            entries = list(os.scandir(folder))
            self._names[os.stat(folder).st_ino] = {entry.name: entry.inode() for entry in entries}
            for entry in entries:
                if entry.is_file() and entry.inode() not in self._handles:
                    self._handles[entry.inode()] = os.open(entry.path, os.O_RDONLY)

    def _written(self) -> dict[int, bytes]:
        return {inode: self._content(inode) for inode in self._handles}

    def _content(self, inode: int) -> bytes:
        return os.pread(self._handles[inode], os.fstat(self._handles[inode]).st_size, 0)
