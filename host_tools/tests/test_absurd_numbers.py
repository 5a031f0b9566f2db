"""Finite numbers that no actuator has: every command ends with a result or with words, and without NumPy's warnings."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from models import random_model
from rdpi.data import sample_times, write_recording
from rdpi.model import write_model

SAMPLES = 200
MODEL = random_model(3)
TIME_S = sample_times(SAMPLES, 1000)
RANGE_V = MODEL.drive.min_V, MODEL.drive.max_V
COMMAND_V = np.mean(RANGE_V) + 0.4 * np.ptp(RANGE_V) * np.sin(2 * np.pi * 10 * TIME_S)
DISPLACEMENT_UM = MODEL.gain_um_per_V * (COMMAND_V - MODEL.offset_V)

SCALES = 1e200, 1e30, 1e-300, 0.0
COLUMNS = {"command": ["command_V"], "displacement": ["displacement_um"], "reference": ["reference_um"],
           "both": ["command_V", "displacement_um"], "covariate": ["other_axis_V"]}
COMMANDS = {
    "plot": ["plot", "m.json", "r.csv", "-o", "p.png"],
    "simulate": ["simulate", "m.json", "r.csv", "-o", "s.csv"],
    "offset": ["simulate", "m.json", "r.csv", "--remove-offset"],
    "compensate": ["compensate", "m.json", "r.csv", "-o", "c.csv"],
    "q31": ["compensate", "m.json", "r.csv", "-o", "c.csv", "--engine", "q31", "--remove-offset"],
    "profile": ["profile", "r.csv", "-o", "p.h"],
    "drive": ["profile", "r.csv", "-o", "p.h", "--dac", "16:0:10"],
    "import": ["import", "r.csv", "-o", "i.csv"],
    "resample": ["import", "r.csv", "-o", "i.csv", "--resample", "500"],
    "score": ["score", "r.csv", "--report", "pages"],
    "aligned": ["import", "r.csv", "--drive", "usual.csv", "-o", "i.csv"],
    "played": ["import", "usual.csv", "--drive", "r.csv", "-o", "i.csv"],
    "fit": ["fit", "r.csv", "-o", "f.json", "--operators", "3"],
    "gap": ["gap", "m.json", "r.csv"],
}
SLOW = "plot", "score", "fit", "gap"


@pytest.fixture
def quiet() -> Iterator[None]:
    """A warning of NumPy is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


@pytest.mark.parametrize(("command", "scales"), [
    *(pytest.param(name, SCALES, marks=[pytest.mark.long] if name in SLOW else []) for name in COMMANDS),
    *(pytest.param(name, SCALES[:1], marks=pytest.mark.slow) for name in SLOW)])
def test_absurd_numbers(command: str, scales: Sequence[float], rdpi: Callable, quiet: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                        ) -> None:
    monkeypatch.chdir(tmp_path)
    write_model("m.json", MODEL)
    columns = {"time_s": TIME_S, "command_V": COMMAND_V, "displacement_um": DISPLACEMENT_UM,
               "reference_um": DISPLACEMENT_UM, "other_axis_V": COMMAND_V}
    write_recording("usual.csv", columns, {})
    cases = [(names, lambda values, scale=scale: values / np.abs(values).max() * scale)
             for scale in scales for names in COLUMNS.values()]
    cases += [(names, lambda values: np.where(TIME_S == 0.1, 1e200, values)) for names in COLUMNS.values()]
    for names, change in cases:
        write_recording("r.csv", {name: change(values) if name in names else values
                                  for name, values in columns.items()}, {})
        result = rdpi(*COMMANDS[command])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code == 0 or result.exit_code == 2 and "rdpi: " in result.output, result.output
        assert "Warning" not in result.output


def test_plot_of_an_absurd_displacement(rdpi: Callable, tmp_path: Path) -> None:
    write_model(tmp_path / "m.json", MODEL)
    write_recording(tmp_path / "r.csv", {"time_s": TIME_S, "command_V": COMMAND_V,
                                         "displacement_um": np.where(TIME_S == 0.1, 1e200, 0)}, {})
    result = rdpi("plot", tmp_path / "m.json", tmp_path / "r.csv", "-o", tmp_path / "p.png")
    assert result.exit_code == 2 and not (tmp_path / "p.png").exists()
    assert result.output.startswith(f"rdpi: {tmp_path / 'r.csv'}, sample 100: displacement_um is 1e+200, beyond")
