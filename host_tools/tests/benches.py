"""Recordings of the virtual benches of tests/bench, which share no code with rdpi."""

from __future__ import annotations

import sys

import numpy as np
from conftest import ROOT

from rdpi.data import Recording, sample_times

sys.path.insert(0, str(ROOT / "tests" / "bench"))

import bench as vb  # noqa: E402


def swept_and_played(bench: vb.Bench, command_V: np.ndarray, rate_hz: float, name: str) -> Recording:
    """What a bench shows of a drive, swept to the middle of its range before."""
    bench.demagnetise(rate_hz)
    columns = {"time_s": sample_times(len(command_V), rate_hz), "command_V": command_V,
               "displacement_um": bench.run(command_V, rate_hz)}
    return Recording(name, {"sample_rate_hz": f"{rate_hz:g}", "memory": "reset"}, columns, f"sha256:{name}")
