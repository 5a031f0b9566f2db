"""The model file: every way it can be bad is refused by name, and what is accepted the firmware accepts too."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from models import MODELS, SAMPLE_TIME_S, SEEDS, random_model
from written import sections_as_read

from rdpi.errors import BadInput
from rdpi.firmware import Firmware, FixedPoint
from rdpi.model import Memory, Model, read_model, write_model
from rdpi.model.curves import guard_rates
from rdpi.model.file import MAX_DEPTH, MAX_EFFECTS, MAX_FILE_BYTES

GOOD: dict[str, Any] = {
    "schema": "rdpi-model/1", "tool": "rdpi 0.0.1", "actuator": "P-885.91",
    "gain_um_per_V": 0.12, "offset_V": -1.5, "offset_um": 0.25, "stroke_um": 12.5,
    "thresholds_um": [0.0, 2.0, 4.5], "slopes": [0.5, 0.8, 1.0], "slope_rate_s_per_um": [-2e-4, 0.0, 1e-5],
    "deadzones_um": [0.0, 3.0], "deadzone_weights": [1.0, -0.25],
    "rate": {"source": "displacement", "window_s": 0.001, "filter_s": 0.002, "max_um_per_s": 1500.0,
             "singular_um_per_s": 2500.0, "min_slope_ratio": 0.3},
    "drive": {"min_V": -20.0, "max_V": 120.0, "slew_V_per_s": 5e4, "dac_bits": 16},
    "memory": {"x_um": 2.0, "plays_um": [2.0, 1.0, 0.5]},
    "fit": {"runs": [{"file": "a.csv", "rms_percent": 0.5}]}, "effects": [{"name": "delay"}],
    "passport": {"owner": "lab"},
}
ABSENT = object()


def changed(path: str, value: object) -> dict[str, Any]:
    """GOOD with the value at a path such as "memory.plays_um.1" replaced, added or, if ABSENT, taken away."""
    document = copy.deepcopy(GOOD)
    *parents, last = path.split(".")
    holder: Any = document
    for key in parents:
        holder = holder[key]
    if value is ABSENT:
        del holder[last]
    else:
        holder[int(last) if isinstance(holder, list) else last] = value
    return document


@pytest.fixture
def written(tmp_path: Path) -> Callable[[object], Path]:
    def write(document: object) -> Path:
        path = tmp_path / "model.json"
        path.write_text(document if isinstance(document, str) else json.dumps(document))
        return path

    return write


@pytest.fixture
def complaint(written: Callable[[object], Path]) -> Callable[[object], str]:
    """What read_model says about a bad document, after the file's name."""
    def read(document: object) -> str:
        path = written(document)
        with pytest.raises(BadInput) as refused:
            read_model(path)
        message = str(refused.value)
        assert message.startswith(f"{path}: ") and "\n" not in message
        return message.removeprefix(f"{path}: ")

    return read


def test_good(written: Callable[[object], Path]) -> None:
    model = read_model(written(GOOD))
    assert model.gain_um_per_V == 0.12 and model.thresholds_um.tolist() == [0, 2, 4.5] and model.drive.dac_bits == 16
    assert model.rate.min_slope_ratio == 0.3 and model.memory.plays_um.tolist() == [2, 1, 0.5]


# ---- bad documents ----

REQUIRED = ["gain_um_per_V", "offset_V", "offset_um", "stroke_um", "thresholds_um", "slopes", "slope_rate_s_per_um",
            "deadzones_um", "deadzone_weights", "rate.max_um_per_s", "drive.min_V", "drive.max_V"]
NUMBERS = ["gain_um_per_V", "offset_V", "offset_um", "stroke_um", "rate.window_s", "rate.filter_s", "rate.max_um_per_s",
           "rate.singular_um_per_s", "rate.min_slope_ratio", "drive.min_V", "drive.max_V", "drive.slew_V_per_s",
           "drive.dac_bits", "drive.sweep_cycles", "drive.sweep_V_per_s", "drive.sweep_end_V", "memory.x_um"]
LISTS = ["thresholds_um", "slopes", "slope_rate_s_per_um", "deadzones_um", "deadzone_weights", "memory.plays_um"]


@pytest.mark.parametrize("key", REQUIRED)
def test_missing_key(key: str, complaint: Callable) -> None:
    message = complaint(changed(key, ABSENT))
    assert message.startswith(f"{key}: missing") and "fit again, or add it" in message


@pytest.mark.parametrize("key", ["rate", "drive"])
def test_missing_section(key: str, complaint: Callable) -> None:
    assert complaint(changed(key, ABSENT)) == f"{key}: must be an object, as `rdpi fit` writes it"


@pytest.mark.parametrize("key", NUMBERS)
@pytest.mark.parametrize("value", ["0.5", True, [1.0], {}])
def test_no_number_where_one_is_due(key: str, value: object, complaint: Callable) -> None:
    assert complaint(changed(key, value)) == f"{key}: must be a finite number, got {json.dumps(value)}"


@pytest.mark.parametrize("key", sorted(set(NUMBERS) - {"rate.singular_um_per_s", "drive.slew_V_per_s",
                                                       "drive.dac_bits", "drive.sweep_V_per_s", "drive.sweep_end_V"}))
def test_null_where_a_number_is_due(key: str, complaint: Callable) -> None:
    assert complaint(changed(key, None)) == f"{key}: must be a finite number, got null"


@pytest.mark.parametrize("key", LISTS)
@pytest.mark.parametrize("value", ["0, 1, 2", 1.0, None, {}, [0, "1", 2], [0, True, 2], [0, None, 2], [[0, 1, 2]]])
def test_no_list_of_numbers_where_one_is_due(key: str, value: object, complaint: Callable) -> None:
    assert complaint(changed(key, value)) == f"{key}: must be a list of finite numbers"


@pytest.mark.parametrize("key", ["gain_um_per_V", "rate.window_s", "slopes.1"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_nan_and_infinity(key: str, value: float, complaint: Callable) -> None:
    """json.dumps writes the words NaN and Infinity, which JSON does not have."""
    message = complaint(changed(key, value))
    assert json.dumps(value) in message and "fit again or restore it" in message


@pytest.mark.parametrize("number", ["1e999", "-1e999", "1" + 400 * "0", "1" + 5000 * "0"],
                         ids=["1e999", "-1e999", "400 digits", "5000 digits"])
@pytest.mark.parametrize("key", ["gain_um_per_V", "drive.dac_bits", "slopes.1"])
def test_numbers_beyond_double(key: str, number: str, complaint: Callable) -> None:
    complaint(json.dumps(changed(key, "HERE")).replace('"HERE"', number))


@pytest.mark.parametrize("key", LISTS[:-1])
def test_empty_list(key: str, complaint: Callable) -> None:
    assert complaint(changed(key, [])).startswith(f"{key}: is empty")


@pytest.mark.parametrize("schema", [ABSENT, "rdpi-model/2", "RDPI-MODEL/1", 1, None])
def test_wrong_schema(schema: object, complaint: Callable) -> None:
    message = complaint(changed("schema", schema))
    assert message.startswith("schema: is ") and 'expected "rdpi-model/1"' in message and "fit again" in message


@pytest.mark.parametrize("text", ["[1, 2]", "3", "null", '"rdpi-model/1"', "", "time_s,command_V\n0,1\n"])
def test_no_object(text: str, complaint: Callable) -> None:
    assert complaint(text) == "line 1: this is not a JSON object; `rdpi fit` writes model files"


@settings(max_examples=60)
@given(share=st.floats(0.01, 1, exclude_max=True))
def test_cut_short(share: float, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "cut.json"
    write_model(path, random_model(1))
    text = path.read_text().rstrip()
    path.write_text(text[:int(share * len(text))])
    with pytest.raises(BadInput, match=r"cut\.json: not a complete JSON document .* fit again or restore it"):
        read_model(path)


@pytest.mark.parametrize("data", [b"\xff\xfe{\x00", b"\x80\x02}q\x00.", b'{"a": ' * 100_000, b"{}{}"],
                         ids=["UTF-16", "pickle", "deep", "twice"])
def test_no_json(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_bytes(data)
    with pytest.raises(BadInput, match=r"model\.json: not a complete JSON document .* fit again or restore it"):
        read_model(path)


def test_too_many_effects(complaint: Callable) -> None:
    effect = {"name": "gain_change", "stage": "sensor", "parameters": {}, "origin": "gap"}
    message = complaint(changed("effects", (MAX_EFFECTS + 1) * [effect]))
    assert message.startswith(f"effects: has {MAX_EFFECTS + 1} entries, at most {MAX_EFFECTS}")


def test_keys_that_are_there_twice(written: Callable, tmp_path: Path) -> None:
    """JSON leaves open which of the two counts."""
    text = written(changed("gain_um_per_V", 0.1)).read_text()
    for doubled in (text.replace("{", '{"stroke_um": 1, ', 1), text.replace('"min_V"', '"max_V": 1, "min_V"')):
        (tmp_path / "twice.json").write_text(doubled)
        with pytest.raises(BadInput, match="twice.json: .*the key '(stroke_um|max_V)' exists twice"):
            read_model(tmp_path / "twice.json")


def test_nested_too_deep(complaint: Callable) -> None:
    nest: object = 1
    for _ in range(MAX_DEPTH + 1):
        nest = [nest]
    assert f"nested more than {MAX_DEPTH} deep" in complaint(changed("fit.more", nest))


def test_a_file_too_large_for_a_model(tmp_path: Path) -> None:
    (tmp_path / "large.json").write_bytes(b"{" + bytes(MAX_FILE_BYTES))
    with pytest.raises(BadInput, match="large.json: has .* bytes; a model has at most"):
        read_model(tmp_path / "large.json")


def test_no_file(tmp_path: Path) -> None:
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(BadInput, match=rf"{path.name}: .*; check the path"):
            read_model(path)


# ---- bad values: file, key, what, remedy ----

BAD_VALUES = {
    "gain zero": ("gain_um_per_V", 0, "gain_um_per_V: is 0"),
    "stroke zero": ("stroke_um", 0, "stroke_um: is 0; must be positive"),
    "stroke negative": ("stroke_um", -12.5, "stroke_um: is -12.5; must be positive"),
    "thresholds unsorted": ("thresholds_um", [0, 4.5, 2], "thresholds_um: must start at 0 and increase, got [0, 4.5"),
    "threshold twice": ("thresholds_um", [0, 2, 2], "thresholds_um: must start at 0 and increase, got [0, 2, 2]; sort"),
    "thresholds not from 0": ("thresholds_um", [1, 2, 4.5], "thresholds_um: must start at 0 and increase"),
    "slope negative": ("slopes.1", -0.8, "slopes[1]: is -0.8; every slope must be positive"),
    "slope zero": ("slopes.0", 0, "slopes[0]: is 0; every slope must be positive"),
    "slopes too few": ("slopes", [0.5, 0.8], "slopes: has 2 values, expected 3, one per threshold"),
    "slope rates too many": ("slope_rate_s_per_um", [0, 0, 0, 0], "slope_rate_s_per_um: has 4 values, expected 3"),
    "slope falls": ("slope_rate_s_per_um.0", -3e-4, "rate.max_um_per_s: at 1500 um/s slope 0 has fallen to 0.05, below "
                                                    "0.3 of its 0.5 at rest; use 1167 or less"),
    "dead zones unsorted": ("deadzones_um", [0, -3], "deadzones_um: must start at 0 and increase, got [0, -3]; sort"),
    "dead zones not from 0": ("deadzones_um", [0.1, 3], "deadzones_um: must start at 0 and increase"),
    "dead zone weights too few": ("deadzone_weights", [1], "deadzone_weights: has 1 values, expected 2, one per"),
    "partial sum zero": ("deadzone_weights", [1, -1], "deadzone_weights: the weights up to [1] sum to 0; every"),
    "first weight negative": ("deadzone_weights", [-1, 2], "deadzone_weights: the weights up to [0] sum to -1"),
    "rate source": ("rate.source", "drive", 'rate.source: is "drive"; must be one of displacement, control'),
    "rate source no text": ("rate.source", ["control"], "rate.source: is "),
    "window negative": ("rate.window_s", -1e-3, "rate.window_s: is -0.001 s; must not be negative"),
    "filter negative": ("rate.filter_s", -1, "rate.filter_s: is -1 s; must not be negative"),
    "endless smoothing": ("rate.smoothing_s", 1e308, "rate.smoothing_s: is 1e+308 s; must not exceed 1e+07 s"),
    "guard zero": ("rate.max_um_per_s", 0, "rate.max_um_per_s: is 0; must be positive"),
    "guard ratio zero": ("rate.min_slope_ratio", 0, "rate.min_slope_ratio: is 0; must lie between 0 and 1"),
    "guard ratio one": ("rate.min_slope_ratio", 1, "rate.min_slope_ratio: is 1; must lie between 0 and 1"),
    "drive limits equal": ("drive.min_V", 120, "drive: min_V 120 must be below max_V 120"),
    "drive limits swapped": ("drive.max_V", -30, "drive: min_V -20 must be below max_V -30"),
    "slew zero": ("drive.slew_V_per_s", 0, "drive.slew_V_per_s: is 0; must be positive, or null for no limit"),
    "slew negative": ("drive.slew_V_per_s", -5, "drive.slew_V_per_s: is -5; must be positive, or null"),
    "no DAC bits": ("drive.dac_bits", 0, "drive.dac_bits: is 0; must be 1 to 20, or null"),
    "DAC bits too many": ("drive.dac_bits", 21, "drive.dac_bits: is 21; must be 1 to 20, or null"),
    "DAC bits broken": ("drive.dac_bits", 12.5, "drive.dac_bits: must be a whole number, got 12.5"),
    "sweep cycles none": ("drive.sweep_cycles", 0, "drive.sweep_cycles: is 0; must be 1 to 10000"),
    "sweep cycles many": ("drive.sweep_cycles", 10001, "drive.sweep_cycles: is 10001; must be 1 to 10000"),
    "sweep cycles broken": ("drive.sweep_cycles", 2.5, "drive.sweep_cycles: must be a whole number, got 2.5"),
    "sweep end": ("drive.sweep_end_V", 121, "drive.sweep_end_V: is 121 V, outside drive -20 to 120 V"),
    "sweep backwards": ("drive.sweep_V_per_s", -1, "drive.sweep_V_per_s: is -1; must be positive"),
    "sweep slow": ("drive.sweep_V_per_s", 1e-5, "drive.sweep_V_per_s: a start-up sweep of 1e-05 V/s is too slow"),
    "sweep fast": ("drive.sweep_V_per_s", 6e4, "drive.sweep_V_per_s: is 60000 V/s, above slew_V_per_s, 50000; sweep"),
    "slew slow": ("drive.slew_V_per_s", 1e-5, "drive.slew_V_per_s: a start-up sweep of 1e-05 V/s is too slow"),
    "gain tiny": ("gain_um_per_V", 1e-8, "gain_um_per_V: is 1e-08; x = gain (V - offset_V) needs a gain, at least"),
    "large": ("rate.filter_s", 1.1e7, "rate.filter_s: must be finite, within ±1e+07, as the firmware requires"),
    "intercepts large": ("slopes.2", 5e6, "slopes: with these thresholds_um its intercepts reach 2.25e+07, beyond"),
    "inverse large": ("deadzone_weights", [1e-8, 1], "deadzone_weights: partial sums of"),
    "plays too few": ("memory.plays_um", [2, 1], "memory.plays_um: has 2 values, expected 3, one per threshold"),
    "play apart from its neighbour": ("memory.plays_um", [2, 1, -2], "memory.plays_um: no history leaves these states"),
    "play not at x": ("memory.plays_um.0", 1.5, "memory.plays_um[0]: is 1.5, but must be x_um = 2"),
    "memory outside the drive": ("memory", {"x_um": 20, "plays_um": [20, 19, 17]}, "memory.x_um: is held by 165.167 V"),
    "memory no object": ("memory", [2.0], "memory: must be an object, as `rdpi fit` writes it"),
    "fit no object": ("fit", "good", "fit: must be an object, as `rdpi fit` writes it"),
    "effects no list": ("effects", {}, "effects: must be a list"),
}


@pytest.mark.parametrize(("key", "value", "message"), BAD_VALUES.values(), ids=BAD_VALUES)
def test_bad_value(key: str, value: object, message: str, complaint: Callable) -> None:
    assert complaint(changed(key, value)).startswith(message)


@pytest.mark.parametrize("excess", [1.01, 1 / 1.01])
def test_guard_rate_named_as_remedy_is_accepted(excess: float, written: Callable, complaint: Callable) -> None:
    document = changed("rate.max_um_per_s", excess * 0.7 * 0.5 / 2e-4)
    if excess < 1:
        read_model(written(document))
    else:
        document["rate"]["max_um_per_s"] = float(complaint(document).split("use ")[1].split()[0])
        read_model(written(document))


# ---- round trip ----

@settings(max_examples=50)
@given(model=MODELS)
def test_round_trip(model: Model, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "round-trip.json"
    model.actuator = "Stapel µ"
    write_model(path, model)
    first = path.read_bytes()
    again = read_model(path)
    assert again.to_json() == model.to_json() and again.digest() == model.digest()
    for key in ("thresholds_um", "slopes", "slope_rate_s_per_um", "deadzones_um", "deadzone_weights"):
        np.testing.assert_array_equal(getattr(again, key), getattr(model, key))
    np.testing.assert_array_equal(again.memory.plays_um, model.memory.plays_um)
    assert (again.rate, again.drive, again.actuator) == (model.rate, model.drive, model.actuator)
    write_model(path, again)
    assert path.read_bytes() == first


@pytest.mark.parametrize("effects", [[{"name": "delay", "parameters": {"delay_s": float("nan")}}],
                                     [{"name": "delay", "parameters": {"delay_s": np.array([0.001])}}]])
def test_what_no_file_can_hold_replaces_none(effects: list, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    write_model(path, random_model(1))
    before, wrong = path.read_bytes(), random_model(2)
    wrong.effects = effects
    with pytest.raises(BadInput, match="not written"):
        write_model(path, wrong)
    assert path.read_bytes() == before


def test_unknown_keys_are_kept(written: Callable, tmp_path: Path) -> None:
    document = copy.deepcopy(GOOD)
    document["colour"] = {"hue": [1, None, "x"]}
    for section in ("rate", "drive", "memory"):
        document[section]["remark"] = f"of {section}"
    with sections_as_read():
        write_model(tmp_path / "again.json", read_model(written(document)))
    again = json.loads((tmp_path / "again.json").read_text())
    document["tool"] = again["tool"]
    document["rate"].update(smoothing_s=0.0, identified_um_per_s=None)  # optional keys appear with their defaults
    document["drive"].update(sweep_cycles=20, sweep_V_per_s=None, sweep_end_V=None)
    assert again == document


def test_defaults(written: Callable) -> None:
    optional = ("tool", "actuator", "memory", "fit", "effects", "passport")
    document = {key: GOOD[key] for key in GOOD if key not in optional}
    document.update(rate={"max_um_per_s": 1500.0, "colour": 1}, drive={"min_V": -20.0, "max_V": 120.0})
    model = read_model(written(document))
    assert (model.rate.source, model.rate.window_s, model.rate.filter_s, model.rate.min_slope_ratio) == \
        ("displacement", 0, 0, 0.2)
    assert model.drive.slew_V_per_s is None and model.drive.dac_bits is None and model.effects == []
    assert model.memory.x_um == 0 and model.memory.plays_um.tolist() == [0, 0, 0]


def test_plays_follow_x_when_only_x_is_given(written: Callable) -> None:
    """Straight from 0 to 3.5: the play of threshold 2 has moved to 1.5, that of 4.5 not at all."""
    model = read_model(written(changed("memory", {"x_um": 3.5})))
    assert model.memory.plays_um.tolist() == [3.5, 1.5, 0]
    made = replace(model, memory=Memory(x_um=3.5))  # and without a file
    made.validate()
    assert made.memory.plays_um.tolist() == model.memory.plays_um.tolist()


def test_writing_a_bad_model_leaves_the_old_file(written: Callable) -> None:
    path = written(GOOD)
    before = path.read_bytes()
    model = read_model(path)
    model.slopes = -model.slopes
    with pytest.raises(BadInput, match=r"model\.json: slopes\[2\]: is -1"):
        write_model(path, model)
    assert path.read_bytes() == before and [entry.name for entry in path.parent.iterdir()] == ["model.json"]


def test_digest_is_that_of_the_behaviour(written: Callable) -> None:
    def digest(key: str, value: object) -> str:
        return read_model(written(changed(key, value))).digest()

    same = digest("actuator", "another")
    for key, value in (("tool", "rdpi 9"), ("fit", {}), ("effects", []), ("passport", None), ("colour", 1)):
        assert digest(key, value) == same
    for key, value in (("offset_V", -1.4), ("slopes.1", 0.81), ("drive.dac_bits", None), ("memory.plays_um.2", 0.6)):
        assert digest(key, value) != same
    for key, value, default in (("sweep_V_per_s", 6000.0, 5600.0), ("sweep_end_V", 1.0, 2.0 / 0.12 - 1.5),
                                ("sweep_cycles", 21, 20)):
        assert digest(f"drive.{key}", default) == same != digest(f"drive.{key}", value)


def test_start_up_sweep(written: Callable) -> None:
    model = read_model(written(GOOD))
    assert (model.drive.sweep_cycles, model.drive.sweep_speed()) == (20, 2 * 140 * 20)
    assert model.sweep_end() == pytest.approx(2.0 / 0.12 - 1.5)
    assert replace(model.drive, slew_V_per_s=100.0).sweep_speed() == 100
    assert replace(model.drive, sweep_V_per_s=7.0).sweep_speed() == 7
    widest = replace(model.drive, min_V=-1e6, max_V=1e6, slew_V_per_s=None)
    assert widest.sweep_speed() == 1e7, "the firmware's largest number"
    assert replace(model, drive=replace(model.drive, sweep_end_V=3.0)).sweep_end() == 3


# ---- slopes ----

def test_slopes_at(written: Callable) -> None:
    model = read_model(written(GOOD))
    assert model.slopes_at(1000.0).tolist() == [0.3, 0.8, 1.01]
    assert model.slopes_at(np.array([0.0, 1000.0])).tolist() == [[0.5, 0.8, 1.0], [0.3, 0.8, 1.01]]
    assert model.x_of(8.5) == pytest.approx(1.2)


def test_guard_rates() -> None:
    assert guard_rates(np.array([0.5, 0.8, 1.0]), np.array([-2e-4, 0.0, 1e-5])).tolist() == [2500, math.inf, math.inf]


# ---- what is accepted can be flashed ----

ARRAYS = ("thresholds_um", "slopes", "slope_rate_s_per_um", "deadzones_um", "deadzone_weights")
PLACES = st.one_of(
    st.tuples(st.just("model"), st.sampled_from(["gain_um_per_V", "offset_V", "offset_um", "stroke_um"])),
    st.tuples(st.just("rate"), st.sampled_from(["window_s", "filter_s", "max_um_per_s", "min_slope_ratio"])),
    st.tuples(st.just("drive"), st.sampled_from([
        "min_V", "max_V", "slew_V_per_s", "dac_bits", "sweep_cycles", "sweep_V_per_s", "sweep_end_V"])),
    st.tuples(st.just("memory"), st.just("x_um")),
    st.tuples(st.sampled_from([*ARRAYS, "plays_um"]), st.integers(0, 12)))
VALUES = st.one_of(
    st.sampled_from([0.0, -0.0, -1.0, 1.0, 1e-3, 1e3, 1e-30, 1e30]).map(lambda value: lambda old: value),
    st.sampled_from([-1.0, 0.5, 0.9, 0.999, 1.001, 1.5, 10.0]).map(lambda factor: lambda old: factor * old))
WILD = st.sampled_from([math.nan, math.inf, -math.inf, 1e-320, 1e-46, 1e39, -1e39, 1e300]).map(
    lambda value: lambda old: value)


def corrupt(model: Model, place: tuple[str, Any], change: Callable[[float], float]) -> None:
    """Change one number of the model, as an edited file or a faulty program would."""
    holder, key = place
    if holder in (*ARRAYS, "plays_um"):
        array = model.memory.plays_um if holder == "plays_um" else getattr(model, holder)
        array[key % len(array)] = change(array[key % len(array)])
        return
    target = model if holder == "model" else getattr(model, holder)
    value = change(1.0 if getattr(target, key) is None else getattr(target, key))
    if key in ("dac_bits", "sweep_cycles"):
        assume(math.isfinite(value))
        value = int(min(value, 1e6))
    setattr(target, key, value)
    if key == "x_um":
        model.memory.plays_um[0] = value


def assert_refused_or_flashed(model: Model) -> None:
    """The library is left to refuse only what depends on the sample time: a long rate window, a slow sweep."""
    try:
        model.validate()
    except BadInput:
        return
    for real in ("f64", "f32"):
        try:
            Firmware(model, SAMPLE_TIME_S, real)
        except BadInput as error:
            slow = "start-up sweep" in str(error) and SAMPLE_TIME_S < model.shortest_sample_s()
            assert "rate window spans" in str(error) or slow, f"{real}: {error}"
    try:
        FixedPoint(model, SAMPLE_TIME_S)
    except BadInput as error:  # the host says what 32 bits do not hold
        at_this_rate = ("rate window spans", "start-up sweep", "max_um_per_s out of range")
        assert any(text in str(error) for text in ("no fixed point", *at_this_rate)), error


@settings(max_examples=500)
@given(MODELS, st.lists(st.tuples(PLACES, VALUES), min_size=1, max_size=3))
def test_what_is_valid_can_be_flashed(model: Model, changes: list) -> None:
    for place, change in changes:
        corrupt(model, place, change)
    assert_refused_or_flashed(model)


@settings(max_examples=300)
@given(MODELS, PLACES, WILD)
def test_what_is_valid_can_be_flashed_though_not_representable(model: Model, place: tuple, change: Callable) -> None:
    """NaN, infinity, and numbers that double holds but single precision does not."""
    corrupt(model, place, change)
    assert_refused_or_flashed(model)


@pytest.mark.parametrize("key", ["thresholds_um", "deadzones_um"])
def test_values_that_single_precision_cannot_tell_apart_are_refused(key: str) -> None:
    model = random_model(1)
    values = getattr(model, key)
    values[2] = values[1] * (1 + 1e-12)
    model.memory = Memory(0.0, np.zeros(len(model.thresholds_um)))
    assert_refused_or_flashed(model)


@settings(max_examples=200)
@given(SEEDS, st.integers(2, 12), st.integers(0, 11), st.floats(0.8e-5, 1.2e-5), st.sampled_from([-1, 1]))
def test_states_at_the_end_of_what_rounding_may_do(seed: int, plays: int, which: int, beyond: float, sign: int) -> None:
    """A state a little further from its neighbour than their thresholds: refused here, or taken by the library."""
    model = random_model(seed, plays)
    states = np.full(len(model.thresholds_um), model.memory.x_um)
    k = 1 + which % (len(states) - 1)
    gap = model.thresholds_um[k] - model.thresholds_um[k - 1]
    states[k:] += sign * (gap + beyond * (model.thresholds_um[-1] + abs(states[k - 1])))
    model.memory = Memory(model.memory.x_um, states)
    assert_refused_or_flashed(model)


@settings(max_examples=100)
@given(SEEDS, st.integers(1, 12), st.floats(-5000, 5000))
def test_states_far_from_zero_can_be_flashed(seed: int, plays: int, x_um: float) -> None:
    """Reachable states, whatever the offset of x: rounding to single precision must not make them unreachable."""
    model = random_model(seed, plays)
    shift_um = x_um - model.memory.x_um
    drive = replace(model.drive, min_V=model.drive.min_V + shift_um / model.gain_um_per_V,
                    max_V=model.drive.max_V + shift_um / model.gain_um_per_V)
    model = replace(model, drive=drive, memory=Memory(x_um, model.memory.plays_um + shift_um))
    model.validate()
    assert_refused_or_flashed(model)


@pytest.mark.parametrize("plays", [130, 70_000])
def test_more_plays_than_the_library_takes(plays: int) -> None:
    model = random_model(1)
    model.thresholds_um, model.slopes = np.arange(float(plays)), np.ones(plays)
    model.slope_rate_s_per_um, model.memory = np.zeros(plays), Memory(0.0, np.zeros(plays))
    with pytest.raises(BadInput, match="^model: thresholds_um: has .* at most 129"):
        model.validate()
