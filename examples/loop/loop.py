#!/usr/bin/env python3
"""The whole loop on a board: play an excitation, record, identify, generate, rebuild, sweep, track, report the errors.

    examples/loop/loop.py                                          an emulated Cortex-M4F with a virtual actuator
    examples/loop/loop.py --port /dev/ttyACM0 --preset stm32f405   a board on the bench; see README.md

Everything of rdpi goes through its commands, which are printed. Results in build/loop/.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import math
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench"))

import bench  # noqa: E402
import lockstep  # noqa: E402
from rdpi.board import emulator  # noqa: E402
from rdpi.data import read_recording  # noqa: E402

RATE_HZ = 10_000
SHARE = 0.85  # of the stroke that the excitation reached: what the profile spans
PROFILE = "5-20-35hz"  # the paper's second; it repeats after 2 s
MACHINES = {preset: machine for preset, machine in emulator.MACHINES.items()
            if machine.startswith("mps2")}  # which have a second UART
MODELS = "no model", "rate-independent", "rate-dependent"
PATIENCE_S = 300.0


class Loop:
    """One folder of results, one board; subclasses say how an image gets to run and where its telemetry comes out."""

    rate_hz = RATE_HZ

    def __init__(self, out: Path, preset: str, dac: str, sensor: tuple[float, float], options: list[str]) -> None:
        self.out, self.preset, self.dac = out, preset, dac
        self.options = [f"-DRDPI_UM_PER_COUNT={sensor[0]!r}", f"-DRDPI_COUNT_0_UM={sensor[1]!r}", *options]
        out.mkdir(parents=True, exist_ok=True)

    def command(self, *words: str | Path) -> list[str]:
        """A command as the user would type it in the results' folder, printed."""
        texts = [str(word.relative_to(self.out) if isinstance(word, Path) and word.is_relative_to(self.out) else word)
                 for word in words]
        print("$ " + shlex.join(texts), flush=True)
        program = ROOT / ".venv" / "bin" / texts[0]
        return [str(program) if program.exists() else texts[0], *texts[1:]]

    def do(self, *words: str | Path, quiet: bool = True) -> None:
        done = subprocess.run(self.command(*words), cwd=self.out, text=True, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, check=False)
        if done.returncode or not quiet:
            print("".join(f"    {line}\n" for line in done.stdout.splitlines()), end="")
        if done.returncode:
            sys.exit(f"loop: this command failed with status {done.returncode}")

    def build(self, application: str, name: str, *options: str) -> Path:
        """The image of examples/<application>, in a build folder of its own."""
        folder = self.out / "build" / name
        self.do("cmake", "-S", ROOT, "--preset", self.preset, "-B", folder, *self.options, *options)
        self.do("cmake", "--build", folder, "--target", application)
        return folder

    def play(self, drive: str, name: str) -> Path:
        """Play a drive in volts and record it."""
        headers = self.out / name
        headers.mkdir(exist_ok=True)
        self.do("rdpi", "profile", drive, "--dac", self.dac, "-o", headers / "rdpi_profile.h")
        return self.record(self.build("excite", name, f"-DRDPI_EXCITE_DIR={headers}"), "excite", name)

    def track(self, model: str, reference: str, name: str) -> Path:
        """Track a reference with the model's inverse, after the start-up sweep, and record it."""
        headers = self.out / name
        headers.mkdir(exist_ok=True)
        self.do("rdpi", "header", model, "-o", headers / "rdpi_params.h")
        self.do("rdpi", "profile", reference, "-o", headers / "rdpi_profile.h")
        image = self.build("track", name, f"-DRDPI_PARAMS_DIR={headers}", f"-DRDPI_TRACK_RATE_HZ={self.rate_hz}")
        return self.record(image, "track", name)

    def record(self, folder: Path, application: str, name: str) -> Path:
        """Run the image to its end; returns the recording."""
        raise NotImplementedError

    def recordings(self, name: str) -> list[str]:
        """Of each axis."""
        return [f"{name}.csv"]

    def listen(self, port: str, name: str) -> subprocess.Popen:
        """Start `rdpi record`."""
        outputs = [word for recording in self.recordings(name) for word in ("-o", recording)]
        words = self.command("rdpi", "record", port, *outputs, "--raw", f"{name}.raw", "--timeout", "60")
        return subprocess.Popen(words, cwd=self.out, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)

    def recorded(self, recorder: subprocess.Popen, name: str) -> Path:
        """Wait for `rdpi record` to end."""
        output, _ = recorder.communicate(timeout=PATIENCE_S)
        print("".join(f"    {line}\n" for line in output.splitlines()), end="")
        if recorder.returncode:
            sys.exit(f"loop: rdpi record failed with status {recorder.returncode}")
        return self.out / self.recordings(name)[0]


class Emulated(Loop):
    """QEMU's board; the virtual actuator is behind its second UART, the telemetry comes out of a pseudo-terminal."""

    def __init__(self, out: Path, preset: str, dac: str, kind: str) -> None:
        super().__init__(out, preset, dac, lockstep.counts_scale(bench.make(kind, adc_bits=16)), ["-DRDPI_BENCH=ON"])
        self.kinds = [kind]  # of each axis
        self.settings: dict[str, float] = {}  # of the virtual actuator that are not the kind's own
        self.couple_um_per_V = 0.0  # how much axes move each other
        self.powered_up = 0

    def power_up(self, name: str) -> subprocess.Popen:
        """Start the actuator, every time with another memory. It moves after a line on its standard input."""
        self.powered_up += 1
        actuator = subprocess.Popen(
            self.command("python", ROOT / "tests/bench/lockstep.py", *self.kinds, "--socket", f"{name}.sock", "--dac",
                         self.dac, "--rate", str(self.rate_hz), "--log", f"{name}.npy", "--seed",
                         str(self.powered_up), *(f"--set={key}={value:g}" for key, value in self.settings.items()),
                         *([f"--couple={self.couple_um_per_V:g}"] if self.couple_um_per_V else [])),
            cwd=self.out, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        actuator.stdout.readline()  # it listens
        return actuator

    def record(self, folder: Path, application: str, name: str) -> Path:
        actuator = self.power_up(name)
        board = recorder = None
        try:
            board = subprocess.Popen(
                self.command("qemu-system-arm", "-M", MACHINES[self.preset], "-icount", "shift=4", "-display", "none",
                             "-monitor", "none", "-serial", "pty", "-serial", f"unix:{name}.sock", "-kernel",
                             folder / application),
                cwd=self.out, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
            recorder = self.listen(self.port_of(board), name)
            time.sleep(3)  # until QEMU, which looks once a second, has seen that someone listens
            actuator.stdin.write("go\n")
            actuator.stdin.flush()
            return self.recorded(recorder, name)
        finally:
            for process in filter(None, (recorder, board)):
                process.terminate()
                process.wait()
            actuator.stdin.close()
            actuator.wait(timeout=PATIENCE_S)

    @staticmethod
    def port_of(board: subprocess.Popen) -> str:
        for line in board.stdout:
            if found := re.search(r"redirected to (\S+)", line):
                return found[1]
        sys.exit("loop: QEMU opened no pseudo-terminal")


class OnTheBench(Loop):
    """A board with an actuator, a debug probe to flash it and a serial port."""

    def __init__(self, out: Path, preset: str, dac: str, sensor: tuple[float, float], port: str) -> None:
        super().__init__(out, preset, dac, sensor, [])
        self.port = port

    def record(self, folder: Path, application: str, name: str) -> Path:
        recorder = self.listen(self.port, name)  # first: the image starts as soon as it is flashed
        try:
            time.sleep(2)
            if recorder.poll() is None:  # or it has something to say, and no actuator moves
                self.do("cmake", "--build", folder, "--target", "flash")
            return self.recorded(recorder, name)
        finally:
            recorder.terminate()


def error_percent(recording: Path, reference_um: np.ndarray) -> tuple[float, float]:
    """bench.error_percent of a recording that has a reading for every reference."""
    displacement_um = read_recording(recording).displacement_um
    assert len(displacement_um) == len(reference_um), f"{recording}: {len(displacement_um)} samples"
    return bench.error_percent(displacement_um, reference_um, RATE_HZ)


def run(loop: Loop, drive_s: float, seconds: float) -> dict[str, tuple[float, float]]:
    """The whole loop; returns the error of each of MODELS, rms and max in %."""
    bits, min_V, max_V = loop.dac.split(":")
    limits = "--min-V", min_V, "--max-V", max_V
    loop.do("rdpi", "excite", "commission", *limits, "--sample-rate", str(RATE_HZ), "--duration", f"{drive_s:g}",
            "-o", "excitation.csv", quiet=False)
    excitation = loop.play("excitation.csv", "excitation")

    seen = read_recording(excitation)
    lowest_um, highest_um = seen.displacement_um.min(), seen.displacement_um.max()
    stroke_um = SHARE * (highest_um - lowest_um)
    reference_um = bench.paper_profile(PROFILE, RATE_HZ, seconds, stroke_um) + (lowest_um + highest_um - stroke_um) / 2
    slope, offset = np.polyfit(seen.displacement_um, seen.command_V, 1)  # no model: the best straight line
    line_V = np.clip(slope * reference_um + offset, float(min_V), float(max_V))
    for name, column, values in (("reference", "reference_um", reference_um), ("line", "command_V", line_V)):
        np.savetxt(loop.out / f"{name}.csv", np.column_stack([np.arange(len(values)) / RATE_HZ, values]), "%.9g", ",",
                   header=f"time_s,{column}", comments="")

    errors = {MODELS[0]: error_percent(loop.play("line.csv", "line"), reference_um)}
    for model, options in ((MODELS[1], ["--rate-independent"]), (MODELS[2], [])):
        loop.do("rdpi", "fit", excitation, *options, *limits, "--dac-bits", bits, "-o", f"{model}.json", quiet=False)
        tracked = loop.track(f"{model}.json", "reference.csv", model)
        errors[model] = error_percent(tracked, reference_um)
    loop.do("rdpi", "simulate", f"{MODELS[2]}.json", tracked, quiet=False)  # how well the model explains what was seen
    return errors


def dac(text: str) -> str:
    """As lockstep.dac, but as it was written."""
    lockstep.dac(text)
    return text


def number(low: float) -> Callable[[str], float]:
    """A finite number above `low`, as an option's type."""
    def parse(text: str) -> float:
        value = float(text)
        if not low < value < math.inf:
            raise ValueError(text)
        return value
    parse.__name__ = "number"  # in argparse's message
    return parse


def main() -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("loop: ended"))  # so that what it has started ends with it
    parser = argparse.ArgumentParser(description="The whole loop on a board: excite, record, identify, track, report.")
    parser.add_argument("--actuator", choices=("preisach", "bouc-wen", "paper"), default="preisach",
                        help="the virtual one")
    parser.add_argument("--port", help="serial port of a real board; without it, the board is emulated")
    parser.add_argument("--preset", default="qemu-m4f", help="the board (default: %(default)s)")
    parser.add_argument("--dac", type=dac, default="16:0:100", metavar="BITS:MIN_V:MAX_V",
                        help="volts at the actuator over the board's codes (default: %(default)s)")
    parser.add_argument("--um-per-count", type=number(-math.inf), help="displacement sensor of a real board")
    parser.add_argument("--count-0-um", type=number(-math.inf), default=0.0, help="likewise: um at count 0")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "loop", help="folder of the results")
    parser.add_argument("--duration", type=number(0), default=8.0,
                        help="of the drive that identifies, s (default: %(default)s; the board holds 40 kB of it per "
                             "second)")
    parser.add_argument("--seconds", type=number(bench.SETTLED_S), default=2.0,
                        help="of the profile (default: %(default)s)")
    options = parser.parse_args()
    out = options.out.resolve()
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = open(out / "lock", "w")
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        parser.error(f"--out {out}: another loop runs there")
    except OSError as error:
        parser.error(f"--out {out}: {error.strerror}")
    if options.port and options.preset.startswith("qemu-"):
        parser.error(f"--preset {options.preset} is an emulator's; with --port give the board's")
    if options.port:
        if options.um_per_count is None:
            parser.error("--port needs --um-per-count: the scale of the board's displacement sensor")
        loop = OnTheBench(out, options.preset, options.dac, (options.um_per_count, options.count_0_um), options.port)
    elif options.preset not in MACHINES:
        parser.error(f"--preset {options.preset}: no emulated board with a bench link; give --port, or one of "
                     + ", ".join(MACHINES))
    else:
        loop = Emulated(out, options.preset, options.dac, options.actuator)
    print(f"in {out}:")
    errors = run(loop, options.duration, options.seconds)
    print(f"\nTracking error of the {PROFILE} profile, rms / max in % of its peak-to-peak")
    for model, (rms, peak) in errors.items():
        print(f"  {model:20}{rms:8.2f} / {peak:.2f}")
    (out / "loop.json").write_text(json.dumps(errors, indent=1) + "\n")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("loop: stopped")
