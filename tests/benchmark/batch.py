#!/usr/bin/env python3
"""`rdpi batch` in one process and in one per core: time, speed-up, largest memory of a worker. Nothing is asserted.

    .venv/bin/python tests/benchmark/batch.py [--actuators N] [--samples N] [--jobs N]
    .venv/bin/python tests/benchmark/batch.py --channels 1000 --samples 1000000

Each virtual actuator is commissioned in half of its samples. In the other half, one in four has got a delay. With
`--channels`, one actuator is measured, and the table says what so many of them would ask of 1, 10 and 100 machines like
this one, whose files lie on one server.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from fit_speed import HOST_TOOLS, ROOT, timed

sys.path[:0] = [str(HOST_TOOLS), str(ROOT / "tests" / "bench")]

import bench as vb  # noqa: E402
from rdpi.data import read_recording, sample_times, write_recording  # noqa: E402

RATE_HZ = 2000.0
DELAY_S = 0.002
KINDS = "preisach", "bouc-wen"
SPEED_UP, WORKER_MB = 0.9, 500  # targets: share of the cores; resident memory of a worker
MACHINES = 1, 10, 100
LINK_MB_PER_S = 110.0  # what a file server gives over 1 Gbit/s


def record(path: Path, plant: vb.Bench, command_V: np.ndarray) -> None:
    """After a sweep that ends where the drive begins."""
    plant.demagnetise(RATE_HZ, to_V=float(command_V[0]))
    displacement_um = plant.run(command_V, RATE_HZ)
    columns = {"time_s": sample_times(len(command_V), RATE_HZ), "command_V": command_V,
               "displacement_um": displacement_um}
    write_recording(path, columns, {"sample_rate_hz": RATE_HZ, "memory": "reset"})


def write_plan(folder: Path, actuators: int, samples: int) -> Path:
    """Recordings of virtual actuators, no two of the same stroke, creep and memory; returns the plan."""
    half = samples // 2
    drive = folder / "drive.csv"
    timed("-m", "rdpi", "excite", "commission", "--min-V", "0", "--max-V", "100", "--sample-rate", f"{RATE_HZ:g}",
          "--duration", f"{half / RATE_HZ:g}", "-o", str(drive))
    commissioned_V = read_recording(drive, required=("time_s", "command_V")).command_V
    t = np.arange(half) / RATE_HZ
    plan = folder / "plan.csv"
    with open(plan, "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["actuator", "fit", "gap"])
        for number in range(actuators):
            random, name = np.random.default_rng(number), f"A{number:03}"
            settings = {"stroke_um": random.uniform(10, 15), "creep_percent_per_decade": random.uniform(0, 3)}
            plant = vb.make(KINDS[number % 2], number, **settings)
            record(folder / f"{name}-fit.csv", plant, commissioned_V)
            waves = sum(np.sin(2 * np.pi * (hertz * t + random.uniform())) / hertz**0.5 for hertz in (0.7, 2.3, 6.1, 17))
            command_V = 50 + 45 * waves / np.max(np.abs(waves))
            plant = vb.make(KINDS[number % 2], number, **settings, delay_s=DELAY_S if number % 4 == 0 else 0.0)
            record(folder / f"{name}-gap.csv", plant, command_V)
            rows.writerow([name, f"{name}-fit.csv", f"{name}-gap.csv"])
    return plan


def children(of: int) -> list[int]:
    """Processes below one, itself left out."""
    found = []
    for child in Path(f"/proc/{of}/task/{of}/children").read_text().split():
        found += [int(child), *children(int(child))]
    return found


def peak_MB(process: int) -> float:
    status = Path(f"/proc/{process}/status").read_text()
    return next((int(line.split()[1]) / 1000 for line in status.splitlines() if line.startswith("VmHWM")), 0.0)


def run(plan: Path, jobs: int) -> tuple[float, float]:
    """Seconds of the whole batch, and the largest resident memory of a worker in MB."""
    results = plan.with_name(f"results-{jobs}.sqlite")
    start, largest_MB = time.perf_counter(), 0.0
    batch = subprocess.Popen([sys.executable, "-m", "rdpi", "batch", plan, "-o", results, "--jobs", str(jobs), "--all"],
                             env=os.environ | {"PYTHONPATH": str(HOST_TOOLS)}, stdout=subprocess.DEVNULL)
    while batch.poll() is None:
        with contextlib.suppress(OSError):  # one that has just ended
            largest_MB = max([largest_MB, *map(peak_MB, children(batch.pid))])
        time.sleep(0.2)
    if batch.returncode:
        raise SystemExit("rdpi batch failed")
    return time.perf_counter() - start, largest_MB


def extrapolate(folder: Path, channels: int, samples: int) -> None:
    """Print what `channels` actuators would take, from one."""
    plan, cores = write_plan(folder, 1, samples), os.cpu_count()
    read_MB = sum(path.stat().st_size for path in folder.glob("A*.csv")) / 1e6
    seconds, worker_MB = run(plan, 1)
    written_MB = sum(path.stat().st_size for path in folder.glob("*.sqlite*")) / 1e6
    written_MB += sum(path.stat().st_size for path in folder.glob("models/*.json")) / 1e6
    print(f"one actuator of {samples} samples: {seconds:.0f} s, {worker_MB:.0f} MB of memory, {read_MB:.0f} MB read, "
          f"{written_MB:.2f} MB written\n{channels} of them: {channels * read_MB / 1000:.0f} GB read, "
          f"{channels * written_MB / 1000:.2f} GB written\n"
          f"  machines  {'time':>8}  memory of each  network in all, of 1 Gbit/s")
    for machines in MACHINES:
        hours = channels * seconds / (SPEED_UP * cores * machines) / 3600
        MB_per_s = channels * (read_MB + written_MB) / (3600 * hours)
        print(f"  {machines:8}  {hours:6.2f} h  {cores * worker_MB:10.0f} MB  {MB_per_s:9.2f} MB/s  "
              f"{100 * MB_per_s / LINK_MB_PER_S:9.1f} %")
    most = LINK_MB_PER_S * seconds / ((read_MB + written_MB) * SPEED_UP * cores)
    print(f"1 Gbit/s to the file server is used up by {most:.0f} machines of {cores} cores")


def main() -> None:
    parser = argparse.ArgumentParser(description="Time and memory of `rdpi batch` on virtual actuators.")
    parser.add_argument("--channels", type=int, help="measure one actuator, and print what so many would take, not a batch")
    parser.add_argument("--actuators", type=int, default=200)
    parser.add_argument("--samples", type=int, default=40_000, help="of each actuator (40000)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (one per core)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.channels:
            extrapolate(Path(folder), options.channels, options.samples)
            return
        plan = write_plan(Path(folder), options.actuators, options.samples)
        print(f"rdpi batch, {options.actuators} actuators of {options.samples} samples, fit and gap")
        alone_s, alone_MB = run(plan, 1)
        print(f"  1 process    {alone_s:8.0f} s  {alone_s / options.actuators:6.1f} s each  {alone_MB:6.0f} MB")
        together_s, together_MB = run(plan, options.jobs)
        print(f"  {options.jobs} processes  {together_s:8.0f} s  {together_s / options.actuators:6.1f} s each  "
              f"{together_MB:6.0f} MB, target {WORKER_MB}")
        print(f"  speed-up {alone_s / together_s:.2f}, target {SPEED_UP * options.jobs:.1f}")


if __name__ == "__main__":
    main()
