"""The identified actuator: the model file, and its equations in NumPy as the independent check."""

from __future__ import annotations

from . import operators
from .model import (LARGEST, MAX_DAC_BITS, MAX_OFFSET, MAX_PLAYS, MIN_SLOPE_RATIO, SOURCES, TOLERANCE, Drive, Memory,
                    Model, Rate, guarded, intercepts, inverse_saturation, read_model, write_model)
from .operators import MAX_REFERENCE_UM

__all__ = ["LARGEST", "MAX_DAC_BITS", "MAX_OFFSET", "MAX_PLAYS", "MAX_REFERENCE_UM", "MIN_SLOPE_RATIO", "SOURCES",
           "TOLERANCE", "Drive", "Memory", "Model", "Rate", "guarded", "intercepts", "inverse_saturation", "operators",
           "read_model", "write_model"]
