"""One identified actuator, as the model file holds it (schema rdpi-model/1).

Displacements are in um, drives in V, rates in um/s. `Model.validate` refuses everything that `rdpi_f32_init` refuses,
so that a model that was read can be flashed.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from .. import version
from ..data import arguments
from ..errors import BadInput
from . import validation
from .curves import along
from .documents import Document, json_key
from .limits import (EPSILON, LARGEST, LEAST_SAMPLE_S, MAX_DAC_BITS, MAX_DEADZONES, MAX_PLAYS, MAX_SWEEP_CYCLES,
                     MIN_SLOPE_RATIO, SWEEP_CYCLES, SWEEP_HZ, SWEEP_SAMPLES, TINY, Source)
from .records import EffectEntry, FitRecord, KeptRun, OperatorAlone, Passport
from .sweep import swept_states

SECTIONS = "rate", "drive", "memory"
NOT_NUMBERS = {*SECTIONS, "source", "extra", "tool", "actuator", "fit", "effects", "passport", "operator_alone", "kept",
               "where", "dac_bits", "sweep_cycles", "noise_shaping", "curve_V", "singular_um_per_s", "smoothing_s",
               "identified_um_per_s"}
WHOLE = "dac_bits", "sweep_cycles"
_OF_OPERATOR = ("gain_um_per_V", "offset_V", "offset_um", "stroke_um", "thresholds_um", "slopes",
                "slope_rate_s_per_um", "deadzones_um", "deadzone_weights")


@dataclass
class Rate(Document):
    """How the rate is estimated and where the guard clamps it; see rdpi_f32_params_t in lib/include/rdpi/f32.h."""

    source: Source = json_key("whose rate modulates the slopes", default="displacement")
    window_s: float = json_key("time over which the firmware takes a difference; 0: one sample", "s", low=0,
                               default=0.0)
    filter_s: float = json_key("time constant of the firmware's low-pass on the rate; 0: none", "s", low=0, default=0.0)
    max_um_per_s: float = json_key("guard: the firmware clamps the rate here", "um/s", default=math.inf, needed=True)
    singular_um_per_s: float | None = json_key("rate at which the first slope would reach zero; null: none falls",
                                               "um/s", default=None)
    min_slope_ratio: float = json_key("share of its value at rest that every slope keeps at the guard",
                                      default=MIN_SLOPE_RATIO)
    smoothing_s: float = json_key("zero-phase smoothing before the rate, in a simulation only", "s", low=0, default=0.0)
    identified_um_per_s: float | None = json_key("highest rate in the recordings of the fit", "um/s", default=None)


@dataclass
class Drive(Document):
    """What may be output."""

    min_V: float = json_key("lowest drive", "V", default=0.0, needed=True)
    max_V: float = json_key("highest drive", "V", default=1.0, needed=True)
    slew_V_per_s: float | None = json_key("fastest change of the drive; null: no limit", "V/s", default=None)
    dac_bits: int | None = json_key("bits of the DAC, whose codes span min_V to max_V; null: no codes", low=1,
                                    high=MAX_DAC_BITS, default=None)
    sweep_cycles: int = json_key("cycles of the start-up sweep", low=1, high=MAX_SWEEP_CYCLES, default=SWEEP_CYCLES)
    sweep_V_per_s: float | None = json_key(f"speed of the start-up sweep; null: {SWEEP_HZ:g} Hz over the whole range, "
                                           "or the slew limit if that is slower", "V/s", default=None)
    sweep_end_V: float | None = json_key("drive at which the start-up sweep ends; null: the one that holds the memory",
                                         "V", default=None)
    # The input curve that the firmware inverts, and no key of the file: points in V at the output and in V at the
    # plays, the ends of the range first and last. Empty: straight, the same V at both.
    curve_V: tuple[tuple[float, float], ...] = ()
    # Whether the firmware carries what a code misses to the next one; no key of the file either.
    noise_shaping: bool = False

    def at_plays(self, output_V: np.ndarray | float) -> np.ndarray | float:
        """Where the input curve leads drives."""
        return along(output_V, *zip(*self.curve_V)) if self.curve_V else output_V

    def at_output(self, plays_V: np.ndarray | float) -> np.ndarray | float:
        """The drives that the input curve leads there."""
        return along(plays_V, *reversed(list(zip(*self.curve_V)))) if self.curve_V else plays_V

    def sweep_speed(self) -> float:
        """Speed of the start-up sweep in V/s."""
        if self.sweep_V_per_s is not None:
            return self.sweep_V_per_s
        usual = min(2 * (self.max_V - self.min_V) * SWEEP_HZ, LARGEST)
        return usual if self.slew_V_per_s is None else min(usual, self.slew_V_per_s)


@dataclass
class Memory(Document):
    """The plays at the first sample."""

    x_um: float = json_key("control input", "um", default=0.0)
    plays_um: np.ndarray = json_key("output of each play; none: those of plays that came from 0", "um",
                                    default_factory=lambda: np.zeros(0))
    sweep_share: float | None = json_key("how far a decaying sweep takes the actuator's plays: 1: as far as their "
                                         "equations say, 0: they rest at the control input; null: not known, which "
                                         "simulations take for 0 and the firmware for 1", low=0, high=1, omitted=True)

    def followed_share(self) -> float:
        """The share that the firmware takes."""
        return 1.0 if self.sweep_share is None else self.sweep_share


@dataclass(kw_only=True)
class Model(Document):
    """One actuator.

    Arrays are float64: thresholds, slopes, slope rates (n + 1,), dead zones and weights (m + 1,). `fit`, `effects` and
    `passport` are JSON as it was read. What uses them checks them first: identify.checks, simulate.effects,
    identify.passport_file.
    """

    SCHEMA: ClassVar[str] = "rdpi-model/1"

    tool: str = json_key("version of rdpi that wrote the file", default="")
    actuator: str = json_key("name of the actuator", default="")
    gain_um_per_V: float = json_key("gain of the control input: x = gain_um_per_V (V - offset_V)", "um/V")
    offset_V: float = json_key("drive at which the control input x is 0", "V")
    offset_um: float = json_key("measured displacement at which the model's is 0", "um")
    stroke_um: float = json_key("peak-to-peak displacement of the recordings", "um", low=0)
    thresholds_um: np.ndarray = json_key("thresholds r_0 = 0 < r_1 < ... < r_n of the plays", "um")
    slopes: np.ndarray = json_key("slopes W_0 ... W_n of the loading curve at rest")
    slope_rate_s_per_um: np.ndarray = json_key("change c_0 ... c_n of each slope with the rate: W_i + c_i rate", "s/um")
    deadzones_um: np.ndarray = json_key("dead zones d_0 = 0 < d_1 < ... < d_m of the saturation stage", "um")
    deadzone_weights: np.ndarray = json_key("weights ws_0 ... ws_m of the dead zones")
    rate: Rate = json_key("the rate that modulates the slopes, and its guard")
    drive: Drive = json_key("what may be output")
    memory: Memory = json_key("state of the plays at the first sample; without it, all are 0", needed=False)
    fit: dict[str, Any] = json_key("the recordings of the fit", holds=FitRecord, default_factory=dict)
    effects: list[Any] = json_key("effects that act beside the operator; `rdpi header` says what the firmware does "
                                  "about each",
                                  holds=list[EffectEntry], default_factory=list)
    passport: Any = json_key("what the model misses of the recordings of its fit; null: not known",
                             holds=Passport | None, default=None)
    operator_alone: Any = json_key("the operator fitted as if nothing stood around it, for an inverse that compensates "
                                   "no effect; null: that of the model", holds=OperatorAlone | None, default=None,
                                   omitted=True)
    kept: Any = json_key("copies of the recordings of the fit, written by `rdpi fit --keep`; null: none",
                         holds=list[KeptRun] | None, default=None, omitted=True)
    where: str = "model"  # names it in messages: the file that it was read from, beside whose folder `kept` lies

    def __post_init__(self) -> None:
        self._take_kinds(self.where)
        if len(self.memory.plays_um) == 0:
            self.memory.plays_um = np.clip(0.0, self.memory.x_um - self.thresholds_um,
                                           self.memory.x_um + self.thresholds_um)

    def slopes_at(self, rate_um_per_s: float | np.ndarray) -> np.ndarray:
        """W_i(rate), eq. 14; shape (..., n + 1). No guard."""
        return self.slopes + np.multiply.outer(rate_um_per_s, self.slope_rate_s_per_um)

    def x_of(self, command_V: np.ndarray | float) -> np.ndarray | float:
        """Control input in um."""
        return self.gain_um_per_V * (self.drive.at_plays(command_V) - self.offset_V)

    def drive_of(self, x_um: np.ndarray | float) -> np.ndarray | float:
        """Drive in V that makes this control input."""
        return self.drive.at_output(x_um / self.gain_um_per_V + self.offset_V)

    def start_V(self) -> float:
        """Drive in V that holds the memory: the firmware starts from it."""
        return float(self.drive_of(self.memory.plays_um[0]))

    def swept(self, x_um: float) -> np.ndarray:
        """States of the plays after a decaying sweep over the range of the drive that ended at this control input."""
        ends = float(self.x_of(self.drive.min_V)), float(self.x_of(self.drive.max_V))
        return swept_states(x_um, self.thresholds_um, ends, self.memory.sweep_share or 0.0)

    def sweep_end(self) -> float:
        """Drive in V at which the start-up sweep ends."""
        if self.drive.sweep_end_V is not None:
            return self.drive.sweep_end_V
        return float(min(max(self.start_V(), self.drive.min_V), self.drive.max_V))

    def validate(self, where: str | None = None) -> None:
        """Raise BadInput, naming the key and a remedy, unless the firmware would take these parameters."""
        where = where or self.where
        self._take_kinds(where)
        self.validate_lengths(where)
        for key, maximum in (("thresholds_um", MAX_PLAYS), ("deadzones_um", MAX_DEADZONES)):
            length = len(getattr(self, key))
            if length > maximum:
                raise BadInput(f"{where}: {key}: has {length} values, at most {maximum}; fit a smaller model")
        validation.check_finite(self, where)
        validation.check_curve(self.drive, where)
        validation.check_values(self, where)
        validation.check_values(self._single_precision(), f"{where}, in the firmware's single precision")

    def _take_kinds(self, where: str) -> None:
        """Lists of numbers become arrays, whole numbers int. Raises BadInput for what is no number, array, section or
        text by its key.
        """
        for key, kind in (("rate", Rate), ("drive", Drive), ("memory", Memory), ("fit", dict), ("effects", list)):
            arguments.of_kind(getattr(self, key), kind, f"{where}: {key}")
        for name in ("tool", "actuator"):
            arguments.of_kind(getattr(self, name), str, f"{where}: {name}")
        for prefix, part in (("", self), *((f"{key}.", getattr(self, key)) for key in SECTIONS)):
            for item in fields(part):
                value, key = getattr(part, item.name), f"{where}: {prefix}{item.name}"
                if item.type == "np.ndarray":
                    setattr(part, item.name, arguments.series(value, key, finite=False))
                elif item.type.startswith(("float", "int")) and not (value is None and item.type.endswith("None")):
                    number = arguments.number(value, key, finite=item.name in WHOLE)
                    if item.name in WHOLE:
                        if number != int(number):
                            raise BadInput(f"{key}: is {number:g}; must be a whole number")
                        setattr(part, item.name, int(number))

    def numbers(self) -> dict[str, Any]:
        """Every number and array of numbers the firmware takes, by key."""
        numbers = {item.name: getattr(self, item.name) for item in fields(self) if item.name not in NOT_NUMBERS}
        for key in SECTIONS:
            section = getattr(self, key)
            numbers.update({f"{key}.{item.name}": getattr(section, item.name) for item in fields(section)
                            if item.name not in NOT_NUMBERS and getattr(section, item.name) is not None})
        return numbers

    def _single_precision(self) -> Model:
        """The model with every number as the firmware rounds it."""
        rounded: dict[str, dict[str, Any]] = {key: {} for key in ("", *SECTIONS)}
        with np.errstate(over="ignore"):
            for key, value in self.numbers().items():
                section, _, name = key.rpartition(".")
                single = np.asarray(value, np.float32).astype(float)
                single = np.where(np.abs(single) < TINY, 0.0, single)  # some FPUs flush what is not normal
                rounded[section][name] = single if single.ndim else float(single)
        return replace(self, **rounded[""], **{key: replace(getattr(self, key), **rounded[key]) for key in SECTIONS})

    def validate_lengths(self, where: str | None = None) -> None:
        """Raise BadInput unless every array is as long as it must be."""
        where = where or self.where
        n, m = len(self.thresholds_um), len(self.deadzones_um)
        for key, values, length, of in (
                ("slopes", self.slopes, n, "threshold"),
                ("slope_rate_s_per_um", self.slope_rate_s_per_um, n, "threshold"),
                ("deadzone_weights", self.deadzone_weights, m, "dead zone"),
                ("memory.plays_um", self.memory.plays_um, n, "threshold")):
            if len(values) != length:
                raise BadInput(f"{where}: {key}: has {len(values)} values, expected {length}, one per {of}")

    def uncompensated(self) -> Model:
        """The model for an inverse that compensates no effect: with the operator fitted as if there were none, which
        takes up of them what it can. Raises BadInput, naming the key, if that is no operator.
        """
        if self.operator_alone is None:
            return self
        where = f"{self.where}: operator_alone"
        one = OperatorAlone.from_json(self.operator_alone, where)
        found = replace(self, effects=[], operator_alone=None, where=where,
                        memory=replace(self.memory, x_um=one.x_um, plays_um=one.plays_um),
                        rate=replace(self.rate, max_um_per_s=one.max_um_per_s, singular_um_per_s=one.singular_um_per_s),
                        **{name: getattr(one, name) for name in _OF_OPERATOR})
        found.validate()
        return found

    def alone(self) -> dict[str, Any]:
        """The key `operator_alone` of another model of the same recordings, where this is its operator alone."""
        return OperatorAlone(
            max_um_per_s=self.rate.max_um_per_s, singular_um_per_s=self.rate.singular_um_per_s, x_um=self.memory.x_um,
            plays_um=self.memory.plays_um, **{name: getattr(self, name) for name in _OF_OPERATOR}).to_json()

    def shortest_sample_s(self) -> float:
        """Sample time in s below which the firmware refuses: its drive could not move as slowly as the sweep."""
        return 8 * EPSILON * float(abs(self.drive.min_V) + abs(self.drive.max_V)) / float(self.drive.sweep_speed())

    def sample_times_s(self) -> tuple[float, float]:
        """Shortest and longest sample time in s for which the firmware takes the model."""
        longest_s = float(self.drive.max_V - self.drive.min_V) / SWEEP_SAMPLES / float(self.drive.sweep_speed())
        return max(self.shortest_sample_s(), LEAST_SAMPLE_S), longest_s

    def to_json(self) -> dict[str, Any]:
        """The document as written by this version, unknown keys included."""
        return super().to_json() | {"tool": f"rdpi {version()}"}

    def digest(self) -> str:
        """SHA-256 of what the firmware takes from the model: same behaviour, same digest."""
        bare = replace(self, extra={}, **{key: replace(getattr(self, key), extra={}) for key in SECTIONS})
        bare.rate = replace(bare.rate, smoothing_s=0.0, identified_um_per_s=None, singular_um_per_s=None)
        bare.memory = replace(bare.memory, sweep_share=self.memory.followed_share())
        bare.drive = replace(bare.drive, sweep_V_per_s=self.drive.sweep_speed(), sweep_end_V=self.sweep_end())
        document = bare.to_json()
        for key in ("tool", "actuator", "fit", "effects", "passport", "operator_alone", "kept"):
            document.pop(key, None)
        if self.drive.curve_V:
            document["drive"]["curve_V"] = self.drive.curve_V
        if self.drive.noise_shaping:
            document["drive"]["noise_shaping"] = True
        return "sha256:" + hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
