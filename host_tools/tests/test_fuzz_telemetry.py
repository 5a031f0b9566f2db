"""The decoder against whatever can come: nothing ends it, every frame is counted, and what is good is kept.

`pytest --hypothesis-profile long` and RDPI_FUZZ_SECONDS=1200 make 20 minutes of it.
"""

from __future__ import annotations

import binascii
import os
import re
import struct
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import streams
from hypothesis import example, given
from hypothesis import strategies as st
from streams import Sample, frame, samples, stream

from rdpi.board import Decoder, Following, telemetry
from rdpi.board.stretches import Stretch, notes, stretches
from rdpi.data import MIN_SAMPLES, read_recording, sample_times, write_recording
from rdpi.errors import BadInput

LARGEST = 1e12  # um and V: what is beyond is no measurement, and a reader may refuse it
SAMPLE_LAYOUT, INFO_LAYOUT = "<BHIIIIiH", "<BBBBIBB7d10I"


def near(width: int) -> st.SearchStrategy[int]:
    """Unsigned integers of so many bits, mostly near those that mean something."""
    known = (0, 1, 2, 3, 49, 50, 51, 100, 101, 255, 256, 65535, 10_000, 2**31, 2**32 - 1)
    return st.sampled_from([number for number in known if number < 2**width]) | st.integers(0, 2**width - 1)


def layout(kind: int, codes: str) -> st.SearchStrategy[bytes]:
    """Bodies of this layout with any numbers in them."""
    strategies = {"B": near(8), "H": near(16), "I": near(32), "i": near(32).map(lambda number: number - 2**31),
                  "d": st.sampled_from([0.0, 1.0, -20.0, 120.0, 5e-324, 1e9, 1e308]) | st.floats()}
    fields = [strategies[code] for code in codes.replace("7d", "d" * 7).replace("10I", "I" * 10)[2:]]
    return st.tuples(*fields).map(lambda numbers: struct.pack(codes, kind, *numbers))


INFOS = st.builds(streams.Info, state=st.integers(0, 3), rate_hz=st.sampled_from([1, 10_000, 10**8]),
                  dac_bits=st.sampled_from([1, 16, 32]), numbers=st.integers(0, 2), max_V=st.sampled_from([-19.0, 1e8]),
                  um_per_count=st.sampled_from([-1e8, 0.0, 0.001]), offered=near(32))
BODIES = (st.binary(min_size=1, max_size=251) | layout(telemetry.SAMPLE, SAMPLE_LAYOUT)
          | layout(telemetry.INFO, INFO_LAYOUT) | layout(16 + telemetry.SAMPLE, SAMPLE_LAYOUT)
          | layout(32 + telemetry.INFO, INFO_LAYOUT) | st.builds(bytes.__add__, st.sampled_from([b"\1", b"\2", b"\2\1"]),
                                                            st.binary(max_size=120)))
FRAMES = BODIES.map(frame) | INFOS.map(streams.Info.frame)
NUMBERS = st.tuples(near(32), near(32), near(32), near(32).map(lambda number: number - 2**31), near(16))


@st.composite
def run_frames(draw: st.DrawFn) -> bytes:
    """Samples that go on from one part to the next: a sweep, held codes, no readings, any numbers, lost ticks."""
    line, sequence, tick = b"", draw(st.sampled_from([0, 1, 2**16 - 20])), draw(st.sampled_from([1, 2, 2**32 - 20]))
    parts = st.tuples(st.integers(1, 40), st.sampled_from([0, streams.SWEEP, streams.HELD]), st.integers(0, 3),
                      st.integers(0, 2))
    for count, flags, lost, kind in draw(st.lists(parts, min_size=1, max_size=5)):
        sequence, tick = sequence + draw(st.integers(0, lost)), tick + lost
        numbers = draw(NUMBERS) if kind == 0 else None
        for _ in range(count):
            reading = streams.NO_READING if kind == 1 else 500
            fields = numbers or (tick % 90, 0, 30_000 + (0 if flags == streams.SWEEP else tick % 5), reading, flags)
            line += frame(struct.pack(SAMPLE_LAYOUT, telemetry.SAMPLE, sequence % 2**16, tick % 2**32, *fields))
            sequence, tick = sequence + 1, tick + 1
    return line


RUNS = run_frames()
STREAMS = st.lists(st.binary(max_size=300) | FRAMES | RUNS, max_size=8).map(b"".join)


def kinds(data: bytes) -> Counter[str]:
    """What a stream holds, frame by frame, by a decoder of the tests' own."""
    count: Counter[str] = Counter()
    for place, coded in enumerate(data.split(b"\0")[:-1]):
        kind = _kind(coded)
        count[kind if place or kind != "corrupt" else "begun before"] += 1
    return count


def _kind(coded: bytes) -> str:
    if not coded:
        return "empty"
    body, rest = b"", coded
    while rest:
        body, rest = body + rest[1:rest[0]] + b"\0", rest[rest[0]:] if rest[0] <= len(rest) else None
        if rest is None:
            return "corrupt"
    body, crc = body[:-3], body[-3:-1]
    if not body or len(coded) > 254 or binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little") != crc:
        return "corrupt"
    if body[0] == telemetry.SAMPLE and len(body) == struct.calcsize(SAMPLE_LAYOUT):
        return "sample"
    if body[0] >> 4 and body[0] & 15 == {struct.calcsize(SAMPLE_LAYOUT): telemetry.SAMPLE,
                                        struct.calcsize(INFO_LAYOUT): telemetry.INFO}.get(len(body)):
        return "of another axis"
    known = body[:2] == b"\2\1" and len(body) == struct.calcsize(INFO_LAYOUT)
    return "info" if known and not telemetry.Info(*telemetry.INFO_BODY.unpack(body)[2:]).fault() else "corrupt"


def decode(data: bytes, cuts: list[int]) -> Decoder:
    decoder = Decoder("board")
    for start, end in zip([0, *sorted(cuts)], [*sorted(cuts), len(data)]):
        decoder.feed(data[start:end])
    with_nothing = not any(kinds(data)[kind] for kind in ("sample", "info"))
    try:
        decoder.finish()
    except BadInput as error:
        told = re.search("unknown to this version|the firmware reports|has nothing of axis 0", str(error))
        assert with_nothing or decoder.complaint() or told
    return decoder


@pytest.fixture(autouse=True)
def strict(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A warning on a user's terminal is a fault; and no disk need be waited for."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@given(STREAMS, st.lists(st.integers(0, 2000), max_size=5))
@example(stream(samples(20)) + frame(b"\2"), [])
def every_frame_is_counted(data: bytes, cuts: list[int]) -> None:
    counts, kind = decode(data, [cut % (len(data) + 1) for cut in cuts]).counts, kinds(data)
    assert (counts.samples + counts.unconfirmed, counts.infos, counts.corrupt) == (
        kind["sample"], kind["info"], kind["corrupt"])
    assert min(vars(counts).values()) >= 0


@given(st.lists(FRAMES, max_size=6), st.integers(2, 30), st.integers(2, 30))
@example([frame(b"\2")], 2, 2)
def what_is_good_is_kept(between: list[bytes], before: int, after: int) -> None:
    """Some that belong together, before and after whatever comes with a good CRC."""
    sent = [Sample(7000 + k, 2**30 + k, dac_code=k) for k in range(before + after)]
    parts = [b"".join(sample.frame() for sample in part) for part in (sent[:before], sent[before:])]
    decoder = decode(parts[0] + b"".join(between) + parts[1], [])
    got = [(int(one["tick"]), int(one["dac_code"])) for run in decoder.runs for one in run.samples]
    assert set(got) >= {(sample.tick, sample.dac_code) for sample in sent}


@given(data=STREAMS, info=INFOS)
@example(data=stream(samples(30)), info=streams.Info())
def whatever_is_written_is_a_recording(path: Path, data: bytes, info: streams.Info) -> None:
    decoder = decode(info.frame() + data, [])
    try:
        found = stretches(decoder)
    except BadInput:  # samples but no info
        return
    for stretch in found:
        write_recording(path, stretch.columns, stretch.metadata)
        if all(np.abs(column).max() < LARGEST for column in stretch.columns.values()):
            assert len(read_recording(path, ("command_V",))) == stretch.samples
    if decoder.info is not None and found:
        notes(decoder, found, found[:1])


def parts_of_a_run(*parts: tuple[int, int]) -> bytes:
    """So many samples with these flags, and so on."""
    flags = [flag for count, flag in parts for _ in range(count)]
    return b"".join(Sample(k, k + 1, dac_code=30_000 + (0 if flag == streams.SWEEP else k % 5), adc_counts=1,
                           flags=flag).frame() for k, flag in enumerate(flags))


INFO, FRAME = len(streams.Info().frame()), len(parts_of_a_run((1, 0)))


@example(streams.Info(), [parts_of_a_run((40, streams.SWEEP), (40, 0))], [INFO + 50 * FRAME])
@example(streams.Info(), [parts_of_a_run((40, 0), (40, streams.HELD))], [INFO + 52 * FRAME])
@example(streams.Info(), [parts_of_a_run((40, 0), (9, streams.HELD), (40, 0))], [INFO + 50 * FRAME])
@given(info=INFOS, runs=st.lists(RUNS, min_size=1, max_size=3), cuts=st.lists(st.integers(0, 5000), max_size=6))
def what_is_followed_is_what_is_found(info: streams.Info, runs: list[bytes], cuts: list[int]) -> None:
    """While the stream comes the same stretches as in the end, but for what only the end can tell."""
    data = b"".join(info.frame() + run for run in runs)
    decoder = Decoder("board")
    following, got = Following(decoder), []
    for start, end in zip([0, *sorted(cuts)], [*sorted(cuts), len(data)]):
        decoder.feed(data[start:end])
        for goes_on, part in following.new():
            if goes_on:
                assert got[-1].columns.keys() == part.columns.keys()
                columns = {name: np.r_[got[-1].columns[name], part.columns[name]] for name in part.columns}
                got[-1] = got[-1]._replace(columns=columns)
            else:
                got.append(part)
    for part in got:
        assert part.samples >= MIN_SAMPLES
        assert part.columns["time_s"].tolist() == sample_times(part.samples, info.rate_hz).tolist()
    late_reading = any(run.samples["adc_counts"][0] == streams.NO_READING and
                       (run.samples["adc_counts"] != streams.NO_READING).any() for run in decoder.runs if run.pieces)
    found = stretches(decoder)
    if not late_reading and not any(part.metadata.get("without_reference") for part in found):
        assert [_contents(part) for part in got] == [_contents(part) for part in found]


def _contents(part: Stretch) -> tuple:
    return (part.metadata["first_tick"], part.metadata["memory"],
            {name: column.tolist() for name, column in part.columns.items()})


def test_every_frame_of_any_stream_is_counted(rounds: Iterator[int]) -> None:
    for _ in rounds:
        every_frame_is_counted()


def test_good_frames_beside_any_others_are_kept(rounds: Iterator[int]) -> None:
    for _ in rounds:
        what_is_good_is_kept()


def test_whatever_is_written_of_any_stream_is_a_recording(rounds: Iterator[int], tmp_path: Path) -> None:
    for _ in rounds:
        whatever_is_written_is_a_recording(tmp_path / "run.csv")


def test_a_stream_that_is_followed_gives_the_same_stretches(rounds: Iterator[int]) -> None:
    for _ in rounds:
        what_is_followed_is_what_is_found()
