"""The reports of `rdpi fit`, `rdpi score` and `rdpi compensate`, `rdpi plot`'s picture, and what all share: numbers, pictures, pages."""

from __future__ import annotations

from . import drawing
from .compensation import write_compensation
from .figure import check_picture_name, picture, write_picture
from .numbers import (NONE, SAME, base, bin_names, bracketed, change, drawn, edge_names, given, interval, listed,
                      moved, number, percent, plain, quantity, sentence_of, shrink, shrinks, sized, tight, times, um,
                      unit_of)
from .page import page_of
from .score import write_score
from .templating import environment

__all__ = ["NONE", "SAME", "base", "bin_names", "bracketed", "change", "check_picture_name", "drawing", "drawn",
           "edge_names", "environment", "given", "interval", "listed", "moved", "number", "page_of", "percent",
           "picture", "plain", "quantity", "sentence_of", "shrink", "shrinks", "sized", "tight", "times", "um", "unit_of",
           "write_compensation", "write_picture", "write_score"]
