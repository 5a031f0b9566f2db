#!/usr/bin/env python3
"""Writes the seeds that libFuzzer would hardly guess: parameters that the fuzzers of the library see accepted."""

import itertools
import random
import struct
from pathlib import Path

CORPUS = Path(__file__).parent / "corpus"
PIECES, POLES = 8 + 2, 12  # RDPI_MAX_CURVE_PIECES + 2, RDPI_MAX_POLES
CALLS = bytes(itertools.chain.from_iterable((call, 0x55, call * 37 % 256) for call in range(256)))


def f32(plays: int, deadzones: int, dac_bits: int, gain: float, window_s: float, filter_s: float, slew: float, *,
        shaped: bool = False, pieces: int = 1, chain: bytes = b"") -> bytes:
    """In the order in which any_f32.c takes it: head, numbers, plays, saturation, memory, input curve, chain, calls."""
    numbers = (0, window_s, filter_s, 2000, 0.1, 0, 100, slew, 2e5, 50, 0.25, 1e-4)
    bank = [(1.5 * i, 0.6 + 0.05 * i, -1e-4, 0, 0) for i in range(plays)]  # intercepts are derived
    saturation = [(4.0 * j, 0.9 if j == 0 else -0.05) for j in range(deadzones)]
    curve = [(100 * (k + 1) / pieces, 0, 0, 0, gain, 0, 50, 0, 0, 0, 0, 0, 0) for k in range(pieces)]  # the rest is derived
    floats = itertools.chain(numbers, *bank, *saturation, [0.0] * plays, *curve)
    head = struct.pack("<5BH", 0, plays, deadzones, dac_bits, pieces + shaped * PIECES, 4)
    content = head + b"".join(struct.pack("<f", number) for number in floats) + chain + CALLS
    return content + bytes((len(content) + bool(chain)) % 2)  # an odd size: there is a chain


def f32_chain(poles: int, lead_s: float, lag_s: float) -> bytes:
    """A chain as f32_chain.h takes it."""
    shares = itertools.chain(*[(0.01, 10.0 ** (k - 2)) for k in range(poles)])
    numbers = (3e-4 if lead_s else 0, lag_s, lead_s, lead_s**2, 10, 1)
    floats = b"".join(struct.pack("<f", number) for number in (*numbers, *shares))
    return struct.pack("<2B", 1, poles) + floats + bytes(8 * (POLES - poles))


def q31(how: int, plays: int, deadzones: int, dac_bits: int, window_ns: int, filter_ns: int, slew: int, *,
        shaped: bool = False) -> bytes:
    """As any_q31.c takes it: rdpi_q31_params_t up to its pointers, sample time, plays, stages, memory, calls."""
    drives = (-(2**28), 2**29, -(2**28), 2**29, 0, 0, 0, 1000, 2**28)  # the three of the codes are derived
    fields = (7, 0, slew, 2**45, plays, deadzones, dac_bits, 1, shaped, 4, 30, 30, 0, 0, -20, 2**12, 2**31)
    units, sample_times = (-1000, 2000, 2**31, -55), (0, 0)
    parameters = struct.pack("@IIQQH4BH4BhHIII6iI6i2I", *fields, window_ns, filter_ns, *drives[:4], *units, *drives[4:],
                             *sample_times)
    parameters += bytes(-len(parameters) % 8)
    bank = [(i * 10**7, 2**29 + i * 10**7, -(2**27)) for i in range(plays)]
    stage = [(j * 10**8, 2**30 if j == 0 else -(2**26)) for j in range(deadzones)]
    numbers = itertools.chain(*bank, *stage, *stage, [0] * 6, [0] * plays)  # and one piece
    head = bytes([how]) + parameters + struct.pack("<I", 100000)
    return head + b"".join(struct.pack("<i", number) for number in numbers) + CALLS


SEEDS = {
    "any_f32/one-play": f32(1, 1, 0, 0.2, 0, 0, 0),
    "any_f32/dac": f32(10, 4, 16, 0.2, 3e-4, 0, 0),
    "any_f32/negative-gain": f32(16, 8, 20, -0.2, 16e-4, 1e-3, 4e5),
    "any_f32/slew": f32(3, 2, 12, 0.2, 0, 5e-5, 4e5),
    "any_f32/shaped": f32(5, 2, 12, 0.2, 0, 0, 0, shaped=True, pieces=3),
    "any_f32/lag": f32(5, 2, 16, 0.2, 0, 0, 0, pieces=3, chain=f32_chain(0, 0, 5e-4)),
    "any_f32/chain": f32(5, 2, 12, 0.2, 0, 0, 0, chain=f32_chain(3, 5e-4, 5e-4)),
    "any_f32/shaped-chain": f32(5, 2, 8, -0.2, 0, 0, 4e5, shaped=True, pieces=2, chain=f32_chain(3, 0, 5e-4)),
    "any_q31/one-play": q31(0, 1, 1, 0, 0, 0, 0),
    "any_q31/dac": q31(0, 10, 4, 16, 300000, 0, 0),
    "any_q31/negative-gain": q31(4, 16, 8, 20, 1600000, 1000000, 2**46),
    "any_q31/slew": q31(0, 3, 2, 12, 0, 50000, 2**45),
    "any_q31/shaped": q31(0, 3, 2, 12, 0, 0, 0, shaped=True),
    # valid by construction, whatever the bytes are; long enough for calls
    **{f"chain_q31/random-{seed}": bytes([0]) + random.Random(seed).randbytes(2000) for seed in range(8)},
}
for name, content in SEEDS.items():
    (CORPUS / name).parent.mkdir(parents=True, exist_ok=True)
    (CORPUS / name).write_bytes(content)
