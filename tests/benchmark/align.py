#!/usr/bin/env python3
"""How many virtual scope files `rdpi import --drive` aligns within half a sample, refuses, or aligns wrongly.

    .venv/bin/python tests/benchmark/align.py usual 0 100     # a family of host_tools/tests/scopes.py, and its seeds
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "host_tools" / "tests"))
from scopes import FAMILIES, off_by  # noqa: E402

from rdpi.data.align import align  # noqa: E402
from rdpi.errors import BadInput  # noqa: E402


def main(family: str, begin: int, end: int) -> None:
    count = {"aligned": 0, "refused": 0, "WRONG": 0}
    began_s = time.process_time()
    for seed in range(begin, end):
        file = FAMILIES[family](seed)
        told = f"{seed} {file.drive.metadata['drive']}, noise {file.noise:g}, {file.faster:g} x the drive's rate"
        try:
            found = align(file.run, file.drive, file.first)
        except BadInput as refused:
            end_of, told = "refused", f"{told}: {refused}"
        else:
            error = off_by(found.start_s, found.clock, file)
            end_of = "aligned" if error < 0.5 else "WRONG"
            told += f": off by {error:.3f}, doubt {found.doubt_s * file.drive.sample_rate_hz:.3f}"
        count[end_of] += 1
        print(f"{end_of} {told}")
    print(f"{family}, seeds {begin} to {end - 1}: " + ", ".join(f"{number} {what}" for what, number in count.items())
          + f"; {(time.process_time() - began_s) / (end - begin):.2f} s each")


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:4]))
