"""examples/track as firmware for the STM32F405 in QEMU's machine netduinoplus2: the same image as on silicon. Every
sample has the code of the host's library, the DAC's driver took every code, no tick was lost.

QEMU's timers run at 1 GHz instead of 84 MHz; at one instruction per ns, its fastest, a period has half as many
instructions as on silicon it has cycles. That is enough at 10 kHz.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest

from rdpi import emulator, telemetry
from rdpi.firmware import engine
from rdpi.model import read_model
from rdpi.recording import read_recording, sample_times, write_recording

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/bench"))

from bench import paper_profile  # noqa: E402

BOARD = "stm32f405"
RATE_HZ = 10_000
LIMIT_S = 120.0


def run(image: Path) -> telemetry.Decoder:
    """Run an image until it says that it has finished, or refuses to run; its telemetry up to there."""
    decoder, stream = telemetry.Decoder(BOARD), image.with_name("telemetry")
    stream.touch()
    with (emulator.emulate(image, BOARD, "-serial", f"file:{stream}", "-icount", "shift=0,sleep=off") as process,
          open(stream, "rb") as file):
        begin = time.monotonic()
        while decoder.info is None or decoder.info.state not in (telemetry.FINISHED, telemetry.REFUSED):
            assert process.poll() is None, "the emulator stopped"
            assert time.monotonic() - begin < LIMIT_S, f"not finished after {LIMIT_S:g} s: {decoder.counts}"
            time.sleep(0.02)
            decoder.feed(file.read())
    decoder.finish()
    return decoder


@pytest.mark.parametrize("profile", ["5-20-35hz", pytest.param("10hz", marks=pytest.mark.slow)])
@pytest.mark.parametrize("number", ["f32", pytest.param("q31", marks=pytest.mark.slow)])
def test_every_sample_is_the_hosts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, number: str, profile: str) -> None:
    monkeypatch.setitem(emulator.MACHINES, BOARD, "netduinoplus2")
    model = read_model(ROOT / "examples/track/params/model.json")
    reference_um = paper_profile(profile, RATE_HZ, 2.0)
    columns = {"time_s": sample_times(len(reference_um), RATE_HZ), "reference_um": reference_um}
    write_recording(tmp_path / "reference.csv", columns, {"sample_rate_hz": RATE_HZ})
    reference = read_recording(tmp_path / "reference.csv", required=("time_s", "reference_um"))

    image = emulator.build(model, reference_um, reference, BOARD, number == "q31", tmp_path)
    decoder = run(image)

    info, counts, samples = decoder.info, decoder.counts, decoder.runs[0].samples
    codes = engine(model, 1 / RATE_HZ, number).step(reference_um).dac_code.astype(int)
    assert (info.status, info.overruns, info.refused_count, info.held_count) == (0, 0, 0, 0)
    assert (counts.samples, counts.missing, counts.corrupt) == (len(codes), 0, 0)
    assert np.ptp(codes) > 2**14  # not a drive that stands still
    assert np.abs(samples["dac_code"].astype(int) - codes).max() <= (0 if number == "q31" else 1)
