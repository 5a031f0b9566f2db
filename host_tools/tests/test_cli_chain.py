"""`rdpi simulate`, `compensate`, `header` and `plot` as a user types them: what they write, print and refuse."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plants import model_of, quasi_static, rate_of, recording, stack, waves

from rdpi import firmware
from rdpi.data import Recording, read_recording, sample_times, write_recording
from rdpi.model import Drive, Memory, Rate, read_model, write_model

HOST_TOOLS = Path(__file__).resolve().parents[1]
ENGINES = "f32", "q31", "f64", "numpy"
CLOSE = {"f32": (2e-4, 2e-2), "q31": (1e-5, 1e-4)}  # V, um/s
GUARD, RANGE, SLEW, INPUT, MISSED = 1, 2, 4, 8, 16


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model without rate law, static.json, one with, moving.json, and recordings of these plants."""
    folder = tmp_path_factory.mktemp("files")
    write_model(folder / "static.json", model_of(stack(law=0)))
    write_model(folder / "moving.json", model_of(stack(), rate=Rate("control", max_um_per_s=1000.0)))
    for name, run in recordings().items():
        write_recording(folder / name, run.columns, run.metadata)
    write_reference(folder / "reference.csv", reference(), note="a wish")
    return folder


def write_reference(name: str | Path, reference_um: np.ndarray, **metadata: str) -> None:
    write_recording(name, {"time_s": sample_times(len(reference_um), 1000), "reference_um": reference_um}, metadata)


def recordings() -> dict[str, Recording]:
    """large.csv from rest, carried.csv after it, and fast.csv with the rate law, the rate being the control's."""
    plant, other = stack(law=0), stack()
    large = np.r_[waves(90, 2, 2, 1000), np.linspace(0, 50, 100)]
    small, fast = waves(20, 5, 2, 1000, 50), waves(80, 10, 3, 2000)
    return {
        "large.csv": quasi_static(plant, large, noise_um=0.01, other_axis_V=np.arange(1100.0)),
        "carried.csv": quasi_static(plant, small, noise_um=0.01, memory="carried"),
        "fast.csv": recording(fast, other.respond(fast, 0.13 * rate_of(fast, 2000)), 2000, noise_um=0.01),
    }


def reference() -> np.ndarray:
    return np.r_[waves(9, 4, 1.5, 1000, 0.0)[:375], np.full(50, 9.0), np.linspace(9, 3, 175)]


def result_of(rdpi: Callable, *arguments: object, status: int = 0) -> tuple[dict, str]:
    done = rdpi(*arguments, "--json", "result.json")
    assert done.exit_code == status, done.output
    return json.loads(Path("result.json").read_text()), done.output


# ---- simulate ----

def test_simulate_json_as_in_the_contract(folder: Path, rdpi: Callable) -> None:
    result, text = result_of(rdpi, "simulate", "static.json", "large.csv", "-o", "out.csv")
    assert {"runs", "rms_percent", "max_percent"} <= set(result)
    (row,) = result["runs"]
    assert {"file", "rms_um", "max_um", "rms_percent", "max_percent"} <= set(row) and row["file"] == "large.csv"
    out = read_recording("out.csv", required=("predicted_um",))
    error = out.displacement_um - out.columns["predicted_um"]
    stroke = np.ptp(out.displacement_um)
    assert row["rms_um"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert row["max_um"] == pytest.approx(np.abs(error).max(), rel=1e-12)
    assert row["rms_percent"] == result["rms_percent"] == pytest.approx(100 * row["rms_um"] / stroke, rel=1e-12)
    assert row["max_percent"] == result["max_percent"] == pytest.approx(100 * row["max_um"] / stroke, rel=1e-12)
    assert 0.0095 < row["rms_um"] < 0.0105  # nothing but the noise
    line = next(line for line in text.splitlines() if "large.csv" in line)
    assert f"{row['rms_percent']:.3f}" in line and f"{row['max_percent']:.3f}" in line


def test_simulate_writes_the_runs_columns_and_predicted_um(folder: Path, rdpi: Callable) -> None:
    assert rdpi("simulate", "static.json", "large.csv", "-o", "out.csv").exit_code == 0
    run, out = read_recording("large.csv"), read_recording("out.csv")
    assert list(out.columns) == [*run.columns, "predicted_um"] and out.metadata == run.metadata
    for name, values in run.columns.items():
        assert np.array_equal(out.columns[name], values)
    truth = stack(law=0).respond(run.command_V, 0 * run.command_V)
    assert out.columns["predicted_um"] == pytest.approx(truth, abs=1e-9)


def test_simulate_several(folder: Path, rdpi: Callable) -> None:
    """Memory is carried in the order given; the whole is the rms over all samples and the largest of the maxima."""
    result, _ = result_of(rdpi, "simulate", "static.json", "large.csv", "carried.csv")
    assert [row["file"] for row in result["runs"]] == ["large.csv", "carried.csv"]
    assert all(row["rms_um"] == pytest.approx(0.01, rel=0.1) for row in result["runs"])
    squares = [row["rms_percent"] ** 2 for row in result["runs"]]
    assert result["rms_percent"] == pytest.approx(np.sqrt(np.average(squares, weights=[1100, 400])))
    assert result["max_percent"] == max(row["max_percent"] for row in result["runs"])


def test_simulate_with_a_rate_law(folder: Path, rdpi: Callable) -> None:
    result, _ = result_of(rdpi, "simulate", "moving.json", "fast.csv")
    assert result["runs"][0]["rms_um"] == pytest.approx(0.01, rel=0.1)
    assert result_of(rdpi, "simulate", "static.json", "fast.csv")[0]["runs"][0]["rms_um"] > 0.1


def test_simulate_a_drive_alone(folder: Path, rdpi: Callable) -> None:
    run = read_recording("large.csv")
    write_recording("drive.csv", {"time_s": run.time_s, "command_V": run.command_V}, {})
    result, text = result_of(rdpi, "simulate", "static.json", "drive.csv", "-o", "out.csv")
    assert result["runs"] == [] and result["rms_percent"] is result["max_percent"] is None
    assert "there is no displacement_um to compare with" in text
    out = read_recording("out.csv", required=("predicted_um",))
    assert list(out.columns) == ["time_s", "command_V", "predicted_um"]
    truth = stack(law=0).respond(run.command_V, 0 * run.command_V)
    assert out.columns["predicted_um"] == pytest.approx(truth, abs=1e-9)
    mixed, _ = result_of(rdpi, "simulate", "static.json", "drive.csv", "large.csv")
    (row,) = mixed["runs"]
    assert row["file"] == "large.csv" and mixed["rms_percent"] == row["rms_percent"]


def test_simulate_memory(folder: Path, rdpi: Callable) -> None:
    """At 0 V the model's memory is rest there; a run that says reset at 50 V is elsewhere."""
    plant = stack(law=0)
    plant.settle(50.0)
    command = waves(90, 5, 1, 1000, 50)
    run = recording(command, plant.respond(command, 0 * command), 1000)
    write_recording("reset.csv", run.columns, run.metadata)
    seen = {memory: result_of(rdpi, "simulate", "static.json", "reset.csv", "--memory", memory)[0]["runs"][0]["rms_um"]
            for memory in ("auto", "reset", "model")}
    assert seen["auto"] == seen["reset"] < 1e-9 and seen["model"] > 0.3


def test_simulate_without_the_offset(folder: Path, rdpi: Callable) -> None:
    run = read_recording("large.csv")
    write_recording("drifted.csv", {**run.columns, "displacement_um": run.displacement_um + 0.5}, run.metadata)
    with_offset = result_of(rdpi, "simulate", "static.json", "drifted.csv")[0]["runs"][0]
    without, text = result_of(rdpi, "simulate", "static.json", "drifted.csv", "--remove-offset")
    assert with_offset["rms_um"] == pytest.approx(0.5, rel=0.01)
    assert without["runs"][0]["rms_um"] == pytest.approx(0.01, rel=0.1)
    assert re.search(r"offset.* 0\.(50|49)\d* um", text)


def test_simulate_gate(folder: Path, rdpi: Callable) -> None:
    command = ["simulate", "static.json", "large.csv", "carried.csv"]
    rms = result_of(rdpi, *command)[0]["runs"][1]["rms_percent"]  # the worse of the two
    result, text = result_of(rdpi, *command, "--max-rms", 0.99 * rms, status=1)
    assert result["gate_failed"] is True and "--max-rms" in text
    assert result_of(rdpi, *command, "--max-rms", 1.01 * rms)[0]["gate_failed"] is False


def test_simulate_a_displacement_that_stands_still(folder: Path, rdpi: Callable) -> None:
    """There is no stroke to take percentages of: that is said, and no gate is passed by it."""
    run = read_recording("large.csv")
    write_recording("still.csv", {**run.columns, "displacement_um": 0 * run.time_s + 3}, run.metadata)
    for arguments in ([], ["--max-rms", 1]):
        text = refusal(rdpi, "simulate", "static.json", "still.csv", *arguments)
        assert re.match(r"still\.csv: .*spans 0 .*check", text)


def test_simulate_gate_without_anything_to_judge(folder: Path, rdpi: Callable) -> None:
    run = read_recording("large.csv")
    write_recording("drive.csv", {"time_s": run.time_s, "command_V": run.command_V}, {})
    assert "--max-rms" in refusal(rdpi, "simulate", "static.json", "drive.csv", "--max-rms", 1)


def test_simulate_refuses_one_output_for_several_runs(folder: Path, rdpi: Callable) -> None:
    assert "one RUN" in refusal(rdpi, "simulate", "static.json", "large.csv", "carried.csv")


# ---- compensate ----

def compensated(rdpi: Callable, *arguments: object, model: str = "static.json",
                source: str = "reference.csv") -> tuple[Recording, dict]:
    result, _ = result_of(rdpi, "compensate", model, source, "-o", "drive.csv", *arguments)
    return read_recording("drive.csv", required=("command_V", "reference_um", "rate_um_per_s", "flags")), result


def change_model(name: str = "static.json", **changes: object) -> None:
    write_model(name, replace(model_of(stack(law=0)), **changes))


@pytest.mark.parametrize("engine", ENGINES)
def test_compensate(engine: str, folder: Path, rdpi: Callable) -> None:
    drive, result = compensated(rdpi, "--engine", engine)
    assert list(drive.columns) == ["time_s", "reference_um", "command_V", "rate_um_per_s", "flags"]
    assert drive.metadata["note"] == "a wish"
    truth = stack(law=0).drive(reference(), np.zeros(600))
    assert drive.command_V == pytest.approx(truth, abs=CLOSE.get(engine, (1e-9,))[0])
    rate = rate_of(reference(), 1000)
    assert drive.columns["rate_um_per_s"] == pytest.approx(rate, abs=CLOSE.get(engine, (0, 1e-6))[1])
    assert not drive.columns["flags"].any()
    assert result["engine"] == engine and result["samples"] == 600
    assert [result[f"{name}_count"] for name in ("guard", "range", "slew", "input", "missed")] == [0] * 5


@pytest.mark.parametrize("engine", ["f32", "q31", "f64"])
@pytest.mark.parametrize("metadata", [{}, {"memory": "reset"}])
def test_compensate_after_the_start_up_sweep(engine: str, metadata: dict, folder: Path, rdpi: Callable) -> None:
    """From where the library's own sweep leaves it, whatever the reference's file says."""
    model = replace(model_of(stack(law=0)), drive=Drive(-20.0, 120.0, None, 16))
    write_model("static.json", replace(model, memory=Memory(2.0, np.linspace(2.0, 0.0, len(model.slopes)))))
    write_reference("reference.csv", reference(), **metadata)
    library = firmware.engine(read_model("static.json"), 1e-3, engine)
    _, swept = library.sweep()
    expected = library.step(reference())
    drive, result = compensated(rdpi, "--engine", engine, "--sweep")
    assert drive.columns["dac_code"].tolist() == expected.dac_code.tolist() and len(swept) > 100
    assert drive.columns["flags"].tolist() == expected.flags.tolist()
    assert result["sweep"] and drive.metadata["memory"] == "unknown"  # the first step is not where the sweep ended
    without, _ = compensated(rdpi, "--engine", engine)
    assert np.abs(without.columns["dac_code"] - expected.dac_code).max() > 10


def test_a_drive_that_begins_where_the_sweep_ended(folder: Path, rdpi: Callable) -> None:
    """What simulate makes of it is the reference, but for the little that a fine sweep amid the range leaves."""
    fine = Drive(-20.0, 120.0, sweep_cycles=500, sweep_V_per_s=500.0, sweep_end_V=50.0)
    model = replace(read_model("static.json"), drive=fine)
    write_model("static.json", model)
    library = firmware.engine(model, 1e-3, "f64")
    library.sweep()
    start_um = float(library.predict(np.array([50.0]), np.zeros(1))[0])
    write_reference("reference.csv", start_um + 0.5 * (reference() - reference()[0]), memory="carried")
    drive, _ = compensated(rdpi, "--engine", "f64", "--sweep")
    assert drive.metadata["memory"] == "reset" and drive.command_V[0] == pytest.approx(50)
    assert rdpi("simulate", "static.json", "drive.csv", "-o", "back.csv").exit_code == 0
    back = read_recording("back.csv", required=("predicted_um", "reference_um"))
    assert back.columns["predicted_um"] == pytest.approx(back.columns["reference_um"], abs=1e-2)


def test_a_sweep_that_ends_off_the_middle_resets_nothing(folder: Path, rdpi: Callable) -> None:
    edge = Drive(-20.0, 120.0, sweep_cycles=500, sweep_V_per_s=500.0, sweep_end_V=0.0)
    model = replace(read_model("static.json"), drive=edge)
    write_model("static.json", model)
    library = firmware.engine(model, 1e-3, "f64")
    library.sweep()
    start_um = float(library.predict(np.array([0.0]), np.zeros(1))[0])
    write_reference("reference.csv", start_um + 0.5 * (reference() - reference()[0]), memory="reset")
    drive, _ = compensated(rdpi, "--engine", "f64", "--sweep")
    assert drive.command_V[0] == pytest.approx(0, abs=1e-6) and drive.metadata["memory"] == "unknown"


def test_numpy_has_no_start_up_sweep(folder: Path, rdpi: Callable) -> None:
    text = refusal(rdpi, "compensate", "static.json", None, "--engine", "numpy", "--sweep")
    assert text.startswith("the engine numpy has no start-up sweep")


def test_compensate_is_what_the_firmware_computes_unless_told_otherwise(folder: Path, rdpi: Callable) -> None:
    default = compensated(rdpi)[0].command_V
    assert np.array_equal(default, compensated(rdpi, "--engine", "f32")[0].command_V)
    assert np.array_equal(default, default.astype(np.float32))


def test_engines_agree_with_every_limit_at_work(folder: Path, rdpi: Callable) -> None:
    """Guard, range, slew and DAC; single precision may choose the neighbouring code."""
    wild = np.r_[waves(14, 10, 2, 1000), np.full(20, 2e6), waves(6, 40, 3, 1000)]
    write_reference("wild.csv", wild)
    write_model("limited.json", model_of(stack(), rate=Rate(window_s=0.003, filter_s=0.004, max_um_per_s=200.0),
                                         drive=Drive(-5.0, 75.0, 4000.0, 12)))
    (single, _), (fixed, _), (double, double_result), (numpy_drive, numpy_result) = (
        compensated(rdpi, "--engine", engine, model="limited.json", source="wild.csv") for engine in ENGINES)
    for name in ("command_V", "rate_um_per_s"):
        assert double.columns[name] == pytest.approx(numpy_drive.columns[name], abs=1e-9)
    assert np.array_equal(double.columns["flags"], numpy_drive.columns["flags"])
    assert np.array_equal(double.columns["dac_code"], numpy_drive.columns["dac_code"])
    for drive in (single, fixed):
        assert np.abs(drive.columns["dac_code"] - double.columns["dac_code"]).max() <= 1
        assert np.mean(drive.columns["flags"] == double.columns["flags"]) > 0.98
        assert list(drive.columns) == list(double.columns)
    assert {**double_result, "engine": "numpy"} == numpy_result
    flags = double.columns["flags"].astype(int)
    for name, bit in (("guard", GUARD), ("range", RANGE), ("slew", SLEW), ("input", INPUT), ("missed", MISSED)):
        assert double_result[f"{name}_count"] == np.count_nonzero(flags & bit) > 0


def test_flags_mean_what_they_say(folder: Path, rdpi: Callable) -> None:
    change_model(drive=Drive(-20.0, 60.0), rate=Rate(max_um_per_s=100.0))
    drive, _ = compensated(rdpi, "--engine", "f64")
    flags = drive.columns["flags"].astype(int)
    assert np.array_equal(flags & GUARD > 0, rate_of(reference(), 1000) > 100)
    assert drive.columns["rate_um_per_s"] == pytest.approx(np.minimum(rate_of(reference(), 1000), 100))
    clipped = flags & RANGE > 0
    assert 50 < clipped.sum() < 500
    assert (drive.command_V[clipped] == 60).all() and (drive.command_V[~clipped] < 60).all()
    change_model(drive=Drive(-20.0, 120.0, 500.0))
    drive, _ = compensated(rdpi, "--engine", "f64")
    steps, slewed = np.abs(np.diff(drive.command_V, prepend=0)), drive.columns["flags"].astype(int) & SLEW > 0
    assert steps.max() == pytest.approx(0.5) and slewed.sum() > 50 and steps[slewed] == pytest.approx(0.5)


def test_unusable_references_hold_the_drive(folder: Path, rdpi: Callable) -> None:
    spiked = reference()
    spiked[300:310] = -1e7
    write_reference("spiked.csv", spiked)
    drive, result = compensated(rdpi, source="spiked.csv")
    assert result["input_count"] == 10 and (drive.columns["flags"][300:310] == INPUT).all()
    assert result["missed_count"] == 1 and drive.columns["flags"][310] == MISSED
    assert (drive.command_V[300:310] == drive.command_V[299]).all()
    assert drive.command_V[320:] == pytest.approx(compensated(rdpi)[0].command_V[320:], abs=1e-3)


@pytest.mark.parametrize("engine", ENGINES)
def test_dac_codes(engine: str, folder: Path, rdpi: Callable) -> None:
    drive, _ = compensated(rdpi, "--dac-bits", 10, "--engine", engine)
    assert list(drive.columns)[-1] == "dac_code"
    code = drive.columns["dac_code"]
    assert np.array_equal(code, np.rint(code)) and code.min() >= 0 and code.max() <= 1023
    assert drive.command_V == pytest.approx(code * 140 / 1023 - 20, abs=3e-5)
    wish = stack(law=0).drive(reference(), np.zeros(600))
    assert np.abs(drive.command_V - wish).max() < 1.5 * 140 / 1023
    assert len(np.unique(code)) > 100


def test_the_models_own_dac(folder: Path, rdpi: Callable) -> None:
    change_model(drive=Drive(-20.0, 120.0, None, 8))
    assert compensated(rdpi)[0].columns["dac_code"].max() <= 255
    assert compensated(rdpi, "--dac-bits", 12)[0].columns["dac_code"].max() > 255
    assert json.loads(Path("static.json").read_text())["drive"]["dac_bits"] == 8  # the file is only read


def test_compensate_follows_a_recording(folder: Path, rdpi: Callable) -> None:
    """The measured displacement as reference: its own command comes back, and is kept beside the computed one."""
    run = read_recording("large.csv")
    drive, result = compensated(rdpi, "--reference-column", "displacement_um", "--engine", "f64", source="large.csv")
    assert {"recorded_V", "reference_um", "displacement_um", "other_axis_V"} <= set(drive.columns)
    assert np.array_equal(drive.columns["recorded_V"], run.command_V)
    assert np.array_equal(drive.columns["reference_um"], run.displacement_um)
    error = run.command_V - drive.command_V
    recorded = result["recorded"]
    assert recorded["rms_V"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert recorded["max_V"] == pytest.approx(np.abs(error).max())
    assert recorded["rms_percent"] == pytest.approx(100 * recorded["rms_V"] / 90, rel=1e-3)
    assert recorded["max_percent"] == pytest.approx(100 * recorded["max_V"] / 90, rel=1e-3)
    assert recorded["rms_percent"] < 0.2 and recorded["removed_um"] == 0


@pytest.mark.parametrize("engine", ENGINES)
def test_compensate_removes_the_offset(engine: str, folder: Path, rdpi: Callable) -> None:
    run = read_recording("large.csv")
    write_recording("drifted.csv", {**run.columns, "displacement_um": run.displacement_um + 0.5}, run.metadata)
    arguments = ["--reference-column", "displacement_um", "--engine", engine]
    _, plain = compensated(rdpi, *arguments, source="drifted.csv")
    drive, removed = compensated(rdpi, *arguments, "--remove-offset", source="drifted.csv")
    assert plain["recorded"]["rms_percent"] > 2 > 0.2 > removed["recorded"]["rms_percent"]
    assert removed["recorded"]["removed_um"] == pytest.approx(0.5, abs=0.01)
    assert np.array_equal(drive.columns["reference_um"], drive.displacement_um)  # as it was asked for


def test_compensate_beside_a_command_that_stands_still(folder: Path, rdpi: Callable) -> None:
    columns = {"time_s": sample_times(600, 1000), "command_V": np.full(600, 5.0), "reference_um": reference()}
    write_recording("still.csv", columns, {})
    drive, result = compensated(rdpi, source="still.csv")
    assert (drive.columns["recorded_V"] == 5).all() and np.ptp(drive.command_V) > 50
    assert "recorded" not in result or result["recorded"]["rms_percent"] is None


@pytest.mark.parametrize("engine, limit_um", [("f64", 1e-9), ("numpy", 1e-9), ("f32", 1e-4), ("q31", 1e-6)])
def test_there_and_back(engine: str, limit_um: float, folder: Path, rdpi: Callable) -> None:
    """What simulate makes of a compensated drive is the reference."""
    compensated(rdpi, "--engine", engine)
    assert rdpi("simulate", "static.json", "drive.csv", "-o", "back.csv").exit_code == 0
    back = read_recording("back.csv", required=("predicted_um", "reference_um"))
    assert back.columns["predicted_um"] == pytest.approx(back.columns["reference_um"], abs=limit_um)


def test_there_and_back_with_a_rate_law(folder: Path, rdpi: Callable) -> None:
    """The rate of the reference and of the prediction are found by different means, and agree."""
    write_model("law.json", model_of(stack(), rate=Rate(window_s=0.004, max_um_per_s=1000.0)))
    z = waves(9, 8, 3, 1000)
    write_reference("z.csv", z)
    compensated(rdpi, model="law.json", source="z.csv")
    assert rdpi("simulate", "law.json", "drive.csv", "-o", "back.csv").exit_code == 0
    back = read_recording("back.csv", required=("predicted_um",)).columns["predicted_um"]
    assert np.sqrt(np.mean((back - z) ** 2)) < 0.003 * 9
    compensated(rdpi, source="z.csv")  # without the law
    assert rdpi("simulate", "law.json", "drive.csv", "-o", "back.csv").exit_code == 0
    back = read_recording("back.csv", required=("predicted_um",)).columns["predicted_um"]
    assert np.sqrt(np.mean((back - z) ** 2)) > 0.005 * 9


def test_offset_of_a_reference_alone(folder: Path, rdpi: Callable) -> None:
    text = refusal(rdpi, "compensate", "static.json", "reference.csv", "--remove-offset")
    assert text.startswith("reference.csv: ") and "recording" in text


@pytest.mark.parametrize("bits", [0, 21, -3])
def test_bad_dac_bits(bits: int, folder: Path, rdpi: Callable) -> None:
    assert re.search(r"dac.bits.*1 to 20", refusal(rdpi, "compensate", "static.json", None, "--dac-bits", bits))


# ---- header and plot ----

def test_header(folder: Path, rdpi: Callable) -> None:
    result, text = result_of(rdpi, "header", "moving.json", "-o", "rdpi_params.h")
    first = Path("rdpi_params.h").read_bytes()
    assert result["file"] == "rdpi_params.h" and result["name"] == "rdpi_params" and result["digest"].encode() in first
    assert "9 plays, 2 dead zones" in text
    result_of(rdpi, "header", "moving.json", "-o", "again.h")
    assert Path("again.h").read_bytes() == first
    named, _ = result_of(rdpi, "header", "moving.json", "-o", "stack_x.h", "--name", "stack_x")
    assert named["name"] == "stack_x" and b"const rdpi_f32_params_t stack_x" in Path("stack_x.h").read_bytes()
    assert named["digest"] == result["digest"] != result_of(rdpi, "header", "static.json", "-o", "other.h")[0]["digest"]


def test_header_takes_the_start_up_sweep(folder: Path, rdpi: Callable) -> None:
    plain, text = result_of(rdpi, "header", "static.json", "-o", "plain.h")
    assert "start-up sweep ends at 0 V" in text and "    20, /* sweep_cycles" in Path("plain.h").read_text()
    result, text = result_of(rdpi, "header", "static.json", "-o", "params.h", "--sweep-end-V", 50, "--sweep-cycles", 7,
                             "--sweep-rate", 1234)
    assert "start-up sweep ends at 50 V" in text and result["digest"] != plain["digest"]
    header = Path("params.h").read_text()
    for line in ("7, /* sweep_cycles", "1234.00000f, /* sweep_V_per_s", "50.0000000f, /* sweep_end_V"):
        assert f"    {line}" in header
    for option, value, message in (("--sweep-end-V", 121, "drive.sweep_end_V: is 121 V, outside"),
                                   ("--sweep-cycles", 0, "drive.sweep_cycles: is 0; must be 1 to"),
                                   ("--sweep-rate", 0, "drive.sweep_V_per_s: is 0; must be positive")):
        assert message in refusal(rdpi, "header", "static.json", None, option, value)


def test_header_notes_a_slow_sweep(folder: Path, rdpi: Callable) -> None:
    _, text = result_of(rdpi, "header", "static.json", "-o", "params.h", "--sweep-rate", 0.5)
    assert re.search(r"note: at 0.5 V/s the start-up sweep is too slow for more than 3.74e\+03 samples per second",
                     text)


def test_header_without_fixed_point(folder: Path, rdpi: Callable) -> None:
    result, text = result_of(rdpi, "header", "static.json", "-o", "params.h")
    assert result["q31"] and "single precision" not in text
    change_model(rate=Rate(max_um_per_s=100.0, filter_s=5.0))
    result, text = result_of(rdpi, "header", "static.json", "-o", "params.h")
    assert not result["q31"]
    assert "note: the header has no fixed-point parameters, only single precision: rate.filter_s: is 5 s" in text
    message = refusal(rdpi, "compensate", "static.json", None, "--engine", "q31")
    assert message.startswith("static.json: no fixed point: rate.filter_s: is 5 s; at most 4.29 s")


def test_header_refuses_a_name(folder: Path, rdpi: Callable) -> None:
    assert "name 'two words'" in refusal(rdpi, "header", "static.json", None, "--name", "two words")


@pytest.mark.parametrize("name, start", [("p.png", b"\x89PNG"), ("p.svg", b"<?xml"), ("p.pdf", b"%PDF")])
def test_plot(name: str, start: bytes, folder: Path, rdpi: Callable) -> None:
    result, _ = result_of(rdpi, "plot", "static.json", "large.csv", "-o", name)
    assert result == {"file": name} and Path(name).read_bytes().startswith(start)


@pytest.mark.slow
def test_plot_shows_the_runs(folder: Path, rdpi: Callable) -> None:
    result_of(rdpi, "plot", "moving.json", "fast.csv", "large.csv", "-o", "p.svg")
    result_of(rdpi, "plot", "moving.json", "fast.csv", "-o", "q.svg")
    assert len(Path("p.svg").read_bytes()) > 1.2 * len(Path("q.svg").read_bytes())


def test_plot_refuses_a_format(folder: Path, rdpi: Callable) -> None:
    done = rdpi("plot", "static.json", "large.csv", "-o", "p.bmp")
    assert done.exit_code == 2 and not Path("p.bmp").exists()
    assert re.match(r"rdpi: p\.bmp: .*\.png, \.svg or \.pdf", done.output)


# ---- bad input, whatever the command ----

COMMANDS = {"simulate": ("large.csv", "out.csv"), "compensate": ("reference.csv", "out.csv"),
            "plot": ("large.csv", "out.png"), "header": (None, "out.h")}


def refusal(rdpi: Callable, command: str, model: str, source: str | None = None, *arguments: object) -> str:
    """The message with which the command refuses; no file is touched, be there an output already or not."""
    usual, output = COMMANDS[command]
    sources = [source or usual] if usual else []
    for existing in (False, True):
        if existing:
            Path(output).write_text("as it was\n")
        before = {path: path.read_bytes() for path in Path().iterdir()}
        done = rdpi(command, model, *sources, "-o", output, *arguments)
        assert done.exit_code == 2, done.output
        assert done.output.startswith("rdpi: ") and done.output.count("\n") == 1 and "Traceback" not in done.output
        assert {path: path.read_bytes() for path in Path().iterdir()} == before
    return done.output.removeprefix("rdpi: ").strip()


def document(change: Callable[[dict], object]) -> Callable[[str], str]:
    def edit(text: str) -> str:
        content = json.loads(text)
        change(content)
        return json.dumps(content, indent=1)

    return edit


BAD_MODEL: dict[str, tuple[Callable[[str], str], str]] = {
    "cut in half": (lambda text: text[:len(text) // 2], r"not a complete JSON document .*line \d+.*fit again"),
    "empty": (lambda text: "", r"JSON"),
    "a recording": (lambda text: Path("large.csv").read_text(), r"JSON"),
    "negative slope": (document(lambda model: model["slopes"].__setitem__(3, -0.1)),
                       r"slopes\[3\]: is -0\.1; every slope must be positive"),
    "unsorted thresholds": (document(lambda model: model["thresholds_um"].sort(reverse=True)),
                            r"thresholds_um: must start at 0 and increase.*sort"),
    "repeated threshold": (document(lambda model: model["thresholds_um"].__setitem__(2, model["thresholds_um"][1])),
                           r"thresholds_um: must .*increase.*twice"),
    "wrong schema": (document(lambda model: model.update(schema="rdpi-model/9")),
                     r'schema: is "rdpi-model/9", expected "rdpi-model/1".*fit again'),
    "no schema": (document(lambda model: model.pop("schema")), r"schema: is null"),
    "missing key": (document(lambda model: model.pop("gain_um_per_V")), r"gain_um_per_V: missing; fit again"),
    "text for a number": (document(lambda model: model.update(offset_V="ten")),
                          r'offset_V: must be a finite number, got "ten"'),
    "NaN": (lambda text: text.replace('"stroke_um": 12.0', '"stroke_um": NaN'), r"NaN"),
    "one slope too few": (document(lambda model: model["slopes"].pop()), r"slopes: has 9 values, expected 10"),
    "guard past the singularity": (document(lambda model: model["rate"].update(max_um_per_s=1e6)),
                                   r"rate\.max_um_per_s: at 1e\+06 um/s slope \d.*use \d+"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("case", BAD_MODEL)
def test_bad_model(case: str, command: str, folder: Path, rdpi: Callable) -> None:
    change, message = BAD_MODEL[case]
    Path("bad.json").write_text(change(Path("moving.json").read_text()))
    text = refusal(rdpi, command, "bad.json")
    assert re.match(r"bad\.json: .*" + message, text), text


@pytest.mark.parametrize("command", COMMANDS)
def test_missing_model(command: str, folder: Path, rdpi: Callable) -> None:
    assert re.match(r"nowhere\.json: .*No such file.*check", refusal(rdpi, command, "nowhere.json"))


def test_effects_of_a_later_version(folder: Path, rdpi: Callable) -> None:
    change_model(effects=[{"name": "poltergeist"}])
    for command in ("simulate", "plot"):
        assert re.match(r"static\.json: effects\[0\].*poltergeist.*cannot simulate",
                        refusal(rdpi, command, "static.json"))


def columns_without(name: str) -> Callable[[list[str]], list[str]]:
    return lambda lines: [line.replace(name, "sensor") for line in lines]


# Lines 1 and 2 are metadata, 3 the names of the columns, 4 the first sample of large.csv.
BAD_RUN: dict[str, tuple[Callable[[list[str]], list[str]], str]] = {
    "missing column": (columns_without("command_V"), r":3: there is no column command_V; "
                       r"the columns are .*sensor.*\. Rename"),
    "NaN": (lambda lines: [*lines[:20], "0.017,nan,1,1\n", *lines[21:]],
            r":21: column command_V is nan; .*(cut|interpolate)"),
    "text": (lambda lines: [*lines[:20], "0.017,off,1,1\n", *lines[21:]],
             r":21: column command_V is 'off', not a number"),
    "too short": (lambda lines: lines[:18], r": 15 samples; a recording needs at least 16"),
    "backwards time": (lambda lines: [*lines[:30], *lines[10:]], r":31: time_s runs backwards .*cut"),
    "wrong rate": (lambda lines: [lines[0].replace("1000", "900"), *lines[1:]],
                   r":1: sample_rate_hz is 900, but the times give 1000"),
}


@pytest.mark.parametrize("command", ["simulate", "plot"])
@pytest.mark.parametrize("case", BAD_RUN)
def test_bad_recording(case: str, command: str, folder: Path, rdpi: Callable) -> None:
    change, message = BAD_RUN[case]
    Path("bad.csv").write_text("".join(change(Path("large.csv").read_text().splitlines(keepends=True))))
    text = refusal(rdpi, command, "static.json", "bad.csv")
    assert re.match(r"bad\.csv" + message, text), text


def test_bad_reference(folder: Path, rdpi: Callable) -> None:
    lines = Path("reference.csv").read_text().splitlines(keepends=True)
    for text, message in (
            ([*lines[:30], "0.028,nan\n", *lines[31:]], r"bad\.csv:31: column reference_um is nan"),
            (columns_without("reference_um")(lines), r"bad\.csv:2: there is no column "
             r"reference_um; the columns are time_s, sensor"),
            (lines[:10], r"bad\.csv: 8 samples")):
        Path("bad.csv").write_text("".join(text))
        assert re.match(message, refusal(rdpi, "compensate", "static.json", "bad.csv"))
    text = refusal(rdpi, "compensate", "static.json", None, "--reference-column", "wish")
    assert re.match(r"reference\.csv:2: there is no column wish", text)
    assert re.match(r"nowhere\.csv: cannot be read", refusal(rdpi, "compensate", "static.json", "nowhere.csv"))


@pytest.mark.parametrize("command", COMMANDS)
def test_unwritable(command: str, folder: Path, rdpi: Callable) -> None:
    usual, output = COMMANDS[command]
    done = rdpi(command, "static.json", *([usual] if usual else []), "-o", f"missing/{output}")
    assert done.exit_code == 2 and "Traceback" not in done.output
    assert done.output == f"rdpi: missing/{output}: there is no directory missing; create it first\n"


@pytest.mark.parametrize("command", COMMANDS)
def test_an_output_never_replaces_an_input(command: str, folder: Path, rdpi: Callable) -> None:
    usual, _ = COMMANDS[command]
    for name in filter(None, ("static.json", usual)):
        before = Path(name).read_bytes()
        done = rdpi(command, "static.json", *([usual] if usual else []), "-o", name)
        assert done.exit_code == 2 and f"rdpi: {name}: " in done.output and Path(name).read_bytes() == before


# ---- as a program ----

@pytest.mark.slow
def test_the_whole_chain_as_a_program(folder: Path) -> None:
    """Piped, as scripts use it: fit, header, compensate, simulate. Nothing on stderr, and every file is there."""
    run = read_recording("large.csv")
    write_recording("drive.csv", {"time_s": run.time_s, "reference_um": 0.8 * run.displacement_um.clip(0)}, {})
    for line in ("fit large.csv -o model.json --rate-independent", "header model.json -o model.h",
                 "compensate model.json drive.csv -o out.csv",
                 "simulate model.json out.csv -o back.csv --json back.json",
                 "plot model.json large.csv"):
        done = subprocess.run([sys.executable, "-m", "rdpi", *line.split()], capture_output=True, text=True,
                              env=os.environ | {"PYTHONPATH": str(HOST_TOOLS)})
        assert (done.returncode, done.stderr) == (0, ""), line
        assert done.stdout
    for name in ("model.json", "model.h", "out.csv", "back.csv", "back.json", "rdpi.png"):
        assert Path(name).stat().st_size
    back = read_recording("back.csv", required=("predicted_um", "reference_um"))
    inside = back.columns["flags"] == 0
    assert inside.mean() > 0.9
    assert back.columns["predicted_um"][inside] == pytest.approx(back.columns["reference_um"][inside], abs=1e-3)
