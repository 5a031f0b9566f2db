"""Recordings of actuators that are a model and an effect, for the tests of candidates and gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from plants import changed, model_of, recording, stack

from rdpi.data import Recording, excite
from rdpi.identify import Options, fit
from rdpi.model import Drive, Model, Rate
from rdpi.simulate import chain
from rdpi.simulate.effects import CATALOGUE

RATE_HZ = 1000.0
NOISE_UM = 0.004
LIMITS = excite.Limits(0.0, 100.0, sample_rate_hz=RATE_HZ)
Drives = tuple[tuple[str, dict, float], ...]  # kind and options of `rdpi excite`, and the share of the range about 50 V
COMMISSIONING: Drives = (
    ("sawtooth", {"cycles": 1}, 1.0), ("minor-loops", {"levels": 4}, 1.0), ("steps", {"levels": 4, "hold_s": 0.5}, 1.0),
    ("multisine", {"duration_s": 4.0, "seed": 1}, 1.0))
LATER: Drives = (
    ("sawtooth", {"frequencies_hz": (1.0, 4.0, 12.0), "cycles": 1}, 0.9), ("steps", {"levels": 3, "hold_s": 0.6}, 1.0),
    ("multisine", {"duration_s": 4.0, "seed": 7}, 0.8), ("sine", {"frequencies_hz": (2.0, 8.0), "cycles": 4}, 0.5))
FURTHER: Drives = (
    ("multisine", {"duration_s": 5.0, "seed": 21}, 1.0), ("minor-loops", {"levels": 3}, 0.8),
    ("steps", {"levels": 5, "hold_s": 0.5}, 0.9))


def entry(name: str, stage: str | None = None, **parameters: object) -> dict:
    """An effect as the model file holds it."""
    return {"name": name, "stage": stage or CATALOGUE[name].stages[0], "parameters": parameters}


def plain_model(law: float = 0.0, source: str = "displacement") -> Model:
    """plants.stack of 0 to 100 V."""
    return model_of(stack(law=law), drive=Drive(0.0, 100.0),
                    rate=Rate(source, window_s=0.002, max_um_per_s=1000.0, identified_um_per_s=500.0))


def drives(canned: Drives = LATER[:3], limits: excite.Limits = LIMITS) -> list[Recording]:
    """Drives without displacement, with another axis that moves."""
    found = []
    for kind, options, share in canned:
        columns, _ = excite.make_drive(kind, limits, **options)
        command = limits.middle_V + share * (columns["command_V"] - limits.middle_V)
        other = 5 * np.sin(np.arange(len(command)) / 100)
        found.append(recording(command, None, limits.sample_rate_hz, f"{kind} {share}.csv", other_axis_V=other))
    return found


def recorded(model: Model, runs: Sequence[Recording], *entries: dict, seed: int = 1) -> list[Recording]:
    """Recordings of the actuator that is the model with these effects."""
    random = np.random.default_rng(seed)
    return [changed(run, displacement_um=found.predicted_um + NOISE_UM * random.standard_normal(len(run)))
            for run, found in zip(runs, chain.simulate(replace(model, effects=list(entries)), runs))]


@lru_cache(maxsize=None)
def commissioned() -> Model:
    """What `rdpi fit` makes of the plain model's recordings, passport included.

    They start in the middle of the range, and do not show that a sweep leaves the plain model's plays at x.
    """
    model = fit(recorded(plain_model(), drives(COMMISSIONING)), Options(rate_independent=True)).model
    model.memory = replace(model.memory, sweep_share=0.0)
    return model


def rms(vector: np.ndarray) -> float:
    return float(np.sqrt(np.mean(vector**2)))


def left_um(model: Model, runs: Sequence[Recording]) -> float:
    """rms of what the model leaves of these recordings, each one's mean removed."""
    left = [run.displacement_um - found.predicted_um for run, found in zip(runs, chain.simulate(model, runs))]
    return rms(np.concatenate([part - np.mean(part) for part in left]))
