"""The chain from command to displacement as one thing that runs from a state to a state.

`State` holds all that the chain remembers between two samples: plays, poles of relaxation and creep, lags, resonances,
delayed samples, the rate estimator's. Nothing else holds a part of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..data import Past, arguments
from ..errors import BadInput
from ..firmware import Bank, Block, Firmware, Held, operator_block
from ..model import LARGEST, Drive, Memory, Model
from . import effects
from .memory import entered_plays, from_middle, since_sweep_s

SAME_TIME = 1e-9  # relative difference of sample times that are one
LEAST_WINDOW = 3  # times what displacement changes with its rate: MANY of plant.c
MOST_SAMPLES = 1 << 16  # over which a rate is taken; more are needed by no actuator


@dataclass(frozen=True, eq=False)
class State:
    """All that a chain remembers between two samples."""

    held: Held
    of: str  # digest of the model
    sample_time_s: float

    @property
    def plays_um(self) -> np.ndarray:
        """States of the plays, (n + 1,)."""
        return self.held.plays_um


class Ran(NamedTuple):
    """What a plant did; arrays are (samples,)."""

    displacement_um: np.ndarray
    driven_V: np.ndarray  # the drive that reached the actuator
    operated_um: np.ndarray  # what the operator made of it
    rate_um_per_s: np.ndarray  # before the guard
    state: State


class Plant:
    """A model at a sample time: operator, effects, disturbances apart, and how their memory goes on.

    Raises BadInput for effects that are not known, and for a rate window that is too long.
    """

    def __init__(self, model: Model, sample_time_s: float) -> None:
        self.model, self.sample_time_s = model, sample_time_s
        self.acting = effects.acting(model)
        self.operator = effects.operator(self.acting, replace(model, effects=[]))
        self._of = model.digest()
        ahead = [(one, one.effect.block(one.values, self.operator, sample_time_s))
                 for one in self.acting if one.effect.drives]
        behind = [(one, one.effect.block(one.values, self.operator, sample_time_s))
                  for one in self.acting if not one.effect.drives]
        blocks = [block for _, block in ahead if block is not None]
        self._operator = len(blocks)
        blocks.append(operating(self.operator, sample_time_s))
        self._columns: list[tuple[int, effects.Acting]] = []  # effects of recorded columns, and the block before which
        for one, block in behind:
            if block is not None:
                blocks.append(block)
            elif one.effect.column is not None and not one.effect.disturbance:
                self._columns.append((len(blocks), one))
        self._bank = Bank(blocks)

    # --- states to begin with

    def settled(self, drive_V: float) -> State:
        """At rest for long at a drive, the plays as a decaying sweep leaves them."""
        return self.after(drive_V, self.operator.swept(self._x_um(drive_V)))

    def swept(self, drive_V: float) -> State:
        """After a decaying sweep that ended at a drive, before which creep had settled in the middle of the range."""
        x_um = self._x_um(drive_V)
        return self.after(drive_V, self.operator.swept(x_um),
                          from_middle(self.operator, x_um, since_sweep_s(self.sample_time_s)))

    def held(self, drive_V: float, end: str, rested_s: float | None = None) -> State:
        """Driven to the "low" or "high" end of its drive from the middle of the range and resting there, for `rested_s`
        or, if that is None, for long.
        """
        x_um = self._x_um(drive_V)
        past = Past() if rested_s is None else from_middle(self.operator, x_um, max(rested_s, self.sample_time_s))
        return self.after(drive_V, entered_plays(self.operator, x_um, end), past)

    def after(self, drive_V: float, plays_um: np.ndarray, past: Past = Past()) -> State:
        """The plays as given, the actuator's poles as `past` leaves them, and all else at rest at a drive, which the first
        sample has.
        """
        self._bank.start(drive_V, plays_um, past)
        return self.state

    @property
    def poles_s(self) -> np.ndarray:
        """Time constants of the actuator's relaxation and creep, s, (poles,)."""
        return np.concatenate([self.sample_time_s / block.ratios for block in self._bank.blocks if block.of_actuator]
                              or [np.zeros(0)])

    def driven_V(self, drive_V: float) -> float:
        """What reaches the actuator of a drive at rest."""
        return self._bank.passed_on(drive_V, self._operator)

    def _x_um(self, drive_V: float) -> float:
        return float(self.operator.x_of(self.driven_V(drive_V)))

    # --- running

    def run(self, drive_V: np.ndarray, state: State, columns: Mapping[str, np.ndarray] = {}) -> Ran:
        """A drive in V, (samples,), from a state on; `columns` are what else was recorded, which some effects follow.

        run(a + b) is run(a), then run(b) from its state. Raises BadInput for a state of another model or sample time.
        """
        self.state = state
        drive_V = np.asarray(drive_V, float)
        largest_V = float(np.max(np.abs(drive_V), initial=0.0))
        if not largest_V <= LARGEST:
            raise BadInput(f"the drive reaches {largest_V:.3g} V, beyond ±{LARGEST:g} V, the firmware's limit; check the "
                           "unit of command_V")
        operated_um, driven_V, rate = self._bank.run(drive_V, slice(self._operator + 1))
        shown_um = self._behind(operated_um, driven_V, columns)
        return Ran(shown_um, driven_V, operated_um, rate, self.state)

    def behind(self, operated_um: np.ndarray, driven_V: np.ndarray, state: State) -> np.ndarray:
        """Displacement in um of what the operator made of a drive, all (samples,), from a state on; recorded columns
        apart.
        """
        self.state = state
        return self._behind(operated_um, driven_V, {})

    def _behind(self, shown_um: np.ndarray, driven_V: np.ndarray, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        at = self._operator + 1
        for place, one in self._columns:
            shown_um, at = self._bank.run(shown_um, slice(at, place), driven_V)[0], place
            other = columns.get(one.effect.column)
            shown_um = shown_um if other is None else one.effect.added(shown_um, other, one.values)
        return self._bank.run(shown_um, slice(at, None), driven_V)[0]

    def step(self, drive_V: float) -> float:
        """`run` of one sample from the state at hand, without recorded columns: the displacement in um."""
        return self._bank.step(drive_V)

    @property
    def state(self) -> State:
        """All that it remembers at the moment; may be set. Raises BadInput for one of another model or sample time."""
        return State(self._bank.held, self._of, self.sample_time_s)

    @state.setter
    def state(self, state: State) -> None:
        if state.of != self._of:
            raise BadInput(f"the state is one of another model: {state.of[:15]}, this one is {self._of[:15]}")
        if abs(state.sample_time_s / self.sample_time_s - 1) > SAME_TIME:
            raise BadInput(f"the state is one of another sample time: {state.sample_time_s:g} s, this one is "
                           f"{self.sample_time_s:g} s")
        self._bank.held = state.held


class Simulator:
    """An actuator sample by sample, as a control loop meets it."""

    def __init__(self, model: Model, sample_time_s: float, start_V: float | None = None, state: State | None = None
                 ) -> None:
        """It goes on from `state`, or begins as a decaying sweep that ended at `start_V` leaves it, at the middle of the
        drive's range if neither is given. Columns of recordings, disturbances and noise are none of it.
        """
        self._plant = Plant(model, sample_time_s)
        if state is None:
            middle_V = (model.drive.min_V + model.drive.max_V) / 2
            state = self._plant.swept(middle_V if start_V is None else start_V)
        self._plant.state = state

    def step(self, drive_V: float) -> float:
        """Displacement in um after one sample of a drive in V."""
        return self._plant.step(drive_V)

    @property
    def state(self) -> State:
        """All that it remembers; may be set. Raises BadInput for one of another model or sample time."""
        return self._plant.state

    @state.setter
    def state(self, state: State) -> None:
        self._plant.state = state

    def run(self, drive_V: np.ndarray) -> np.ndarray:
        """Displacement in um, (samples,), of a drive in V, (samples,): as many steps."""
        return self._plant.run(arguments.series(drive_V, "drive_V"), self._plant.state).displacement_um


def unlimited(model: Model, sample_time_s: float, plays_um: np.ndarray) -> Firmware:
    """The compiled forward operator, its plays in these states.

    The model's drive range is what the inverse may output. An actuator goes wherever it is driven, and an effect ahead
    of it may drive it beyond the range: the operator takes every drive whose control input the firmware has numbers for.
    """
    reach_V = 0.999 * LARGEST / abs(model.gain_um_per_V)
    drive = Drive(max(-LARGEST, model.offset_V - reach_V), min(LARGEST, model.offset_V + reach_V))
    return Firmware(replace(model, drive=drive, memory=Memory(float(plays_um[0]), np.asarray(plays_um, float))),
                    sample_time_s, "f64", any_sample_time=True)


def operating(model: Model, sample_time_s: float) -> Block:
    """The operator as a block. Its rate law acts on what the guard leaves of the rate."""
    law = model.rate
    rates = 0.0, min(law.max_um_per_s, LARGEST) if np.any(model.slope_rate_s_per_um) else 0.0
    pieces = np.cumsum(model.deadzone_weights)
    longest = max(law.window_s, longest_s(model) if law.source == "displacement" else 0.0) / sample_time_s
    return operator_block(unlimited(model, sample_time_s, model.swept(0.0)), rates,
                          (-model.gain_um_per_V * model.offset_V, model.gain_um_per_V), law.source == "control",
                          float(np.max(pieces) / np.min(pieces)), 2 + int(min(longest, MOST_SAMPLES)))


def longest_s(model: Model) -> float:
    """Over how long the displacement's rate must be taken at most, so that the law has one answer, s; see plant.h."""
    apart_um = np.diff(model.thresholds_um)
    furthest_um = 2 * model.stroke_um  # of the play with the highest threshold, whatever is driven
    pieces = np.cumsum(model.deadzone_weights)
    by_rate_s = np.abs(model.slope_rate_s_per_um) @ np.append(apart_um, furthest_um)
    return float(LEAST_WINDOW * np.max(pieces)**2 / np.min(pieces) * by_rate_s)
