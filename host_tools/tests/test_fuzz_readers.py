"""Files of noise, and good files that were damaged: every reader takes them or refuses them in words.

`pytest --hypothesis-profile long` goes on for RDPI_FUZZ_SECONDS a test.
"""

from __future__ import annotations

import copy
import io
import json
import math
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings, strategies as st
from hypothesis.extra import numpy as arrays_of
from models import random_model

from rdpi.board import profile
from rdpi.data import (Recording, Request, import_recording, importer, read_recording, sample_times, sources,
                       write_recording)
from rdpi.errors import BadInput
from rdpi.firmware import header
from rdpi.model import read_model, write_model

COUNT = 20
RUN = {"time_s": sample_times(COUNT, 1000), "command_V": np.arange(COUNT) % 7.0,
       "displacement_um": np.arange(COUNT) % 5.0}


@pytest.fixture
def fuzzed(long: bool, rounds: Iterable[int]) -> Callable[..., None]:
    """Check a function of drawn arguments with so many examples, or if `long` for long; warnings are errors."""

    def run(function: Callable[..., None], examples: int, **strategies: st.SearchStrategy[Any]) -> None:
        count = 0

        def counted(**drawn: Any) -> None:
            nonlocal count
            count += 1
            function(**drawn)

        checked = settings(max_examples=2000 if long else examples, suppress_health_check=list(HealthCheck))(
            given(**strategies)(counted))
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            for _ in rounds:
                checked()
        print(f"{count} examples")  # pytest -s shows it

    return run


def refuses(path: Path, function: Callable[[], Any]) -> Any:
    """What a reader returns; None where it refuses, as it should: one line that names the file."""
    try:
        return function()
    except BadInput as error:
        assert str(path) in str(error) or str(error).startswith("-"), error
        assert "\n" not in str(error), error
        return None


def damaged(good: bytes, *pieces: bytes) -> st.SearchStrategy[bytes]:
    """`good` with some bytes changed, put in, taken out or repeated."""
    spot = st.integers(0, len(good)) | st.integers(0, min(len(good), 200))
    piece = st.binary(max_size=4) | st.sampled_from([b"", b"\x00", b"\xff" * 4, *pieces])
    edits = st.lists(st.tuples(spot, st.integers(0, 8), piece, st.sampled_from([1, 1, 2, 40])), max_size=6)

    def apply(edits: list[tuple[int, int, bytes, int]]) -> bytes:
        data = good
        for start, length, new, times in edits:
            data = data[:start] + new * times + data[start + length:]
        return data

    return edits.map(apply)


def sound(run: Recording) -> None:
    """What a reader lets pass is a recording."""
    lengths = {len(values) for values in run.columns.values()}
    assert len(lengths) == 1 and lengths.pop() >= 16 and (np.diff(run.time_s) > 0).all()
    assert all(np.isfinite(values).all() for values in run.columns.values())
    assert math.isfinite(run.sample_rate_hz) and run.sample_rate_hz > 0


# --- recordings and what is made of them ----------------------------------------------------------------------------

ROWS = "".join(f"{t},{u},{z}\n" for t, u, z in zip(*(values.tolist() for values in RUN.values())))
CSV = f"# actuator: a\n# sample_rate_hz: 1000\n# memory: reset\n# sweep_s: 0.005\n{','.join(RUN)}\n{ROWS}".encode()
PIECES = (b"nan", b"inf", b"-1", b"1e999", b"1e300", b"1e-320", b",", b"\n", b"\r", b"#", b":", b'"', b"\xc2\xb5", b";",
          b"\t", b".", b"time_s", b"# memory: \n", b"\xef\xbb\xbf", "٣".encode(), b"1_0", b"0x1p3")
TEXT = st.text("0123456789.,;\t eE+-#:%\n\"ab", max_size=300).map(str.encode)


def test_recordings(fuzzed: Callable, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"

    def check(data: bytes, dac: tuple[int, float, float]) -> None:
        path.write_bytes(data)
        run = refuses(path, lambda: read_recording(path))
        if run is not None:
            sound(run)
            refuses(path, lambda: profile.render_reference(run, "displacement_um"))
            refuses(path, lambda: profile.render_drive(run, *dac))

    number = st.floats() | st.sampled_from([0.0, 10.0, -1e6, 1e6])
    fuzzed(check, 120, data=damaged(CSV, *PIECES) | TEXT | st.binary(max_size=200),
           dac=st.tuples(st.integers(-1, 40), number, number))


# --- foreign tables -------------------------------------------------------------------------------------------------

LVM = ("LabVIEW Measurement\nSeparator\tTab\nX_Columns\tOne\n***End_of_Header***\n\nChannels\t2\nSamples\t20\t20\n"
       "Y_Unit_Label\tVolts\tMicrons\nX_Dimension\tTime\tTime\nX0\t0.0\t0.0\nDelta_X\t0.001\t0.001\n"
       "***End_of_Header***\nX_Value\tDrive\tPosition\tComment\n" + ROWS.replace(",", "\t"))
TABLES = [
    CSV.decode(),
    "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-2e-2,1e-3\n"
    + "".join(f"{k},{line.partition(',')[2]},\n" for k, line in enumerate(ROWS.split("\n")[:-1])),
    "CH1(V),CH2(V),t0 = -2e-2, tInc = 1e-3,\n"
    + "".join(f"{line.partition(',')[2]},,\n" for line in ROWS.split("\n")[:-1]),
    "x-axis,1,2\nsecond,Volt,Volt\n" + ROWS,
    "Model,M\nHorizontal Units,s\nSample Interval,1e-3\nVertical Units,V,V\n\nTIME,CH1,CH2\n" + ROWS,
    "Time (s)  Drive Voltage (V)  Disp (um)\n" + ROWS.replace(",", "  "),
    LVM, LVM.replace(".", ","),
    "Zeit;Spannung;Weg [µm]\n" + ROWS.replace(",", ";").replace(".", ","),
]
SPECS = st.none() | st.sampled_from(["0", "1", "2", "3", "CH1", "CH2:0.25", "1:mV", "2:nm", "x", "1:1e300", "1:nan",
                                      ""])
ROW = st.none() | st.integers(-30, 30)
REQUESTS = st.builds(
    lambda time, command, displacement, rate, rows, resample, gain, purpose: Request(
        columns={key: spec for key, spec in (("time", time), ("command", command), ("displacement", displacement))
                 if spec is not None},
        rate_hz=rate, rows=rows, resample_hz=resample, command_gain=gain, purpose=purpose),
    SPECS, SPECS, SPECS, st.none() | st.sampled_from([1000.0, 1.0, 1e-300, 1e300, math.nan]),
    st.builds(slice, ROW, ROW), st.none() | st.sampled_from([1000.0, 900.0, 1e-7, 5e3, 1e308]),
    st.sampled_from([1.0, 15.0, 1e300, 0.0, math.nan]),
    st.sampled_from(list(importer.PURPOSES)))


def test_foreign_tables(fuzzed: Callable, tmp_path: Path) -> None:
    path = tmp_path / "run.txt"

    def check(data: bytes, request: Request) -> None:
        path.write_bytes(data)
        found = refuses(path, lambda: import_recording(str(path), request))
        if found is not None:
            sound(found[0])
            write_recording(tmp_path / "out.csv", found[0].columns, found[0].metadata)

    words = (b"***End_of_Header***", b"X_Value", b"Volt", b"(ms)", b"Sequence", b"Increment", b"=", b"t0 =", b"Unit",
             b"\n#\n", b"\n%% \n", b"\n##:\n", b"\n\n")
    good = st.one_of([damaged(table.encode(encoding), *PIECES, *words)
                      for table in TABLES for encoding in ("utf-8", "utf-16")])
    fuzzed(check, 250, data=good | TEXT | st.binary(max_size=200), request=REQUESTS)


# --- arrays ---------------------------------------------------------------------------------------------------------

def matlab(**options: Any) -> bytes:
    stream = io.BytesIO()
    scipy.io.savemat(stream, {"t": RUN["time_s"], "u": RUN["command_V"], "fs": 1000.0, "text": "x",
                              "run": {"z": RUN["displacement_um"], "cells": np.array([1, "a", RUN["time_s"]], object)}},
                     **options)
    return stream.getvalue()


def numpy_file(save: Callable[..., None], *arrays: np.ndarray, **named: np.ndarray) -> bytes:
    stream = io.BytesIO()
    save(stream, *arrays, **named)
    return stream.getvalue()


FILES = {
    "5.mat": matlab(), "5z.mat": matlab(do_compression=True), "4.mat": numpy_file(
        lambda stream, **named: scipy.io.savemat(stream, named, format="4"), t=RUN["time_s"], u=RUN["command_V"]),
    "a.npy": numpy_file(np.save, np.column_stack(list(RUN.values()))),
    "fields.npy": numpy_file(np.save, np.rec.fromarrays(list(RUN.values()), names="t,voltage,position")),
    "a.npz": numpy_file(np.savez, t=RUN["time_s"], u=RUN["command_V"], z=RUN["displacement_um"]),
    "z.npz": numpy_file(np.savez_compressed, t=RUN["time_s"], u=RUN["command_V"], z=RUN["displacement_um"]),
}


@pytest.mark.parametrize("name", FILES)
def test_files_of_arrays(name: str, fuzzed: Callable, tmp_path: Path) -> None:
    """Each example is a process, so that there are few."""
    path = tmp_path / name

    def check(data: bytes, request: Request) -> None:
        path.write_bytes(data)
        found = refuses(path, lambda: import_recording(str(path), request))
        if found is not None:
            sound(found[0])

    fuzzed(check, 2, data=damaged(FILES[name]), request=REQUESTS)


def test_what_comes_out_of_files_of_arrays(fuzzed: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Any arrays, under any names."""
    path = tmp_path / "run.mat"
    path.touch()
    shapes = arrays_of.array_shapes(min_dims=0, max_dims=3, max_side=24)
    kinds = st.one_of(arrays_of.floating_dtypes(), arrays_of.integer_dtypes(), arrays_of.unsigned_integer_dtypes(),
                      arrays_of.boolean_dtypes())
    some = kinds.flatmap(lambda kind: arrays_of.arrays(kind, shapes | st.just((COUNT,)))).filter(lambda a: a.size)
    names = st.text(max_size=8) | st.sampled_from(["t", "u", "z", "fs", "dt", "run.x", "pos_nm", "pos [um]", ""])

    def check(arrays: list[tuple[str, np.ndarray]], request: Request) -> None:
        monkeypatch.setattr(sources, "read_arrays", lambda data: arrays)
        found = refuses(path, lambda: import_recording(str(path), request))
        if found is not None:
            sound(found[0])

    run = [(name, values) for name, values in RUN.items()]
    fuzzed(check, 100, request=REQUESTS, arrays=st.lists(st.tuples(names, some) | st.sampled_from(run), max_size=5))


# --- models ---------------------------------------------------------------------------------------------------------

VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5)
    | st.sampled_from([0, 0.0, -1, 1e308, 10**400, 1e-320, "displacement", "fit"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4), max_leaves=6)


def test_models(fuzzed: Callable, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    write_model(path, random_model(1, plays=2, deadzones=1))
    document, text = json.loads(path.read_text()), path.read_bytes()
    document["effects"] = [{"name": "delay", "stage": "sensor", "origin": "gap", "parameters":
                            {"delay_s": {"value": 1e-3, "ci95": [1e-3, 2e-3], "unit": "s"}}}]
    places = list(keys(document))

    def changed(edits: list[tuple[tuple[Any, ...], Any]]) -> bytes:
        changed = copy.deepcopy(document)
        for (*parents, last), value in edits:
            holder = changed
            for key in parents:
                holder = holder.get(key) if isinstance(holder, dict) else None
            if isinstance(holder, dict):
                holder[last] = value
        return json.dumps(changed).encode()

    def check(data: bytes) -> None:
        path.write_bytes(data)
        model = refuses(path, lambda: read_model(path))
        if model is not None:
            assert model.digest() and json.dumps(model.to_json(), allow_nan=True)
            refuses(path, lambda: header.render(model, source=str(path)))

    edits = st.lists(st.tuples(st.sampled_from(places), VALUES), max_size=3)
    fuzzed(check, 150, data=edits.map(changed)
           | damaged(text, b"1e999", b"NaN", b"{", b"[", b'"', b"-", b"0", b"\\ud800"))


def keys(value: Any, where: tuple[Any, ...] = ()) -> Iterable[tuple[Any, ...]]:
    """The place of every value in a document, lists taken whole."""
    for key, inner in value.items():
        yield (*where, key)
        if isinstance(inner, dict):
            yield from keys(inner, (*where, key))
