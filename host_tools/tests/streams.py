"""What a board would send, from the layout in port/drivers/telemetry.h; shares nothing with rdpi.telemetry."""

from __future__ import annotations

import binascii
import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

NO_READING = -(2**31)
NONE, FLOAT, INT32 = range(3)
STARTING, RUNNING, FINISHED, REFUSED, SAFE, RESET = range(6)
SWEEP, HELD = 0x100, 0x200


@dataclass(frozen=True)
class Sample:
    sequence: int
    tick: int
    reference: float = 0.0
    rate: float = 0.0
    dac_code: int = 0
    adc_counts: int = NO_READING
    flags: int = 0
    axis: int = 0

    def frame(self, numbers: str = "ff") -> bytes:
        return frame(struct.pack(f"<BHI{numbers}IiH", 1 + 16 * self.axis, self.sequence % 2**16, self.tick % 2**32, self.reference,
                                 self.rate, self.dac_code, self.adc_counts, self.flags))


@dataclass(frozen=True)
class Info:
    state: int = RUNNING
    status: int = 0
    rate_hz: int = 10_000
    dac_bits: int = 16
    numbers: int = FLOAT
    min_V: float = -20.0
    max_V: float = 120.0
    um_per_reference: float = 1.0
    reference_0_um: float = 0.0
    um_per_s_per_rate: float = 1.0
    um_per_count: float = 0.001
    count_0_um: float = 0.5
    offered: int = 0
    counts: tuple[int, ...] = (0,) * 9  # samples not taken, ticks lost, ...
    axis: int = 0

    def frame(self, version: int = 1) -> bytes:
        return frame(struct.pack("<BBBbIBB7d10I", 2 + 16 * self.axis, version, self.state, self.status, self.rate_hz, self.dac_bits,
                                 self.numbers, self.min_V, self.max_V, self.um_per_reference, self.reference_0_um,
                                 self.um_per_s_per_rate, self.um_per_count, self.count_0_um, self.offered,
                                 *self.counts))


def frame(body: bytes) -> bytes:
    """A body on the line."""
    body += binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little")
    return b"".join(bytes([len(part) + 1]) + part for part in body.split(b"\0")) + b"\0"


def samples(count: int, seed: int = 0, **fields: int) -> list[Sample]:
    """A run from its first sample on, with readings."""
    rng = np.random.default_rng(seed)
    references = rng.normal(5, 2, count).astype(np.float32).tolist()
    rates = rng.uniform(0, 500, count).astype(np.float32).tolist()
    codes, counts = rng.integers(0, 2**16, count).tolist(), rng.integers(-5000, 5000, count).tolist()
    return [replace(Sample(k, k + 1, references[k], rates[k], codes[k], counts[k]), **fields) for k in range(count)]


def stream(sent: Iterable[Sample], info: Info = Info(), every: int = 1000, finished: int = 1) -> bytes:
    """A whole run: infos at the start, every so many samples, and so many at the end."""
    parts = [replace(info, state=STARTING).frame()]
    for number, sample in enumerate(sent, 1):
        parts.append(sample.frame())
        info = replace(info, offered=sample.sequence + 1)
        if number % every == 0:
            parts.append(info.frame())
    return b"".join(parts) + replace(info, state=FINISHED).frame() * finished
