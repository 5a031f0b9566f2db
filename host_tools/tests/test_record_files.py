"""What `rdpi record` has on disk while it goes on, and after whatever happens to it."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import streams
from captures import SENT, codes, part
from ports import Board
from streams import Info, stream

from rdpi.board import Decoder, Following
from rdpi.board.serial import SAVE_S, Raw, Safe
from rdpi.data import read_recording, recording


@pytest.mark.parametrize("body", [b"\2", b"\7"])
def test_a_frame_of_a_damaged_kind_does_not_cost_the_recording(board: Board, run_csv: Path, rdpi: Callable,
                                                               body: bytes) -> None:
    board.later(lambda: board.send(stream(SENT[:1000], finished=0) + streams.frame(body) + stream([])))
    done = rdpi("record", board.port, "-o", run_csv)
    assert done.exit_code == 0 and "; 1 corrupt frames" in done.output
    assert len(codes(run_csv)) == 1000


def test_a_fault_of_the_decoder_does_not_cost_what_was_decoded(board: Board, run_csv: Path, rdpi: Callable,
                                                               monkeypatch: pytest.MonkeyPatch) -> None:
    feed = Decoder.feed

    def fail(decoder: Decoder, data: bytes) -> None:
        if decoder.counts.samples == 3000:
            raise IndexError("of any kind")
        feed(decoder, data)

    monkeypatch.setattr(Decoder, "feed", fail)
    board.later(lambda: board.send(stream(SENT, finished=0)))
    error = rdpi("record", board.port, "-o", run_csv).exception
    assert isinstance(error, IndexError) and error.__notes__ == [f"The samples received so far are in {part(run_csv)}."]
    assert len(codes(part(run_csv))) == 3000 and not run_csv.exists()


@pytest.mark.parametrize("kilobytes, kept", [(100, 1000), (1, 0)])
def test_a_full_disk(board: Board, run_csv: Path, kilobytes: int, kept: int) -> None:
    """Files may grow to so many KB: the recording ends, and says where its samples are."""
    limited = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({kilobytes << 10},) * 2); " \
              "from rdpi.cli import main; main()"

    def wait_for_the_first() -> None:
        while kept and not part(run_csv).exists():
            time.sleep(0.01)

    board.later(lambda: board.send(stream(SENT[:kept], finished=0)), wait_for_the_first,
                lambda: board.send(b"".join(sample.frame() for sample in SENT[kept:])))
    words = [sys.executable, "-B", "-c", limited, "record", board.port, "-o", run_csv]  # -B: no module cached by half
    process = subprocess.run(words, text=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, timeout=60)
    message = process.stderr
    assert process.returncode == 2 and not run_csv.exists()
    assert message.startswith(f"rdpi: {run_csv}: File too large; ") and message.count("\n") == 1
    assert part(run_csv).exists() == bool(kept) == message.endswith(f"; the samples are in {part(run_csv)}\n")
    if kept:
        assert part(run_csv).stat().st_size == kilobytes << 10
        sent = [sample.dac_code for sample in SENT]
        assert kept <= len(codes(part(run_csv))) and codes(part(run_csv)) == sent[:len(codes(part(run_csv)))]


def test_samples_that_cannot_be_saved_end_it(board: Board, run_csv: Path, rdpi: Callable,
                                             monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording.GrowingRecording, "append", lambda *_: _full("run.csv.part"))
    board.later(lambda: board.send(stream(SENT[:1000], finished=0)), lambda: time.sleep(4 * SAVE_S),
                lambda: board.send(b"".join(sample.frame() for sample in SENT[1000:])))
    done = rdpi("record", board.port, "-o", run_csv)
    assert done.exit_code == 2
    assert done.output.endswith("run.csv.part: No space left on device; the samples before that have been written\n")
    assert len(codes(run_csv)) >= 1000 and list(run_csv.parent.iterdir()) == [run_csv]


def _full(path: str) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)


@pytest.mark.parametrize("name", ["run.csv.part", "run.csv.part2"])
def test_what_a_recording_that_was_cut_off_has_left_is_not_written_over(board: Board, run_csv: Path, rdpi: Callable,
                                                                        name: str) -> None:
    left = run_csv.with_name(name)
    left.write_text("left")
    done = rdpi("record", board.port, "-o", run_csv)
    assert done.exit_code == 2 and done.output.startswith(f"rdpi: {left}: exists already: a recording was interrupted")
    assert left.read_text() == "left" and list(run_csv.parent.iterdir()) == [left]
    for option in ("--raw", "--json"):
        left.unlink(missing_ok=True)
        done = rdpi("record", board.port, "-o", run_csv, option, left)
        assert (done.exit_code, done.output) == (
            2, f"rdpi: {left}: is used for samples during the recording; give another name\n")


@pytest.mark.parametrize("name", ["run.csv", "raw"])
def test_two_recordings_to_one_file(board: Board, run_csv: Path, rdpi: Callable, tmp_path: Path, name: str) -> None:
    """The second is refused from the beginning, before there is a sample, until the first has ended or was killed."""
    first, both = Board(), tmp_path / name
    one = run_csv, tmp_path / "raw"
    other = [path if path == both else path.with_name("other") for path in one]
    first.renew()
    with subprocess.Popen([sys.executable, "-m", "rdpi", "record", first.port, "-o", one[0], "--raw", one[1]],
                          stdout=subprocess.DEVNULL) as process:
        first.wait()
        try:
            done = subprocess.run([sys.executable, "-m", "rdpi", "record", board.port, "-o", other[0], "--raw",
                                   other[1]], stderr=subprocess.PIPE, text=True, timeout=20)
        finally:
            process.kill()
    first.unplug()
    assert (done.returncode, done.stderr) == (2, f"rdpi: {both}: another rdpi is writing to this file; "
                                                 "stop it first, or give another name\n")
    board.later(lambda: board.send(stream(SENT)))
    assert rdpi("record", board.port, "-o", other[0], "--raw", other[1]).exit_code == 0
    assert len(codes(other[0])) == len(SENT) and not both.with_name(f".rdpi.{name}.lock").exists()


def test_what_came_beside_a_recording_since_it_began_is_not_written_over(run_csv: Path) -> None:
    decoder = Decoder("board")
    with Safe(run_csv, True, Following(decoder), {}, Raw(None)) as safe:
        part(run_csv).write_text("another's")
        decoder.feed(stream(SENT[:100]))
        safe.save()
    assert part(run_csv).read_text() == "another's" and len(codes(run_csv.with_name("run.csv.part2"))) == 100


def test_a_recording_to_a_device_has_no_files_beside_it(board: Board, rdpi: Callable) -> None:
    board.later(lambda: board.send(stream(SENT, finished=0)), lambda: time.sleep(4 * SAVE_S),
                lambda: board.send(stream([])))
    before = set(os.listdir("/dev"))
    assert rdpi("record", board.port, "-o", "/dev/null").exit_code == 0
    assert not [name for name in set(os.listdir("/dev")) - before if ".part" in name]


@pytest.mark.parametrize("every, kept", [(False, [300, 200]), (True, [100, 300, 50, 200])])
def test_the_longest_and_the_present_stretch_are_kept_or_all(run_csv: Path, every: bool, kept: list[int]) -> None:
    parts = [SENT[:100], SENT[101:401], SENT[402:452], SENT[453:653]]
    decoder = Decoder("board")
    with Safe(run_csv, every, Following(decoder), {"note": "first"}, Raw(None)) as safe:
        for sent in ([Info()], *parts):
            decoder.feed(b"".join(one.frame() for one in sent))
            safe.save()
    found = [read_recording(path) for path in sorted(run_csv.parent.iterdir())]
    assert [len(run) for run in found] == kept and {run.metadata["note"] for run in found} == {"first"}
    safe.remove()
    assert not list(run_csv.parent.iterdir())


def test_a_stretch_without_readings_is_not_kept_for_one_that_has_them(run_csv: Path) -> None:
    dead = [replace(sample, adc_counts=streams.NO_READING) for sample in SENT]
    decoder = Decoder("board")
    with Safe(run_csv, False, Following(decoder), {}, Raw(None)) as safe:
        for sent in ([Info()], dead[:300], SENT[301:331], SENT[332:352]):
            decoder.feed(b"".join(one.frame() for one in sent))
            safe.save()
    assert [len(read_recording(path)) for path in sorted(run_csv.parent.iterdir())] == [30, 20]


def test_a_fault_of_what_saves_does_not_cost_the_recording(board: Board, run_csv: Path, rdpi: Callable,
                                                           monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Following, "new", lambda one: [1 / 0] if one._decoder.counts.samples >= 1000 else [])
    board.later(lambda: board.send(stream(SENT, finished=0)))
    done = rdpi("record", board.port, "-o", run_csv)
    assert done.exit_code == 2
    assert done.output.endswith(".part: ZeroDivisionError: division by zero; the samples before that have been "
                                "written\n")
    assert len(codes(run_csv)) >= 1000


@pytest.mark.parametrize("option", ["--note", "--actuator"])
def test_texts_that_no_file_can_hold_are_refused_before_it_begins(captured: Path, refused: Callable,
                                                                  option: str) -> None:
    for words in (["record", "/dev/null"], ["import", "--telemetry", captured], ["import", captured]):
        assert refused(*words, "-o", refused.output, option, "a\udcff").startswith(f"{option} 'a\\udcff': is not UTF-8")


def test_a_stream_of_a_name_that_is_no_text(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    name = captured.rename(captured.with_name("a\udcff.bin"))
    assert rdpi("import", "--telemetry", name, "-o", run_csv).exit_code == 0
    assert read_recording(run_csv).metadata["source"] == "a\\udcff.bin"
