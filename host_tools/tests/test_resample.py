"""`rdpi import --resample`: a clock that jitters, a rate higher than needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rdpi.data import read_recording, sample_times
from rdpi.data.resample import GAP, MOST, PASS, STOP, resample
from rdpi.errors import BadInput

RATE_HZ = 1000


def jittered(share: float, samples: int = 4000, seed: int = 1) -> np.ndarray:
    """Times of a clock of which every step is off by this share, rms."""
    random = np.random.default_rng(seed)
    return np.concatenate([[0.0], np.cumsum((1 + share * random.normal(size=samples - 1)) / RATE_HZ)])


def tone(time_s: np.ndarray, hz: float) -> np.ndarray:
    return np.sin(2 * np.pi * hz * time_s)


def place(row: int) -> str:
    return f"row {row}"


def test_import_refuses_jitter_and_names_what_helps(rdpi: Callable, tmp_path: Path) -> None:
    time_s = jittered(0.03)
    lines = [f"{t!r},{u!r},{u / 2!r}" for t, u in zip(time_s.tolist(), tone(time_s, 5).tolist())]
    (tmp_path / "run.csv").write_text("time_s,command_V,displacement_um\n" + "\n".join(lines) + "\n")
    refused = rdpi("import", tmp_path / "run.csv", "-o", tmp_path / "out.csv")
    assert refused.exit_code == 2 and "`rdpi import --resample`" in refused.output
    done = rdpi("import", tmp_path / "run.csv", "--resample", "1000", "-o", tmp_path / "out.csv")
    assert done.exit_code == 0, done.output
    run = read_recording(tmp_path / "out.csv")
    assert run.sample_rate_hz == 1000 and "jitter 3 % rms" in run.metadata["resampled"]
    assert f"resampled {run.metadata['resampled']}" in done.output
    np.testing.assert_allclose(run.command_V, tone(run.time_s, 5), atol=1e-3)


@pytest.mark.parametrize("rate_hz", [1000, 1234, 400, 100])
def test_what_the_new_rate_can_hold_is_kept(rate_hz: float) -> None:
    time_s = jittered(0.03)
    hz = min(PASS * rate_hz, RATE_HZ / 25)
    found = resample("run.csv", {"time_s": time_s, "x": tone(time_s, hz)}, rate_hz, place)
    inner = slice(len(found.columns["x"]) // 10, -len(found.columns["x"]) // 10)
    np.testing.assert_allclose(found.columns["x"][inner], tone(found.columns["time_s"], hz)[inner], atol=0.02)
    np.testing.assert_allclose(np.diff(found.columns["time_s"]), 1 / rate_hz, atol=2e-9)


def test_what_the_new_rate_cannot_hold_is_taken_out() -> None:
    """At 100 per second 110 Hz would look like 10 Hz."""
    time_s = sample_times(8000, RATE_HZ)
    for hz in (STOP * 100 * 1.02, 110):
        found = resample("run.csv", {"time_s": time_s, "x": tone(time_s, hz)}, 100, place)
        assert found.filtered and np.abs(found.columns["x"][50:-50]).max() < 2e-3


def test_the_same_rate_leaves_uniform_samples_alone() -> None:
    time_s = sample_times(1000, RATE_HZ)
    found = resample("run.csv", {"time_s": time_s, "x": tone(time_s, 200)}, RATE_HZ, place)
    assert not found.filtered and found.jitter < 1e-6
    np.testing.assert_allclose(found.columns["x"], tone(time_s, 200), atol=1e-9)


@pytest.mark.parametrize("clock", [1 - 1e-5, 1 + 1e-5, 1.01])
def test_nearly_the_same_rate_is_not_filtered(clock: float) -> None:
    """Which side of its nominal rate a clock runs on must not decide: a filter would ring beyond a step's ends."""
    time_s = sample_times(1000, RATE_HZ) / clock
    found = resample("run.csv", {"time_s": time_s, "x": (time_s > 0.5).astype(float)}, RATE_HZ, place)
    assert not found.filtered and found.columns["x"].min() == 0 and found.columns["x"].max() == 1


def test_steps_do_not_overshoot() -> None:
    """A reversal that was not there would be hysteresis."""
    time_s = jittered(0.1)
    found = resample("run.csv", {"time_s": time_s, "x": (time_s > 2).astype(float)}, 1500, place)
    assert (np.diff(found.columns["x"]) >= 0).all() and set(found.columns["x"][[0, -1]]) == {0.0, 1.0}


def test_gaps_are_refused() -> None:
    time_s = np.delete(jittered(0.03), slice(700, 702))
    with pytest.raises(BadInput, match="row 700: .* --resample does not fill gaps; .* --rows"):
        resample("run.csv", {"time_s": time_s, "x": time_s}, 1000, place)
    assert np.diff(time_s).max() > GAP / RATE_HZ


@pytest.mark.parametrize("rate_hz", [1.01 * MOST * RATE_HZ, 1e-9, 1.0])
def test_rates_that_make_no_sense_are_refused(rate_hz: float) -> None:
    time_s = sample_times(4000, RATE_HZ)
    with pytest.raises(BadInput, match="^run.csv"):
        resample("run.csv", {"time_s": time_s, "x": time_s}, rate_hz, place)


def test_absurd_times_are_refused() -> None:
    with np.errstate(all="raise"), pytest.raises(BadInput, match="^run.csv"):
        resample("run.csv", {"time_s": np.linspace(-1, 1, 100) * 1.7e308, "x": np.zeros(100)}, 1000, place)
