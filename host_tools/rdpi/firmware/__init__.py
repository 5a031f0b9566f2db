"""What is flashed, called from Python: the compiled library, its parameters, the C header."""

from __future__ import annotations

from .builds import beyond_sample_times, build_notes, build_options, check_sample_time
from .chain import LEAD, Chain, ahead
from .header import comment, file_name, template, write_header
from .library import (DTYPES, ENGINES, FLAGS, Firmware, FixedPoint, Steps, digest, engine, flag_counts, lags, plays,
                      rate, status_text)
from .parameters import NO_REFERENCE

__all__ = ["DTYPES", "ENGINES", "FLAGS", "LEAD", "NO_REFERENCE", "Chain", "Firmware", "FixedPoint", "Steps", "ahead",
           "beyond_sample_times", "build_notes", "build_options", "check_sample_time", "comment", "digest", "engine",
           "file_name", "flag_counts", "lags", "plays", "rate", "status_text", "template", "write_header"]
