"""Telemetry from a serial port, live."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO, NamedTuple

from . import firmware
from .errors import BadInput
from .telemetry import FINISHED, REFUSED, Decoder, Info

POLL_S = 0.005  # a terminal buffers 4096 bytes: 14 ms at 3 Mbaud
REPORT_S = 0.2
CHUNK = 1 << 16


class End(NamedTuple):
    """Why a recording ended, and whether that is as it should be."""

    why: str
    good: bool


def record(port: str, baud: int, duration_s: float | None, timeout_s: float, raw: BinaryIO | None,
           report: Callable[[Decoder], None]) -> tuple[Decoder, End]:
    """Take telemetry until the target has finished, `duration_s` of its time have passed, or Ctrl-C.

    It also ends when nothing valid comes for `timeout_s`, or the port is gone. `port` is a device or a URL that
    pyserial knows, socket://localhost:1234 for instance. `raw` gets every byte as it came.
    Raises BadInput for a port that cannot be opened, a target that refuses to run, and what `Decoder.check` finds.
    """
    decoder = Decoder(port)
    with _open(port, baud) as line, _stop_signals() as stopped:
        return decoder, _take(decoder, line, duration_s, timeout_s, raw, report, stopped)


@contextmanager
def _stop_signals() -> Iterator[list[int]]:
    """Ctrl-C and its like are put on a list, so that none interrupts the decoder at its work."""
    received: list[int] = []
    before = {number: signal.signal(number, lambda number, frame: received.append(number))
              for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _open(port: str, baud: int) -> Any:
    import serial

    terminal = os.path.realpath(port).startswith("/dev/pts/")  # an emulator's, which has no baud rate to set
    try:
        return serial.serial_for_url(port, timeout=0, **({} if terminal else {"baudrate": baud}))
    except (OSError, ValueError) as error:
        raise BadInput(f"{port}: cannot be opened ({getattr(error, 'strerror', None) or error}); check the name, that "
                       "no other program has the port, --baud, and that you may use it (on Linux: group dialout)"
                       ) from None


def _take(decoder: Decoder, line: Any, duration_s: float | None, timeout_s: float, raw: BinaryIO | None,
          report: Callable[[Decoder], None], stopped: list[int]) -> End:
    counts = decoder.counts
    heard = reported = time.monotonic()
    frames = heard_bytes = 0
    while not stopped:
        try:
            data = line.read(CHUNK)  # what there is; an error drops nothing, it is told when there is nothing else
        except OSError as error:
            return End(f"the port is gone ({error.strerror or error})", False)
        if raw is not None:
            raw.write(data)
        decoder.feed(data)
        now = time.monotonic()
        run = decoder.runs[-1]
        info = run.infos[-1] if run.infos else None
        over = info is not None and info.state == FINISHED
        if counts.samples + counts.infos > frames and not over:
            frames, heard, heard_bytes = counts.samples + counts.infos, now, decoder.bytes
        if info is not None and info.state == REFUSED:
            raise BadInput(f"{decoder.where}: the target refuses to run: {refusal(info)}")
        if over and run.finished:
            return End("the target has finished", True)
        if info is not None and duration_s is not None and counts.samples + counts.missing >= duration_s * info.rate_hz:
            return End(f"{duration_s:g} s recorded", True)
        if now - heard > timeout_s:
            if over:
                return End("the target had finished before: reset it after this command has begun", False)
            return End(f"silent for {timeout_s:g} s" if decoder.bytes == heard_bytes else
                       f"nothing that is telemetry for {timeout_s:g} s; is the baud rate right?", False)
        if now - reported > REPORT_S:
            decoder.check()
            report(decoder)
            reported = now
        if not data:
            time.sleep(POLL_S)
    return End("stopped", True)


def refusal(info: Info) -> str:
    """Why a target does not run, in words."""
    if info.status == 0:
        return f"the board has no timer for {info.rate_hz} samples per second"
    return f"{firmware.status_text(info.status)} (status {info.status})"
