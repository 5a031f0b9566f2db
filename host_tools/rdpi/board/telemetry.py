"""A microcontroller's telemetry back to samples; port/drivers/telemetry.h holds the layout.

What may be believed. A damaged frame passes its CRC by chance once in 65536. So a sample is believed only if the frame
received before or after it is its neighbour by sequence and tick, or both are but for some lost ticks. A damaged one is
still believed where its CRC is right by chance and sequence and tick are undamaged: less than once in 65536 damaged
frames. What no neighbour confirms is not used, and is missing like any other lost sample.

Several axes of a board share its line. A decoder hears one of them, as if the others were not there.

A board that is reset begins a new run, told by a STARTING or by confirmed samples that go back. No recording spans two.
The bytes before the first zero of a stream, and after the last, may be parts of a frame and are not held against it.
"""

from __future__ import annotations

import binascii
import struct
from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..errors import BadInput

VERSION = 1
SAMPLE, INFO = 1, 2  # frame types, in the lower half of a frame's first byte; the upper is the axis
STARTING, RUNNING, FINISHED, REFUSED, SAFE, RESET = range(6)  # rdpi_telemetry_state_t; from REFUSED on: no sample more
NO_REFERENCE, FLOAT, INT32 = range(3)  # rdpi_telemetry_number_t
SWEEP, HELD = 0x100, 0x200  # among the flags: start-up sweep; the DAC held the code before
NO_READING = NO_VALUE = np.int32(-(2**31))  # of the sensor; in place of an int32 reference
BODY = np.dtype([("type", "u1"), ("sequence", "<u2"), ("tick", "<u4"), ("reference", "<u4"), ("rate", "<u4"),
                 ("dac_code", "<u4"), ("adc_counts", "<i4"), ("flags", "<u2")])
INFO_BODY = struct.Struct("<BBBbIBB7d10I")

LENGTHS = {BODY.itemsize: SAMPLE, INFO_BODY.size: INFO}
LONGEST = 254  # bytes of a frame of this kind of COBS without its zero: one block
NEAR_TICKS = 1000  # more ticks than this are not lost between neighbours
LARGEST = 1e9  # of volts and scales, either sign: far beyond any, and all sums of them are finite
SCALES = {"um_per_reference": "the parameters", "reference_0_um": "the parameters",
          "um_per_s_per_rate": "the parameters", "um_per_count": "RDPI_UM_PER_COUNT",
          "count_0_um": "RDPI_COUNT_0_UM"}  # of an info, and what in the firmware's build sets them
UNKNOWN = ": unknown to this version of rdpi; use the version that the firmware was built with"
CHANCE = 10_000  # of this many good frames, one of an unknown kind may be a damaged one

_CRC_TABLE = np.array([binascii.crc_hqx(bytes([byte]), 0) for byte in range(256)], np.uint16)


class Info(NamedTuple):
    """An info frame, field by field."""

    state: int
    status: int
    rate_hz: int
    dac_bits: int
    numbers: int
    min_V: float
    max_V: float
    um_per_reference: float
    reference_0_um: float
    um_per_s_per_rate: float
    um_per_count: float
    count_0_um: float
    offered_count: int
    refused_count: int
    overruns: int
    guard_count: int
    clip_count: int
    input_count: int
    missed_count: int
    held_count: int
    longest_tick_cycles: int
    cycles_per_s: int

    @property
    def constants(self) -> tuple:
        """What does not change within a run."""
        return (*self[2:12], self.cycles_per_s)

    def fault(self) -> str:
        """What makes it unusable, or nothing."""
        if self.numbers > INT32 or self.state > RESET:
            return f"an info frame with numbers {self.numbers} and state {self.state}{UNKNOWN}"
        if not 1 <= self.rate_hz <= 10**8:
            return f"the firmware reports {self.rate_hz} samples per second; check rate_hz in its build"
        if not 1 <= self.dac_bits <= 32 or not -LARGEST < self.min_V < self.max_V < LARGEST:
            return (f"the firmware reports {self.dac_bits} DAC bits from {self.min_V:g} to {self.max_V:g} V; check "
                    "min_V, max_V and dac_bits in its build")
        for name, setting in SCALES.items():
            if not -LARGEST < getattr(self, name) < LARGEST:
                return f"the firmware reports {name} = {getattr(self, name):g}; check {setting}"
        return ""


@dataclass
class Counts:
    """Of a whole stream. A frame that was damaged is corrupt, and its sample, if it held one, is also lost."""

    samples: int = 0  # believed
    infos: int = 0
    corrupt: int = 0  # between two zeros, and no frame: CRC, COBS, length or kind
    unconfirmed: int = 0  # samples with a good CRC that no neighbour confirms; lost too
    lost: int = 0  # samples that the target offered and that did not arrive, since the first that is known of
    ticks_lost: int = 0  # samples that the target did not take, between the first and the last
    resets: int = 0
    corrupt_at_end: int = 0  # of the corrupt: after the last sample, where nothing says what they were

    @property
    def missing(self) -> int:
        """Sample times of which nothing is known."""
        return self.lost + self.ticks_lost


@dataclass
class Run:
    """From one start of the target to the next."""

    pieces: list[np.ndarray] = field(default_factory=list)
    infos: list[Info] = field(default_factory=list)

    @property
    def samples(self) -> np.ndarray:
        """The believed ones in order, fields of BODY, shape (samples,)."""
        return np.concatenate(self.pieces) if self.pieces else np.empty(0, BODY)

    @property
    def finished(self) -> bool:
        """Whether the target has come to its end in a run of which something was heard before."""
        return bool(self.infos) and self.infos[-1].state == FINISHED and (bool(self.pieces) or self.started)

    @property
    def started(self) -> bool:
        """Whether its start was heard."""
        return any(info.state == STARTING for info in self.infos)

    @property
    def lost_at_end(self) -> int:
        """Samples after the last received of which the latest info tells that they were offered."""
        info = self.info
        if info is None or not (self.pieces or self.started):
            return 0
        offered = 0
        if self.pieces:  # up to the last received, that included: as many as its tick allows
            last = self.pieces[-1][-1]
            offered = int(last["tick"]) - (int(last["tick"]) - int(last["sequence"]) - 1) % 65536
        lost = (info.offered_count - offered) % 2**32
        return lost if lost < 2**31 else 0

    @property
    def info(self) -> Info | None:
        """The latest of those that agree on the constants with most."""
        if not self.infos:
            return None
        constants = Counter(info.constants for info in self.infos).most_common(1)[0][0]
        return next(info for info in reversed(self.infos) if info.constants == constants)


class Decoder:
    """Takes the stream in pieces of any size; `counts` and `runs` tell what has come so far."""

    def __init__(self, where: str, axis: int = 0) -> None:
        """`where` names the stream in messages. `axis`: of the board, from 0."""
        self.where, self.axis = where, axis
        self.other_axes: Counter[int] = Counter()  # frames of each
        self.counts = Counts()
        self.runs = [Run()]
        self.bytes = 0
        self._rest = b""
        self._joined = False  # whether the first zero has come
        self._strange: Counter[str] = Counter()
        self._last = np.empty(0, BODY)  # the last believed
        self._open = np.empty(0, BODY)  # the last frame of all, and whether it is believed already
        self._open_taken = self._open_near = False  # near: but for lost ticks a neighbour of the one before

    def feed(self, data: bytes) -> None:
        """Take the next bytes."""
        self.bytes += len(data)
        stream = np.frombuffer(self._rest + data, np.uint8)
        ends = np.flatnonzero(stream == 0)
        if not len(ends):
            self._rest = stream[-LONGEST - 1:].tobytes()  # one more than a frame has, so that it stays too long
            return
        starts = np.r_[0, ends[:-1] + 1]
        lengths = ends - starts
        self._rest = stream[ends[-1] + 1:][-LONGEST - 1:].tobytes()
        good = lengths == 0  # a zero more than needed
        infos: dict[int, Info] = {}
        places, samples = np.empty(0, int), np.empty(0, BODY)
        for length in np.unique(lengths[(lengths > 3) & (lengths <= LONGEST)]):
            which = np.flatnonzero(lengths == length)
            bodies, sound = _unframe(stream[starts[which][:, np.newaxis] + np.arange(length)])
            which, bodies = which[sound], bodies[sound]
            own = self._own(bodies)
            good[which[~own]] = True
            which, bodies = which[own], bodies[own]
            if length == BODY.itemsize + 3:
                alike = bodies[:, 0] & 15 == SAMPLE
                places, samples = which[alike], np.ascontiguousarray(bodies[alike]).view(BODY)[:, 0]
                good[places] = True
                which, bodies = which[~alike], bodies[~alike]
            for place, body in zip(which.tolist(), bodies):
                if (info := self._info(body.tobytes())) is not None:
                    infos[place], good[place] = info, True
        if not self._joined:
            good[0], self._joined = True, True
        self._count_corrupt(good, places)
        done = 0
        for place, info in sorted(infos.items()):
            before = int(np.searchsorted(places, place))
            self._take(samples[done:before])
            self._inform(info)
            done = before
        self._take(samples[done:])

    def finish(self) -> None:
        """Say, once, that the stream has ended. Raises BadInput as `check` does, and if nothing in it was telemetry.

        What came is counted and may be used all the same.
        """
        if len(self._open) and not self._open_taken:
            self.counts.unconfirmed += 1
            self._open_taken = True
        self.counts.lost += self.runs[-1].lost_at_end
        if not self.counts.infos and self._strange:
            raise BadInput(f"{self.where}: {next(iter(self._strange))}")
        self.check()
        if not self.counts.infos + self.counts.samples + self.counts.unconfirmed:
            if others := self.axes[1:]:
                raise BadInput(f"{self.where}: has nothing of axis {self.axis}, but of {', '.join(map(str, others))}")
            raise BadInput(f"{self.where}: no telemetry frame in {self.bytes} bytes; "
                           + ("check the baud rate" if self.bytes else "nothing was sent"))

    def check(self) -> None:
        """Raise BadInput for what `complaint` finds."""
        if what := self.complaint():
            raise BadInput(f"{self.where}: {what}")

    def complaint(self) -> str:
        """What is wrong with frames, if there are more of them than damage can make, or nothing."""
        return next((what for what, count in self._strange.items()
                     if count > 1 and count * CHANCE > self.counts.samples), "")

    @property
    def info(self) -> Info | None:
        """The latest of all."""
        return next((run.infos[-1] for run in reversed(self.runs) if run.infos), None)

    def info_of(self, run: Run) -> Info:
        """A run's, or if none of its infos arrived another run's: most likely the same firmware."""
        infos = [info for info in (run.info, *(other.info for other in reversed(self.runs))) if info is not None]
        if not infos:
            raise BadInput(f"{self.where}: there are samples, but no info frame with their rate and scale. The "
                           "firmware sends one at the start and one every 1000 samples: record for longer")
        return infos[0]

    @property
    def latest(self) -> np.void | None:
        """The last believed sample of the present run."""
        return self.runs[-1].pieces[-1][-1] if self.runs[-1].pieces else None

    @property
    def axes(self) -> list[int]:
        """Those that are on the line, this one first. One frame of another may be a damaged one."""
        return [self.axis, *sorted(axis for axis, frames in self.other_axes.items() if frames > 1)]

    def _own(self, bodies: np.ndarray) -> np.ndarray:
        """Whether frames of one length, (frames, length), are of this axis, or of a kind that is not known."""
        axes = bodies[:, 0] >> 4
        own = (axes == self.axis) | (LENGTHS.get(bodies.shape[1]) != bodies[:, 0] & 15)
        self.other_axes.update(axes[~own].tolist())
        return own

    def _info(self, body: bytes) -> Info | None:
        """An info frame; of a frame of any other kind it is remembered that there was one."""
        known = body[0] == INFO | self.axis << 4
        if known and len(body) > 1 and body[1] != VERSION:  # the length is another version's own affair
            what = f"telemetry of version {body[1]}{UNKNOWN}"
        elif not known or len(body) != INFO_BODY.size:
            what = f"a frame of type {body[0]} with {len(body)} bytes{UNKNOWN}"
        else:
            info = Info(*INFO_BODY.unpack(body)[2:])
            what = info.fault()
            if not what:
                return info
        self._strange[what] += 1
        return None

    def _count_corrupt(self, good: np.ndarray, places: np.ndarray) -> None:
        self.counts.corrupt += int(np.count_nonzero(~good))
        if len(places):
            self.counts.corrupt_at_end = 0
        self.counts.corrupt_at_end += int(np.count_nonzero(~good[places[-1] if len(places) else 0:]))

    def _inform(self, info: Info) -> None:
        self.counts.infos += 1
        if info.state == STARTING:
            if len(self._open):
                self.counts.unconfirmed += not self._open_taken
            if self.runs[-1].pieces:
                self._new_run()
            # a sample that never was, before the first: what is lost after it is counted
            self._last = np.array([(SAMPLE, 0xFFFF, 0, 0, 0, 0, 0, 0)], BODY)
            self._open, self._open_taken, self._open_near = self._last, True, False
        self.runs[-1].infos.append(info)

    def _take(self, new: np.ndarray) -> None:
        """Samples with a good CRC: believe those that have a neighbour. The last may get its own with the next."""
        if not len(new):
            return
        frames = np.concatenate([self._open, new])
        following, ticks = step_by(frames, "sequence", 1), ticks_between(frames)
        next_to = following & (ticks == 1)
        near = np.r_[self._open_near, following & (ticks > 1) & (ticks <= NEAR_TICKS), False]  # on the left
        believed = np.r_[False, next_to] | np.r_[next_to, False] | (near[:-1] & near[1:])
        first, end = int(self._open_taken), len(frames) - (not believed[-1])
        taken = frames[first:end][believed[first:end]]
        self.counts.unconfirmed += end - first - len(taken)
        self._open, self._open_taken, self._open_near = frames[-1:], bool(believed[-1]), bool(near[-2])
        if len(taken):
            self._append(taken)

    def _append(self, taken: np.ndarray) -> None:
        """Believed samples: count what is missing between them, and begin a new run where they go back."""
        chain = np.concatenate([self._last, taken])
        ticks = ticks_between(chain).astype(np.int64)
        sequence = np.diff(chain["sequence"].astype(np.int64))
        offered = ticks - (ticks - sequence) % 65536  # as many as the ticks allow
        back = (ticks >= 2**31) | (offered < 1)
        self.counts.samples += len(taken)
        self.counts.lost += int((offered - 1)[~back].sum())
        self.counts.ticks_lost += int((ticks - offered)[~back].sum())
        cuts = np.flatnonzero(back) + len(taken) - len(ticks)  # the first of a new run
        for number, piece in enumerate(np.split(taken, cuts)):
            if number:
                self._new_run()
            if len(piece):
                self.runs[-1].pieces.append(piece)
        self._last = taken[-1:]

    def _new_run(self) -> None:
        self.counts.resets += 1
        self.counts.lost += self.runs[-1].lost_at_end
        self.runs.append(Run())


def summary(counts: Counts) -> str:
    """In a line, what came and what did not."""
    return (f"{counts.samples} samples, {counts.lost} lost on the way, {counts.ticks_lost} ticks lost by the target; "
            f"{counts.corrupt} corrupt frames")


def volts(info: Info, dac_code: np.ndarray) -> np.ndarray:
    """The drive of DAC codes, V."""
    return info.min_V + dac_code.astype(float) * (info.max_V - info.min_V) / (2**info.dac_bits - 1)


def displacement_um(info: Info, adc_counts: np.ndarray | np.integer, um_per_count: float | None = None,
                    count_0_um: float | None = None) -> np.ndarray | np.floating:
    """What the sensor's counts mean, by the firmware or by what is given instead."""
    scale = info.um_per_count if um_per_count is None else um_per_count
    return (info.count_0_um if count_0_um is None else count_0_um) + scale * adc_counts.astype(float)


def references_um(info: Info, samples: np.ndarray) -> np.ndarray:
    """References, NaN where there was none."""
    return _numbers(info, samples["reference"]) * info.um_per_reference + info.reference_0_um


def rates_um_per_s(info: Info, samples: np.ndarray) -> np.ndarray:
    """Rates used, um/s."""
    return _numbers(info, samples["rate"]) * info.um_per_s_per_rate


def _numbers(info: Info, bits: np.ndarray) -> np.ndarray:
    bits = np.ascontiguousarray(bits)
    if info.numbers == FLOAT:
        return bits.view("<f4").astype(float)
    integers = bits.view("<i4")
    return np.where(integers == NO_VALUE, np.nan, integers)


def step_by(frames: np.ndarray, name: str, by: int) -> np.ndarray:
    """Whether a field grows by so much from each frame to the next, wrapping round; shape (frames - 1,)."""
    return frames[name][1:] - frames[name][:-1] == by


def ticks_between(frames: np.ndarray) -> np.ndarray:
    """From each frame to the next, uint32; what goes back is large."""
    return frames["tick"][1:] - frames["tick"][:-1]


def _unframe(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frames of one length without their zeros, (frames, length), to bodies and whether each was sound.

    COBS, one block: each mark says how far the next is, and stood for a zero. All frames go from mark to mark at once.
    """
    count, length = frames.shape
    going, at = np.arange(count), np.zeros(count, int)
    while len(going):
        further = frames[going, at]
        frames[going, at] = 0
        at = at + further
        arrived, on = at == length, at < length
        if not on.all():
            frames[going[arrived], 0] = 1  # the first mark's place is free: it tells that the last mark met the end
            going, at = going[on], at[on]
    crc = np.full(count, 0xFFFF, np.uint16)
    for column in frames[:, 1:-2].T:
        crc = (crc << np.uint16(8)) ^ _CRC_TABLE[(crc >> np.uint16(8)) ^ column]
    sent = frames[:, -2] | frames[:, -1].astype(np.uint16) << np.uint16(8)
    return frames[:, 1:-2], (frames[:, 0] == 1) & (crc == sent)
