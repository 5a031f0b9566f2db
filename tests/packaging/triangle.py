"""The triangle that every way of taking the library in has to follow, and the codes that the host tools compute for it."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PARAMS = ROOT / "examples/track/params"
HERE = Path(__file__).resolve().parent
TIMES_s = np.arange(400) / 1000
HEIGHTS = 160 - np.abs(np.arange(400) % 320 - 160)


def references_um(engine: str, params: Path = PARAMS) -> np.ndarray:
    """As firmware makes them: in single precision, or whole numbers of the unit of fixed point."""
    if engine == "f32":
        return (np.float32(0.05) * HEIGHTS.astype(np.float32)).astype(float)
    header = (params / "rdpi_params.h").read_text()
    um_per_unit = float(re.search(r"Q31_UM\(reference\) \(\(double\)\(reference\) \* \((\S+)\)", header)[1])
    found = re.search(r"\(\(int32_t\)\(\(\(double\)\(um\) - \((\S+)\)\) \* \((\S+)\)", header)
    offset_um, per_um = float(found[1]), float(found[2])
    return (round(-offset_um * per_um) + round(0.05 * per_um) * HEIGHTS) * um_per_unit + offset_um


def host_codes(engine: str, work: Path, command: tuple[str, ...] = (sys.executable, "-m", "rdpi"), params: Path = PARAMS,
               **options: object) -> list[int]:
    """The codes by `rdpi compensate`; work: a directory for its files; params: that of model and header."""
    work.mkdir(parents=True, exist_ok=True)
    reference, drive = work / "reference.csv", work / "drive.csv"
    rows = (f"{time_s!r},{um!r}" for time_s, um in zip(TIMES_s.tolist(), references_um(engine, params).tolist()))
    reference.write_text("\n".join(["time_s,reference_um", *rows, ""]))
    subprocess.run([*command, "compensate", params / "model.json", reference, "-o", drive, "--engine", engine],
                   check=True, capture_output=True, **options)
    with drive.open() as file:
        return [int(row["dac_code"]) for row in csv.DictReader(line for line in file if not line.startswith("#"))]


def run(*command: object, **options: object) -> str:
    """What a program prints; its errors are the test's."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **options)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def codes_of(program: Path) -> dict[str, list[int]]:
    rows = [line.split() for line in run(program).splitlines()]
    return {"f32": [int(row[0]) for row in rows], "q31": [int(row[1]) for row in rows]}
