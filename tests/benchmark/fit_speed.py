#!/usr/bin/env python3
"""How long `rdpi fit` takes, and how much memory: a table, nothing is asserted. The demo's recordings of its virtual
actuators, and a million samples in eight runs.

    .venv/bin/python tests/benchmark/fit_speed.py [--samples N]
"""

from __future__ import annotations

import argparse
import os
import pstats
import sys
import tempfile
import time
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
HOST_TOOLS = ROOT / "host_tools"
sys.path.insert(0, str(ROOT / "examples" / "demo"))

import demo  # noqa: E402

RATES_HZ = (500, 1000, 2000, 5000, 10_000, 10_000, 20_000, 20_000)  # of sampling, one per run
WAVES_HZ = (1, 2, 5, 10, 15, 25, 35, 40)
TARGET_S, TARGET_MB, DEMO_S = 45, 1000, 3
SHOWN = 0.02  # parts that take less of the whole are left out


def synthesise(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Commands in V, displacements in um, both (runs, samples): ten plays, a rate law, one dead zone, 4 nm of noise."""
    random = np.random.default_rng(1)
    phase = np.arange(samples) * (np.array(WAVES_HZ) / RATES_HZ)[:, None]
    size = random.uniform(0.3, 1, (len(RATES_HZ), int(phase.max()) + 1))  # a new amplitude every period
    command_V = 100 * size[np.arange(len(phase))[:, None], phase.astype(int)] * (1 - np.abs(2 * (phase % 1) - 1))
    x = 0.14 * command_V
    rate = np.abs(np.diff(x, axis=1, prepend=0)) * np.array(RATES_HZ)[:, None]
    thresholds, slopes = np.arange(10) * 0.6, np.linspace(0.7, 1.2, 10)
    fall = np.linspace(4e-4, 1e-5, 10)
    y, v = np.zeros((len(x), 10)), np.empty_like(x)
    for k in range(samples):
        now = x[:, k, None]
        y = np.maximum(now - thresholds, np.minimum(now + thresholds, y))
        v[:, k] = np.sum(np.diff(slopes - fall * rate[:, k, None], prepend=0) * y, axis=1)
    return command_V, v - 0.1 * np.maximum(v - 8, 0) + 0.004 * random.standard_normal(v.shape)


def write_runs(folder: Path, samples: int) -> list[str]:
    paths = []
    for i, (rate, command_V, displacement_um) in enumerate(zip(RATES_HZ, *synthesise(samples))):
        paths.append(str(folder / f"run{i}.csv"))
        np.savetxt(paths[-1], np.column_stack([np.arange(samples) / rate, command_V, displacement_um]), "%.7f", ",",
                   header=f"# sample_rate_hz: {rate}\n# memory: reset\ntime_s,command_V,displacement_um", comments="")
    return paths


def demo_runs(folder: Path) -> dict[str, str]:
    """The demo's recording of each virtual actuator."""
    demo.OUT = folder
    with redirect_stdout(StringIO()):
        drive = demo.excite()
        return {kind: str(folder / demo.record(kind, drive)) for kind in demo.ACTUATORS}


def timed(*arguments: str) -> tuple[float, float]:
    """Wall seconds and largest resident memory in MB (never below this script's own) of a Python that must succeed."""
    start = time.perf_counter()
    child = os.posix_spawn(sys.executable, [sys.executable, *arguments], os.environ | {"PYTHONPATH": str(HOST_TOOLS)},
                           file_actions=[(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)])
    _, status, usage = os.wait4(child, 0)
    if status:
        raise SystemExit(f"{' '.join(arguments)}: failed")
    return time.perf_counter() - start, usage.ru_maxrss / 1000


def print_parts(profile: str) -> None:
    """Functions of rdpi by the time they and all they call take."""
    stats = pstats.Stats(profile)
    print(f"\nparts, from a second run under cProfile, {stats.total_tt:.1f} s (each includes what it calls):")
    parts = sorted(((cumulative, Path(file).stem, name, calls)
                    for (file, _, name), (_, calls, _, cumulative, _) in stats.stats.items()
                    if "rdpi" in Path(file).parts and name[0] != "<"), reverse=True)
    for seconds, module, name, calls in parts:
        if seconds > SHOWN * stats.total_tt:
            print(f"  {seconds:7.2f} s  {calls:6} x  {module}.{name}")


def print_row(label: str, seconds: float, target_s: float, megabytes: float) -> None:
    print(f"  {label:22}{seconds:10.1f} s{target_s:6} s{megabytes:7.0f} MB{TARGET_MB:6} MB")


def main() -> None:
    parser = argparse.ArgumentParser(description="Time and memory of `rdpi fit` on eight synthetic runs.")
    parser.add_argument("--samples", type=int, default=1_000_000, help="of all runs together (1000000)")
    samples = parser.parse_args().samples // len(RATES_HZ)
    with tempfile.TemporaryDirectory() as folder:
        model, profile = f"{folder}/model.json", f"{folder}/profile"
        print(f"rdpi fit, {os.cpu_count()} cores\n{'':24}load and fit  target  resident  target")
        for kind, recording in demo_runs(Path(folder)).items():
            *_, options = demo.ACTUATORS[kind].models.values()  # of the demo's best model
            seconds, megabytes = timed("-m", "rdpi", "fit", recording, *options, "-o", model)
            print_row(f"demo, {kind}", seconds, DEMO_S, megabytes)
        runs = write_runs(Path(folder), samples)
        fit_s, fit_MB = timed("-m", "rdpi", "fit", *runs, "-o", model)
        timed("-m", "cProfile", "-o", profile, "-m", "rdpi", "fit", *runs, "-o", model)
        print_row(f"{samples * len(runs)} samples, {len(runs)} runs", fit_s, TARGET_S, fit_MB)
        print_parts(profile)


if __name__ == "__main__":
    main()
