"""What a model predicts: the chain from command to displacement, its effects, its signals; what a drive will show."""

from __future__ import annotations

from . import chain, effects, scoring, signals, tracking
from .chain import Prediction
from .inverse import ALL, Inverse, inverse_of
from .memory import swept_ticks
from .shown import ASSUMED, shown

__all__ = ["ALL", "ASSUMED", "Inverse", "Prediction", "chain", "effects", "inverse_of", "scoring", "shown", "signals",
           "swept_ticks", "tracking"]
