#!/usr/bin/env python3
"""A virtual actuator behind the second UART of an emulated board (port/qemu_mps2 with RDPI_BENCH), one frame a tick.

    python3 tests/bench/lockstep.py preisach --socket bench.sock --dac 16:0:100 --rate 10000 --log log.npy

Listens on a Unix socket. The board sends its tick's number and DAC code, 32 bits each, little endian, and waits; the
answer is the same number and the sensor's reading in counts after one period of that code. The first answer waits for a
line on standard input, so that whoever listens to the board can get ready. The log, int64 (ticks, 3) of numbers, codes
and counts, is written when the board hangs up.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import socket
import stat
import struct
import sys

import numpy as np

from bench import Bench, add_make_options, make
from bench_laws import LAWS

REQUEST, ANSWER = struct.Struct("<II"), struct.Struct("<Ii")


def counts_scale(bench: Bench) -> tuple[float, float]:
    """The sensor's um per count, and um at count 0."""
    low, high = bench.adc_range_um
    return (high - low) / 2**bench.adc_bits, low


def serve(line: socket.socket, bench: Bench, dac: tuple[int, float, float], rate_hz: float) -> np.ndarray:
    """Answer until the board hangs up; returns the log."""
    bits, low_V, high_V = dac
    um_per_count, count_0_um = counts_scale(bench)
    log = []
    stream = line.makefile("rb")
    with contextlib.suppress(ConnectionError):  # a killed emulator hangs up so
        while len(request := stream.read(REQUEST.size)) == REQUEST.size:
            number, code = REQUEST.unpack(request)
            command_V = low_V + code * (high_V - low_V) / (2**bits - 1)
            reading_um = bench.run(np.array([command_V]), rate_hz)[0]
            counts = round((reading_um - count_0_um) / um_per_count)
            log.append((number, code, counts))
            line.sendall(ANSWER.pack(number, counts))
    return np.array(log, np.int64).reshape(-1, 3)


def dac(text: str) -> tuple[int, float, float]:
    """BITS:MIN_V:MAX_V."""
    bits, low_V, high_V = text.split(":")
    found = int(bits), float(low_V), float(high_V)
    if not (1 <= found[0] <= 24 and -1e6 < found[1] < found[2] < 1e6):
        raise ValueError(text)
    return found


def listen(server: socket.socket, path: str) -> None:
    """On a path that is free, or a socket that an earlier run has left."""
    if os.path.exists(path) and stat.S_ISSOCK(os.stat(path).st_mode):
        os.unlink(path)
    server.bind(path)
    server.listen(1)


def main() -> None:
    parser = argparse.ArgumentParser(description="A virtual actuator in lockstep with an emulated board.")
    parser.add_argument("kind", choices=LAWS)
    parser.add_argument("--socket", required=True, help="path to listen on")
    parser.add_argument("--dac", type=dac, required=True, metavar="BITS:MIN_V:MAX_V")
    parser.add_argument("--rate", type=float, required=True, metavar="HZ", help="the board's ticks per second")
    parser.add_argument("--log", required=True, metavar="FILE.npy")
    add_make_options(parser)
    options = parser.parse_args()
    bench = make(options.kind, options.seed, **{"adc_bits": 16, **dict(options.set)})
    with socket.socket(socket.AF_UNIX) as server:
        try:
            listen(server, options.socket)
        except OSError as error:
            parser.error(f"--socket {options.socket}: {error.strerror or error}")
        print("listening; the sensor has {!r} um per count, {!r} at count 0".format(*counts_scale(bench)), flush=True)
        line, _ = server.accept()
    sys.stdin.readline()
    with line:
        np.save(options.log, serve(line, bench, options.dac, options.rate))


if __name__ == "__main__":
    main()
