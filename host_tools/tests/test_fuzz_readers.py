"""Files of noise, and good files that were damaged: every reader takes them or refuses them in words.

`pytest --hypothesis-profile long` goes on for RDPI_FUZZ_SECONDS a test.
"""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings, strategies as st

from models import single_play
from rdpi import profile
from rdpi.errors import BadInput
from rdpi.foreign import Unreadable, _leaves, _numpy, read_arrays
from rdpi.importer import Request, import_recording
from rdpi.model import read_model
from rdpi.recording import read_recording, sample_times

COUNT = 20
COLUMNS = {"time_s": sample_times(COUNT, 1000), "command_V": np.arange(COUNT) % 7.0,
           "displacement_um": np.arange(COUNT) % 5.0}

fuzz = settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


def damaged(good: bytes, extra: bytes = b"") -> st.SearchStrategy[bytes]:
    """`good` with some bytes changed, put in, taken out or repeated."""
    spot, piece = st.integers(0, len(good)), st.binary(max_size=4) | st.sampled_from([extra, b"\x00", b"\xff" * 4])
    edit = st.tuples(spot, st.integers(0, 8), piece, st.integers(1, 3))

    def apply(edits: list[tuple[int, int, bytes, int]]) -> bytes:
        data = good
        for start, length, new, times in edits:
            data = data[:start] + new * times + data[start + length:]
        return data

    return st.lists(edit, max_size=6).map(apply)
