"""Recordings: one run on disk, how other formats come to it, and the drives that make one."""

from __future__ import annotations

from . import excite
from .excite import Limits, make_drive
from .importer import ROLES, Request, import_recording
from .recording import (MIN_SAMPLES, RATE_TOLERANCE, RUN_COLUMNS, GrowingRecording, Recording, atomic_write,
                        check_sizes, content, make_folder, read_bytes, read_recording, sample_times, sync_folder, taken,
                        write_all, write_recording)
from .shows import shown

__all__ = ["MIN_SAMPLES", "RATE_TOLERANCE", "ROLES", "RUN_COLUMNS", "GrowingRecording", "Limits", "Recording",
           "Request", "atomic_write", "check_sizes", "content", "excite", "import_recording", "make_drive",
           "make_folder", "read_bytes", "read_recording", "sample_times", "shown", "sync_folder", "taken", "write_all",
           "write_recording"]
