"""Why the model misses: the gap between a model and recordings, its cause, and the improved model."""

from __future__ import annotations

from . import batch, report
from .diagnosis import Diagnosis, diagnose
from .sections import GapDocument

__all__ = ["Diagnosis", "GapDocument", "batch", "diagnose", "report"]
