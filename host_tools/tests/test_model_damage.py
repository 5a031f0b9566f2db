"""Every part of a model file replaced by everything that it is not: the commands work with it or refuse it in words."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from injected import RATE_HZ, commissioned, entry, plain_model, recorded
from plants import changed, recording, waves

from rdpi.data import Recording, write_recording
from rdpi.errors import BadInput
from rdpi.firmware import header
from rdpi.identify import checks, localise, passport
from rdpi.model import Model, read_model, write_model
from rdpi.simulate import chain

WRONG = ["x", 1.5, -1, 1e300, 10**400, None, [], {}, [[1]]]
Path_ = tuple[Any, ...]


@lru_cache(maxsize=None)
def document() -> dict[str, Any]:
    """A model with a passport, the operator alone, and effects that show all that an effect's entry may hold."""
    model = replace(commissioned(), operator_alone=commissioned().alone(), effects=[
        entry("lag", "amplifier", time_constant_s={"value": 0.001, "ci95": [0.0, 0.1], "unit": "s"}),
        {**entry("cross_coupling", um_per_V=0.01), "column": "other_axis_V"}])
    return json.loads(json.dumps(model.to_json()))


@lru_cache(maxsize=None)
def run() -> Recording:
    drive = recording(waves(100.0, 8.0, 2, RATE_HZ), None, RATE_HZ, other_axis_V=np.arange(250.0) % 7)
    (found,) = recorded(plain_model(), [drive], entry("gain_change", factor=1.1))
    return changed(found, reference_um=found.displacement_um)


def places(value: Any, path: Path_ = ()) -> Iterator[Path_]:
    """Of all values; in a list of the first and the last, which stand for all."""
    yield path
    if isinstance(value, (dict, list)):
        for key in value if isinstance(value, dict) else {0, len(value) - 1} & set(range(len(value))):
            yield from places(value[key], (*path, key))


def damaged(path: Path_, value: Any) -> Any:
    found = copy.deepcopy(document())
    if not path:
        return value
    part = found
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    return found


def use(model: Model, key: str) -> None:
    """What the commands read of this part of a model, the slow search of `gap` apart."""
    if key == "passport":
        known = passport.read(model)
        if known is not None:
            residual = run().displacement_um - predicted().predicted_um
            coords = localise.coordinates(run(), predicted().predicted_um, predicted().rate_um_per_s)
            passport.ratio(known, [residual], [coords])
            localise.localise([run()], [residual - np.mean(residual)], [coords], known, 0.01)
    else:
        header.render(model)
        checks.check_against(model, [run()])
    if key not in ("passport", "fit"):
        chain.simulate(model, [run()])
        chain.follow(model, run())
    model.uncompensated()


@lru_cache(maxsize=None)
def predicted() -> chain.Prediction:
    return chain.simulate(commissioned(), [run()])[0]


def check(path: Path_, folder: Path) -> None:
    for value in WRONG:
        (folder / "model.json").write_text(json.dumps(damaged(path, value)))
        try:
            use(read_model(folder / "model.json"), str(path[0]))
        except BadInput as error:
            assert "\n" not in str(error)


PARTS = ["schema", "tool", "actuator", "gain_um_per_V", "offset_V", "offset_um", "stroke_um", "thresholds_um", "slopes",
         "slope_rate_s_per_um", "deadzones_um", "deadzone_weights", "rate", "drive", "memory", "fit", "effects",
         "passport", "operator_alone"]


@pytest.mark.slow
@pytest.mark.parametrize("key", PARTS)
def test_every_part_of_every_wrong_kind(key: str, tmp_path: Path) -> None:
    for path in places(document()[key], (key,)):
        check(path, tmp_path)


def test_the_operator_alone_is_read_with_the_model(tmp_path: Path) -> None:
    for key, value, words in (("gain_um_per_V", "x", "gain_um_per_V is 'x'"), ("slopes", [1.0], "slopes: has 1 values")):
        (tmp_path / "model.json").write_text(json.dumps(damaged(("operator_alone", key), value)))
        with pytest.raises(BadInput, match=f"model.json: operator_alone: {words}"):
            read_model(tmp_path / "model.json")
        with pytest.raises(BadInput, match=f"other.json: operator_alone: {words}"):
            alone = {**commissioned().alone(), key: value}
            write_model(tmp_path / "other.json", replace(commissioned(), operator_alone=alone))
    assert not (tmp_path / "other.json").exists()


def test_no_part_is_left_out() -> None:
    assert list(document()) == PARTS


@pytest.mark.parametrize("runs", [1.5, "a.csv", {"a": 1}, [1.5], ["a.csv"], [[]], None])
def test_gap_says_what_is_wrong_with_the_runs_of_the_fit(runs: Any, rdpi: Callable, tmp_path: Path) -> None:
    (tmp_path / "model.json").write_text(json.dumps(damaged(("fit", "runs"), runs)))
    write_recording(tmp_path / "run.csv", run().columns, run().metadata)
    result = rdpi("gap", tmp_path / "model.json", tmp_path / "run.csv")
    assert result.exit_code == 2
    assert f"{tmp_path / 'model.json'}: fit.runs: must be a list of objects" in result.output


def test_a_run_of_the_fit_may_say_anything_else(tmp_path: Path) -> None:
    """A digest that is no text matches no recording."""
    for digest in (["sha256:0"], {}, 1.5, None):
        (tmp_path / "model.json").write_text(json.dumps(damaged(("fit", "runs", 0, "digest"), digest)))
        model = read_model(tmp_path / "model.json")
        assert len(checks.fitted_digests(model)) == len(model.fit["runs"]) - 1


def test_a_recording_that_was_held_out_was_not_fitted(tmp_path: Path) -> None:
    (tmp_path / "model.json").write_text(json.dumps(damaged(("fit", "runs", 0, "held_out"), True)))
    model = read_model(tmp_path / "model.json")
    assert checks.fitted_digests(model) == [one["digest"] for one in model.fit["runs"][1:]]
