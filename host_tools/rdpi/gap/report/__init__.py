"""The report of `rdpi gap`: its words, numbers and pictures, the page and the terminal's text."""

from __future__ import annotations

from .page import tables, write
from .pictures import Pictures

__all__ = ["Pictures", "tables", "write"]
