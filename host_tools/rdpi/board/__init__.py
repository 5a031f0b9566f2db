"""What firmware on a target says and is fed: telemetry, serial lines, profiles, the emulator."""

from __future__ import annotations

from . import emulator, profile, telemetry
from .serial import Raw, Safe, is_part, record, refusal, reserved, stop_signals
from .telemetry import FINISHED, NO_READING, OFF_THE_MIDDLE, REFUSED, STILL, Decoder, Following, amid, displacement_um

__all__ = ["FINISHED", "NO_READING", "OFF_THE_MIDDLE", "REFUSED", "STILL", "Decoder", "Following", "Raw", "Safe",
           "amid", "displacement_um", "emulator", "is_part", "profile", "record", "refusal", "reserved", "stop_signals",
           "telemetry"]
