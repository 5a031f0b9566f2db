"""Creep for ten hours at 20 kHz, in the library in single precision, in double and in fixed point."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = 10 * 3600 * 20000


def build(program: Path, *sources: str) -> None:
    folders = [f"-I{ROOT / folder}" for folder in ("lib/include", "lib/src", "tests/support")]
    files = [ROOT / source for source in sources]
    subprocess.run(["cc", "-std=c99", "-O2", *folders, *files, "-lm", "-o", program], check=True)


@pytest.mark.long
def test_ten_hours_of_creep_lose_nothing(tmp_path: Path) -> None:
    program = tmp_path / "chain"
    build(program, "tests/property/chain.c", "lib/src/rdpi_f32.c", "lib/src/rdpi_f32_chain.c")
    done = subprocess.run([program, str(SAMPLES)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout  # it holds the states within 1e-4 of the stroke
    assert re.match(rf"{SAMPLES} samples at 20 kHz, 10.0 h", done.stdout)


@pytest.mark.long
def test_ten_hours_of_creep_in_fixed_point_lose_nothing(tmp_path: Path) -> None:
    program = tmp_path / "chain"
    sources = (f"lib/src/{name}.c" for name in ("rdpi_q31", "rdpi_q31_chain", "status"))
    build(program, "tests/property/chain_q31.c", *sources)
    done = subprocess.run([program, "10"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout  # it holds the states within 1e-4 of the stroke
    assert "10.0 hours at 20 kHz" in done.stdout
