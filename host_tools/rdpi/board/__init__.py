"""What firmware on a target says and is fed: telemetry, serial lines, profiles, the emulator."""

from __future__ import annotations

from . import emulator, profile, telemetry
from .compensation import Compensation, compensate
from .recordings import (Recorded, Stream, Written, check_recording_outputs, how_it_ended, how_it_goes, read_stream,
                         record_file, write_stream)
from .sweep import memory_after
from .telemetry import Decoder, Following

__all__ = ["Compensation", "Decoder", "Following", "Recorded", "Stream", "Written", "check_recording_outputs",
           "compensate", "emulator", "how_it_ended", "how_it_goes", "memory_after", "profile", "read_stream",
           "record_file", "telemetry", "write_stream"]
