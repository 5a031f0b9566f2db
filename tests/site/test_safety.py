"""lib/SAFETY.md names tests that exist, for both number types where it says so, and every requirement has one."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "lib/SAFETY.md").read_text(encoding="utf-8")
REQUIREMENT = re.compile(r"^\| (R\d+) \| (.+) \| (\w+) \| (.*) \|$", re.MULTILINE)
REQUIREMENTS = REQUIREMENT.findall(TEXT)
C_TEST = re.compile(r"^void (test_\w+)\(void\)", re.MULTILINE)
PYTHON_TEST = re.compile(r"^def (test_\w+)\(", re.MULTILINE)


@cache
def files_of() -> dict[str, set[str]]:
    """The files of every test, by its name."""
    found: dict[str, set[str]] = {}
    for pattern, files in ((C_TEST, (ROOT / "tests/unit").glob("*.c")),
                           (PYTHON_TEST, [*ROOT.glob("tests/*/test_*.py"), *ROOT.glob("host_tools/tests/test_*.py")])):
        for path in files:
            for name in pattern.findall(path.read_text(encoding="utf-8")):
                found.setdefault(name, set()).add(path.name)
    return found


def named(text: str) -> list[str]:
    return re.findall(r"`(test_\w+)`", text)


def wrong_with(number: str, kind: str, held_by: str) -> list[str]:
    names = named(held_by)
    wrong = [f"{number}: there is no {name}" for name in names if name not in files_of()]
    files = {file for name in names for file in files_of().get(name, ())}
    if not names:
        wrong.append(f"{number} has no test")
    elif kind == "both":
        wrong += [f"{number} has no test of {sibling}" for sibling in ("f32", "q31")
                  if not any(f"_{sibling}_" in file for file in files)]
    elif kind not in ("port", "build"):
        wrong.append(f"{number} is for {kind}")
    return wrong


@pytest.mark.parametrize("number, requirement, kind, held_by", REQUIREMENTS, ids=lambda text: text if text[:1] == "R" else "")
def test_every_requirement_is_held_by_tests(number: str, requirement: str, kind: str, held_by: str) -> None:
    assert wrong_with(number, kind, held_by) == []


def test_requirements_are_numbered() -> None:
    assert [number for number, *_ in REQUIREMENTS] == [f"R{k}" for k in range(1, len(REQUIREMENTS) + 1)]
    assert len(REQUIREMENTS) == len(re.findall(r"^\| R\d", TEXT, re.MULTILINE)) > 20


def test_no_test_is_named_elsewhere_that_does_not_exist() -> None:
    assert [name for name in named(TEXT) if name not in files_of()] == []


def test_a_requirement_without_tests_is_seen() -> None:
    assert wrong_with("R1", "both", "") == ["R1 has no test"]
    assert wrong_with("R1", "both", "`test_nothing_at_all`") == [
        "R1: there is no test_nothing_at_all", "R1 has no test of f32", "R1 has no test of q31"]
    assert wrong_with("R1", "both", "`test_init_refuses_sample_time_zero`") == ["R1 has no test of f32"]


def test_every_status_flag_and_macro_exists() -> None:
    headers = "\n".join(path.read_text(encoding="utf-8") for path in [*(ROOT / "lib/include/rdpi").glob("*.h"),
                                                                      *(ROOT / "port/include").glob("*.h"),
                                                                      ROOT / "examples/track/params/rdpi_params.h",
                                                                      ROOT / "examples/track/CMakeLists.txt",
                                                                      ROOT / "CMakeLists.txt", ROOT / "port/CMakeLists.txt"]
                        if path.exists())
    assert [name for name in re.findall(r"`(RDPI_[A-Z0-9_]+)`", TEXT) if not re.search(rf"\b{name}\b", headers)] == []
