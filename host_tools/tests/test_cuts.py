"""Cut at any moment, by SIGKILL or by the power: what was on disk before is there, whole, or what is new is.

`pytest --hypothesis-profile long` kills `record` 200 times and each of the others 100 times.
"""

from __future__ import annotations

import errno
import os
import random
import shutil
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
import streams
from ports import Board
from disks import Disk
from injected import LATER, commissioned, drives, plain_model, recorded
from streams import samples

from rdpi.board import Decoder
from rdpi.cli import main
from rdpi.data import Recording, atomic_write, make_folder, read_recording, write_recording
from rdpi.identify import identify
from rdpi.gap import diagnosis as gap
from rdpi.model import write_model
from rdpi.simulate.effects import CATALOGUE

KILLS, LONG_KILLS = 5, 100  # of each command, twice as many of record
LATE_S = 1.0  # what was sent earlier than this before a cut is on disk


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two models, model.json and other.json, and two recordings."""
    folder = tmp_path_factory.mktemp("files")
    for name, actuator in (("model", "stack 7"), ("other", "stack 8")):
        write_model(folder / f"{name}.json", replace(commissioned(), actuator=actuator))
    for k, run in enumerate(recorded(plain_model(), drives(LATER[-2:]))):
        write_recording(folder / f"run{k}.csv", {**run.columns, "reference_um": run.displacement_um}, run.metadata)
    return folder


@pytest.fixture(scope="module")
def results(files: Path) -> tuple[identify.Result, gap.Diagnosis]:
    """Of a fit and of a diagnosis, for those that want to see only how they are written."""
    runs = [read_recording(files / f"run{k}.csv") for k in (0, 1)]
    fitted = identify.fit(runs, identify.Options(rate_independent=True))
    return fitted, gap.diagnose(commissioned(), runs, tuple(name for name in CATALOGUE if name != "delay"))


@pytest.fixture
def quick(results: tuple[identify.Result, gap.Diagnosis], monkeypatch: pytest.MonkeyPatch) -> None:
    """fit and gap know their results; all that they read and write is as ever."""
    fitted, found = results

    def fit(runs: list[Recording], options: identify.Options, *_: object) -> identify.Result:
        return replace(fitted, model=replace(fitted.model, actuator=options.actuator or "stack 7"))

    monkeypatch.setattr(identify, "fit", fit)
    monkeypatch.setattr(gap, "diagnose", lambda model, *_: replace(found, improved=model))


# ---- the power fails ----

WRITERS = [
    "fit run0.csv run1.csv -o out/new.json --report out/report --json out/fit.json",
    "gap model.json run0.csv run1.csv -o out/new.json --report out/deep/report --json out/gap.json",
    "header model.json -o out/rdpi_params.h --json out/header.json",
    "simulate model.json run0.csv -o out/simulated.csv",
    "compensate model.json run0.csv -o out/drive.csv",
    "import run0.csv run1.csv -o out/new/runs/",
    "import --telemetry captured.bin -o out/runs/run.csv --stretches",
    "profile run0.csv -o out/profile.h",
    "excite sine -o out/drive.csv --sample-rate 1000",
    "plot model.json run0.csv -o out/picture.png",
]


@pytest.mark.parametrize("line", [
    pytest.param(line, id=f"{line.split()[0]}{k}", marks=pytest.mark.long if k == 0 else pytest.mark.slow)
    for k, line in enumerate(WRITERS)])
def test_a_power_failure_leaves_the_old_file_or_the_new(line: str, folder: Path, quick: None,
                                                        rdpi: Callable) -> None:
    Path("captured.bin").write_bytes(streams.stream([one for one in samples(200) if one.sequence != 90]))
    out = folder / "out"
    (out / "runs" if "telemetry" in line else out).mkdir(parents=True)
    before: dict[str, bytes] = {}
    for _ in range(2):  # where there is nothing, and where there are such files
        with Disk(out) as disk:
            done = rdpi(*line.split())
        assert done.exit_code == 0, done.output
        after = {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}
        assert disk.sure() == after, "when the command has ended all of it is on disk"
        for moment, held in disk.cuts():
            for name in after:
                assert held.get(name) in (before.get(name), after[name]), (moment.call, name)
            assert all(name.split("/")[-1].startswith(".rdpi.") for name in held.keys() - after.keys())
        before = dict.fromkeys(after, b"as it was")
        for name in before:
            (out / name).write_bytes(before[name])


def test_folders_above_a_new_one_are_synced_too(tmp_path: Path) -> None:
    with Disk(tmp_path) as disk:
        make_folder(tmp_path / "a/b/c")
        make_folder(tmp_path / "a/b/c")
        atomic_write(tmp_path / "a/b/c/x", "new")
    assert disk.sure() == {"a/b/c/x": b"new"}


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES])
def test_a_file_system_that_syncs_no_folders_is_none_the_worse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                               number: int) -> None:
    sync = os.fsync

    def refuse(handle: int) -> None:
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(number, os.strerror(number))
        sync(handle)

    monkeypatch.setattr(os, "fsync", refuse)
    atomic_write(tmp_path / "x", "new")
    assert (tmp_path / "x").read_text() == "new"


def test_a_folder_that_may_not_be_read_can_be_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = os.open

    def refuse(path: str | Path, flags: int, *rest: int) -> int:
        if os.path.isdir(path):
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened(path, flags, *rest)

    monkeypatch.setattr(os, "open", refuse)
    atomic_write(tmp_path / "x", "new")
    assert (tmp_path / "x").read_text() == "new"


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC, errno.EDQUOT])
def test_what_cannot_be_brought_to_disk_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                            number: int) -> None:
    """Some file systems tell only then that there is no room."""
    (tmp_path / "x").write_text("old")

    def fail(handle: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError) as error:
        atomic_write(tmp_path / "x", "new")
    assert error.value.filename == str(tmp_path / "x")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]


# ---- the process is killed ----

@pytest.mark.parametrize("one, other", [
    ("fit run0.csv -o out --actuator one", "fit run0.csv -o out --actuator other"),
    ("gap model.json run0.csv -o out", "gap other.json run0.csv -o out"),
    ("header model.json -o out", "header other.json -o out"),
])
def test_a_kill_leaves_the_old_file_or_the_new(one: str, other: str, folder: Path, quick: None, rdpi: Callable,
                                               long: bool) -> None:
    written = []
    for line in (one, other):
        assert rdpi(*line.split()).exit_code == 0
        written.append(Path("out").read_bytes())
    assert written[0] != written[1]
    seen = set()
    for _ in range(LONG_KILLS if long else KILLS):
        child = os.fork()
        if child == 0:
            _write_for_ever(one.split(), other.split())
        time.sleep(random.uniform(0.01, 0.2))
        os.kill(child, signal.SIGKILL)
        assert os.waitpid(child, 0)[1] == signal.SIGKILL, "it was at work"
        seen.add(Path("out").read_bytes())
        for left in folder.glob(".rdpi.*.part"):
            left.unlink()
    assert seen <= set(written)


def _write_for_ever(*lines: list[str]) -> None:
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    with suppress(BaseException):
        while True:
            for line in lines:
                main(line, standalone_mode=False)
    os._exit(1)


# ---- record ----

class Sender(threading.Thread):
    """Sends samples to a board's port as time goes by, and knows when."""

    SENT = [one for one in samples(6000, 3) if one.sequence not in (1500, 1501)]
    AT_ONCE, EVERY_S = 100, 0.05

    def __init__(self, board: Board, finishes: bool) -> None:
        super().__init__(daemon=True)
        self.board, self.finishes = board, finishes
        self.log: list[tuple[float, int]] = []  # when, and how many by then
        self.over = threading.Event()

    def run(self) -> None:
        with suppress(OSError):  # the port is closed
            self.board.wait()
            self.board.send(streams.Info(streams.STARTING).frame() + streams.Info().frame())
            for first in range(0, len(self.SENT), self.AT_ONCE):
                if self.over.wait(self.EVERY_S):
                    return
                self.board.send(b"".join(one.frame() for one in self.SENT[first:first + self.AT_ONCE]))
                self.log.append((time.monotonic(), first + self.AT_ONCE))
                if self.finishes and first >= 2400:
                    break
            self.board.send(streams.Info(streams.FINISHED, offered=6000).frame())

    def sent_by(self, time_s: float) -> int:
        """How many samples, of which the last is not confirmed by the next."""
        return max((count - 1 for when, count in self.log if when <= time_s), default=0)

    def check(self, folder: Path, before_s: float, earlier: bytes | None) -> None:
        """What this folder holds is read, and holds all that was sent before this time."""
        found: dict[int, float] = {}
        for path in folder.iterdir():
            if path.name.startswith(".rdpi.") or path.name == "run.csv" and path.read_bytes() == earlier:
                continue
            assert path.name in ("run.csv", "run.csv.part", "run.csv.part2")
            run = read_recording(path)
            first = int(run.metadata["first_tick"])
            assert run.time_s.tolist() == [round(k / 10_000, 9) for k in range(len(run))]
            found |= dict(zip(range(first, first + len(run)), run.columns["dac_code"].tolist()))
            if path.name == "run.csv":  # the longest stretch is all that is wanted
                assert len(run) == max(1500, len(self.SENT[:self.log[-1][1]]) - 1500)
                return
        wanted = self.SENT[:self.sent_by(before_s)]
        lacks = [one.tick for one in wanted if found.get(one.tick) != one.dac_code]
        begun = [one.tick for one in wanted if one.tick > 1502]
        assert lacks == (begun if 0 < len(begun) < 16 else []), f"{len(lacks)} of {len(wanted)}"


@pytest.mark.slow
@pytest.mark.parametrize("earlier", [None, b"as it was"], ids=["new", "existing"])
def test_a_power_failure_leaves_what_is_older_than_a_second(board: Board, earlier: bytes | None, tmp_path: Path,
                                                            rdpi: Callable) -> None:
    folder, scratch = tmp_path / "runs", tmp_path / "scratch"
    folder.mkdir()
    if earlier is not None:
        (folder / "run.csv").write_bytes(earlier)
    sender = Sender(board, finishes=True)
    board.renew()
    sender.start()
    with Disk(folder) as disk:
        done = rdpi("record", board.port, "-o", folder / "run.csv")
    assert done.exit_code == 0, done.output
    assert disk.sure() == {"run.csv": (folder / "run.csv").read_bytes()}
    until = {id(one): following.time_s for one, following in zip(disk.moments, disk.moments[1:])}
    for moment, held in disk.cuts():
        scratch.mkdir()
        for name, data in held.items():
            (scratch / name).write_bytes(data)
        sender.check(scratch, until.get(id(moment), 0.0) - LATE_S, earlier)
        shutil.rmtree(scratch)


@pytest.mark.slow
def test_a_kill_leaves_what_is_older_than_a_second(tmp_path: Path, long: bool) -> None:
    def cut(number: int) -> None:
        board, folder, raw = Board(), tmp_path / str(number), tmp_path / f"{number}.bin"
        earlier = b"as it was" if number % 2 else None
        folder.mkdir()
        if earlier is not None:
            (folder / "run.csv").write_bytes(earlier)
        board.renew()
        sender = Sender(board, finishes=number % 4 > 1)
        with subprocess.Popen([sys.executable, "-m", "rdpi", "record", board.port, "-o", folder / "run.csv", "--raw",
                               raw], stdout=subprocess.DEVNULL) as process:
            sender.start()
            while not sender.log and process.poll() is None:
                time.sleep(0.01)
            time.sleep(random.uniform(0, 2.5))
            process.kill()
            cut_s = time.monotonic()
        sender.over.set()
        sender.join()
        sender.check(folder, cut_s - LATE_S, earlier)
        copied = Decoder("raw")
        copied.feed(raw.read_bytes() if raw.exists() else b"")
        assert copied.counts.samples >= sender.sent_by(cut_s - LATE_S)
        board.unplug()

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(cut, range(2 * (LONG_KILLS if long else KILLS))))
