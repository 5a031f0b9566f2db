#!/usr/bin/env python3
"""Compares the names of the Unity tests that CTest and Ceedling executed; exit status 1 when they differ.

usage: compare_names.py CTEST_JUNIT.xml CEEDLING_REPORT.json
"""

from __future__ import annotations

import json
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

UNITY_LINE = re.compile(r"^(?:.*/)?(test_\w+\.c):\d+:(\w+):(?:PASS|FAIL|IGNORE)", re.MULTILINE)


def names_in_ctest(junit: str) -> set[str]:
    """file:test of every result line that the Unity programs printed."""
    output = "\n".join(element.text or "" for element in ElementTree.fromstring(junit).iter("system-out"))
    return {f"{file}:{test}" for file, test in UNITY_LINE.findall(output)}


def names_in_ceedling(report: str) -> set[str]:
    """file:test of every entry of Ceedling's JSON report."""
    results = json.loads(report)
    entries = results["PassedTests"] + results["FailedTests"] + results["IgnoredTests"]
    return {f"{Path(entry['file']).name}:{entry['test']}" for entry in entries}


def compare(junit: str, report: str) -> list[str]:
    """One line for each difference; none when both executed the same tests, at least one."""
    ctest, ceedling = names_in_ctest(junit), names_in_ceedling(report)
    if not ctest and not ceedling:
        return ["neither runner executed a test"]
    return [f"only CTest executed {name}" for name in sorted(ctest - ceedling)] + [
        f"only Ceedling executed {name}" for name in sorted(ceedling - ctest)
    ]


if __name__ == "__main__":
    absent = [name for name in sys.argv[1:3] if not Path(name).is_file()]
    if absent or len(sys.argv) != 3:
        sys.exit(f"no such report, so its runner did not get that far: {', '.join(absent)}" if absent else __doc__)
    texts = [Path(name).read_text() for name in sys.argv[1:3]]
    differences = compare(*texts)
    print(*(differences or [f"both runners executed the same {len(names_in_ctest(texts[0]))} tests"]), sep="\n")
    sys.exit(1 if differences else 0)
