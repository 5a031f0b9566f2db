"""examples/shrink on an emulated Cortex-M4F: an effect appears, and the rebuilt firmware compensates what gap names."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from rdpi.data import read_recording

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "examples/shrink"))

import shrink as example  # noqa: E402

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ["delay", pytest.param(example.TOGETHER, marks=pytest.mark.long)])
def test_the_error_shrinks_as_promised(name: str, tmp_path: Path) -> None:
    """A delay of 1 ms; and one together with lag, creep and resonance."""
    board = example.Board(tmp_path, "qemu-m4f", example.DAC, "preisach")
    healthy, results = example.run(board, [name], 4.0, 1.0)
    example.print_table(healthy, results)
    assert (read_recording(tmp_path / f"{name}-before.csv").columns["dac_code"]
            == read_recording(healthy.tracked).columns["dac_code"]).all(), "the same firmware"
    one = results[name]
    assert one.before > 3 * healthy.error, "it is meant to hurt"
    assert one.after < min(0.3 * one.before, 3 * healthy.error)
    assert one.after < one.promised + 0.08 * one.before
    assert one.named
    if name == "delay":
        assert one.named == ["delay"]
        assert abs(one.after - one.promised) < 0.08 * one.before
