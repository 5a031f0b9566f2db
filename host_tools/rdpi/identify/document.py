"""The document of `rdpi fit --json`; the folder of --report holds the same as fit.json."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..model import Document, json_key, records

ShownBy = Literal["beginnings", "inner loops", "nothing"]


@dataclass(kw_only=True)
class RateBand(Document):
    """Slopes of the loading curve, fitted to the samples of one band of rate alone."""

    rate_um_per_s: float = json_key("mean rate in the band", "um/s", low=0)
    slopes: list[float | None] = json_key("slopes; null where the samples do not reach the interval")
    samples: int = json_key("number of samples", low=0)


@dataclass(kw_only=True)
class BeforeAfter(Document):
    """An rms without and with the effects."""

    before: float = json_key("without the effects", "um", low=0)
    after: float = json_key("with the effects", "um", low=0)


@dataclass(kw_only=True)
class IdentifiedEffect(Document):
    """An effect around the operator."""

    name: str = json_key("name of the effect")
    stage: str = json_key("stage of the chain at which it acts")
    parameters: dict[str, records.EffectParameter] = json_key("parameters by name")
    held_out_rms_um: BeforeAfter = json_key("error on recordings, or parts of them, that were not fitted; before: by "
                                            "the model with all effects but this one", "um")
    shrink: float = json_key("share by which the effect shrinks that error", high=1)
    confusable_with: list[str] = json_key("names of effects that do as well in its place")
    stage_shown: bool = json_key("true: monitor_V showed the stage")


@dataclass(kw_only=True)
class Sweep(Document):
    """Where a decaying sweep leaves the plays, and what shows it.

    Both errors are shares of the loops' rms width; null: the recordings show no loops.
    """

    share: float = json_key("how far the sweep takes the plays, as in the model's memory", low=0, high=1)
    shown_by: ShownBy = json_key("what shows it; nothing: the usual share is assumed")
    remembers_rms: float | None = json_key("error of plays that remember until it is wiped out", low=0)
    forgets_rms: float | None = json_key("error of plays that forget as the drive moves on", low=0)


@dataclass(kw_only=True)
class FitDocument(Document):
    """What `rdpi fit` found."""

    runs: list[records.FittedRun] = json_key("the recordings, those held out last")
    noise_um: float = json_key("rms of the sensor's noise", "um", low=0)
    warnings: list[str] = json_key("remarks of the fit")
    variants: list[records.Variant] = json_key("models that were compared, the one that is delivered first")
    model: str = json_key("path of the model file")
    gate_failed: bool = json_key("true: a run is predicted worse than --max-rms allows")
    rate_slopes: list[RateBand] = json_key("slopes in each band of rate")
    effects: list[IdentifiedEffect] = json_key("what stands around the operator, in the order of the chain")
    sweep: Sweep = json_key("where a decaying sweep leaves the plays")


def name_of(variant: records.Variant) -> str:
    """For people."""
    alone = "" if variant.effects else "operator alone"
    return ", ".join(filter(None, (alone, *variant.effects, "rate law" if variant.rate_law else "")))
