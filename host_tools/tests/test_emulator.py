"""`rdpi compensate --engine qemu-...`: the firmware on an emulated board gives what the library gives on the host."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rdpi.board import emulator
from rdpi.board.telemetry import SWEEP
from rdpi.data import Recording, read_recording, sample_times, write_recording
from rdpi.errors import BadInput
from rdpi.model import Drive, Memory, Model, Rate, read_model, write_model

ROOT = Path(__file__).resolve().parents[2]
MODEL = ROOT / "examples/track/params/model.json"
RATE_HZ = 8000
FLAGS = 1, 2, 8, 16  # guard, range, input, missed
LEAD = 32
EFFECTS = [{"name": name, "parameters": parameters} for name, parameters in (
    ("delay", {"delay_s": 5.6e-4}), ("lag", {"time_constant_s": 4e-4}),
    ("input_curve", {"quadratic": 0.04, "cubic": 0.05, "low_V": -1.7, "high_V": 60.1}),
    ("relaxation", {"share": 0.05, "time_constant_s": 3e-3}), ("creep", {"percent_per_decade": 2.0}),
    ("resonance", {"f0_hz": 600.0, "damping": 0.05}))]

slow = pytest.mark.slow
USUAL = "qemu-m4f", False


def boards(*slow_ones: tuple[str, bool]) -> list:
    """Every board with either number type: the usual one always, these also before a change lands."""
    marks = {USUAL: [], **dict.fromkeys(slow_ones, slow)}
    return [pytest.param(*one, marks=marks.get(one, pytest.mark.long))
            for one in itertools.product(emulator.MACHINES, (False, True))]


@pytest.fixture(scope="module")
def model() -> Model:
    """With offsets, memory, a guard and limits that the reference meets, and a longer window than is compiled in."""
    return replace(read_model(MODEL), offset_V=0.3, offset_um=-0.2,
                   memory=Memory(0.5, np.array([0.5, 0.3, 0.1, *[0.0] * 7])),
                   rate=Rate("displacement", 2.5e-3, 2e-4, 250.0), drive=Drive(-1.7, 60.1, None, 16))


@pytest.fixture
def folder(model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work here, beside the model and a reference of 2000 samples."""
    monkeypatch.chdir(tmp_path)
    write_model("model.json", model)
    time_s = sample_times(2000, RATE_HZ)
    reference_um = 4 - 3.5 * np.cos(2 * np.pi * 8 * time_s) + np.sin(2 * np.pi * 35 * time_s)
    reference_um[1200:1205] = 2e6  # not usable
    write_recording("reference.csv", {"time_s": time_s, "reference_um": reference_um}, {})
    return tmp_path


def compensated(rdpi: Callable, engine: str, *options: str) -> Recording:
    done = rdpi("compensate", "model.json", "reference.csv", "-o", "drive.csv", "--engine", engine, *options)
    assert done.exit_code == 0, done.output
    return read_recording("drive.csv", ("command_V", "rate_um_per_s", "flags", "dac_code"))


@pytest.mark.parametrize("board, fixed_point", boards())
def test_a_board_outputs_what_the_host_computes(folder: Path, rdpi: Callable, board: str, fixed_point: bool) -> None:
    host = compensated(rdpi, "q31" if fixed_point else "f32")
    target = compensated(rdpi, board, *["--fixed-point"] * fixed_point)
    assert list(target.columns) == list(host.columns)
    codes, expected = target.columns["dac_code"], host.columns["dac_code"]
    assert np.abs(codes - expected).max() <= (0 if fixed_point else 1)
    if fixed_point:
        assert target.columns["flags"].tolist() == host.columns["flags"].tolist()
    np.testing.assert_allclose(target.command_V, host.command_V, rtol=0, atol=1.1 * 61.8 / 65535)
    np.testing.assert_allclose(target.columns["rate_um_per_s"], host.columns["rate_um_per_s"], rtol=1e-4, atol=1e-3)
    flags = host.columns["flags"].astype(int)
    assert all((flags & flag).any() for flag in FLAGS), "the reference is meant to meet them all"


@pytest.mark.parametrize("preview", [[], pytest.param(["--no-preview"], marks=pytest.mark.long)])
@pytest.mark.parametrize("board, fixed_point", boards(("qemu-m0", True), ("qemu-m3", False), ("qemu-m7", True)))
def test_a_board_compensates_what_the_host_compensates(folder: Path, model: Model, rdpi: Callable, board: str,
                                                       fixed_point: bool, preview: list[str]) -> None:
    """Delay, lag, input curve, relaxation, creep and resonance at once, after the start-up sweep; a jump that the lead
    is limited at."""
    write_model("model.json", replace(model, effects=EFFECTS))
    run = read_recording("reference.csv", ("reference_um",))
    run.columns["reference_um"][400:500] += 2.0
    write_recording("reference.csv", run.columns, {})
    host = compensated(rdpi, "q31" if fixed_point else "f32", "--sweep", *preview)
    target = compensated(rdpi, board, "--sweep", *preview, *["--fixed-point"] * fixed_point)
    codes, expected = target.columns["dac_code"], host.columns["dac_code"]
    assert np.abs(codes - expected).max() <= (0 if fixed_point else 1)
    if fixed_point:
        assert target.columns["flags"].tolist() == host.columns["flags"].tolist()
    flags = host.columns["flags"].astype(int)
    assert all((flags & flag).any() for flag in (*FLAGS, LEAD)), "the reference is meant to meet them all"
    without = compensated(rdpi, "f32", "--sweep", "--effects", "none")
    assert np.abs(without.columns["dac_code"] - expected).max() > 1000, "it is meant to make a difference"


@pytest.mark.parametrize("board, fixed_point", boards(("qemu-m0", True)))
def test_after_the_start_up_sweep(folder: Path, rdpi: Callable, board: str, fixed_point: bool) -> None:
    engine, options = "q31" if fixed_point else "f32", ["--fixed-point"] * fixed_point
    target = compensated(rdpi, board, "--sweep", *options)
    host = compensated(rdpi, engine, "--sweep")
    assert np.abs(target.columns["dac_code"] - host.columns["dac_code"]).max() <= (0 if fixed_point else 1)
    assert target.columns["flags"].max() < SWEEP
    without = compensated(rdpi, engine)
    assert np.abs(without.columns["dac_code"] - host.columns["dac_code"]).max() > 10, "it is meant to make a difference"


@pytest.mark.slow
def test_the_memory_is_that_of_the_recording(folder: Path, rdpi: Callable) -> None:
    run = read_recording("reference.csv", ("reference_um",))
    write_recording("reference.csv", {name: values[:200] for name, values in run.columns.items()}, {"memory": "reset"})
    target, host = (compensated(rdpi, engine).columns["dac_code"] for engine in ("qemu-m3", "f32"))
    assert np.abs(target - host).max() <= 1


def refusal(folder: Path, rdpi: Callable, *options: str) -> str:
    done = rdpi("compensate", "model.json", "reference.csv", "-o", "drive.csv", *options)
    assert done.exit_code == 2 and done.output.startswith("rdpi: ") and done.output.count("\n") == 1, done.output
    assert not (folder / "drive.csv").exists()
    return done.output.removeprefix("rdpi: ").strip()


def test_a_rate_that_is_no_whole_number(folder: Path, rdpi: Callable) -> None:
    write_recording("reference.csv", {"time_s": sample_times(100, 1000.5), "reference_um": np.zeros(100)}, {})
    assert refusal(folder, rdpi, "--engine", "qemu-m4f").startswith("reference.csv: 1000.5 samples per second; the ")


@pytest.mark.slow
def test_a_rate_that_the_board_has_no_timer_for(folder: Path, rdpi: Callable) -> None:
    write_recording("reference.csv", {"time_s": sample_times(100, 300_000), "reference_um": np.zeros(100)}, {})
    write_model("model.json", replace(read_model("model.json"), rate=Rate("displacement", 0.0, 0.0, 400.0)))
    assert refusal(folder, rdpi, "--engine", "qemu-m3") == (
        "qemu-m3: the firmware refuses to run: the board has no timer for 300000 samples per second")


def test_a_model_without_dac(folder: Path, model: Model, rdpi: Callable) -> None:
    write_model("model.json", replace(model, drive=Drive(-1.7, 60.1)))
    assert "no drive.dac_bits: give --dac-bits" in refusal(folder, rdpi, "--engine", "qemu-m4f")


def test_a_model_without_fixed_point(folder: Path, model: Model, rdpi: Callable) -> None:
    narrow = Drive(0.0, 0.8, None, 20)  # against the largest threshold
    write_model("model.json", replace(model, drive=narrow, memory=Memory(0.0, np.zeros(10))))
    message = refusal(folder, rdpi, "--engine", "qemu-m3", "--fixed-point")
    assert message.startswith("model.json: no fixed point: drive")


def test_fixed_point_is_a_choice_of_the_boards(folder: Path, rdpi: Callable) -> None:
    assert refusal(folder, rdpi, "--engine", "f32", "--fixed-point").startswith(
        "--fixed-point: is only valid with the engines")


@slow
def test_how_many_samples_fit(folder: Path, model: Model, rdpi: Callable) -> None:
    samples = 70_000
    time_s = sample_times(samples, RATE_HZ)
    write_recording("reference.csv", {"time_s": time_s, "reference_um": np.sin(time_s)}, {})
    message = refusal(folder, rdpi, "--engine", "qemu-m0")
    found = re.fullmatch(r"70000 samples do not fit into the flash of qemu-m0; (\d+) do\. Shorten the reference, or .*",
                         message)
    run, fit = read_recording("reference.csv", ("reference_um",)), int(found[1])
    for count in (fit, fit + 4):  # flash is filled by eights of bytes
        (folder / str(count)).mkdir()
        cut = np.sin(time_s[:count])
        if count == fit:
            assert emulator.build(model, cut, run, "qemu-m0", False, folder / str(count)).exists()
        else:
            with pytest.raises(BadInput, match="do not fit"):
                emulator.build(model, cut, run, "qemu-m0", False, folder / str(count))


@pytest.mark.slow
def test_firmware_that_does_not_build(folder: Path, model: Model, rdpi: Callable) -> None:
    write_model("model.json", replace(model, rate=Rate("displacement", 0.5, 0.0, 400.0)))  # 4000 samples, 16 KiB
    message = refusal(folder, rdpi, "--engine", "qemu-m0")
    assert message.startswith("the build of the firmware for qemu-m0 failed: ") and "ram" in message.lower()


@pytest.mark.parametrize("missing", [["qemu-system-arm"], ["cmake", "arm-none-eabi-gcc"]])
def test_tools_that_are_missing(folder: Path, rdpi: Callable, monkeypatch: pytest.MonkeyPatch,
                                missing: list[str]) -> None:
    (folder / "bin").mkdir()
    for name in set(emulator.TOOLS) - set(missing):
        (folder / "bin" / name).symlink_to(shutil.which(name))
    monkeypatch.setenv("PATH", str(folder / "bin"))
    message = refusal(folder, rdpi, "--engine", "qemu-m4f")
    assert message.startswith(f"the engines qemu-... need {', '.join(missing)}: apt-get install ")


def test_no_checkout(folder: Path, rdpi: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RDPI_HOME", str(folder))
    assert refusal(folder, rdpi, "--engine", "qemu-m4f") == f"RDPI_HOME is {folder}: this is not a checkout of rdpi"
    monkeypatch.delenv("RDPI_HOME")
    monkeypatch.setattr(emulator, "__file__", str(folder / "site-packages/rdpi/board/emulator.py"))
    assert "set RDPI_HOME to the directory of the checkout" in refusal(folder, rdpi, "--engine", "qemu-m4f")
    monkeypatch.setenv("RDPI_HOME", str(ROOT))
    assert emulator.checkout() == ROOT


def fake(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """A qemu-system-arm that does this."""
    (folder / "bin").mkdir()
    program = folder / "bin/qemu-system-arm"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}")


@pytest.mark.slow
def test_an_emulator_that_fails(folder: Path, rdpi: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(folder, monkeypatch, "echo unsupported machine >&2; exit 1")
    assert refusal(folder, rdpi, "--engine", "qemu-m4f") == "qemu-m4f: qemu-system-arm ended early: unsupported machine"


def test_an_emulator_that_is_silent_is_ended(folder: Path, rdpi: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(folder, monkeypatch, f"echo $$ >{folder}/pid; exec sleep 60")
    monkeypatch.setattr(emulator, "SILENT_S", 0.5)
    assert refusal(folder, rdpi, "--engine", "qemu-m4f") == "qemu-m4f: no data for 0.5 s after 0 of 2000 samples"
    assert subprocess.run(["kill", "-0", (folder / "pid").read_text().strip()], capture_output=True).returncode != 0


def test_a_board_that_is_too_slow(folder: Path, rdpi: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    real = shutil.which("qemu-system-arm")
    # a microsecond an instruction
    fake(folder, monkeypatch, f"""exec {real} $(echo "$@" | sed s/shift=[0-9]*/shift=10/)""")
    message = refusal(folder, rdpi, "--engine", "qemu-m4f")
    assert re.match(r"qemu-m4f: the run is not complete: \d+ of 2000 samples, [1-9]\d* ticks lost at 8000 ", message)
