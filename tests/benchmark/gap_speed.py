#!/usr/bin/env python3
"""How long `rdpi gap` takes on 100 000 samples in eight runs, every effect tried: a table, nothing is asserted.

    .venv/bin/python tests/benchmark/gap_speed.py [--samples N] [--monitor]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from fit_speed import HOST_TOOLS, print_parts, timed

sys.path[:0] = [str(HOST_TOOLS), str(HOST_TOOLS.parent / "tests" / "bench")]

import bench as vb  # noqa: E402

RATE_HZ = 2000.0
RUNS = 8
TARGET_S = 5
# What the recordings have and the model has not: three effects at once, so that every round of the selection is gone
# through, beside readings on a grid and another axis, so that nothing is left out for want of excitation.
DELAY_S, GAIN, HUM_HZ, HUM_UM, GRID_UM = 0.002, 1.06, 77.0, 0.3, 0.02


def command(kind: int, samples: int) -> np.ndarray:
    """One of eight drives of 0 to 100 V: waves that change their amplitude, sums of sines, and staircases."""
    random, t = np.random.default_rng(kind), np.arange(samples) / RATE_HZ
    if kind < 4:
        phase = t * (1.0, 4.0, 12.0, 30.0)[kind]
        size = random.uniform(0.3, 1, int(phase[-1]) + 1)[phase.astype(int)]
        wave = np.cos(2 * np.pi * phase) if kind % 2 else 4 * np.abs(phase % 1 - 0.5) - 1
        return 50 - 50 * size * wave
    if kind < 6:
        waves = sum(np.sin(2 * np.pi * (hertz * t + random.uniform())) / hertz**0.5 for hertz in (0.7, 2.3, 6.1, 17.0))
        return 50 + 45 * waves / np.max(np.abs(waves))
    return random.uniform(0, 100, int(t[-1] / 0.5) + 1)[(t / 0.5).astype(int)]


def write_runs(folder: Path, name: str, samples: int, changed: bool, monitor: bool) -> list[str]:
    """Recordings of the virtual bench, with or without what the model does not know; returns their paths."""
    plant, paths = vb.make("preisach", 3), []
    for kind in range(RUNS):
        drive = command(kind, samples)
        plant.demagnetise(RATE_HZ, to_V=float(drive[0]))
        t, random = np.arange(samples) / RATE_HZ, np.random.default_rng(100 + kind)
        late = np.interp(t - DELAY_S, t, drive) if changed else drive
        z = plant.run(late, RATE_HZ)
        if changed:
            z = GAIN * z + HUM_UM * np.sin(2 * np.pi * (HUM_HZ * t + random.uniform()))
            z = GRID_UM * np.round(z / GRID_UM)
        columns = {"time_s": t, "command_V": drive, "displacement_um": z, "other_axis_V": np.sin(t + kind)}
        if monitor:
            columns["monitor_V"] = late + 0.01 * random.standard_normal(samples)
        paths.append(str(folder / f"{name}{kind}.csv"))
        np.savetxt(paths[-1], np.column_stack(list(columns.values())), "%.7f", ",", comments="",
                   header=f"# sample_rate_hz: {RATE_HZ:g}\n# memory: reset\n" + ",".join(columns))
    return paths


def print_searches(model: str, runs: list[str]) -> None:
    """Seconds that fitting each effect alone takes, in this process."""
    from rdpi.data import read_recording
    from rdpi.gap import candidates
    from rdpi.gap.dataset import Dataset
    from rdpi.model import read_model
    from rdpi.simulate import effects

    dataset = Dataset(read_model(model), [read_recording(run) for run in runs])
    before, hidden, seconds = dataset.predict([]), [], {}
    for name, kind in effects.CATALOGUE.items():
        for stage in kind.stages:
            start = time.perf_counter()
            found = candidates.search(dataset, kind(stage), [], before)
            seconds[f"{name} ({stage})"] = time.perf_counter() - start
            hidden += [] if found else [f"{name} ({stage})"]
    print(f"\nfits of one effect to the gap, the first of up to three rounds, {sum(seconds.values()):.2f} s:")
    for name, took in sorted(seconds.items(), key=lambda item: -item[1]):
        print(f"  {took:7.2f} s  {name}")
    if hidden:
        print(f"  not excited: {', '.join(hidden)}")


def main() -> None:
    parser = argparse.ArgumentParser(description="Time and memory of `rdpi gap` on eight runs of a virtual bench.")
    parser.add_argument("--samples", type=int, default=100_000, help="of all recordings together (100000)")
    parser.add_argument("--monitor", action="store_true", help="with a column monitor_V, which doubles what is judged")
    options = parser.parse_args()
    samples = options.samples // RUNS
    with tempfile.TemporaryDirectory() as folder:
        commissioning = write_runs(Path(folder), "commissioning", samples, False, False)
        later = write_runs(Path(folder), "later", samples, True, options.monitor)
        model, result, profile = (f"{folder}/{name}" for name in ("model.json", "result.json", "profile"))
        timed("-m", "rdpi", "fit", *commissioning, "-o", model)
        import_s, _ = timed("-c", "import rdpi.gap.report")
        before = os.times()
        gap_s, gap_MB = timed("-m", "rdpi", "gap", model, *later, "--json", result)
        after = os.times()
        busy_s = after.children_user + after.children_system - before.children_user - before.children_system
        report_s, _ = timed("-m", "rdpi", "gap", model, *later, "--report", f"{folder}/report")
        timed("-m", "cProfile", "-o", profile, "-m", "rdpi", "gap", model, *later)
        document = json.loads(Path(result).read_text())
        named = ", ".join(one["name"] for one in document["effects"]) or "none"
        print(f"rdpi gap, {RUNS} runs{' with monitor_V' * options.monitor}, {samples * RUNS} samples, "
              f"{os.cpu_count()} cores; {document['verdict']}: {named}")
        print(f"  load and diagnose        {gap_s:7.1f} s    target {TARGET_S} s")
        print(f"  of the processor         {busy_s:7.1f} s    more than the above: threads; less: other work beside it")
        print(f"  imports alone            {import_s:7.1f} s")
        print(f"  the same with --report   {report_s:7.1f} s")
        print(f"  resident, largest        {gap_MB:7.0f} MB")
        print_searches(model, later)
        print_parts(profile)


if __name__ == "__main__":
    main()
