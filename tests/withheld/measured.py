"""Cases on the measured stack of ../shared/data/picma_p885: one half judges the other.

Twelve cuts of the record into what is fitted and the rest. Of every piece of the rest, `rdpi gap` sees the first half;
what it promises is tried on the second. What happens after the actuator can be put into a measured record exactly, and
nothing about the actuator is made up. `initial_memory`: the recordings say `reset`, which they are not.

The record has one frequency, 1 Hz, at 200 samples per second: what needs other rates cannot be asked.
"""

from __future__ import annotations

import json
import os
from itertools import chain
from pathlib import Path

import numpy as np
from cases import Case, pooled, rdpi, residual_rms, write
from rdpi.data import Recording, read_recording
from rdpi.model import read_model

DATA = Path(os.environ.get("RDPI_DATA", Path(__file__).resolve().parents[3] / "shared/data/picma_p885")).resolve()
PARTS = {  # file and rows
    "sine-1": ("Model_Vi_Do.dat", "400:4200"), "sine-2": ("Model_Vi_Do.dat", "4200:8000"),
    "loops-1": ("Test_Vi_Do_Di.dat", "200:3700"), "loops-2": ("Test_Vi_Do_Di.dat", "3700:7350"),
    "path-1": ("Test_Vi_Do_Di.dat", "7450:10800"), "path-2": ("Test_Vi_Do_Di.dat", "10800:14100"),
}
FITTED = (  # and, in turn, the rest is fitted
    ("sine-1", "sine-2"), ("sine-1", "loops-1", "path-1"), ("sine-1", "loops-2", "path-2"),
    ("sine-1", "loops-1", "path-2"), ("sine-1", "loops-1", "loops-2"), ("sine-1", "sine-2", "loops-1"),
)
CUTS = tuple(chain.from_iterable((cut, tuple(name for name in PARTS if name not in cut)) for cut in FITTED))
SIZES: dict[str, tuple[float, float, float]] = {
    "delay": (0.002, 0.005, 0.015),  # s
    "lag": (0.002, 0.005, 0.015),  # s
    "periodic_disturbance": (0.1, 0.3, 1.0),  # um
    "gain_change": (0.01, 0.03, 0.06),  # share
    "quantisation": (9, 8, 6),  # bits over 64 um
    "thermal_drift": (0.3, 1.0, 3.0),  # um from end to end
    "static_nonlinearity": (0.005, 0.015, 0.04),  # cubic, share of the stroke
    "creep": (0.5, 1.5, 4.0),  # % per decade
    "initial_memory": (0, 1, 2),  # the pieces begin so many quarters of a period later
}
STROKE_UM, MIDDLE_UM, HUM_HZ, QUARTER = 45.0, -96.0, 37.3, 50
LEVELS = "small", "middle", "large"
CREEP_S = 0.2 * 10.0 ** np.arange(0, 4, 0.4)  # time constants


def put(name: str, size: float, run: Recording, random: np.random.Generator) -> np.ndarray:
    """The displacement as the sensor would read it with the effect."""
    z, t = run.displacement_um, run.time_s - run.time_s[0]
    if name == "delay":
        return np.interp(t - size, t, z)
    if name == "lag":
        return followed(z, t, size)
    if name == "creep":
        share = size / 100 * np.log10(CREEP_S[1] / CREEP_S[0])
        return z + share * sum(followed(z, t, constant) - z[0] for constant in CREEP_S)
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


def followed(z: np.ndarray, t: np.ndarray, constant_s: float) -> np.ndarray:
    """Low-pass of first order; readings are joined by straight lines. Starts settled."""
    step = (t[1] - t[0]) / constant_s
    kept, slope = np.exp(-step), -np.expm1(-step) / step
    result = np.array(z)
    for k in range(1, len(z)):
        result[k] = kept * result[k - 1] + (slope - kept) * z[k - 1] + (1 - slope) * z[k]
    return result


def generate(folder: Path, seed: int) -> list[Case]:
    """Files and labels of all cases. Raises SystemExit where the data are not."""
    if not DATA.is_dir():
        raise SystemExit(f"measured data not found in {DATA}; set RDPI_DATA to its folder")
    random = np.random.default_rng([seed, 3])
    parts = {name: _part(folder, name) for name in PARTS}
    models = [_model(folder, k, [parts[name] for name in cut]) for k, cut in enumerate(CUTS)]
    asked = [(name, level) for name in SIZES for level in range(len(LEVELS))]
    # Every cut without an effect; every effect and size on two cuts.
    plan = [(k, "", 0) for k in range(len(CUTS))] + [
        ((k + turn) % len(CUTS), *one) for turn in (0, 5) for k, one in enumerate(asked)]
    return [_case(folder, random, k, models[k], [run for part, run in parts.items() if part not in CUTS[k]], name,
                  level) for k, name, level in plan]


def _case(folder: Path, random: np.random.Generator, cut: int, model: Path, rest: list[Recording], name: str,
          level: int) -> Case:
    ident = random.bytes(6).hex()
    where = folder / "cases" / ident
    if name == "initial_memory":
        rest = [_rows(run, slice(SIZES[name][level] * QUARTER, None)) for run in rest]
    changed = [Recording(run.path, run.metadata | ({"memory": "reset"} if name == "initial_memory" else {}),
                         run.columns if name in ("", "initial_memory") else
                         {**run.columns, "displacement_um": put(name, SIZES[name][level], run, random)})
               for run in rest]
    now, later, as_was = ([_rows(run, half(len(run))) for run in runs] for runs, half in (
        (changed, lambda n: slice(n // 2)), (changed, lambda n: slice(n // 2, None)), (rest, lambda n: slice(n // 2))))
    write(where, "run", now)
    write(where, "later", later)
    (where / "task.json").write_text(json.dumps({"model": os.path.relpath(model, where), "without": []}))
    floor = residual_rms(read_model(model), as_was)
    grew = residual_rms(read_model(model), now) / floor
    moved = pooled([a.displacement_um - b.displacement_um for a, b in zip(now, as_was)]) / floor if name else 0.0
    if name and not moved:  # left out of what is said, not put into the data
        moved = float(np.sqrt(max(0.0, grew**2 - 1)))
    return Case("measured" if name else "none", (name,) if name else (), round(moved, 1), cut, ident=ident,
                kind=LEVELS[level] if name else "", reached=moved, growth=grew, floor_um=floor,
                samples=sum(map(len, now)))


def _rows(run: Recording, rows: slice) -> Recording:
    return Recording(run.path, dict(run.metadata), {name: column[rows] for name, column in run.columns.items()})


def _part(folder: Path, name: str) -> Recording:
    source, rows = PARTS[name]
    path = folder / "models" / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    if rdpi("import", str(DATA / source), "--command", "0", "--displacement", "4", "--rate", "200", "--rows", rows,
            "-o", str(path)):
        raise SystemExit(f"{DATA / source}: rdpi import refuses it")
    return read_recording(path)


def _model(folder: Path, cut: int, runs: list[Recording]) -> Path:
    path = folder / "models" / f"{cut}.json"
    if rdpi("fit", *(run.path for run in runs), "-o", str(path)):
        raise SystemExit(f"{path}: rdpi fit refuses the recordings")
    return path
