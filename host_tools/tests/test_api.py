"""The Python interface: its examples run, and it is the commands' equal."""

from __future__ import annotations

import doctest
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from injected import COMMISSIONING, LATER, commissioned, drives, entry, plain_model, recorded

import rdpi
from rdpi import api
from rdpi.data import Recording, write_recording
from rdpi.data import recording as recordings
from rdpi.model import read_model, write_model

GAINED = entry("gain_change", factor=1.05)
T = np.arange(100) / 1000


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the examples read: slow.csv and fast.csv, the model of that actuator, today.csv with another gain."""
    made = tmp_path_factory.mktemp("api")
    early, late = recorded(plain_model(), drives(COMMISSIONING[:2])), recorded(plain_model(), drives(LATER[:3]), GAINED)
    for name, run in (("slow.csv", early[0]), ("fast.csv", early[1]), ("today.csv", late[2])):
        write_recording(made / name, run.columns, run.metadata)
    write_model(made / "model.json", commissioned())
    return made


@pytest.fixture
def there(folder: Path) -> Iterator[Path]:
    before = os.getcwd()
    os.chdir(folder)
    yield folder
    os.chdir(before)


@pytest.fixture
def command(request: pytest.FixtureRequest) -> Callable[..., None]:
    """A command of `rdpi`, which succeeds."""
    run = request.getfixturevalue("rdpi")

    def do(*arguments: str) -> None:
        done = run(*arguments)
        assert done.exit_code == 0, done.output

    return do


@pytest.mark.parametrize("module", [api, recordings])
def test_examples_run(there: Path, module: Any) -> None:
    found = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert found.attempted > 0 and found.failed == 0


def test_import_is_quick_and_complete() -> None:
    code = "import sys, rdpi; assert 'numpy' not in sys.modules; "
    code += "import rdpi.identify, rdpi.gap; assert callable(rdpi.fit) and callable(rdpi.diagnose); "
    code += "assert set(rdpi.__all__) <= set(dir(rdpi)); from rdpi import *; Model, fit"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_unknown_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="nothing"):
        rdpi.nothing


def test_model_survives_its_file(there: Path) -> None:
    model = rdpi.Model.load("model.json")
    model.save("again.json")
    assert Path("again.json").read_bytes() == Path("model.json").read_bytes()


def test_predict_is_simulate(there: Path, command: Callable) -> None:
    command("simulate", "model.json", "today.csv", "-o", "predicted.csv")
    expected = recordings.read_recording("predicted.csv").columns["predicted_um"]
    assert np.array_equal(rdpi.Model.load("model.json").predict(rdpi.read_recording("today.csv")), expected)


@pytest.mark.parametrize("engine", ["f32", "q31", "f64", "numpy"])
def test_compensate_is_the_command(there: Path, command: Callable, engine: str) -> None:
    reference_um = 5 + np.sin(2 * np.pi * 10 * T)
    write_recording("reference.csv", {"time_s": T, "reference_um": reference_um}, {})
    command("compensate", "model.json", "reference.csv", "-o", "drive.csv", "--engine", engine)
    expected = recordings.read_recording("drive.csv", required=("time_s", "command_V")).command_V
    assert np.array_equal(rdpi.Model.load("model.json").compensate(reference_um, 1e-3, engine), expected)


def test_header_is_the_command(there: Path, command: Callable) -> None:
    command("header", "model.json", "-o", "rdpi_params.h")
    rdpi.Model.load("model.json").header("other.h")

    def code(name: str) -> list[str]:
        return [line for line in Path(name).read_text().splitlines() if not line.startswith((" *", "/*"))]

    assert code("other.h") == code("rdpi_params.h")


def test_fit_is_the_command(there: Path, command: Callable) -> None:
    command("fit", "slow.csv", "fast.csv", "-o", "fitted.json", "--dac-bits", "16", "--effects", "none")
    model = rdpi.fit([rdpi.read_recording(name) for name in ("slow.csv", "fast.csv")], dac_bits=16, effects="none")
    model.save("mine.json")
    assert Path("mine.json").read_bytes() == Path("fitted.json").read_bytes()


def test_diagnose_is_the_command(there: Path, command: Callable) -> None:
    command("gap", "model.json", "today.csv", "-o", "improved.json", "--json", "gap.json")
    found = rdpi.diagnose(rdpi.Model.load("model.json"), [rdpi.read_recording("today.csv")])
    expected = json.loads(Path("gap.json").read_text())
    assert json.loads(json.dumps(found.to_json(), default=lambda value: value.tolist())) == \
        {key: value for key, value in expected.items() if key not in ("model", "model_digest")}
    assert found.improved.parameters.to_json() == read_model("improved.json").to_json()
    assert set(expected) - {"schema", "model", "model_digest"} <= set(dir(found))
    with pytest.raises(AttributeError, match="nothing"):
        found.nothing


def test_from_arrays_is_a_recording(tmp_path: Path) -> None:
    run = Recording.from_arrays(list(T), 50 * T, 5 * T, "reset", monitor_V=49 * T)
    write_recording(tmp_path / "run.csv", run.columns, run.metadata)
    back = recordings.read_recording(tmp_path / "run.csv")
    assert back.memory == run.memory == "reset" and back.sample_rate_hz == run.sample_rate_hz == 1000
    assert all(np.allclose(back.columns[name], values, atol=1e-9) for name, values in run.columns.items())


NONSENSE: dict[str, tuple[str, Callable[[], Any]]] = {
    "text": ("command_V", lambda: Recording.from_arrays(T, "abc", T)),
    "table": ("displacement_um", lambda: Recording.from_arrays(T, T, np.zeros((100, 2)))),
    "lengths": ("command_V: has 99 values", lambda: Recording.from_arrays(T, T[1:], T)),
    "NaN": (r"command_V\[3\]", lambda: Recording.from_arrays(T, np.where(T == T[3], np.nan, T), T)),
    "gap in time": ("not uniform", lambda: Recording.from_arrays(np.delete(T, 50), T[1:], T[1:])),
    "memory": ("memory", lambda: Recording.from_arrays(T, T, T, memory="none")),
    "too large": ("command_V is 1e\\+30", lambda: Recording.from_arrays(T, 1e30 + T, T)),
    "too few": ("samples", lambda: Recording.from_arrays(T[:3], T[:3], T[:3])),
    "covariate": ("temperature_degC", lambda: Recording.from_arrays(T, T, T, temperature_degC=[1.0])),
    "option": ("colour: is no option", lambda: rdpi.fit([], colour=3)),
    "runs": ("runs", lambda: rdpi.fit("run.csv")),
    "no runs": ("runs", lambda: rdpi.fit([])),
    "option's value": ("operators", lambda: rdpi.fit([Recording.from_arrays(T, T, T)], operators="many")),
    "parameters": ("parameters", lambda: rdpi.Model({"slopes": []})),
    "path": ("path", lambda: rdpi.Model.load(3)),
    "recording's path": ("path", lambda: rdpi.read_recording(3)),
    "option's NaN": ("min_V is nan", lambda: rdpi.fit([Recording.from_arrays(T, T, T)], min_V=float("nan"))),
    "option's list": ("thresholds_um", lambda: rdpi.fit([Recording.from_arrays(T, T, T)], thresholds_um=[float("nan")])),
    "run": ("run", lambda: rdpi.Model(commissioned()).predict([1.0, 2.0])),
    "reference": ("reference_um", lambda: rdpi.Model(commissioned()).compensate("abc", 1e-3)),
    "reference's NaN": (r"reference_um\[1\]", lambda: rdpi.Model(commissioned()).compensate([1.0, np.nan], 1e-3)),
    "no reference": ("reference_um", lambda: rdpi.Model(commissioned()).compensate([], 1e-3)),
    "sample time": ("sample_time_s", lambda: rdpi.Model(commissioned()).compensate([1.0] * 20, 0.0)),
    "engine": ("engine", lambda: rdpi.Model(commissioned()).compensate([1.0] * 20, 1e-3, "f16")),
    "model": ("model", lambda: rdpi.diagnose(commissioned(), [])),
    "earlier": ("earlier", lambda: rdpi.diagnose(rdpi.Model(commissioned()), [Recording.from_arrays(T, T, T)], [3]))}


@pytest.mark.parametrize("name", NONSENSE)
def test_nonsense_is_refused_by_name(name: str) -> None:
    message, do = NONSENSE[name]
    with pytest.raises(rdpi.BadInput, match=message):
        do()
