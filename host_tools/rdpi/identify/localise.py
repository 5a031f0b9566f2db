"""Where a residual lies: its energy along time, frequency, rate, position, direction, reversals, loop size, recording.

A residual is measured minus predicted displacement of one run, in um, shape (samples,); every function here takes its
mean away first, because a sensor's zero is no gap. Energies are given with the sensor's noise taken off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .. import firmware
from ..data import Recording
from ..model import Document, json_key
from . import passport
from .passport import Passport, bin_of, quantile_edges

Coordinates = dict[str, np.ndarray]

UNITS = {"time_s": "s", "frequency_hz": "Hz", "rate_um_per_s": "um/s", "position_um": "um", "direction": "",
         "since_reversal_s": "s", "amplitude_um": "um", "recording": ""}
DIRECTIONS = "falling", "rest", "rising"
BINS = 8  # of equal occupancy along an axis of numbers
TABLE_BINS = 12, 8  # position, rate
TURN = 0.02  # share of its range by which a signal must come back for its turning to count
REST = 0.01  # of the mean speed of a run; what is slower rests
FLOOR = 0.02  # least share expected in a bin when bins are weighed: a tiny one does not decide
MIN_TABLE_SAMPLES = 20  # in a cell of the table; below it is empty


class Axis(NamedTuple):
    """A residual along one axis. Arrays are (bins,); along frequency rms² adds up to the mean square."""

    name: str
    unit: str
    edges: np.ndarray | None  # (bins + 1,) and increasing; None where the bins are no numbers
    labels: tuple[str, ...]  # one per bin
    rms_um: np.ndarray
    share: np.ndarray  # of the energy beyond noise
    occupancy: np.ndarray  # share of the samples; along frequency see there
    expected_um: np.ndarray | None  # rms by the passport; None without one
    ratio: np.ndarray | None  # rms / expected

    @property
    def concentration(self) -> float:
        """0: the energy lies as the passport has it, or without one as the samples do; 1: all in one of equal bins."""
        if self.expected_um is None or not np.any(self.expected_um):
            return _divergence(self.share, self.occupancy)
        if self.name == "frequency_hz":  # spectra differ much from drive to drive: the passport's excuses, but no more
            return min(_divergence(self.share, self.occupancy), _divergence(self.share, self.expected_um**2))
        return _divergence(self.share, self.occupancy * self.expected_um**2)

    def entry(self) -> AxisEntry:
        """What `where.axes` of `rdpi gap --json` says of it."""
        lists = {name: None if (values := getattr(self, name)) is None else values.tolist()
                 for name in ("edges", "rms_um", "share", "occupancy", "expected_um", "ratio")}
        return AxisEntry(unit=self.unit, bins=list(self.labels), **lists, concentration=self.concentration)


@dataclass(kw_only=True)
class AxisEntry(Document):
    """The residual of all recordings along one axis, in bins."""

    unit: str = json_key("unit of the edges")
    bins: list[str] = json_key("names of the bins")
    edges: list[float] | None = json_key("ends of the bins, one more than bins, where the axis has numbers",
                                         omitted=True)
    rms_um: list[float] = json_key("rms of the residual in each bin", "um", low=0)
    share: list[float] = json_key("share of the residual's energy beyond noise in each bin", low=0)
    occupancy: list[float] = json_key("share of the samples in each bin; along frequency, of a spectrum that "
                                      "concentrates nowhere", low=0)
    expected_um: list[float] | None = json_key("rms that the passport expects in each bin; null: no passport", "um",
                                               low=0)
    ratio: list[float] | None = json_key("rms_um over expected_um; null: no passport", low=0)
    concentration: float = json_key("0: the energy lies where it is expected, 1: all lies in one bin")


class Table(NamedTuple):
    """rms over position x rate, for a picture."""

    position_um: np.ndarray  # edges, (positions + 1,)
    rate_um_per_s: np.ndarray  # edges, (rates + 1,)
    rms_um: np.ndarray  # (positions, rates); NaN where there are hardly any samples


def coordinates(run: Recording, predicted_um: np.ndarray, rate_um_per_s: np.ndarray) -> Coordinates:
    """Where each sample of a run lies; every array (samples,).

    time_s from the run's start; rate_um_per_s and position_um of the prediction; direction of it: 1 rising, -1 falling,
    0 at rest; since_reversal_s since the command left the point where it last turned round, at first since the start;
    amplitude_um, the distance of the prediction's last two turning points, at first of the start from the first one.
    """
    time_s = np.arange(len(predicted_um)) * run.sample_time_s
    slope = np.gradient(predicted_um)
    moving = np.abs(slope) > REST * np.mean(np.abs(slope))
    turns = np.r_[0, turning_points(run.command_V)]
    leg = np.searchsorted(turns, np.arange(len(time_s)), side="right") - 1
    return {"time_s": time_s, "rate_um_per_s": rate_um_per_s, "position_um": predicted_um,
            "direction": np.where(moving, np.sign(slope), 0.0), "since_reversal_s": time_s - time_s[turns[leg]],
            "amplitude_um": _amplitude(predicted_um)}


def turning_points(signal: np.ndarray, share: float = TURN) -> np.ndarray:
    """Samples at which a signal leaves an extreme from which it comes back by more than `share` of its range."""
    band = share * float(np.ptp(signal))
    if not band > 0:
        return np.zeros(0, int)
    settled = firmware.plays(signal, np.array([0.0, band / 2]), np.full(2, signal[0]))[0][:, 1]
    steps = np.diff(settled)
    moved = np.flatnonzero(steps)
    back = np.flatnonzero(np.diff(np.sign(steps[moved])))
    points = []
    for reached, left in zip(moved[back] + 1, moved[back + 1] + 1):
        stay = np.abs(signal[reached:left] - signal[reached]) <= band / 4  # noise of a command that was read back
        points.append(reached + int(np.flatnonzero(stay)[-1]))
    return np.array(points, int)


def localise(runs: Sequence[Recording], residuals_um: Sequence[np.ndarray], coords: Sequence[Coordinates],
             known: Passport | None, noise_um: float) -> list[Axis]:
    """The residuals of all runs along every axis of UNITS; `known` is the model's passport, None without one."""
    residuals = [residual - np.mean(residual) for residual in residuals_um]
    square = np.concatenate(residuals) ** 2
    expected = None
    if known is not None:
        expected = np.concatenate([passport.expected_um(known, at) for at in coords]) ** 2
    axes = []
    for name in UNITS:
        if name == "frequency_hz":
            axes.append(along_frequency(runs, residuals, coords, known, noise_um))
            continue
        if name == "recording":
            labels = tuple(run.path for run in runs)
            edges, bins = None, np.repeat(np.arange(len(runs)), [len(residual) for residual in residuals])
        else:
            values = np.concatenate([at[name] for at in coords])
            if name == "direction":
                edges, labels, bins = None, DIRECTIONS, values.astype(int) + 1
            else:
                edges = quantile_edges(values, BINS)
                labels, bins = _interval_labels(edges), bin_of(values, edges)
        axes.append(_axis(name, edges, labels, bins, square, expected, noise_um))
    return axes


def dominant(axes: Sequence[Axis]) -> Axis:
    """The axis that concentrates the gap most."""
    return max(axes, key=lambda axis: axis.concentration)


def table(residuals_um: Sequence[np.ndarray], coords: Sequence[Coordinates]) -> Table:
    """rms of the residuals over position x rate; positions equally spaced, rates equally occupied."""
    square = np.concatenate([residual - np.mean(residual) for residual in residuals_um]) ** 2
    position = np.concatenate([at["position_um"] for at in coords])
    rate = np.concatenate([at["rate_um_per_s"] for at in coords])
    edges = np.linspace(np.min(position), np.max(position), TABLE_BINS[0] + 1)
    rates = quantile_edges(rate, TABLE_BINS[1])
    shape = len(edges) - 1, len(rates) - 1
    cell = bin_of(position, edges) * shape[1] + bin_of(rate, rates)
    samples = np.bincount(cell, minlength=shape[0] * shape[1])
    energy = np.bincount(cell, square, len(samples))
    rms = np.full(len(samples), np.nan)
    seen = samples >= MIN_TABLE_SAMPLES
    rms[seen] = np.sqrt(energy[seen] / samples[seen])
    return Table(edges, rates, rms.reshape(shape))


def _axis(name: str, edges: np.ndarray | None, labels: tuple[str, ...], bins: np.ndarray, square: np.ndarray,
          expected: np.ndarray | None, noise_um: float) -> Axis:
    """Axis from the bin, the squared residual and the squared expectation of each sample, all (samples,)."""
    count = np.bincount(bins, minlength=len(labels))
    some = np.maximum(count, 1)
    mean = np.bincount(bins, square, len(labels)) / some
    expected_um = None if expected is None else np.sqrt(np.bincount(bins, expected, len(labels)) / some)
    return _finish(name, edges, labels, mean, count * np.maximum(mean - noise_um**2, 0), count / len(bins), expected_um)


def along_frequency(runs: Sequence[Recording], residuals: Sequence[np.ndarray], coords: Sequence[Coordinates],
                    known: Passport | None, noise_um: float) -> Axis:
    """Residuals, their means removed, along frequency in octaves.

    Occupancy is what a residual that lies nowhere in particular looks like: white, even over the octaves or as the
    movement, as a wrong gain leaves it; the one of the three that is nearest.
    """
    spectra = [passport.octaves(residual, run.sample_rate_hz) for run, residual in zip(runs, residuals)]
    first = min(spectrum.first for spectrum in spectra)
    bands = max(spectrum.first + len(spectrum.power) for spectrum in spectra) - first
    power, white, moved, expected, samples = *np.zeros((4, bands)), 0
    for run, spectrum, residual, at in zip(runs, spectra, residuals, coords):
        there = slice(spectrum.first - first, spectrum.first - first + len(spectrum.power))
        power[there] += len(residual) * spectrum.power
        white[there] += len(residual) * spectrum.white
        position = at["position_um"] - np.mean(at["position_um"])
        moved[there] += len(residual) * passport.octaves(position, run.sample_rate_hz).power
        if known is not None:
            expected[there] += len(residual) * passport.expected_octaves(known, at, spectrum, run.sample_rate_hz)
        samples += len(residual)
    edges = 2.0 ** np.arange(first, first + bands + 1)
    energy = np.maximum(power - white * noise_um**2, 0)
    occupancy = min((spectrum / np.sum(spectrum) for spectrum in (white, np.ones(bands), moved) if np.any(spectrum)),
                    key=lambda spectrum: _divergence(energy / max(np.sum(energy), np.finfo(float).tiny), spectrum))
    return _finish("frequency_hz", edges, _interval_labels(edges), power / samples, energy, occupancy,
                   None if known is None else np.sqrt(expected / samples))


def _divergence(share: np.ndarray, reference: np.ndarray) -> float:
    """Kullback-Leibler divergence of energy shares from a reference of any scale; 1: all in one of equal bins."""
    bins = len(share)
    if bins < 2 or not np.any(share):
        return 0.0
    reference = np.maximum(reference / np.sum(reference), min(FLOOR, 0.5 / bins))
    reference = reference / np.sum(reference)
    held = share > 0
    return float(np.sum(share[held] * np.log(share[held] / reference[held])) / np.log(bins))


def _finish(name: str, edges: np.ndarray | None, labels: tuple[str, ...], mean_square: np.ndarray, energy: np.ndarray,
            occupancy: np.ndarray, expected_um: np.ndarray | None) -> Axis:
    total = float(np.sum(energy))
    rms = np.sqrt(mean_square)
    ratio = None
    if expected_um is not None:
        ratio = np.divide(rms, expected_um, out=np.zeros_like(rms), where=expected_um > 0)
    return Axis(name, UNITS[name], edges, labels, rms, energy / total if total > 0 else np.zeros_like(energy),
                occupancy, expected_um, ratio)


def _interval_labels(edges: np.ndarray) -> tuple[str, ...]:
    return tuple(f"{low:.3g} to {high:.3g}" for low, high in zip(edges[:-1], edges[1:]))


def _amplitude(signal: np.ndarray) -> np.ndarray:
    """Distance of the last two turning points at every sample; (samples,)."""
    turns = turning_points(signal)
    values = signal[np.r_[0, turns, len(signal) - 1]]
    sizes = np.abs(np.diff(values))[:max(1, len(turns))]
    leg = np.searchsorted(turns, np.arange(len(signal)), side="right")
    return sizes[np.maximum(leg - 1, 0)]
