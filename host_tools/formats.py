#!/usr/bin/env python3
"""Writes the JSON schemas that the package holds, and formats.md, from the dataclasses of the documents.

    .venv/bin/python host_tools/formats.py
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, NamedTuple

from rdpi.identify import FitDocument
from rdpi.gap import GapDocument
from rdpi.model import Document, Model, schema

HOST_TOOLS = Path(__file__).resolve().parent
TABLES = HOST_TOOLS / "formats.md"
INTRODUCTION = """\
<!-- Written by host_tools/formats.py. Do not edit: change the dataclasses and run it again. -->
# File formats

This page describes the JSON documents of rdpi. A recording is a CSV file, which the [README](README.md)
describes.

* Every document has a JSON schema (draft 2020-12). The Python package holds the schemas, in the places named below.
* A reader accepts keys that it does not know. When rdpi reads a model and writes it again, it keeps them.
* A key that is marked *optional* may be missing. `null` means that the value is not known or does not apply.
* Each number has the unit that the table gives. A number without a unit is a ratio or a count.
"""


class Format(NamedTuple):
    """A document of the package."""

    kind: type[Document]
    path: str  # of its schema, in host_tools
    title: str
    about: str


FORMATS = (
    Format(Model, "rdpi/model/schemas/rdpi-model-1.json", "Model file",
           "`rdpi fit -o MODEL.json` writes it, and `rdpi gap -o IMPROVED.json` with the effects that were found. "
           "Reading refuses every model that the firmware would refuse; the schema alone does not."),
    Format(FitDocument, "rdpi/identify/schemas/rdpi-fit-1.json", "Fit document",
           "`rdpi fit --json FILE` writes it, and `rdpi fit --report DIR` as `fit.json`."),
    Format(GapDocument, "rdpi/gap/schemas/rdpi-gap-1.json", "Gap document",
           "`rdpi gap --json FILE` writes it, and `rdpi gap --report DIR` as `gap.json`."))
WORDS = {"number": ("number", "numbers"), "integer": ("whole number", "whole numbers"), "string": ("text", "texts"),
         "boolean": ("true or false", "true or false"), "null": ("null", "null"), "object": ("object", "objects")}


def files() -> dict[Path, str]:
    """Text of every file that this script writes."""
    schemas = {one: schema(one.kind, one.title) for one in FORMATS}
    found = {HOST_TOOLS / one.path: json.dumps(written, indent=1, ensure_ascii=False) + "\n"
             for one, written in schemas.items()}
    return found | {TABLES: _tables(schemas)}


def _tables(schemas: dict[Format, dict[str, Any]]) -> str:
    """A section for each document and, where it first occurs, each of its sections."""
    lines, told = [INTRODUCTION], set()
    for one, whole in schemas.items():
        lines += [f"## {one.title}\n", f"{whole['description']} {one.about}\n",
                  f"Schema: [`{one.path}`]({one.path})\n", *_table(whole)]
        sections = [name for name in _order(whole, whole.get("$defs", {})) if name not in told]
        for name in sections:
            lines += [f"### {_heading(name)}\n", f"{whole['$defs'][name]['description']}\n",
                      *_table(whole["$defs"][name])]
        told.update(sections)
    return "\n".join(lines).rstrip("\n") + "\n"


def _order(part: Any, sections: dict[str, Any], found: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Names of the sections, each after the one that first holds it."""
    for name in re.findall(r"#/\$defs/(\w+)", json.dumps({**part, "$defs": None})):
        if name not in found:
            found = _order(sections[name], sections, (*found, name))
    return found


def _table(part: dict[str, Any]) -> list[str]:
    rows = ["| key | type | unit | meaning |", "| --- | --- | --- | --- |"]
    for name, about in part["properties"].items():
        kind = _type(about) + ("" if name in part["required"] else ", *optional*")
        rows.append(f"| `{name}` | {kind} | {about.get('unit', '')} | {about['description']} |")
    return [*rows, ""]


def _type(about: dict[str, Any], several: bool = False) -> str:
    """In words: "list of numbers or null"."""
    if "$ref" in about:
        heading = _heading(about["$ref"].rpartition("/")[2])
        return f"[{heading}](#{heading.lower().replace(' ', '-')})"
    if "const" in about:
        return f'"{about["const"]}"'
    if "enum" in about:
        return ", ".join(f'"{value}"' for value in about["enum"])
    if "anyOf" in about:
        return " or ".join(_type(one, several) for one in about["anyOf"])
    if isinstance(about.get("type"), list):
        return " or ".join(_type({**about, "type": one}, several) for one in about["type"])
    if about.get("type") == "array":
        length = f"{about['minItems']} " if "minItems" in about else ""
        return f"{'lists' if several else 'list'} of {length}{_type(about['items'], True)}"
    if "additionalProperties" in about:
        return f"object of {_type(about['additionalProperties'], True)} by name"
    return WORDS[about["type"]][several] if about.get("type") else "anything"


def _heading(name: str) -> str:
    """"EffectEntry" as "Effect entry"."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).capitalize()


def main() -> None:
    for path, text in files().items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
        print(path.relative_to(HOST_TOOLS.parent))


if __name__ == "__main__":
    main()
