"""examples/track as firmware on the emulated boards: no tick lost, no sample missing, the codes of the host's library.

An instruction takes 2 ns of emulated time (shift=1), less than on these boards, so that single precision in software
has time at 20 kHz on a Cortex-M0 too: what is tested is what the firmware does. What it costs, tests/benchmark counts.
"""

from __future__ import annotations

import math
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rdpi import emulator, telemetry
from rdpi.firmware import engine
from rdpi.header import write_header
from rdpi.model import Model, read_model
from rdpi.profile import render_reference
from rdpi.recording import read_recording, sample_times, write_recording

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/bench"))

from bench import paper_profile  # noqa: E402

SHIFT = 1
CORE_HZ = {board: 16_000_000 if board == "qemu-m0" else 25_000_000 for board in emulator.MACHINES}  # rdpi_port_cycles
QUICK = ("qemu-m0", "q31", "10hz", 10_000), ("qemu-m4f", "f32", "5-20-35hz", 10_000)
CASES = [pytest.param(*case, marks=[] if case in QUICK else pytest.mark.slow)
         for case in ((board, number, *profile) for board in emulator.MACHINES for number in ("f32", "q31")
                      for profile in (("10hz", 10_000), ("5-20-35hz", 10_000), ("5-20-35hz", 20_000)))]
SLOW_REFERENCE = """
#include "rdpi_port.h"
#include "rdpi_reference.h"

bool rdpi_reference_um(uint32_t ticks, float *reference_um)
{
    static uint32_t calls;
    const uint32_t every = %d, half_period = %d, last = %d;
    (void)ticks;
    if (++calls > last) {
        return false;
    }
    if (calls %% every == 0) {
        uint32_t began = rdpi_port_cycles();
        while (rdpi_port_cycles() - began < (2 * calls / every + 1) * half_period) {
        }
    }
    *reference_um = (float)(calls %% 50) * 0.1f;
    return true;
}
"""
FAULTY_REFERENCE = """
#include "rdpi_reference.h"

bool rdpi_reference_um(uint32_t ticks, float *reference_um)
{
    static uint32_t calls;
    (void)ticks;
    if (++calls == %d) {
        __asm__ volatile("udf #0");
    }
    *reference_um = 1.0f;
    return true;
}
"""
REQUEST, ANSWER = struct.Struct("<II"), struct.Struct("<Ii")

Build = Callable[..., Path]


@pytest.fixture(scope="module")
def model() -> Model:
    return read_model(ROOT / "examples/track/params/model.json")


@pytest.fixture(scope="module")
def build(model: Model, tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Configure and build track for a board, a reference in um and a number of samples per second; returns the image.

    One build folder per board: the next image takes the place of the one before.
    """
    folders: dict[str, Path] = {}

    def run(board: str, reference_um: np.ndarray, rate_hz: int, number: str, *options: str) -> Path:
        folder = folders.setdefault(board, tmp_path_factory.mktemp(board))
        columns = {"time_s": sample_times(len(reference_um), rate_hz), "reference_um": reference_um}
        write_recording(folder / "reference.csv", columns, {"sample_rate_hz": rate_hz})
        write_header(model, folder / "rdpi_params.h")
        reference = read_recording(folder / "reference.csv", required=("time_s", "reference_um"))
        (folder / "rdpi_profile.h").write_text(render_reference(reference))
        window = max(16, math.ceil(model.rate.window_s * rate_hz))
        for command in (["cmake", "--fresh", "-S", ROOT, "-B", folder / "build", "--preset", board,
                         f"-DRDPI_PARAMS_DIR={folder}", f"-DRDPI_PROFILE_DIR={folder}",
                         f"-DRDPI_TRACK_RATE_HZ={rate_hz}",
                         f"-DRDPI_TRACK_Q31={number == 'q31'}", f"-DRDPI_MAX_WINDOW={window}", *options],
                        ["cmake", "--build", folder / "build", "--target", "track"]):
            done = subprocess.run(command, capture_output=True, text=True)
            assert done.returncode == 0, done.stdout + done.stderr
            assert "warning" not in done.stdout + done.stderr
        return folder / "build" / "track"

    return run


def run(image: Path, board: str, silent_s: float = 30) -> telemetry.Decoder:
    """Run an image until it says that it has finished, or refuses to run; its telemetry up to there."""
    decoder, stream = telemetry.Decoder(board), image.with_name("telemetry")
    stream.write_bytes(b"")
    # a file takes every byte at once; sleep=off: emulated time does not wait for the host's
    with (emulator.emulate(image, board, "-serial", f"file:{stream}", "-icount", f"shift={SHIFT},sleep=off") as process,
          open(stream, "rb") as file):
        heard = time.monotonic()
        while decoder.info is None or decoder.info.state not in (telemetry.FINISHED, telemetry.REFUSED):
            assert process.poll() is None, "the emulator stopped"
            assert time.monotonic() - heard < silent_s, f"nothing for {silent_s:g} s: {decoder.counts}"
            time.sleep(0.02)
            if data := file.read():
                decoder.feed(data)
                decoder.check()
                heard = time.monotonic()
    decoder.finish()
    return decoder


@pytest.mark.parametrize("board, number, profile, rate_hz", CASES)
def test_every_sample_is_the_hosts(build: Build, model: Model, board: str, number: str, profile: str,
                                   rate_hz: int) -> None:
    reference_um = paper_profile(profile, rate_hz, 2.0)
    decoder = run(build(board, reference_um, rate_hz, number), board)
    samples, info = decoder.runs[0].samples, decoder.info

    host = engine(model, 1 / rate_hz, number)
    swept = host.sweep()[1]
    codes = np.concatenate([swept, host.step(reference_um).dac_code])
    assert (info.status, info.rate_hz, info.overruns, info.refused_count, info.held_count) == (0, rate_hz, 0, 0, 0)
    assert (decoder.counts.samples, decoder.counts.missing, decoder.counts.corrupt) == (len(codes), 0, 0)
    assert (samples["tick"] == np.arange(len(codes)) + 1).all()
    assert ((samples["flags"] & telemetry.SWEEP != 0) == (np.arange(len(codes)) < len(swept))).all()
    given = host.references(reference_um) if number == "q31" else reference_um.astype(np.float32)
    assert (samples["reference"][len(swept):] == given.view(np.uint32)).all()
    assert (samples["adc_counts"] == telemetry.NO_READING).all()
    assert {key: getattr(info, f"{key}_count") for key in host.counts} == host.counts
    assert np.ptp(codes[len(swept):].astype(int)) > 2**14  # not a drive that stands still
    difference = np.abs(samples["dac_code"].astype(int) - codes.astype(int))
    assert difference.max() <= (0 if number == "q31" else 1)


@pytest.mark.parametrize("board", CORE_HZ)
def test_lost_ticks_are_counted_and_told_to_the_library(build: Build, model: Model, board: str,
                                                        tmp_path: Path) -> None:
    """A reference for which the tick takes 1.5, 2.5, ... 7.5 periods, every twentieth time."""
    rate_hz, every, waits = 10_000, 20, 7
    source = tmp_path / "slow.c"
    source.write_text(SLOW_REFERENCE % (every, CORE_HZ[board] // rate_hz // 2, every * (waits + 1) - 1))
    image = build(board, np.zeros(16), rate_hz, "f32", "-DRDPI_TRACK_SWEEP=OFF", f"-DRDPI_REFERENCE={source}")
    decoder = run(image, board)
    samples, info = decoder.runs[0].samples, decoder.info

    calls = np.arange(1, every * (waits + 1))
    lost = np.where(calls % every == 1, calls // every, 0)  # before this call
    host = engine(model, 1 / rate_hz, "f32")
    codes = []
    for reference_um, ticks in zip(calls.astype(np.float32) % 50 * np.float32(0.1), lost.tolist()):
        if ticks:
            host.missed(ticks)
        codes.append(host.step(np.array([reference_um])).dac_code[0])
    assert (samples["tick"] == calls + np.cumsum(lost)).all()
    assert info.overruns == info.missed_count == decoder.counts.ticks_lost == lost.sum()
    assert decoder.counts.lost == decoder.counts.corrupt == 0
    assert np.abs(samples["dac_code"].astype(int) - np.array(codes, int)).max() <= 1


@pytest.mark.parametrize("board", ["qemu-m0", "qemu-m4f"])
def test_fault_stops_everything(build: Build, board: str, tmp_path: Path) -> None:
    """An undefined instruction in a tick: none follows, and what was queued before is out."""
    source, calls = tmp_path / "faulty.c", 100
    source.write_text(FAULTY_REFERENCE % calls)
    image = build(board, np.zeros(16), 10_000, "f32", "-DRDPI_TRACK_SWEEP=OFF", f"-DRDPI_REFERENCE={source}")
    with pytest.raises(AssertionError, match=f"nothing for 5 s: .*samples={calls - 2},"):  # each is sent one tick later
        run(image, board, silent_s=5)


@pytest.mark.parametrize("board", ["qemu-m0", "qemu-m4f"])
def test_refuses_a_rate_that_the_timer_misses(build: Build, board: str) -> None:
    """99 kHz is 0.2 % away from what 25 MHz or 16 MHz divide into."""
    decoder = run(build(board, np.zeros(16), 99_000, "f32"), board)
    assert (decoder.info.state, decoder.info.status) == (telemetry.REFUSED, 0)
    assert decoder.counts.samples == 0


def test_bench_link_is_in_lockstep(build: Build, tmp_path: Path) -> None:
    """One exchange per tick, for which the timers stand; the answer is the next tick's reading; a wrong one holds."""
    board, ticks = "qemu-m4f", 500
    image = build(board, paper_profile("10hz", 10_000, 0.1), 10_000, "f32", "-DRDPI_BENCH=ON", "-DRDPI_TRACK_SWEEP=OFF")
    stream, log = tmp_path / "telemetry", []
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "bench"))
        server.listen(1)
        with emulator.emulate(image, board, "-serial", f"file:{stream}",
                              "-chardev", f"socket,id=bench,path={tmp_path / 'bench'}", "-serial", "chardev:bench",
                              "-icount", f"shift={SHIFT}"):
            server.settimeout(30)
            line = server.accept()[0]
            line.settimeout(30)
            with line, line.makefile("rb") as requests:
                for k in range(ticks):
                    tick, code = REQUEST.unpack(requests.read(REQUEST.size))
                    log.append((tick, code, (k * 7919 + code) % 65536 - 32768))
                    if k == 10:
                        time.sleep(0.5)  # thousands of periods, were the timers running
                    line.sendall(ANSWER.pack(tick + (k == ticks - 1), log[-1][2]))
                line.settimeout(1.0)
                with pytest.raises(TimeoutError):
                    requests.read(1)
    decoder = telemetry.Decoder(board)
    decoder.feed(stream.read_bytes())
    decoder.finish()
    sent = decoder.runs[0].samples[["tick", "dac_code", "adc_counts"]].tolist()
    assert sent == log[:-1]  # the last one's reading never came
    assert [tick for tick, *_ in log] == list(range(1, ticks + 1))
    assert decoder.counts.missing == decoder.counts.corrupt == 0
