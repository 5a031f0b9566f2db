"""`rdpi fit --keep`: copies of the recordings beside the model, and `rdpi gap`, which compares with them."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from injected import drives, entry, plain_model, recorded
from plants import changed

from rdpi.data import Limits, Recording, filled, read_recording, thinned, write_recording
from rdpi.errors import BadInput
from rdpi.identify import kept
from rdpi.model import read_model, write_model
from rdpi.simulate import signals

NAMES = ("waves", "steps", "sine")
LIMITS = Limits(0.0, 100.0, sample_rate_hz=4000.0)
CANNED = (("sawtooth", {"frequencies_hz": (1.0, 4.0), "cycles": 1}, 1.0), ("steps", {"levels": 3, "hold_s": 0.3}, 1.0),
          ("sine", {"frequencies_hz": (2.0, 8.0), "cycles": 2, "sweep": False}, 0.8))
DELAYED = entry("delay", delay_s=0.002)


def write(path: Path, run: Recording) -> None:
    write_recording(path, run.columns, {**run.metadata, "actuator": "stack 7"})


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """NAME.csv, recordings of a plain actuator; late-NAME.csv, the same drives with a delay; and a model."""
    folder = tmp_path_factory.mktemp("kept")
    silent = drives(CANNED, LIMITS)
    for name, run, late in zip(NAMES, recorded(plain_model(), silent),
                               recorded(plain_model(), silent, DELAYED, seed=2)):
        write(folder / f"{name}.csv", run)
        write(folder / f"late-{name}.csv", late)
    other = drives((("multisine", {"duration_s": 3.0, "seed": 3}, 0.9),), LIMITS)
    write(folder / "late-other.csv", recorded(plain_model(), other, DELAYED)[0])
    model = replace(plain_model(), actuator="stack 7")
    kept.keep([read_recording(folder / f"{name}.csv") for name in NAMES], folder / "kept", model)
    write_model(folder / "model.json", model)
    return folder


LATE = tuple(f"late-{name}.csv" for name in NAMES)


def gap_of(rdpi: Callable, *arguments: object) -> tuple[dict, str]:
    done = rdpi("gap", *arguments, "--json", "result.json")
    assert done.exit_code == 0, done.output
    return json.loads(Path("result.json").read_text()), " ".join(done.output.split())


def copies(model: str = "model.json") -> dict[str, Path]:
    """Each kept file by the name of its recording."""
    return {Path(one["source"]).stem: Path(model).parent / one["file"] for one in read_model(model).kept}


# ---- thinning out ----

@pytest.mark.parametrize("every", [2, 5, 16])
@pytest.mark.parametrize("count", [1000, 1001, 1003])
def test_thinning_keeps_what_is_slow(every: int, count: int) -> None:
    """Below 0.4 of the new rate all is had back, inside; at the ends the signal is guessed."""
    time = np.arange(count)
    slow = 3 + np.sin(2 * np.pi * 0.3 / every * time)
    few = thinned(slow, every)
    assert (len(few) - 1) * every >= count - 1 > (len(few) - 2) * every
    again = filled(few, every, count)
    inside = slice(30 * every, -30 * every) if 60 * every < count else slice(0, 0)
    np.testing.assert_allclose(again[inside], slow[inside], atol=2e-3)
    assert len(again) == count


@pytest.mark.parametrize("frequency", [0.6, 0.9, 1.3])  # of the new rate
def test_thinning_does_not_alias(frequency: float) -> None:
    every = 8
    fast = np.sin(2 * np.pi * frequency / every * np.arange(8000))
    assert np.max(np.abs(thinned(fast, every)[60:-60])) < 1e-3 < np.max(np.abs(fast[::every][60:-60]))


# ---- fit --keep ----

def test_fit_keeps(folder: Path, rdpi: Callable) -> None:
    Path("models").mkdir()
    done = rdpi("fit", "waves.csv", "steps.csv", "--hold-out", "sine.csv", "--effects", "none", "-o",
                "models/new.json", "--keep", "models/with/new")
    assert done.exit_code == 0, done.output
    entries = read_model("models/new.json").kept
    assert [one["source"] for one in entries] == ["waves.csv", "steps.csv", "sine.csv"]
    assert all(re.fullmatch(r"with/new/(waves|steps|sine)-[0-9a-f]{8}\.csv", one["file"]) for one in entries)
    for one in entries:
        copy, run = read_recording(Path("models") / one["file"]), read_recording(one["source"])
        assert copy.digest == one["digest"] and run.digest == one["source_digest"]
        assert copy.memory == run.memory and copy.metadata["actuator"] == "stack 7"
        assert copy.sample_rate_hz * one["every"] == pytest.approx(run.sample_rate_hz)
        assert f"kept {one['source']}: models/{one['file']}, " in done.output
    everies = {one["source"]: one["every"] for one in entries}
    assert everies["steps.csv"] == 1 and everies["sine.csv"] > 1  # a step cannot be had back from fewer samples


def test_a_model_without_keep_names_nothing(folder: Path, rdpi: Callable) -> None:
    assert rdpi("fit", "waves.csv", "--effects", "none", "-o", "new.json").exit_code == 0
    assert "kept" not in json.loads(Path("new.json").read_text())


def test_copies_are_the_recordings_but_for_noise(folder: Path) -> None:
    model = read_model("model.json")
    late = [read_recording(name) for name in LATE]
    found, _ = kept.earlier(model, late)
    for one, name in zip(found, NAMES):
        run = read_recording(f"{name}.csv")
        assert len(one) == len(run) and one.sample_rate_hz == run.sample_rate_hz and one.memory == run.memory
        np.testing.assert_allclose(one.time_s, run.time_s, atol=1e-8)
        assert np.max(np.abs(one.command_V - run.command_V)) < 0.2  # of 100 V
        assert np.std(one.displacement_um - run.displacement_um) < 0.005  # its noise is 0.004
        assert "other_axis_V" in one.columns


def test_a_coarse_sensor_keeps_its_grid(folder: Path) -> None:
    run = read_recording("sine.csv")
    coarse = np.round(run.displacement_um / 0.008) * 0.008
    write("coarse.csv", changed(run, displacement_um=coarse))
    model = replace(plain_model(), actuator="stack 7")
    kept.keep([read_recording("coarse.csv")], "kept", model)
    assert model.kept[0]["every"] > 1 and model.kept[0]["step_um"] == pytest.approx(0.008)
    (found,), _ = kept.earlier(model, [read_recording("late-sine.csv")])
    assert signals.grid_step(found.displacement_um) == pytest.approx(0.008)


@pytest.mark.parametrize("target", ["waves.csv", "waves.csv/inner"])
def test_a_folder_that_cannot_be(target: str, folder: Path, rdpi: Callable) -> None:
    done = rdpi("fit", "waves.csv", "-o", "new.json", "--keep", target)
    assert done.exit_code == 2 and not Path("new.json").exists()


def test_other_files_of_the_folder_stay(folder: Path, rdpi: Callable) -> None:
    """Recordings of one name and of other content."""
    before = {path: path.read_bytes() for path in Path("kept").iterdir()}
    shutil.copy("late-sine.csv", "sine.csv")
    assert rdpi("fit", "sine.csv", "--effects", "none", "-o", "new.json", "--keep", "kept").exit_code == 0
    assert all(path.read_bytes() == content for path, content in before.items())
    assert len([*Path("kept").iterdir()]) == len(before) + 1


# ---- gap ----

def test_gap_compares_with_what_was_kept(folder: Path, rdpi: Callable) -> None:
    given = [word for name in NAMES for word in ("--earlier", f"{name}.csv")]
    by_hand, _ = gap_of(rdpi, "model.json", *LATE, *given)
    result, text = gap_of(rdpi, "model.json", *LATE, "-o", "improved.json")
    assert result["paired"] and result["verdict"] == by_hand["verdict"] == "effect"
    assert [one["name"] for one in result["effects"]] == [one["name"] for one in by_hand["effects"]] == ["delay"]
    assert result["effects"][0]["parameters"]["delay_s"]["value"] == pytest.approx(0.002, rel=0.02)
    named = [Path(row["earlier"]) for row in result["runs"]]
    assert named == [copies()[name] for name in NAMES]
    line = f"as with --earlier, compared with recordings that were kept with the model: {', '.join(map(str, named))}"
    assert line in text and line in result["notes"]
    assert json.loads(Path("improved.json").read_text())["effects"][0]["new"] is True
    explicit, text = gap_of(rdpi, "model.json", *LATE[:1], *given[:2])  # what is given goes first
    assert explicit["runs"][0]["earlier"] == "waves.csv" and "were kept" not in text


def test_gap_need_not(folder: Path, rdpi: Callable) -> None:
    result, text = gap_of(rdpi, "model.json", *LATE, "--no-kept")
    assert not result["paired"] and "kept" not in text


def test_a_drive_that_was_not_kept(folder: Path, rdpi: Callable) -> None:
    result, text = gap_of(rdpi, "model.json", *LATE[1:], "late-other.csv")
    assert not result["paired"] and result["runs"][0]["earlier"] is None
    assert "the recordings that were kept with the model are not used: late-other.csv: no earlier recording has" in text
    assert "; give late-" in text and " alone to compare with what was kept" in text


def test_the_kept_recordings_themselves(folder: Path, rdpi: Callable) -> None:
    result, text = gap_of(rdpi, "model.json", "sine.csv", "late-waves.csv")
    assert not result["paired"] and "sine.csv: was kept itself" in text


def test_a_moved_folder(folder: Path, rdpi: Callable) -> None:
    Path("elsewhere/deep").mkdir(parents=True)
    shutil.move("kept", "elsewhere/deep/kept")
    shutil.move("model.json", "elsewhere/deep/model.json")
    result, _ = gap_of(rdpi, "elsewhere/deep/model.json", LATE[2], "-o", "improved.json")
    assert result["paired"]
    assert copies("improved.json")["sine"].is_file()  # the new model has another folder
    assert gap_of(rdpi, "improved.json", LATE[2])[0]["paired"]


DAMAGE = {
    "missing": (Path.unlink, "cannot be read"),
    "changed": (lambda path: path.write_text(path.read_text().replace("0.1", "0.2", 1)), "has changed since"),
    "cut": (lambda path: path.write_bytes(path.read_bytes()[:20000]), ""),
    "empty": (lambda path: path.write_bytes(b""), "is empty")}


@pytest.mark.parametrize("what", DAMAGE)
def test_a_copy_that_is_not_as_it_was(what: str, folder: Path, rdpi: Callable) -> None:
    damage, words = DAMAGE[what]
    damage(copies()["sine"])
    model = Path("model.json").read_bytes()
    result, text = gap_of(rdpi, "model.json", LATE[0])  # what is left still serves
    assert result["paired"] and words in text
    result, text = gap_of(rdpi, "model.json", LATE[2], "-o", "improved.json")
    assert not result["paired"] and "a recording that was kept with the model is left out" in text
    assert "sine" in text and words in text and "fit again with --keep" in text
    assert Path("model.json").read_bytes() == model
    assert json.loads(Path("improved.json").read_text())["kept"] == json.loads(model)["kept"]


@pytest.mark.parametrize("wrong", [
    {"samples": 10**8}, {"samples": "many"}, {"every": 0}, {"every": 1.5}, {"every": True}, {"file": 3},
    {"sample_rate_hz": -1},
    {"step_um": None}, {"step_um": 10**400}, {"step_um": 1e300}, {"step_um": 1e-320}, {"sample_rate_hz": 10**400},
    {"sample_rate_hz": 1e-300}, {"source_digest": ["x"]}, {"source_digest": {}}, {"digest": ""}])
def test_entries_that_no_fit_wrote(wrong: dict, folder: Path) -> None:
    model = read_model("model.json")
    model.kept = [{**one, **wrong} for one in model.kept if "sine" in one["source"]]
    found, notes = kept.earlier(model, [read_recording(LATE[2])])
    assert not found and len(notes) == 1 and "left out" in notes[0]


@pytest.mark.parametrize("digest", [["x"], {}])
def test_a_digest_that_is_no_text_leaves_out_its_copy_alone(digest: object, folder: Path) -> None:
    model = read_model("model.json")
    model.kept = [{**one, "source_digest": digest} if "sine" in one["source"] else one for one in model.kept]
    found, notes = kept.earlier(model, [read_recording(LATE[0])])
    assert len(found) == 1 and "left out" in " ".join(notes)


@pytest.mark.parametrize("wrong", [3, "kept", [3], [{}], {}])
def test_a_key_that_is_no_list_of_entries(wrong: object, folder: Path, rdpi: Callable) -> None:
    document = json.loads(Path("model.json").read_text())
    Path("model.json").write_text(json.dumps({**document, "kept": wrong}))
    result, text = gap_of(rdpi, "model.json", LATE[2])
    assert not result["paired"] and "left out" in text
    assert read_model("model.json").kept == wrong  # nothing is lost


def test_a_model_never_replaces_what_is_kept_with_it(folder: Path, rdpi: Callable) -> None:
    name, path = next(iter(copies().items()))
    whole = path.read_bytes()
    done = rdpi("gap", "model.json", f"late-{name}.csv", "-o", path)
    assert done.exit_code == 2 and "a recording that is kept with the model" in done.output
    with pytest.raises(BadInput, match="is a recording that is kept with the model"):
        write_model(path, read_model("model.json"))
    assert path.read_bytes() == whole


REFERENCE = "time_s,reference_um\n" + "".join(f"{k / 1000},{5 + k / 100}\n" for k in range(50))


@pytest.mark.parametrize("command", [
    ("simulate", "model.json", LATE[2], "-o"), ("simulate", "model.json", LATE[2], "--json"),
    ("header", "model.json", "-o"), ("compensate", "model.json", "reference.csv", "-o"),
    ("gap", "model.json", LATE[2], "--json"), ("plot", "model.json", LATE[2], "--json")])
def test_no_output_replaces_what_is_kept_with_the_model(command: tuple[str, ...], folder: Path, rdpi: Callable) -> None:
    Path("reference.csv").write_text(REFERENCE)
    path = copies()["sine"]
    whole = path.read_bytes()
    done = rdpi(*command, path)
    assert done.exit_code == 2 and done.output == \
        f"rdpi: {path}: would be written over a recording that is kept with the model; give another name\n"
    assert path.read_bytes() == whole


def test_a_report_replaces_nothing_that_is_kept(folder: Path, rdpi: Callable) -> None:
    document = json.loads(Path("model.json").read_text())
    shutil.copy(copies()["sine"], "kept/gap.json")
    document["kept"] = [{**document["kept"][0], "file": "kept/gap.json"}]
    Path("model.json").write_text(json.dumps(document))
    done = rdpi("gap", "model.json", LATE[2], "--report", "kept")
    assert done.exit_code == 2 and "kept/gap.json: would be written over a recording that is kept" in done.output
    assert not Path("kept/index.html").exists()


@pytest.mark.parametrize("option", ["-o", "--json"])
def test_no_output_of_a_fit_replaces_what_it_keeps(option: str, folder: Path, rdpi: Callable) -> None:
    name = copies()["sine"].name
    Path("new").mkdir()
    done = rdpi("fit", "sine.csv", "--effects", "none", "-o", "new.json", "--keep", "new", option, f"new/{name}")
    assert done.exit_code == 2 and done.output == \
        f"rdpi: new/{name}: could be one of the files of --keep; give another name or directory\n"
    assert not [*Path("new").iterdir()] and not Path("new.json").exists()


@pytest.mark.parametrize("name", ["a\0b", "a\ud800b", "x" * 5000])
def test_names_that_no_file_can_have(name: str, folder: Path, rdpi: Callable) -> None:
    document = json.loads(Path("model.json").read_text())
    document["kept"] = [{**document["kept"][0], "file": name}]
    Path("model.json").write_text(json.dumps(document))
    done = rdpi("simulate", "model.json", LATE[2], "-o", "out.csv")
    assert done.exit_code == 0, done.output
    done = rdpi("gap", "model.json", LATE[2], "-o", "new.json")
    assert done.exit_code == 0, done.output
