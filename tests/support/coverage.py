#!/usr/bin/env python3
"""Line and branch coverage of a library that was built with --coverage, from gcov; exit status 1 unless both are full.

Counts are merged over every program that contains a line: functions in headers are compiled into many. A line that no
test can reach is excluded by a comment at its end, `coverage-exclusion 1: why`, numbered from 1 on over the whole
library; all are listed, and one that excludes nothing is an error.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path

EXCLUSION = re.compile(r"coverage-exclusion (\d+): (.*?)\s*(?:\*/|$)")
INLINE = re.compile(r"^static inline [^;=]*?(\w+)\(", re.MULTILINE)


class Counts:
    """How often the lines and branches of one file were taken."""

    def __init__(self) -> None:
        self.lines: Counter[int] = Counter()
        self.branches: Counter[tuple[int, str, int]] = Counter()  # line, function, which of its branches
        self.functions: set[str] = set()

    def add(self, file: dict) -> None:
        self.functions.update(function["name"] for function in file["functions"])
        for line in file["lines"]:
            number = line["line_number"]
            self.lines[number] += line["count"]
            for which, branch in enumerate(line["branches"]):
                self.branches[number, line.get("function_name", ""), which] += branch["count"]

    def missed(self) -> dict[int, str]:
        """What was never taken: "line", or "branch" of a line that was, by line number."""
        branches = {number: "branch" for (number, _, _), count in self.branches.items() if count == 0}
        return branches | {number: "line" for number, count in self.lines.items() if count == 0}


def measure(objects: Path, library: Path) -> dict[Path, Counts]:
    notes = sorted(objects.rglob("*.gcno"))  # not .gcda: a file that no test ran counts too
    if not notes:
        sys.exit(f"coverage: no .gcno below {objects}: not built with --coverage")
    files: dict[Path, Counts] = defaultdict(Counts)
    output = subprocess.run(
        ["gcov", "--branch-probabilities", "--json-format", "--stdout", *map(str, notes)],
        check=True, capture_output=True, text=True,
    ).stdout
    for document in map(json.loads, output.splitlines()):
        for file in document["files"]:
            path = (Path(document["current_working_directory"]) / file["file"]).resolve()
            if path.is_relative_to(library):
                files[path].add(file)
    return files


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("objects", type=Path, help="folder of the build")
    parser.add_argument("library", type=Path, help="folder of the sources that must be covered")
    arguments = parser.parse_args()
    library = arguments.library.resolve()

    files = measure(arguments.objects, library)
    faults: list[str] = []
    exclusions: dict[int, str] = {}
    lines = lines_missed = branches = branches_missed = 0
    for path in sorted(library.rglob("*.[ch]")):
        name, text, counts = path.relative_to(library), path.read_text(), files.get(path, Counts())
        faults += [f"{name}: no test contains {function}" for function in INLINE.findall(text)
                   if function not in counts.functions]
        if path.suffix == ".c" and not counts.lines:
            faults.append(f"{name}: not compiled with --coverage")
        missed = counts.missed()
        for number, line in enumerate(text.splitlines(), 1):
            if match := EXCLUSION.search(line):
                if int(match[1]) in exclusions:
                    faults.append(f"{name}:{number}: exclusion {match[1]} is another one's number")
                exclusions[int(match[1])] = f"{name}:{number}: {match[2]}"
                if number not in missed:
                    faults.append(f"{name}:{number}: exclusion {match[1]} excludes nothing")
                counts.lines.pop(number, None)
                for key in [key for key in counts.branches if key[0] == number]:
                    del counts.branches[key]
        for kind in "line", "branch":
            if numbers := sorted(number for number, what in counts.missed().items() if what == kind):
                faults.append(f"{name}: {kind} never taken: {' '.join(map(str, numbers))}")
        lines += len(counts.lines)
        lines_missed += sum(count == 0 for count in counts.lines.values())
        branches += len(counts.branches)
        branches_missed += sum(count == 0 for count in counts.branches.values())

    for number, what in sorted(exclusions.items()):
        print(f"exclusion {number}: {what}")
    print(*faults, sep="\n", end="\n" if faults else "")
    for kind, count, left in ("lines", lines, lines_missed), ("branches", branches, branches_missed):
        print(f"{100 * (count - left) / max(count, 1):.1f} % of {count} {kind}")
    return 1 if faults or not lines else 0


if __name__ == "__main__":
    sys.exit(main())
