"""Faults on the target: the output holds or nothing is output, the counters say so, nothing hangs (boards.run watches).

Lost ticks, a fault of the processor and a rate that the timer misses are in test_ports.py.
"""

from __future__ import annotations

import socket
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from bench import paper_profile
from boards import SHIFT, Builder, over, run

from rdpi.board import emulator, telemetry
from rdpi.firmware import engine
from rdpi.model import Model

RATE_HZ = 10_000
ERR_DIGEST = -17  # lib/include/rdpi/types.h
HELD_NONE = 5  # samples without a reference
# What the tests change on the board goes in with the source of references: the linker's --wrap puts it before a
# function of port or driver.
REFERENCE = """
#include <math.h>
#include "rdpi_port.h"
#include "rdpi_reference.h"
#include "rdpi_spi.h"

static uint32_t calls;

static bool next(bool *none)
{
    calls++;
    *none = calls > 100 && calls <= 100 + %d;
    return calls <= 300;
}

bool rdpi_reference_um(uint32_t ticks, uint32_t ahead, float *reference_um, float *ahead_um)
{
    bool none;
    (void)ticks;
    (void)ahead;
    if (!next(&none)) {
        return false;
    }
    *reference_um = *ahead_um = none ? NAN : (float)(calls %% 50) * 0.1f;
    return true;
}

bool rdpi_reference_q31(uint32_t ticks, uint32_t ahead, int32_t *reference, int32_t *ahead_reference)
{
    bool none;
    (void)ticks;
    (void)ahead;
    if (!next(&none)) {
        return false;
    }
    *reference = *ahead_reference = none ? INT32_MIN : (int32_t)(calls %% 50) * 5000000;
    return true;
}
"""
# Busy in nine ticks, from the 201st reference on. The sensor reads what the DAC outputs, taken from the frames of the AD5683R: 4 bits of command,
# then the code.
BUSY_DAC = """
static int32_t output = -1;
static uint32_t ticks; /* the sensor is read once in each */

bool __wrap_rdpi_spi_busy(void)
{
    return ticks > 200 && ticks <= 209;
}

void __real_rdpi_spi_write(const uint8_t *bytes, size_t frame_bytes, size_t frames);
void __wrap_rdpi_spi_write(const uint8_t *bytes, size_t frame_bytes, size_t frames)
{
    output = (bytes[0] & 15) << 12 | bytes[1] << 4 | bytes[2] >> 4;
    __real_rdpi_spi_write(bytes, frame_bytes, frames);
}

void __wrap_rdpi_port_read_adc(int32_t *counts)
{
    *counts = output;
    ticks++;
}
"""
# Every code to the DAC leaves a frame on the line that is none of telemetry's.
MARKED_DAC = """
bool __real_rdpi_port_write_dac(const uint32_t *codes);
bool __wrap_rdpi_port_write_dac(const uint32_t *codes)
{
    static const uint8_t mark[] = {1, 2, 3, 0};
    (void)rdpi_port_send(mark, sizeof mark);
    return __real_rdpi_port_write_dac(codes);
}
"""


def source(folder: Path, *parts: str, none: int = 0) -> str:
    """The option for a source of references: 300 samples, of which `none` have no reference."""
    path = folder / "reference.c"
    path.write_text("\n".join([REFERENCE % none, *parts]))
    return f"-DRDPI_REFERENCE={path}"


def wrap(*functions: str) -> str:
    return "-DCMAKE_EXE_LINKER_FLAGS=" + " ".join(f"-Wl,--wrap={function}" for function in functions)


def references_um(number: str, model: Model, none: int = 0) -> np.ndarray:
    """The same references in um."""
    calls = np.arange(1, 301)
    um = (calls % 50).astype(np.float32) * np.float32(0.1)
    if number == "q31":
        scale = engine(model, 1 / RATE_HZ, "q31").parameters.scale
        um = (calls % 50) * 5000000 * scale.um_per_reference + scale.offset_um
    return np.where((calls > 100) & (calls <= 100 + none), np.nan, um)


@pytest.mark.parametrize("board, number", [("qemu-m4f", "f32"), ("qemu-m0", "q31")])
def test_a_reference_that_is_none_holds_the_output(build: Builder, model: Model, board: str, number: str,
                                                   tmp_path: Path) -> None:
    image = build(board, np.zeros(16), RATE_HZ, number, "-DRDPI_TRACK_SWEEP=OFF", source(tmp_path, none=HELD_NONE))
    decoder = run(image, board)
    samples, info = decoder.runs[0].samples, decoder.info
    host = engine(model, 1 / RATE_HZ, number).step(references_um(number, model, HELD_NONE))
    codes = samples["dac_code"].astype(int)
    assert np.abs(codes - host.dac_code.astype(int)).max() <= (0 if number == "q31" else 1)
    assert (codes[100:100 + HELD_NONE] == codes[99]).all()
    assert (samples["flags"] == host.flags).all()
    assert (info.input_count, info.overruns, info.refused_count) == (HELD_NONE, 0, 0)


def test_a_busy_dac_holds_its_output_and_the_host_is_told(build: Builder, model: Model, tmp_path: Path) -> None:
    image = build("stm32f405", np.zeros(16), RATE_HZ, "f32", "-DRDPI_TRACK_SWEEP=OFF", source(tmp_path, BUSY_DAC),
                  wrap("rdpi_spi_busy", "rdpi_spi_write", "rdpi_port_read_adc"))
    decoder = run(image, "stm32f405")
    samples, info = decoder.runs[0].samples, decoder.info
    host, um = engine(model, 1 / RATE_HZ, "f32"), references_um("f32", model)
    before = host.step(um[:201]).dac_code
    host.missed(9)  # then the library goes on, from the code that was held back
    expected = np.concatenate([before, 9 * [before[-1]], host.step(um[201:]).dac_code]).astype(int)
    held = (samples["flags"] & telemetry.HELD) != 0
    assert held.nonzero()[0].tolist() == list(range(200, 209))
    assert (info.held_count, info.missed_count, info.overruns, info.refused_count) == (9, 9, 0, 0)
    codes = samples["dac_code"].astype(int)
    assert np.abs(codes - expected).max() <= 1
    assert (samples["adc_counts"] == np.where(held, codes[199], codes)).all()  # what is output


@pytest.mark.slow
def test_a_full_line_costs_samples_of_telemetry_and_nothing_else(build: Builder, model: Model, tmp_path: Path) -> None:
    """Nobody reads for two seconds; then every sample that was not taken is a gap, and the rest are right."""
    board, reference_um = "qemu-m4f", paper_profile("10hz", RATE_HZ, 3.0)
    image = build(board, reference_um, RATE_HZ, "f32", "-DRDPI_TRACK_SWEEP=OFF")
    decoder = telemetry.Decoder(board)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "line"))
        server.listen(1)
        server.settimeout(30)
        with emulator.emulate(image, board, "-chardev", f"socket,id=line,path={tmp_path / 'line'}", "-serial",
                              "chardev:line", "-icount", f"shift={SHIFT[board]},sleep=off"):
            line = server.accept()[0]
            time.sleep(2)
            line.settimeout(30)
            with line:
                while not over(decoder):
                    decoder.feed(line.recv(1 << 16))
    decoder.finish()
    samples, info = decoder.runs[0].samples, decoder.info
    host = engine(model, 1 / RATE_HZ, "f32").step(reference_um)
    assert info.refused_count > 1000
    assert decoder.counts.lost == info.refused_count
    assert len(samples) + info.refused_count == info.offered_count == len(reference_um)
    assert (info.overruns, info.held_count, decoder.counts.corrupt) == (0, 0, 0)
    assert np.abs(samples["dac_code"].astype(int) - host.dac_code[samples["tick"] - 1].astype(int)).max() <= 1


@pytest.mark.parametrize("board, number", [("qemu-m4f", "f32"), ("qemu-m0", "q31")])
def test_parameters_damaged_in_flash_are_refused_before_any_output(build: Builder, model: Model, board: str,
                                                                   number: str, tmp_path: Path) -> None:
    image = build(board, np.zeros(16), RATE_HZ, number, "-DRDPI_TRACK_SWEEP=OFF", source(tmp_path, MARKED_DAC),
                  wrap("rdpi_port_write_dac"))
    assert run(image, board).counts.corrupt > 300  # every code marks
    numbers = engine(model, 1 / RATE_HZ, number).parameters.play
    row = struct.pack("<2f" if number == "f32" else "<2i", *numbers[3][:2])  # r and W of a play
    flash = image.read_bytes()
    assert flash.count(row) == 1
    damaged = bytearray(row)
    damaged[4] ^= 1  # the least bit of W
    image.write_bytes(flash.replace(row, bytes(damaged)))
    decoder = run(image, board)
    assert (decoder.info.state, decoder.info.status) == (telemetry.REFUSED, ERR_DIGEST)
    assert decoder.counts.samples == decoder.counts.corrupt == 0
