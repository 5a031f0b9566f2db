"""Limits of what the firmware takes, and defaults of the model file."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

Source = Literal["displacement", "control"]  # of the rate
SOURCES = get_args(Source)
MIN_SLOPE_RATIO = 0.2  # default of rate.min_slope_ratio
TOLERANCE = 1e-5  # relative; what rounding to the firmware's float may cost (ROUNDING in lib/src/f32_check.h)
LARGEST, LEAST_SLOPE, MIN_SPAN_V = 1e7, 1e-7, 1e-9  # MAX_NUMBER, MIN_SLOPE and MIN_SPAN_V there
TINY, EPSILON = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).eps)
MAX_OFFSET = 1000.0  # in ranges; leaves 0.01 % of the range to rounding
MAX_PLAYS, MAX_DEADZONES = 129, 65  # of the library as firmware_build.py compiles it
MAX_DAC_BITS, MAX_CURVE_PIECES = 20, 8  # RDPI_MAX_DAC_BITS, RDPI_MAX_CURVE_PIECES
SWEEP_CYCLES, MAX_SWEEP_CYCLES, SWEEP_HZ = 20, 10_000, 20.0  # of the start-up sweep
SWEEP_SAMPLES = 8  # at least, in which the sweep goes from one end of the range to the other; in fewer, ramps are jumps
LEAST_SAMPLE_S = 0.5e-6  # no controller computes a step in less: who asks for that has the wrong unit
