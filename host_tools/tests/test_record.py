"""`rdpi record` on a pseudo-terminal and a socket, as a user types it: when it ends, what it says and refuses."""

from __future__ import annotations

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
from pathlib import Path

import pytest
import streams
from captures import SENT, codes
from ports import A_MOMENT_S, Board
from streams import Info, samples, stream

from rdpi import firmware
from rdpi.board.serial import NO_INFO, REPORT_S
from rdpi.data import read_recording, recording


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
                        (Info(streams.REFUSED, counts=(*(0,) * 6, 1, 0, 0)), "its DAC did not take the first code"),
                        (Info(streams.RESET), "its watchdog has reset it; it now outputs its safe code")):
        board.later(lambda: board.send(info.frame()))
        done = rdpi("record", board.port, "-o", run_csv)
        assert (done.exit_code, done.output) == (2, f"rdpi: {board.port}: the target refuses to run: {words}\n")
        assert not run_csv.exists()


@pytest.mark.parametrize("last, why", [
    (Info(streams.REFUSED, -8).frame(), "the target refuses to run: "),
    (Info(streams.SAFE, counts=(0, 7, *(0,) * 7)).frame(),
     "the target refuses to run: it lost too many ticks in a row, 7 in total; it now outputs its safe code"),
    (Info(streams.SAFE, counts=(0, 7, *(0,) * 4, 10, 0, 0)).frame(),
     "the target refuses to run: too many ticks in a row brought no new code: it lost 7, and its DAC did not take 10, in "
     "total; it now outputs its safe code"),
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


# ---- ports that cannot be used, targets that do not send ----

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
    done = rdpi("record", board.port, "-o", run_csv, "--timeout", "2")
    stop.set()
    thread.join()
    assert done.exit_code == 2 and "no sample for 2 s, although the target reports that it is running" in done.output
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


@pytest.mark.parametrize("port", ["/nowhere/ttyACM0", "nonsense://x", "/dev/null", "loop://?logging=x"])
def test_ports_that_are_none(port: str, refused: Callable) -> None:
    message = refused("record", port, "-o", refused.output)
    assert message.startswith(f"{port}: cannot be opened (") and "group dialout" in message


@pytest.mark.parametrize("rate", [2**31, 10**20])
def test_a_rate_that_no_port_has(board: Board, refused: Callable, monkeypatch: pytest.MonkeyPatch, rate: int) -> None:
    real = os.path.realpath  # of a pseudo-terminal the rate is left alone
    monkeypatch.setattr(os.path, "realpath", lambda path, **options: real(path, **options).replace("/pts/", "/ttyS"))
    message = refused("record", board.port, "-o", refused.output, "--baud", rate)
    assert message.startswith(f"{board.port}: cannot be opened (") and "check the name and --baud" in message


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
