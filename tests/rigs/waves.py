"""Drives and references for the rigs, in shares of the range or of the stroke. Nothing here comes from rdpi.

Commissioning, field, and what nobody has seen use different waveforms. Every drive starts where it is told
to start and stays there for 20 ms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi

import numpy as np

Wave = Callable[[float, float, np.random.Generator], np.ndarray]
START_S = 0.02
MOVE_S = 0.15  # a move over the whole range


def path(rate_hz: float, times_s: Sequence[float], values: Sequence[float]) -> np.ndarray:
    """Straight lines between points."""
    return np.interp(np.arange(int(times_s[-1] * rate_hz + 1e-9)) / rate_hz, times_s, values)


def multisine(rate_hz: float, seconds: float, lines_hz: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Between -1 and 1; amplitudes fall as 1/sqrt(f)."""
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    wave = sum(np.sin(2 * pi * (f * t + random.random())) / np.sqrt(f) for f in lines_hz)
    return wave / np.abs(wave).max()


# --- commissioning ---------------------------------------------------------------------------------------------------

def sawtooths(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """Triangles over the whole range at four rates."""
    times, values = [0.0], [0.0]
    for frequency in np.array([1.0, 4.0, 15.0, 40.0]) * random.uniform(0.85, 1.15, 4):
        for _ in range(max(2, round(1.5 * scale * frequency))):
            times += [times[-1] + 0.5 / frequency, times[-1] + 1 / frequency]
            values += [1.0, 0.0]
    return path(rate_hz, times, values)


def growing(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """A multisine that grows from a quarter of the range to the whole."""
    wave = multisine(rate_hz, 3 * scale, np.geomspace(1.3, 60, 14) * random.uniform(0.95, 1.05, 14), random)
    wave *= np.linspace(0.25, 1, len(wave))
    return 0.5 + 0.5 * wave / np.abs(wave).max()


def steps(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """Steps to six levels with holds, the last a long one."""
    times, values, at, edge_s = [], [], 0.0, random.uniform(0.004, 0.01)
    levels = [0.5, *random.permutation(np.linspace(0.05, 0.95, 6)), 0.3]
    for k, level in enumerate(levels):
        hold = scale * (1.2 if k == len(levels) - 1 else 0.25)
        times += [at, at + hold]
        values += [level, level]
        at = times[-1] + edge_s
    return path(rate_hz, times, values)


# --- field -----------------------------------------------------------------------------------------------------------

def decay(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """A sine that decays."""
    t = np.arange(int(2 * scale * rate_hz)) / rate_hz
    return 0.5 + 0.48 * (1 - 0.8 * t / t[-1]) * np.sin(2 * pi * random.uniform(4, 12) * t)


def moves(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """Smooth moves between random places with rests."""
    pieces, at = [], 0.5
    for _ in range(max(4, round(14 * scale))):
        to, seconds = random.random(), random.uniform(0.02, 0.2)
        s = np.arange(1, int(seconds * rate_hz) + 1) / int(seconds * rate_hz)
        pieces += [at + (to - at) * s**3 * (10 - 15 * s + 6 * s * s),
                   np.full(int(rate_hz * random.uniform(0, 0.08)), to)]
        at = to
    return np.concatenate(pieces)


def biased(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """Small multisines about three places."""
    lines = np.geomspace(3, 90, 10)
    pieces = [bias + 0.12 * multisine(rate_hz, 0.7 * scale, lines * random.uniform(0.95, 1.05, 10), random)
              for bias in random.uniform(0.15, 0.85, 3)]
    bridges = [np.linspace(a[-1], b[0], int(0.05 * rate_hz)) for a, b in zip(pieces, pieces[1:])]
    return np.concatenate([pieces[0], bridges[0], pieces[1], bridges[1], pieces[2]])


def two_sines(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """A slow large sine with a fast small one on it: minor loops along the great one."""
    t = np.arange(int(2 * scale * rate_hz)) / rate_hz
    return (0.5 - 0.35 * np.cos(2 * pi * random.uniform(0.8, 1.6) * t)
            + 0.12 * np.sin(2 * pi * random.uniform(15, 45) * t))


def wander(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """A random walk in position, now slow, now fast."""
    slow = multisine(rate_hz, 3 * scale, random.uniform(0.4, 4, 6), random)
    fast = multisine(rate_hz, 3 * scale, random.uniform(4, 50, 8), random)
    t = np.arange(len(slow)) / rate_hz
    wave = slow + 0.5 * fast * np.sin(pi * t / (0.6 * scale)) ** 2
    return 0.5 + 0.45 * wave / np.abs(wave).max()


# --- field, a tenth of the range -----------------------------------------------------------------------------------

FINE_SHARE = 0.05  # of the range to both sides of a place


def fine_scan(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """Triangles about one place, as a scanner draws lines."""
    t = np.arange(int(3 * scale * rate_hz)) / rate_hz
    phase = random.uniform(4, 15) * t % 1
    return random.uniform(0.15, 0.85) + FINE_SHARE * (1 - 4 * np.abs(phase - 0.5))


def fine_sines(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """A multisine about another."""
    lines = np.geomspace(3, 60, 8) * random.uniform(0.95, 1.05, 8)
    return random.uniform(0.15, 0.85) + FINE_SHARE * multisine(rate_hz, 3 * scale, lines, random)


def fine_moves(rate_hz: float, scale: float, random: np.random.Generator) -> np.ndarray:
    """Smooth moves with rests about a third, as a stage is brought into focus."""
    return random.uniform(0.15, 0.85) + FINE_SHARE * (2 * moves(rate_hz, 1.5 * scale, random) - 1)


COMMISSION: dict[str, Wave] = {"sawtooths": sawtooths, "growing": growing, "steps": steps}
FIELD: dict[str, Wave] = {"decay": decay, "moves": moves, "biased": biased, "two_sines": two_sines}
UNSEEN: dict[str, Wave] = {"wander": wander}
FINE: dict[str, Wave] = {"fine_scan": fine_scan, "fine_sines": fine_sines, "fine_moves": fine_moves}


def drive(name: str, rate_hz: float, seed: int, start: float = 0.5, scale: float = 1.0) -> np.ndarray:
    """A drive of COMMISSION, FIELD, UNSEEN or FINE from `start` on, in shares of the range. `scale` stretches its length."""
    make = {**COMMISSION, **FIELD, **UNSEEN, **FINE}[name]
    wave = np.clip(make(rate_hz, scale, np.random.default_rng([seed, len(name)])), 0, 1)
    way = np.linspace(start, wave[0], max(2, int(MOVE_S * abs(wave[0] - start) * rate_hz)), endpoint=False)
    return np.concatenate([np.full(int(START_S * rate_hz), start), way, wave])


# --- references ------------------------------------------------------------------------------------------------------

def track(name: str, rate_hz: float, seconds: float) -> np.ndarray:
    """References "10hz" and "5-20-35hz" between -1/2 and 1/2, faded in over 0.2 s."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    fade = np.minimum(t / 0.2, 1)
    fade = fade * fade * (3 - 2 * fade)
    if name == "10hz":
        return fade * np.sin(20 * pi * t) / 2
    slow, period = np.sin(pi * t), np.arange(0, 2, 1e-4)

    def three(t: np.ndarray, slow: np.ndarray) -> np.ndarray:
        return (0.3 * np.sin(10 * pi * t) + (0.5 - 0.15 * slow) * np.sin(40 * pi * t)
                + (0.4 + 0.12 * slow) * np.sin(70 * pi * t))

    return fade * three(t, slow) / np.ptp(three(period, np.sin(pi * period)))


TRACKS = "10hz", "5-20-35hz"
