"""What a model predicts: the chain from command to displacement, its effects, its signals."""

from __future__ import annotations

from . import chain, effects, scoring, signals
from .chain import Prediction

__all__ = ["Prediction", "chain", "effects", "scoring", "signals"]
