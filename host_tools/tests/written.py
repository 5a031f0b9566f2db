"""Every model, fit and gap document that rdpi writes while tests run is checked against the schema in the package."""

from __future__ import annotations

import functools
import importlib
import json
import pkgutil
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rdpi
from jsonschema import Draft202012Validator
from rdpi.data import recording

PACKAGE = Path(rdpi.__file__).parent
VALIDATORS = {path.stem.split("-")[1]: Draft202012Validator(json.loads(path.read_text("utf-8")))
              for path in PACKAGE.glob("*/schemas/*.json")}
FOREIGN = "fit", "effects", "passport"  # of a model: kept as they were read, whatever they hold
checked: Counter[str] = Counter()  # documents so far, by kind
_as_read: list[bool] = []


def kind_of(document: Any) -> str | None:
    """"model", "fit", "gap", or None for any other content."""
    if not isinstance(document, dict):
        return None
    if {"rate_slopes", "gate_failed"} <= set(document):
        return "fit"
    return {"rdpi-model/1": "model", "rdpi-gap/1": "gap"}.get(document.get("schema"))


def complaints(document: dict[str, Any]) -> list[str]:
    """What the schema has against a document."""
    return [f"{'.'.join(map(str, error.absolute_path))}: {error.message[:300]}"
            for error in VALIDATORS[kind_of(document)].iter_errors(document)]


def check(data: str | bytes) -> None:
    """Raise AssertionError for a document that its schema refuses; other content is let through."""
    try:
        document = json.loads(data)
    except ValueError:
        return
    kind = kind_of(document)
    if kind is None:
        return
    checked[kind] += 1
    if _as_read:
        document = {key: value for key, value in document.items() if key not in FOREIGN}
    found = complaints(document)
    assert not found, f"the schema of a {kind} document refuses {found}"


@contextmanager
def sections_as_read() -> Iterator[None]:
    """A model may hold sections that rdpi did not write: they are kept, and not checked."""
    _as_read.append(True)
    try:
        yield
    finally:
        _as_read.pop()


def install() -> None:
    """Let every module of rdpi check what it writes."""
    plain = recording.atomic_write
    if hasattr(plain, "checks"):
        return

    @functools.wraps(plain)
    def atomic_write(path: Any, data: str | bytes) -> None:
        check(data)
        plain(path, data)

    atomic_write.checks = True
    for module in modules():
        if getattr(module, "atomic_write", None) is plain:
            module.atomic_write = atomic_write


def modules() -> list[Any]:
    """All of rdpi."""
    names = [one.name for one in pkgutil.walk_packages(rdpi.__path__, "rdpi.") if not one.name.endswith("__main__")]
    return [importlib.import_module(name) for name in names]
