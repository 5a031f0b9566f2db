"""`rdpi gap` as a user types it: what it writes, prints and refuses."""

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
from injected import LATER, RATE_HZ, commissioned, drives, entry, plain_model, recorded
from plants import changed, recording

from rdpi.data import Recording, read_recording, write_recording
from rdpi.model import read_model, write_model
from rdpi.simulate.effects import CATALOGUE

HOST_TOOLS = Path(__file__).resolve().parents[1]
KEYS = {"schema", "verdict", "effects", "candidates", "gap", "where", "next_experiment"}
LATE = tuple(f"late{k}.csv" for k in range(len(LATER)))
FRESH = tuple(f"fresh{k}.csv" for k in range(len(LATER)))


def write(name: Path | str, run: Recording) -> None:
    write_recording(name, run.columns, {**run.metadata, "actuator": "stack 7"})


def slow_sines(*entries: dict) -> list[Recording]:
    t = np.arange(5000) / RATE_HZ
    silent = [recording(50 - 50 * share * np.cos(2 * np.pi * t), None, RATE_HZ) for share in (1.0, 0.6)]
    return recorded(plain_model(), silent, *entries)


DELAYED = entry("delay", delay_s=0.003)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """model.json; recordings of its actuator fresh0.csv, ..., with a delay late0.csv, ..., and slow sines with it."""
    folder = tmp_path_factory.mktemp("files")
    write_model(folder / "model.json", replace(commissioned(), actuator="stack 7"))
    for names, entries in ((FRESH, []), (LATE, [DELAYED])):
        for name, run in zip(names, recorded(plain_model(), drives(LATER), *entries)):
            write(folder / name, run)
    for k, run in enumerate(slow_sines(DELAYED)):
        write(folder / f"sine{k}.csv", run)
    return folder


def gap_of(rdpi: Callable, *arguments: object) -> tuple[dict, str]:
    done = rdpi("gap", *arguments, "--json", "result.json")
    assert done.exit_code == 0, done.output
    return json.loads(Path("result.json").read_text()), done.output


def change_model(**changes: object) -> None:
    document = json.loads(Path("model.json").read_text())
    Path("model.json").write_text(json.dumps({**document, **changes}))


# ---- what it writes and prints ----

def test_an_effect(folder: Path, rdpi: Callable) -> None:
    result, text = gap_of(rdpi, "model.json", *LATE, "-o", "improved.json")
    assert KEYS <= set(result) and result["schema"] == "rdpi-gap/1" and result["verdict"] == "effect"
    (found,) = result["effects"]
    assert found["name"] == "delay"
    assert found["parameters"]["delay_s"]["value"] == pytest.approx(0.003, rel=0.01)
    assert found["parameters"]["delay_s"]["unit"] == "s"
    assert result["model"] == "model.json" and result["model_digest"] == read_model("model.json").digest()
    assert [row["file"] for row in result["runs"]] == list(LATE)
    assert [row["digest"] for row in result["runs"]] == [read_recording(name).digest for name in LATE]
    assert "delay" in text and "rate" in text and result["where"]["dominant"] == "rate_um_per_s"
    assert re.search(r"^improved\.json: the model with delay$", text, re.MULTILINE)
    assert all(one["name"] in text for one in result["candidates"] if one["shrink"] > 0.5)


def test_a_change_of_an_effect_that_the_model_holds(folder: Path, rdpi: Callable) -> None:
    change_model(effects=[{**entry("delay", delay_s=0.002), "origin": "fit"}])
    result, text = gap_of(rdpi, "model.json", *LATE, "-o", "improved.json", "--report", "out")
    (found,) = result["effects"]
    assert found["name"] == "delay" and found["was"] == {"delay_s": 0.002}
    assert found["parameters"]["delay_s"]["value"] == pytest.approx(0.003, rel=0.02)
    assert "change of the signal delay from 2.0" in " ".join(text.split())
    assert "improved.json: the model with delay changed\n" in text
    assert "delay from 2.0" in Path("out/index.html").read_text("utf-8")
    (only,) = json.loads(Path("improved.json").read_text())["effects"]
    assert only == {**{key: found[key] for key in ("name", "stage", "parameters", "was")}, "origin": "gap"}
    assert gap_of(rdpi, "improved.json", *LATE)[0]["verdict"] == "none"


def test_the_improved_model_is_the_model_with_the_effect(folder: Path, rdpi: Callable) -> None:
    result, _ = gap_of(rdpi, "model.json", *LATE, "-o", "improved.json")
    before, after = (json.loads(Path(name).read_text()) for name in ("model.json", "improved.json"))
    assert after["effects"] == [{key: one[key] for key in ("name", "stage", "parameters")} | {"origin": "gap"}
                                for one in result["effects"]]
    added = result["offset_um"]["added"]
    assert after["offset_um"] == pytest.approx(before["offset_um"] + added)
    assert {**after, "effects": [], "offset_um": before["offset_um"]} == before
    done = rdpi("simulate", "improved.json", *LATE, "--json", "simulated.json")
    assert done.exit_code == 0, done.output
    # simulate scores with each run's mean error, the gap without
    rows = json.loads(Path("simulated.json").read_text())["runs"]
    for row, told in zip(rows, result["runs"]):
        left_over = row["rms_um"] ** 2 - told["rms_um"]["after"] ** 2
        assert left_over == pytest.approx(row["offset_um"] ** 2, rel=0.05, abs=0.1 * row["rms_um"] ** 2)
    samples = np.array([row["samples"] for row in result["runs"]])
    left = np.sqrt(np.average([row["rms_um"]["after"] ** 2 for row in result["runs"]], weights=samples))
    assert left == pytest.approx(result["gap"]["remaining_um"], rel=1e-9)


def test_none(folder: Path, rdpi: Callable) -> None:
    result, text = gap_of(rdpi, "model.json", *FRESH, "-o", "improved.json")
    assert result["verdict"] == "none" and result["effects"] == []
    assert Path("improved.json").read_text() == Path("model.json").read_text()
    assert "improved.json: the model unchanged" in text


def test_report(folder: Path, rdpi: Callable) -> None:
    Path("out").mkdir()
    Path("out/notes.txt").write_text("kept")
    result, _ = gap_of(rdpi, "model.json", *LATE, "--report", "out")
    assert sorted(path.name for path in Path("out").iterdir()) == ["gap.json", "index.html", "notes.txt"]
    assert json.loads(Path("out/gap.json").read_text()) == result
    page = Path("out/index.html").read_text()
    assert page.lstrip().lower().startswith("<!doctype html") and "delay" in page
    assert not re.search(r'(src|href)="https?:', page)  # no network


def test_the_improved_model_beside_the_report(folder: Path, rdpi: Callable) -> None:
    gap_of(rdpi, "model.json", *FRESH, "-o", "new/improved.json", "--report", "new")
    assert sorted(path.name for path in Path("new").iterdir()) == ["gap.json", "improved.json", "index.html"]


def test_without(folder: Path, rdpi: Callable) -> None:
    result, _ = gap_of(rdpi, "model.json", *LATE, "--without", "delay", "--without", "lag")
    assert not {"delay", "lag"} & {one["name"] for one in result["effects"]}
    assert not {"delay", "lag"} & {one["name"] for one in result["candidates"] if one["rejected_because"] is None}


def test_earlier_recordings_of_the_same_drives(folder: Path, rdpi: Callable) -> None:
    """Given in any order, and one too many."""
    given = [word for name in FRESH[::-1] for word in ("--earlier", name)]
    result, text = gap_of(rdpi, "model.json", *LATE[1:], *given)
    unused = [note for note in result["notes"] if "no recording is compared with it" in note]
    assert unused == ["fresh0.csv: was given as earlier, but no recording is compared with it"] and unused[0] in text
    assert result["paired"] and result["effects"][0]["name"] == "delay"
    assert [row["earlier"] for row in result["runs"]] == list(FRESH[1:])
    result, _ = gap_of(rdpi, "model.json", *LATE[1:])
    assert not result["paired"] and all(row["earlier"] is None for row in result["runs"])


def test_earlier_recordings_of_other_drives(folder: Path, rdpi: Callable, refused: Callable) -> None:
    told = refused("gap", "model.json", *LATE[1:3], "--earlier", "fresh1.csv", "--earlier", "fresh3.csv",
                   "-o", refused.output)
    assert re.match(r"late2\.csv: no earlier recording has the same drive throughout "
                    r"\(the nearest is \S+\.csv, (which differs by up to \S+ % of|which ends)", told)
    done = rdpi("gap", "model.json", "late0.csv", "--earlier", "fresh0.csv", "-o", "fresh0.csv")
    assert done.exit_code == 2 and "fresh0.csv: would be written over an input" in done.output


@pytest.mark.slow
def test_no_progress_when_piped(folder: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "rdpi", "gap", "model.json", "sine0.csv"], capture_output=True,
                          text=True, env=os.environ | {"PYTHONPATH": str(HOST_TOOLS)})
    assert done.returncode == 0 and done.stderr == "" and "\r" not in done.stdout


@pytest.mark.slow
def test_closed_output(folder: Path) -> None:
    for closed in (">&-", "2>&-"):
        words = f'"{sys.executable}" -m rdpi gap model.json sine0.csv --json found.json {closed}'
        done = subprocess.run(words, shell=True, capture_output=True, text=True,
                              env=os.environ | {"PYTHONPATH": str(HOST_TOOLS)})
        assert done.returncode == 0 and done.stderr == "" and json.loads(Path("found.json").read_text())["verdict"]


@pytest.mark.slow
def test_the_next_experiment_runs_as_given(folder: Path, rdpi: Callable) -> None:
    """What the shell makes of it is a drive; recorded and added, it settles which of them it is."""
    result, text = gap_of(rdpi, "model.json", "sine0.csv", "sine1.csv")
    assert result["verdict"] == "ambiguous"
    (first,) = result["effects"]
    assert {"delay", "lag"} <= {first["name"], *first["confusable_with"]}
    command = result["next_experiment"]["command"]
    assert command in " ".join(text.split())
    Path("bin").mkdir()
    Path("bin/rdpi").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m rdpi "$@"\n')
    Path("bin/rdpi").chmod(0o755)
    environment = os.environ | {"PYTHONPATH": str(HOST_TOOLS), "PATH": f"{folder / 'bin'}:{os.environ['PATH']}"}
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    drive = read_recording("next.csv", required=("command_V",))
    assert drive.time_s[-1] == pytest.approx(result["next_experiment"]["seconds"])
    write("next.csv", recorded(plain_model(), [drive], DELAYED)[0])
    settled, _ = gap_of(rdpi, "model.json", "sine0.csv", "sine1.csv", "next.csv")
    assert settled["verdict"] == "effect" and settled["effects"][0]["name"] == "delay"


# ---- what recordings cannot show ----

@pytest.mark.parametrize(("names", "changes", "remark"), [
    (LATE[:1], {}, "there is only one recording"),
    (LATE, {"passport": None}, "the model has no passport"),
    (LATE, {"actuator": "stack 8"}, "the recordings are of stack 7, but the model is of stack 8"),
])
def test_says_what_it_cannot_claim(names: tuple[str, ...], changes: dict, remark: str, folder: Path, rdpi: Callable
                                   ) -> None:
    change_model(**changes)
    result, text = gap_of(rdpi, "model.json", *names)
    assert any(remark in note for note in result["notes"]) and remark in " ".join(text.split())
    assert result["effects"][0]["name"] == "delay"


def altered(change: Callable[[Recording], Recording], names: tuple[str, ...] = FRESH) -> None:
    for name in names:
        write(name, change(read_recording(name)))


def test_a_clipped_sensor(folder: Path, rdpi: Callable) -> None:
    altered(lambda run: changed(run, displacement_um=np.minimum(run.displacement_um, 8.0)))
    result, text = gap_of(rdpi, "model.json", *FRESH)
    assert result["verdict"] != "none"
    assert any("clipped sensor" in note for note in result["notes"]) and "clipped sensor" in " ".join(text.split())


def test_recordings_of_another_actuator(folder: Path, rdpi: Callable) -> None:
    altered(lambda run: changed(run, displacement_um=4 * run.displacement_um))
    result, text = gap_of(rdpi, "model.json", *FRESH)
    assert result["verdict"] != "none"
    assert any("check that it is of the same actuator" in note for note in result["notes"])
    assert "check that it is of the same actuator" in " ".join(text.split())


# ---- what it refuses ----

def without_column(name: str) -> Callable[[Recording], Recording]:
    return lambda run: replace(run, columns={key: values for key, values in run.columns.items() if key != name})


BAD_RUNS: dict[str, tuple[Callable[[Recording], Recording], str]] = {
    "all constant": (lambda run: changed(run, command_V=0 * run.command_V + 5, displacement_um=0 * run.time_s + 1),
                     r"fresh0\.csv: command_V is constant at 5 V; .*remove this run"),
    "a sensor that is dead": (lambda run: changed(run, displacement_um=0 * run.time_s + 1),
                              r"fresh0\.csv: displacement_um is constant at 1 um; check the sensor"),
    "displacement in nm": (lambda run: changed(run, displacement_um=1000 * run.displacement_um),
                           r"fresh0\.csv: moves \S+ um/V, but the model moves \S+ um/V: the units differ; "
                           ".*rdpi import"),
    "displacement in mm": (lambda run: changed(run, displacement_um=run.displacement_um / 1000),
                           r"fresh0\.csv: moves \S+ um/V, but the model moves \S+ um/V: the units differ"),
    "command in mV": (lambda run: changed(run, command_V=1000 * run.command_V),
                      r"fresh0\.csv: moves \S+ um/V, but the model moves \S+ um/V: the units differ"),
    "opposite sign": (lambda run: changed(run, displacement_um=-run.displacement_um),
                      r"fresh0\.csv: moves opposite to the model; check the sign"),
    "unrelated": (lambda run: changed(run, displacement_um=np.random.default_rng(0).standard_normal(len(run))),
                  r"fresh\d\.csv: command_V and displacement_um are unrelated"),
    "no displacement": (without_column("displacement_um"), r"fresh0\.csv:\d+: there is no column displacement_um"),
    "no command": (without_column("command_V"), r"fresh0\.csv:\d+: there is no column command_V"),
}


@pytest.mark.parametrize("case", BAD_RUNS)
def test_bad_recordings(case: str, folder: Path, refused: Callable) -> None:
    change, message = BAD_RUNS[case]
    altered(change)
    assert re.match(message, refused("gap", "model.json", *FRESH, "-o", refused.output))
    assert not Path("report").exists()


def test_one_recording_in_other_units_among_others(folder: Path, refused: Callable) -> None:
    altered(lambda run: changed(run, displacement_um=1000 * run.displacement_um), FRESH[2:3])
    assert re.match(r"fresh2\.csv: moves \S+ um/V, but the model moves \S+ um/V: the units differ",
                    refused("gap", "model.json", *FRESH, "-o", refused.output))


def test_a_recording_given_twice(folder: Path, refused: Callable) -> None:
    assert re.match(r"fresh0\.csv: given twice",
                    refused("gap", "model.json", "fresh0.csv", "fresh1.csv", "fresh0.csv", "-o", refused.output))
    run = read_recording("fresh0.csv")
    columns = {name: values for name, values in run.columns.items() if name != "monitor_V"} | {"other_axis_V": run.time_s}
    write_recording("copy.csv", columns, run.metadata)
    assert re.match(r"copy\.csv: holds the samples of fresh0\.csv; a run counts once",
                    refused("gap", "model.json", "fresh0.csv", "fresh1.csv", "copy.csv", "-o", refused.output))


@pytest.mark.parametrize(("changes", "message"), [
    ({"passport": {"schema": "rdpi-passport/1"}}, r"model.*: passport\.\w+.*fit the model again"),
    ({"passport": [1, 2]}, r"model.*: passport: must be an object"),
    ({"effects": [{"name": "magic"}]}, r'model\.json: effects\[0\] is "magic", which this version cannot simulate'),
    ({"effects": [entry("delay", delay_s=-1)]}, r"model\.json: effects\[0\] \(delay\): delay_s is -1"),
    ({"effects": {"delay": 1}}, r"model\.json: effects"),
    ({"gain_um_per_V": 0}, r"model\.json: gain_um_per_V"),
])
def test_bad_models(changes: dict, message: str, folder: Path, refused: Callable) -> None:
    change_model(**changes)
    assert re.match(message, refused("gap", "model.json", *FRESH, "-o", refused.output))


def test_outputs_that_cannot_be(folder: Path, rdpi: Callable) -> None:
    Path("file").write_text("as it was")
    for arguments, message in ((("-o", "model.json"), "model.json: would be written over an input"),
                               (("-o", "fresh1.csv"), "fresh1.csv: would be written over an input"),
                               (("-o", "a.json", "--json", "a.json"), "a.json: would be written over another output"),
                               (("--report", "file"), "file"),
                               (("--report", "model.json"), "model.json"),
                               (("-o", "nowhere/a.json"), "nowhere"),
                               (("--without", "magic"), "--without magic: is not an effect; the effects are "),
                               (("-o", "out/gap.json", "--report", "out"), "would be written over another output")):
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        done = rdpi("gap", "model.json", *FRESH, *arguments)
        assert done.exit_code == 2 and message in done.output and "Traceback" not in done.output, arguments
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_an_unknown_effect_is_told_which_there_are(folder: Path, refused: Callable) -> None:
    message = refused("gap", "model.json", *FRESH, "--without", "magic", "-o", refused.output)
    assert all(name in message for name in CATALOGUE)


@pytest.mark.parametrize(("arguments", "message"), [
    (("nowhere.json", "fresh0.csv"), "nowhere.json: No such file"), (("model.json", "nowhere.csv"), "nowhere.csv"),
    (("fresh0.csv", "fresh1.csv"), "fresh0.csv"), (("model.json", "model.json"), "model.json"),
])
def test_files_that_are_not_what_they_should_be(arguments: tuple[str, ...], message: str, folder: Path,
                                                refused: Callable) -> None:
    assert refused("gap", *arguments, "-o", refused.output).startswith(message)


def test_no_recording(folder: Path, rdpi: Callable) -> None:
    done = rdpi("gap", "model.json")
    assert done.exit_code == 2 and "RUN" in done.output
