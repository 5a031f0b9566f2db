"""The safe state on the target: what the DAC has after a fault of the processor, after too many lost ticks and from
start-up on; and what feeds the watchdog. Read from outside, in the emulator's memory and registers.
"""

from __future__ import annotations

import contextlib
import json
import re
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from boards import SHIFT, Builder
from test_ports import CORE_HZ

from rdpi.board import emulator, telemetry

RATE_HZ, SAFE_CODE, CALLS = 10_000, 0x1234, 100
FAULTS = {"an undefined instruction": 1, "a pointer that is not aligned": 2, "a stack beyond its memory": 3,
          "an interrupt without a handler": 4, "a jump to nowhere": 5}
AMID_A_FRAME = 102, 106, 110  # counts of SysTick from before the frame on, + 100
MARK = bytes.fromhex("dec017fa")  # the fault's number is put in its place, in the image
SOURCE = """
#include "cortex_m.h"
#include "rdpi_reference.h"
#include "rdpi_spi.h"

static const volatile uint32_t kind = 0xFA17C0DEu;
static uint32_t calls;

bool rdpi_reference_um(uint32_t ticks, uint32_t ahead, float *reference_um, float *ahead_um)
{
    (void)ticks;
    (void)ahead;
    *reference_um = *ahead_um = 1.0f;
    if (++calls != %d) {
        return true;
    }
    switch (kind) {
    case 1:
        __asm__ volatile("udf #0");
        break;
    case 2:
        __asm__ volatile("mov r0, %%0\\n\\tldmia r0!, {r1, r2}" ::"r"(0x20000001u) : "r0", "r1", "r2", "memory");
        break;
    case 3:
        __asm__ volatile("mov sp, %%0\\n\\tudf #0" ::"r"(0x10000000u));
        break;
    case 4:
        cortex_m_enable(0, 0);
        cortex_m_pend(0);
        break;
    case 5:
        ((void (*)(void))0x2u)();
        break;
    default:
        break;
    }
    return true;
}

/* SysTick, an exception that no port has a handler for, comes so many counts later: somewhere in this frame. */
void __real_rdpi_spi_write(const uint8_t *bytes, size_t frame_bytes, size_t frames);
void __wrap_rdpi_spi_write(const uint8_t *bytes, size_t frame_bytes, size_t frames)
{
    if (kind >= 100u && calls == %d) {
        ((volatile uint32_t *)0xE000E010u)[1] = kind - 100u; /* reload */
        ((volatile uint32_t *)0xE000E010u)[2] = 0;
        ((volatile uint32_t *)0xE000E010u)[0] = 7u; /* the core's clock, interrupt, on */
    }
    __real_rdpi_spi_write(bytes, frame_bytes, frames);
}
""" % (CALLS, CALLS)
LATE = """
#include "rdpi_port.h"
#include "rdpi_reference.h"

bool rdpi_reference_um(uint32_t ticks, uint32_t ahead, float *reference_um, float *ahead_um)
{
    static uint32_t calls;
    uint32_t began = rdpi_port_cycles();
    (void)ticks;
    (void)ahead;
    *reference_um = *ahead_um = 1.0f;
    while (++calls > %d && rdpi_port_cycles() - began < %d) {
    }
    return true;
}
"""
HANGS = """
#include "rdpi_port.h"
#include "rdpi_reference.h"

bool rdpi_reference_um(uint32_t ticks, uint32_t ahead, float *reference_um, float *ahead_um)
{
    static uint32_t calls;
    (void)ticks;
    (void)ahead;
    *reference_um = *ahead_um = 1.0f;
    if (++calls >= %d) {
        for (;;) { /* not a loop that ends when calls wraps: newer compilers go straight to its end */
        }
    }
    return true;
}
"""


class Outside:
    """A board that runs, seen from outside."""

    def __init__(self, image: Path, board: str, folder: Path, line: socket.socket | None) -> None:
        self.board, self.line = board, line
        self.trace, self.stream = folder / "trace", folder / "telemetry"
        names = subprocess.run(["arm-none-eabi-nm", image], capture_output=True, text=True, check=True).stdout
        found = re.search(r"^([0-9a-f]+) \w dac_code$", names, re.MULTILINE)
        self.address = int(found[1], 16) if found else None
        self._writes, self._read = [], 0

    def writes(self) -> list[tuple[int, int]]:
        """Address and value of each write to a register."""
        with open(self.trace, "rb") as file:
            file.seek(self._read)
            lines, end, _ = file.read().rpartition(b"\n")
        self._read += len(lines + end)
        self._writes += [(int(address, 16), int(value, 16)) for address, value in
                         re.findall(rb"ops_write .* addr (0x[0-9a-f]+) value (0x[0-9a-f]+) ", lines)]
        return self._writes

    def frames(self) -> list[list[int]]:
        """What the AD5683R got each time that SYNC was low; the last may be going on."""
        frames, low = [], False
        for address, value in self.writes():
            if address == 0x40020018 and value & (1 << 4 | 1 << 20):  # GPIOA_BSRR, pin 4
                low = bool(value & 1 << 20)
                if low:
                    frames.append([])
            elif address == 0x4001300C:  # SPI1_DR
                assert low
                frames[-1].append(value)
        return [*frames, *([[]] if low else [])]  # a frame that is not at its end leaves something open

    def code(self) -> int:
        """The DAC's, or -1 while it gets one."""
        if self.board == "stm32f405":
            codes = [(data[0] & 15) << 12 | data[1] << 4 | data[2] >> 4 for data in self.frames()
                     if len(data) == 3 and data[0] >> 4 == 3]
            return codes[-1] if codes and len(self.frames()[-1]) == 3 else -1
        answer = ask(self.line, "human-monitor-command", **{"command-line": f"xp /1wx {self.address:#x}"})
        return int(answer.split(":")[1], 16)

    def telemetry(self) -> telemetry.Decoder:
        decoder = telemetry.Decoder(self.board)
        decoder.feed(self.stream.read_bytes())
        return decoder


def ask(line: socket.socket, command: str, **arguments: str) -> str:
    line.sendall(json.dumps({"execute": command, "arguments": arguments}).encode())
    text = b""
    while b'"return"' not in text or not text.endswith(b"\n"):
        text += line.recv(1 << 16)
    return next(answer["return"] for answer in map(json.loads, text.splitlines()) if "return" in answer)


@contextlib.contextmanager
def running(image: Path, board: str, folder: Path) -> Iterator[Outside]:
    options = ["-serial", f"file:{folder / 'telemetry'}", "-icount", f"shift={SHIFT[board]},sleep=off"]
    if board == "stm32f405":
        with emulator.emulate(image, board, *options, "-trace", "memory_region_ops_write", "-D", str(folder / "trace")):
            until((folder / "trace").exists)
            yield Outside(image, board, folder, None)
        return
    with emulator.emulate(image, board, *options, "-qmp", f"unix:{folder / 'qmp'},server=on,wait=off"), \
            socket.socket(socket.AF_UNIX) as line:
        line.settimeout(30)
        until(lambda: line.connect_ex(str(folder / "qmp")) == 0)
        ask(line, "qmp_capabilities")
        yield Outside(image, board, folder, line)


def until(condition: Callable[[], bool], seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come to that"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def faulty(build: Builder, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int, Path], Path]:
    """An image for a board that meets a fault in a tick; the safe code is SAFE_CODE."""
    images: dict[str, bytes] = {}
    source = tmp_path_factory.mktemp("faulty") / "faulty.c"
    source.write_text(SOURCE)

    def make(board: str, kind: int, folder: Path) -> Path:
        if board not in images:
            wrap = ["-DCMAKE_EXE_LINKER_FLAGS=-Wl,--wrap=rdpi_spi_write"] if board == "stm32f405" else []
            images[board] = build(board, np.zeros(16), RATE_HZ, "f32", "-DRDPI_TRACK_SWEEP=OFF",
                                  f"-DRDPI_SAFE_CODE={SAFE_CODE}", f"-DRDPI_REFERENCE={source}", *wrap).read_bytes()
        assert images[board].count(MARK) == 1
        image = folder / "track"
        image.write_bytes(images[board].replace(MARK, kind.to_bytes(4, "little")))
        return image

    return make


def ends_in_the_safe_code(board: str, image: Path, folder: Path) -> Outside:
    with running(image, board, folder) as outside:
        until(lambda: outside.telemetry().counts.samples >= CALLS - 2)  # each is sent one tick later
        until(lambda: outside.code() == SAFE_CODE)
        time.sleep(0.3)  # thousands of periods, were they to go on
        assert outside.code() == SAFE_CODE
        samples = outside.telemetry().runs[0].samples
    assert len(samples) == CALLS - 2
    assert (samples["dac_code"] != SAFE_CODE).all()
    return outside


@pytest.mark.parametrize("board, fault", [
    pytest.param(board, fault, marks=[] if (board, FAULTS[fault]) in (("qemu-m4f", 3), ("stm32f405", 1))
                 else pytest.mark.slow if board in ("qemu-m0", "stm32f405") else pytest.mark.long)
    for board in emulator.BOARDS for fault in FAULTS
    if board in ("qemu-m0", "qemu-m4f", "stm32f405") or FAULTS[fault] in (1, 3)])  # M3 and M7 share the M4's port
def test_a_fault_ends_in_the_safe_code(faulty: Callable, board: str, fault: str, tmp_path: Path) -> None:
    ends_in_the_safe_code(board, faulty(board, FAULTS[fault], tmp_path), tmp_path)


@pytest.mark.slow
def test_a_fault_amid_a_frame_gives_it_up_and_ends_in_the_safe_code(faulty: Callable, tmp_path: Path) -> None:
    board, cut = "stm32f405", []
    for kind in AMID_A_FRAME:
        folder = tmp_path / str(kind)
        folder.mkdir()
        *before, control, code = ends_in_the_safe_code(board, faulty(board, kind, folder), folder).frames()
        assert control == [0x40, 0x80, 0x00]  # gain 2, no reset
        assert code == [0x31, 0x23, 0x40]
        assert all(len(frame) == 3 for frame in before[:-1])
        cut.append(len(before[-1]))  # fewer than 3 are discarded by the DAC
    assert {1, 2} & set(cut), cut


def test_from_reset_on_the_dac_has_the_safe_code(faulty: Callable, tmp_path: Path) -> None:
    """Before the clock unit is touched, on a board whose DAC keeps its code through a reset."""
    board = "stm32f405"
    with running(faulty(board, 0, tmp_path), board, tmp_path) as outside:
        until(lambda: len(outside.frames()) > 10)
        assert outside.frames()[:2] == [[0x40, 0x80, 0x00], [0x31, 0x23, 0x40]]
        codes = [value for address, value in outside.writes() if address == 0x4001300C][:6]
        last = [address for address, _ in outside.writes()].index(0x4001300C) + len(codes)
        clocks = {0x40023800, 0x40023804, 0x40023808, 0x40007000}  # RCC_CR, PLLCFGR, CFGR, PWR_CR
        assert not clocks & {address for address, _ in outside.writes()[:last]}


@pytest.mark.parametrize("board", [pytest.param(board, marks=[] if board == "qemu-m4f" else pytest.mark.slow
                                                if board == "qemu-m0" else pytest.mark.long) for board in CORE_HZ])
def test_too_many_lost_ticks_in_a_row_end_in_the_safe_code(build: Builder, board: str, tmp_path: Path) -> None:
    """Every tick takes one and a half periods from some time on."""
    most, source = 8, tmp_path / "late.c"
    source.write_text(LATE % (CALLS, CORE_HZ[board] * 3 // 2 // RATE_HZ))
    image = build(board, np.zeros(16), RATE_HZ, "f32", "-DRDPI_TRACK_SWEEP=OFF", f"-DRDPI_REFERENCE={source}",
                  f"-DRDPI_SAFE_CODE={SAFE_CODE}", f"-DRDPI_MAX_OVERRUNS={most}")
    with running(image, board, tmp_path) as outside:
        until(lambda: outside.code() == SAFE_CODE)
        until(lambda: (info := outside.telemetry().info) is not None and info.state == telemetry.SAFE)
        decoder = outside.telemetry()
        time.sleep(0.3)
        assert outside.code() == SAFE_CODE
    assert decoder.info.overruns == most
    assert (decoder.runs[0].samples["dac_code"] != SAFE_CODE).all()
    assert decoder.info.offered_count == CALLS + most  # each lost one came with a late one, the last with the end


def test_only_ticks_feed_the_watchdog(build: Builder, tmp_path: Path) -> None:
    """Keys as they would reach the watchdog, which QEMU does not have: it starts, is fed, and no longer is when a tick
    hangs, though the timer goes on."""
    board, source = "stm32f405", tmp_path / "hangs.c"
    source.write_text(HANGS % CALLS)
    image = build(board, np.zeros(16), RATE_HZ, "f32", "-DRDPI_TRACK_SWEEP=OFF", f"-DRDPI_REFERENCE={source}",
                  "-DRDPI_WATCHDOG_MS=100")
    with running(image, board, tmp_path) as outside:
        until(lambda: outside.telemetry().counts.samples >= CALLS - 2)
        time.sleep(0.3)
        keys = [value for address, value in outside.writes() if address == 0x40003000]
    assert keys[:2] == [0xCCCC, 0x5555]
    assert set(keys[2:]) == {0xAAAA}
    assert len(keys[2:]) == 1 + CALLS - 1  # at the start, and after each tick that returned


def test_the_watchdog_is_fed_after_the_end(build: Builder, tmp_path: Path) -> None:
    """main has returned, and the last code is to stay."""
    board = "stm32f405"
    image = build(board, np.zeros(16), RATE_HZ, "f32", "-DRDPI_TRACK_SWEEP=OFF", "-DRDPI_WATCHDOG_MS=100")
    with running(image, board, tmp_path) as outside:
        until(lambda: (info := outside.telemetry().info) is not None and info.state == telemetry.FINISHED)
        until(lambda: [address for address, _ in outside.writes()].count(0x40003000) > 1000)


@pytest.mark.parametrize("board, last", [("stm32f405", 2**16 - 1), ("stm32g474", 2**12 - 1)])
def test_a_safe_code_beyond_the_dac_does_not_build(build: Builder, board: str, last: int) -> None:
    with pytest.raises(AssertionError, match=f"RDPI_SAFE_CODE: {last} at most"):
        build(board, np.zeros(16), RATE_HZ, "f32", f"-DRDPI_SAFE_CODE={last + 1}")


def test_a_safe_code_that_is_no_number_is_told_so(build: Builder) -> None:
    with pytest.raises(AssertionError, match="RDPI_SAFE_CODE is '-1', not a whole number"):
        build("qemu-m4f", np.zeros(16), RATE_HZ, "f32", "-DRDPI_SAFE_CODE=-1")


def test_a_watchdog_is_refused_where_the_board_has_none(build: Builder) -> None:
    with pytest.raises(AssertionError, match="RDPI_WATCHDOG_MS is 100, but port/qemu_mps2 has no watchdog"):
        build("qemu-m4f", np.zeros(16), RATE_HZ, "f32", "-DRDPI_WATCHDOG_MS=100")
