"""Which files may be written: rules that commands and scripts share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rdpi.data import check_outputs, check_targets, is_device, same_file, targets
from rdpi.errors import BadInput, printable


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.csv").write_text("a run")
    (tmp_path / "runs").mkdir()
    return tmp_path


def test_what_is_no_ordinary_file() -> None:
    assert is_device("/dev/null") and is_device("runs")
    assert not is_device("run.csv") and not is_device("nowhere.csv")


def test_two_paths_of_one_file(here: Path) -> None:
    (here / "link.csv").symlink_to("run.csv")
    os.link("run.csv", "twin.csv")
    assert same_file("run.csv", "runs/../run.csv") and same_file("run.csv", "link.csv")
    assert same_file("run.csv", "twin.csv")  # hard links
    assert same_file("new.csv", here / "new.csv") and not same_file("new.csv", "run.csv")


def test_outputs_that_can_be_written() -> None:
    check_outputs(["new.csv", "runs/new.csv", "/dev/null", "/dev/null"], ["run.csv"])
    check_outputs(["run.csv"])  # replaced
    check_outputs(["made/gap.json", "made/index.html"], made="made/")
    check_outputs(["made/"], folders=["made/"])


@pytest.mark.parametrize(("outputs", "options", "message"), [
    (["missing/new.csv"], {}, "missing/new.csv: "),
    (["made/"], {}, "made/: "), (["runs"], {}, "runs: is a directory"),
    (["made/", "made/log.json"], {"folders": ["made/"]}, "made/log.json: "),
    (["run.csv/gap.json"], {"made": "run.csv"}, "run.csv: "),
    (["new.csv", "./run.csv"], {"inputs": ["run.csv"]}, "./run.csv: would be written over an input"),
    (["new.csv", "runs/../new.csv"], {}, "runs/../new.csv: would be written over another output")])
def test_outputs_that_cannot_be_written(outputs: list[str], options: dict, message: str, here: Path) -> None:
    with pytest.raises(BadInput) as refused:
        check_outputs(outputs, **options)
    assert str(refused.value).startswith(message)
    assert sorted(path.name for path in here.iterdir()) == ["run.csv", "runs"]


def test_a_folder_that_may_not_be_written_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """Root may write everywhere, so the system's answer is a false one."""
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(BadInput, match="runs/new.csv: .*permissions"):
        check_outputs(["runs/new.csv"])
    check_outputs(["/dev/null"])


def test_a_file_that_is_protected_is_not_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rename that puts a file into its place does not ask it."""
    monkeypatch.setattr(os, "access", lambda path, mode: os.path.isdir(path))
    with pytest.raises(BadInput, match="run.csv: .*protected"):
        check_outputs(["run.csv"])
    check_outputs(["new.csv"])


def test_the_target_of_each_source() -> None:
    assert targets(["a.mat"], "new.csv") == [Path("new.csv")]
    assert targets(["a.mat"], "runs") == targets(["x/a.mat"], "runs/") == [Path("runs/a.csv")]
    assert targets(["a.mat"], "new/") == [Path("new/a.csv")]
    assert targets(["a.mat", "b.dat"], "new") == [Path("new/a.csv"), Path("new/b.csv")]


@pytest.mark.parametrize(("sources", "output", "message"), [
    (["a.mat", "b.mat"], "new.csv", "-o new.csv: several sources need a "),
    (["a.mat", "b.mat"], "run.csv", "-o run.csv: several sources need a "),
    (["a.mat", "x/a.dat"], "runs", "x/a.dat and a.mat would both be written to runs/a.csv"),
    (["run.csv"], ".", "run.csv: would be written over an input"),
    (["run.csv"], "run.csv", "run.csv: would be written over an input")])
def test_sources_without_a_target(sources: list[str], output: str, message: str) -> None:
    with pytest.raises(BadInput) as refused:
        targets(sources, output)
    assert str(refused.value).startswith(message)


def test_targets_that_are_another_output() -> None:
    check_targets([Path("new.csv")], ["run.csv"], ["log.json"])
    check_targets([Path("/dev/null")], (), ["/dev/null"])
    with pytest.raises(BadInput, match="new.csv: would be written over another output"):
        check_targets([Path("new.csv")], ["run.csv"], ["./new.csv"])
    with pytest.raises(BadInput, match="a.csv: would be written over another output"):
        targets(["a.mat"], "a.csv", ["a.csv"])


def test_numbered_targets(here: Path) -> None:
    """run.csv stands for run-1.csv, run-2.csv, ..."""
    (here / "run-7.csv").write_text("an input")
    check_targets([Path("run.csv")], ["run.csv"], ["run-x.csv"], numbered=True)
    with pytest.raises(BadInput, match="run-7.csv: would be written over an input"):
        check_targets([Path("run.csv")], ["run-7.csv"], numbered=True)
    with pytest.raises(BadInput, match="run-3.csv: would be written over another output"):
        check_targets([Path("run.csv")], (), ["run-3.csv"], numbered=True)
    check_targets([Path("run.csv")], ["run-7.csv"])


def test_names_that_are_no_text() -> None:
    assert printable("µ.csv") == "µ.csv" and printable(os.fsdecode(b"a\xff.csv")) == "a\\udcff.csv"
