"""`rdpi simulate`, `header` and `plot` as a user types them: what they write and print."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from chain_files import change_model, refusal, result_of, write_files
from plants import recording, stack, waves

from rdpi import firmware
from rdpi.data import read_recording, write_recording
from rdpi.model import Rate, read_model

HOST_TOOLS = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_files(tmp_path_factory.mktemp("files"))


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
        assert re.match(r"still\.csv: .*range is 0 .*check", text)


def test_simulate_gate_without_anything_to_judge(folder: Path, rdpi: Callable) -> None:
    run = read_recording("large.csv")
    write_recording("drive.csv", {"time_s": run.time_s, "command_V": run.command_V}, {})
    assert "--max-rms" in refusal(rdpi, "simulate", "static.json", "drive.csv", "--max-rms", 1)


def test_simulate_refuses_one_output_for_several_runs(folder: Path, rdpi: Callable) -> None:
    assert "one RUN" in refusal(rdpi, "simulate", "static.json", "large.csv", "carried.csv")


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


EFFECTS = [{"name": "delay", "parameters": {"delay_s": {"value": 0.0005, "ci95": None, "unit": "s"}}, "origin": "fit"},
           {"name": "creep", "parameters": {"percent_per_decade": 2}},
           {"name": "cross_coupling", "column": "other_axis_V", "parameters": {"um_per_V": 0.25}},
           {"name": "quantisation", "stage": "DAC", "parameters": {"step": 0.1, "origin": 0.0, "dither": 0}}]
COMMANDS_OF_INVERSE = [("header", "static.json", "-o", "out.h"),
                       ("compensate", "static.json", "reference.csv", "-o", "drive.csv")]


@pytest.mark.parametrize("command", COMMANDS_OF_INVERSE)
def test_one_line_for_each_effect(command: tuple[str, ...], folder: Path, rdpi: Callable) -> None:
    """And none for a model without effects."""
    assert " at stage " not in rdpi(*command).output
    change_model(effects=EFFECTS)
    result, text = result_of(rdpi, *command)
    lines = [line for line in text.splitlines() if " at stage " in line]
    assert [line.partition(" (")[0] for line in lines] == [
        "quantisation at stage DAC", "delay at stage timing", "creep at stage actuator",
        "cross_coupling at stage environment"]
    assert "left out: " in lines[0] and "compensated by the lead, which looks 500 us ahead; nothing shows" in lines[1]
    assert [one["firmware"] for one in result["effects"]] == ["left out", "compensated", "compensated", "compensated"]
    assert all(one["why"] in line for one, line in zip(result["effects"], lines))


@pytest.mark.parametrize("command", COMMANDS_OF_INVERSE)
def test_options_say_what_is_compensated(command: tuple[str, ...], folder: Path, rdpi: Callable) -> None:
    change_model(effects=EFFECTS)
    _, text = result_of(rdpi, *command, "--leave-out", "delay", "--leave-out", "creep")
    assert text.count("left out: as asked") == 2
    assert "delay at stage timing (delay_s 0.0005 s): left out: as asked" in text
    none, text = result_of(rdpi, *command, "--effects", "none")
    assert text.count("left out: as asked") == 4 and {one["firmware"] for one in none["effects"]} == {"left out"}
    assert "--no-preview" not in text
    assert "note: --no-preview changes nothing" in result_of(rdpi, *command, "--effects", "none", "--no-preview")[1]
    _, text = result_of(rdpi, *command, "--sensor-delay", "0.0002")
    assert "which looks 300 us ahead" in text and "without preview" not in text
    _, text = result_of(rdpi, *command, "--no-preview")
    table = text.partition("without preview, ")[2].splitlines()[2:]
    assert table[0].split() == ["1", "0.314", "%", "5.17e-07", "%"]
    for options, words in ((("--leave-out", "lag"), "does not hold this effect"),
                           (("--effects", "none", "--leave-out", "delay"), "--effects none leaves all effects out"),
                           (("--sensor-lag", "0.01"), "later than all"),
                           (("--sensor-delay", "0.0001", "--effects", "none"), "from delay, which is left out"),
                           (("--sensor-lag", "0.0001", "--leave-out", "delay"), "from delay, which is left out"),
                           (("--backlash-time", "0"), "must be a time in s, 1e-06 to 10")):
        done = rdpi(*command, *options)
        assert done.exit_code == 2 and words in " ".join(done.output.split())


def test_the_header_of_a_chain(folder: Path, rdpi: Callable) -> None:
    plain, _ = result_of(rdpi, "header", "static.json", "-o", "plain.h")
    assert "#define RDPI_PARAMS_CHAIN 0" in Path("plain.h").read_text() and plain["chain"] is False
    change_model(effects=EFFECTS)
    whole, _ = result_of(rdpi, "header", "static.json", "-o", "whole.h")
    text = Path("whole.h").read_text()
    assert "#define RDPI_PARAMS_CHAIN 1" in text and whole["chain"] is True and whole["digest"] != plain["digest"]
    assert "#define RDPI_PARAMS_OTHER_AXIS_V_UM(value) ((value) * (0.25))" in text
    assert "    9, /* poles */" in text and "500000u, /* delay_ns: ns: delay */" in text
    none, _ = result_of(rdpi, "header", "static.json", "-o", "none.h", "--effects", "none")
    assert Path("none.h").read_bytes() == Path("plain.h").read_bytes() and none["digest"] == plain["digest"]
    later, _ = result_of(rdpi, "header", "static.json", "-o", "later.h", "--no-preview", "--name", "x_axis")
    text = Path("later.h").read_text()
    assert "rdpi_f32_chain_params_t x_axis_chain = {" in text and "rdpi_q31_chain_params_t x_axis_chain_q31 = {" in text
    assert "    0, /* preview: 1: the caller" in text and later["digest"] not in (whole["digest"], plain["digest"])


def test_the_drive_of_a_chain(folder: Path, rdpi: Callable) -> None:
    """It comes early by the delay; the file is its own future."""
    change_model(effects=EFFECTS[:1])
    result, _ = result_of(rdpi, "compensate", "static.json", "reference.csv", "-o", "early.csv", "--engine", "f64")
    result_of(rdpi, "compensate", "static.json", "reference.csv", "-o", "plain.csv", "--engine", "f64", "--effects",
              "none")
    early, plain = (read_recording(name, required=("time_s", "command_V")).command_V
                    for name in ("early.csv", "plain.csv"))
    assert result["lead_count"] == 0
    late = np.interp(np.arange(len(early)) - 0.5, np.arange(len(early)), early)
    assert np.abs(late - plain)[5:].max() < 0.3 * np.abs(early - plain)[5:].max()


def test_header_takes_the_start_up_sweep(folder: Path, rdpi: Callable) -> None:
    plain, text = result_of(rdpi, "header", "static.json", "-o", "plain.h")
    assert "start-up sweep ends at 0 V" in text and "    20, /* sweep_cycles" in Path("plain.h").read_text()
    result, text = result_of(rdpi, "header", "static.json", "-o", "params.h", "--sweep-end-V", 50, "--sweep-cycles", 7,
                             "--sweep-rate", 1234)
    assert "start-up sweep ends at 50 V" in text and result["digest"] != plain["digest"]
    header = Path("params.h").read_text()
    for line in ("7, /* sweep_cycles", "1234.00000f, /* sweep_V_per_s", "50.0000000f, /* sweep_end_V"):
        assert f"    {line}" in header


def test_header_tells_the_sample_rates_that_init_takes(folder: Path, rdpi: Callable) -> None:
    for options, words in (((), "sample rates 320 Hz to 2 MHz\n"),  # 5600 V/s over 140 V in 8 samples
                           (("--sweep-rate", 1234), "sample rates 70.52 Hz to 2 MHz\n"),
                           (("--sweep-rate", 1e5), "sample rates 5.715 kHz to 2 MHz\n")):
        result, text = result_of(rdpi, "header", "static.json", "-o", "params.h", *options)
        assert words in text
        model = read_model("static.json")
        if options:
            model.drive.sweep_V_per_s = options[1]
        lowest_hz, highest_hz = result["sample_rates_hz"]
        assert not any(firmware.beyond_sample_times(model, 1 / rate_hz) for rate_hz in (lowest_hz, highest_hz))
        assert all(firmware.beyond_sample_times(model, 1 / rate_hz) for rate_hz in (0.999 * lowest_hz, 1.001 * highest_hz))


def test_header_refuses_a_start_up_sweep_by_its_option(folder: Path, rdpi: Callable) -> None:
    bent = {"quadratic": 0.1, "cubic": 0.0, "low_V": -20.0, "high_V": 120.0}  # what is folded in is not to blame
    change_model(effects=[{"name": "input_curve", "parameters": bent}])
    for option, value, message in (("--sweep-end-V", 121, "drive.sweep_end_V: is 121 V, outside"),
                                   ("--sweep-end-V", "nan", "drive.sweep_end_V: must be finite"),
                                   ("--sweep-cycles", 0, "drive.sweep_cycles: is 0; must be 1 to"),
                                   ("--sweep-rate", 0, "drive.sweep_V_per_s: is 0; must be positive"),
                                   ("--sweep-rate", "inf", "drive.sweep_V_per_s: must be finite")):
        assert refusal(rdpi, "header", "static.json", None, option, value).startswith(f"{option} {value}: {message}")


def test_header_notes_a_slow_sweep(folder: Path, rdpi: Callable) -> None:
    _, text = result_of(rdpi, "header", "static.json", "-o", "params.h", "--sweep-rate", 0.5)
    assert re.search(r"note: the start-up sweep, 0.5 V/s, is too slow for more than 3.74e\+03 samples per second", text)


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
