"""What an effect is: a physical block with one to three bounded parameters, at its own place in the chain.

    command -> DAC -> timing -> amplifier -> (monitor_V) -> actuator -> mechanics -> environment -> sensor

An effect acts on the drive in V, on the operator's parameters, or on the displacement in um. One class in one file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from ... import firmware
from ...data import Past, Recording
from ...firmware import Block
from ...model import LARGEST, Model
from ..memory import past_of
from .spectra import Spectra
from .treatment import Sensor, Treatment

if TYPE_CHECKING:
    from .planned import PlannedDrive, Shown

STAGES = "DAC", "timing", "amplifier", "actuator", "mechanics", "environment", "sensor"
BEFORE_MONITOR = STAGES[:3]
SENSOR = STAGES[-1]
Values = Mapping[str, float]


class Parameter(NamedTuple):
    """A number of an effect. Physics bounds it; a fit never leaves the bounds."""

    name: str
    unit: str
    low: float
    high: float
    absent: float = 0.0  # the value at which the effect does nothing
    # how a report writes it
    internal: bool = False  # a simulation needs it, a reader does not
    digits: int = 3  # where no interval says how many it is worth
    joined: str = "of"  # to the title: "a signal delay of 0.5 ms"

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest finite value: the firmware's largest number bounds what physics does not."""
        return max(self.low, -LARGEST), min(self.high, LARGEST)


@dataclass(frozen=True, eq=False)
class Residuals:
    """What an effect may look at to choose where a fit starts: recordings, their prediction and what it leaves."""

    model: Model
    runs: Sequence[Recording]
    predicted_um: Sequence[np.ndarray]  # (samples,) per run
    residual_um: Sequence[np.ndarray]  # measured - predicted, without each run's mean
    drive_residual_um: Sequence[np.ndarray]  # the same of what monitor_V shows, in um; residual_um without a monitor

    @cached_property
    def spectra(self) -> Spectra:
        return Spectra.of(self.runs, self.predicted_um, self.residual_um)


class Effect:
    """One effect at one stage; stateless: its block says what it remembers."""

    name: ClassVar[str]
    title: ClassVar[str]  # in plain words
    what: ClassVar[str]  # physically
    remedy: ClassVar[str]  # what to do about it on the bench
    needs: ClassVar[str]  # what recordings must hold for it to be seen
    article: ClassVar[str] = ""  # of the title: "a", "an", or none ("creep")
    look: ClassVar[str] = ""  # a sentence: what tells it from its like in the pictures
    stages: ClassVar[tuple[str, ...]]  # where it may act; the first unless a monitor tells more
    shows_stage: ClassVar[bool] = False  # ... or the recorded values themselves
    on_drive: ClassVar[bool] = False  # acts on the drive although no monitor shows it: last before the operator
    parameters: ClassVar[tuple[Parameter, ...]]
    linear: ClassVar[bool] = False  # the displacement is linear in the parameters, at least while they are small
    of_column: ClassVar[str | None] = None  # the covariate that it follows by default; None: it follows none
    several: ClassVar[bool] = False  # a chain may hold it more than once at a stage
    # --- how it is estimated
    of_rig: ClassVar[bool] = False  # stands around the operator of ordinary rigs; `fit` looks for it unless told not to
    needs_rates: ClassVar[bool] = False  # with strokes of a single rate it looks like a loop
    needs_loops: ClassVar[bool] = False  # with strokes of a single size it does
    # Narrower bounds of parameters where `fit` looks for it; narrower still of an effect that recordings limit.
    on_rig: Mapping[str, tuple[float, float]] = {}
    in_holds: ClassVar[str | None] = None  # the parameter by which it alone moves on while the drive stands still
    in_gap: ClassVar[Mapping[str, tuple[float, float]]] = {}  # likewise where `gap` does
    comes_late: ClassVar[bool] = False  # the displacement comes late by it, as it does by others of its kind
    late_by: ClassVar[str | None] = None  # the parameter that is the time by which slow movements come late
    rings: ClassVar[bool] = False  # at a frequency of its own
    stands_still: ClassVar[bool] = False  # for a while at reversals, and then follows without a jump
    slow: ClassVar[bool] = False  # goes on for seconds, as loops that drift do
    disturbance: ClassVar[bool] = False  # estimated anew in every recording, never carried to another
    differs_anyway: ClassVar[bool] = False  # recordings of an unchanged rig differ by it: by what was before them
    starts_memory: ClassVar[bool] = False  # acts by where the plays start, and by nothing else
    moves_zero: ClassVar[bool] = False  # the zero is estimated along with it
    tells_zero: ClassVar[bool] = False  # recordings do not lie where it says they would: it is not there
    frequency: ClassVar[str | None] = None  # the parameter that is the frequency of a line in the spectrum
    # --- how it compares with others
    # Shrink that it brings where nothing is wrong, with the model frozen and with the model refitted beside it. From
    # the 'none' controls of the tuning set of tests/withheld.
    chance_gain: ClassVar[tuple[float, float]] = 0.0, 0.0
    contains: ClassVar[type[Effect] | None] = None  # a simpler effect, which it can imitate
    comes_up: ClassVar[bool] = True  # may come up after the identification; else it can only change where there is one
    changes_loops: ClassVar[bool] = False  # at a single rate, all that do look alike
    grows_with_rate: ClassVar[bool] = False  # slow recordings do not show it
    hides_rate: ClassVar[bool] = False  # it is what a missing rate dependence looks like at another rate

    def __init__(self, stage: str | None = None, column: str | None = None) -> None:
        self.stage = self.stages[0] if stage is None else stage
        self.column = self.of_column if column is None else column
        if self.stage not in self.stages:
            raise ValueError(f"{self.name} does not act at {self.stage}")

    def __repr__(self) -> str:
        return f"{self.name}({self.stage})"

    def least_gain(self, values: Values) -> float:
        """Share of the squares that it must take away, where it makes up for other misfit."""
        return 0.0

    def past_um(self, values: Values, run: Recording, model: Model) -> float:
        """How far a recording may go on by what was before it, where no sweep was before it."""
        return 0.0

    @property
    def before_monitor(self) -> bool:
        """Whether monitor_V shows it."""
        return self.stage in BEFORE_MONITOR

    @property
    def drives(self) -> bool:
        """Whether it acts on the drive."""
        return self.before_monitor or self.on_drive

    @property
    def ahead(self) -> bool:
        """Whether it acts on the drive or on the operator, not on the displacement."""
        return self.drives or type(self).operator is not Effect.operator

    def replaces(self, other: Effect) -> bool:
        """Whether a chain that holds the other cannot hold this one beside it, only in its place."""
        return not self.several and self.is_as(other)

    def is_as(self, other: Effect) -> bool:
        """Whether both are the same effect at the same place."""
        return (self.name, self.stage, self.column) == (other.name, other.stage, other.column)

    def late_starts(self, residuals: Residuals) -> list[tuple[dict[str, float], float]]:
        """What rings: where a fit may start if what it gets comes late, and by how much, s; none: it would not help."""
        return []

    def amplification(self, values: Values, highest_hz: float) -> float:
        """The most that it makes of a slow movement's size, at frequencies up to this one."""
        return 1.0

    def rings_within(self, stroke_s: float, values: Values) -> bool:
        """Whether strokes of this time show it by a ringing of its own, although they all have the same rate."""
        return False

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names of the parameters that a fit moves; the others stay where it starts."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def options(self) -> dict[str, str]:
        """What else an entry of the model file's list `effects` must hold to make this effect again."""
        return {} if self.column is None else {"column": self.column}

    def unit(self, parameter: Parameter) -> str:
        """Of a parameter, at this stage."""
        return parameter.unit

    def reading_step_um(self, values: Values) -> float:
        """Step of the grid that readings stand on: no prediction takes away its rounding. 0: it makes no grid."""
        return 0.0

    def missing_in(self, run: Recording, values: Values) -> str:
        """What a recording lacks for it to be predicted; "": nothing."""
        return f"has no column {self.column}" if self.column and self.column not in run.columns else ""

    def within(self, values: Values, runs: Sequence[Recording]) -> Values:
        """Parameters as these recordings show them: what none of them reaches is absent."""
        return values

    def absent(self) -> dict[str, float]:
        """Parameters at which it does nothing."""
        return {parameter.name: parameter.absent for parameter in self.parameters}

    @classmethod
    def variants(cls, runs: Sequence[Recording]) -> list[Effect]:
        """The effect everywhere that these recordings may show it."""
        return [cls(stage) for stage in cls.stages]

    @staticmethod
    def wrong_column(column: object) -> str | None:
        """What is wrong with a column to follow; None: nothing."""
        return None

    @staticmethod
    def refusal(values: Values) -> str | None:
        """What is wrong with parameters that are each within bounds; None: nothing."""
        return None

    def block(self, values: Values, model: Model, sample_time_s: float) -> Block | None:
        """What it does to the drive in V, if it acts on it, or to the displacement in um; None: nothing."""
        return None

    def act(self, signal: np.ndarray, run: Recording, values: Values, model: Model) -> np.ndarray:
        """The signal (samples,) that leaves this stage: the drive in V if the effect acts on it, else the displacement
        in um, and run.command_V then is what drove the actuator.
        """
        block = self.block(values, model, run.sample_time_s)
        if block is None or not len(signal):
            return signal
        past = past_of(run, model) if block.of_actuator else Past()
        bank = firmware.Bank([block])
        bank.start(float(signal[0]), past=past)
        return bank.run(signal, driven_V=run.command_V)[0]

    def drive(self, drive_V: np.ndarray, run: Recording, values: Values, model: Model) -> np.ndarray:
        """The drive in V (samples,) that leaves this stage."""
        return self.act(drive_V, run, values, model) if self.drives else drive_V

    def operator(self, model: Model, values: Values) -> Model:
        """The model with the changed operator."""
        return model

    def displacement(self, z_um: np.ndarray, run: Recording, values: Values, model: Model) -> np.ndarray:
        """The displacement in um (samples,) that leaves this stage."""
        return z_um if self.drives else self.act(z_um, run, values, model)

    def before(self, shown_um: np.ndarray, run: Recording, values: Values) -> np.ndarray:
        """What has to come in where it rings, for this to come out; um, (samples,)."""
        return shown_um

    def columns(self, run: Recording, values: Values, model: Model) -> np.ndarray:
        """Disturbances: what is fitted to each recording by itself, um, (samples, columns)."""
        raise NotImplementedError

    def summary(self, values: Values, sizes: Sequence[np.ndarray], samples: Sequence[int]) -> dict[str, float]:
        """Disturbances: the parameters that say how large the columns are; of the parameters that the columns were
        made with and of each recording's coefficients and samples.
        """
        raise NotImplementedError

    def usual_sizes(self, values: Values) -> np.ndarray:
        """Disturbances: coefficients of the columns that these parameters stand for, (columns,)."""
        raise NotImplementedError

    def starts(self, residuals: Residuals) -> list[dict[str, float]]:
        """Parameters from which a fit starts; none: these recordings do not excite it."""
        raise NotImplementedError

    def hidden(self, residuals: Residuals) -> bool:
        """Whether these recordings cannot show it."""
        return not self.starts(residuals)

    def treated(self, values: Values, model: Model, folded_into: Model) -> Treatment:
        """What the firmware does about it. `model` is the one whose effect this is; `folded_into` has the operator that
        will be inverted, with what others have folded into it.
        """
        raise NotImplementedError

    def less_sensor(self, values: Values, sensor: Sensor) -> tuple[Values, Sensor]:
        """The parameters without what is the sensor's, and what of the sensor's is left to take away elsewhere."""
        return values, sensor

    def shown(self, drive: PlannedDrive) -> Shown | None:
        """From which to which size a drive will show it; None: `rdpi excite` says nothing about it."""
        return None


def low_pass(signal: np.ndarray, sample_time_s: float, time_constant_s: float) -> np.ndarray:
    """First-order lag of unit gain, settled at first, exact for a signal that is straight between samples."""
    return signal + firmware.lags(signal, sample_time_s, [time_constant_s], [0.0])

