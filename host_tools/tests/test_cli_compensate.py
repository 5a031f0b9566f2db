"""`rdpi compensate` as a user types it: what it writes and prints."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pages import without_scripts
from chain_files import change_model, reference, refusal, result_of, write_files, write_reference
from plants import model_of, rate_of, stack, waves

from rdpi import firmware
from rdpi.data import Recording, read_recording, sample_times, write_recording
from rdpi.model import Drive, Memory, Rate, read_model, write_model

ENGINES = "f32", "q31", "f64", "numpy"
CLOSE = {"f32": (2e-4, 2e-2), "q31": (1e-5, 1e-4)}  # V, um/s
GUARD, RANGE, SLEW, INPUT, MISSED = 1, 2, 4, 8, 16


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_files(tmp_path_factory.mktemp("files"))


def compensated(rdpi: Callable, *arguments: object, model: str = "static.json",
                source: str = "reference.csv") -> tuple[Recording, dict]:
    result, _ = result_of(rdpi, "compensate", model, source, "-o", "drive.csv", *arguments)
    return read_recording("drive.csv", required=("command_V", "reference_um", "rate_um_per_s", "flags")), result


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


def test_a_drive_that_was_not_written_is_not_summed_up(folder: Path, rdpi: Callable) -> None:
    done = rdpi("compensate", "static.json", "reference.csv", "-o", "/dev/full")
    assert done.exit_code == 2 and "No space left" in done.output and "samples" not in done.output


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


def test_where_a_reference_begins_without_a_step(folder: Path, rdpi: Callable) -> None:
    model = replace(model_of(stack(law=0)), drive=Drive(-20.0, 120.0, sweep_end_V=50.0))
    x_um = float(model.x_of(50.0))
    write_model("static.json", replace(model, memory=Memory(x_um, model.swept(x_um))))

    def first(start_um: float, *options: str, **metadata: str) -> tuple[str, float]:
        write_reference("reference.csv", start_um + 0 * reference(), **metadata)
        printed = rdpi("compensate", "static.json", "reference.csv", "-o", "drive.csv", *options).stdout
        return printed, float(read_recording("drive.csv", required=("command_V",)).command_V[0])

    aside = r"the drive begins ([-+][\d.]+) V from .* a reference that begins at ([\d.]+) um and at rest begins without a step"
    for options in ((), ("--sweep",)):
        printed, begun_V = first(5.0, *options)
        assert "rdpi excite startup" in printed and "--end-V 50\n" in printed
        step_V, there_um = map(float, re.search(aside, printed).groups())
        assert begun_V == pytest.approx(50 + step_V, abs=0.01) and abs(step_V) > 1.4
        printed, begun_V = first(there_um, *options)
        assert not re.search(aside, printed) and begun_V == pytest.approx(50, abs=1.4)
    printed, begun_V = first(5.0, memory="reset")  # then the sweep ends where the reference begins
    assert not re.search(aside, printed) and f"--end-V {begun_V:g}" in printed


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


@pytest.mark.parametrize("engine", [*ENGINES])
def test_noise_shaping(engine: str, folder: Path, rdpi: Callable) -> None:
    """Held between two codes of 5 bits, the actuator is where it shall be in the mean."""
    change_model(drive=Drive(-20.0, 120.0, None, 5))
    write_reference("held.csv", np.full(400, 3.21))
    away_um = []
    for options in ((), ("--noise-shaping",)):
        compensated(rdpi, "--engine", engine, *options, source="held.csv")
        assert rdpi("simulate", "static.json", "drive.csv", "-o", "back.csv").exit_code == 0
        back_um = read_recording("back.csv", required=("predicted_um",)).columns["predicted_um"]
        away_um.append(abs(np.mean(back_um[-200:]) - 3.21))
    assert away_um[1] < 0.01 < 0.05 < away_um[0]


@pytest.mark.parametrize("command", ["header", "compensate"])
def test_noise_shaping_needs_codes(command: str, folder: Path, rdpi: Callable) -> None:
    words = refusal(rdpi, command, "static.json", None if command == "compensate" else (), "--noise-shaping")
    assert "--noise-shaping: is only valid with DAC codes, but static.json has no drive.dac_bits" in words


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


def test_the_page_shows_both_drives(folder: Path, rdpi: Callable) -> None:
    _, result = compensated(rdpi, "--reference-column", "displacement_um", "--report", "page", source="large.csv")
    page = without_scripts(Path("page/compensate.html").read_text())
    assert page.count("<figure>") == 3 and "% rms of the recorded drive" in page
    assert json.loads(Path("page/compensate.json").read_text()) == result


def test_the_page_without_a_recorded_drive(folder: Path, rdpi: Callable) -> None:
    """There is no reference in one sample."""
    run = read_recording("large.csv")
    reference_um = run.displacement_um.copy()
    reference_um[len(run) // 2] = 1e9
    write_recording("followed.csv", {"time_s": run.time_s, "reference_um": reference_um,
                                     "displacement_um": run.displacement_um}, {})
    compensated(rdpi, "--report", "page", source="followed.csv")
    page = without_scripts(Path("page/compensate.html").read_text())
    assert page.count("<figure>") == 2 and "recorded drive" not in page


def test_the_page_needs_a_displacement(folder: Path, rdpi: Callable) -> None:
    write_reference("alone.csv", reference())
    done = rdpi("compensate", "static.json", "alone.csv", "-o", "drive.csv", "--report", "page")
    assert done.exit_code == 2 and "displacement_um" in done.output
    assert not Path("drive.csv").exists() and not Path("page").exists()


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


def test_a_rate_that_a_board_refuses_is_noted(folder: Path, rdpi: Callable) -> None:
    rows = "\n".join(f"{k / 10!r},{5.0}" for k in range(20))
    (folder / "slow.csv").write_text(f"time_s,reference_um\n{rows}\n")
    _, said = result_of(rdpi, "compensate", "static.json", "slow.csv", "-o", "slow_drive.csv")
    assert "note: a board would refuse this rate: sample_time_s is 0.1, and the firmware takes" in str(said)
