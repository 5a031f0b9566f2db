#!/usr/bin/env python3
"""The shrink, closed: an effect appears, `rdpi gap` names it, the firmware is rebuilt, and the error is measured again.

    examples/shrink/shrink.py                       each effect by itself, then all of them together
    examples/shrink/shrink.py --effects delay lag   these two only, by themselves

The board is an emulated Cortex-M4F with a virtual actuator. Everything of rdpi goes through its commands, which are
printed. Results in build/shrink/.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "examples" / "loop"), str(ROOT / "tests" / "bench")]

import bench  # noqa: E402
import loop  # noqa: E402
from rdpi.board import telemetry  # noqa: E402
from rdpi.data import read_recording  # noqa: E402

# What appears on the bench, as fields of bench.Bench.
EFFECTS: dict[str, dict[str, float]] = {
    "delay": {"delay_s": 1e-3},
    "lag": {"amplifier_hz": 160.0},  # 1 ms
    "creep": {"creep_percent_per_decade": 6.0},  # 1.5 at commissioning
    "resonance": {"resonance_hz": 200.0, "resonance_damping": 0.05},
}
TOGETHER = "together"
DAC = "16:0:100"


class Board(loop.Emulated):
    """Its telemetry goes into a file, which takes every byte at once: what is compared must be whole."""

    rate_hz = 5_000  # half of loop's: half the time

    def record(self, folder: Path, application: str, name: str) -> Path:
        stream = self.out / f"{name}.raw"
        stream.write_bytes(b"")
        actuator = self.power_up(name)
        try:
            words = self.command("qemu-system-arm", "-M", loop.MACHINES[self.preset], "-icount", "shift=4,sleep=off",
                                 "-display", "none", "-monitor", "none", "-serial", f"file:{stream.name}", "-serial",
                                 f"unix:{name}.sock", "-kernel", folder / application)
            with subprocess.Popen(words, cwd=self.out) as board:
                try:
                    actuator.stdin.write("go\n")
                    actuator.stdin.flush()
                    wait(board, stream)
                finally:
                    board.kill()
        finally:
            actuator.stdin.close()
            actuator.wait(timeout=loop.PATIENCE_S)
        for axis, recording in enumerate(self.recordings(name)):
            self.do("rdpi", "import", "--telemetry", stream, "--axis", str(axis), "-o", recording)
        return self.out / self.recordings(name)[0]


def wait(board: subprocess.Popen, stream: Path) -> None:
    """Until the board says that it has come to its end."""
    decoder, heard = telemetry.Decoder(stream.name), time.monotonic()
    with open(stream, "rb") as file:
        while decoder.info is None or decoder.info.state < telemetry.FINISHED:
            if data := file.read():
                decoder.feed(data)
                heard = time.monotonic()
            elif board.poll() is not None or time.monotonic() - heard > loop.PATIENCE_S:
                sys.exit("shrink: the board fell silent")
            time.sleep(0.1)


class Shrink(NamedTuple):
    """Tracking error, rms in % of the stroke, and what `rdpi gap` named."""

    before: float
    promised: float
    after: float
    named: list[str]


class Commissioned(NamedTuple):
    """The actuator before anything changes."""

    reference_um: np.ndarray
    drive: Path  # recordings: of the commissioning drive, and of the profile, tracked
    tracked: Path
    error: float  # of the latter, rms in % of the stroke


def error_of(recording: Path, reference_um: np.ndarray) -> float:
    return bench.error_percent(read_recording(recording).displacement_um, reference_um, Board.rate_hz)[0]


def commission(board: Board, drive_s: float, seconds: float) -> Commissioned:
    """Identify the actuator, and track the profile with it."""
    bits, min_V, max_V = DAC.split(":")
    limits = "--min-V", min_V, "--max-V", max_V
    board.do("rdpi", "excite", "commission", *limits, "--sample-rate", str(board.rate_hz), "--duration", f"{drive_s:g}",
             "-o", "drive.csv")
    drive = board.play("drive.csv", "commissioned")
    board.do("rdpi", "fit", drive, *limits, "--dac-bits", bits, "-o", "model.json", quiet=False)
    displacement_um = read_recording(drive).displacement_um
    low_um, high_um = displacement_um.min(), displacement_um.max()
    stroke_um = loop.SHARE * (high_um - low_um)
    reference_um = (bench.paper_profile(loop.PROFILE, board.rate_hz, seconds, stroke_um)
                    + (low_um + high_um - stroke_um) / 2)
    np.savetxt(board.out / "reference.csv", np.column_stack([np.arange(len(reference_um)) / board.rate_hz,
                                                             reference_um]), "%.9g", ",", header="time_s,reference_um",
               comments="")
    tracked = board.track("model.json", "reference.csv", "tracked")
    return Commissioned(reference_um, drive, tracked, error_of(tracked, reference_um))


def shrink(board: Board, name: str, settings: dict[str, float], healthy: Commissioned) -> Shrink:
    """An effect appears. The same drives are played again; gap compares, header and compiler do the rest."""
    print(f"\n=== {name}: " + ", ".join(f"{key} {value:g}" for key, value in settings.items()))
    board.settings = settings
    images = board.out / "build"
    drive = board.record(images / "commissioned", "excite", f"{name}-drive")
    before = board.record(images / "tracked", "track", f"{name}-before")
    improved, found = f"{name}.json", board.out / f"{name}-gap.json"
    board.do("rdpi", "gap", "model.json", drive, before, "--earlier", healthy.drive, "--earlier", healthy.tracked,
             "-o", improved, "--json", found, quiet=False)
    after = board.track(improved, "reference.csv", f"{name}-after")
    diagnosis = json.loads(found.read_text())
    return Shrink(error_of(before, healthy.reference_um), promised(diagnosis, before, healthy),
                  error_of(after, healthy.reference_um), [one["name"] for one in diagnosis["effects"]])


def promised(diagnosis: dict, before: Path, healthy: Commissioned) -> float:
    """The model's own error, and beside it what is to be left of the change since then.

    The same drive was output, so that the change is the difference of the recordings.
    """
    changed_um = read_recording(before).displacement_um - read_recording(healthy.tracked).displacement_um
    changed = bench.error_percent(changed_um + healthy.reference_um, healthy.reference_um, Board.rate_hz)[0]
    return math.hypot(healthy.error, (1 - (diagnosis["promised"]["shrink"] or 0.0)) * changed)


def print_table(healthy: Commissioned, results: dict[str, Shrink]) -> None:
    print(f"\nTracking error of the {loop.PROFILE} profile, rms in % of its peak-to-peak; as commissioned "
          f"{healthy.error:.2f}")
    print(f"  {'what appears':14}{'before':>8}{'promised':>10}{'after':>8}   named by rdpi gap")
    for name, one in results.items():
        print(f"  {name:14}{one.before:8.2f}{one.promised:10.2f}{one.after:8.2f}   {', '.join(one.named) or 'nothing'}")


def run(board: Board, names: list[str], drive_s: float, seconds: float) -> tuple[Commissioned, dict[str, Shrink]]:
    healthy = commission(board, drive_s, seconds)
    together = {key: value for settings in EFFECTS.values() for key, value in settings.items()}
    results = {name: shrink(board, name, EFFECTS.get(name, together), healthy) for name in names}
    return healthy, results


def main() -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("shrink: ended"))  # so that what it has started ends with it
    parser = argparse.ArgumentParser(description="Effects appear on an emulated bench; the firmware compensates them.")
    parser.add_argument("--effects", nargs="+", choices=[*EFFECTS, TOGETHER], default=[*EFFECTS, TOGETHER],
                        help="default: all, one after the other")
    parser.add_argument("--preset", choices=loop.MACHINES, default="qemu-m4f", help="the board (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "shrink", help="folder of the results")
    parser.add_argument("--duration", type=loop.number(0), default=4.0,
                        help="of the commissioning drive, s (default: %(default)s)")
    parser.add_argument("--seconds", type=loop.number(bench.SETTLED_S), default=2.0,
                        help="of the profile (default: %(default)s)")
    options = parser.parse_args()
    out = options.out.resolve()
    board = Board(out, options.preset, DAC, "preisach")
    print(f"in {out}:")
    healthy, results = run(board, options.effects, options.duration, options.seconds)
    print_table(healthy, results)
    (out / "shrink.json").write_text(json.dumps({"commissioned": healthy.error, **{
        name: one._asdict() for name, one in results.items()}}, indent=1) + "\n")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("shrink: stopped")
