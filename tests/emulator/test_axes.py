"""Two axes on one emulated board: each as if it were alone, and examples/stage, where they move each other."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench import paper_profile
from boards import Builder, run

from rdpi.board import telemetry
from rdpi.board.profile import render_reference
from rdpi.data import read_recording, sample_times, write_recording
from rdpi.firmware import write_header
from rdpi.model import Drive, Model

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "examples/stage"))

import stage as example  # noqa: E402

BOARD, RATE_HZ = "qemu-m4f", 10_000

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def models(model: Model) -> list[Model]:
    """Another gain, range and start-up sweep, which takes longer."""
    return [model, replace(model, gain_um_per_V=0.8 * model.gain_um_per_V,
                           drive=Drive(-20.0, 120.0, None, 15, sweep_cycles=30))]


@pytest.fixture(scope="module")
def references_um() -> list[np.ndarray]:
    """The second is shorter."""
    return [paper_profile("5-20-35hz", RATE_HZ, 0.5), 0.7 * paper_profile("10hz", RATE_HZ, 0.3)]


def together(models: list[Model], references_um: list[np.ndarray], folder: Path, *options: str) -> list[np.ndarray]:
    """Samples of each axis of one board with both."""
    for axis, (model, reference_um) in enumerate(zip(models, references_um)):
        headers = folder / str(axis)
        headers.mkdir()
        write_header(model, headers / "rdpi_params.h")
        write_recording(headers / "reference.csv", {"time_s": sample_times(len(reference_um), RATE_HZ),
                                                    "reference_um": reference_um}, {"sample_rate_hz": RATE_HZ})
        reference = read_recording(headers / "reference.csv", required=("time_s", "reference_um"))
        (headers / "rdpi_profile.h").write_text(render_reference(reference))
    for command in (["cmake", "-S", ROOT, "-B", folder / "build", "--preset", BOARD, "-DRDPI_AXES=2",
                     f"-DRDPI_PARAMS_DIR={folder}/0;{folder}/1", f"-DRDPI_TRACK_RATE_HZ={RATE_HZ}", *options],
                    ["cmake", "--build", folder / "build", "--target", "track"]):
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "warning" not in done.stdout + done.stderr
    first = run(folder / "build/track", BOARD)
    second = telemetry.Decoder(BOARD, 1)
    second.feed((folder / "build/telemetry").read_bytes())
    assert (first.counts.missing, second.counts.missing, first.info.overruns) == (0, 0, 0)
    return [first.runs[0].samples, second.runs[0].samples]


@pytest.mark.parametrize("number", ["q31", pytest.param("f32", marks=pytest.mark.long)])
def test_each_axis_outputs_the_codes_of_its_own_single_axis_run(number: str, models: list[Model],
                                                                references_um: list[np.ndarray], tmp_path: Path) -> None:
    fixed = f"-DRDPI_TRACK_Q31={number == 'q31'}"
    both = together(models, references_um, tmp_path, fixed)
    for axis, (samples, model, reference_um) in enumerate(zip(both, models, references_um)):
        folder = tmp_path / f"alone-{axis}"
        folder.mkdir()
        alone = run(Builder(model, lambda name, folder=folder: folder)(BOARD, reference_um, RATE_HZ, number),
                    BOARD).runs[0].samples
        swept = int((alone["flags"] & telemetry.SWEEP != 0).sum())
        started = int((samples["flags"] & telemetry.SWEEP != 0).sum())
        assert started == max(swept, started) and np.ptp(alone["dac_code"].astype(int)) > 2**13
        for name in ("dac_code", "reference", "rate", "flags"):
            assert (samples[name][:swept] == alone[name][:swept]).all(), name
            ours = samples[name][started:started + len(reference_um)]
            assert len(ours) == len(alone) - swept == len(reference_um) and (ours == alone[name][swept:]).all(), name
        waits = samples["dac_code"][swept:started]
        assert (waits == samples["dac_code"][swept - 1]).all()
        ended = samples["dac_code"][started + len(reference_um):]
        assert (ended == alone["dac_code"][-1]).all() and len(ended) == (0 if axis == 0 else 2000)
    assert len(both[0]) == len(both[1])


@pytest.mark.long
def test_cross_coupling_is_taken_off(tmp_path: Path) -> None:
    """The error with it is that of axes which do not move each other, to a fifth; without, twice as large."""
    errors = example.run(example.Stage(tmp_path, BOARD, "16:0:100"), 3.0, 0.8)
    print(errors)
    for axis in example.AXES:
        assert errors["coupled"][axis] > 2 * errors["alone"][axis]
        assert errors["compensated"][axis] < 1.2 * errors["alone"][axis]
