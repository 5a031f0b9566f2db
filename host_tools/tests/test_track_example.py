"""examples/track on the port `sim`: the firmware application built with CMake gives what the host tools compute."""

from __future__ import annotations

import csv
import io
import os
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rdpi.board import compensate
from rdpi.board.telemetry import Decoder, rates_um_per_s, references_um, volts
from rdpi.data import Recording, read_recording, write_recording
from rdpi.firmware import Firmware, FixedPoint, engine
from rdpi.firmware.header import render, write_header
from rdpi.firmware.parameters import f32
from rdpi.model import Drive, Memory, Model, Rate, read_model
from rdpi.simulate import inverse_of

ROOT = Path(__file__).resolve().parents[2]
PARAMS = ROOT / "examples/track/params"
RATE_HZ = 8000

Run = Callable[..., subprocess.CompletedProcess]


@pytest.fixture(scope="module")
def model() -> Model:
    """Not the shipped one: a rate without exact period, memory, offsets, guard and clips that the reference meets."""
    return replace(read_model(PARAMS / "model.json"), offset_V=0.3, offset_um=-0.2,
                   memory=Memory(0.5, np.array([0.5, 0.3, 0.1, *[0.0] * 7])),
                   rate=Rate("displacement", 9e-4, 2e-4, 500.0), drive=Drive(-1.7, 80.1, 30000.0, 15))


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Configure and build track with CMake, under the sanitizers; returns the program."""

    def run(*options: object) -> Path:
        folder = tmp_path_factory.mktemp("build")
        configure = ["cmake", "-S", ROOT, "-B", folder, "--preset", "sanitize", "-DRDPI_BUILD_TESTS=OFF",
                     "-DCMAKE_C_FLAGS_RELWITHDEBINFO=-O0", *options]  # a third of the time
        for command in (configure, ["cmake", "--build", folder, "--target", "track"]):
            done = subprocess.run(command, capture_output=True, text=True)
            assert done.returncode == 0, done.stdout + done.stderr
        return folder / "track"

    return run


@pytest.fixture(scope="module")
def program(build: Callable[..., Path], model: Model, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The application, built for `model`."""
    params = tmp_path_factory.mktemp("params")
    write_header(model, params / "rdpi_params.h")
    return build(f"-DRDPI_PARAMS_DIR={params}", f"-DRDPI_TRACK_RATE_HZ={RATE_HZ}")


@pytest.fixture(scope="module")
def track(program: Path) -> Run:
    """Run it with arguments and standard input."""
    return lambda *words, stdin="": subprocess.run([program, *words], input=stdin, capture_output=True, text=True)


@pytest.fixture(scope="module")
def reference() -> dict[str, np.ndarray]:
    """Half a second of 5, 20 and 35 Hz with a jump, beyond the drive's range at times."""
    time_s = np.arange(4000) / RATE_HZ
    amplitudes = ((5, 4.0), (20, 1.5), (35, 0.6))
    reference_um = 3 + sum(um * np.sin(2 * np.pi * hz * time_s) for hz, um in amplitudes)
    reference_um[2500] += 1.0
    return {"time_s": np.round(time_s, 9), "reference_um": reference_um}


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(line for line in io.StringIO(text) if not line.startswith("#")))


def nine_digits(values: np.ndarray) -> list[str]:
    return [f"{value:.9g}" for value in values.tolist()]


def test_codes_and_volts_are_those_of_the_host_tools_to_the_bit(track: Run, model: Model, reference: dict,
                                                                tmp_path: Path) -> None:
    write_recording(tmp_path / "reference.csv", reference, {"note": "commas, and : colons"})
    done = track(tmp_path / "reference.csv", "--dac", "15:-1.7:80.1", "-o", tmp_path / "drive.csv")
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    got = rows((tmp_path / "drive.csv").read_text())

    firmware = Firmware(model, 1 / RATE_HZ, "f32")
    expected = firmware.step(reference["reference_um"])
    assert [int(row["dac_code"]) for row in got] == expected.dac_code.tolist()
    assert [row["command_V"] for row in got] == nine_digits(expected.drive_V)
    assert [row["reference_um"] for row in got] == nine_digits(reference["reference_um"].astype(np.float32))
    assert [float(row["time_s"]) for row in got] == reference["time_s"].tolist()

    counts = [int(number) for number in re.findall(r"\d+", done.stderr)]
    assert counts == [firmware.counts["guard"], firmware.counts["clip"], 0, 0]
    assert min(counts[:2]) > 0, "the reference was meant to meet guard and limits"


def test_volts_of_a_dac_whose_range_over_its_codes_rounds_up(build: Callable[..., Path], reference: dict,
                                                             tmp_path: Path) -> None:
    """140 V over 4095, rounded, would put the last code beyond 120 V: the host tools take the number below."""
    model = replace(read_model(PARAMS / "model.json"), drive=Drive(-20.0, 120.0, None, 12))
    step_V = np.float32(140 / 4095)
    assert f32(model).V_per_code == np.nextafter(step_V, np.float32(0)) < step_V
    reference_um = np.concatenate([[1e4, -1e4], 3 * reference["reference_um"]])
    write_header(model, tmp_path / "rdpi_params.h")
    write_recording(tmp_path / "x.csv", {"reference_um": reference_um}, {})
    program = build(f"-DRDPI_PARAMS_DIR={tmp_path}", f"-DRDPI_TRACK_RATE_HZ={RATE_HZ}")
    done = subprocess.run([program, "x.csv", "--dac", "12:-20:120"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    expected = Firmware(model, 1 / RATE_HZ, "f32").step(reference_um)
    codes = [int(row["dac_code"]) for row in rows(done.stdout)]
    assert codes == expected.dac_code.tolist() and min(codes) == 0 and max(codes) == 4095 and len(set(codes)) > 300
    assert [row["command_V"] for row in rows(done.stdout)] == nine_digits(expected.drive_V)


def test_what_it_writes_is_a_recording_of_a_drive(track: Run, reference: dict, tmp_path: Path) -> None:
    write_recording(tmp_path / "reference.csv", reference, {})
    assert track(tmp_path / "reference.csv", "--dac", "15:0:1", "-o", tmp_path / "drive.csv").returncode == 0
    drive = read_recording(tmp_path / "drive.csv", required=("time_s", "command_V", "reference_um", "dac_code"))
    assert (len(drive), drive.sample_rate_hz) == (4000, RATE_HZ)


def test_what_it_tells_the_host_is_what_it_did(track: Run, model: Model, reference: dict, tmp_path: Path) -> None:
    write_recording(tmp_path / "reference.csv", reference, {})
    done = track(tmp_path / "reference.csv", "-o", tmp_path / "drive.csv", "--telemetry", tmp_path / "stream")
    assert done.returncode == 0, done.stderr
    decoder = Decoder("track")
    decoder.feed((tmp_path / "stream").read_bytes())
    decoder.finish()
    (run,) = decoder.runs
    assert run.started and run.finished
    assert (decoder.counts.samples, decoder.counts.missing, decoder.counts.corrupt) == (4000, 0, 0)

    firmware = Firmware(model, 1 / RATE_HZ, "f32")
    expected, info, samples = firmware.step(reference["reference_um"]), run.info, run.samples
    assert samples["tick"].tolist() == list(range(1, 4001))
    for name in ("dac_code", "flags"):
        assert samples[name].tolist() == getattr(expected, name).tolist()
    assert rates_um_per_s(info, samples).tolist() == expected.rate_um_per_s.tolist()
    assert references_um(info, samples).tolist() == reference["reference_um"].astype(np.float32).tolist()
    np.testing.assert_allclose(volts(info, samples["dac_code"]), expected.drive_V, rtol=0, atol=1e-4)
    assert (info.rate_hz, info.dac_bits, info.min_V, info.max_V, info.offered_count) == (RATE_HZ, 15, -1.7, 80.1, 4000)
    counts = {name: getattr(info, f"{name}_count") for name in firmware.counts}
    assert counts == firmware.counts


def test_in_fixed_point_and_after_the_sweep(build: Callable[..., Path], reference: dict, tmp_path: Path) -> None:
    """The sweep's ticks write no rows; the references then begin where it has left the actuator."""
    model = read_model(PARAMS / "model.json")
    program = build("-DRDPI_TRACK_Q31=ON", "-DRDPI_TRACK_SWEEP=ON", f"-DRDPI_TRACK_RATE_HZ={RATE_HZ}")
    write_recording(tmp_path / "reference.csv", reference, {})
    done = subprocess.run([program, tmp_path / "reference.csv"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    firmware = FixedPoint(model, 1 / RATE_HZ)
    firmware.sweep()
    codes = firmware.step(reference["reference_um"]).dac_code
    assert [int(row["dac_code"]) for row in rows(done.stdout)] == codes.tolist()


@pytest.mark.parametrize("number", [pytest.param("f32", marks=pytest.mark.long), "q31"])
def test_what_stands_around_the_actuator_is_compensated_with_the_rows_that_follow(
        build: Callable[..., Path], model: Model, reference: dict, tmp_path: Path, number: str) -> None:
    """The chain is given the reference of later rows, and beyond the end the last; the present one is written."""
    late = replace(model, effects=[{"name": "delay", "parameters": {"delay_s": 1e-3}},
                                   {"name": "lag", "parameters": {"time_constant_s": 3e-4}},
                                   {"name": "creep", "parameters": {"percent_per_decade": 2.0}}])
    by = inverse_of(late)
    write_header(by.model, tmp_path / "rdpi_params.h", chain=by.chain)
    program = build(f"-DRDPI_PARAMS_DIR={tmp_path}", f"-DRDPI_TRACK_RATE_HZ={RATE_HZ}",
                    f"-DRDPI_TRACK_Q31={number == 'q31'}")
    write_recording(tmp_path / "reference.csv", reference, {})
    done = subprocess.run([program, tmp_path / "reference.csv"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    got = rows(done.stdout)
    firmware = engine(by.model, 1 / RATE_HZ, number, by.chain)
    assert firmware.preview_samples == 10
    wanted = np.concatenate([reference["reference_um"][10:], np.full(10, reference["reference_um"][-1])])
    assert [int(row["dac_code"]) for row in got] == firmware.step(wanted).dac_code.tolist()
    assert [row["reference_um"] for row in got] == nine_digits(reference["reference_um"].astype(np.float32))


def test_as_a_filter(track: Run, tmp_path: Path) -> None:
    done = track(stdin="\ufeff# a comment\n\nspare, reference_um\r\n-, 1.5\r\nnan,2\r\n")
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert lines[:2] == [f"# sample_rate_hz: {RATE_HZ}", "time_s,reference_um,dac_code"]
    assert [line.rpartition(",")[0] for line in lines[2:]] == ["0.000000000,1.5", "0.000125000,2"]


@pytest.mark.parametrize("text, message", [
    ("", "stdin: no samples"),
    ("# only\ntime_s,reference_um\n", "stdin: no samples"),
    ("time_s,command_V\n0,1\n", "stdin:1: no column reference_um"),
    ("# rate\n0,1\n", "stdin:2: no column reference_um"),
    ("time_s,reference_um\n0,1\n0.000125,abc\n", "stdin:3: reference_um is 'abc', not a number"),
    ("reference_um\n1\n\nnan\n", "stdin:4: reference_um is 'nan', not a number"),
    ("reference_um\n1e39\n", "stdin:2: reference_um is '1e39', not a number"),
    ("reference_um\n0x10\n", "stdin:2: reference_um is '0x10', not a number"),
    ("reference_um\n5\0006\n", "stdin:2: a NUL byte"),
    ("time_s,reference_um\n,1\n", "stdin:2: time_s is '', not a number"),
    ("time_s,reference_um\n0,1\n0.000125\n", "stdin:3: 1 values where there should be 2"),
    ("time_s,reference_um\n0,1,2\n", "stdin:2: 3 values where there should be 2"),
    ("time_s,reference_um\n0,1\n0.001,1\n", "stdin:3: time_s is 0.001 where 0.000125 is due: the application"),
    ("time_s,reference_um\n0,1\n-0.000125,1\n", "stdin:3: time_s is -0.000125 where"),
])
def test_bad_references_are_refused_with_their_place(track: Run, tmp_path: Path, text: str, message: str) -> None:
    done = track("-o", tmp_path / "drive.csv", stdin=text)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(message) and done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words, message", [
    (["nowhere.csv"], "nowhere.csv: cannot be opened"),
    (["/"], "/: cannot be read"),
    (["a.csv", "b.csv"], "b.csv: not understood"),
    (["--fast"], "--fast: not understood"),
    (["-o"], "-o needs a value"),
    (["--dac", "16:0"], "--dac 16:0: give BITS:MIN_V:MAX_V"),
    (["--dac", "0:0:1"], "--dac 0:0:1: give"),
    (["--dac", "25:0:1"], "--dac 25:0:1: give"),
    (["--dac", "16:1:1"], "--dac 16:1:1: give"),
    (["--dac", "16:nan:1"], "--dac 16:nan:1: give"),
    (["--dac", "16:0:1V"], "--dac 16:0:1V: give"),
    (["-o", "/nowhere/drive.csv"], "/nowhere/drive.csv: cannot be written"),
    (["-o", "/dev/full"], "/dev/full: cannot be written to its end"),
])
def test_bad_command_lines_are_refused(track: Run, words: list[str], message: str) -> None:
    done = track(*words, stdin="reference_um\n1\n")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith(message)


def test_a_code_beyond_the_dac_leaves_no_file(track: Run, tmp_path: Path) -> None:
    done = track("--dac", "4:0:1", "-o", tmp_path / "drive.csv", stdin="reference_um\n1\n")
    assert done.returncode == 2 and re.search(r"code \d+ does not fit the DAC of --dac", done.stderr)
    assert list(tmp_path.iterdir()) == []


def test_the_output_appears_when_it_is_complete(track: Run, tmp_path: Path) -> None:
    drive, link, fifo = tmp_path / "drive.csv", tmp_path / "link.csv", tmp_path / "fifo"
    drive.write_text("as it was")
    drive.chmod(0o640)
    link.symlink_to(drive)
    inode = drive.stat().st_ino
    assert track("-o", link, stdin="reference_um\n1\n").returncode == 0
    assert link.is_symlink() and drive.stat().st_ino != inode, "written in place, readers may see half of it"
    assert drive.stat().st_mode & 0o777 == 0o640 and len(rows(drive.read_text())) == 1
    assert sorted(tmp_path.iterdir()) == [drive, link]
    os.mkfifo(fifo)
    with subprocess.Popen(["cat", fifo], stdout=subprocess.PIPE, text=True) as reader:
        assert track("-o", fifo, stdin="reference_um\n1\n").returncode == 0
        assert reader.stdout.read() == drive.read_text()


def test_the_reference_is_not_written_over(track: Run, tmp_path: Path) -> None:
    reference, link = tmp_path / "reference.csv", tmp_path / "link.csv"
    reference.write_text("reference_um\n1\n")
    link.symlink_to(reference)
    for output in (reference, link):
        done = track(reference, "-o", output)
        assert done.returncode == 2 and done.stderr.startswith(f"{output}: is the reference itself")
    assert reference.read_text() == "reference_um\n1\n"


def test_no_output_is_a_reference_or_another_output(track: Run, tmp_path: Path,
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever they are called, and whether they are there or not. Nothing is written then."""
    monkeypatch.chdir(tmp_path)
    texts = {"ref.csv": "reference_um\n1\n", "old.csv": "as it was", "folder/held.csv": "as it was"}
    Path("folder").mkdir()
    for name, text in texts.items():
        Path(name).write_text(text)
    Path("link.csv").symlink_to("old.csv")
    Path("hard.csv").hardlink_to("ref.csv")
    Path("elsewhere").symlink_to("folder")
    there = sorted(tmp_path.rglob("*"))
    for drive, telemetry, message in [
            ("d.csv", "ref.csv", "ref.csv: is the reference itself; give the telemetry another name"),
            ("d.csv", "hard.csv", "hard.csv: is the reference itself; give the telemetry another name"),
            ("./hard.csv", "t", "./hard.csv: is the reference itself; give the drive another name"),
            ("d.csv", "d.csv", "d.csv: is a drive too; give the telemetry another name"),
            ("d.csv", "./d.csv", "./d.csv: is a drive too"),
            ("old.csv", "link.csv", "link.csv: is a drive too"),
            ("folder/new.csv", "elsewhere/new.csv", "elsewhere/new.csv: is a drive too"),
            ("folder/held.csv", "elsewhere/held.csv", "elsewhere/held.csv: is a drive too"),
            (f"{tmp_path}/d.csv", "folder/../d.csv", "folder/../d.csv: is a drive too"),
            ("-", "-", "-: is a drive too")]:
        done = track("ref.csv", "-o", drive, "--telemetry", telemetry)
        assert (done.returncode, done.stdout) == (2, "") and done.stderr.startswith(message), (drive, telemetry)
        assert sorted(tmp_path.rglob("*")) == there and {name: Path(name).read_text() for name in texts} == texts


def test_outputs_that_differ_only_in_folder_or_name_are_two(track: Run, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for drive, telemetry in [("a", "folder/a"), ("a", "b"), ("folder/b", "folder/c"), ("/dev/null", "/dev/null")]:
        done = track("-o", tmp_path / drive, "--telemetry", tmp_path / telemetry, stdin="reference_um\n1\n")
        assert done.returncode == 0, done.stderr


def test_standard_output_is_an_output_too(program: Path, tmp_path: Path) -> None:
    (tmp_path / "ref.csv").write_text("reference_um\n1\n")
    with open(tmp_path / "ref.csv", "a") as end:
        done = subprocess.run([program, tmp_path / "ref.csv"], stdout=end, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2 and done.stderr.startswith("-: is the reference itself; give the drive another name")
    with open(tmp_path / "d.csv", "w") as drive:
        done = subprocess.run([program, tmp_path / "ref.csv", "--telemetry", tmp_path / "d.csv"], stdout=drive,
                              stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2 and done.stderr.startswith(f"{tmp_path}/d.csv: is a drive too")
    assert (tmp_path / "ref.csv").read_text() == "reference_um\n1\n" and (tmp_path / "d.csv").read_text() == ""


def test_a_loop_of_links_is_refused(track: Run, tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    assert "cannot be written" in track("-o", tmp_path / "loop", stdin="reference_um\n1\n").stderr
    assert [path.is_symlink() for path in tmp_path.iterdir()] == [True]


def test_help_names_units(track: Run) -> None:
    done = track("--help")
    assert done.returncode == 0 and "reference_um (um)" in done.stdout and "time_s (s)" in done.stdout


def test_the_shipped_header_is_that_of_the_shipped_model_and_runs(build: Callable[..., Path]) -> None:
    def without_version(text: str) -> str:
        return re.sub(r"Generated by rdpi \S+", "Generated by rdpi", text)

    shipped = (PARAMS / "rdpi_params.h").read_text()
    model = read_model(PARAMS / "model.json")
    by = inverse_of(model)
    assert without_version(shipped) == without_version(render(by.model, source="model.json", chain=by.chain))
    done = subprocess.run([build()], input="reference_um\n0\n", capture_output=True, text=True)
    first = Firmware(model, 1e-4, "f32").step(np.zeros(1)).dac_code[0]
    assert done.stdout.splitlines()[2:] == [f"0.000000000,0,{first}"]


def test_a_folder_without_header_stops_the_configuration(tmp_path: Path) -> None:
    done = subprocess.run(["cmake", "-S", ROOT, "-B", tmp_path / "build", "-DRDPI_BUILD_TESTS=OFF",
                           f"-DRDPI_PARAMS_DIR={tmp_path}"], capture_output=True, text=True)
    assert done.returncode != 0 and "No rdpi_params.h" in done.stderr


# --- several axes ---


@pytest.fixture(scope="module")
def stage(build: Callable[..., Path], model: Model, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The application with two axes: of `model`, and of one with half its gain."""
    params = tmp_path_factory.mktemp("stage")
    for name, one in (("x", model), ("y", replace(model, gain_um_per_V=model.gain_um_per_V / 2))):
        (params / name).mkdir()
        write_header(one, params / name / "rdpi_params.h")
    program = build("-DRDPI_AXES=2", f"-DRDPI_PARAMS_DIR={params}/x;{params}/y", f"-DRDPI_TRACK_RATE_HZ={RATE_HZ}")
    return lambda *words: subprocess.run([program, *words], capture_output=True, text=True)


def test_each_axis_of_two_is_as_if_it_were_alone(stage: Run, model: Model, reference: dict, tmp_path: Path) -> None:
    """The second reference is shorter, and turned."""
    references_um = [reference["reference_um"], -reference["reference_um"][:1500]]
    for name, reference_um in zip("xy", references_um):
        write_recording(tmp_path / f"{name}.csv", {"reference_um": reference_um}, {})
    done = stage(tmp_path / "x.csv", tmp_path / "y.csv", "-o", tmp_path / "drive-x.csv", "-o", tmp_path / "drive-y.csv",
                 "--dac", "15:-1.7:80.1", "--dac", "15:-1.7:80.1", "--telemetry", tmp_path / "sent")
    assert done.returncode == 0, done.stderr
    for axis, name in enumerate("xy"):
        one = replace(model, gain_um_per_V=model.gain_um_per_V / (1 + axis))
        steps = Firmware(one, 1 / RATE_HZ, "f32").step(references_um[axis])
        drive = rows((tmp_path / f"drive-{name}.csv").read_text())
        assert [int(row["dac_code"]) for row in drive] == steps.dac_code.tolist()
        assert [row["command_V"] for row in drive] == nine_digits(steps.drive_V)
        decoder = Decoder("stage", axis)
        decoder.feed((tmp_path / "sent").read_bytes())
        decoder.finish()
        sent = decoder.runs[0].samples["dac_code"].tolist()
        assert sent == [*steps.dac_code.tolist(), *[steps.dac_code[-1]] * (4000 - len(steps.dac_code))]


@pytest.mark.parametrize("number", ["f32", pytest.param("q31", marks=pytest.mark.long)])
def test_cross_coupling_is_taken_off_as_by_compensate(number: str, build: Callable[..., Path], reference: dict,
                                                      tmp_path: Path) -> None:
    """The drive of the other axis is that of the sample before; before the first, where the model's memory begins."""
    plain = read_model(PARAMS / "model.json")
    coupled = replace(plain, effects=[{"name": "cross_coupling", "stage": "environment", "column": "other_axis_V",
                                       "parameters": {"um_per_V": {"value": 0.01, "ci95": None, "unit": "um/V"}}}])
    references_um = {"x": reference["reference_um"], "y": 4 + 2 * np.sin(np.arange(4000) / 90)}
    for name, model in (("x", coupled), ("y", plain)):
        (tmp_path / name).mkdir()
        by = inverse_of(model)
        write_header(by.model, tmp_path / name / "rdpi_params.h", chain=by.chain, addends=by.addends)
        write_recording(tmp_path / f"{name}.csv", {"reference_um": references_um[name]}, {})
    program = build("-DRDPI_AXES=2", f"-DRDPI_PARAMS_DIR={tmp_path}/x;{tmp_path}/y", f"-DRDPI_TRACK_RATE_HZ={RATE_HZ}",
                    f"-DRDPI_TRACK_Q31={number == 'q31'}")
    subprocess.run([program, "x.csv", "y.csv", "-o", "dx.csv", "-o", "dy.csv"], cwd=tmp_path, check=True)
    ours, other = ([int(row["dac_code"]) for row in rows((tmp_path / f"d{name}.csv").read_text())] for name in "xy")
    low_V, high_V, last = plain.drive.min_V, plain.drive.max_V, 2**plain.drive.dac_bits - 1
    start = round((plain.start_V() - low_V) / (high_V - low_V) * last)
    other_V = low_V + np.array([start, *other[:-1]]) * (high_V - low_V) / last
    run = Recording("x", {}, {"time_s": np.arange(4000) / RATE_HZ, "reference_um": references_um["x"],
                              "other_axis_V": other_V})
    codes = compensate(coupled, run, engine=number).steps.dac_code.astype(int)
    assert np.abs(codes - ours).max() <= (0 if number == "q31" else 1)
    alone = compensate(plain, run, engine=number).steps.dac_code.astype(int)
    assert np.abs(codes - alone).max() > 1000


@pytest.mark.parametrize("number", [pytest.param("f32", marks=pytest.mark.long), "q31"])
def test_backlash_is_crossed_as_by_compensate(number: str, build: Callable[..., Path], reference: dict, tmp_path: Path
                                              ) -> None:
    """Of a reference that rests, moves too little for the first code, and is none for a while."""
    plain = read_model(PARAMS / "model.json")
    loose = replace(plain, effects=[{"name": "backlash", "stage": "mechanics", "parameters": {"width_um": {
        "value": 0.3, "ci95": None, "unit": "um"}}}])
    reference_um = reference["reference_um"].copy()
    reference_um[200:260], reference_um[700:705] = reference_um[200], 2e6
    by = inverse_of(loose, jump_s=0.004)
    write_header(by.model, tmp_path / "rdpi_params.h", chain=by.chain, jump=by.jump)
    (tmp_path / "x.csv").write_text("\n".join(["reference_um", *map(repr, reference_um.tolist()), ""]))
    program = build(f"-DRDPI_PARAMS_DIR={tmp_path}", f"-DRDPI_TRACK_RATE_HZ={RATE_HZ}", f"-DRDPI_TRACK_Q31={number == 'q31'}")
    subprocess.run([program, "x.csv", "-o", "dx.csv"], cwd=tmp_path, check=True)
    ours = [int(row["dac_code"]) for row in rows((tmp_path / "dx.csv").read_text())]
    run = Recording("x", {}, {"time_s": np.arange(len(reference_um)) / RATE_HZ, "reference_um": reference_um})
    codes = compensate(loose, run, engine=number, by=by).steps.dac_code.astype(int)
    assert np.abs(codes - ours).max() <= (0 if number == "q31" else 1)
    alone = compensate(plain, run, engine=number).steps.dac_code.astype(int)
    assert np.abs(codes - alone).max() > 100


@pytest.mark.parametrize("words, message", [
    (["x.csv"], "the application has 2 axes: give so many REFERENCE.csv and -o DRIVE.csv"),
    (["x.csv", "x.csv", "-o", "d.csv"], "the application has 2 axes"),
    (["x.csv", "x.csv", "-o", "d.csv", "-o", "e.csv", "--dac", "16:0:1"], "the application has 2 axes"),
    (["x.csv", "x.csv", "x.csv"], "x.csv: not understood; the application has 2 axes"),
    (["x.csv", "x.csv", "-o", "d.csv", "-o", "d.csv"], "d.csv: two axes cannot have the same drive"),
    (["x.csv", "x.csv", "-o", "d.csv", "-o", "./d.csv"], "./d.csv: two axes cannot have the same drive"),
    (["x.csv", "x.csv", "-o", "-", "-o", "-"], "-: two axes cannot have the same drive"),
    (["x.csv", "x.csv", "-o", "d.csv", "-o", "e.csv", "--telemetry", "./e.csv"], "./e.csv: is a drive too"),
    (["x.csv", "x.csv", "-o", "d.csv", "-o", "x.csv"], "x.csv: is the reference itself"),
    (["x.csv", "x.csv", "-o", "d.csv", "-o", "e.csv", "--telemetry", "x.csv"], "x.csv: is the reference itself"),
    (["x.csv", "nowhere.csv", "-o", "d.csv", "-o", "e.csv"], "nowhere.csv: cannot be opened"),
])
def test_command_lines_of_two_axes_that_are_refused(stage: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                    words: list[str], message: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.csv").write_text("reference_um\n1\n")
    done = stage(*words)
    assert done.returncode == 2 and done.stderr.splitlines()[-1].startswith(message)
    assert [path.name for path in tmp_path.iterdir()] == ["x.csv"]
    assert (tmp_path / "x.csv").read_text() == "reference_um\n1\n"


@pytest.mark.parametrize("options, message", [
    (["-DRDPI_AXES=0"], "RDPI_AXES is '0', not a number from 1 to 6"),
    (["-DRDPI_AXES=7"], "RDPI_AXES is '7', not a number from 1 to 6"),
    (["-DRDPI_AXES=2", f"-DRDPI_PARAMS_DIR={PARAMS};{PARAMS};{PARAMS}"], "3 values; give one for each of 2 axes"),
    (["-DRDPI_AXES=2", "-DRDPI_UM_PER_COUNT=1;2;3"], "RDPI_UM_PER_COUNT is '1;2;3', 3 values"),
    (["-DRDPI_AXES=2", "-DRDPI_UM_PER_COUNT=1;two"], "RDPI_UM_PER_COUNT is '1;two', not a number"),
    (["-DRDPI_TRACK_LOOP=ON", "-DRDPI_TRACK_KI=10", "-DRDPI_TRACK_KP=101"], "RDPI_TRACK_KP is 101"),
    (["-DRDPI_TRACK_LOOP=ON", "-DRDPI_TRACK_KI=1000001"], "RDPI_TRACK_KI 1000001: at most 100"),
])
def test_settings_that_are_refused(tmp_path: Path, options: list[str], message: str) -> None:
    done = subprocess.run(["cmake", "-S", ROOT, "-B", tmp_path / "build", "-DRDPI_BUILD_TESTS=OFF", *options],
                          capture_output=True, text=True)
    assert done.returncode != 0 and message in " ".join(done.stderr.split())


def test_a_board_with_fewer_axes(tmp_path: Path) -> None:
    done = subprocess.run(["cmake", "-S", ROOT, "-B", tmp_path / "build", "--preset", "stm32g474", "-DRDPI_AXES=2"],
                          capture_output=True, text=True)
    assert done.returncode != 0 and "RDPI_AXES is 2, but port/stm32g474 moves fewer" in " ".join(done.stderr.split())
