"""What is flashed, called from Python: the compiled library, its parameters, the C header."""

from __future__ import annotations

from .header import TEMPLATES, comment, file_name, fixed_point, write_header
from .library import DTYPES, ENGINES, Firmware, FixedPoint, Steps, digest, engine, plays, rate, status_text
from .parameters import NO_REFERENCE, q31

__all__ = ["DTYPES", "ENGINES", "NO_REFERENCE", "TEMPLATES", "Firmware", "FixedPoint", "Steps", "comment",
           "digest", "engine", "file_name", "fixed_point", "plays", "q31", "rate", "status_text", "write_header"]
