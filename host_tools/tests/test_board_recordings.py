"""Telemetry to files, as scripts do it; test_record.py and test_telemetry.py go the same way by commands."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import streams
from ports import Board
from streams import Info, samples, stream

from rdpi.board import (Decoder, check_recording_outputs, how_it_ended, how_it_goes, read_stream, record_file,
                        write_stream)
from rdpi.board.recordings import usable_stretches
from rdpi.data import read_recording
from rdpi.errors import BadInput


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def decoded(data: bytes) -> Decoder:
    decoder = Decoder("board")
    decoder.feed(data)
    return decoder


def with_a_gap() -> list[streams.Sample]:
    """1000 samples, a lost one and 999 more, a lost one and 499 more."""
    return [sample for k, sample in enumerate(samples(2500)) if k not in (1000, 2000)]


def test_a_stored_stream(here: Path) -> None:
    (here / "kept.bin").write_bytes(stream(samples(2500)))
    done: list[float] = []
    found = read_stream("kept.bin", report=done.append)
    assert found.decoder.counts.samples == 2500 and [part.samples for part in found.stretches] == [2500]
    assert all(0 <= fraction < 1 for fraction in done) and done
    scaled = read_stream("kept.bin", (0.002, 1.0)).stretches[0].columns["displacement_um"]
    assert scaled == pytest.approx(2 * (found.stretches[0].columns["displacement_um"] - 0.5) + 1)


def test_streams_without_a_stretch(here: Path) -> None:
    for name, data, message in (("none.bin", b"", "none.bin: no telemetry frame in 0 bytes"),
                                ("short.bin", stream(samples(15)), "short.bin: 15 samples, 0 lost"),
                                ("refused.bin", replace(Info(), state=streams.SAFE).frame(), "refuses to run")):
        (here / name).write_bytes(data)
        with pytest.raises(BadInput, match=message):
            read_stream(name)
    with pytest.raises(BadInput, match="nowhere.bin: cannot be read"):
        read_stream("nowhere.bin")


def test_the_longest_stretch_is_written(here: Path) -> None:
    decoder = decoded(stream(with_a_gap()))
    decoder.finish()
    found = usable_stretches(decoder)
    written = write_stream((decoder, found), Path("made/run.csv"), "source.bin", texts={"note": "a note"})
    assert [path.name for path in (here / "made").iterdir()] == ["run.csv"]
    run = read_recording("made/run.csv")
    assert len(run) == 1000 and run.metadata["note"] == "a note" and run.metadata["source"] == "source.bin"
    (told,) = written.recordings
    assert told["file"] == "made/run.csv" and told["source"] == "board" and told["samples"] == 1000
    assert told["columns"] == list(run.columns) and {key: str(value) for key, value in told["metadata"].items()} == \
        run.metadata
    assert written.missing == 2 == written.stream["counts"]["lost"] and written.stream["stretches"] == [1000, 999, 499]
    assert written.stream["finished"] is True and written.stream["target"]["rate_hz"] == 10_000
    assert written.lines[0].startswith("board: 2498 samples, 2 lost")
    assert "made/run.csv: 1000 samples" in written.lines[-1]


def test_every_stretch_is_written() -> None:
    decoder = decoded(stream(with_a_gap()))
    decoder.finish()
    written = write_stream((decoder, usable_stretches(decoder)), Path("run.csv"), "board", every=True,
                           texts={"memory": "reset"})
    assert [told["file"] for told in written.recordings] == ["run-1.csv", "run-2.csv", "run-3.csv"]
    assert [len(read_recording(told["file"])) for told in written.recordings] == [1000, 999, 499]
    assert all(told["metadata"]["memory"] == "reset" for told in written.recordings)
    assert all(line.endswith("memory: reset") for line in written.lines[-3:])


def test_how_a_stream_ended() -> None:
    assert how_it_ended(decoded(stream(samples(20)))) == "the target had finished"
    assert "before the target had finished" in how_it_ended(decoded(stream(samples(20), finished=0)))
    reset = decoded(stream(samples(20), finished=0) + Info(streams.RESET).frame())
    assert how_it_ended(reset) == "the target refuses to run: its watchdog has reset it; it now outputs its safe code"


def test_how_a_recording_goes_on() -> None:
    assert "the first frame" in how_it_goes(decoded(b""))
    assert "a reset" in how_it_goes(decoded(b"\0" + Info(streams.FINISHED).frame()))
    sent = samples(1500, adc_counts=1000)
    assert how_it_goes(decoded(stream(sent, finished=0))).startswith("1500 samples, 0 lost, 1.5 um")
    assert "um" not in how_it_goes(decoded(stream(samples(20, adc_counts=streams.NO_READING), finished=0)))


def test_files_that_a_recording_must_leave_alone(here: Path) -> None:
    check_recording_outputs("/dev/null", ["run.csv"], ["log.json", "raw.bin"])
    check_recording_outputs("socket://localhost:1234", ["run.csv"])
    for others, every, message in ((["/dev/null"], False, "/dev/null: is the port"),
                                   (["run.csv.part2"], False, "run.csv.part2: is used for samples"),
                                   (["run.csv"], False, "run.csv: would be written over another output"),
                                   (["run-4.csv"], True, "run-4.csv: would be written over another output")):
        with pytest.raises(BadInput, match=message):
            check_recording_outputs("/dev/null", ["run.csv"], others, every)
    with pytest.raises(BadInput, match="is the port"):
        check_recording_outputs("run.csv", ["run.csv"])


def test_a_live_recording(board: Board, here: Path) -> None:
    data, goes = stream(samples(2500)), []
    board.later(lambda: board.send(data))
    recorded = record_file(board.port, ["run.csv"], raw="raw.bin", texts={"actuator": "stack 7"},
                           report=lambda decoder: goes.append(decoder.counts.samples))
    assert recorded.why == "the target has finished" and recorded.failures == []
    assert (here / "raw.bin").read_bytes() == data
    assert sorted(path.name for path in here.iterdir()) == ["raw.bin", "run.csv"]
    run = read_recording("run.csv")
    assert len(run) == 2500 and run.metadata["actuator"] == "stack 7"
    assert np.array_equal(run.columns["dac_code"], [sample.dac_code for sample in samples(2500)])


def test_a_live_recording_that_breaks_off(board: Board, here: Path) -> None:
    """What came is written and what went wrong is told."""
    board.later(lambda: board.send(stream(samples(2500), finished=0)), lambda: time.sleep(1), board.unplug)
    recorded = record_file(board.port, ["run.csv"])
    assert "the connection to the port was lost" in recorded.failures[0] and "the samples before that have been written" in recorded.failures[0]
    assert len(read_recording("run.csv")) >= 1000 and recorded.written[0].stream["finished"] is False


def test_a_live_recording_without_a_sample(board: Board, here: Path) -> None:
    board.later(lambda: os.kill(os.getpid(), signal.SIGINT))
    with pytest.raises(BadInput, match=f"{board.port}: no samples: stopped"):
        record_file(board.port, ["run.csv"])
    assert list(here.iterdir()) == []
