"""The command `rdpi`: options in, print, exit status."""

from __future__ import annotations

from .program import command, main, progress

__all__ = ["command", "main", "progress"]
