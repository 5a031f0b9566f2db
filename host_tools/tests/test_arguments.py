"""The Python functions take numbers, lists and arrays, and refuse everything else by the name of the argument."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from injected import LATER, drives, plain_model, recorded
from plants import changed

import rdpi
from rdpi import firmware
from rdpi.data import Recording
from rdpi.errors import BadInput
from rdpi.firmware import header
from rdpi.identify import Options, identify
from rdpi.gap import diagnosis as gap
from rdpi.model import Model
from rdpi.simulate import chain

SAMPLE_TIME_S = 1e-3
MODEL = plain_model(1.0)
PLAYS = len(MODEL.thresholds_um)
RUN = recorded(plain_model(), drives(LATER[:1]))[0]
# None of these is a series of numbers, and none a recording, a model, a list of them, or options.
NONSENSE: dict[str, Any] = {
    "None": None, "text": "abc", "texts": ["1", "2"], "table": np.zeros((3, 3)), "number": 1.5, "bool": True,
    "objects": np.array([None, 1.0], object), "complex": np.zeros(4, complex), "ragged": [[1.0], [1.0, 2.0]],
    "dict": {}, "huge": [10**400]}
NOT_FINITE = {"NaN": np.nan, "inf": np.inf}


def engine(name: str) -> firmware.Firmware | firmware.FixedPoint:
    return firmware.engine(MODEL, SAMPLE_TIME_S, name)


def set_memory(name: str, states_um: Any) -> None:
    engine(name).memory_um = states_um


SERIES: dict[str, tuple[str, Callable[[Any], Any]]] = {
    **{f"{name} step": ("reference_um", lambda values, name=name: engine(name).step(values))
       for name in firmware.ENGINES},
    **{f"{name} {do}": ("drive_V", lambda values, name=name, do=do: getattr(engine(name), do)(values, np.zeros(3)))
       for name in firmware.ENGINES for do in ("predict", "forward")},
    **{f"{name} {do} rate": ("rate_um_per_s", lambda values, name=name, do=do: getattr(engine(name), do)(
        np.zeros(3), values)) for name in firmware.ENGINES for do in ("predict", "forward")},
    **{f"{name} memory": ("memory_um", lambda values, name=name: set_memory(name, values))
       for name in firmware.ENGINES},
    "plays x": ("x_um", lambda values: firmware.plays(values, np.zeros(1), np.zeros(1))),
    "plays r": ("thresholds_um", lambda values: firmware.plays(np.zeros(3), values, np.zeros(1))),
    "plays y": ("states_um", lambda values: firmware.plays(np.zeros(3), np.zeros(1), values)),
    "rate": ("z_um", lambda values: firmware.rate(values, SAMPLE_TIME_S, 0.0, 0.0)),
    "score predicted": ("predicted_um", lambda values: chain.score(values, np.arange(3.0))),
    "score measured": ("measured_um", lambda values: chain.score(np.arange(3.0), values)),
    "follow": ("reference_um", lambda values: chain.follow(MODEL, changed(RUN, reference_um=values))),
    **{f"{do} {name}": (name, lambda values, do=do, name=name: DO[do]([changed(RUN, **{name: values})]))
       for do in ("simulate", "fit", "diagnose") for name in ("time_s", "command_V", "displacement_um")},
    **{f"model {item.name}": (item.name, lambda values, key=item.name: replace(MODEL, **{key: values}).validate())
       for item in fields(Model) if item.type == "np.ndarray"}}
DO: dict[str, Callable[[Any], Any]] = {
    "simulate": lambda runs: chain.simulate(MODEL, runs), "fit": identify.fit,
    "diagnose": lambda runs: gap.diagnose(MODEL, runs)}
OTHERS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "engine model": ("model", lambda value: firmware.engine(value, SAMPLE_TIME_S, "f32")),
    "fixed point model": ("model", lambda value: firmware.engine(value, SAMPLE_TIME_S, "q31")),
    "engine name": ("engine", lambda value: firmware.engine(MODEL, SAMPLE_TIME_S, value)),
    **{f"{name} missed": ("ticks", lambda value, name=name: engine(name).missed(value)) for name in firmware.ENGINES},
    **{f"{do} runs": ("runs", lambda value, do=do: DO[do](value)) for do in DO},
    **{f"{do} run": (r"runs\[0\]", lambda value, do=do: DO[do]([value])) for do in DO},
    "simulate model": ("model", lambda value: chain.simulate(value, [RUN])),
    "simulate memory": ("memory", lambda value: chain.simulate(MODEL, [RUN], value)),
    "diagnose model": ("model", lambda value: gap.diagnose(value, [RUN])),
    "diagnose without": ("without", lambda value: gap.diagnose(MODEL, [RUN], [value])),
    "follow engine": ("engine", lambda value: chain.follow(MODEL, changed(RUN, reference_um=RUN.time_s), engine=value)),
    "simulate thresholds": ("thresholds_um|slopes", lambda value: chain.simulate(
        replace(MODEL, thresholds_um=np.zeros(0) if value is None else value), [RUN])),
    "fit rate_independent": ("rate_independent", lambda value: identify.fit([RUN], Options(
        rate_independent="yes" if value is True else value))),
    "fit options": ("options", lambda value: identify.fit([RUN], value))}
SCALARS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "engine": ("sample_time_s", lambda value: firmware.engine(MODEL, value, "f32")),
    "fixed point": ("sample_time_s", lambda value: firmware.engine(MODEL, value, "q31")),
    **{f"rate {name}": (name, lambda value, name=name: firmware.rate(
        np.zeros(3), **{"sample_time_s": SAMPLE_TIME_S, "window_s": 0.0, "filter_s": 0.0, name: value}))
       for name in ("sample_time_s", "window_s", "filter_s")},
    **{f"model {item.name}": (item.name, lambda value, key=item.name: replace(MODEL, **{key: value}))
       for item in fields(Model) if item.type == "float"},
    **{f"model {part}.{item.name}": (item.name, lambda value, part=part, key=item.name: replace(
        MODEL, **{part: replace(getattr(MODEL, part), **{key: value})}))
       for part in ("rate", "drive", "memory") for item in fields(getattr(MODEL, part))
       if item.type.startswith(("float", "int"))},
    **{f"fit {item.name}": (item.name, lambda value, key=item.name: identify.fit([RUN], Options(**{key: value})))
       for item in fields(Options) if item.type.startswith(("float", "int"))}}


def refused(name: str, function: Callable[[Any], Any], value: Any) -> None:
    """Without a warning that NumPy would have printed first."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(BadInput, match=name):
            function(value)


def test_the_error_is_public() -> None:
    assert rdpi.BadInput is BadInput


@pytest.mark.parametrize("case", SERIES)
def test_what_is_no_series_of_numbers(case: str) -> None:
    name, function = SERIES[case]
    for value in NONSENSE.values():
        refused(name, function, value)


@pytest.mark.parametrize("case", OTHERS)
def test_what_is_of_another_kind(case: str) -> None:
    name, function = OTHERS[case]
    for value in NONSENSE.values():
        refused(name, function, value)


@pytest.mark.parametrize("case", SCALARS)
def test_what_is_no_number(case: str) -> None:
    name, function = SCALARS[case]
    for kind, value in {**NONSENSE, "huge": 10**400, "number": [1.5]}.items():
        if kind == "None" and case.startswith(("model rate.", "model drive.", "model memory.sweep_share", "fit ")):
            continue  # some of them may be left open
        refused(name, function, value)


def test_a_rate_without_a_sample_time() -> None:
    refused("sample_time_s is 0", lambda value: firmware.rate(np.zeros(3), value, 0.0, 0.0), 0)


@pytest.mark.parametrize("value", NOT_FINITE.values(), ids=NOT_FINITE)
@pytest.mark.parametrize("do", DO)
@pytest.mark.parametrize("column", ["time_s", "command_V", "displacement_um", "other_axis_V"])
def test_a_column_that_is_not_finite(do: str, column: str, value: float) -> None:
    broken = RUN.columns[column].copy()
    broken[len(broken) // 2] = value
    refused(rf"{RUN.path}: {column}\[{len(broken) // 2}\]", DO[do], [changed(RUN, **{column: broken})])


@pytest.mark.parametrize("do", DO)
def test_columns_of_unequal_length_and_none_at_all(do: str) -> None:
    refused("command_V has 3 values", DO[do], [changed(RUN, command_V=np.zeros(3))])
    refused("at least", DO[do], [changed(RUN, **{key: values[:0] for key, values in RUN.columns.items()})])
    refused("no column command_V", DO[do], [Recording("x.csv", {}, {"time_s": RUN.time_s})])


@pytest.mark.parametrize("value", NOT_FINITE.values(), ids=NOT_FINITE)
def test_a_model_that_is_not_finite(value: float) -> None:
    for item in fields(Model):
        if item.type in ("float", "np.ndarray"):
            broken = value if item.type == "float" else np.full(len(getattr(MODEL, item.name)), value)
            model = replace(MODEL, **{item.name: broken})
            for function in (lambda one: one.validate(), lambda one: gap.diagnose(one, [RUN]), header.render,
                             lambda one: firmware.engine(one, SAMPLE_TIME_S, "q31")):
                refused(item.name, function, model)


def test_lists_integers_and_any_memory_layout_are_as_good_as_arrays() -> None:
    values = np.arange(6)
    frozen = values.astype(float)
    frozen.flags.writeable = False
    wanted = engine("f64").step(values.astype(float)).drive_V
    for given in (values.tolist(), values, values.astype(np.float32), np.repeat(values, 2)[::2], frozen,
                  values.astype(">f8")):
        assert np.array_equal(engine("f64").step(given).drive_V, wanted)
        outputs, states = firmware.plays(given, [0.0, 1.0], (0, 0))
        assert np.array_equal(outputs[:, 1], np.maximum(values - 1, 0)) and states.tolist() == [5.0, 4.0]
    listed = replace(MODEL, thresholds_um=MODEL.thresholds_um.tolist())
    assert np.array_equal(listed.thresholds_um, MODEL.thresholds_um)
    as_lists = changed(RUN, command_V=RUN.command_V.tolist())
    assert np.array_equal(chain.simulate(MODEL, [as_lists])[0].predicted_um,
                          chain.simulate(MODEL, [RUN])[0].predicted_um)
