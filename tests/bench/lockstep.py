#!/usr/bin/env python3
"""Virtual actuators behind the second UART of an emulated board (port/qemu_mps2 with RDPI_BENCH), one frame a tick.

    python3 tests/bench/lockstep.py preisach --socket bench.sock --dac 16:0:100 --rate 10000 --log log.npy
    python3 tests/bench/lockstep.py preisach bouc-wen --couple 0.01 --socket ...

Listens on a Unix socket. The board sends its tick's number and the DAC code of each axis, 32 bits each, little endian,
and waits; the answer is the same number and the sensors' readings in counts after one period of these codes. The first
answer waits for a line on standard input, so that whoever listens to the board can get ready. The log, int64 (ticks,
1 + 2 axes) of numbers, codes and counts, is written when the board hangs up.

With --couple each axis moves by so many um per V of the drives of the others, counted from the middle of the range.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import socket
import stat
import struct
import sys
from collections.abc import Sequence

import numpy as np

from bench import Bench, add_make_options, make
from bench_laws import LAWS


def counts_scale(bench: Bench) -> tuple[float, float]:
    """The sensor's um per count, and um at count 0."""
    low, high = bench.adc_range_um
    return (high - low) / 2**bench.adc_bits, low


def serve(line: socket.socket, benches: Sequence[Bench], dac: tuple[int, float, float], rate_hz: float,
          couple_um_per_V: float = 0.0) -> np.ndarray:
    """Answer until the board hangs up; returns the log."""
    bits, low_V, high_V = dac
    axes = len(benches)
    request, answer = struct.Struct(f"<I{axes}I"), struct.Struct(f"<I{axes}i")
    log = []
    stream = line.makefile("rb")
    with contextlib.suppress(ConnectionError):  # a killed emulator hangs up so
        while len(asked := stream.read(request.size)) == request.size:
            number, *codes = request.unpack(asked)
            drives_V = low_V + np.array(codes) * (high_V - low_V) / (2**bits - 1)
            moved_um = couple_um_per_V * (drives_V - (low_V + high_V) / 2)
            counts = []
            for bench, drive_V, others_um in zip(benches, drives_V, moved_um.sum() - moved_um):
                um_per_count, count_0_um = counts_scale(bench)
                reading_um = bench.run(np.array([drive_V]), rate_hz)[0] + others_um
                counts.append(round((reading_um - count_0_um) / um_per_count))
            log.append((number, *codes, *counts))
            line.sendall(answer.pack(number, *counts))
    return np.array(log, np.int64).reshape(-1, 1 + 2 * axes)


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
    parser = argparse.ArgumentParser(description="Virtual actuators in lockstep with an emulated board.")
    parser.add_argument("kinds", nargs="+", choices=LAWS, metavar="KIND", help="one for each axis: " + ", ".join(LAWS))
    parser.add_argument("--couple", type=float, default=0.0, metavar="UM_PER_V", help="cross coupling of the axes")
    parser.add_argument("--socket", required=True, help="path to listen on")
    parser.add_argument("--dac", type=dac, required=True, metavar="BITS:MIN_V:MAX_V")
    parser.add_argument("--rate", type=float, required=True, metavar="HZ", help="the board's ticks per second")
    parser.add_argument("--log", required=True, metavar="FILE.npy")
    add_make_options(parser)
    options = parser.parse_args()
    benches = [make(kind, options.seed + 100 * axis, **{"adc_bits": 16, **dict(options.set)})
               for axis, kind in enumerate(options.kinds)]
    with socket.socket(socket.AF_UNIX) as server:
        try:
            listen(server, options.socket)
        except OSError as error:
            parser.error(f"--socket {options.socket}: {error.strerror or error}")
        print("listening; the sensor has {!r} um per count, {!r} at count 0".format(*counts_scale(benches[0])),
              flush=True)
        line, _ = server.accept()
    sys.stdin.readline()
    with line:
        np.save(options.log, serve(line, benches, options.dac, options.rate, options.couple))


if __name__ == "__main__":
    main()
