"""Creep for ten hours at 20 kHz, in the library in single precision and in double."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = 10 * 3600 * 20000


@pytest.mark.long
def test_ten_hours_of_creep_lose_nothing(tmp_path: Path) -> None:
    program = tmp_path / "chain"
    folders = [f"-I{ROOT / folder}" for folder in ("lib/include", "lib/src", "tests/support")]
    sources = [ROOT / "tests/property/chain.c", ROOT / "lib/src/rdpi_f32.c", ROOT / "lib/src/rdpi_f32_chain.c"]
    subprocess.run(["cc", "-std=c99", "-O2", *folders, *sources, "-lm", "-o", program], check=True)
    done = subprocess.run([program, str(SAMPLES)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout  # it holds the states within 1e-4 of the stroke
    assert re.match(rf"{SAMPLES} samples at 20 kHz, 10.0 h", done.stdout)
