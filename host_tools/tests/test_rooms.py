"""The rooms of the package: imports run down the list only, and through what a room exports.

Run as a program it prints which room imports which.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path

import pytest

import rdpi

PACKAGE = Path(rdpi.__file__).parent
ROOMS = "cli", "gap", "identify", "board", "simulate", "firmware", "model", "data"  # a room imports those to its right
COMMON = {"rdpi", "rdpi.errors", "rdpi.__main__"}  # what any room may import
MOST_BOXES = 12
MODULES = {".".join(("rdpi", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): path
           for path in PACKAGE.rglob("*.py")}


def imported(name: str, source: str, is_package: bool) -> Iterator[str]:
    """Absolute names that a module of the package imports from it: "rdpi.data.Recording"."""
    package = name.split(".") if is_package else name.split(".")[:-1]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] == "rdpi")
        elif isinstance(node, ast.ImportFrom):
            base = package[:len(package) + 1 - node.level] if node.level else []
            origin = ".".join([*base, *filter(None, [node.module])])
            if origin.split(".")[0] == "rdpi":
                yield from (f"{origin}.{alias.name}" for alias in node.names)


def wrong(name: str, target: str) -> str | None:
    """What is wrong with a module's import of a name; None: nothing."""
    here, parts = (name.split(".") + [""])[1], target.split(".")
    if target.rpartition(".")[0] in COMMON and (target in COMMON or parts[1] not in ROOMS):
        return None
    there = parts[1]
    if there == here or (name, there) == ("rdpi", "api"):  # whose names the package has too
        return None
    if here in ROOMS and ROOMS.index(there) <= ROOMS.index(here):
        return "runs up"
    door = importlib.import_module(target.rpartition(".")[0] if len(parts) > 2 else target)
    if not hasattr(door, "__path__"):
        return "reaches into a room"
    if len(parts) > 2 and parts[-1] not in door.__all__:
        return "is not exported"
    return None


@pytest.mark.parametrize("name", sorted(MODULES))
def test_imports_run_down_and_through_doors(name: str) -> None:
    path = MODULES[name]
    found = {target: complaint for target in imported(name, path.read_text("utf-8"), path.name == "__init__.py")
             if (complaint := wrong(name, target))}
    assert not found


@pytest.mark.parametrize(("name", "source", "complaint"), [
    ("rdpi.data.recording", "from ..model import Model", "runs up"),
    ("rdpi.gap.selection", "from ..cli import main", "runs up"),
    ("rdpi.gap.selection", "from rdpi.data.recording import Recording", "reaches into a room"),
    ("rdpi.identify.identify", "from ..data import recording", "is not exported"),
    ("rdpi.identify.identify", "from ..data import Recording\nfrom ..errors import BadInput\nfrom . import passport", None)])
def test_what_imports_may_not_do(name: str, source: str, complaint: str | None) -> None:
    assert [wrong(name, target) for target in imported(name, source, False)][0] == complaint


def test_boxes_at_the_top() -> None:
    boxes = {path.name for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert len(boxes) <= MOST_BOXES and {*ROOMS} <= boxes


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_says_what_is_in_it(room: str) -> None:
    door = importlib.import_module(f"rdpi.{room}")
    assert door.__doc__ and all(hasattr(door, name) for name in door.__all__)


if __name__ == "__main__":
    for room in ROOMS:
        modules = {name: path for name, path in MODULES.items() if name.split(".")[1:2] == [room]}
        below = {target.split(".")[1] for name, path in modules.items()
                 for target in imported(name, path.read_text("utf-8"), path.name == "__init__.py")} & {*ROOMS} - {room}
        print(f"{room:9} {len(modules):2} modules -> {', '.join(sorted(below, key=ROOMS.index)) or 'none'}")
