"""Actuators that are the model, written out literally, and recordings of them: the truth that fits are held against.

The input is u = V - offset_V, or offset_V - V for an inverted actuator, in V; slopes are in um/V, so that nothing
depends on the gain that a fit chooses. Shares no code with identify, chain, operators or the library.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from rdpi.data import Recording, sample_times
from rdpi.model import Drive, Memory, Model, Rate


@dataclass
class Plant:
    """Plays (eq. 1, 9), slopes that change with the rate (eq. 14), dead zones (eq. 7, 8); arrays (n + 1,), (m + 1,)."""

    thresholds_V: np.ndarray
    slopes: np.ndarray  # um/V at rest
    changes: np.ndarray  # um/V per um/s
    deadzones_um: np.ndarray
    weights: np.ndarray
    offset_um: float = 0.0
    offset_V: float = 0.0
    inverted: bool = False
    states: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self.settle(self.offset_V)

    def input(self, command_V: np.ndarray | float) -> np.ndarray | float:
        return (self.offset_V - command_V) if self.inverted else (command_V - self.offset_V)

    def settle(self, command_V: float) -> None:
        """A decaying sweep ends here."""
        self.states = np.full(len(self.thresholds_V), self.input(command_V))

    def slopes_at(self, rate_um_per_s: float) -> np.ndarray:
        return self.slopes + self.changes * rate_um_per_s

    def weights_at(self, rate_um_per_s: np.ndarray) -> np.ndarray:
        """Of the plays, for each rate; shape (samples, n + 1)."""
        return np.diff(self.slopes_at(np.asarray(rate_um_per_s)[:, None]), prepend=0.0)

    def respond(self, command_V: np.ndarray, rate_um_per_s: np.ndarray) -> np.ndarray:
        """Displacement in um, going on from the present state."""
        v = np.empty(len(command_V))
        for k, (u, weights) in enumerate(zip(self.input(command_V), self.weights_at(rate_um_per_s))):
            self.states = np.maximum(u - self.thresholds_V, np.minimum(u + self.thresholds_V, self.states))
            v[k] = weights @ self.states
        return self._saturate(v) + self.offset_um

    def drive(self, displacement_um: np.ndarray, rate_um_per_s: np.ndarray) -> np.ndarray:
        """The command in V at which the displacement is this, going on from the present state."""
        command_V = np.empty(len(displacement_um))
        far = 1e4
        knots = np.r_[-far, self.deadzones_um, far]
        wanted_um = np.interp(displacement_um - self.offset_um, self._saturate(knots), knots)
        for k, (v, weights) in enumerate(zip(wanted_um, self.weights_at(rate_um_per_s))):
            # v is piecewise linear in u, with these corners
            corners = np.sort(np.r_[-far, self.states - self.thresholds_V, self.states + self.thresholds_V, far])
            moved = np.clip(self.states, corners[:, None] - self.thresholds_V, corners[:, None] + self.thresholds_V)
            u = np.interp(v, moved @ weights, corners)
            self.states = np.clip(self.states, u - self.thresholds_V, u + self.thresholds_V)
            command_V[k] = self.offset_V - u if self.inverted else self.offset_V + u
        return command_V

    def _saturate(self, v_um: np.ndarray) -> np.ndarray:
        return self.weights[0] * v_um + sum(
            weight * np.maximum(v_um - d, 0) for d, weight in zip(self.deadzones_um[1:], self.weights[1:]))


def stack(span_V: float = 90.0, plays: int = 9, law: float = 1.0, **changes: object) -> Plant:
    """A plant of about 12 um over `span_V`, its thresholds where a fit to that span puts them by default.

    Its slopes bend as measured ones do and fall with the rate; `law` 1: the lowest reaches zero at 2900 um/s, 0: no
    dependence on the rate. Two dead zones.
    """
    up = np.arange(plays + 1) / max(plays, 1)
    slopes = 0.15 * (0.65 + 0.45 * (1 - (1 - up) ** 1.5))
    fall = law * (0.1 + 0.9 * (1 - up) ** 2) / 2900
    plant = Plant(np.arange(plays + 1) * span_V / 2 / (plays + 1), slopes, -fall * slopes, np.array([0.0, 4.0, 8.0]),
                  np.array([1.0, -0.06, -0.08]))
    return replace(plant, **changes)


def waves(high: float, hertz: float, cycles: float, rate_hz: float, low: float = 0.0) -> np.ndarray:
    """Raised cosines from `low` to `high` and back, one sample short of whole cycles."""
    phase = 2 * np.pi * hertz / rate_hz * np.arange(round(cycles * rate_hz / hertz))
    return low + (high - low) * (1 - np.cos(phase)) / 2


def rate_of(signal: np.ndarray, rate_hz: float) -> np.ndarray:
    """Difference over one sample, 0 at the first."""
    return np.abs(np.diff(signal, prepend=signal[0])) * rate_hz


def recording(command_V: np.ndarray, displacement_um: np.ndarray | None, rate_hz: float, name: str = "run.csv",
              memory: str = "reset", noise_um: float = 0.0, **columns: np.ndarray) -> Recording:
    everything = {"time_s": sample_times(len(command_V), rate_hz), "command_V": command_V}
    if displacement_um is not None:
        noise = np.random.default_rng(len(name) + len(command_V)).standard_normal(len(command_V))
        everything["displacement_um"] = displacement_um + noise_um * noise
    metadata = {"sample_rate_hz": f"{rate_hz:.12g}", "memory": memory}
    return Recording(name, metadata, {**everything, **columns}, f"sha256:{name}")


def changed(run: Recording, **columns: np.ndarray) -> Recording:
    return replace(run, columns={**run.columns, **columns})


def marked(run: Recording, **metadata: str) -> Recording:
    return replace(run, metadata={**run.metadata, **metadata})


def quasi_static(plant: Plant, command_V: np.ndarray, rate_hz: float = 1000.0, **options: object) -> Recording:
    """A recording of the plant at rate 0, going on from its present state."""
    return recording(command_V, plant.respond(command_V, np.zeros(len(command_V))), rate_hz, **options)


def thresholds_um(plant: Plant, runs: list[Recording]) -> tuple[float, ...]:
    """The plant's thresholds r_1 ... r_n as a fit to these runs counts them, by its gain of stroke per command."""
    gain = max(np.ptp(run.displacement_um) for run in runs) / max(np.ptp(run.command_V) for run in runs)
    return tuple(plant.thresholds_V[1:] * gain)


def slopes_um_per_V(model: Model, rate_um_per_s: float = 0.0) -> np.ndarray:
    return abs(model.gain_um_per_V) * model.slopes_at(rate_um_per_s)


def model_of(plant: Plant, gain_um_per_V: float = 0.13, **changes: object) -> Model:
    """The same plant as a model, at rest at its offset; rates up to 1000 um/s, drive -20 to 120 V from the offset."""
    gain = -gain_um_per_V if plant.inverted else gain_um_per_V
    below, above = (120, 20) if plant.inverted else (20, 120)
    thresholds = plant.thresholds_V * gain_um_per_V
    return Model(**{**dict(
        gain_um_per_V=gain, offset_V=plant.offset_V, offset_um=plant.offset_um, stroke_um=12.0,
        thresholds_um=thresholds, slopes=plant.slopes / gain_um_per_V,
        slope_rate_s_per_um=plant.changes / gain_um_per_V,
        deadzones_um=plant.deadzones_um, deadzone_weights=plant.weights, rate=Rate(max_um_per_s=1000.0),
        drive=Drive(plant.offset_V - below, plant.offset_V + above),
        memory=Memory(0.0, np.zeros(len(thresholds))), actuator="stack 7"), **changes})
