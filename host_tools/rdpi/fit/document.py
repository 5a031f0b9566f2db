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
class Sweep(Document):
    """Where a decaying sweep leaves the plays, and what shows it. Both errors are shares of the loops' rms width."""

    share: float = json_key("how far the sweep takes the plays, as in the model's memory", low=0, high=1)
    shown_by: ShownBy = json_key("what shows it; nothing: the usual share is assumed")
    remembers_rms: float = json_key("error of plays that remember until it is wiped out", low=0)
    forgets_rms: float = json_key("error of plays that forget as the drive moves on", low=0)


@dataclass(kw_only=True)
class FitDocument(Document):
    """What `rdpi fit` found."""

    runs: list[records.FittedRun] = json_key("the recordings, those held out last")
    noise_um: float = json_key("rms of the sensor's noise", "um", low=0)
    warnings: list[str] = json_key("remarks of the fit")
    model: str = json_key("path of the model file")
    gate_failed: bool = json_key("true: a run is predicted worse than --max-rms allows")
    rate_slopes: list[RateBand] = json_key("slopes in each band of rate")
    sweep: Sweep = json_key("where a decaying sweep leaves the plays")
