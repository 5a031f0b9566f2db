"""Tuned numbers: each one says its unit, what it means and where it comes from, and is read when it is used."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import rdpi.identify.thresholds
import rdpi.gap.thresholds
from rdpi.identify.regression import prior

ROOMS = [rdpi.identify.thresholds, rdpi.gap.thresholds]


def names(thresholds: ModuleType) -> list[str]:
    return [name for name in vars(thresholds) if name.isupper()]


@pytest.mark.parametrize("thresholds", ROOMS, ids=lambda module: module.__name__)
def test_each_says_unit_meaning_and_source(thresholds: ModuleType) -> None:
    sources = set(re.findall(r"^  (\w+)  +\w", thresholds.__doc__, flags=re.M))
    lines = re.findall(r"^([A-Z_]+) = [^#]+  # \[([^\]]+)\] (.+); (\w+)$", Path(thresholds.__file__).read_text("utf-8"),
                       flags=re.M)
    assert [line[0] for line in lines] == names(thresholds) and {line[3] for line in lines} == sources
    assert all(len(meaning.split()) > 2 for _, _, meaning, _ in lines)


@pytest.mark.parametrize("thresholds", ROOMS, ids=lambda module: module.__name__)
def test_each_is_read_when_it_is_used(thresholds: ModuleType) -> None:
    """As an attribute of its module inside a function, not bound when a module or a function is made."""
    used = set()
    for path in Path(thresholds.__file__).parent.glob("*.py"):
        tree = ast.parse(path.read_text("utf-8"))
        bodies = [part for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) for part in node.body]
        inside = {id(node) for part in bodies for node in ast.walk(part)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("thresholds", "tuned"):
                assert id(node) in inside, f"{path.name}, line {node.lineno}: {node.attr} is bound early"
                used.add(node.attr)
            if isinstance(node, ast.ImportFrom) and (node.module or "").endswith("thresholds"):
                raise AssertionError(f"{path.name}, line {node.lineno}: bound early")
    assert used == set(names(thresholds))


@pytest.mark.parametrize("name", ["PRIOR_BEND", "PRIOR_RATE_BEND", "PRIOR_RATE", "PRIOR_SATURATION"])
def test_the_prior_that_is_kept_follows_its_weights(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = np.linalg.norm(prior(5, 10, 2)[0])
    monkeypatch.setattr(rdpi.identify.thresholds, name, 2 * getattr(rdpi.identify.thresholds, name))
    assert np.linalg.norm(prior(5, 10, 2)[0]) > before
