"""Cases on the measured stack of ../shared/data/picma_p885: effects of sensor and environment, put into its readings.

What happens after the actuator can be put into a measured record exactly, and nothing about the actuator is made up. In
two more cases a part of the model is left out instead. The record has one frequency, 1 Hz, at 200 samples per second:
what needs other rates cannot be asked. What is fitted, diagnosed and predicted are different rows.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from cases import Case, pooled, rdpi, residual_rms, write
from rdpi.data import Recording, read_recording
from rdpi.model import read_model

DATA = Path(os.environ.get("RDPI_DATA", Path(__file__).resolve().parents[3] / "shared/data/picma_p885")).resolve()
PARTS = {  # file and rows
    "sine-1": ("Model_Vi_Do.dat", "400:4400"), "sine-2": ("Model_Vi_Do.dat", "4400:8000"),
    "loops-1": ("Test_Vi_Do_Di.dat", "200:3700"), "loops-2": ("Test_Vi_Do_Di.dat", "3700:7350"),
    "path-1": ("Test_Vi_Do_Di.dat", "7450:10800"), "path-2": ("Test_Vi_Do_Di.dat", "10800:14100"),
}
FITTED = "sine-1", "loops-1"
DIRECTIONS = ((("sine-2", "loops-2"), ("path-1", "path-2")), (("path-1", "path-2"), ("sine-2", "loops-2")))
SIZES: dict[str, tuple[float, float, float]] = {
    "delay": (0.002, 0.005, 0.015),  # s
    "periodic_disturbance": (0.1, 0.3, 1.0),  # um
    "gain_change": (0.01, 0.03, 0.06),  # share
    "quantisation": (9, 8, 6),  # bits over 64 um
    "thermal_drift": (0.3, 1.0, 3.0),  # um from end to end
    "static_nonlinearity": (0.005, 0.015, 0.04),  # cubic, share of the stroke
}
STROKE_UM, MIDDLE_UM, HUM_HZ = 45.0, -96.0, 37.3
LEVELS = "small", "middle", "large"


def put(name: str, size: float, run: Recording, random: np.random.Generator) -> np.ndarray:
    """The displacement as the sensor would read it with the effect."""
    z, t = run.displacement_um, run.time_s - run.time_s[0]
    if name == "delay":
        return np.interp(t - size, t, z)
    if name == "periodic_disturbance":
        return z + size * np.sin(2 * np.pi * (HUM_HZ * t + random.random()))
    if name == "gain_change":
        return MIDDLE_UM + (1 + size) * (z - MIDDLE_UM)
    if name == "quantisation":
        step = 64 / 2**size
        return step * np.round(z / step)
    if name == "thermal_drift":
        return z + random.choice([-1, 1]) * size * -np.expm1(-t / t[-1]) / -np.expm1(-1)
    x = 2 * (z - np.mean(z)) / STROKE_UM
    return z + size * STROKE_UM * (5 * x**3 - 3 * x) / 2


def generate(folder: Path, seed: int) -> list[Case]:
    """Files and labels of all cases. Raises SystemExit where the data are not."""
    if not DATA.is_dir():
        raise SystemExit(f"measured data not found in {DATA}; set RDPI_DATA to its folder")
    random = np.random.default_rng([seed, 3])
    parts = {name: _part(folder, name) for name in PARTS}
    model = _model(folder, "whole", parts)
    bent = _model(folder, "bent", parts, "--deadzones", "0")
    cases: list[Case] = []

    def add(direction: int, names: tuple[str, ...], level: str, change: Callable[[Recording], Recording],
            use: Path = model) -> None:
        now, later = ([parts[name] for name in names] for names in DIRECTIONS[direction])
        changed, ident = [change(run) for run in now], random.bytes(6).hex()
        floor = residual_rms(read_model(model), now)
        moved = pooled([a.displacement_um - b.displacement_um for a, b in zip(changed, now)]) / floor
        grew = residual_rms(read_model(use), changed) / floor
        if names and not moved:  # left out of the model, not put into the data
            moved = float(np.sqrt(max(0.0, grew**2 - 1)))
        where = folder / "cases" / ident
        write(where, "run", changed)
        write(where, "later", [change(run) for run in later])
        (where / "task.json").write_text(json.dumps({"model": os.path.relpath(use, where), "without": []}))
        cases.append(Case("measured" if names else "none", names, round(moved, 1), direction, ident=ident, kind=level,
                          reached=moved, growth=grew, floor_um=floor, samples=sum(map(len, changed))))

    for direction in range(len(DIRECTIONS)):
        add(direction, (), "", lambda run: run)
        add(direction, ("static_nonlinearity",), "left out", lambda run: run, use=bent)
        add(direction, ("initial_memory",), "left out",
            lambda run: Recording(run.path, run.metadata | {"memory": "reset"}, run.columns))
        for name, sizes in SIZES.items():
            for level, size in zip(LEVELS, sizes):
                add(direction, (name,), level, lambda run: Recording(run.path, run.metadata, {
                    **run.columns, "displacement_um": put(name, size, run, random)}))
    return cases


def _part(folder: Path, name: str) -> Recording:
    source, rows = PARTS[name]
    path = folder / "models" / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    if rdpi("import", str(DATA / source), "--command", "0", "--displacement", "4", "--rate", "200", "--rows", rows,
            "-o", str(path)):
        raise SystemExit(f"{DATA / source}: rdpi import refuses it")
    return read_recording(path)


def _model(folder: Path, name: str, parts: dict[str, Recording], *options: str) -> Path:
    path = folder / "models" / f"{name}.json"
    if rdpi("fit", *(parts[part].path for part in FITTED), "-o", str(path), *options):
        raise SystemExit(f"{path}: rdpi fit refuses the recordings")
    return path
