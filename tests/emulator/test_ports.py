"""examples/track as firmware on the emulated boards: no tick lost, no sample missing, the host's codes."""

from __future__ import annotations

import socket
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from bench import paper_profile
from boards import SHIFT, Builder, run

from rdpi.board import emulator, telemetry
from rdpi.firmware import engine
from rdpi.model import Model

CORE_HZ = {board: 16_000_000 if board == "qemu-m0" else 25_000_000 for board in emulator.MACHINES}  # rdpi_port_cycles
QUICK = (("qemu-m0", "q31", "10hz", 10_000), ("qemu-m4f", "f32", "5-20-35hz", 10_000),
         ("stm32f405", "f32", "5-20-35hz", 10_000))
CASES = [pytest.param(*case, marks=[] if case in QUICK else pytest.mark.long)
         for case in ((board, number, *profile) for board in emulator.BOARDS for number in ("f32", "q31")
                      for profile in (("10hz", 10_000), ("5-20-35hz", 10_000), ("5-20-35hz", 20_000))
                      if (board, *profile) != ("stm32f405", "5-20-35hz", 20_000))]  # too fast for QEMU's timers of it
SLOW_REFERENCE = """
#include "rdpi_port.h"
#include "rdpi_reference.h"

bool rdpi_reference_um(uint32_t ticks, uint32_t ahead, float *reference_um, float *ahead_um)
{
    static uint32_t calls;
    const uint32_t every = %d, half_period = %d, last = %d;
    (void)ticks;
    (void)ahead;
    if (++calls > last) {
        return false;
    }
    if (calls %% every == 0) {
        uint32_t began = rdpi_port_cycles();
        while (rdpi_port_cycles() - began < (2 * calls / every + 1) * half_period) {
        }
    }
    *reference_um = *ahead_um = (float)(calls %% 50) * 0.1f;
    return true;
}
"""
FAULTY_REFERENCE = """
#include "rdpi_reference.h"

bool rdpi_reference_um(uint32_t ticks, uint32_t ahead, float *reference_um, float *ahead_um)
{
    static uint32_t calls;
    (void)ticks;
    (void)ahead;
    if (++calls == %d) {
        __asm__ volatile("udf #0");
    }
    *reference_um = *ahead_um = 1.0f;
    return true;
}
"""
REQUEST, ANSWER = struct.Struct("<II"), struct.Struct("<Ii")


@pytest.mark.parametrize("board, number, profile, rate_hz", CASES)
def test_every_sample_is_the_hosts(build: Builder, model: Model, board: str, number: str, profile: str,
                                   rate_hz: int) -> None:
    reference_um = paper_profile(profile, rate_hz, 1.0)
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
def test_lost_ticks_are_counted_and_told_to_the_library(build: Builder, model: Model, board: str,
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


@pytest.mark.slow
@pytest.mark.parametrize("board", ["qemu-m0", "qemu-m4f"])
def test_fault_stops_everything(build: Builder, board: str, tmp_path: Path) -> None:
    """An undefined instruction in a tick: none follows, and what was queued before is out."""
    source, calls = tmp_path / "faulty.c", 100
    source.write_text(FAULTY_REFERENCE % calls)
    image = build(board, np.zeros(16), 10_000, "f32", "-DRDPI_TRACK_SWEEP=OFF", f"-DRDPI_REFERENCE={source}")
    with pytest.raises(AssertionError, match=f"nothing for 5 s: .*samples={calls - 2},"):  # each is sent one tick later
        run(image, board, silent_s=5)


@pytest.mark.parametrize("board", ["qemu-m0", "qemu-m4f"])
def test_refuses_a_rate_that_the_timer_misses(build: Builder, board: str) -> None:
    """99 kHz is 0.2 % away from what 25 MHz or 16 MHz divide into."""
    decoder = run(build(board, np.zeros(16), 99_000, "f32"), board)
    assert (decoder.info.state, decoder.info.status) == (telemetry.REFUSED, 0)
    assert decoder.counts.samples == 0


def test_bench_link_is_in_lockstep(build: Builder, tmp_path: Path) -> None:
    """One exchange per tick, for which the timers stand; the answer is the next tick's reading; a wrong one holds."""
    board, ticks = "qemu-m4f", 500
    image = build(board, paper_profile("10hz", 10_000, 0.1), 10_000, "f32", "-DRDPI_BENCH=ON", "-DRDPI_TRACK_SWEEP=OFF")
    stream, log = tmp_path / "telemetry", []
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "bench"))
        server.listen(1)
        with emulator.emulate(image, board, "-serial", f"file:{stream}",
                              "-chardev", f"socket,id=bench,path={tmp_path / 'bench'}", "-serial", "chardev:bench",
                              "-icount", f"shift={SHIFT[board]}"):
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
