"""Recordings: one run on disk, how other formats come to it, and the drives that make one."""

from __future__ import annotations

from . import arguments, excite
from .align import amid, beside_drive
from .excite import Limits, make_drive
from .files import atomic_write, content, make_folder, read_bytes, reserved, sync_folder, write_all
from .importer import ROLES, Request, import_recording
from .paths import check_made, check_no_table, check_outputs, check_targets, is_device, same_file, targets
from .recording import (ENDS, MEMORY, MIN_SAMPLES, RATE_TOLERANCE, RATES_HZ, RUN_COLUMNS, GrowingRecording, Past,
                        Recording, check_sizes, read_recording, sample_times, taken, write_recording)
from .resample import filled, thinned

__all__ = ["ENDS", "MEMORY", "MIN_SAMPLES", "RATE_TOLERANCE", "RATES_HZ", "ROLES", "RUN_COLUMNS", "GrowingRecording",
           "Limits", "Past", "Recording", "Request", "amid", "arguments", "atomic_write", "beside_drive", "check_made",
           "check_no_table", "check_outputs", "check_sizes", "check_targets", "content", "excite", "filled",
           "import_recording", "is_device", "make_drive", "make_folder", "read_bytes", "read_recording", "reserved",
           "same_file", "sample_times", "sync_folder", "taken", "targets", "thinned", "write_all", "write_recording"]
