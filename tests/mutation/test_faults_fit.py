"""Every fault of mutants.txt can be put in: mutate.py itself, which says whether a test sees it, takes minutes."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import mutate  # noqa: E402


def test_every_fault_can_be_put_in_where_it_says() -> None:
    assert mutate.obstacles(mutate.read_faults()) == []


def test_a_fault_that_cannot_be_put_in_is_reported() -> None:
    line = "low = x_um - r_um;"  # once in f32_play.h
    cases = {
        "nowhere.h: a: there is no such file": mutate.Fault("nowhere.h", "a", line, ""),
        "f32_play.h: b: its text occurs 0 times": mutate.Fault("f32_play.h", "b", "no such line", ""),
        "f32_play.h: c: its text occurs 0 times": mutate.Fault("f32_play.h", "c", "", line),
        "f32_play.h: d: it changes nothing": mutate.Fault("f32_play.h", "d", line, line),
    }
    sound = mutate.Fault("f32_play.h", "e", line, "")
    assert mutate.obstacles([*cases.values(), sound]) == list(cases)
    assert mutate.obstacles([sound, sound]) == ["f32_play.h: e: 2 faults have this name"]
    [several] = mutate.obstacles([mutate.Fault("f32_play.h", "f", "r_um", "")])
    assert several.startswith("f32_play.h: f: its text occurs ") and several != "f32_play.h: f: its text occurs 1 times"
