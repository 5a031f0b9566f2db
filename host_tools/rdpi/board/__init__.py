"""What firmware on a target says and is fed: telemetry, serial lines, profiles, the emulator."""

from __future__ import annotations

from . import emulator, profile, telemetry
from .compensation import Compensation, compensate
from .live import Live, latest_seconds
from .recordings import (Recorded, Stream, Written, check_recording_outputs, how_it_ended, how_it_goes, read_stream,
                         record_file, write_stream)
from .stretches import Following
from .sweep import memory_after
from .telemetry import Decoder

__all__ = ["Compensation", "Decoder", "Following", "Live", "Recorded", "Stream", "Written", "check_recording_outputs",
           "compensate", "emulator", "how_it_ended", "how_it_goes", "latest_seconds", "memory_after", "profile",
           "read_stream", "record_file", "telemetry", "write_stream"]
