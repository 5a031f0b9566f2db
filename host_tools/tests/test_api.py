"""The Python interface: its examples run, and it is the commands' equal."""

from __future__ import annotations

import doctest
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
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
REFERENCE = np.full(20, 5.0)


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
    code += "assert {name for name in dir(rdpi) if name[0] != '_'} == set(rdpi.__all__); from rdpi import *; Model, fit"
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


def test_a_reference_out_of_reach_is_told() -> None:
    model, reference_um = rdpi.Model(commissioned()), np.full(50, 1e3)
    with pytest.warns(UserWarning, match="clipped at [0-9]+ of 50 samples: the reference spans 1000 to 1000 um"):
        model.compensate(reference_um, 1e-3)


def test_a_model_says_what_it_is() -> None:
    assert "plays" in repr(rdpi.Model(commissioned())) and "stroke" in repr(rdpi.Model(commissioned()))


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


class Elsewhere:
    """What another library may call an array, and a path."""

    def __array__(self, *arguments: Any, **options: Any) -> np.ndarray:
        raise RuntimeError("cannot be converted while it needs a gradient")

    def __fspath__(self) -> bytes:
        return b"model.json"


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
    "earlier": ("earlier", lambda: rdpi.diagnose(rdpi.Model(commissioned()), [Recording.from_arrays(T, T, T)], [3])),
    "masked": (r"command_V\[3\] is masked", lambda: Recording.from_arrays(T, np.ma.masked_equal(T, T[3]), T)),
    "another library's": ("command_V: must be a one-dimensional", lambda: Recording.from_arrays(T, Elsewhere(), T)),
    "beyond a double": (r"command_V\[0\] is inf", lambda: Recording.from_arrays(T, [np.longdouble("1e4000")] * 100, T)),
    "runs of no dimension": ("runs: must be a list", lambda: rdpi.fit(np.array(1.0))),
    "required": ("required: must be a list of strs", lambda: rdpi.read_recording("run.csv", required="time_s")),
    "required's member": (r"required\[0\]: must be a str", lambda: rdpi.read_recording("run.csv", required=[3])),
    "header's name": ("name: must be a str", lambda: rdpi.Model(commissioned()).header("x.h", name=None)),
    "no path": ("path: must be the name of a file", lambda: rdpi.Model(commissioned()).save("")),
    "zero in a path": ("path: must be the name of a file", lambda: rdpi.read_recording("a\0b")),
    "path of bytes": ("path: must be the name of a file", lambda: rdpi.Model.load(Elsewhere())),
    "short sample time": ("sample_time_s is 1e-300", lambda: rdpi.Model(commissioned()).compensate(REFERENCE, 1e-300, "numpy")),
    "long sample time": ("sample_time_s is 1e\\+07", lambda: rdpi.Model(commissioned()).compensate(REFERENCE, 1e7, "numpy")),
    "f32's sample time": ("sample_time_s is 1e-08", lambda: rdpi.Model(commissioned()).compensate(REFERENCE, 1e-8)),
    "q31's sample time": ("sample_time_s is 5;", lambda: rdpi.Model(commissioned()).compensate(REFERENCE, 5.0, "q31")),
    **{f"{name} out of range": (f"^`{name}`", lambda name=name, value=value: rdpi.fit([Recording.from_arrays(T, T, T)],
                                                                                     **{name: value}))
       for name, value in {"operators": 500, "deadzones": 7, "thresholds_um": [2, 1], "effects": "speed",
                           "rate_window_s": -1, "rate_filter_s": 1e9, "min_slope_ratio": 2, "min_V": 1e30,
                           "max_V": -1e30, "slew_V_per_s": 0, "dac_bits": 99}.items()},
    **{f"made by hand, {what}": (message, lambda changes=changes: rdpi.Model(commissioned()).predict(
        Recording("run", **{"metadata": {}, "columns": {"time_s": T, "command_V": T}, **changes})))
       for what, (message, changes) in {
           "no metadata": ("run: metadata: must be a dict", {"metadata": None}),
           "no rate": ("run: metadata: sample_rate_hz is 'fast'", {"metadata": {"sample_rate_hz": "fast"}}),
           "another rate": ("run: metadata: sample_rate_hz is 7", {"metadata": {"sample_rate_hz": 7.0}}),
           "no memory": ("run: metadata: memory is '3'", {"metadata": {"memory": 3}}),
           "no name": ("run: columns: must be a str", {"columns": {"time_s": T, "command_V": T, 3: T}}),
           "time that stands": ("run, sample 1: time_s repeats", {"columns": {"time_s": 0 * T, "command_V": T}}),
           "time that jumps": ("not uniform", {"columns": {"time_s": T**2 + T, "command_V": T}})}.items()}}


BY_HAND: dict[str, tuple[str, Any]] = {
    "none": ("effects: must be a list, got None", None),
    "set for a name": (r"effects\[0\] is a set, which", [{"name": {"delay"}}]),
    "arrays for a stage": ("stage is a ndarray; must be one of", [{"name": "delay", "stage": np.zeros(2)}]),
    "set for a column": ("column is a set;", [{"name": "cross_coupling", "column": {1}, "parameters": {}}]),
    "bytes for a key": ("but a bytes; they are", [{"name": "delay", "parameters": {b"delay_s": 1.0}}]),
    "array for a value": ("delay_s is a ndarray; must", [{**entry("delay"), "parameters": {"delay_s": np.zeros(1)}}]),
    "long whole number": ("delay_s is a int; must", [entry("delay", delay_s=10**5000)])}


@pytest.mark.parametrize("what", BY_HAND)
def test_effects_that_are_no_json_are_refused(what: str, tmp_path: Path) -> None:
    message, effects = BY_HAND[what]
    model = rdpi.Model(replace(commissioned()))
    model.parameters.effects = effects
    drive_V = 50 + 40 * np.sin(60 * T)
    run = Recording.from_arrays(T, drive_V, 0.13 * drive_V)
    for use in (lambda: model.predict(run), lambda: model.header(tmp_path / "params.h"),
                lambda: model.compensate(REFERENCE, 1e-3), lambda: rdpi.diagnose(model, [run])):
        with pytest.raises(rdpi.BadInput, match=message):
            use()
    (tmp_path / "model.json").write_text("another")
    with pytest.raises(rdpi.BadInput):
        model.save(tmp_path / "model.json")
    assert (tmp_path / "model.json").read_text() == "another"


NO_MODEL: dict[str, tuple[str, Any]] = {  # by the key that is set by hand
    "rate.source": ('is "contrl"; must be one of', "contrl"), "memory.sweep_share": ("is 2; must be 0 to 1", 2.0),
    "drive.min_V": (" min_V 105 must be below", 105.0), "drive.dac_bits": ("is 12.5; must be a whole number", 12.5),
    "memory": ("must be a Memory, got None", None), "gain_um_per_V": ("must be finite", np.inf),
    "stroke_um": ("must be finite", np.nan)}


@pytest.mark.parametrize("key", NO_MODEL)
def test_parameters_that_are_no_model_are_refused_by_key(key: str, tmp_path: Path) -> None:
    message, value = NO_MODEL[key]
    bent = entry("input_curve", quadratic=0.1, cubic=0.0, low_V=0.0, high_V=100.0)  # is folded in
    model = rdpi.Model(deepcopy(replace(commissioned(), effects=[bent])))
    *sections, name = key.split(".")
    setattr(getattr(model.parameters, sections[0]) if sections else model.parameters, name, value)
    drive_V = 50 + 40 * np.sin(60 * T)
    run = Recording.from_arrays(T, drive_V, 0.13 * drive_V)
    for use in (lambda: model.predict(run), lambda: model.header(tmp_path / "params.h"),
                lambda: model.compensate(REFERENCE, 1e-3), lambda: model.save(tmp_path / "model.json")):
        with warnings.catch_warnings(), pytest.raises(rdpi.BadInput, match=f": {key.removesuffix('.min_V')}:.*{message}"):
            warnings.simplefilter("error")
            use()
    assert not list(tmp_path.iterdir())


def test_a_whole_number_that_is_a_float_is_as_good(tmp_path: Path) -> None:
    model = rdpi.Model(deepcopy(commissioned()))
    for name, bits in (("whole.h", 12), ("float.h", 12.0)):
        setattr(model.parameters.drive, "dac_bits", bits)
        model.header(tmp_path / name)
    assert (tmp_path / "float.h").read_bytes() == (tmp_path / "whole.h").read_bytes()


@pytest.mark.parametrize("name", NONSENSE)
def test_nonsense_is_refused_by_name(name: str) -> None:
    message, do = NONSENSE[name]
    with warnings.catch_warnings(), pytest.raises(rdpi.BadInput, match=message):
        warnings.simplefilter("error")
        do()


def test_names_of_effects_may_be_drawn_one_after_the_other(there: Path) -> None:
    runs = [rdpi.read_recording(name) for name in ("slow.csv", "fast.csv")]
    found = rdpi.fit(runs, effects=(name for name in ["delay"]))
    assert [one["name"] for one in found.parameters.effects] == ["delay"]


def test_numbers_of_numpy_are_as_good_as_pythons(there: Path) -> None:
    """Also whole numbers that are floats; the fixed point of 16 bits would overflow in NumPy's integers."""
    plain: dict[str, Any] = {"operators": 4, "deadzones": 0, "dac_bits": 16, "min_V": -5.0, "max_V": 105.0}
    for kinds in ((np.int64, np.float32), (float, np.float64)):
        given = {name: kinds[isinstance(value, float)](value) for name, value in plain.items()}
        for name, options in (("plain.h", plain), ("given.h", given)):
            rdpi.fit([rdpi.read_recording("slow.csv")], effects="none", **options).header(name)
        assert Path("given.h").read_bytes() == Path("plain.h").read_bytes()
