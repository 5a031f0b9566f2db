#!/usr/bin/env python3
"""A bench of virtual piezo actuators that shares no code with rdpi: command in volts, sensor reading in um out.

    python3 tests/bench/bench.py preisach DRIVE.csv -o RUN.csv
    python3 tests/bench/bench.py bouc-wen A.csv B.csv --out-dir DIR     one actuator, memory carried from A to B
    python3 tests/bench/bench.py preisach DRIVE.csv -o RUN.csv --set delay_s=0.001
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, pi
from pathlib import Path

import numpy as np

from bench_laws import LAWS, Pole, Resonance

SETTLED_S = 0.3  # paper_profile fades in before


@dataclass
class Bench:
    """Converter, amplifier, hysteresis law, creep, mechanics and sensor in series. Only the sensor's reading comes out.

    The reading of a sample is taken at the end of its hold, so sampling adds no delay to the amplifier's. A fresh bench
    has visited random voltages (the seed's) and then rested at mid range until creep was over: its memory is unknown.
    """

    law: Callable[[np.ndarray, float], np.ndarray]
    seed: int = 0
    command_range_V: tuple[float, float] = (0.0, 100.0)
    stroke_um: float = 12.5  # nominal peak-to-peak stroke about the middle; the rails leave about 15 % in reserve
    delay_s: float = 0.0  # of the converter; part of a hold delays the mean over the hold
    amplifier_hz: float | None = 3000.0
    creep_percent_per_decade: float = 1.5
    resonance_hz: float | None = None  # of the mechanics; None: stiff
    resonance_damping: float = 0.05
    noise_um: float = 0.004
    adc_bits: int | None = 16
    adc_range_um: tuple[float, float] = (-3.75, 16.25)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        self._past_V = np.empty(0)  # commands that the converter may still have to output
        self._amplifier = Pole(1 / (2 * pi * self.amplifier_hz)) if self.amplifier_hz else None
        self._mechanics: Resonance | None = None
        # two poles per decade from 10 ms to 1000 s are as good as a logarithm
        self._creep = [Pole(10.0**e) for e in np.arange(-2, 3.1, 0.5)]
        low, high = self.command_range_V
        self._respond(np.append(self._random.uniform(low, high, 6), (low + high) / 2), 1e9)
        if self.resonance_hz:  # only now: what has rested does not swing
            self._mechanics = Resonance(self.resonance_hz, self.resonance_damping)

    def _respond(self, command_V: np.ndarray, hold_s: float) -> np.ndarray:
        """Displacement in um at the end of each hold."""
        low, high = self.command_range_V
        u = (2 * np.clip(self._late(command_V, hold_s), low, high) - low - high) / (high - low)
        substeps = 1
        if self._amplifier:
            substeps = min(10, ceil(hold_s / 100e-6 - 1e-6))
            u = self._amplifier(np.repeat(u, substeps), hold_s / substeps)
        z = self.law(u, hold_s / substeps)[substeps - 1::substeps]
        share = self.creep_percent_per_decade / 200
        z = z + share * sum(pole(z, hold_s) for pole in self._creep)
        return self.stroke_um / 2 + (self._mechanics(z, hold_s) if self._mechanics else z)

    def _late(self, command_V: np.ndarray, hold_s: float) -> np.ndarray:
        """What the converter outputs, in the mean over each hold."""
        if not self.delay_s:
            return command_V
        holds, part = divmod(self.delay_s / hold_s, 1.0)
        count = int(holds) + 1
        line = np.concatenate([np.full(max(count - len(self._past_V), 0), (*self._past_V, *command_V[:1])[0]),
                               self._past_V, command_V])
        new = len(line) - len(command_V)
        self._past_V = line[-max(count, new):]
        return (1 - part) * line[new - count + 1:len(line) - count + 1] + part * line[new - count:len(line) - count]

    def run(self, command_V: np.ndarray, sample_rate_hz: float) -> np.ndarray:
        """Readings in um, one per command_V (1-D, volts, each held for one sample); goes on from the present state."""
        command_V = np.asarray(command_V, dtype=float)
        if command_V.ndim != 1 or not np.all(np.isfinite(command_V)):
            raise ValueError("command_V must be one-dimensional and finite")
        if not len(command_V):
            return np.empty(0)
        reading = self._respond(command_V, 1 / sample_rate_hz)
        reading = reading + self.noise_um * self._random.standard_normal(len(reading))
        if self.adc_bits:
            low, high = self.adc_range_um
            step = (high - low) / 2**self.adc_bits
            reading = low + step * np.clip(np.round((reading - low) / step), 0, 2**self.adc_bits - 1)
        return reading

    def demagnetise(self, sample_rate_hz: float, to_V: float | None = None) -> None:
        """Wipe the memory: a 20 Hz sine decays in 4 s from full range onto to_V (default mid range); rest 0.5 s."""
        low, high = self.command_range_V
        middle, half = (low + high) / 2, (high - low) / 2
        end = middle if to_V is None else to_V
        t = np.arange(round(4 * sample_rate_hz)) / sample_rate_hz
        decay = 1 - t / 4
        sweep = end + decay * (middle - end + half * np.sin(2 * pi * 20 * t))
        self.run(np.append(sweep, np.full(round(0.5 * sample_rate_hz), end)), sample_rate_hz)


# the paper's own conditions: hysteresis alone
_IDEAL = dict(amplifier_hz=None, creep_percent_per_decade=0.0, noise_um=0.0, adc_bits=None)


def make(kind: str, seed: int = 0, **overrides: float | None) -> Bench:
    """A fresh bench of kind "paper", "preisach" or "bouc-wen"; overrides are fields of Bench or of the kind's law."""
    law = LAWS[kind]
    settings = {**(_IDEAL if kind == "paper" else {}), **overrides}
    of_law = {f.name for f in dataclasses.fields(law)}
    return Bench(law(**{k: v for k, v in settings.items() if k in of_law}), seed,
                 **{k: v for k, v in settings.items() if k not in of_law})


def settable(kind: str) -> list[str]:
    """Names of the numbers that `make` takes for a kind."""
    return [field.name for made in (Bench, LAWS[kind]) for field in dataclasses.fields(made)
            if str(field.type) in ("float", "float | None")]


def paper_profile(name: str, sample_rate_hz: float, duration_s: float, stroke_um: float = 12.5) -> np.ndarray:
    """The paper's references in um about stroke_um / 2, faded in over 0.2 s: "10hz" or "5-20-35hz".

    The second repeats after 2 s, spans stroke_um and, at 12.5 um, stays below 900 um/s.
    """
    def multitone(t: np.ndarray) -> np.ndarray:
        slow = np.sin(pi * t)
        return (1.5 * np.sin(2 * pi * 5 * t) + (2.5 - 0.75 * slow) * np.sin(2 * pi * 20 * t)
                + (2.0 + 0.6 * slow) * np.sin(2 * pi * 35 * t))

    t = np.arange(round(duration_s * sample_rate_hz)) / sample_rate_hz
    if name == "10hz":
        wave = np.sin(2 * pi * 10 * t) / 2
    elif name == "5-20-35hz":
        period = multitone(np.arange(0, 2, 1e-5))
        wave = multitone(t) / np.ptp(period)
    else:
        raise ValueError(f'no profile "{name}": 10hz or 5-20-35hz')
    fade = np.minimum(t / 0.2, 1)
    return stroke_um * (0.5 + fade**2 * (3 - 2 * fade) * wave)


def error_percent(reading_um: np.ndarray, reference_um: np.ndarray, sample_rate_hz: float) -> tuple[float, float]:
    """rms and max tracking error as % of the reference's peak-to-peak, once the profile has faded in."""
    part = slice(round(SETTLED_S * sample_rate_hz), None)
    error_um = (reading_um - reference_um)[part]
    stroke_um = np.ptp(reference_um[part])
    return 100 * float(np.sqrt(np.mean(error_um**2)) / stroke_um), 100 * float(np.abs(error_um).max() / stroke_um)


def record(bench: Bench, command_V: np.ndarray, sample_rate_hz: float, path: Path | str,
           metadata: dict[str, str], reference_um: np.ndarray | None = None) -> np.ndarray:
    """Play command_V and write the run as a recording (CSV); returns the readings in um."""
    reading = bench.run(command_V, sample_rate_hz)
    columns = {"time_s": np.arange(len(reading)) / sample_rate_hz, "command_V": command_V, "displacement_um": reading}
    if reference_um is not None:
        columns["reference_um"] = reference_um
    lines = [f"# {key}: {value}" for key, value in {**metadata, "sample_rate_hz": f"{sample_rate_hz:.10g}"}.items()]
    np.savetxt(path, np.column_stack(list(columns.values())), "%.9f", ",",
               header="\n".join(lines + [",".join(columns)]), comments="")
    return reading


def read_drive(path: Path | str) -> tuple[dict[str, str], dict[str, np.ndarray], float]:
    """Metadata, columns and sample rate in Hz of a drive file (time_s, command_V and any other numeric column)."""
    metadata = {}
    with open(path, encoding="utf-8") as file:
        while (line := file.readline()).startswith("#"):
            key, _, value = line[1:].partition(":")
            metadata[key.strip()] = value.strip()
        names = [name.strip() for name in line.split(",")]
        columns = dict(zip(names, np.loadtxt(file, delimiter=",", ndmin=2).T))
    time_s = columns["time_s"]
    rate_hz = float(f"{(len(time_s) - 1) / (time_s[-1] - time_s[0]):.6g}")  # the file's times are rounded
    return metadata, columns, rate_hz


def setting(text: str) -> tuple[str, float]:
    """NAME=VALUE."""
    name, _, value = text.partition("=")
    return name, float(value)


def add_make_options(parser: argparse.ArgumentParser) -> None:
    """The options `seed` and `set`: what `make` takes beside the kind."""
    parser.add_argument("--seed", type=int, default=0, help="noise and memory at power-up")
    parser.add_argument("--set", type=setting, action="append", default=[], metavar="NAME=VALUE",
                        help="a field of Bench or of the law, e.g. delay_s=0.001")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Play drive files on a fresh virtual actuator and record its sensor.")
    parser.add_argument("kind", choices=LAWS)
    parser.add_argument("drives", nargs="+", type=Path, metavar="DRIVE.csv",
                        help="columns time_s, command_V, optional reference_um")
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument("-o", "--output", type=Path, metavar="RUN.csv", help="recording of a single drive")
    target.add_argument("--out-dir", type=Path, metavar="DIR", help="recordings under the drives' names")
    add_make_options(parser)
    parser.add_argument("--demagnetise", action=argparse.BooleanOptionalAction, default=True,
                        help="wipe the memory before the first drive (usual)")
    options = parser.parse_args(arguments)
    if options.output and len(options.drives) > 1:
        parser.error("several drives need --out-dir")
    if options.out_dir:
        options.out_dir.mkdir(parents=True, exist_ok=True)

    known = settable(options.kind)
    for name, _ in options.set:
        if name not in known:
            parser.error(f"--set: {options.kind} has no {name}; it has {', '.join(known)}")
    bench = make(options.kind, options.seed, **dict(options.set))
    memory = "reset" if options.demagnetise else "unknown"
    for drive in options.drives:
        metadata, columns, rate_hz = read_drive(drive)
        if memory == "reset":
            bench.demagnetise(rate_hz)
        metadata.update(actuator=f"virtual bench, {options.kind}, seed {options.seed}", memory=memory)
        record(bench, columns["command_V"], rate_hz, options.output or options.out_dir / drive.name, metadata,
               columns.get("reference_um"))
        memory = "carried"
    return 0


if __name__ == "__main__":
    sys.exit(main())
