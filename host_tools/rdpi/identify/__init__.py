"""From recordings to a model with its error budget."""

from __future__ import annotations

from . import checks, identify, kept, localise, passport, report, stick_slip, summary
from .bands import rate_slopes
from .document import BeforeAfter, FitDocument
from .identify import Options, checked_options, fit
from .localise import Axis, AxisEntry, Table
from .passport import FITTED
from .strokes import Strokes

__all__ = ["FITTED", "Axis", "AxisEntry", "BeforeAfter", "FitDocument", "Options", "Strokes", "Table", "checked_options",
           "checks", "fit", "identify", "kept", "localise", "passport", "rate_slopes", "report", "stick_slip", "summary"]
