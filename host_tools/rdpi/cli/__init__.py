"""The command `rdpi`: options in, print, exit status."""

from __future__ import annotations

from . import diagnosis, firmware, models, recordings
from .program import command, main

__all__ = ["command", "diagnosis", "firmware", "main", "models", "recordings"]
