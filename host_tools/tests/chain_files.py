"""Models, recordings and a reference as files, for the tests of the commands that use a model."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from plants import model_of, quasi_static, rate_of, recording, stack, waves

from rdpi.data import Recording, sample_times, write_recording
from rdpi.model import Rate, write_model


def write_files(folder: Path) -> Path:
    """A model without rate law, static.json, one with, moving.json, and recordings of these plants."""
    write_model(folder / "static.json", model_of(stack(law=0)))
    write_model(folder / "moving.json", model_of(stack(), rate=Rate("control", max_um_per_s=1000.0)))
    for name, run in recordings().items():
        write_recording(folder / name, run.columns, run.metadata)
    write_reference(folder / "reference.csv", reference(), note="a wish")
    return folder


def write_reference(name: str | Path, reference_um: np.ndarray, **metadata: str) -> None:
    write_recording(name, {"time_s": sample_times(len(reference_um), 1000), "reference_um": reference_um}, metadata)


def recordings() -> dict[str, Recording]:
    """large.csv from rest, carried.csv after it, and fast.csv with the rate law, the rate being the control's."""
    plant, other = stack(law=0), stack()
    large = np.r_[waves(90, 2, 2, 1000), np.linspace(0, 50, 100)]
    small, fast = waves(20, 5, 2, 1000, 50), waves(80, 10, 3, 2000)
    return {
        "large.csv": quasi_static(plant, large, noise_um=0.01, other_axis_V=np.arange(1100.0)),
        "carried.csv": quasi_static(plant, small, noise_um=0.01, memory="carried"),
        "fast.csv": recording(fast, other.respond(fast, 0.13 * rate_of(fast, 2000)), 2000, noise_um=0.01),
    }


def reference() -> np.ndarray:
    return np.r_[waves(9, 4, 1.5, 1000, 0.0)[:375], np.full(50, 9.0), np.linspace(9, 3, 175)]


def result_of(rdpi: Callable, *arguments: object, status: int = 0) -> tuple[dict, str]:
    done = rdpi(*arguments, "--json", "result.json")
    assert done.exit_code == status, done.output
    return json.loads(Path("result.json").read_text()), done.output


def change_model(name: str = "static.json", **changes: object) -> None:
    write_model(name, replace(model_of(stack(law=0)), **changes))


COMMANDS = {"simulate": ("large.csv", "out.csv"), "compensate": ("reference.csv", "out.csv"),
            "plot": ("large.csv", "out.png"), "header": (None, "out.h")}


def refusal(rdpi: Callable, command: str, model: str, source: str | None = None, *arguments: object) -> str:
    """The message with which the command refuses; no file is touched, be there an output already or not."""
    usual, output = COMMANDS[command]
    sources = [source or usual] if usual else []
    for existing in (False, True):
        if existing:
            Path(output).write_text("as it was\n")
        before = {path: path.read_bytes() for path in Path().iterdir()}
        done = rdpi(command, model, *sources, "-o", output, *arguments)
        assert done.exit_code == 2, done.output
        assert done.output.startswith("rdpi: ") and done.output.count("\n") == 1 and "Traceback" not in done.output
        assert {path: path.read_bytes() for path in Path().iterdir()} == before
    return done.output.removeprefix("rdpi: ").strip()
