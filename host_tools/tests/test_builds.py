"""What a model asks of the firmware's build, and the flags that the firmware sets."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT
from models import random_model

from rdpi.firmware import FLAGS, build_notes, build_options, builds, flag_counts

TYPES_H = (ROOT / "lib" / "include" / "rdpi" / "types.h").read_text()


def test_flags_are_those_of_the_library() -> None:
    found = {name.lower(): int(bit) for name, bit in re.findall(r"RDPI_FLAG_(\w+) = (\d+)u", TYPES_H)}
    assert len(found) == 6 and found == FLAGS


def test_flags_are_counted() -> None:
    counts = flag_counts(np.array([0, 1, 3, 16, 31, 32, 0x100], np.uint32))
    assert counts == {"guard": 3, "range": 2, "slew": 1, "input": 1, "missed": 2, "lead": 1}
    assert all(type(count) is int for count in counts.values())
    assert flag_counts(np.zeros(0, np.uint32)) == dict.fromkeys(FLAGS, 0)


def test_defaults_are_those_of_the_library() -> None:
    found = re.findall(r"#define (RDPI_MAX_(?:PLAYS|DEADZONES|WINDOW|POLES)) (\d+)", TYPES_H)
    assert len(found) == 4 and {name: int(size) for name, size in found} == builds.DEFAULTS


@pytest.mark.parametrize(("plays", "deadzones", "rate_hz", "options"), [
    (15, 7, None, {}), (16, 7, None, {"RDPI_MAX_PLAYS": 17}), (15, 8, None, {"RDPI_MAX_DEADZONES": 9}),
    (15, 7, 1500, {}), (15, 7, 1501, {"RDPI_MAX_WINDOW": 17}),
    (40, 20, 10_000, {"RDPI_MAX_PLAYS": 41, "RDPI_MAX_DEADZONES": 21, "RDPI_MAX_WINDOW": 101})])
def test_macros_that_a_model_needs(plays: int, deadzones: int, rate_hz: float | None, options: dict) -> None:
    model = random_model(1, plays=plays, deadzones=deadzones)
    model.rate.window_s = 0.01
    assert build_options(model, rate_hz) == options


def test_notes() -> None:
    model = random_model(1)
    model.rate.window_s = 0.0
    assert build_notes(model) == []
    model.rate.window_s = 0.004
    (window,) = build_notes(model)
    assert "0.004 s" in window and "-DRDPI_MAX_WINDOW=" in window
    large = random_model(1, plays=20, deadzones=10)
    assert [re.search(r"-D\S+", note)[0] for note in build_notes(large)] == [
        "-DRDPI_MAX_PLAYS=21", "-DRDPI_MAX_DEADZONES=11", "-DRDPI_MAX_WINDOW=..."]


def test_a_note_of_a_slow_sweep() -> None:
    model = random_model(1)
    model.rate.window_s = 0.0
    model.drive = replace(model.drive, sweep_V_per_s=model.drive.max_V - model.drive.min_V)
    assert model.shortest_sample_s() < 1e-6 and build_notes(model) == []
    model.drive.sweep_V_per_s /= 1000
    (note,) = build_notes(model)
    assert f"{1 / model.shortest_sample_s():.3g} samples per second" in note and "rdpi_f32_init" in note
