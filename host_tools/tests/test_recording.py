"""Recordings: what is written reads back, and what cannot be used is refused with file, place and remedy."""

from __future__ import annotations

import hashlib
import os
import stat
import string
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from rdpi.data.recording import (MIN_SAMPLES, GrowingRecording, atomic_write, is_column_name, read_recording,
                                 sample_times, write_recording)
from rdpi.errors import BadInput

HEADER = "time_s,command_V,displacement_um"


def rows(count: int = 20, rate_hz: float = 1000) -> list[str]:
    return [f"{index / rate_hz:.7f},{index}.5,{2 * index}.25" for index in range(count)]


def text(*, metadata: str = "", header: str = HEADER, lines: list[str] | None = None) -> str:
    return f"{metadata}{header}\n" + "".join(line + "\n" for line in (rows() if lines is None else lines))


def replaced(index: int, line: str) -> list[str]:
    lines = rows()
    lines[index] = line
    return lines


def times(values: np.ndarray) -> list[str]:
    return [f"{value:.10g},1,2" for value in values]


UNIFORM = sample_times(20, 1000)

BAD = {
    "empty": ("", ["run.csv", "is empty", HEADER]),
    "blank": ("\n \n", ["run.csv", "is empty"]),
    "metadata only": ("# note: x\n", ["run.csv", "contains no column names"]),
    "no samples": (text(lines=[]), ["run.csv", "0 samples", "at least 16"]),
    "too short": (text(lines=rows(15)), ["run.csv", "15 samples", "at least 16"]),
    "missing column": (text(metadata="# note: x\n\n", header="time_s,command_V,pos_nm"),
                       ["run.csv:3", "no column displacement_um", "time_s, command_V, pos_nm", "rdpi import"]),
    "missing time": (text(header="t,command_V,displacement_um"), ["run.csv:1", "no column time_s", "rdpi import"]),
    "other separator": (text().replace(",", ";"), ["run.csv:1", "no column time_s", "rdpi import"]),
    "no header": (text(header="0.1,2,3"), ["run.csv:1", "column names", "rdpi import"]),
    "column twice": (text(header="time_s,command_V,displacement_um,x,x", lines=[row + ",1,1" for row in rows()]),
                     ["run.csv:1", "column x exists twice", "rename"]),
    "column without name": (text(header=HEADER + ",", lines=[row + ",1" for row in rows()]),
                            ["run.csv:1", "column 4 has no name", "name it"]),
    "column with a quotation mark": (text(header=HEADER + ',q"r', lines=[row + ",1" for row in rows()]),
                                     ["run.csv:1", "column 4", "'q\"r'", "use a name without"]),
    "column like a comment": (text(header=HEADER + ",#4", lines=[row + ",1" for row in rows()]),
                              ["run.csv:1", "column 4", "'#4'", "use a name without"]),
    "absurd times": (text(lines=[f"{1e307 * index},1,2" for index in range(-17, 17)]),
                     ["run.csv:3", "steps by", "times in seconds"]),
    "tiny times": (text(lines=[f"{5e-324 * index},1,2" for index in range(20)]), ["run.csv:3", "times in seconds"]),
    "text": (text(lines=replaced(4, "0.004,volt,3")), ["run.csv:6", "column command_V is 'volt', not a number"]),
    "text after blank lines": (text(metadata="# note: x\n", lines=["", *replaced(4, "0.004,1,3 um"), ""]),
                               ["run.csv:8", "column displacement_um is '3 um'"]),
    "empty field": (text(lines=replaced(4, "0.004,,3")), ["run.csv:6", "column command_V is empty", "correct"]),
    "text that Python takes for a number": (text(lines=replaced(0, "0,1_0,3")), ["run.csv:2", "'1_0', not a number"]),
    "NaN": (text(lines=replaced(7, "0.007,1,NaN")), ["run.csv:9", "column displacement_um is NaN", "interpolate"]),
    "infinity": (text(lines=replaced(7, "0.007,-inf,1")), ["run.csv:9", "column command_V is -inf", "finite"]),
    "overflow": (text(lines=replaced(7, "0.007,1e999,1")), ["run.csv:9", "column command_V is 1e999", "finite"]),
    "digits without end": (text(lines=replaced(7, f"0.007,{1000 * '9'},1")), [f"column command_V is {40 * '9'}…; every"]),
    "short row": (text(lines=replaced(9, "0.009,1")), ["run.csv:11", "2 value(s) instead of 3"]),
    "long row": (text(lines=replaced(9, "0.009,1,5,2,5")), ["run.csv:11", "5 value(s) instead of 3"]),
    "every row short": (text(lines=["0.1,2"] * 20), ["run.csv:2", "2 value(s) instead of 3"]),
    "cut in half": (text()[:-7], ["run.csv:21", "2 value(s)"]),
    "second recording appended": (text() + text(metadata="# memory: reset\n"), ["run.csv:22", "1 value(s)"]),
    "backwards": (text(lines=replaced(5, "0.0035,1,2")), ["run.csv:7", "time_s runs backwards", "0.004 then 0.0035"]),
    "repeated time": (text(lines=replaced(5, "0.004,1,2")), ["run.csv:7", "time_s repeats", "rdpi import --rate"]),
    "lost sample": (text(lines=times(np.delete(sample_times(21, 1000), 12))),
                    ["run.csv:14", "not uniform", "steps by 0.002 here and by 0.001", "this is row 12"]),
    "rate changes": (text(lines=times(np.cumsum([0.001] * 300 + [0.00102] * 300))),
                     ["run.csv:", "not uniform", "resample"]),
    "random sampling": (text(lines=times(UNIFORM + 4e-4 * np.sin(7 * np.arange(20)))), ["run.csv:", "not uniform"]),
    "rate contradicts": (text(metadata="# note: x\n# sample_rate_hz: 2000\n"),
                         ["run.csv:2", "sample_rate_hz is 2000, but the times give 1000", "correct the wrong one"]),
    "rate slightly wrong": (text(metadata="# sample_rate_hz: 1010\n", lines=rows(1000)), ["run.csv:1", "is 1010"]),
    "rate not a number": (text(metadata="# sample_rate_hz: 1 kHz\n"), ["run.csv:1", "'1 kHz'", "positive number"]),
    "rate absurd": (text(metadata="# sample_rate_hz: 1e-300\n"), ["run.csv:1", "'1e-300'", "1e-06 to 1e+08"]),
    "rate zero": (text(metadata="# sample_rate_hz: 0\n"), ["run.csv:1", "positive number"]),
    "rate twice": (text(metadata="# sample_rate_hz: 1000\n# sample_rate_hz: 1000\n"), ["run.csv:2", "positive number"]),
    "memory": (text(metadata="# memory: erased\n"), ["run.csv:1", "'erased'", "reset, low, high, carried, unknown"]),
    "key in capitals": (text(metadata="# note: x\n# Memory: reset\n"), ["run.csv:2", "write memory", "'Memory'"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_recording(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content, needles = BAD[name]
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text(content)
    with pytest.raises(BadInput) as error:
        read_recording("run.csv")
    for needle in needles:
        assert needle in str(error.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"nowhere\.csv: cannot be read.*check the file name"):
        read_recording(tmp_path / "nowhere.csv")
    with pytest.raises(BadInput, match="cannot be read"):
        read_recording(tmp_path)


def test_not_utf8(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(b"# actuator: a\n# note: \xb5m\n" + text().encode())
    with pytest.raises(BadInput, match=r"run\.csv:2: is not UTF-8.*rdpi import"):
        read_recording(path)


def test_line_ends_byte_order_mark_quotes_and_blank_lines(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text())
    plain = read_recording(path)
    header = ",".join(f'"{name}"' for name in HEADER.split(","))
    content = text(metadata="# note: µm\n")
    for variant in (content.replace("\n", "\r\n"), content.replace("\n", "\r"), "\ufeff" + content,
                    text(metadata="\n#a comment\n#note:µm\n\n", header=header) + "\n\n"):
        path.write_bytes(variant.encode())
        recording = read_recording(path)
        assert recording.metadata == {"note": "µm"}
        for name, column in plain.columns.items():
            np.testing.assert_array_equal(recording.columns[name], column)


def test_properties(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text(metadata="# memory: reset\n", header=HEADER + ",reference_um,other_axis_V",
                         lines=[row + ",7,8" for row in rows()]))
    recording = read_recording(path)
    assert len(recording) == 20 and recording.path == str(path)
    assert recording.memory == "reset" and recording.sample_rate_hz == 1000 and recording.sample_time_s == 0.001
    assert list(recording.columns) == ["time_s", "command_V", "displacement_um", "reference_um", "other_axis_V"]
    assert all(column.dtype == np.float64 and column.shape == (20,) for column in recording.columns.values())
    assert recording.reference_um[3] == 7 and recording.columns["other_axis_V"][3] == 8
    assert recording.command_V[3] == 3.5 and recording.displacement_um[3] == 6.25
    assert recording.digest == "sha256:" + hashlib.sha256(path.read_bytes()).hexdigest()


def test_required_columns_are_the_callers(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_text("time_s,command_V\n" + "".join(row.rpartition(",")[0] + "\n" for row in rows()))
    drive = read_recording(path, required=("command_V",))
    assert drive.displacement_um is None and drive.memory == "unknown"
    with pytest.raises(BadInput, match="no column reference_um"):
        read_recording(path, required=("reference_um",))


@pytest.mark.parametrize("form", ["{:.7f}", "{:.7g}", "{:.12g}"])
@pytest.mark.parametrize("rate_hz", [200, 3000, 10_000, 44_100])
def test_rounded_times_pass(form: str, rate_hz: float, tmp_path: Path) -> None:
    """Seven digits are enough up to the time where they resolve a quarter of a sample."""
    count = 20_000 if rate_hz <= 3000 else 2000
    path = tmp_path / "run.csv"
    path.write_text(text(lines=[form.format(index / rate_hz) + ",1,2" for index in range(count)]))
    assert read_recording(path).sample_rate_hz == pytest.approx(rate_hz, rel=1e-5)


def test_jitter_and_offset_of_time_pass(tmp_path: Path) -> None:
    jitter = 1e-4 * np.random.default_rng(1).uniform(-1, 1, 500)
    path = tmp_path / "run.csv"
    path.write_text(text(metadata="# sample_rate_hz: 1000\n", lines=times(100 + sample_times(500, 1000) + jitter)))
    recording = read_recording(path)
    assert recording.sample_rate_hz == 1000 and recording.time_s[0] > 99


finite = st.floats(allow_nan=False, allow_infinity=False)
words = st.text(st.characters(blacklist_categories=("Cs", "Cc", "Zl", "Zp")), max_size=20).map(str.strip)
names = st.text(string.ascii_letters + string.digits + "_ µ.#\"'", min_size=1, max_size=12).map(str.strip)


@settings(max_examples=60)
@given(data=st.data(), rate_hz=st.sampled_from([50, 1000, 3000, 1e4, 48_000]), start_s=st.sampled_from([0, -3.5, 1e4]))
def test_round_trip(data: st.DataObject, rate_hz: float, start_s: float,
                    tmp_path_factory: pytest.TempPathFactory) -> None:
    """Every float64 and every metadata text comes back, in order."""
    count = data.draw(st.integers(16, 40))
    columns = {"time_s": start_s + sample_times(count, rate_hz)}
    further = names.filter(lambda name: is_column_name(name) and name not in ("time_s", "command_V"))
    extra = data.draw(st.lists(further, max_size=3, unique=True))
    for name in ["command_V", *extra]:
        columns[name] = np.array(data.draw(st.lists(finite, min_size=count, max_size=count)))
    keys = words.filter(lambda key: key and ":" not in key and key not in ("sample_rate_hz", "memory"))
    metadata = data.draw(st.dictionaries(keys, words, max_size=4))
    path = tmp_path_factory.getbasetemp() / "round_trip.csv"
    write_recording(path, columns, metadata)
    back = read_recording(path, required=("command_V",))
    assert list(back.metadata.items()) == list(metadata.items())
    assert list(back.columns) == list(columns)
    for name, column in columns.items():
        np.testing.assert_array_equal(back.columns[name], column)


def test_writer_format(tmp_path: Path, run_columns: dict[str, np.ndarray]) -> None:
    path = tmp_path / "run.csv"
    write_recording(path, run_columns | {"dac_code": np.arange(200.0)}, {"actuator": "P-885.91", "note": "one\ntwo"})
    lines = path.read_text().splitlines()
    assert lines[:5] == ["# actuator: P-885.91", "# note: one", "# note: two", HEADER + ",dac_code", "0.0,0.0,0.3,0"]
    assert len(lines) == 204
    assert read_recording(path).metadata == {"actuator": "P-885.91", "note": "one\ntwo"}


def test_writer_refuses_what_it_could_not_read(tmp_path: Path, run_columns: dict[str, np.ndarray]) -> None:
    path = tmp_path / "run.csv"
    nan = np.full(200, np.nan)
    for columns, metadata in (({"time_s": nan}, {}), (run_columns | {"a,b": nan}, {}), (run_columns | {" a": nan}, {}),
                              (run_columns | {"\udcff": nan}, {}), (run_columns, {"note": "\udcff"}),
                              (run_columns | {"short": np.zeros(3)}, {}), ({}, {}), (run_columns, {"a: b": 1}),
                              (run_columns, {"": 1})):
        with pytest.raises(ValueError):
            write_recording(path, columns, metadata)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), SystemExit(143), KeyboardInterrupt()])
def test_atomic_write_keeps_the_old_file_when_it_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                       error: BaseException) -> None:
    path = tmp_path / "out.csv"
    path.write_text("as it was")

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(type(error)):
        atomic_write(path, "new")
    assert path.read_text() == "as it was" and list(tmp_path.iterdir()) == [path]


@pytest.fixture
def growing(tmp_path: Path, run_columns: dict[str, np.ndarray]) -> Path:
    """What a recording that was not closed has left: 40 samples, in two parts."""
    path = tmp_path / "run.csv.part"
    parts = [{name: column[part] for name, column in run_columns.items()} for part in (slice(20), slice(20, 40))]
    GrowingRecording(path, parts[0], {"note": "x"}, "it had not ended").append(parts[1])
    return path


def test_a_growing_recording_can_be_read_wherever_it_is_cut(growing: Path,
                                                            run_columns: dict[str, np.ndarray]) -> None:
    data = growing.read_bytes()
    first = len(b"\n".join(data.split(b"\n")[:3 + MIN_SAMPLES])) + 1
    for size in range(first, len(data) + 1):
        growing.write_bytes(data[:size])
        run = read_recording(growing)
        assert len(run) == data[:size].count(b"\n") - 3
        assert run.displacement_um.tolist() == run_columns["displacement_um"][:len(run)].tolist()
    assert len(run) == 40 and run.metadata == {"unfinished": "it had not ended", "note": "x"}


def test_of_a_growing_recording_nothing_is_read_that_had_not_reached_the_disk(growing: Path) -> None:
    data = growing.read_bytes()
    growing.write_bytes(data[:-300] + bytes(200) + data[-100:])
    assert len(read_recording(growing)) == data[:-300].count(b"\n") - 3


def test_a_growing_recording_that_is_imported_does_not_grow_any_more(growing: Path, tmp_path: Path,
                                                                     rdpi: Callable) -> None:
    growing.write_bytes(growing.read_bytes()[:-3])
    done = rdpi("import", growing, "-o", tmp_path / "run.csv")
    assert done.exit_code == 0, done.output
    run = read_recording(tmp_path / "run.csv")
    assert len(run) == 39 and run.metadata["note"] == "x" and "unfinished" not in run.metadata


def test_a_last_line_without_its_end_counts_where_nothing_is_growing(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text().rstrip("\n"))
    assert len(read_recording(path)) == len(rows())


def test_samples_that_no_file_can_hold_are_not_appended(tmp_path: Path, run_columns: dict[str, np.ndarray]) -> None:
    growing = GrowingRecording(tmp_path / "run.csv.part", run_columns, {}, "it had not ended")
    data = growing.path.read_bytes()
    with pytest.raises(ValueError, match="NaN"):
        growing.append({name: np.full(3, np.nan) for name in run_columns})
    assert growing.path.read_bytes() == data


def test_the_fastest_recording_there_may_be(tmp_path: Path) -> None:
    """Its times are 1e-8 s apart but for their rounding."""
    times_s = sample_times(40, 1e8)
    write_recording(tmp_path / "run.csv", dict.fromkeys(("time_s", "command_V", "displacement_um"), times_s),
                    {"sample_rate_hz": 10**8})
    assert len(read_recording(tmp_path / "run.csv")) == 40


def test_atomic_write_modes_links_and_devices(tmp_path: Path) -> None:
    old_mask = os.umask(0o022)
    try:
        new, script, link = tmp_path / "new", tmp_path / "script", tmp_path / "link"
        atomic_write(new, "x")
        assert stat.S_IMODE(new.stat().st_mode) == 0o644
        script.write_text("old")
        script.chmod(0o640)
        link.symlink_to(script)
        atomic_write(link, b"new\n")
        assert link.is_symlink() and script.read_text() == "new\n" and stat.S_IMODE(script.stat().st_mode) == 0o640
        atomic_write("/dev/null", "x")
        assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
        with pytest.raises(OSError):
            atomic_write(tmp_path, "x")
        with pytest.raises(OSError) as error:
            atomic_write(tmp_path / "nowhere" / "out", "x")
        assert error.value.filename == str(tmp_path / "nowhere" / "out")
    finally:
        os.umask(old_mask)


def test_atomic_write_takes_long_names(tmp_path: Path) -> None:
    path = tmp_path / ("行" * 80 + ".c")  # 242 bytes
    atomic_write(path, "x")
    assert list(tmp_path.iterdir()) == [path]


def test_atomic_write_does_not_replace_a_loop_of_links(tmp_path: Path) -> None:
    path = tmp_path / "loop"
    path.symlink_to(path)
    with pytest.raises(OSError, match="loop"):
        atomic_write(path, "x")
    assert path.is_symlink()


def test_atomic_write_makes_the_file_of_a_link(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "new")
    atomic_write(tmp_path / "link", "x")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "new").read_text() == "x"


def test_atomic_write_writes_to_pipes(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    atomic_write(f"/dev/fd/{writer}", "x")  # as /dev/stdout in a pipeline
    os.close(writer)
    with open(reader) as pipe:
        assert pipe.read() == "x"
    os.mkfifo(tmp_path / "fifo")
    thread = threading.Thread(target=atomic_write, args=(tmp_path / "fifo", "y"))
    thread.start()
    assert (tmp_path / "fifo").read_text() == "y"
    thread.join()


def test_atomic_write_names_the_device_that_is_full() -> None:
    with pytest.raises(OSError, match="No space left") as error:
        atomic_write("/dev/full", "x")
    assert error.value.filename == "/dev/full"
