"""examples/loop on an emulated Cortex-M4F: what the board records is what the bench saw, and tracking gets better."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import tty
from pathlib import Path

import numpy as np
import pytest

from rdpi.board import telemetry
from rdpi.data import read_recording

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "examples/loop"))

import loop as example  # noqa: E402

pytestmark = pytest.mark.slow


class NoisyLine(example.Emulated):
    """Between board and recorder, a line that damages one byte in a hundred."""

    def listen(self, port: str, name: str) -> subprocess.Popen:
        board = os.open(port, os.O_RDONLY | os.O_NOCTTY)
        tty.setraw(board)
        ours, recorders = os.openpty()
        tty.setraw(recorders)
        threading.Thread(target=self._forward, args=(board, ours), daemon=True).start()
        return super().listen(os.ttyname(recorders), name)

    @staticmethod
    def _forward(board: int, recorder: int) -> None:
        random = np.random.default_rng(20261121)
        with contextlib.suppress(OSError):  # until the emulator ends
            while data := os.read(board, 4096):
                damaged = np.frombuffer(data, np.uint8).copy()
                hit = random.random(len(damaged)) < 0.01
                damaged[hit] ^= random.integers(1, 256, int(hit.sum()), np.uint8)
                rest = damaged.tobytes()
                while rest:
                    rest = rest[os.write(recorder, rest):]


def received(folder: Path, name: str) -> telemetry.Decoder:
    decoder = telemetry.Decoder(name)
    decoder.feed((folder / f"{name}.raw").read_bytes())
    decoder.finish()
    return decoder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("loop")


@pytest.fixture(scope="module")
def errors(folder: Path) -> dict[str, tuple[float, float]]:
    return example.run(example.Emulated(folder, "qemu-m4f", "16:0:100", "preisach"), 4.0, 1.0)


def is_the_benchs_own_log(folder: Path, name: str) -> None:
    """Every sample of a run: number, code and reading, sweep included."""
    decoder, log = received(folder, name), np.load(folder / f"{name}.npy")
    samples = decoder.runs[0].samples
    assert (decoder.counts.missing, decoder.counts.corrupt, decoder.counts.unconfirmed) == (0, 0, 0)
    assert len(samples) > 9000
    sent = np.column_stack([samples[key] for key in ("tick", "dac_code", "adc_counts")])
    assert (sent == log[:len(samples)]).all()
    run = read_recording(folder / f"{name}.csv")
    first = int(run.metadata["first_tick"]) - 1
    assert (run.columns["dac_code"] == log[first:first + len(run), 1]).all()


def test_telemetry_is_the_benchs_own_log(tmp_path: Path) -> None:
    board = example.Emulated(tmp_path, "qemu-m4f", "16:0:100", "preisach")
    board.do("rdpi", "excite", "multisine", "--min-V", "0", "--max-V", "100", "--sample-rate", str(example.RATE_HZ),
             "--duration", "1", "-o", "drive.csv")
    board.play("drive.csv", "played")
    is_the_benchs_own_log(tmp_path, "played")


@pytest.mark.long
def test_tracking_gets_better_with_the_model(errors: dict[str, tuple[float, float]], folder: Path) -> None:
    """Both fits of this short drive find a lag and need no rate law beside it, so that their models are the same."""
    line, independent, dependent = (errors[model][0] for model in example.MODELS)
    print(f"rms: {line:.2f}, {independent:.2f} and {dependent:.2f} %")
    assert max(independent, dependent) < 0.2 * line
    assert max(independent, dependent) < 0.6
    for name in ("excitation", "line", *example.MODELS[1:]):
        is_the_benchs_own_log(folder, name)


@pytest.mark.long
def test_of_a_line_that_damages_bytes_every_loss_is_counted(errors: dict, folder: Path) -> None:
    """1 % of bytes: no sample that is believed differs from the bench's log, and what is not there is counted."""
    noisy = NoisyLine(folder / "noisy", "qemu-m4f", "16:0:100", "preisach")
    image = folder / "build" / "excitation"
    noisy.record(image, "excite", "noisy")
    decoder, log = received(noisy.out, "noisy"), np.load(noisy.out / "noisy.npy")
    samples, info = decoder.runs[0].samples, decoder.runs[0].infos[-1]
    assert 0.1 < decoder.counts.lost / info.offered_count < 0.5
    assert len(samples) + decoder.counts.lost == info.offered_count
    assert info.refused_count == info.overruns == 0
    assert (np.column_stack([samples["dac_code"], samples["adc_counts"]]) == log[samples["tick"] - 1, 1:]).all()
    run = read_recording(noisy.out / "noisy.csv")
    first = int(run.metadata["first_tick"]) - 1
    assert (run.columns["dac_code"] == log[first:first + len(run), 1]).all()
    assert run.metadata["telemetry_lost"] == str(decoder.counts.lost)
