"""The document of `rdpi fit --json`; the folder of --report holds the same as fit.json."""

from __future__ import annotations

from dataclasses import dataclass

from ..model import Document, json_key, records


@dataclass(kw_only=True)
class RateBand(Document):
    """Slopes of the loading curve, fitted to the samples of one band of rate alone."""

    rate_um_per_s: float = json_key("mean rate in the band", "um/s", low=0)
    slopes: list[float | None] = json_key("slopes; null where the samples do not reach the interval")
    samples: int = json_key("number of samples", low=0)


@dataclass(kw_only=True)
class FitDocument(records.FitRecord):
    """What `rdpi fit` found: the key fit of the model file, and what only a reader needs."""

    model: str = json_key("path of the model file")
    gate_failed: bool = json_key("true: a run is predicted worse than --max-rms allows")
    rate_slopes: list[RateBand] = json_key("slopes in each band of rate")
