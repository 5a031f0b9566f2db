"""What tests of `rdpi record`, `rdpi import --telemetry` and of the decoder share: a stream, and what becomes of it."""

from __future__ import annotations

from pathlib import Path

from streams import samples

from rdpi.board import Decoder
from rdpi.data import read_recording

SENT = samples(3000)
WITHOUT_A_FEW = [sample for sample in SENT if sample.sequence not in (1000, 1001, 1800)]


def decode(data: bytes, size: int = 1 << 20) -> Decoder:
    decoder = Decoder("board")
    for start in range(0, len(data), size):
        decoder.feed(data[start:start + size])
    decoder.finish()
    return decoder


def codes(path: Path) -> list[float]:
    return read_recording(path, ("command_V",)).columns["dac_code"].tolist()


def part(run_csv: Path, number: str = "") -> Path:
    return run_csv.with_name(f"run.csv.part{number}")
