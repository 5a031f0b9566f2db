#!/usr/bin/env python3
"""A stage with two axes that move each other: one board drives both, and takes the cross coupling off the references.

    examples/stage/stage.py

The board is an emulated Cortex-M4F with two virtual actuators. Everything of rdpi goes through its commands, which are
printed. Results in build/stage/.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "examples" / "shrink"), str(ROOT / "examples" / "loop"), str(ROOT / "tests" / "bench")]

import bench  # noqa: E402
import loop  # noqa: E402
import shrink  # noqa: E402
from rdpi.data import read_recording  # noqa: E402

AXES = {"x": "preisach", "y": "bouc-wen"}  # and the laws of their actuators
PROFILES = {"x": "5-20-35hz", "y": "10hz"}
MOVING_HZ = {"x": "7", "y": "3"}  # where both move, so that gap sees what one does to the other
COUPLE_UM_PER_V = 0.01
RESULTS = {"alone": "axes that do not move each other",
           "coupled": "axes that do, models without cross coupling",
           "compensated": "axes that do, models with it"}


class Stage(shrink.Board):
    """Two axes on one board."""

    def __init__(self, out: Path, preset: str, dac: str) -> None:
        super().__init__(out, preset, dac, AXES["x"])
        self.kinds = list(AXES.values())
        self.options.append(f"-DRDPI_AXES={len(AXES)}")

    def recordings(self, name: str) -> list[str]:
        return [f"{name}-{axis}.csv" for axis in AXES]

    def headers(self, name: str, file: str, commands: Sequence[Sequence[str]]) -> str:
        """A header for each axis, made by the command of each; the folders as a CMake option has them."""
        folders = [self.out / name / axis for axis in AXES]
        for folder, command in zip(folders, commands):
            folder.mkdir(parents=True, exist_ok=True)
            self.do("rdpi", *command, "-o", folder / file)
        return ";".join(map(str, folders))

    def play_both(self, drives: Sequence[str], name: str) -> None:
        """Play a drive on each axis and record both."""
        folders = self.headers(name, "rdpi_profile.h", [["profile", drive, "--dac", self.dac] for drive in drives])
        self.record(self.build("excite", name, f"-DRDPI_EXCITE_DIR={folders}"), "excite", name)

    def track_both(self, models: Sequence[str], name: str) -> None:
        """Track the reference of each axis with its model, after the start-up sweeps, and record both."""
        self.headers(name, "rdpi_profile.h", [["profile", f"reference-{axis}.csv"] for axis in AXES])
        folders = self.headers(name, "rdpi_params.h", [["header", model] for model in models])
        self.record(self.build("track", name, f"-DRDPI_PARAMS_DIR={folders}",
                               f"-DRDPI_TRACK_RATE_HZ={self.rate_hz}"), "track", name)


def commission(stage: Stage, drive_s: float) -> None:
    """A model of each axis: it moves while the other rests where a sweep has left it."""
    bits, min_V, max_V = stage.dac.split(":")
    limits = "--min-V", min_V, "--max-V", max_V
    rate = "--sample-rate", str(stage.rate_hz)
    stage.do("rdpi", "excite", "commission", *limits, *rate, "--duration", f"{drive_s:g}", "-o", "drive.csv")
    stage.do("rdpi", "excite", "startup", *limits, *rate, "-o", "rest.csv")
    for k, axis in enumerate(AXES):
        drives = ["rest.csv"] * len(AXES)
        drives[k] = "drive.csv"
        stage.play_both(drives, f"commission-{axis}")
        stage.do("rdpi", "fit", f"commission-{axis}-{axis}.csv", *limits, "--dac-bits", bits, "-o", f"model-{axis}.json",
                 quiet=False)


def find_coupling(stage: Stage) -> None:
    """Both axes move; what one does to the other is named, and becomes part of the models."""
    _, min_V, max_V = stage.dac.split(":")
    for axis, frequency_hz in MOVING_HZ.items():
        stage.do("rdpi", "excite", "sine", "--min-V", min_V, "--max-V", max_V, "--sample-rate", str(stage.rate_hz),
                 "--frequencies", frequency_hz, "-o", f"sine-{axis}.csv")
    stage.play_both([f"sine-{axis}.csv" for axis in AXES], "moving")
    for axis in AXES:
        stage.do("rdpi", "gap", f"model-{axis}.json", f"moving-{axis}.csv", "-o", f"coupled-{axis}.json", quiet=False)


def write_references(stage: Stage, seconds: float) -> dict[str, np.ndarray]:
    """A profile for each axis, over the stroke that its commissioning reached."""
    references_um = {}
    for axis, profile in PROFILES.items():
        seen_um = read_recording(stage.out / f"commission-{axis}-{axis}.csv").displacement_um
        low_um, high_um = seen_um.min(), seen_um.max()
        stroke_um = loop.SHARE * (high_um - low_um)
        references_um[axis] = (bench.paper_profile(profile, stage.rate_hz, seconds, stroke_um)
                               + (low_um + high_um - stroke_um) / 2)
        rows = np.column_stack([np.arange(len(references_um[axis])) / stage.rate_hz, references_um[axis]])
        np.savetxt(stage.out / f"reference-{axis}.csv", rows, "%.9g", ",", header="time_s,reference_um", comments="")
    return references_um


def run(stage: Stage, drive_s: float, seconds: float) -> dict[str, dict[str, float]]:
    """Tracking error of each axis for each of RESULTS, rms in % of the stroke."""
    stage.couple_um_per_V = COUPLE_UM_PER_V
    commission(stage, drive_s)
    find_coupling(stage)
    references_um = write_references(stage, seconds)
    errors = {}
    for name, model, couple_um_per_V in (("alone", "model", 0.0), ("coupled", "model", COUPLE_UM_PER_V),
                                         ("compensated", "coupled", COUPLE_UM_PER_V)):
        stage.couple_um_per_V = couple_um_per_V
        stage.track_both([f"{model}-{axis}.json" for axis in AXES], name)
        errors[name] = {axis: bench.error_percent(read_recording(stage.out / f"{name}-{axis}.csv").displacement_um,
                                                  references_um[axis], stage.rate_hz)[0] for axis in AXES}
    return errors


def main() -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("stage: ended"))  # so that what it has started ends with it
    parser = argparse.ArgumentParser(description="Two axes on an emulated board, with cross coupling.")
    parser.add_argument("--preset", choices=loop.MACHINES, default="qemu-m4f", help="the board (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "stage", help="folder of the results")
    parser.add_argument("--duration", type=loop.number(0), default=4.0,
                        help="of the commissioning drives, s (default: %(default)s)")
    parser.add_argument("--seconds", type=loop.number(bench.SETTLED_S), default=1.0,
                        help="of the profiles (default: %(default)s)")
    options = parser.parse_args()
    out = options.out.resolve()
    print(f"in {out}:")
    errors = run(Stage(out, options.preset, shrink.DAC), options.duration, options.seconds)
    print("\nTracking error, rms in % of the reference's peak-to-peak" + "".join(f"{axis:>8}" for axis in AXES))
    for name, told in RESULTS.items():
        print(f"  {told:54}" + "".join(f"{errors[name][axis]:8.2f}" for axis in AXES))
    (out / "stage.json").write_text(json.dumps(errors, indent=1) + "\n")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("stage: stopped")
