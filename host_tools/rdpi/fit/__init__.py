"""From recordings to a model with its error budget."""

from __future__ import annotations

from . import checks, identify, localise, passport, report, summary
from .identify import Options, fit
from .localise import Axis, Table
from .passport import FITTED

__all__ = ["FITTED", "Axis", "Options", "Table", "checks", "fit", "identify", "localise", "passport", "report",
           "summary"]
