"""Several axes of a board on one line: each becomes a recording of its own, with the drives of the others."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import streams
from click.testing import CliRunner
from ports import Board
from streams import Info, Sample, samples

from rdpi.board import Decoder, check_recording_outputs, read_stream, record_file
from rdpi.board.stretches import stretches
from rdpi.cli.program import main
from rdpi.data import read_recording
from rdpi.errors import BadInput

INFOS = [Info(axis=axis, min_V=0.0, max_V=50.0 * (axis + 1)) for axis in range(3)]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def sent(axes: int, count: int = 300) -> list[list[Sample]]:
    """Samples of each axis, other numbers on each."""
    return [samples(count, seed=axis, axis=axis) for axis in range(axes)]


def interleaved(of: list[list[Sample]], finished: bool = True) -> bytes:
    """What a board sends: infos, then in every tick a sample of each axis."""
    ends = [max((sample.sequence + 1 for sample in one), default=0) for one in of]
    by_tick = sorted((sample for one in of for sample in one), key=lambda sample: (sample.tick, sample.axis))
    return b"".join([*(replace(INFOS[axis], state=streams.STARTING).frame() for axis in range(len(of))),
                     *(sample.frame() for sample in by_tick),
                     *(replace(INFOS[axis], state=streams.FINISHED, offered=ends[axis]).frame()
                       for axis in range(len(of)) if finished)])


def heard(data: bytes, axis: int) -> Decoder:
    decoder = Decoder("board", axis)
    decoder.feed(data)
    decoder.finish()
    return decoder


def volts(one: list[Sample]) -> np.ndarray:
    info = INFOS[one[0].axis]
    return np.array([sample.dac_code for sample in one]) * (info.max_V / 65535)


def test_an_axis_is_heard_as_if_the_others_were_not_there() -> None:
    of = sent(3)
    together = interleaved(of)
    for axis, one in enumerate(of):
        alone = b"".join([replace(INFOS[axis], state=streams.STARTING).frame(), *(sample.frame() for sample in one),
                          replace(INFOS[axis], state=streams.FINISHED, offered=300).frame()])
        among, by_itself = heard(together, axis), heard(alone, axis)
        assert among.counts == by_itself.counts and among.counts.samples == 300 and among.counts.corrupt == 0
        assert (among.runs[0].samples == by_itself.runs[0].samples).all()
        assert among.axes == [axis, *(other for other in range(3) if other != axis)] and by_itself.axes == [axis]


def test_losses_are_counted_for_each_axis() -> None:
    of = sent(2)
    of[1] = [sample for sample in of[1] if sample.sequence not in (100, 101)]
    data = interleaved(of)
    assert [heard(data, axis).counts.lost for axis in (0, 1)] == [0, 2]


def test_a_single_frame_of_an_axis_is_no_axis() -> None:
    of = sent(1)
    assert heard(interleaved(of) + replace(INFOS[2], axis=2).frame(), 0).axes == [0]


def test_an_axis_that_is_not_there() -> None:
    with pytest.raises(BadInput, match="board: has nothing of axis 2, but of 0, 1"):
        heard(interleaved(sent(2)), 2)


def test_the_drive_of_the_other_axis_is_a_column() -> None:
    of = sent(2)
    decoders = [heard(interleaved(of), axis) for axis in (0, 1)]
    for axis in (0, 1):
        (stretch,) = stretches(decoders[axis], others=[decoders[1 - axis]])
        assert stretch.columns["command_V"] == pytest.approx(volts(of[axis]))
        assert stretch.columns["other_axis_V"] == pytest.approx(volts(of[1 - axis]))


def test_of_more_axes_each_has_a_column() -> None:
    of = sent(3)
    decoders = [heard(interleaved(of), axis) for axis in range(3)]
    (stretch,) = stretches(decoders[1], others=[decoders[0], decoders[2]])
    assert stretch.columns["axis_0_V"] == pytest.approx(volts(of[0]))
    assert stretch.columns["axis_2_V"] == pytest.approx(volts(of[2]))
    assert "other_axis_V" not in stretch.columns and "axis_1_V" not in stretch.columns


def test_where_the_other_axis_lost_a_sample_its_drive_is_the_one_before() -> None:
    of = sent(2)
    expected = volts(of[1])
    expected[100:102] = expected[99]
    of[1] = [sample for sample in of[1] if sample.sequence not in (100, 101)]
    decoders = [heard(interleaved(of), axis) for axis in (0, 1)]
    (stretch,) = stretches(decoders[0], others=[decoders[1]])
    assert stretch.columns["other_axis_V"] == pytest.approx(expected)


def test_an_axis_that_begins_later_is_no_column() -> None:
    of = sent(2)
    of[1] = of[1][100:]
    decoders = [heard(interleaved(of), axis) for axis in (0, 1)]
    (stretch,) = stretches(decoders[0], others=[decoders[1]])
    assert "other_axis_V" not in stretch.columns


def test_a_stored_stream(here: Path) -> None:
    of = sent(2)
    (here / "kept.bin").write_bytes(interleaved(of))
    for axis in (0, 1):
        done = CliRunner().invoke(main, ["import", "--telemetry", "kept.bin", "--axis", str(axis), "-o", f"{axis}.csv"])
        assert done.exit_code == 0 and f"the file has axis {1 - axis} too, see --axis" in done.output
        run = read_recording(f"{axis}.csv")
        assert run.command_V == pytest.approx(volts(of[axis]), abs=1e-6)
        assert run.columns["other_axis_V"] == pytest.approx(volts(of[1 - axis]), abs=1e-6)
    with pytest.raises(BadInput, match="kept.bin: has nothing of axis 5, but of 0, 1"):
        read_stream("kept.bin", axis=5)
    done = CliRunner().invoke(main, ["import", "run.csv", "--axis", "1", "-o", "1.csv"])
    assert done.exit_code == 2 and "--axis: is only valid with --telemetry" in done.output


def test_a_live_recording(board: Board, here: Path) -> None:
    of = sent(2)
    board.later(lambda: board.send(interleaved(of)))
    done = CliRunner().invoke(main, ["record", board.port, "-o", "x.csv", "-o", "y.csv", "--json", "told.json"])
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in here.iterdir()) == ["told.json", "x.csv", "y.csv"]
    for axis, name in enumerate("xy"):
        run = read_recording(f"{name}.csv")
        assert run.columns["dac_code"].tolist() == [sample.dac_code for sample in of[axis]]
        assert run.columns["other_axis_V"] == pytest.approx(volts(of[1 - axis]), abs=1e-6)
    told = json.loads((here / "told.json").read_text())
    assert [one["file"] for one in told["recordings"]] == ["x.csv", "y.csv"]
    assert [one["counts"]["samples"] for one in (told, *told["further_axes"])] == [300, 300]


def test_an_axis_that_is_not_recorded_is_told(board: Board, here: Path) -> None:
    board.later(lambda: board.send(interleaved(sent(2))))
    recorded = record_file(board.port, ["x.csv"])
    assert any("the target has axis 1 too" in line for line in recorded.written[0].lines)


def test_more_files_than_axes(board: Board, here: Path) -> None:
    """What there is of the one axis stays beside its file's name."""
    board.later(lambda: board.send(interleaved(sent(1))))
    with pytest.raises(BadInput, match="the target has no axis 1: give -o once for each axis; the samples are in "
                                       f"{here / 'x.csv.part'}$"):
        record_file(board.port, ["x.csv", "y.csv"])
    assert len(read_recording("x.csv.part")) == 300


def test_of_an_axis_that_cannot_be_written_the_others_are_told(board: Board, here: Path) -> None:
    of = sent(2)
    board.later(lambda: board.send(interleaved([of[0], of[1][:10]])))
    with pytest.raises(BadInput, match=f"no 16 samples without a gap .*; the samples are in {here / 'x.csv.part'}$"):
        record_file(board.port, ["x.csv", "y.csv"])
    assert len(read_recording("x.csv.part")) == 300


def test_an_axis_that_refuses_ends_the_recording(board: Board, here: Path) -> None:
    board.later(lambda: board.send(b"\0" + replace(INFOS[1], state=streams.REFUSED, status=-17).frame() * 2))
    with pytest.raises(BadInput, match="refuses to run"):
        record_file(board.port, ["x.csv", "y.csv"])


@pytest.mark.parametrize("outputs, message", [(["a.csv", "a.csv"], "would be written over another output"),
                                              (["a.csv", "a.csv.part"], "is used for samples during the recording"),
                                              (["a.csv", "/dev/null"], "is the port")])
def test_outputs_that_are_in_each_others_way(outputs: list[str], message: str) -> None:
    with pytest.raises(BadInput, match=re.escape(message)):
        check_recording_outputs("/dev/null", outputs)


def test_an_import_writes_one_axis(here: Path) -> None:
    """Of two outputs the second would hold the first axis."""
    Path("stream.bin").write_bytes(interleaved(sent(2)))
    done = CliRunner().invoke(main, ["import", "--telemetry", "stream.bin", "-o", "x.csv", "-o", "y.csv"])
    assert done.exit_code == 2 and "give it once" in done.output and "--axis" in done.output
    assert [path.name for path in here.iterdir()] == ["stream.bin"]
    done = CliRunner().invoke(main, ["import", "--telemetry", "stream.bin", "--axis", "1", "-o", "y.csv"])
    assert done.exit_code == 0 and Path("y.csv").exists()
