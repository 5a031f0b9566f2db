"""Documents with types: to JSON and back, their schemas in the package, the page that describes them."""

from __future__ import annotations

import copy
import importlib.util
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import written
from conftest import ROOT
from injected import LATER, commissioned, drives, entry, plain_model, recorded
from jsonschema import Draft202012Validator

from rdpi.data import write_recording
from rdpi.errors import BadInput
from rdpi.identify import FitDocument
from rdpi.gap import GapDocument, diagnose
from rdpi.model import Document, Passport, json_key, schema


@dataclass(kw_only=True)
class Spot(Document):
    """A place."""

    at_um: float | None = json_key("where it is", "um", low=0, high=10)


@dataclass(kw_only=True)
class Map(Document):
    """A map.

    Of nothing in particular.
    """

    SCHEMA: ClassVar[str] = "test-map/1"

    spots: list[Spot] = json_key("places")
    grid: list[list[float | None]] = json_key("heights")
    named: dict[str, float | Spot] = json_key("places by name")
    size: tuple[float, float] = json_key("width and height", default=(1.0, 1.0))
    home: Spot | None = json_key("a special one", omitted=True)
    values: np.ndarray = json_key("numbers", default_factory=lambda: np.zeros(0))


MAP = {"schema": "test-map/1", "spots": [{"at_um": 1.0}, {"colour": "red", "at_um": None}], "grid": [[1.0, None], []],
       "named": {"a": 2.0, "b": {"at_um": 3.0}}, "size": [4.0, 5.0], "values": [6.0]}


# --- to JSON and back ------------------------------------------------------------------------------------------------

def test_json_becomes_objects_and_comes_back() -> None:
    found = Map.from_json(MAP)
    assert [spot.at_um for spot in found.spots] == [1.0, None] and found.named["b"].at_um == 3.0
    assert found.size == (4.0, 5.0) and found.home is None
    assert found.to_json() == MAP and list(found.to_json()) == list(MAP)


def test_keys_that_are_not_known_are_kept() -> None:
    found = Map.from_json({**MAP, "legend": {"x": [1]}})
    assert found.extra == {"legend": {"x": [1]}} and found.spots[1].extra == {"colour": "red"}
    assert found.to_json() == {**MAP, "legend": {"x": [1]}}


def test_arrays_and_whole_numbers_are_written_as_the_type_says() -> None:
    found = Map(spots=[Spot(at_um=np.float32(0.5))], grid=np.eye(2), named={"a": 1}, size=(1, 2), home=Spot(at_um=0),
                values=np.arange(2.0))
    text = json.dumps(found.to_json())
    assert text == ('{"schema": "test-map/1", "spots": [{"at_um": 0.5}], "grid": [[1.0, 0.0], [0.0, 1.0]], "named": '
                    '{"a": 1.0}, "size": [1.0, 2.0], "home": {"at_um": 0.0}, "values": [0.0, 1.0]}')


def test_defaults_stand_in_for_missing_keys() -> None:
    found = Map.from_json({key: value for key, value in MAP.items() if key not in ("size", "values")})
    assert found.size == (1.0, 1.0) and len(found.values) == 0


@pytest.mark.parametrize("changes, complaint", [
    ({"schema": "test-map/2"}, 'm.schema: must be "test-map/1"'), ({"spots": {}}, "m.spots: must be a list"),
    ({"spots": [1]}, "m.spots[0]: must be an object"), ({"spots": [{}]}, "m.spots[0].at_um: is missing"),
    ({"grid": [1.0]}, "m.grid[0]: must be a list"), ({"named": []}, "m.named: must be an object"),
    ({"named": {"a": {"b": 1}}}, "m.named.a.at_um: is missing"), ({"spots": None}, "m.spots: must be a list")])
def test_what_cannot_be_read_is_refused_by_its_key(changes: dict[str, Any], complaint: str) -> None:
    with pytest.raises(BadInput) as error:
        Map.from_json({**MAP, **changes}, "m")
    assert str(error.value) == complaint
    with pytest.raises(BadInput, match="^m: must be an object$"):
        Map.from_json([], "m")


# --- schemas ---------------------------------------------------------------------------------------------------------

def test_the_schema_of_a_document() -> None:
    found = schema(Map, "Map")
    Draft202012Validator.check_schema(found)
    assert found["title"] == "Map" and found["description"] == "A map."
    assert found["required"] == ["schema", "spots", "grid", "named"]
    assert found["properties"]["home"] == {"$ref": "#/$defs/Spot", "description": "a special one"}
    assert found["$defs"]["Spot"]["properties"]["at_um"] == {
        "type": ["number", "null"], "minimum": 0, "maximum": 10, "description": "where it is", "unit": "um"}


@pytest.mark.parametrize("changes, good", [
    ({}, True), ({"more": 1}, True), ({"home": {"at_um": 1.0}}, True), ({"home": None}, False),
    ({"schema": "x"}, False), ({"values": [None]}, False),
    ({"spots": [{"at_um": -1.0}]}, False), ({"spots": [{"at_um": 11}]}, False), ({"spots": [{}]}, False),
    ({"grid": [[None, "1"]]}, False), ({"named": {"a": "1"}}, False), ({"size": [1.0]}, False)])
def test_what_a_schema_accepts(changes: dict[str, Any], good: bool) -> None:
    assert Draft202012Validator(schema(Map, "Map")).is_valid({**MAP, **changes}) == good


def formats() -> Any:
    """The script that writes the schemas and the page."""
    spec = importlib.util.spec_from_file_location("formats", ROOT / "host_tools" / "formats.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_what_is_generated_is_committed() -> None:
    """Schemas and tables; else run host_tools/formats.py."""
    files = formats().files()
    assert [path.name for path in files] == ["rdpi-model-1.json", "rdpi-fit-1.json", "rdpi-gap-1.json", "formats.md"]
    for path, text in files.items():
        assert path.read_text("utf-8") == text, f"{path} is not up to date: run host_tools/formats.py"
    assert {path for path in written.PACKAGE.glob("*/schemas/*")} == {path for path in files if path.suffix == ".json"}


def test_links_of_the_page_lead_somewhere() -> None:
    text = formats().TABLES.read_text("utf-8")
    headings = [line.lstrip("# ").lower().replace(" ", "-") for line in text.splitlines() if line.startswith("#")]
    links = [part.partition(")")[0] for part in text.split("](")[1:]]
    assert len(set(headings)) == len(headings) and len(links) > 40
    for link in links:
        assert link[1:] in headings if link.startswith("#") else (ROOT / "host_tools" / link).is_file(), link


def test_every_key_has_a_meaning_and_every_number_a_place_for_its_unit() -> None:
    """A key that ends in a unit has that unit."""
    units = {"um": "um", "V": "V", "s": "s", "hz": "Hz", "percent": "%"}

    def properties(part: Any) -> Iterator[tuple[str, dict[str, Any]]]:
        for name, value in part.items() if isinstance(part, dict) else ():
            if name == "properties":
                yield from value.items()
            yield from properties(value)

    seen = 0
    for path in written.PACKAGE.glob("*/schemas/*.json"):
        for name, about in properties(json.loads(path.read_text("utf-8"))):
            assert about["description"]
            ending = name.rpartition("_")[2]
            if ending in units and "_per_" not in name and "$ref" not in about:
                assert about.get("unit") == units[ending], name
                seen += 1
    assert seen > 30


# --- what is written -------------------------------------------------------------------------------------------------

@lru_cache(maxsize=None)
def gap_document() -> dict[str, Any]:
    """Of a delay, as JSON."""
    runs = recorded(plain_model(), drives(LATER[:2]), entry("delay", delay_s=0.003))
    return diagnose(commissioned(), runs, [name for name in ("lag", "resonance")]).document.to_json()


def test_documents_that_are_written_are_checked(rdpi: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                                                ) -> None:
    """Of every kind, whichever command writes them: the model, IMPROVED.json, --json and the reports."""
    monkeypatch.chdir(tmp_path)
    for k, run in enumerate(recorded(plain_model(), drives(LATER[:2]), entry("delay", delay_s=0.003))):
        write_recording(f"{k}.csv", run.columns, run.metadata)
    before = dict(written.checked)
    assert rdpi("fit", "0.csv", "-o", "m.json", "--json", "f.json", "--report", "fit").exit_code == 0
    others = [word for name in ("creep", "lag", "resonance", "backlash") for word in ("--without", name)]
    done = rdpi("gap", "m.json", "1.csv", "-o", "new.json", "--json", "g.json", "--report", "gap", *others)
    assert done.exit_code == 0
    counts = {kind: written.checked[kind] - before.get(kind, 0) for kind in ("model", "fit", "gap")}
    assert counts == {"model": 2, "fit": 2, "gap": 2}
    document = json.loads(Path("g.json").read_text())
    assert GapDocument.from_json(document).to_json() == document
    assert FitDocument.from_json(json.loads(Path("f.json").read_text())).to_json() == json.loads(
        Path("fit/fit.json").read_text())
    model = json.loads(Path("new.json").read_text())
    assert Passport.from_json(model["passport"]).to_json() == model["passport"]


@pytest.mark.parametrize("path, value", [
    ("verdict", "perhaps"), ("gap.rms_um", None), ("gap.rms_um", -1.0), ("where.axes.time_s.share", [None]),
    ("effects.0.parameters.delay_s.value", "x"), ("effects.0.confidence", 1.5), ("runs.0.samples", 1.5),
    ("promised.shrink", 2.0), ("offset_um.moved", 1), ("candidates.0.excited", None), ("matrix.r2", [1.0]),
    ("detection", "3"), ("notes", [1])])
def test_a_document_that_is_wrong_is_not_written(path: str, value: Any, tmp_path: Path) -> None:
    """So that the check above can fail."""
    from rdpi.gap.report import page

    document = copy.deepcopy(gap_document())
    written.check(json.dumps(document))
    *parents, last = path.split(".")
    place: Any = document
    for key in parents:
        place = place[int(key)] if isinstance(place, list) else place[key]
    assert last in place
    place[last] = value
    with pytest.raises(AssertionError, match=f"refuses .*{path}"):
        page.atomic_write(tmp_path / "gap.json", json.dumps(document))
    del place[last]
    with pytest.raises(AssertionError, match="is a required property"):
        page.atomic_write(tmp_path / "gap.json", json.dumps(document))
    assert not list(tmp_path.iterdir())


def test_every_module_checks_what_it_writes() -> None:
    writers = [module for module in written.modules() if hasattr(module, "atomic_write")]
    assert len(writers) > 4 and all(hasattr(module.atomic_write, "checks") for module in writers)


@pytest.mark.parametrize("path", ["fit.runs", "passport.axes.direction", "passport.level", "rate.max_um_per_s",
                                  "drive.min_V", "slopes", "effects.0.parameters"])
def test_a_model_that_is_wrong_is_told(path: str) -> None:
    document = json.loads(json.dumps(replace(commissioned(), effects=[entry("delay", delay_s=0.003)]).to_json()))
    assert written.complaints(document) == []
    *parents, last = path.split(".")
    place: Any = document
    for key in parents:
        place = place[int(key)] if isinstance(place, list) else place[key]
    assert last in place
    place[last] = "x"
    told = path if not path.startswith("passport") else "passport"  # which may be null as well
    assert [one for one in written.complaints(document) if one.startswith(f"{told}:")]
