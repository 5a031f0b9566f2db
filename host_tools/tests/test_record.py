"""`rdpi record` on a pseudo-terminal and a socket, and `rdpi import --telemetry`, as a user types them."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import pty
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import streams
from ports import A_MOMENT_S, Board
from streams import Info, samples, stream

from rdpi import firmware
from rdpi.board import Decoder, Following
from rdpi.board.serial import NO_INFO, REPORT_S, SAVE_S, Raw, Safe
from rdpi.data import read_recording, recording

SENT = samples(3000)
WITHOUT_A_FEW = [sample for sample in SENT if sample.sequence not in (1000, 1001, 1800)]


@pytest.fixture
def run_csv(tmp_path: Path) -> Path:
    return tmp_path / "run.csv"


def codes(path: Path) -> list[float]:
    return read_recording(path, ("command_V",)).columns["dac_code"].tolist()


# ---- record ----

def test_until_the_target_has_finished(board: Board, run_csv: Path, rdpi: Callable, tmp_path: Path) -> None:
    data = stream(SENT)
    board.later(lambda: board.send(data))
    done = rdpi("record", board.port, "-o", run_csv, "--raw", tmp_path / "raw", "--json", tmp_path / "json",
                "--actuator", "stack 3", "--note", "first try", "--memory", "carried")
    assert done.exit_code == 0, done.output
    assert f"{board.port}: 3000 samples, 0 lost on the way, 0 ticks lost by the target; 0 corrupt frames" in done.output
    assert "the target has finished" in done.output
    run = read_recording(run_csv)
    assert run.columns["dac_code"].tolist() == [sample.dac_code for sample in SENT]
    assert run.sample_rate_hz == 10_000
    assert run.metadata.items() >= {"actuator": "stack 3", "note": "first try", "memory": "carried",
                                    "first_tick": "1", "telemetry_lost": "0", "source": board.port}.items()
    assert (tmp_path / "raw").read_bytes() == data
    result = json.loads((tmp_path / "json").read_text())
    assert result["counts"]["samples"] == 3000 and result["stretches"] == [3000]
    assert result["target"]["state"] == streams.FINISHED and not result["gate_failed"]


@pytest.fixture
def terminal() -> Iterator[None]:
    """Signals as in a terminal, however the tests were started: CI has Ctrl-C ignored, nohup that it hangs up."""
    before = {number: signal.signal(number, handler) for number, handler in (
        (signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL))}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_ctrl_c_keeps_what_was_received(board: Board, run_csv: Path, rdpi: Callable, terminal: None) -> None:
    board.later(lambda: board.send(stream(SENT, finished=0)), lambda: time.sleep(A_MOMENT_S),
                lambda: os.kill(os.getpid(), signal.SIGINT))
    done = rdpi("record", board.port, "-o", run_csv)
    assert done.exit_code == 0 and "stopped" in done.output
    assert len(codes(run_csv)) == 3000
    with pytest.raises(KeyboardInterrupt):  # and is Ctrl-C again from now on
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_so_do_its_like(board: Board, run_csv: Path, rdpi: Callable, terminal: None,
                         number: int) -> None:
    board.later(lambda: board.send(stream(SENT, finished=0)), lambda: time.sleep(A_MOMENT_S),
                lambda: os.kill(os.getpid(), number))
    assert rdpi("record", board.port, "-o", run_csv).exit_code == 0
    assert len(codes(run_csv)) == 3000


def test_none_of_them_interrupts_the_writing(board: Board, run_csv: Path, rdpi: Callable, terminal: None,
                                             monkeypatch: pytest.MonkeyPatch) -> None:
    write = recording.atomic_write

    def interrupted(path: Path, data: str) -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if path == run_csv else ():
            os.kill(os.getpid(), number)
        write(path, data)

    monkeypatch.setattr(recording, "atomic_write", interrupted)
    board.later(lambda: board.send(stream(SENT)))
    assert rdpi("record", board.port, "-o", run_csv).exit_code == 0
    assert len(codes(run_csv)) == 3000


@pytest.mark.parametrize("ignored, ends", [("INT", True), ("HUP", False)])
def test_in_the_background_of_a_script(board: Board, run_csv: Path, ignored: str, ends: bool) -> None:
    """Ctrl-C, which shells have ignored there, ends it; what nohup has ignored does not."""
    command = ["sh", "-c", f"trap '' {ignored}; exec \"$@\"", "sh", sys.executable, "-m", "rdpi", "record", board.port,
               "-o", run_csv]
    board.renew()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        board.wait()
        board.send(stream(SENT, finished=0))
        time.sleep(A_MOMENT_S)
        process.send_signal(getattr(signal, f"SIG{ignored}"))
        if not ends:
            time.sleep(A_MOMENT_S)
            assert process.poll() is None
            process.terminate()
        assert process.wait(timeout=20) == 0
    assert len(codes(run_csv)) == 3000


def test_ctrl_c_before_anything_came(board: Board, rdpi: Callable, refused: Callable) -> None:
    def stop() -> None:
        for _ in range(2):
            board.wait()
            board.renew()
            os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=stop, daemon=True).start()
    assert refused("record", board.port, "-o", refused.output) == f"{board.port}: no samples: stopped"


def test_a_duration_of_the_targets_time(board: Board, run_csv: Path, rdpi: Callable) -> None:
    board.later(lambda: board.send(stream(SENT, finished=0)))
    done = rdpi("record", board.port, "-o", run_csv, "--duration", "0.1")
    assert done.exit_code == 0 and "0.1 s recorded" in done.output
    assert 1000 <= len(codes(run_csv)) <= 3000


def test_the_first_frame_is_waited_for_while_the_board_is_flashed(board: Board, run_csv: Path,
                                                                  rdpi: Callable) -> None:
    glitch = lambda: board.send(b"\xff")  # noqa: E731: of a line that comes up
    flashing = lambda: time.sleep(0.5)  # noqa: E731
    board.later(flashing, glitch, flashing, lambda: board.send(stream(SENT)))
    done = rdpi("record", board.port, "-o", run_csv, "--timeout", "0.2")
    assert done.exit_code == 0, done.output
    assert codes(run_csv) == [sample.dac_code for sample in SENT]


def test_silence_after_samples_saves_them(board: Board, run_csv: Path, rdpi: Callable) -> None:
    board.later(lambda: board.send(stream(SENT, finished=0)))
    done = rdpi("record", board.port, "-o", run_csv, "--timeout", "0.5")
    assert done.exit_code == 2
    assert done.output.endswith(f"rdpi: {board.port}: no data for 0.5 s; the samples before that have been written\n")
    assert len(codes(run_csv)) == 3000


@pytest.mark.parametrize("noise", [bytes(range(256)) * 4, b"\x55" * 1000], ids=["any", "no zero"])
def test_noise_is_not_silence(board: Board, refused: Callable, noise: bytes) -> None:
    stop = threading.Event()

    def chatter() -> None:
        while not stop.wait(0.05):
            board.send(noise)

    thread = threading.Thread(target=chatter)
    thread.start()
    try:
        message = refused("record", board.port, "-o", refused.output, "--timeout", "0.3")
    finally:
        stop.set()
        thread.join()
    assert message == f"{board.port}: no samples: no valid telemetry for 0.3 s; check the baud rate"


def test_a_port_that_vanishes_leaves_what_there_is(board: Board, run_csv: Path, rdpi: Callable) -> None:
    board.later(lambda: board.send(stream(SENT, finished=0)), lambda: time.sleep(A_MOMENT_S), board.unplug)
    done = rdpi("record", board.port, "-o", run_csv)
    assert done.exit_code == 2
    assert "the connection to the port was lost" in done.output and "have been written" in done.output
    assert len(codes(run_csv)) == 3000


def test_a_target_that_refuses(board: Board, rdpi: Callable, run_csv: Path) -> None:
    for info, words in ((Info(streams.REFUSED, -8), f"{firmware.status_text(-8)} (status -8)"),
                        (Info(streams.REFUSED, 0), "the board has no timer for 10000 samples per second"),
                        (Info(streams.RESET), "its watchdog has reset it; it now outputs its safe code")):
        board.later(lambda: board.send(info.frame()))
        done = rdpi("record", board.port, "-o", run_csv)
        assert (done.exit_code, done.output) == (2, f"rdpi: {board.port}: the target refuses to run: {words}\n")
        assert not run_csv.exists()


@pytest.mark.parametrize("last, why", [
    (Info(streams.REFUSED, -8).frame(), "the target refuses to run: "),
    (Info(streams.SAFE, counts=(0, 7, *(0,) * 7)).frame(),
     "the target refuses to run: it lost too many ticks in a row, 7 in total; it now outputs its safe code"),
    (Info(streams.RESET).frame(), "the target refuses to run: its watchdog has reset it; it now outputs its safe code"),
    (Info(um_per_count=1e306).frame() * 2, "the firmware reports um_per_count = 1e+306; check RDPI_UM_PER_COUNT"),
    (Info().frame(version=9) * 2, "telemetry of version 9: unknown to this version of rdpi"),
])
def test_what_came_before_the_target_went_wrong_is_kept(board: Board, run_csv: Path, rdpi: Callable, last: bytes,
                                                        why: str) -> None:
    board.later(lambda: board.send(stream(SENT, finished=0) + last))
    done = rdpi("record", board.port, "-o", run_csv, "--timeout", "0.5")
    assert done.exit_code == 2 and f"rdpi: {board.port}: {why}" in done.output
    assert done.output.endswith("; the samples before that have been written\n")
    assert len(codes(run_csv)) == 3000


def test_a_copy_that_cannot_be_written_does_not_cost_the_recording(board: Board, run_csv: Path,
                                                                   rdpi: Callable) -> None:
    board.later(lambda: board.send(stream(SENT)))
    done = rdpi("record", board.port, "-o", run_csv, "--raw", "/dev/full")
    assert done.exit_code == 2
    assert done.output.endswith("--raw /dev/full: No space left on device; it does not contain all bytes received\n")
    assert len(codes(run_csv)) == 3000


def test_all_that_went_wrong_is_told(board: Board, run_csv: Path, rdpi: Callable) -> None:
    board.later(lambda: board.send(stream(SENT[:15], finished=0) + Info(streams.REFUSED, -8).frame()))
    done = rdpi("record", board.port, "-o", run_csv, "--raw", "/dev/full")
    assert done.exit_code == 2 and done.output.count("the target refuses to run: ") == 1
    assert done.output.endswith("; --raw /dev/full: No space left on device; it does not contain all bytes received\n")
    assert not run_csv.exists()


@pytest.mark.parametrize("port", ["/nowhere/ttyACM0", None])
def test_an_earlier_capture_is_kept_until_the_first_byte(board: Board, run_csv: Path, rdpi: Callable, tmp_path: Path,
                                                         port: str | None) -> None:
    (tmp_path / "raw").write_bytes(b"earlier")
    if port is None:
        board.later(lambda: os.kill(os.getpid(), signal.SIGINT))
    assert rdpi("record", port or board.port, "-o", run_csv, "--raw", tmp_path / "raw").exit_code == 2
    assert (tmp_path / "raw").read_bytes() == b"earlier"


# ---- what is on disk while it goes on ----

def part(run_csv: Path, number: str = "") -> Path:
    return run_csv.with_name(f"run.csv.part{number}")


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
    assert (done.returncode, done.stderr) == (2, f"rdpi: {both}: another recording is being written to this file; "
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


@pytest.mark.parametrize("option", ["-o", "--raw", "--json"])
def test_the_port_is_no_file_to_write_to(board: Board, run_csv: Path, rdpi: Callable, option: str) -> None:
    done = rdpi("record", board.port, "-o", run_csv, option, board.port)
    assert (done.exit_code, done.output) == (2, f"rdpi: {board.port}: is the port; give a file name\n")


def test_a_folder_that_cannot_be_written_to(board: Board, run_csv: Path, rdpi: Callable,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: str(path) != str(run_csv.parent))
    done = rdpi("record", board.port, "-o", run_csv)
    assert (done.exit_code, done.output) == (
        2, f"rdpi: {run_csv}: you may not write to the directory {run_csv.parent}; check its permissions\n")


def test_a_port_in_use(board: Board, refused: Callable) -> None:
    with open(board.port, "rb", buffering=0) as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        assert refused("record", board.port, "-o", refused.output) == (
            f"{board.port}: is in use by another program; stop that program first")


@pytest.mark.parametrize("option", ["--timeout", "--duration", "--um-per-count", "--count-0-um"])
@pytest.mark.parametrize("number", ["nan", "inf", "1e306", "-1e9"])
def test_options_that_are_no_numbers(run_csv: Path, rdpi: Callable, option: str, number: str) -> None:
    done = rdpi("record", "/dev/null", "-o", run_csv, option, number)
    assert done.exit_code == 2 and f"'{number}': must be a number within" in done.output


def test_samples_but_no_info(board: Board, run_csv: Path, rdpi: Callable) -> None:
    stop, sent = threading.Event(), samples(3 * NO_INFO)

    def run() -> None:
        board.wait()
        for sample in sent:
            board.send(sample.frame())
            if stop.is_set():
                break

    board.renew()
    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    done = rdpi("record", board.port, "-o", run_csv, "--duration", "0.1")
    stop.set()
    assert done.exit_code == 2 and f"no info frame with rate and scale in the first {NO_INFO}" in done.output


@pytest.mark.parametrize("before, state", [(b"", streams.RUNNING), (b"", streams.STARTING),
                                           (stream(SENT, finished=0), streams.RUNNING)])
def test_infos_but_no_sample(board: Board, run_csv: Path, rdpi: Callable, before: bytes, state: int) -> None:
    stop = threading.Event()

    def chatter() -> None:
        board.wait()
        board.send(before)
        while not stop.wait(0.05):
            board.send(Info(state, offered=3000).frame())

    board.renew()
    thread = threading.Thread(target=chatter, daemon=True)
    thread.start()
    done = rdpi("record", board.port, "-o", run_csv, "--timeout", "0.5")
    stop.set()
    thread.join()
    assert done.exit_code == 2 and "no sample for 0.5 s, although the target reports that it is running" in done.output
    assert run_csv.exists() == bool(before)


def test_a_target_of_another_version(board: Board, rdpi: Callable, run_csv: Path) -> None:
    board.later(lambda: board.send(Info().frame(version=9) * 2))
    done = rdpi("record", board.port, "-o", run_csv)
    assert done.exit_code == 2 and "telemetry of version 9: unknown to this version of rdpi" in done.output


def test_a_target_that_had_finished_before(board: Board, run_csv: Path, rdpi: Callable) -> None:
    over = Info(streams.FINISHED, offered=3000).frame()
    board.later(lambda: board.send(over * 3), lambda: time.sleep(0.5), lambda: os.kill(os.getpid(), signal.SIGINT))
    done = rdpi("record", board.port, "-o", run_csv, "--timeout", "0.2")
    assert done.exit_code == 2 and "no samples: stopped; the target had finished before: reset it" in done.output
    board.later(lambda: board.send(over * 3), lambda: time.sleep(0.5), lambda: board.send(stream(SENT)))
    assert rdpi("record", board.port, "-o", run_csv, "--timeout", "0.2").exit_code == 0
    assert len(codes(run_csv)) == 3000


def test_reset_while_it_records(board: Board, run_csv: Path, rdpi: Callable) -> None:
    board.later(lambda: board.send(stream(SENT, finished=0)[5000:20_000]), lambda: board.send(stream(SENT)))
    done = rdpi("record", board.port, "-o", run_csv)
    assert done.exit_code == 0 and "note: the target was reset 1 times" in done.output
    assert codes(run_csv) == [sample.dac_code for sample in SENT]


def test_from_a_socket(run_csv: Path, rdpi: Callable) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        def serve() -> None:
            line, _ = server.accept()
            with line:
                time.sleep(A_MOMENT_S)  # pyserial drops what came with the connection
                line.sendall(stream(SENT, finished=0))

        threading.Thread(target=serve, daemon=True).start()
        done = rdpi("record", f"socket://127.0.0.1:{server.getsockname()[1]}", "-o", run_csv)
    assert done.exit_code == 2 and "the connection to the port was lost" in done.output
    assert len(codes(run_csv)) == 3000
    assert read_recording(run_csv).metadata["source"].startswith("socket://127.0.0.1:")


@pytest.mark.parametrize("port", ["/nowhere/ttyACM0", "nonsense://x", "/dev/null"])
def test_ports_that_are_none(port: str, refused: Callable) -> None:
    message = refused("record", port, "-o", refused.output)
    assert message.startswith(f"{port}: cannot be opened (") and "group dialout" in message


def test_a_terminal_shows_how_it_goes(board: Board, run_csv: Path) -> None:
    screen, its_end = pty.openpty()
    with subprocess.Popen([sys.executable, "-m", "rdpi", "record", board.port, "-o", run_csv], stderr=its_end,
                          stdout=subprocess.DEVNULL, env=os.environ | {"TERM": "xterm", "COLUMNS": "120"}) as process:
        os.close(its_end)
        shown = b""
        half = len(stream(SENT)) // 2
        while b"waiting for the first frame" not in shown:
            shown += os.read(screen, 4096)
        time.sleep(5 * REPORT_S)
        assert b"0 samples" not in os.read(screen, 1 << 16), "it still waits"
        board.send(Info(streams.FINISHED).frame())
        while b"waiting for a reset: the target had finished before" not in shown:
            shown += os.read(screen, 4096)
        board.send(stream(SENT)[:half])
        while b" samples, 0 lost, " not in shown or b" um; Ctrl-C stops" not in shown:
            shown += os.read(screen, 4096)
        board.send(stream(SENT)[half:])
        threading.Thread(target=lambda: [None for _ in iter(lambda: _read(screen), b"")], daemon=True).start()
        assert process.wait(timeout=20) == 0
    assert len(codes(run_csv)) == 3000


def _read(screen: int) -> bytes:
    try:
        return os.read(screen, 4096)
    except OSError:  # the other end is closed
        return b""


# ---- import --telemetry ----

@pytest.fixture
def captured(tmp_path: Path) -> Path:
    path = tmp_path / "captured.bin"
    path.write_bytes(stream(WITHOUT_A_FEW))
    return path


def test_the_longest_stretch_of_a_captured_stream(captured: Path, run_csv: Path, rdpi: Callable,
                                                  tmp_path: Path) -> None:
    done = rdpi("import", "--telemetry", captured, "-o", run_csv, "--json", tmp_path / "json")
    assert done.exit_code == 0, done.output
    assert "2997 samples, 3 lost on the way" in done.output
    assert codes(run_csv) == [sample.dac_code for sample in SENT[1801:]]
    assert read_recording(run_csv).metadata.items() >= {"source": "captured.bin", "telemetry_lost": "3"}.items()
    assert done.output.endswith("\nthe target had finished\n")
    assert "note: the longest stretch without a gap has 1199 of the 2997 samples received; --stretches writes all 3\n" \
        in done.output
    result = json.loads((tmp_path / "json").read_text())
    assert result["streams"][0]["counts"]["lost"] == 3 and result["streams"][0]["stretches"] == [1000, 798, 1199]
    assert [row["samples"] for row in result["recordings"]] == [1199]


def test_every_stretch_of_it(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    done = rdpi("import", "--telemetry", captured, "-o", run_csv, "--stretches")
    assert done.exit_code == 0 and not run_csv.exists() and "note: the longest" not in done.output
    parts = [codes(run_csv.with_stem(f"run-{k}")) for k in (1, 2, 3)]
    assert [len(part) for part in parts] == [1000, 798, 1199]
    assert sum(parts, []) == [sample.dac_code for sample in WITHOUT_A_FEW]


@pytest.mark.parametrize("most, status", [(3, 0), (2, 1)])
def test_the_gate(captured: Path, run_csv: Path, rdpi: Callable, most: int, status: int) -> None:
    done = rdpi("import", "--telemetry", captured, "-o", run_csv, "--max-lost", most)
    assert done.exit_code == status and run_csv.exists()
    assert ("3 samples are missing, more than the 2 allowed by --max-lost" in done.output) == (status == 1)


def test_several_streams_to_a_folder(captured: Path, rdpi: Callable, tmp_path: Path) -> None:
    other = tmp_path / "other.bin"
    other.write_bytes(stream(SENT[:500]))
    done = rdpi("import", "--telemetry", captured, other, "-o", f"{tmp_path}/runs/")
    assert done.exit_code == 0, done.output
    assert len(codes(tmp_path / "runs/captured.csv")) == 1199 and len(codes(tmp_path / "runs/other.csv")) == 500


def test_another_sensor(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    assert rdpi("import", "--telemetry", captured, "-o", run_csv, "--um-per-count", "-0.5", "--count-0-um",
                "7").exit_code == 0
    assert read_recording(run_csv).displacement_um.tolist() == [7 - 0.5 * s.adc_counts for s in SENT[1801:]]


@pytest.mark.parametrize("data, message", [
    (b"", "no telemetry frame in 0 bytes; nothing was sent"),
    (b"abc" * 100, "no telemetry frame in 300 bytes; check the baud rate"),
    (stream(SENT[:15]), "15 samples, 0 lost on the way, 0 ticks lost by the target; 0 corrupt frames: no 16 samples w"),
    (Info().frame(), "0 samples, 0 lost on the way, 0 ticks lost by the target; 0 corrupt frames: no 16 samples w"),
    (Info(streams.REFUSED, -8).frame(), f"the target refuses to run: {firmware.status_text(-8)} (status -8)"),
    (stream(SENT)[len(Info().frame()):20_000], "there are samples, but no info frame"),
])
def test_streams_without_a_recording(captured: Path, refused: Callable, data: bytes, message: str) -> None:
    captured.write_bytes(data)
    assert refused("import", "--telemetry", captured, "-o", refused.output).startswith(f"{captured}: {message}")


def test_a_bad_stream_among_good_ones_leaves_nothing(captured: Path, tmp_path: Path, rdpi: Callable) -> None:
    (tmp_path / "bad.bin").write_bytes(stream(SENT[:5]))
    assert rdpi("import", "--telemetry", captured, tmp_path / "bad.bin", "-o", f"{tmp_path}/runs/").exit_code == 2
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("words, message", [
    (["--telemetry", "--rate", "5"], "--rate: is only valid without --telemetry"),
    (["--telemetry", "--command", "1"], "--command: is only valid without --telemetry"),
    (["--stretches"], "--stretches: is only valid with --telemetry"),
    (["--um-per-count", "1"], "--um-per-count: is only valid with --telemetry"),
])
def test_options_of_the_other_kind(captured: Path, refused: Callable, words: list[str], message: str) -> None:
    assert refused("import", captured, "-o", refused.output, *words) == message


@pytest.mark.parametrize("name", ["run-1.csv", "run-12.csv"])
def test_stretches_are_not_written_over_what_is_read(captured: Path, rdpi: Callable, tmp_path: Path,
                                                     name: str) -> None:
    source = captured.rename(tmp_path / name)
    as_it_was = source.read_bytes()
    done = rdpi("import", "--telemetry", source, "-o", tmp_path / "run.csv", "--stretches")
    assert (done.exit_code, done.output) == (
        2, f"rdpi: {source}: would be written over an input; give another name or directory\n")
    link = tmp_path / "other-1.csv"
    link.symlink_to(source)
    done = rdpi("import", "--telemetry", source, "-o", tmp_path / "other.csv", "--stretches")
    assert done.exit_code == 2 and f"{link}: would be written over an input" in done.output
    assert source.read_bytes() == as_it_was


def test_nor_over_what_else_is_written(captured: Path, board: Board, rdpi: Callable, tmp_path: Path) -> None:
    for words in (["import", "--telemetry", captured, "-o", tmp_path / "run.csv", "--stretches", "--json"],
                  ["record", board.port, "-o", tmp_path / "run.csv", "--stretches", "--raw"]):
        done = rdpi(*words, tmp_path / "run-1.csv")
        assert done.exit_code == 2 and "run-1.csv: would be written over another output" in done.output
    (tmp_path / "runs").mkdir()
    done = rdpi("import", "--telemetry", captured, "-o", tmp_path / "runs", "--json", tmp_path / "runs/captured.csv")
    assert done.exit_code == 2 and "captured.csv: would be written over another output" in done.output
    assert not list((tmp_path / "runs").iterdir())


def test_the_raw_stream_is_not_written_over_the_recording(refused: Callable) -> None:
    message = refused("record", "/dev/null", "-o", refused.output, "--raw", refused.output)
    assert "another output" in message


def test_the_target_told_what_it_did_not_send(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    captured.write_bytes(stream(WITHOUT_A_FEW, Info(counts=(3, *[0] * 8))))
    done = rdpi("import", "--telemetry", captured, "-o", run_csv)
    assert "note: the target could not send 3 samples: its line is too slow" in done.output


@pytest.mark.parametrize("sent, note", [
    (stream(SENT), None),
    (stream(SENT, finished=0), "note: the stream ends before the target had finished"),
    (stream(SENT, finished=0) + Info(streams.REFUSED).frame(), "the target refuses to run: the board has no timer for"),
])
def test_how_a_stream_ended(captured: Path, run_csv: Path, rdpi: Callable, sent: bytes, note: str | None) -> None:
    captured.write_bytes(sent)
    done = rdpi("import", "--telemetry", captured, "-o", run_csv)
    assert done.exit_code == 0 and len(codes(run_csv)) == 3000
    assert ("the target had finished\n" in done.output) == (note is None or note.startswith("note"))
    assert note is None or f"\n{note}" in done.output


def test_why_the_memory_is_unknown(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    sent = [replace(sample, flags=streams.SWEEP, dac_code=0) if sample.sequence < 30 else
            replace(sample, dac_code=40_000) for sample in SENT]
    captured.write_bytes(stream(sent))
    done = rdpi("import", "--telemetry", captured, "-o", run_csv)
    assert "memory: unknown (the drive jumps at the end of the sweep)\n" in done.output
    done = rdpi("import", "--telemetry", captured, "-o", run_csv, "--memory", "carried")
    assert "memory: carried\n" in done.output


def test_samples_without_readings(captured: Path, run_csv: Path, rdpi: Callable) -> None:
    captured.write_bytes(stream([replace(sample, adc_counts=streams.NO_READING) for sample in SENT]))
    done = rdpi("import", "--telemetry", captured, "-o", run_csv)
    assert done.exit_code == 0 and "note: there is no displacement_um" in done.output
    assert read_recording(run_csv, ("command_V",)).displacement_um is None
