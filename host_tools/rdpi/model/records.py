"""What a model file holds beside the operator: effects, the recordings of the fit, the passport. As it is written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from .documents import Document, json_key

HeldOut = Literal["other runs", "left out in turn", "fitted"]


@dataclass(kw_only=True)
class EffectParameter(Document):
    """A parameter of an effect, with its uncertainty."""

    value: float | None = json_key("estimate; null: not known")
    ci95: tuple[float, float] | None = json_key("95 % interval; null: none was estimated", default=None)
    unit: str = json_key("unit of value and ci95, always the parameter's own; 1: none", default="")


@dataclass(kw_only=True)
class EffectEntry(Document):
    """An effect that acts beside the operator."""

    name: str = json_key("name of the effect, as `rdpi gap` lists it")
    stage: str = json_key("stage of the chain at which it acts; without it, the effect's first", needed=False)
    column: str | None = json_key("column of the recordings that it follows", omitted=True)
    parameters: dict[str, float | EffectParameter | None] = json_key(
        "parameters by name: an object, or its value alone")
    origin: Literal["fit", "gap"] | None = json_key("the command that found these values; without it, "
                                                 "the stage is taken as it stands", omitted=True)
    stage_shown: bool | None = json_key("true: the recordings showed the stage, by monitor_V or by their values; else "
                                        "the actuator's may as well be the sensor's", omitted=True)
    new: bool | None = json_key("true: `rdpi gap --earlier` found these values; in the earlier recordings it acted "
                                "with those of `was`, or did not act", omitted=True)
    was: dict[str, float | None] | None = json_key("values before `rdpi gap` found them changed, by parameter",
                                                   omitted=True)


@dataclass(kw_only=True)
class OperatorAlone(Document):
    """The operator fitted as if nothing stood around it. What it does not share with the model."""

    gain_um_per_V: float = json_key("gain of the control input", "um/V")
    offset_V: float = json_key("drive at which the control input is 0", "V")
    offset_um: float = json_key("measured displacement at which the operator's is 0", "um")
    stroke_um: float = json_key("peak-to-peak displacement of the recordings", "um", low=0)
    thresholds_um: np.ndarray = json_key("thresholds r_0 = 0 < r_1 < ... < r_n of the plays", "um")
    slopes: np.ndarray = json_key("slopes W_0 ... W_n of the loading curve at rest")
    slope_rate_s_per_um: np.ndarray = json_key("change c_0 ... c_n of each slope with the rate", "s/um")
    deadzones_um: np.ndarray = json_key("dead zones d_0 = 0 < d_1 < ... < d_m of the saturation stage", "um")
    deadzone_weights: np.ndarray = json_key("weights ws_0 ... ws_m of the dead zones")
    max_um_per_s: float = json_key("guard: the firmware clamps the rate here", "um/s")
    singular_um_per_s: float | None = json_key("rate at which the first slope would reach zero; null: none falls",
                                               "um/s", default=None)
    x_um: float = json_key("control input at the first sample", "um")
    plays_um: np.ndarray = json_key("output of each play at the first sample", "um")


@dataclass(kw_only=True)
class FittedRun(Document):
    """A recording of the fit, and how well the model predicts it."""

    file: str = json_key("path as given")
    digest: str = json_key("SHA-256 of the file")
    samples: int = json_key("number of samples", low=0)
    held_out: bool = json_key("true: the model was only scored on it")
    memory: str = json_key("how the state at the first sample was known")
    read_at: str | None = json_key("moment of the converter's hold at which `rdpi import --drive` read it: middle or "
                                   "switch", omitted=True)
    rms_um: float = json_key("rms of the prediction's error", "um", low=0)
    max_um: float = json_key("largest error", "um", low=0)
    rms_percent: float = json_key("the same as rms_um, of the measured stroke", "%", low=0)
    max_percent: float = json_key("the same as max_um, of the measured stroke", "%", low=0)
    offset_um: float = json_key("mean of the prediction's error", "um")


@dataclass(kw_only=True)
class Variant(Document):
    """A model that was compared: the operator alone, or a chain around it."""

    effects: list[str] = json_key("names of the effects around the operator, in the order of the chain")
    rate_law: bool = json_key("whether the operator's slopes depend on the rate")
    parameters: int = json_key("number of its parameters", low=0)
    left_out_percent: float = json_key("rms of what it misses of recordings, or parts of one, that were left out in turn, "
                                       "each one's offset apart, of the stroke", "%", low=0)


@dataclass(kw_only=True)
class FitRecord(Document):
    """The recordings of the fit; empty for a model that was made in another way."""

    runs: list[FittedRun] = json_key("the recordings, those held out last", needed=False)
    noise_um: float = json_key("rms of the sensor's noise", "um", low=0, needed=False)
    warnings: list[str] = json_key("remarks of the fit", needed=False)
    variants: list[Variant] = json_key("models that were compared, this one first", needed=False)


@dataclass(kw_only=True)
class KeptRun(Document):
    """A copy of a recording of the fit, for `rdpi gap` to compare later ones of the same drive with."""

    file: str = json_key("path of the copy, from the folder of the model file")
    digest: str = json_key("SHA-256 of the copy")
    source: str = json_key("path of the recording as given")
    source_digest: str = json_key("SHA-256 of the recording")
    samples: int = json_key("number of samples of the recording", low=1)
    sample_rate_hz: float = json_key("sample rate of the recording", "Hz", low=0)
    every: int = json_key("the copy holds every so many-th sample, behind a low-pass; 1: all, as they are", low=1)
    step_um: float = json_key("step of the sensor's grid; 0: none", "um", low=0)


@dataclass(kw_only=True)
class PassportRun(Document):
    """What the model misses of one recording."""

    file: str = json_key("path as given", default="")
    digest: str = json_key("SHA-256 of the file", default="")
    samples: int = json_key("number of samples", low=0, default=0)
    held_out: HeldOut | None = json_key("the model that was asked: fitted to other runs, to the others in turn, or to "
                                        "this one too", default=None)
    rms_um: float | None = json_key("rms of the residual, mean removed", "um", low=0, default=None)
    fitted_rms_um: float | None = json_key("the same of the model fitted to this run too; null: it was not", "um",
                                           low=0, default=None)
    offset_um: float | None = json_key("mean of the residual", "um", default=None)
    noise_um: float | None = json_key("rms of the sensor's noise", "um", low=0, default=None)
    kurtosis: float | None = json_key("kurtosis of the residual; 3: normal", low=0, default=None)
    stroke_um: float | None = json_key("peak-to-peak displacement", "um", low=0, default=None)
    sample_rate_hz: float | None = json_key("sample rate", "Hz", low=0, default=None)
    step_um: float = json_key("step of the sensor's grid; 0: none", "um", low=0)
    stuck: float | None = json_key("share of the residual's energy while the reading stands still before it catches up in a "
                                   "jump", low=0, high=1, omitted=True)


@dataclass(kw_only=True)
class PassportAxis(Document):
    """The residual of all recordings in bins along one axis."""

    edges: list[float] = json_key("ends of the bins, one more than bins")
    rms_um: list[float] = json_key("rms of the residual in each bin", "um", low=0)
    occupancy: list[float] = json_key("share of the samples in each bin", low=0, high=1)
    factor: list[float] | None = json_key("mean square in each bin relative to the others, the other axis with a "
                                          "factor taken into account", low=0, omitted=True)


@dataclass(kw_only=True)
class PassportAxes(Document):
    """The axes along which the residual is known."""

    rate_um_per_s: PassportAxis = json_key("along the rate of the prediction, in um/s")
    position_um: PassportAxis = json_key("along the prediction, in um")
    amplitude_um: PassportAxis = json_key("along the size of the loop, in um")
    since_reversal_s: PassportAxis = json_key("along the time since the command turned round, in s")
    direction: PassportAxis = json_key("by direction: -1 falling, 0 at rest, 1 rising")


@dataclass(kw_only=True)
class OctaveShare(Document):
    """A spectrum in octaves: bin k lies at 2^(first + k) to twice that."""

    first: int = json_key("power of two at which the first bin starts")
    share: list[float] = json_key("share of the energy in each bin", low=0)


@dataclass(kw_only=True)
class OctavePeaks(Document):
    """How far the recordings moved in octaves: bin k lies at 2^(first + k) to twice that."""

    first: int = json_key("power of two at which the first bin starts")
    peak_um: list[float] = json_key("largest distance from 0 of what lies in each bin, trend removed", "um", low=0)
    missed: list[float] | None = json_key("rms that the model missed in each bin, over the rms that moved there", low=0,
                                          omitted=True)


@dataclass(kw_only=True)
class PassportOctaves(Document):
    """Spectra of the residual, each the mean over the recordings."""

    absolute: OctaveShare = json_key("along frequency in Hz")
    relative: OctaveShare = json_key("along frequency relative to that of the movement")
    moved: OctavePeaks | None = json_key("how far the prediction moved, the largest of the recordings", omitted=True)


@dataclass(kw_only=True)
class PassportLevel(Document):
    """What the size of a residual depends on: whole recordings and parts of them, one value of each list for each."""

    coefficients: list[float] = json_key("of 1, std, std² and rate², whose sum is the expected mean square", low=0)
    std_um: list[float] = json_key("standard deviation of the prediction", "um", low=0)
    span_um: list[float] = json_key("peak-to-peak prediction", "um", low=0)
    loop_um: list[float] = json_key("rms size of the loops", "um", low=0)
    rate_um_per_s: list[float] = json_key("rms rate", "um/s", low=0)
    rms_um: list[float] = json_key("rms of the residual, mean removed", "um", low=0)
    weight: list[float] = json_key("weight: parts of one size of one recording weigh 1 together", low=0)
    least_std_um: float | None = json_key("standard deviation of the recording that moved least; smaller movements are "
                                          "missed by as much", "um", low=0, omitted=True)
    drift_um: float | None = json_key("how far inner loops that drift may lead aside of the prediction while movements "
                                      "are small", "um", low=0, omitted=True)


@dataclass(kw_only=True)
class Passport(Document):
    """What the model misses of the recordings of its fit: how large its residual may be on any other recording."""

    SCHEMA: ClassVar[str] = "rdpi-passport/1"

    held_out: HeldOut = json_key("the best kind of prediction among the runs")
    noise_um: float = json_key("rms of the sensor's noise", "um", low=0)
    rms_um: float = json_key("rms of all residuals, means removed", "um", low=0)
    expected_um: float = json_key("rms to be expected on other recordings", "um", low=0)
    kurtosis: float = json_key("kurtosis of all residuals; 3: normal", low=0)
    spread: float = json_key("standard deviation of the logarithm of actual over expected rms", low=0)
    runs: list[PassportRun] = json_key("the recordings")
    axes: PassportAxes = json_key("where the residual lies")
    octaves: PassportOctaves = json_key("its spectrum")
    level: PassportLevel = json_key("its size")
    drifts: bool | None = json_key("true: the actuator's inner loops drift as it moves, which plays do not, so that "
                                   "they do not tell where a recording starts", omitted=True)
