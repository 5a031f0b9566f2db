#!/usr/bin/env python3
"""Line coverage of a target built with --coverage, from gcov; exit status 1 below the minimum."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("objects", type=Path, help="folder of the target's object files")
    parser.add_argument("--minimum", type=float, required=True, help="per cent of lines")
    arguments = parser.parse_args()

    notes = sorted(arguments.objects.rglob("*.gcno"))  # not .gcda: a file that no test ran counts too
    if not notes:
        sys.exit(f"coverage: no .gcno below {arguments.objects}: not built with --coverage")
    lines: dict[str, dict[int, int]] = {}
    output = subprocess.run(
        ["gcov", "--json-format", "--stdout", *map(str, notes)], check=True, capture_output=True, text=True
    ).stdout
    for document in output.splitlines():
        for file in json.loads(document)["files"]:
            counts = lines.setdefault(file["file"], {})
            for line in file["lines"]:
                number = line["line_number"]
                counts[number] = counts.get(number, 0) + line["count"]

    total = covered = 0
    for name, counts in sorted(lines.items()):
        missed = sorted(number for number, count in counts.items() if count == 0)
        total += len(counts)
        covered += len(counts) - len(missed)
        print(f"{name}: {len(counts) - len(missed)}/{len(counts)}", *(["missed", *missed] if missed else []))
    percent = 100 * covered / total
    print(f"{percent:.1f} % of {total} lines, minimum {arguments.minimum:g} %")
    return 0 if percent >= arguments.minimum else 1


if __name__ == "__main__":
    sys.exit(main())
