"""Fit and diagnosis of many actuators: a plan, processes or a cluster that work it off, results in SQLite, a page."""

from __future__ import annotations

from .page import PAGE, write_page
from .plan import Task, read_plan
from .results import Results, Row
from .run import run

__all__ = ["PAGE", "Results", "Row", "Task", "read_plan", "run", "write_page"]
