"""What is flashed, called from Python: the compiled library, its parameters, the C header."""

from __future__ import annotations

from .builds import beyond_sample_times, build_notes, build_options, check_sample_time
from .chain import LEAD, Chain, ahead
from .header import comment, file_name, template, write_header
from .library import (DTYPES, ENGINES, FLAGS, Firmware, FixedPoint, Steps, digest, engine, flag_counts, plays, rate,
                      status_text)
from .parameters import NO_REFERENCE
from .plant import (BENT, CLAMP, CUBIC, LINE, PLAY, ROUND, SLEW, STAIRCASE, WIDEN, Bank, Block, Held, delay_block, lags,
                    lags_block, operator_block, ring_block)

__all__ = ["BENT", "CLAMP", "CUBIC", "DTYPES", "ENGINES", "FLAGS", "LEAD", "LINE", "NO_REFERENCE", "PLAY", "ROUND",
           "SLEW", "STAIRCASE", "WIDEN", "Bank", "Block", "Chain", "Firmware", "FixedPoint", "Held", "Steps", "ahead",
           "beyond_sample_times", "build_notes", "build_options", "check_sample_time", "comment", "delay_block",
           "digest", "engine", "file_name", "flag_counts", "lags", "lags_block", "operator_block", "plays", "rate",
           "ring_block", "status_text", "template", "write_header"]
