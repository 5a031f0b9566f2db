"""Processor in the loop: the firmware, examples/track, built for a board and run in QEMU on a reference.

Needs the project's checkout: the one that this package lies in, or that RDPI_HOME names. Emulated time follows the
count of instructions, with room for so many per sample that no board loses one; what they cost on silicon is another
matter.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ..data import Recording
from ..errors import BadInput
from ..firmware import (NO_REFERENCE, Chain, FixedPoint, Steps, build_options, check_sample_time, engine,
                        write_header)
from ..model import Model
from . import profile, telemetry
from .serial import refusal

MACHINES = {"qemu-m0": "microbit", "qemu-m3": "mps2-an385", "qemu-m4f": "mps2-an386", "qemu-m7": "mps2-an500"}
BOARDS = MACHINES | {"stm32f405": "netduinoplus2"}  # whose timers are not its own: for tests only
TOOLS = {"cmake": "cmake", "make": "make", "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
         "qemu-system-arm": "qemu-system-arm"}  # and the Debian packages that have them
PER_SAMPLE, PER_SAMPLE_SOFT = 16_000, 64_000  # instructions, at least; the second where floats are software
SOFT = "qemu-m0", "qemu-m3"
SILENT_S = 30.0
POLL_S = 0.01


def step(model: Model, reference_um: np.ndarray, run: Recording, board: str, fixed_point: bool = False,
         sweep: bool = False, chain: Chain = Chain(), report: Callable[[float], None] = lambda fraction: None,
         swept: int = 0) -> Steps:
    """The drive that the firmware on `board`, a key of MACHINES, makes of references at the rate of `run`.

    With `sweep` the start-up sweep comes first, and is left out. Another one ended `swept` samples before the first
    reference; 0: there was none. The firmware itself looks ahead in the references, as far as `chain` needs it.

    Raises BadInput for a model or a rate that this firmware cannot have, for tools that are missing, and for samples
    that the board loses.
    """
    rate_hz = profile.integer_rate_hz(run)
    with tempfile.TemporaryDirectory(prefix="rdpi-") as folder:
        image = build(model, reference_um, run, board, fixed_point, Path(folder), sweep, chain, swept)
        before = len(engine(model, 1 / rate_hz, "q31" if fixed_point else "f32").sweep()[1]) if sweep else 0
        decoder = _run(image, board, rate_hz, before + len(reference_um), report)
    return _steps(decoder, board, rate_hz, len(reference_um))


def build(model: Model, reference_um: np.ndarray, run: Recording, board: str, fixed_point: bool, folder: Path,
          sweep: bool = False, chain: Chain = Chain(), swept: int = 0) -> Path:
    """Build the application for references at the rate of `run`; returns the image, in `folder`."""
    if not model.drive.dac_bits:
        raise BadInput("the firmware outputs DAC codes, but the model has no drive.dac_bits: give --dac-bits")
    _require_tools()
    home, rate_hz = checkout(), profile.integer_rate_hz(run)
    check_sample_time(model, 1 / rate_hz)
    write_header(model, folder / "rdpi_params.h", source="model", chain=chain)
    if fixed_point:  # the integers themselves: as the host rounds them
        integers = FixedPoint(model, 1 / rate_hz).references(reference_um).tolist()
        references = [profile.NONE if number == NO_REFERENCE else str(number) for number in integers]
    else:
        references = profile.literals(reference_um)
    (folder / "rdpi_profile.h").write_text(profile.render(run, rate_hz, references))
    options = [f"-DRDPI_PARAMS_DIR={folder}", f"-DRDPI_TRACK_RATE_HZ={rate_hz}",
               f"-DRDPI_TRACK_SWEEP={'ON' if sweep else 'OFF'}", f"-DRDPI_TRACK_SWEPT={swept}",
               f"-DRDPI_TRACK_Q31={'ON' if fixed_point else 'OFF'}",
               *(f"-D{name}={need}" for name, need in build_options(model, rate_hz, chain).items())]
    _make([["cmake", "--preset", board, "-S", str(home), "-B", str(folder / "build"), *options],
           ["cmake", "--build", str(folder / "build"), "--target", "track"]], board, len(reference_um))
    return folder / "build" / "track"


def checkout() -> Path:
    """The project's checkout."""
    named = os.environ.get("RDPI_HOME")
    folders = [Path(named)] if named else Path(__file__).resolve().parents
    for folder in folders:
        if (folder / "CMakePresets.json").is_file() and (folder / "examples/track/main.c").is_file():
            return folder.resolve()
    raise BadInput(f"RDPI_HOME is {named}: this is not a checkout of rdpi" if named else
                   "the engines qemu-... build the firmware from a checkout of rdpi, and this installation is not in "
                   "one: set RDPI_HOME to the directory of the checkout")


def _require_tools() -> None:
    missing = [name for name in TOOLS if shutil.which(name) is None]
    if missing:
        raise BadInput(f"the engines qemu-... need {', '.join(missing)}: "
                       f"apt-get install {' '.join(TOOLS[name] for name in missing)}")


def _make(commands: list[list[str]], board: str, samples: int) -> None:
    for command in commands:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", stdin=subprocess.DEVNULL)
        output = done.stdout + done.stderr
        if done.returncode == 0:
            continue
        if overflow := re.search(r"region `flash' overflowed by (\d+) bytes", output):
            fit = max(samples - math.ceil(int(overflow[1]) / 4), 0)
            raise BadInput(f"{samples} samples do not fit into the flash of {board}; {fit} do. Shorten the reference, "
                           "or use a board with more flash")
        reason = next((line for line in output.splitlines()
                       if re.search("error:|Error at|overflowed|left for the stack", line)), output[-300:])
        raise BadInput(f"the build of the firmware for {board} failed: {' '.join(reason.split())}")


@contextlib.contextmanager
def emulate(image: Path, board: str, *options: str) -> Iterator[subprocess.Popen]:
    """QEMU running an image; it ends with the context."""
    command = ["qemu-system-arm", "-M", BOARDS[board], "-display", "none", "-monitor", "none", *options,
               "-kernel", str(image)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                          text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def _run(image: Path, board: str, rate_hz: int, samples: int,
         report: Callable[[float], None]) -> telemetry.Decoder:
    """Run an image until it says that it has come to its end."""
    decoder = telemetry.Decoder(board)
    stream = image.with_name("telemetry")
    stream.touch()
    per_sample = PER_SAMPLE_SOFT if board in SOFT else PER_SAMPLE
    shift = min(max(int(math.log2(1e9 / rate_hz / per_sample)), 0), 10)  # 2^shift ns per instruction
    # into a file, which takes every byte at once: a pipe that is full would hold up the line, but not the board's time
    with emulate(image, board, "-serial", f"file:{stream}", "-icount", f"shift={shift},sleep=off") as process, \
            open(stream, "rb") as file:
        heard, frames = time.monotonic(), 0
        while decoder.info is None or decoder.info.state < telemetry.FINISHED:
            data = file.read(1 << 20)
            decoder.feed(data)
            decoder.check()
            if decoder.counts.samples + decoder.counts.infos > frames:
                heard, frames = time.monotonic(), decoder.counts.samples + decoder.counts.infos
                report(decoder.counts.samples / samples)
            elif process.poll() is not None:
                raise BadInput(f"{board}: qemu-system-arm ended early: {' '.join(process.stderr.read().split())}")
            elif time.monotonic() - heard > SILENT_S:
                raise BadInput(f"{board}: no data for {SILENT_S:g} s after {decoder.counts.samples} of {samples} "
                               "samples")
            elif not data:
                time.sleep(POLL_S)
    decoder.finish()
    return decoder


def _steps(decoder: telemetry.Decoder, board: str, rate_hz: int, samples: int) -> Steps:
    info, counts, frames = decoder.info, decoder.counts, decoder.runs[-1].samples
    frames = frames[frames["flags"] & telemetry.SWEEP == 0]
    if info.state >= telemetry.REFUSED:
        raise BadInput(f"{board}: the firmware refuses to run: {refusal(info)}")
    if info.overruns or counts.missing or counts.corrupt or info.held_count or len(frames) != samples:
        raise BadInput(f"{board}: the run is not complete: {len(frames)} of {samples} samples, {info.overruns} ticks "
                       f"lost at {rate_hz} samples per second, {info.refused_count} samples not sent, {counts.corrupt} "
                       f"frames corrupt, {info.held_count} codes not taken; a lower rate may help")
    return Steps(telemetry.volts(info, frames["dac_code"]), telemetry.rates_um_per_s(info, frames),
                 frames["flags"].astype(np.uint32), frames["dac_code"].copy())
