"""A microcontroller's telemetry back to samples and recordings; port/drivers/telemetry.h holds the layout.

What may be believed. A damaged frame passes its CRC by chance once in 65536. So a sample is believed only if the frame
received before or after it is its neighbour by sequence and tick, or both are but for some lost ticks. A damaged one is
still believed where its CRC is right by chance and sequence and tick are undamaged: less than once in 65536 damaged
frames. What no neighbour confirms is not used, and is missing like any other lost sample.

A board that is reset begins a new run, told by a STARTING or by confirmed samples that go back. No recording spans two.
The bytes before the first zero of a stream, and after the last, may be parts of a frame and are not held against it.
"""

from __future__ import annotations

import binascii
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

import numpy as np

from ..data import MIN_SAMPLES, sample_times
from ..errors import BadInput
from .sweep import OFF_THE_MIDDLE, STILL, amid

VERSION = 1
SAMPLE, INFO = 1, 2  # frame types
STARTING, RUNNING, FINISHED, REFUSED, SAFE, RESET = range(6)  # rdpi_telemetry_state_t; from REFUSED on: no sample more
NO_REFERENCE, FLOAT, INT32 = range(3)  # rdpi_telemetry_number_t
SWEEP, HELD = 0x100, 0x200  # among the flags: start-up sweep; the DAC held the code before
NO_READING = NO_VALUE = np.int32(-(2**31))  # of the sensor; in place of an int32 reference
BODY = np.dtype([("type", "u1"), ("sequence", "<u2"), ("tick", "<u4"), ("reference", "<u4"), ("rate", "<u4"),
                 ("dac_code", "<u4"), ("adc_counts", "<i4"), ("flags", "<u2")])
INFO_BODY = struct.Struct("<BBBbIBB7d10I")

LONGEST = 254  # bytes of a frame of this kind of COBS without its zero: one block
NEAR_TICKS = 1000  # more ticks than this are not lost between neighbours
MOST = 0.8  # of the samples received: a recording with fewer is worth a word
LARGEST = 1e9  # of volts and scales, either sign: far beyond any, and all sums of them are finite
SCALES = {"um_per_reference": "the parameters", "reference_0_um": "the parameters",
          "um_per_s_per_rate": "the parameters", "um_per_count": "RDPI_UM_PER_COUNT",
          "count_0_um": "RDPI_COUNT_0_UM"}  # of an info, and what in the firmware's build sets them
UNKNOWN = ", which this version of rdpi does not know; use the one that the firmware was built with"
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
            return f"an info of numbers {self.numbers} and state {self.state}{UNKNOWN}"
        if not 1 <= self.rate_hz <= 10**8:
            return f"the firmware says {self.rate_hz} samples per second; check rate_hz, with which it was built"
        if not 1 <= self.dac_bits <= 32 or not -LARGEST < self.min_V < self.max_V < LARGEST:
            return (f"the firmware says {self.dac_bits} DAC bits from {self.min_V:g} to {self.max_V:g} V; check min_V, "
                    "max_V and dac_bits, with which it was built")
        for name, setting in SCALES.items():
            if not -LARGEST < getattr(self, name) < LARGEST:
                return f"the firmware says that {name} is {getattr(self, name):g}; check {setting}"
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


class Stretch(NamedTuple):
    """Samples without a gap: the columns and the metadata of a recording."""

    columns: dict[str, np.ndarray]
    metadata: dict[str, object]
    why_unknown: str  # where `memory` is that, what kept a start-up sweep from making it reset

    @property
    def samples(self) -> int:
        return len(self.columns["time_s"])


class Decoder:
    """Takes the stream in pieces of any size; `counts` and `runs` tell what has come so far."""

    def __init__(self, where: str) -> None:
        """`where` names the stream in messages."""
        self.where = where
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
            if length == BODY.itemsize + 3:
                alike = bodies[:, 0] == SAMPLE
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
            raise BadInput(f"{self.where}: no telemetry frame in {self.bytes} bytes; "
                           + ("is the baud rate right?" if self.bytes else "nothing was sent"))

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
            raise BadInput(f"{self.where}: samples, but no info frame, which says their rate and scale; one comes at "
                           "the start and then every 1000 samples: record for longer")
        return infos[0]

    @property
    def latest(self) -> np.void | None:
        """The last believed sample of the present run."""
        return self.runs[-1].pieces[-1][-1] if self.runs[-1].pieces else None

    def _info(self, body: bytes) -> Info | None:
        """An info frame; of a frame of any other kind it is remembered that there was one."""
        if body[0] == INFO and len(body) > 1 and body[1] != VERSION:  # the length is another version's own affair
            what = f"telemetry of version {body[1]}{UNKNOWN}"
        elif body[0] != INFO or len(body) != INFO_BODY.size:
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
        following, ticks = _step(frames, "sequence", 1), _ticks(frames)
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
        ticks = _ticks(chain).astype(np.int64)
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


def stretches(decoder: Decoder, um_per_count: float | None = None, count_0_um: float | None = None) -> list[Stretch]:
    """Every unbroken stretch of at least 16 samples after the start-up sweep, in order, as a recording.

    A stretch ends where a sample is missing, or has no reading while others have one. `memory` is reset if the sweep
    was received from the first sample to the last, ends amid its own range, and the stretch begins where it ended: with
    references, at the first one if the drive stays; without, at the sweep's last sample. `um_per_count` and
    `count_0_um` replace the firmware's.
    """
    found = []
    for run in decoder.runs:
        if len(samples := run.samples):
            read = bool((samples["adc_counts"] != NO_READING).any())
            found += [part for _, part in _stretches(samples, decoder.info_of(run), um_per_count, count_0_um, read)]
    counts = {f"telemetry_{name}": count for name, count in asdict(decoder.counts).items() if name != "corrupt_at_end"}
    return [stretch._replace(metadata=stretch.metadata | counts) for stretch in found]


class Following:
    """The same stretches while the stream still comes, with what can be known by then.

    Not known are the counts, and that a stretch will lack a column: a sample without a reference begins another.
    """

    def __init__(self, decoder: Decoder, um_per_count: float | None = None, count_0_um: float | None = None) -> None:
        self._decoder = decoder
        self._scale = um_per_count, count_0_um
        self._run = -1
        self._begin_run()

    def new(self) -> Iterator[tuple[bool, Stretch]]:
        """What has come since the last call: whether it goes on with the stretch before, and the samples.

        May be called from another thread than the decoder's: that only appends, to runs, pieces and infos.
        """
        while self._decoder.info is not None:  # without rate and scale it is no recording yet
            over = self._run + 1 < len(self._decoder.runs)  # asked before its pieces are taken: then none is to come
            yield from self._take(self._decoder.runs[self._run])
            if not over:
                return
            self._begin_run()

    def _begin_run(self) -> None:
        self._run += 1
        self._pieces = 0  # taken of those of the run
        self._rest = np.empty(0, BODY)  # of them what may be needed again
        self._read = False  # whether any had a reading
        self._info: Info | None = None
        self._open: tuple[str, ...] = ()  # columns of the stretch of which the rest is the last sample
        self._samples = 0  # of it

    def _take(self, run: Run) -> Iterator[tuple[bool, Stretch]]:
        pieces = run.pieces[self._pieces:]
        if not pieces:
            return
        self._pieces += len(pieces)
        samples = np.concatenate([self._rest, *pieces])
        self._read |= bool((samples["adc_counts"] != NO_READING).any())
        if not self._open or self._info is None:
            self._info = self._decoder.info_of(run)
        before, self._open = self._open, ()
        for start, part in _stretches(samples, self._info, *self._scale, self._read, goes_on=bool(before)):
            columns = part.columns
            goes_on = start == 0 and bool(before) and columns.keys() >= set(before)
            if goes_on:
                columns = {name: columns[name][1:] for name in before}
                columns["time_s"] = sample_times(part.samples - 1, self._info.rate_hz, self._samples)
                self._samples += part.samples - 1
            elif part.samples >= MIN_SAMPLES:
                self._samples = part.samples
            else:
                continue
            if len(columns["time_s"]):
                yield goes_on, part._replace(columns=columns)
            if start + part.samples == len(samples):
                self._open = tuple(columns)
        if self._open:
            self._rest = samples[-1:].copy()
            self._rest["dac_code"] = _output(samples)[-1]  # where the DAC is, should it not take the next codes
            self._rest["flags"] &= ~np.uint16(HELD)
        else:  # from the last break on, and a start-up sweep before it
            starts = _starts(samples, self._info, self._read)
            swept = len(starts) > 1 and samples["flags"][starts[-2]] & SWEEP
            self._rest = samples[starts[-2 if swept else -1]:]


def _stretches(samples: np.ndarray, info: Info, um_per_count: float | None, count_0_um: float | None, read: bool,
               goes_on: bool = False) -> list[tuple[int, Stretch]]:
    """Stretches and where they start. `read`: there are readings, so that a sample needs one.

    `goes_on`: the first sample is the last of a stretch before; what goes on with it may be of any length.
    """
    starts = _starts(samples, info, read)
    ends = np.r_[starts[1:], len(samples)]
    sweeping = samples["flags"] & SWEEP != 0
    held = samples["flags"] & HELD != 0
    last_code = 2**info.dac_bits - 1
    output, usable = _output(samples), _usable(samples, info, read)
    swept = int(np.argmin(sweeping))  # samples of the sweep, if all of them are there
    if samples["tick"][0] != 1 or sweeping[swept] or not _whole(samples)[:swept].all():
        swept = 0
    no_sweep = "the start-up sweep was not received whole to its end" if sweeping.any() else ""
    wanted = ~sweeping[starts] & usable[starts]
    found = []
    for start, end in zip(starts[wanted].tolist(), ends[wanted].tolist()):
        why = "" if 0 < start == swept else "it does not begin at the sweep's end" if swept else no_sweep
        reset = 0 < start == swept
        if reset and info.numbers == NO_REFERENCE and usable[start - 1]:
            start -= 1
        if held[start]:  # which code it was is not known
            start += int(np.argmin(np.r_[held[start:end], False]))
            reset, why = False, "the DAC did not take the code at the sweep's end" if reset else why
        if end - start < (1 if goes_on and start == 0 else MIN_SAMPLES):
            continue
        if reset and abs(int(output[start]) - int(output[swept - 1])) > STILL * last_code:
            reset, why = False, "the drive jumps at the sweep's end"
        if reset and not amid(int(output[swept - 1]), int(output[:swept].min()), int(output[:swept].max())):
            reset, why = False, OFF_THE_MIDDLE
        metadata = {"sample_rate_hz": info.rate_hz, "memory": "reset" if reset else "unknown",
                    "first_tick": int(samples["tick"][start])}
        columns = _columns(samples[start:end], output[start:end], info, um_per_count, count_0_um)
        if info.numbers != NO_REFERENCE and "reference_um" not in columns:
            metadata["without_reference"] = int((~np.isfinite(references_um(info, samples[start:end]))).sum())
        found.append((start, Stretch(columns, metadata, why)))
    return found


def _starts(samples: np.ndarray, info: Info, read: bool) -> np.ndarray:
    """Samples that do not go on from the one before, or of which one of the two is of the sweep, or not usable."""
    sweeping, usable = samples["flags"] & SWEEP != 0, _usable(samples, info, read)
    return np.r_[0, np.flatnonzero(~_whole(samples) | np.diff(sweeping) | ~usable[1:] | ~usable[:-1]) + 1]


def _whole(samples: np.ndarray) -> np.ndarray:
    """Whether nothing is between a sample and the next."""
    return _step(samples, "sequence", 1) & (_ticks(samples) == 1)


def _usable(samples: np.ndarray, info: Info, read: bool) -> np.ndarray:
    possible = samples["dac_code"] <= 2**info.dac_bits - 1
    return possible & (samples["adc_counts"] != NO_READING) if read else possible


def _output(samples: np.ndarray) -> np.ndarray:
    """The codes that the DAC was at: where it held one, that of the last sample which it took."""
    held = samples["flags"] & HELD != 0
    return samples["dac_code"][np.maximum.accumulate(np.where(held, 0, np.arange(len(samples))))]


def _columns(samples: np.ndarray, output: np.ndarray, info: Info, um_per_count: float | None,
             count_0_um: float | None) -> dict[str, np.ndarray]:
    """Of a recording, with what there is: no displacement without readings, no reference where one is none.

    `output` are the codes that the DAC was at; those of the samples are what it was given.
    """
    columns = {"time_s": sample_times(len(samples), info.rate_hz), "command_V": volts(info, output)}
    if (samples["adc_counts"] != NO_READING).all():
        columns["displacement_um"] = displacement_um(info, samples["adc_counts"], um_per_count, count_0_um)
    if info.numbers != NO_REFERENCE and np.isfinite(reference := references_um(info, samples)).all():
        columns["reference_um"] = reference
    return columns | {"dac_code": samples["dac_code"].astype(float), "flags": samples["flags"].astype(float)}


def summary(counts: Counts) -> str:
    """In a line, what came and what did not."""
    return (f"{counts.samples} samples, {counts.lost} lost on the way, {counts.ticks_lost} ticks lost by the target; "
            f"{counts.corrupt} corrupt frames")


def notes(decoder: Decoder, found: list[Stretch], written: list[Stretch]) -> list[str]:
    """What the user should know about the recordings written of those found in a stream."""
    counts, info, said = decoder.counts, decoder.info_of(decoder.runs[-1]), []
    if counts.resets:
        said.append(f"the target started anew {counts.resets} times; no recording spans that")
    for run in decoder.runs:
        if run.pieces and not run.started and (first := int(run.pieces[0]["tick"][0])) > 1:
            said.append(f"the target was running already: samples before tick {first} were not received")
        constants = Counter(told.constants for told in run.infos)
        if len(constants) > 1:
            said.append(f"{len(run.infos)} infos of one run tell {len(constants)} different rates or scales; those of "
                        "most are used")
    if info.refused_count:
        said.append(f"{info.refused_count} samples never left the target: its line is too slow")
    if info.overruns or counts.ticks_lost:
        said.append(f"the target itself counts {info.overruns} ticks lost{_longest_tick(info)}")
    if info.held_count:
        said.append(f"the DAC did not take {info.held_count} codes; command_V is the one that it held; does --dac-bits "
                    "of the fit match the board's DAC?")
    if counts.unconfirmed:
        said.append(f"{counts.unconfirmed} samples are not used: both neighbours are lost, so nothing confirms them")
    if counts.corrupt_at_end and not decoder.runs[-1].finished:
        said.append(f"{counts.corrupt_at_end} corrupt frames came after the last sample: as many more may be lost")
    received = sum(int(np.count_nonzero(run.samples["flags"] & SWEEP == 0)) for run in decoder.runs)
    if len(written) < len(found) and written[0].samples < MOST * received:
        said.append(f"the longest stretch without a gap has {written[0].samples} of the {received} samples received; "
                    f"--stretches writes all {len(found)}")
    if any("displacement_um" not in stretch.columns for stretch in written):
        said.append("no displacement_um: the target has no reading of the sensor")
    if without := sum(int(stretch.metadata.get("without_reference", 0)) for stretch in written):
        said.append(f"no reference_um: {without} samples had no reference")
    return said


def _longest_tick(info: Info) -> str:
    if info.longest_tick_cycles == 0:  # a board without cycle counter
        return ""
    took = f"; its longest tick took {info.longest_tick_cycles} cycles"
    if info.cycles_per_s > 0:
        took += f", {info.longest_tick_cycles / info.cycles_per_s:.3g} s, of a period of {1 / info.rate_hz:.3g} s"
    return took


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


def _step(frames: np.ndarray, name: str, by: int) -> np.ndarray:
    """Whether a field grows by so much from each frame to the next, wrapping round; shape (frames - 1,)."""
    return frames[name][1:] - frames[name][:-1] == by


def _ticks(frames: np.ndarray) -> np.ndarray:
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
