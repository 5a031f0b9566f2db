"""The identified actuator: the model file, and its equations in NumPy as the independent check."""

from __future__ import annotations

from . import operators, records
from .curves import along, guarded, intercepts, inverse_saturation, loop_ends_um
from .documents import Document, json_key, schema
from .file import beside, kept_with, read_model, write_model
from .limits import (LARGEST, LEAST_SAMPLE_S, MAX_CURVE_PIECES, MAX_DAC_BITS, MAX_OFFSET, MAX_PLAYS, MIN_SLOPE_RATIO,
                     SOURCES, SWEEP_SAMPLES, TOLERANCE)
from .model import Drive, Memory, Model, Rate
from .operators import MAX_REFERENCE_UM
from .records import Passport
from .sweep import swept_states

__all__ = ["LARGEST", "LEAST_SAMPLE_S", "MAX_CURVE_PIECES", "MAX_DAC_BITS", "MAX_OFFSET", "MAX_PLAYS",
           "MAX_REFERENCE_UM", "MIN_SLOPE_RATIO", "SOURCES", "SWEEP_SAMPLES", "TOLERANCE", "Document", "Drive",
           "Memory", "Model", "Passport", "Rate", "along", "beside", "guarded", "intercepts", "inverse_saturation",
           "json_key", "kept_with", "loop_ends_um", "operators", "read_model", "records", "schema", "swept_states",
           "write_model"]
