"""Runs firmware images in QEMU; for the tests beside it."""

from __future__ import annotations

import math
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from rdpi.board import emulator, telemetry
from rdpi.board.profile import render_reference
from rdpi.data import read_recording, sample_times, write_recording
from rdpi.firmware import write_header
from rdpi.model import Model

ROOT = Path(__file__).resolve().parents[2]
# An instruction takes 2^shift ns of emulated time, less than on these boards, so that single precision in software has
# time at 20 kHz on a Cortex-M0 too: what is tested is what the firmware does. What it costs, tests/benchmark counts.
# QEMU's timers on the STM32F405 run at 1 GHz instead of 84 MHz: it needs all the instructions that there are.
SHIFT = {board: 0 if board == "stm32f405" else 1 for board in emulator.BOARDS}


class Builder:
    """Configures and builds track for a board, a reference in um and a number of samples per second.

    One build folder per board: the next image takes the place of the one before.
    """

    def __init__(self, model: Model, folder: Callable[[str], Path]) -> None:
        self.model, self.new_folder = model, folder
        self.folders: dict[str, Path] = {}

    def __call__(self, board: str, reference_um: np.ndarray, rate_hz: int, number: str, *options: str) -> Path:
        """The image."""
        if board not in self.folders:
            self.folders[board] = self.new_folder(board)
        folder = self.folders[board]
        columns = {"time_s": sample_times(len(reference_um), rate_hz), "reference_um": reference_um}
        write_recording(folder / "reference.csv", columns, {"sample_rate_hz": rate_hz})
        write_header(self.model, folder / "rdpi_params.h")
        reference = read_recording(folder / "reference.csv", required=("time_s", "reference_um"))
        (folder / "rdpi_profile.h").write_text(render_reference(reference))
        window = max(16, math.ceil(self.model.rate.window_s * rate_hz))
        for command in (["cmake", "--fresh", "-S", ROOT, "-B", folder / "build", "--preset", board,
                         f"-DRDPI_PARAMS_DIR={folder}", f"-DRDPI_TRACK_RATE_HZ={rate_hz}",
                         f"-DRDPI_TRACK_Q31={number == 'q31'}", f"-DRDPI_MAX_WINDOW={window}", *options],
                        ["cmake", "--build", folder / "build", "--target", "track"]):
            done = subprocess.run(command, capture_output=True, text=True)
            assert done.returncode == 0, done.stdout + done.stderr
            assert "warning" not in done.stdout + done.stderr
        return folder / "build" / "track"


def over(decoder: telemetry.Decoder) -> bool:
    """Whether the target says that it has come to its end, or refuses to run."""
    return decoder.info is not None and decoder.info.state >= telemetry.FINISHED


def run(image: Path, board: str, silent_s: float = 30) -> telemetry.Decoder:
    """Run an image until it says that it has finished, or refuses to run; its telemetry up to there.

    A watchdog ends it where nothing comes for so long.
    """
    decoder, stream = telemetry.Decoder(board), image.with_name("telemetry")
    stream.write_bytes(b"")
    clock = f"shift={SHIFT[board]},sleep=off"  # emulated time does not wait for the host's
    # a file takes every byte at once
    with (emulator.emulate(image, board, "-serial", f"file:{stream}", "-icount", clock) as process,
          open(stream, "rb") as file):
        heard = time.monotonic()
        while not over(decoder):
            assert process.poll() is None, "the emulator stopped"
            assert time.monotonic() - heard < silent_s, f"nothing for {silent_s:g} s: {decoder.counts}"
            time.sleep(0.02)
            if data := file.read():
                decoder.feed(data)
                decoder.check()
                heard = time.monotonic()
    decoder.finish()
    return decoder
