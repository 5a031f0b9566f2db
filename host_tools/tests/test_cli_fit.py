"""`rdpi fit` as a user types it: what it writes, prints and refuses."""

from __future__ import annotations

import json
import shutil
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from plants import Plant, quasi_static, slopes_um_per_V, stack, waves

from rdpi.data import Recording, read_recording, sample_times, write_recording
from rdpi.model import read_model
from rdpi.simulate import chain

HOST_TOOLS = Path(__file__).resolve().parents[1]
KEYS = {"schema", "tool", "actuator", "gain_um_per_V", "offset_V", "offset_um", "stroke_um", "thresholds_um", "slopes",
        "slope_rate_s_per_um", "deadzones_um", "deadzone_weights", "rate", "drive", "memory", "fit", "effects",
        "passport"}
ROW = {"file", "digest", "samples", "held_out", "memory", "rms_um", "max_um", "rms_percent", "max_percent", "offset_um"}


def write(path: Path, run: Recording) -> Path:
    write_recording(path, run.columns, {**run.metadata, "actuator": "stack 7"})
    return path


def run_of(plant: Plant, high: float, cycles: float = 2) -> Recording:
    return quasi_static(plant, waves(high, 1, cycles, 500), 500.0, noise_um=0.004)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("runs")
    return {name: write(folder / f"{name}.csv", run_of(stack(), high))
            for name, high in {"large": 90, "small": 60, "held": 75}.items()}


@pytest.fixture
def fitted(rdpi: Callable, runs: dict[str, Path], tmp_path: Path) -> Callable:
    """Fit the large run with further arguments; returns the model as JSON, the result of --json and the output."""

    def run(*arguments: object, status: int = 0) -> tuple[dict, dict, str]:
        model, result = tmp_path / "model.json", tmp_path / "result.json"
        done = rdpi("fit", runs["large"], "-o", model, "--json", result, *arguments)
        assert done.exit_code == status, done.output
        return json.loads(model.read_text()), json.loads(result.read_text()), done.output

    return run


# ---- what it writes ----

def test_model_file(fitted: Callable, runs: dict[str, Path], tmp_path: Path) -> None:
    document, _, _ = fitted(runs["small"], "--rate-independent")
    assert set(document) == KEYS
    assert document["schema"] == "rdpi-model/1" and document["actuator"] == "stack 7"
    assert document["tool"].startswith("rdpi ")
    assert len(document["slopes"]) == len(document["thresholds_um"]) == len(document["slope_rate_s_per_um"]) == 10
    assert len(document["deadzones_um"]) == len(document["deadzone_weights"]) == 3
    assert document["thresholds_um"][0] == document["deadzones_um"][0] == 0 and document["deadzone_weights"][0] == 1
    assert document["slope_rate_s_per_um"] == [0] * 10 and document["rate"]["singular_um_per_s"] is None
    assert document["rate"]["source"] == "displacement" and document["effects"] == []
    assert document["passport"]["schema"] == "rdpi-passport/1" and len(document["passport"]["runs"]) == 2
    assert {"min_V", "max_V", "slew_V_per_s"} <= set(document["drive"])
    assert set(document["memory"]) == {"x_um", "plays_um", "sweep_share"}
    model = read_model(tmp_path / "model.json")
    assert slopes_um_per_V(model) == pytest.approx(stack().slopes, rel=0.02)
    assert document["fit"]["runs"][0]["digest"] == read_recording(runs["large"]).digest


def test_same_command_same_bytes(fitted: Callable, tmp_path: Path) -> None:
    first, second = [(fitted(), (tmp_path / "model.json").read_bytes())[1] for _ in range(2)]
    assert first == second


def test_json(fitted: Callable, runs: dict[str, Path], tmp_path: Path) -> None:
    document, result, _ = fitted(runs["small"], "--hold-out", runs["held"])
    assert [Path(row["file"]).name for row in result["runs"]] == ["large.csv", "small.csv", "held.csv"]
    assert [row["held_out"] for row in result["runs"]] == [False, False, True]
    model = read_model(tmp_path / "model.json")
    for row in result["runs"]:
        assert set(row) == ROW
        run = read_recording(row["file"])
        error = run.displacement_um - chain.simulate(model, [run])[0].predicted_um
        assert row["samples"] == len(run) and row["digest"] == run.digest and row["memory"] == "reset"
        assert row["rms_um"] == pytest.approx(np.sqrt(np.mean(error**2)))
        assert row["max_um"] == pytest.approx(np.abs(error).max())
        assert row["rms_percent"] == pytest.approx(100 * row["rms_um"] / np.ptp(run.displacement_um))
        assert row["max_percent"] == pytest.approx(100 * row["max_um"] / np.ptp(run.displacement_um))
    assert result["model"] == str(tmp_path / "model.json") and result["gate_failed"] is False
    assert result["noise_um"] == pytest.approx(0.004, rel=0.2)
    assert result["warnings"] == []
    first, other = result["variants"]
    assert first["rate_law"] == bool(np.any(model.slope_rate_s_per_um)) != other["rate_law"]
    assert first["effects"] == other["effects"] == [] and first["parameters"] != other["parameters"]
    for band in result["rate_slopes"]:
        assert set(band) == {"rate_um_per_s", "slopes", "samples"} and len(band["slopes"]) == 10
    assert {key: result[key] for key in ("runs", "noise_um", "warnings", "variants")} == document["fit"]


def test_printed(fitted: Callable, runs: dict[str, Path]) -> None:
    document, result, text = fitted("--hold-out", runs["held"])
    for row in result["runs"]:
        line = next(line for line in text.splitlines() if line.strip().startswith(row["file"]))
        assert f"{row['rms_percent']:.3f}" in line and f"{row['max_percent']:.3f}" in line
        assert line.endswith("held out" if row["held_out"] else "fitted")
    assert "9 plays, 2 dead zones" in text and "% of the run's stroke" in text and "W_9" in text
    assert f"guard at {document['rate']['max_um_per_s']:.4g} um/s" in text
    rows = [[float(cell) for cell in re.findall(r"(?<= )\d\.\d{3}\b", line)] for line in text.splitlines()]
    rest, top = document["slopes"], document["rate"]["identified_um_per_s"]
    fast = [slope + top * change for slope, change in zip(rest, document["slope_rate_s_per_um"])]
    for slopes in (rest, fast):
        assert any(len(row) == 10 and row == pytest.approx(slopes, abs=6e-4) for row in rows)
    assert sum(len(row) >= 5 for row in rows) == len(result["rate_slopes"]) + 2


def test_report(fitted: Callable, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "report"
    _, result, _ = fitted("--report", folder)
    assert {path.name for path in folder.iterdir()} == {"fit.html", "fit.png", "fit.json"}
    assert (folder / "fit.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((folder / "fit.json").read_text()) == result


def test_the_model_beside_the_report(runs: dict[str, Path], rdpi: Callable, tmp_path: Path) -> None:
    folder = tmp_path / "new"
    done = rdpi("fit", runs["large"], "-o", folder / "model.json", "--report", folder)
    assert done.exit_code == 0, done.output
    assert {path.name for path in folder.iterdir()} == {"fit.html", "fit.png", "fit.json", "model.json"}


# ---- what the options do ----

@pytest.mark.parametrize("arguments, place, value", [
    (["--operators", 4], "thresholds_um", lambda value: len(value) == 5),
    (["--operators", 0], "slopes", lambda value: len(value) == 1),
    (["--deadzones", 0], "deadzones_um", lambda value: value == [0]),
    (["--deadzones", 4], "deadzone_weights", lambda value: len(value) == 5),
    (["--thresholds", "1,2.5,4"], "thresholds_um", lambda value: value == [0, 1, 2.5, 4]),
    (["--rate-source", "control"], "rate.source", lambda value: value == "control"),
    (["--rate-window", 0.02], "rate.window_s", lambda value: value == 0.02),
    (["--rate-filter", 0.01], "rate.filter_s", lambda value: value == 0.01),
    (["--min-slope-ratio", 0.4], "rate.min_slope_ratio", lambda value: value == 0.4),
    (["--min-V", -10], "drive.min_V", lambda value: value == -10),
    (["--max-V", 120], "drive.max_V", lambda value: value == 120),
    ([], "drive.max_V", lambda value: value == pytest.approx(90, rel=1e-6)),
    (["--slew", 5000], "drive.slew_V_per_s", lambda value: value == 5000),
    ([], "drive.slew_V_per_s", lambda value: value is None),
    (["--dac-bits", 12], "drive.dac_bits", lambda value: value == 12),
    (["--actuator", "other"], "actuator", lambda value: value == "other"),
])
def test_options(arguments: list[object], place: str, value: Callable, fitted: Callable) -> None:
    document, _, _ = fitted(*arguments)
    for key in place.split("."):
        document = document[key]
    assert value(document)


def test_unobservable_thresholds_are_named(fitted: Callable) -> None:
    document, result, text = fitted("--thresholds", "1,3,50")
    assert document["thresholds_um"] == [0, 1, 3]
    assert "note: thresholds 50 um are not fitted: they are unobservable" in text
    assert "unobservable" in result["warnings"][0]


def test_quality_gate(fitted: Callable, runs: dict[str, Path]) -> None:
    """--max-rms judges held-out runs, or all if there are none; the model is written all the same."""
    held = ["--hold-out", runs["held"], "--operators", 2]  # predicted worse than the fitted run
    _, result, _ = fitted(*held)
    seen, unseen = (row["rms_percent"] for row in result["runs"])
    limit = 0.5 * (seen + unseen)
    assert seen < limit < unseen
    document, result, text = fitted(*held, "--max-rms", limit, status=1)
    assert result["gate_failed"] is True and document["slopes"]
    assert f"the rms error is {unseen:.3g} %; --max-rms allows {limit:g} %" in text
    assert fitted(*held, "--max-rms", 1.1 * unseen)[1]["gate_failed"] is False
    assert fitted("--operators", 2, "--max-rms", 1.1 * seen)[1]["gate_failed"] is False
    fitted("--operators", 2, "--max-rms", 0.9 * seen, status=1)


def test_quality_gate_does_not_judge_what_was_fitted_beside_a_held_out_run(
        runs: dict[str, Path], rdpi: Callable, tmp_path: Path) -> None:
    noisy = tmp_path / "noisy.csv"
    run = read_recording(runs["small"])
    noise = 0.1 * np.random.default_rng(1).standard_normal(len(run))
    write_recording(noisy, {**run.columns, "displacement_um": run.displacement_um + noise}, run.metadata)
    result = tmp_path / "result.json"
    command = ["fit", noisy, "--hold-out", runs["small"], "-o", tmp_path / "model.json", "--json", result]
    assert rdpi(*command).exit_code == 0
    seen, unseen = (row["rms_percent"] for row in json.loads(result.read_text())["runs"])
    assert unseen < 0.5 * seen
    assert rdpi(*command, "--max-rms", 1.1 * unseen).exit_code == 0


# ---- what it refuses ----

def lines_of(path: Path) -> list[str]:
    return path.read_text().splitlines(keepends=True)


def edit(line: int, old: str, new: str) -> Callable[[list[str]], list[str]]:
    """Replace in one line, counted from 1 as messages do."""

    def change(lines: list[str]) -> list[str]:
        assert old in lines[line - 1], lines[line - 1]
        return [*lines[:line - 1], lines[line - 1].replace(old, new, 1), *lines[line:]]

    return change


def columns(**changes: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        run = read_recording(path)
        changed = {name: make(run.columns[name]) for name, make in changes.items()}
        write_recording(path, {**run.columns, **changed}, run.metadata)

    return change


# Lines 1 to 3 are metadata, 4 the names of the columns, 5 the first sample.
BAD_TEXT: dict[str, tuple[Callable[[list[str]], list[str]], str]] = {
    "missing column": (edit(4, "displacement_um", "sensor"),
                       r":4: there is no column displacement_um; the columns are "
                       r"time_s, command_V, sensor\. .*rdpi import"),
    "NaN": (lambda lines: [*lines[:20], "0.032,1.5,nan\n", *lines[21:]],
            r":21: column displacement_um is nan; .*(cut|interpolate)"),
    "text": (lambda lines: [*lines[:20], "0.032,off,1.5\n", *lines[21:]],
             r":21: column command_V is 'off', not a number; correct"),
    "too short": (lambda lines: lines[:19], r": 15 samples; at least 16 are needed"),
    "empty": (lambda lines: [], r": is empty; a recording has"),
    "backwards time": (lambda lines: [*lines[:30], *lines[10:]],
                       r":31: time_s runs backwards \(0\.05 then 0\.012\); cut"),
    "a gap": (lambda lines: [*lines[:30], *lines[40:]], r":31: sampling is not uniform.*0\.022.*0\.002.*resample"),
    "wrong rate": (edit(1, "500", "5000"), r":1: sample_rate_hz is 5000, but the times give 500; correct"),
    "unknown memory": (edit(2, "reset", "forgotten"), r":2: memory is 'forgotten'; use one of reset, low, high, carried, unknown"),
}
BAD_COLUMNS: dict[str, tuple[Callable[[Path], None], str]] = {
    "constant command": (columns(command_V=lambda V: 0 * V + 12.5),
                         r": command_V is constant at 12\.5 V; .*rdpi excite"),
    "constant displacement": (columns(displacement_um=lambda z: 0 * z + 3),
                              r": displacement_um is constant at 3 um; check"),
    "unrelated": (columns(displacement_um=lambda z: np.random.default_rng(1).permutation(z)),
                  r": command_V and displacement_um are unrelated \(correlation -?0\.\d\d\); check"),
}


@pytest.mark.parametrize("case", [*BAD_TEXT, *BAD_COLUMNS])
@pytest.mark.parametrize("held_out", [False, True])
def test_bad_recording(case: str, held_out: bool, runs: dict[str, Path], refused: Callable, tmp_path: Path) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_bytes(runs["small"].read_bytes())
    if case in BAD_TEXT:
        change, message = BAD_TEXT[case]
        bad.write_text("".join(change(lines_of(bad))))
    else:
        change, message = BAD_COLUMNS[case]
        change(bad)
    text = refused("fit", runs["large"], *(["--hold-out", bad] if held_out else [bad]), "-o", refused.output)
    assert re.match(re.escape(str(bad)) + message, text), text


def test_json_is_not_written_over_a_table(rdpi: Callable, runs: dict[str, Path], tmp_path: Path) -> None:
    """Who forgets the name of the model writes it over the first of several recordings."""
    one, other = (shutil.copy(path, tmp_path) for path in [*runs.values()][:2])
    before = Path(one).read_bytes()
    for arguments in (["fit", "-o", one, other], ["fit", other, "-o", tmp_path / "m.json", "--json", one]):
        done = rdpi(*arguments)
        assert done.exit_code == 2 and f"{one}: is a table that is there already" in done.output
    assert Path(one).read_bytes() == before


def test_missing_file(refused: Callable, runs: dict[str, Path]) -> None:
    text = refused("fit", runs["large"].with_name("nowhere.csv"), "-o", refused.output)
    assert "nowhere.csv: cannot be read (No such file or directory); check the file name" in text


@pytest.mark.parametrize("arguments, message", [
    (["--operators", -1], "--operators -1: must be 0 to 128"), (["--deadzones", 9], "--deadzones 9: must be 0 to 6"),
    (["--thresholds", "2,1"], "--thresholds: must be positive"), (["--thresholds", "1,nan"], "--thresholds: must be"),
    (["--min-slope-ratio", 1.5], "--min-slope-ratio 1.5: must lie between 0 and 1"),
    (["--rate-window", -1], "--rate-window -1"), (["--rate-filter", -1], "--rate-filter -1"),
    (["--rate-window", 1e6], "--rate-window 1e"), (["--min-V", 200], "200"), (["--slew", -5], "--slew -5"),
    (["--dac-bits", 50], "--dac-bits 50"), (["--dac-bits", 0], "--dac-bits 0"), (["--effects", "speed"], "--effects: no"),
    (["--min-V", 5, "--max-V", 5], "--max-V 5: must be above the lowest drive, 5 V; give --min-V and --max-V"),
])
def test_bad_option(arguments: list[object], message: str, refused: Callable, runs: dict[str, Path]) -> None:
    assert re.search(message, refused("fit", runs["large"], *arguments, "-o", refused.output))


@pytest.mark.parametrize("arguments", [[], ["--thresholds", "1,two"], ["--rate-source", "both"], ["--max-rms", "x"]])
def test_bad_usage(arguments: list[str], rdpi: Callable, runs: dict[str, Path], tmp_path: Path) -> None:
    output = ["-o", tmp_path / "model.json"] if arguments else []  # -o itself may not be left out
    result = rdpi("fit", runs["large"], *arguments, *output)
    assert result.exit_code == 2 and "Usage: " in result.output and list(tmp_path.iterdir()) == []


def test_unwritable(rdpi: Callable, runs: dict[str, Path], tmp_path: Path) -> None:
    result = rdpi("fit", runs["large"], "-o", tmp_path / "missing" / "model.json")
    assert result.exit_code == 2 and "Traceback" not in result.output
    assert "missing/model.json: there is no directory" in result.output and "create it first" in result.output


@pytest.mark.slow
def test_as_a_program(runs: dict[str, Path], tmp_path: Path) -> None:
    """Piped: the result on stdout, notes of trouble alone on stderr, no progress bar."""

    def program(*arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-m", "rdpi", "fit", *map(str, arguments)], cwd=tmp_path,
                              capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(HOST_TOOLS)})

    done = program(runs["large"], "-o", "model.json", "--rate-independent")
    assert (done.returncode, done.stderr) == (0, "") and "model.json: 9 plays" in done.stdout
    failed = program(runs["large"], "-o", "model.json", "--rate-independent", "--max-rms", "1e-6")
    assert failed.returncode == 1 and failed.stderr.startswith("rdpi: ") and failed.stderr.count("\n") == 1
    before = (tmp_path / "model.json").read_bytes()
    time_s = sample_times(100, 1000)
    write_recording(tmp_path / "bad.csv", {"time_s": time_s, "command_V": 0 * time_s, "displacement_um": time_s}, {})
    refused = program("bad.csv", "-o", "model.json")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr.startswith("rdpi: bad.csv: command_V is constant")
    assert (tmp_path / "model.json").read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {"model.json", "bad.csv"}
