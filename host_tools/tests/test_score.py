"""`rdpi score`: errors, delay, gate, page; and the gates of `rdpi gap`."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from injected import LATER, commissioned, drives, entry, plain_model, recorded
from pages import without_scripts

from rdpi.data import Recording, read_recording, write_recording
from rdpi.errors import BadInput
from rdpi.identify.report import score as score_page
from rdpi.model import write_model
from rdpi.simulate import tracking

RATE_HZ = 2000.0


def followed(wanted: Callable[[np.ndarray], np.ndarray], late_s: float = 0.0, offset_um: float = 0.0,
             noise_um: float = 0.0, seconds: float = 2.0) -> Recording:
    """A recording whose displacement follows `wanted`, a function of time, `late_s` later."""
    time_s = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    noise = noise_um * np.random.default_rng(1).standard_normal(len(time_s))
    return Recording("run.csv", {}, {"time_s": time_s, "reference_um": wanted(time_s),
                                     "displacement_um": wanted(time_s - late_s) + offset_um + noise})


def profile(time_s: np.ndarray) -> np.ndarray:
    return 8 + 4 * np.sin(2 * np.pi * 5 * time_s) + 2 * np.sin(2 * np.pi * 20 * time_s + 1)


@pytest.mark.parametrize("late_s", [0.0, 0.00013, 0.0011, -0.00226, 0.02, 0.0507])
def test_delay_is_found_between_samples(late_s: float) -> None:
    found = tracking.track(followed(profile, late_s, offset_um=0.3, noise_um=0.002))
    assert found.delay_s == pytest.approx(late_s, abs=0.02 / RATE_HZ)
    assert found.offset_um == pytest.approx(0.3, abs=0.02 + abs(late_s) * 2)
    assert found.rms_percent_without_delay < 0.05


def test_figures_are_those_of_the_error() -> None:
    run = followed(profile, 0.001, offset_um=0.2)
    error = run.displacement_um - run.columns["reference_um"]
    found, size = tracking.track(run), np.ptp(run.columns["reference_um"])
    assert found.rms_um == pytest.approx(np.sqrt(np.mean(error**2)))
    assert found.max_um == pytest.approx(np.max(np.abs(error)))
    assert found.rms_percent == pytest.approx(100 * found.rms_um / size)
    assert found.max_percent == pytest.approx(100 * found.max_um / size)
    assert found.max_at_s == run.time_s[np.argmax(np.abs(error))]
    assert found.offset_um == pytest.approx(np.mean(error))
    assert tracking.track(run, remove_offset=True).rms_um == pytest.approx(np.std(error))


def test_a_start_may_be_left_out() -> None:
    run = followed(profile, 0.001)
    run.displacement_um[:10] += 50
    rest = tracking.without_start(run, 10 / RATE_HZ)
    assert len(rest) == len(run) - 10 and rest.time_s[0] == run.time_s[10]
    assert tracking.track(run).max_at_s < rest.time_s[0] < tracking.track(rest).max_at_s
    assert tracking.track(rest).max_um < 5 < tracking.track(run).max_um
    for skip_s in (-1.0, 1e9, float("nan")):
        with pytest.raises(BadInput, match="--skip .*: must be a time in s, from 0 to"):
            tracking.without_start(run, skip_s)


def test_of_a_periodic_reference_the_shortest_delay_is_told() -> None:
    found = tracking.track(followed(lambda time_s: np.sin(2 * np.pi * 50 * time_s), 0.0004, noise_um=0.01))
    assert found.delay_s == pytest.approx(0.0004, abs=0.1 / RATE_HZ)


def test_a_bad_start_does_not_make_a_period_of_delay() -> None:
    run = followed(lambda time_s: np.sin(2 * np.pi * 5 * time_s), 0.0004)
    run.columns["displacement_um"][:200] += 0.1 * np.exp(-run.time_s[:200] / 0.03)  # a delay of a period leaves it out
    assert tracking.track(run).delay_s == pytest.approx(0.0004, abs=2 / RATE_HZ)


def test_a_start_that_is_late_does_not_make_a_period_of_delay() -> None:
    """What fits all samples best is a little late, and then fits those after the start a little worse."""
    run, late = (followed(lambda time_s: np.sin(2 * np.pi * 5 * time_s), late_s) for late_s in (0.0, 0.02))
    run.columns["displacement_um"][:200] = late.displacement_um[:200] - 0.2
    assert abs(tracking.track(run).delay_s) < 0.01


def test_a_step_has_a_delay_too() -> None:
    found = tracking.track(followed(lambda time_s: np.where(time_s < 0.5, 0.0, 1.0), 0.003))
    assert found.delay_s == pytest.approx(0.003, abs=1 / RATE_HZ)


def test_a_reference_at_rest_is_refused() -> None:
    with pytest.raises(BadInput, match=r"run\.csv: reference_um spans 0 um"):
        tracking.track(followed(lambda time_s: np.full_like(time_s, 3.0), noise_um=0.1))


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    monkeypatch.chdir(tmp_path)
    for name, late_s in (("good.csv", 0.0001), ("late.csv", 0.002)):
        write_recording(name, followed(profile, late_s).columns, {"actuator": "stack <7>"})
    return "good.csv", "late.csv"


def test_score_prints_and_writes(rdpi: Callable, runs: tuple[str, str]) -> None:
    done = rdpi("score", *runs, "--json", "score.json")
    assert done.exit_code == 0, done.output
    found = json.loads(Path("score.json").read_text())
    expected = [tracking.track(read_recording(name, required=tracking.COLUMNS)) for name in runs]
    assert [{**one._asdict(), "file": name} for name, one in zip(runs, expected)] == found["runs"]
    assert found["gate_failed"] is False
    assert found["max_percent"] == expected[1].max_percent
    assert found["rms_percent"] == pytest.approx(np.sqrt(np.mean([one.rms_percent**2 for one in expected])))
    assert "2 ms late" in done.output and "late.csv" in done.output


def test_gate(rdpi: Callable, runs: tuple[str, str]) -> None:
    assert rdpi("score", runs[0], "--max-rms", "2").exit_code == 0
    done = rdpi("score", *runs, "--max-rms", "2", "--json", "gate.json")
    assert done.exit_code == 1 and "--max-rms allows 2 %" in done.output
    assert json.loads(Path("gate.json").read_text())["gate_failed"] is True


def test_page(rdpi: Callable, runs: tuple[str, str]) -> None:
    assert rdpi("score", *runs, "--report", "page", "--json", "score.json").exit_code == 0
    page = without_scripts(Path("page/score.html").read_text())
    assert page.count("<figure>") == 6 and "stack &lt;7&gt;" in page and "http" not in page.replace("http-equiv", "")
    assert Path("page/score.json").read_text() == Path("score.json").read_text()
    pictures = [b64decode(one) for one in re.findall('data-pdf="data:application/pdf;base64,([^"]+)"', page)]
    assert len(pictures) == 6 and all(one.startswith(b"%PDF") for one in pictures)
    assert all(b"/FontFile2" in one and b"/Type3" not in one for one in pictures), "letters that programs can edit"


def test_an_offset_that_is_removed_is_told(rdpi: Callable, runs: tuple[str, str]) -> None:
    told = "the mean error is removed"
    for options, removed in (((), False), (("--remove-offset",), True)):
        done = rdpi("score", *runs, "--report", "page", *options)
        page = without_scripts(Path("page/score.html").read_text())
        assert ("(removed)" in done.output) is (told in page) is ("The offset is removed from" in page) is removed
    run = followed(profile, offset_um=0.5, noise_um=0.01)
    assert all(one.plot != other.plot for one, other in list(zip(
        score_page._figures(run, True), score_page._figures(run, False)))[:2])  # a spectrum has no mean


@pytest.mark.parametrize("missing", ["reference_um", "displacement_um"])
def test_a_missing_column_is_named(rdpi: Callable, runs: tuple[str, str], missing: str) -> None:
    columns = {name: values for name, values in followed(profile).columns.items() if name != missing}
    write_recording("less.csv", columns, {})
    done = rdpi("score", "less.csv")
    assert done.exit_code == 2 and missing in done.output


# --- the gates of gap ---


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("late")
    write_model(folder / "model.json", replace(commissioned(), actuator="stack 7"))
    for k, run in enumerate(recorded(plain_model(), drives(LATER), entry("delay", delay_s=0.003))):
        write_recording(folder / f"late{k}.csv", run.columns, run.metadata)
    return folder


@pytest.mark.parametrize("options, status", [
    (("--fail-on", "effect"), 1), (("--fail-on", "ambiguous,unknown"), 0), (("--max-gap", "90"), 0),
    (("--max-gap", "0.001"), 1), (("--fail-on", "unknown, effect", "--max-gap", "90"), 1),
    (("--fail-on", "effect", "--fail-on", "unknown"), 1)])
def test_gates_of_gap(rdpi: Callable, late: Path, tmp_path: Path, options: tuple[str, ...], status: int) -> None:
    done = rdpi("gap", late / "model.json", late / "late0.csv", late / "late1.csv", *options, "-o",
                tmp_path / "improved.json", "--json", tmp_path / "gap.json")
    assert done.exit_code == status, done.output
    found = json.loads((tmp_path / "gap.json").read_text())
    assert found["verdict"] == "effect" and found["gate_failed"] is bool(status)
    assert (tmp_path / "improved.json").exists()  # a gate loses nothing


def test_a_verdict_that_is_none_of_them_is_refused(rdpi: Callable, late: Path) -> None:
    done = rdpi("gap", late / "model.json", late / "late0.csv", "--fail-on", "effect,nothing")
    assert done.exit_code == 2 and "'nothing'" in done.output and "unknown" in done.output
