"""examples/track as firmware for the STM32F405 in QEMU's machine netduinoplus2: the same image as on silicon. Every
sample has the code of the host's library, the DAC's driver took every code, no tick was lost, or rdpi.emulator raises
BadInput.

QEMU's timers run at 1 GHz instead of 84 MHz; at one instruction per ns, its fastest, a period has half as many
instructions as on silicon it has cycles. That is enough at 10 kHz.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from rdpi import emulator
from rdpi.firmware import engine
from rdpi.model import read_model
from rdpi.recording import read_recording, sample_times, write_recording

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/bench"))

from bench import paper_profile  # noqa: E402

RATE_HZ = 10_000


@pytest.mark.parametrize("profile", ["5-20-35hz", pytest.param("10hz", marks=pytest.mark.slow)])
@pytest.mark.parametrize("number", ["f32", pytest.param("q31", marks=pytest.mark.slow)])
def test_every_sample_is_the_hosts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, number: str, profile: str) -> None:
    monkeypatch.setitem(emulator.MACHINES, "stm32f405", "netduinoplus2")
    model = read_model(ROOT / "examples/track/params/model.json")
    reference_um = paper_profile(profile, RATE_HZ, 2.0)
    columns = {"time_s": sample_times(len(reference_um), RATE_HZ), "reference_um": reference_um}
    write_recording(tmp_path / "reference.csv", columns, {"sample_rate_hz": RATE_HZ})
    run = read_recording(tmp_path / "reference.csv", required=("time_s", "reference_um"))

    codes = emulator.step(model, reference_um, run, "stm32f405", fixed_point=number == "q31").dac_code.astype(int)

    expected = engine(model, 1 / RATE_HZ, number).step(reference_um).dac_code.astype(int)
    assert np.ptp(expected) > 2**14  # not a drive that stands still
    assert np.abs(codes - expected).max() <= (0 if number == "q31" else 1)
