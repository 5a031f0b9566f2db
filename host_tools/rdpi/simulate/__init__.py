"""What a model predicts: the chain from command to displacement, its effects, its signals; what a drive will show."""

from __future__ import annotations

from . import chain, effects, memory, scoring, signals, tracking
from .chain import Prediction
from .inverse import ALL, Inverse, inverse_of
from .memory import swept_ticks
from .plant import Plant, Simulator, State, operating
from .shown import ASSUMED, shown
from .start import doubted, started

__all__ = ["ALL", "ASSUMED", "Inverse", "Plant", "Prediction", "Simulator", "State", "chain", "doubted", "effects", "inverse_of",
           "memory", "operating", "scoring", "shown", "signals", "started", "swept_ticks", "tracking"]
