"""Telemetry from a serial port, live."""

from __future__ import annotations

import errno
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple

from .. import firmware
from ..data import GrowingRecording, sync_folder, write_all
from ..errors import BadInput
from .stretches import Following, Stretch
from .telemetry import FINISHED, REFUSED, RESET, SAFE, Decoder, Info

POLL_S = 0.005  # a terminal buffers 4096 bytes: 14 ms at 3 Mbaud
REPORT_S = 0.2
SAVE_S = 0.25  # and what a disk takes to save: what is older than a second is saved
CHUNK = 1 << 16
NO_INFO = 50_000  # samples: of its infos, one every 1000, a line that damages a byte in a hundred lets 15 through


class End(NamedTuple):
    """Why a recording ended, and whether that is as it should be."""

    why: str
    good: bool


class Raw:
    """A file that gets every byte as it came. Opened by the first, so that no earlier capture is lost for nothing."""

    def __init__(self, path: str | None) -> None:
        """Without a path all of this does nothing."""
        self.path = path
        self.failure = ""  # what kept it from being whole
        self._waiting: list[bytes] = []
        self._file: FileIO | None = None

    def take(self, data: bytes) -> None:
        """The next bytes, to be written by the next `save`."""
        if self.path is not None and data:
            self._waiting.append(data)

    def save(self) -> None:
        """What has been taken, to disk."""
        count = len(self._waiting)  # more may come meanwhile
        data, self._waiting[:count] = b"".join(self._waiting[:count]), []
        if self.failure or not data:
            return
        try:
            if self._file is None:
                self._file = open(self.path, "wb", buffering=0)
                sync_folder(Path(self.path).parent)
            write_all(self._file, data)
        except OSError as error:  # a recording is worth more than its copy
            self.failure = f"{self.path}: {error.strerror or error}; it does not contain all bytes received"

    def close(self) -> None:
        if self._file is not None:
            with suppress(OSError):  # told already
                self._file.close()


class Safe:
    """While a recording goes on, keeps on disk what it would write if it ended: see `rdpi record --help`.

    Each stretch is a recording in a file of its own, RUN.csv.part, RUN.csv.part2, ...; unless `every` stretch is
    wanted, no more than the longest and the present one. Disks may be slow, so all of this is done by a thread.
    """

    def __init__(self, target: Path | None, every: bool, following: Following, metadata: Mapping[str, object],
                 raw: Raw) -> None:
        """Without a target only `raw` is saved. Raises BadInput if there are such files already."""
        self.raw = raw
        self.failure = ""  # what keeps samples from being saved
        self._target, self._every, self._following, self._metadata = target, every, following, metadata
        self._parts: list[GrowingRecording] = []  # the last is the present one
        self._number = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        for name in os.listdir(target.parent) if target and os.access(target.parent, os.R_OK) else ():
            if is_part(target.with_name(name), target):
                raise BadInput(f"{target.with_name(name)}: exists already: a recording was interrupted, or one is "
                               "running. The file is a valid recording: rename it or delete it")

    def __enter__(self) -> Safe:
        self._thread.start()
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> None:
        self._over.set()
        self._thread.join()
        self.save()
        for part in self._parts:
            part.close()
        self.raw.close()
        if error is not None and self.where:
            error.add_note(f"The samples received so far are in {self.where}.")

    @property
    def where(self) -> str:
        """The files, in words, or nothing."""
        return " and ".join(str(part.path) for part in self._parts)

    def save(self) -> None:
        """Everything that has come by now. Returns when it is on disk."""
        self.raw.save()
        if self._target is None or self.failure:
            return
        try:
            for goes_on, stretch in self._following.new():
                if goes_on:
                    self._parts[-1].append(stretch.columns)
                else:
                    self._begin(stretch)
        except OSError as error:
            self.failure = f"{error.filename}: {error.strerror or error}"
        except Exception as error:  # the samples are in memory yet, and a recording is worth more than its copy
            self.failure = f"{self._target}.part: {type(error).__name__}: {error}"

    def remove(self) -> None:
        """The files, when the recording itself is on disk."""
        if self._parts:
            for part in self._parts:
                part.remove()
            self._parts = []
            with suppress(OSError):
                sync_folder(self._target.parent)

    def _begin(self, stretch: Stretch) -> None:
        if not self._every:
            longest = max(self._parts, key=lambda part: ("displacement_um" in part.names, part.samples), default=None)
            for part in self._parts:
                if part is not longest:
                    part.remove()
            self._parts = [longest] if longest else []
        path = None
        while path is None or os.path.lexists(path):  # what has come there since the beginning is not ours
            self._number += 1
            path = f"{self._target}.part{self._number if self._number > 1 else ''}"
        self._parts.append(GrowingRecording(path, stretch.columns, {**stretch.metadata, **self._metadata},
                                            "rdpi record had not ended"))

    def _work(self) -> None:
        while not self._over.wait(SAVE_S):
            self.save()


def is_part(path: Path, target: Path) -> bool:
    """Whether a recording to `target` may keep its samples in this file while it goes on."""
    number = path.name.removeprefix(f"{target.name}.part")
    return number != path.name and (not number or number.isdecimal()) and path.parent == target.parent


def record(decoders: Sequence[Decoder], baud: int, duration_s: float | None, timeout_s: float, safes: Sequence[Safe],
           report: Callable[[Decoder], None], stopped: list[int]) -> End:
    """Feed `decoders`, one for each axis, with telemetry from the port that they are named after, until something is on
    the list `stopped`, the target has finished, or `duration_s` of its time have passed.

    The first frame is waited for without limit, for a board may have to be flashed or reset first: what a target says
    that had finished before is none. It also ends when nothing valid comes for `timeout_s` after that, or for so long
    nothing but bytes that are no telemetry, or infos without a sample; when NO_INFO samples came without any info; when
    the target refuses to run, has no such axis, or sends what Decoder.complaint finds; when samples cannot be saved; or
    the port is gone. Times and counts are those of the first axis.
    The port is a device or a URL that pyserial knows, socket://localhost:1234 for instance.
    Raises BadInput for a port that cannot be opened.
    """
    with _open(decoders[0].where, baud) as line:
        return _take(decoders, line, duration_s, timeout_s, safes, report, stopped)


@contextmanager
def stop_signals() -> Iterator[list[int]]:
    """Ctrl-C and its like are put on a list: none interrupts the decoder, or the writing of what it has.

    What was ignored before stays so, after nohup for instance, but not Ctrl-C: shells have it ignored by what a script
    starts in the background, which would then go on, and hold the port, when the script has been stopped.
    """
    received: list[int] = []
    before = {}
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and (name == "SIGINT" or signal.getsignal(number) != signal.SIG_IGN):
            before[number] = signal.signal(number, lambda number, frame: received.append(number))
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _open(port: str, baud: int) -> Any:
    import serial

    terminal = os.path.realpath(port).startswith("/dev/pts/")  # an emulator's, which has no baud rate to set
    lock = {"exclusive": True} if os.name == "posix" else {}  # elsewhere a port is never shared
    try:
        return serial.serial_for_url(port, timeout=0, **lock, **({} if terminal else {"baudrate": baud}))
    except (OSError, ValueError, ArithmeticError, LookupError) as error:  # a rate or URL that pyserial did not expect
        if getattr(error, "errno", None) == errno.EWOULDBLOCK:
            raise BadInput(f"{port}: is in use by another program; stop that program first") from None
        raise BadInput(f"{port}: cannot be opened ({getattr(error, 'strerror', None) or error}); check the name and "
                       "--baud, that no other program uses the port, and that you have permission (on Linux: group "
                       "dialout)"
                       ) from None


def _take(decoders: Sequence[Decoder], line: Any, duration_s: float | None, timeout_s: float, safes: Sequence[Safe],
          report: Callable[[Decoder], None], stopped: list[int]) -> End:
    decoder = decoders[0]
    counts, frames = decoder.counts, 0
    listening = over = False  # to a target at work; or only to one that had finished before
    reported = time.monotonic()
    noisy, received = math.inf, -math.inf  # since when bytes come, but no frame, and the latest of all bytes
    samples, infos = 0, 0
    idle = math.inf  # since when infos come that promise samples, but none
    while not stopped:
        try:
            data = line.read(CHUNK)  # what there is; an error drops nothing, it is told when there is nothing else
        except OSError as error:
            return End(f"the connection to the port was lost ({error.strerror or error})", False)
        safes[0].raw.take(data)
        for one in decoders:
            one.feed(data)
        now = time.monotonic()
        run = decoder.runs[-1]
        info = run.infos[-1] if run.infos else None
        over = info is not None and info.state == FINISHED and not run.finished
        if data:
            if now - received > timeout_s:
                noisy = now
            received = now
        if counts.samples + counts.infos > frames:
            frames, noisy, listening = counts.samples + counts.infos, now, not over
        if counts.samples > samples or info is None or info.state == FINISHED:
            samples, infos, idle = counts.samples, counts.infos, math.inf
        elif counts.infos > infos:
            infos, idle = counts.infos, min(idle, now)
            if now - idle > timeout_s:
                return End(f"no sample for {timeout_s:g} s, although the target reports that it is running; check "
                           "whether it is reset again and again", False)
        for one in decoders:
            if one.runs[-1].infos and one.runs[-1].infos[-1].state >= REFUSED:
                return End(f"the target refuses to run: {refusal(one.runs[-1].infos[-1])}", False)
        if run.finished and (missing := [one.axis for one in decoders if one.info is None]):
            return End(f"the target has no axis {missing[0]}: give -o once for each axis", False)
        if all(one.runs[-1].finished for one in decoders):
            return End("the target has finished", True)
        if duration_s is not None and decoder.info is not None \
                and counts.samples + counts.missing >= duration_s * decoder.info.rate_hz:
            return End(f"{duration_s:g} s recorded", True)
        if failures := [safe.failure for safe in safes if safe.failure]:
            return End(failures[0], False)
        if decoder.info is None and counts.samples > NO_INFO:
            return End(f"no info frame with rate and scale in the first {NO_INFO} samples", False)
        if received - noisy > timeout_s:
            return End(f"no valid telemetry for {timeout_s:g} s; check the baud rate", False)
        if listening and now - received > timeout_s:
            return End(f"no data for {timeout_s:g} s", False)
        if now - reported > REPORT_S:
            if what := next(filter(None, (one.complaint() for one in decoders)), ""):
                return End(what, False)
            report(decoder)
            reported = now
        if not data:
            time.sleep(POLL_S)
    return End("stopped; the target had finished before: reset it after you have started this "
               "command" if over else "stopped",
               True)


def refusal(info: Info) -> str:
    """Why a target does not run, or no longer, in words."""
    if info.state == SAFE and info.held_count:
        return (f"too many ticks in a row brought no new code: it lost {info.overruns}, and its DAC did not take "
                f"{info.held_count}, in total; it now outputs its safe code")
    if info.state == SAFE:
        return f"it lost too many ticks in a row, {info.overruns} in total; it now outputs its safe code"
    if info.state == RESET:
        return "its watchdog has reset it; it now outputs its safe code"
    if info.status == 0 and info.held_count:
        return "its DAC did not take the first code"
    if info.status == 0:
        return f"the board has no timer for {info.rate_hz} samples per second"
    return f"{firmware.status_text(info.status)} (status {info.status})"
