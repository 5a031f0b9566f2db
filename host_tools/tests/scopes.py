"""What a scope records of a drive, and two families of such files: usual ones, and such as nobody should record."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rdpi.data import Limits, Recording, make_drive

KINDS = (("sawtooth", {"cycles": 1}), ("multisine", {"duration_s": 4.0}), ("sine", {"cycles": 2}),
         ("steps", {"hold_s": 0.4}), ("minor-loops", {"levels": 3}), ("commission", {"duration_s": 20.0}))


def drive_of(kind: str = "sawtooth", rate_hz: float = 2000.0, sweep: bool = True, **options: object) -> Recording:
    columns, metadata = make_drive(kind, Limits(0.0, 100.0, sample_rate_hz=rate_hz), sweep, **options)
    return Recording("drive.csv", metadata, columns, "sha256:0")


def scope(drive: Recording, rate_hz: float, start_s: float, *, clock: float = 1.0, gain: float = 1.0,
          offset_V: float = 0.0, noise: float = 0.0, before_s: float = 0.5, after_s: float = 0.5, held: bool = True,
          edge: float = 0.0, hum: float = 0.0, bits: int | None = None, seed: int = 1) -> Recording:
    """What a scope records of a drive that is `start_s` late.

    Gain and offset are those of its voltage, noise and hum of 50 Hz are shares of its rms. Its clock counts `clock`
    seconds per second, its converter has so many bits over 1.25 of the range. The drive passes to its next sample
    within `edge` of a sample, or in a straight line if it is not `held`. The displacement is 0.1 um/V of the voltage
    at the actuator.
    """
    lasts_s = clock * (len(drive) - 1) / drive.sample_rate_hz
    time_s = np.arange(0, before_s + lasts_s + after_s, 1 / rate_hz)
    at = (time_s - start_s) / clock * drive.sample_rate_hz
    if held:  # a sample is taken at the middle of its hold
        within = np.floor(at + 0.5) - 0.5
        passed = np.clip((at - within) / edge + 0.5, 0, 1) if edge else 1.0
        left = np.clip((within + 1 - at) / edge + 0.5, 0, 1) if edge else 1.0
        before, here, after = (drive.command_V[np.clip(np.floor(at + 0.5).astype(int) + by, 0, len(drive) - 1)]
                               for by in (-1, 0, 1))
        volts = here + (1 - passed) * (before - here) + (1 - left) * (after - here)
    else:
        volts = np.interp(at, np.arange(len(drive)), drive.command_V)
    random, rms = np.random.default_rng(seed), abs(gain) * np.std(drive.command_V)
    heard = gain * volts + offset_V + rms * noise * random.standard_normal(len(volts))
    heard += rms * hum * np.sqrt(2) * np.sin(2 * np.pi * 50 * time_s + seed)
    if bits is not None:
        step_V = 1.25 * abs(gain) * np.ptp(drive.command_V) / 2**bits
        heard = step_V * np.round(heard / step_V)
    return Recording("scope.csv", {}, {"time_s": time_s, "command_V": heard, "displacement_um": 0.1 * volts})


class File(NamedTuple):
    """A scope file, the drive that was played, and what is true of both."""

    drive: Recording
    run: Recording
    start_s: float
    clock: float
    first: int  # sample of the drive at which its sweep ends
    noise: float
    faster: float  # recorded samples per sample of the drive


def usual(seed: int) -> File:
    """Noise up to 2 %, a scope at least as fast as the drive, and whatever trigger, clock, gain, hum and converter."""
    random = np.random.default_rng(seed)
    drive, first = _any_drive(random)
    before_s = float(random.uniform(0, 2))
    start_s = before_s if random.random() < 0.8 or not first else -float(random.uniform(0, 0.9)) * float(
        drive.metadata["sweep_s"])
    off = float(random.choice([0, random.normal(0, 3e-5), random.uniform(-9e-3, 9e-3)], p=[0.3, 0.5, 0.2]))
    noise, faster = float(random.choice([0.001, 0.003, 0.01, 0.02])), float(random.choice([1, 2, 2.5, 4, 5, 10]))
    run = scope(drive, faster * drive.sample_rate_hz, start_s, clock=1 + off, noise=noise,
                before_s=max(0.0, start_s), after_s=float(random.uniform(0.01, 1)),
                gain=float(random.choice([1, -1, 0.1, -0.05, 15])), offset_V=float(random.normal()),
                edge=float(random.choice([0, 0.1, 0.3])), held=bool(random.random() < 0.8),
                hum=float(random.choice([0, 0.002, 0.005])), bits=random.choice([8, 12, None]), seed=seed)
    return File(drive, run, start_s, 1 + off, first, noise, faster)


def rough(seed: int) -> File:
    """Up to 30 % of noise, down to a third of the drive's rate, clocks up to 0.9 % off."""
    random = np.random.default_rng(seed)
    kind, options = KINDS[random.integers(6)]
    drive = drive_of(kind, float(random.choice([1000, 2000, 5000, 10000])), bool(random.random() < 0.8), **options)
    start_s, noise = float(random.uniform(0, 1)), float(random.choice([0, 0.003, 0.01, 0.1, 0.3]))
    off = float(np.clip(random.normal() * random.choice([0, 1e-4, 3e-3]), -0.009, 0.009))
    faster = float(random.choice([0.3, 0.5, 1, 1.37, 2.5, 5]))
    run = scope(drive, faster * drive.sample_rate_hz, start_s, clock=1 + off, noise=noise, before_s=start_s,
                gain=float(random.choice([1, -1, 0.1, -0.05, 10])), offset_V=float(random.normal()),
                held=bool(random.random() < 0.7), seed=seed)
    return File(drive, run, start_s, 1 + off, _sweep(drive), noise, faster)


FAMILIES = {"usual": usual, "rough": rough}


def off_by(found_start_s: float, found_clock: float, file: File) -> float:
    """Largest error of the place, from the end of the sweep on and as long as the drive moves, in samples of the drive."""
    rate_hz, moves = file.drive.sample_rate_hz, int(np.flatnonzero(np.diff(file.drive.command_V))[-1]) + 1
    return max(abs((found_start_s - file.start_s) * rate_hz + k * (found_clock - file.clock))
               for k in (file.first, moves))


def _any_drive(random: np.random.Generator) -> tuple[Recording, int]:
    kind, options = KINDS[random.integers(len(KINDS))]
    drive = drive_of(kind, float(random.choice([1000, 2000, 5000, 10000])), bool(random.random() < 0.8), **options)
    return drive, _sweep(drive)


def _sweep(drive: Recording) -> int:
    return round(float(drive.metadata.get("sweep_s", 0)) * drive.sample_rate_hz)
