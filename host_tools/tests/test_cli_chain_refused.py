"""`rdpi simulate`, `compensate`, `header` and `plot`: bad input and outputs that cannot be written."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from chain_files import COMMANDS, change_model, refusal, write_files
from written import sections_as_read


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_files(tmp_path_factory.mktemp("files"))


def document(change: Callable[[dict], object]) -> Callable[[str], str]:
    def edit(text: str) -> str:
        content = json.loads(text)
        change(content)
        return json.dumps(content, indent=1)

    return edit


BAD_MODEL: dict[str, tuple[Callable[[str], str], str]] = {
    "cut in half": (lambda text: text[:len(text) // 2], r"not a complete JSON document .*line \d+.*fit again"),
    "empty": (lambda text: "", r"JSON"),
    "a recording": (lambda text: Path("large.csv").read_text(), r"JSON"),
    "negative slope": (document(lambda model: model["slopes"].__setitem__(3, -0.1)),
                       r"slopes\[3\]: is -0\.1; every slope must be positive"),
    "unsorted thresholds": (document(lambda model: model["thresholds_um"].sort(reverse=True)),
                            r"thresholds_um: must start at 0 and increase.*sort"),
    "repeated threshold": (document(lambda model: model["thresholds_um"].__setitem__(2, model["thresholds_um"][1])),
                           r"thresholds_um: must .*increase.*twice"),
    "wrong schema": (document(lambda model: model.update(schema="rdpi-model/9")),
                     r'schema: is "rdpi-model/9", expected "rdpi-model/1".*fit again'),
    "no schema": (document(lambda model: model.pop("schema")), r"schema: is null"),
    "missing key": (document(lambda model: model.pop("gain_um_per_V")), r"gain_um_per_V: missing; fit again"),
    "text for a number": (document(lambda model: model.update(offset_V="ten")),
                          r'offset_V: must be a finite number, got "ten"'),
    "NaN": (lambda text: text.replace('"stroke_um": 12.0', '"stroke_um": NaN'), r"NaN"),
    "one slope too few": (document(lambda model: model["slopes"].pop()), r"slopes: has 9 values, expected 10"),
    "guard past the singularity": (document(lambda model: model["rate"].update(max_um_per_s=1e6)),
                                   r"rate\.max_um_per_s: at 1e\+06 um/s slope \d.*use \d+"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("case", BAD_MODEL)
def test_bad_model(case: str, command: str, folder: Path, rdpi: Callable) -> None:
    change, message = BAD_MODEL[case]
    Path("bad.json").write_text(change(Path("moving.json").read_text()))
    text = refusal(rdpi, command, "bad.json")
    assert re.match(r"bad\.json: .*" + message, text), text


@pytest.mark.parametrize("command", COMMANDS)
def test_missing_model(command: str, folder: Path, rdpi: Callable) -> None:
    assert re.match(r"nowhere\.json: .*No such file.*check", refusal(rdpi, command, "nowhere.json"))


def test_effects_of_a_later_version(folder: Path, rdpi: Callable) -> None:
    with sections_as_read():
        change_model(effects=[{"name": "poltergeist"}])
    for command in COMMANDS:
        assert re.match(r"static\.json: effects\[0\].*poltergeist.*cannot simulate",
                        refusal(rdpi, command, "static.json"))


@pytest.mark.parametrize("command", ["compensate", "header"])
def test_a_chain_without_inverse_names_its_effects(command: str, folder: Path, rdpi: Callable) -> None:
    change_model(effects=[{"name": "relaxation", "parameters": {"share": -0.2, "time_constant_s": 1.0}},
                          {"name": "creep", "parameters": {"percent_per_decade": 20.0}}])
    text = refusal(rdpi, command, "static.json")
    assert re.match(r"static\.json: relaxation and creep: .* taken back later; .*give --leave-out creep$", text), text
    assert rdpi(command, "static.json", *filter(None, COMMANDS[command][:1]), "-o", COMMANDS[command][1],
                "--leave-out", "creep").exit_code == 0


def test_a_slow_sweep_names_what_makes_it_slow(folder: Path, rdpi: Callable) -> None:
    change_model(effects=[{"name": "slew_limit", "parameters": {"V_per_s": 0.001}}])
    for model, key, remedy in (("static.json", "slew_limit", "give --leave-out slew_limit"),
                               ("moving.json", "drive", "raise sweep_V_per_s or slew_V_per_s")):
        if model == "moving.json":
            slow = json.loads(Path(model).read_text())
            slow["drive"]["sweep_V_per_s"] = 0.001
            Path(model).write_text(json.dumps(slow))
        done = rdpi("compensate", model, "reference.csv", "-o", "out.csv")
        assert done.exit_code == 2 and not Path("out.csv").exists()
        assert re.search(rf"rdpi: {model}: {key}: the start-up sweep, 0.001 V/s, is too slow for .*reference.csv: "
                         rf"sample_time_s is 0.001\); {remedy}", done.output), done.output
    assert rdpi("compensate", "static.json", "reference.csv", "-o", "out.csv", "--engine", "f64").exit_code == 0


def columns_without(name: str) -> Callable[[list[str]], list[str]]:
    return lambda lines: [line.replace(name, "sensor") for line in lines]


# Lines 1 and 2 are metadata, 3 the names of the columns, 4 the first sample of large.csv.
BAD_RUN: dict[str, tuple[Callable[[list[str]], list[str]], str]] = {
    "missing column": (columns_without("command_V"), r":3: there is no column command_V; "
                       r"the columns are .*sensor.*\. Rename"),
    "NaN": (lambda lines: [*lines[:20], "0.017,nan,1,1\n", *lines[21:]],
            r":21: column command_V is nan; .*(cut|interpolate)"),
    "text": (lambda lines: [*lines[:20], "0.017,off,1,1\n", *lines[21:]],
             r":21: column command_V is 'off', not a number"),
    "too short": (lambda lines: lines[:18], r": 15 samples; at least 16 are needed"),
    "backwards time": (lambda lines: [*lines[:30], *lines[10:]], r":31: time_s runs backwards .*cut"),
    "wrong rate": (lambda lines: [lines[0].replace("1000", "900"), *lines[1:]],
                   r":1: sample_rate_hz is 900, but the times give 1000"),
}


@pytest.mark.parametrize("command", ["simulate", "plot"])
@pytest.mark.parametrize("case", BAD_RUN)
def test_bad_recording(case: str, command: str, folder: Path, rdpi: Callable) -> None:
    change, message = BAD_RUN[case]
    Path("bad.csv").write_text("".join(change(Path("large.csv").read_text().splitlines(keepends=True))))
    text = refusal(rdpi, command, "static.json", "bad.csv")
    assert re.match(r"bad\.csv" + message, text), text


def test_bad_reference(folder: Path, rdpi: Callable) -> None:
    lines = Path("reference.csv").read_text().splitlines(keepends=True)
    for text, message in (
            ([*lines[:30], "0.028,nan\n", *lines[31:]], r"bad\.csv:31: column reference_um is nan"),
            (columns_without("reference_um")(lines), r"bad\.csv:2: there is no column "
             r"reference_um; the columns are time_s, sensor"),
            (lines[:10], r"bad\.csv: 8 samples")):
        Path("bad.csv").write_text("".join(text))
        assert re.match(message, refusal(rdpi, "compensate", "static.json", "bad.csv"))
    text = refusal(rdpi, "compensate", "static.json", None, "--reference-column", "wish")
    assert re.match(r"reference\.csv:2: there is no column wish", text)
    for column in ("command_V", "monitor_V", "time_s", "rate_um_per_s", "dac_code"):
        text = refusal(rdpi, "compensate", "static.json", "large.csv", "--reference-column", column)
        assert text == f"--reference-column {column}: is no displacement; give a column in um"
    assert re.match(r"nowhere\.csv: cannot be read", refusal(rdpi, "compensate", "static.json", "nowhere.csv"))


@pytest.mark.parametrize("command", COMMANDS)
def test_unwritable(command: str, folder: Path, rdpi: Callable) -> None:
    usual, output = COMMANDS[command]
    done = rdpi(command, "static.json", *([usual] if usual else []), "-o", f"missing/{output}")
    assert done.exit_code == 2 and "Traceback" not in done.output
    assert done.output == f"rdpi: missing/{output}: there is no directory missing; create it first\n"


@pytest.mark.parametrize("command", COMMANDS)
def test_an_output_never_replaces_an_input(command: str, folder: Path, rdpi: Callable) -> None:
    usual, _ = COMMANDS[command]
    for name in filter(None, ("static.json", usual)):
        before = Path(name).read_bytes()
        done = rdpi(command, "static.json", *([usual] if usual else []), "-o", name)
        assert done.exit_code == 2 and f"rdpi: {name}: " in done.output and Path(name).read_bytes() == before
