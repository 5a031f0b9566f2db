"""The command `rdpi`: options in, print, exit status."""

from __future__ import annotations

from . import batch, diagnosis, firmware, models, recordings
from .program import command, main

__all__ = ["batch", "command", "diagnosis", "firmware", "main", "models", "recordings"]
