"""examples/track with its PI controller on an emulated Cortex-M4F: hand-over, and what the controller adds at 35 Hz."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from rdpi.data import Recording, read_recording, sample_times, write_recording

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "examples/shrink"), str(ROOT / "examples/loop"), str(ROOT / "tests/bench")]

import bench  # noqa: E402
import shrink as example  # noqa: E402

pytestmark = pytest.mark.slow

RATE_HZ = example.Board.rate_hz
KI = 0.3 / (1.5 / RATE_HZ + 53e-6)  # as examples/track/README.md advises; the bench's amplifier lags by 53 us
CLOSE_AT, MOVING = 1500, 3000  # samples: the second, of movement; then the reference stands still
OPEN_AT = MOVING + 500


class Board(example.Board):
    """Tracks with a controller where `loop` says so."""

    loop: tuple[str, ...] = ()

    def build(self, application: str, name: str, *options: str) -> Path:
        return super().build(application, name, *options, *self.loop)


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Board:
    """The actuator identified, in model.json, from recordings of the bench itself: test_loop.py has the board's."""
    board = Board(tmp_path_factory.mktemp("closed"), "qemu-m4f", example.DAC, "preisach")
    limits = "--min-V", "0", "--max-V", "100"
    board.do("rdpi", "excite", "commission", *limits, "--sample-rate", str(RATE_HZ), "--duration", "4", "-o", "drive.csv")
    drive_V = read_recording(board.out / "drive.csv", required=("time_s", "command_V")).command_V
    bench.record(bench.make("preisach", seed=1), drive_V, RATE_HZ, board.out / "commissioned.csv", {})
    # without effects: creep that is compensated goes on where the code is to stay
    board.do("rdpi", "fit", "commissioned.csv", *limits, "--effects", "none", "--dac-bits", "16", "-o", "model.json")
    return board


def tracked(board: Board, name: str, reference_um: np.ndarray, *loop: str) -> Recording:
    """The recording of a reference."""
    reference = board.out / f"{name}-reference.csv"
    columns = {"time_s": sample_times(len(reference_um), RATE_HZ), "reference_um": reference_um}
    write_recording(reference, columns, {"sample_rate_hz": RATE_HZ})
    board.loop = loop
    return read_recording(board.track("model.json", reference.name, name))


@pytest.fixture(scope="module")
def sine_um(board: Board) -> np.ndarray:
    """35 Hz over the profile's stroke."""
    moved_um = read_recording(board.out / "commissioned.csv").displacement_um
    wave = np.sin(2 * np.pi * 35 * np.arange(RATE_HZ) / RATE_HZ) * np.linspace(0, 5, RATE_HZ).clip(max=1)
    return (moved_um.max() + moved_um.min()) / 2 + example.loop.SHARE * np.ptp(moved_um) / 2 * wave


@pytest.mark.parametrize("number", ["f32", pytest.param("q31", marks=pytest.mark.long)])
def test_hand_over(number: str, board: Board, sine_um: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """Closing leaves the code that the open loop has; opening leaves the code that there is, or the next one where the
    reference lies between both.

    Without the sensor's noise: the controller passes it on, so that the codes differ by more from sample to sample.
    """
    monkeypatch.setattr(board, "settings", {"noise_um": 0.0})
    reference_um = np.append(sine_um[:MOVING], np.full(1000, sine_um[MOVING]))
    both = f"-DRDPI_TRACK_Q31={'ON' if number == 'q31' else 'OFF'}", "-DRDPI_TRACK_SWEEP=OFF"
    loop = ("-DRDPI_TRACK_LOOP=ON", f"-DRDPI_TRACK_KI={KI:.0f}", "-DRDPI_TRACK_KP=0.2",
            f"-DRDPI_TRACK_CLOSE_AT={CLOSE_AT}", f"-DRDPI_TRACK_OPEN_AT={OPEN_AT}")
    free = tracked(board, f"free-{number}", reference_um, *both).columns["dac_code"]
    code = tracked(board, f"handed-{number}", reference_um, *both, *loop).columns["dac_code"]
    assert (code[:CLOSE_AT + 1] == free[:CLOSE_AT + 1]).all()
    assert (code[CLOSE_AT + 1:] != free[CLOSE_AT + 1:]).mean() > 0.9
    assert (code[MOVING:OPEN_AT] != code[OPEN_AT - 1]).any(), "the controller works until then"
    assert np.ptp(code[OPEN_AT:]) == 0 and abs(code[OPEN_AT] - code[OPEN_AT - 1]) <= 1


@pytest.mark.long
def test_feedforward_is_worth_more_than_the_controller(board: Board, sine_um: np.ndarray) -> None:
    loop = "-DRDPI_TRACK_LOOP=ON", f"-DRDPI_TRACK_KI={KI:.0f}"
    errors = {}
    for name, options in (("inverse", ()), ("inverse and PI", loop), ("PI", (*loop, "-DRDPI_TRACK_FEEDFORWARD=OFF"))):
        seen = tracked(board, name.replace(" ", "-"), sine_um, *options)
        errors[name] = bench.error_percent(seen.displacement_um, sine_um, RATE_HZ)[0]
    print("rms at 35 Hz: " + ", ".join(f"{name} {percent:.2f} %" for name, percent in errors.items()))
    assert errors["inverse and PI"] < errors["PI"] / 5
    assert errors["inverse and PI"] < errors["inverse"] / 1.5
