"""What the program says of commands, options, files and sections of the README exists."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import click
import pytest

from conftest import ROOT
from rdpi.cli import main

PACKAGE = ROOT / "host_tools" / "rdpi"
OPTIONS = {name: {option for parameter in command.params if isinstance(parameter, click.Option)
                  for option in parameter.opts} | {"--help"} for name, command in main.commands.items()}
ELSEWHERE = {"--version", "--preset", "--build", "--target", "--set"}  # of rdpi itself, of CMake, of tests/withheld


def texts() -> Iterator[tuple[str, str]]:
    """Every string that the program can print, formatted parts left out, and where it is."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield f"{path.name}:{node.lineno}", node.value
            elif isinstance(node, ast.JoinedStr):  # pieces that belong together
                yield f"{path.name}:{node.lineno}", "".join(
                    part.value if isinstance(part, ast.Constant) else "…" for part in node.values)
    templates = sorted(PACKAGE.rglob("templates/*"))
    assert len({path.parent for path in templates}) > 1  # of the headers, of the report
    for path in templates:
        yield path.name, path.read_text(encoding="utf-8")


TEXTS = list(texts())


def found(pattern: str) -> list[tuple[str, re.Match[str]]]:
    return [(place, match) for place, text in TEXTS for match in re.finditer(pattern, text)]


def test_sections_of_the_readme() -> None:
    headings = set(re.findall(r"^#+ (.+?)\s*$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE))
    for place, match in found(r"README(?!\.md)(?:, \"([^\"]+)\")?"):
        assert match[1] in headings, f"{place}: names no section of README.md"


def test_commands_and_their_options() -> None:
    mentioned = found(r"`rdpi ([a-z]+)([^`]*)`")
    assert len(mentioned) > 10
    for place, match in mentioned:
        assert match[1] in OPTIONS, f"{place}: no command {match[0]}"
        for option in re.findall(r"--[a-z][\w-]*", match[2]):
            assert option in OPTIONS[match[1]], f"{place}: {match[0]}: no option {option}"


def test_options() -> None:
    everywhere = set().union(*OPTIONS.values())
    for place, match in found(r"(?<![\w-])--[a-zA-Z][\w-]*"):
        if place.endswith((".html.j2", ".js")):
            continue  # variables of style sheets
        assert match[0].rstrip("-") in everywhere | ELSEWHERE, f"{place}: {match[0]} is no option of any command"


@pytest.mark.parametrize("folder", ["lib", "port", "examples", "tests", "host_tools"])
def test_files(folder: str) -> None:
    for place, match in found(rf"(?<![\w/.-]){folder}/[\w./-]*\w"):
        assert (ROOT / match[0]).exists(), f"{place}: there is no {match[0]}"


def test_documents() -> None:
    for place, match in found(r"[\w/-]+\.md\b"):
        assert (ROOT / match[0]).exists(), f"{place}: there is no {match[0]}"
