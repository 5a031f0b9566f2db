"""The residual passport: what a model's residual looked like where it was fitted and on recordings it did not fit.

A diagnosis asks whether a residual is larger, or lies elsewhere, than the model's own shortcomings explain. So the
passport says how large a residual is to be expected for any recording whose prediction is known: its level from how
far, how fast and in what loops the actuator moved, its distribution from bins along rate, position and frequency.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import log2
from typing import Any, NamedTuple

import numpy as np

from ..data import Recording
from ..model import Passport, records
from ..simulate import signals
from . import stick_slip
from . import thresholds as tuned
from .passport_file import AXES, FITTED, LEFT_OUT, OTHER_RUNS, SHAPE_AXES, SOURCES, read

__all__ = ["FITTED", "LEFT_OUT", "OTHER_RUNS", "astray_um", "build", "expected_octaves", "expected_um", "level_um", "octaves",
           "moved_um", "ratio", "read", "remembered", "repeated", "too_small"]

PARTS = 4  # of the only recording, which are left out in turn
SPLITS = 1, PARTS, 16  # every run counts as a whole and in so many windows: small movements are seen too
BINS, PASSES = 8, 10
DIRECTION_EDGES = np.array([-1.5, -0.5, 0.5, 1.5])
DIGITS = 5  # of what is stored
TAPER = 0.2  # of a record, before its spectrum is taken
MOVED_TAPER = 0.05  # the same where peaks count: a record that begins and ends at 0 needs little

Coordinates = Mapping[str, np.ndarray]


class Residual(NamedTuple):
    """What a model left of one run, with the run's coordinates (localise.coordinates); arrays (samples,), in um."""

    run: Recording
    how: str  # OTHER_RUNS, LEFT_OUT or FITTED
    held_out_um: np.ndarray | None  # by a model that did not see the run
    fitted_um: np.ndarray | None  # by one that did
    coords: Coordinates
    noise_um: float
    stuck: np.ndarray | None = None  # samples in which the reading stood still, of bool; None: not asked


class Octaves(NamedTuple):
    """Power of a signal per octave [2^k, 2^(k+1)) Hz, k = first, first + 1, …; adds up to its mean square."""

    first: int
    power: np.ndarray  # (octaves,)
    white: np.ndarray  # share of white noise in each


class Ratio(NamedTuple):
    """rms of residuals, means removed, against what the passport expects of unchanged ones."""

    actual_um: np.ndarray  # (runs,)
    expected_um: np.ndarray  # (runs,)
    ratio: np.ndarray  # (runs,), actual / expected
    overall: float  # of all samples
    spread: float  # sd of the logarithm of a run's ratio when nothing has changed


def build(residuals: Sequence[Residual], drift_um: float = 0.0) -> Passport:
    """The passport of a model from what it left of its runs; two dozen of them make 20 kB of JSON.

    `drift_um` is how far inner loops that drift may lead aside of the model; 0: they do not drift.
    """
    energies = [_energy(one) for one in residuals]
    windows, owner = _windows(residuals)
    square = np.concatenate(energies)
    everything = np.concatenate([_centred(one.fitted_um if one.held_out_um is None else one.held_out_um)
                                 for one in residuals])
    return _rounded(Passport(
        held_out=min((one.how for one in residuals), key=SOURCES.index),
        noise_um=float(np.median([one.noise_um for one in residuals])),
        rms_um=_rms(everything), expected_um=float(np.sqrt(np.mean(square))), kurtosis=_kurtosis(everything),
        spread=_spread(windows, owner, all(one.how == FITTED for one in residuals)),
        runs=[_run(one) for one in residuals],
        axes=_axes({name: np.concatenate([one.coords[name] for one in residuals]) for name in AXES}, square),
        octaves=_spectra(residuals),
        level=records.PassportLevel(coefficients=_coefficients(windows), **windows._asdict(),
                                    least_std_um=_least_std(residuals), drift_um=drift_um), drifts=drift_um > 0))


def repeated(known: Passport) -> Passport:
    """The passport of differences between two recordings of the same drive: a share of what a model misses, for no
    actuator repeats exactly, and the sensor's noise twice.
    """
    noise = known.noise_um ** 2
    level, beside = known.level, (2 - tuned.REPEATS**2) * noise

    def differs(rms_um: float) -> float:
        return float(np.sqrt(tuned.REPEATS**2 * rms_um**2 + beside))

    first, *others = (tuned.REPEATS**2 * value for value in level.coefficients)
    return replace(known, noise_um=float(np.sqrt(2 * noise)), rms_um=differs(known.rms_um),
                   expected_um=differs(known.expected_um),
                   level=replace(level, rms_um=[*map(differs, level.rms_um)], coefficients=[first + beside, *others],
                                 least_std_um=None, drift_um=None),
                   octaves=replace(known.octaves, moved=known.octaves.moved and replace(known.octaves.moved, missed=None)))


def expected_um(known: Passport, coords: Coordinates) -> np.ndarray:
    """rms that the residual of one run, mean removed, should have at each sample if nothing has changed; (samples,)."""
    shape = np.ones(len(coords["time_s"]))
    for name in SHAPE_AXES:
        axis = getattr(known.axes, name)
        shape *= np.array(axis.factor)[bin_of(coords[name], np.array(axis.edges))]
    shape /= np.mean(shape)
    return np.maximum(level_um(known, coords) * np.sqrt(shape), known.noise_um)


def level_um(known: Passport, coords: Coordinates) -> float:
    """rms that the residual of a run, or of a part of one, should have once its mean is removed.

    A model that was fitted to large movements misses small ones by a larger share of them, so a movement smaller than
    any recording of the passport is taken for one as large. Loops that drift may lead aside meanwhile by what they
    remember.
    """
    windows = _Windows(*(np.array(getattr(known.level, name)) for name in _Windows._fields))
    features = _features(coords)
    features[0] = max(features[0], known.level.least_std_um or 0.0)
    square = _level(windows, np.array(known.level.coefficients), features)
    return float(np.hypot(np.sqrt(square), tuned.ASTRAY * astray_um(known, coords)))


def too_small(known: Passport, coords: Coordinates) -> float:
    """How much less a run moves than any recording of the passport: 0, no less, to 1, it rests."""
    least_um = known.level.least_std_um
    return max(0.0, 1 - float(np.std(coords["position_um"])) / least_um) if least_um else 0.0


def astray_um(known: Passport, coords: Coordinates) -> float:
    """How far loops that drift may lead aside of a run's prediction; 0 where they do not drift."""
    return remembered(known, coords) * (known.level.drift_um or 0.0)


def remembered(known: Passport, coords: Coordinates) -> float:
    """What a run's movement does not wipe out, as a share of the Preisach plane: all but a triangle as high as it moves."""
    height = float(np.std(coords["position_um"])) / max(*known.level.std_um, np.finfo(float).tiny)
    return 1 - min(height, 1.0) ** 2


def expected_octaves(known: Passport, coords: Coordinates, spectrum: Octaves,
                     sample_rate_hz: float) -> np.ndarray:
    """Power to be expected in each octave of `spectrum`, that of the run's residual; (octaves,).

    Half of the guess is where the residuals of the passport lay, half where they lay relative to the movement.
    """
    ends = spectrum.first, spectrum.first + len(spectrum.power)
    share = np.zeros(len(spectrum.power))
    drive = octaves(_centred(coords["position_um"]), sample_rate_hz)
    for stored, first in ((known.octaves.absolute, 0), (known.octaves.relative, drive.first)):
        there = np.array(stored.share)
        if stored is known.octaves.relative:
            there = np.convolve(there, drive.power)
        there = _window(there, stored.first + first, *ends)
        if np.any(there):
            share += there / np.sum(there)
    power = float(np.mean(expected_um(known, coords) ** 2))
    noise = min(known.noise_um ** 2, power)
    if not np.any(share):
        return power * spectrum.white
    return noise * spectrum.white + (power - noise) * share / np.sum(share)


def ratio(known: Passport, residuals_um: Sequence[np.ndarray], coords: Sequence[Coordinates]) -> Ratio:
    """Residuals of whole runs against what the passport expects of them."""
    samples = np.array([len(residual) for residual in residuals_um])
    actual = np.array([_rms(_centred(residual)) for residual in residuals_um])
    expected = np.array([np.sqrt(np.mean(expected_um(known, at) ** 2)) for at in coords])
    tiny = np.finfo(float).tiny
    overall = np.sqrt(samples @ actual**2) / max(float(np.sqrt(samples @ expected**2)), tiny)
    return Ratio(actual, expected, actual / np.maximum(expected, tiny), float(overall), float(known.spread))


def octaves(signal: np.ndarray, sample_rate_hz: float) -> Octaves:
    """Power per octave of a signal with mean 0, from its tapered periodogram, scaled to the signal's mean square."""
    spectrum = _lines(signal, sample_rate_hz, TAPER)
    squares = np.abs(spectrum.lines) ** 2
    squares[1:(spectrum.samples + 1) // 2] *= 2  # all but those at 0 and at half the sample rate stand for two
    power = np.bincount(spectrum.octave, squares, spectrum.octaves)
    total = float(np.sum(power))
    if total > 0:
        power *= float(np.mean(signal**2)) / total
    return Octaves(spectrum.first, power, np.bincount(spectrum.octave, minlength=len(power)) / len(squares))


def moved_um(position_um: np.ndarray, sample_rate_hz: float) -> tuple[int, np.ndarray]:
    """How far a movement goes from 0 in each octave, its trend removed; k of the first octave, and (octaves,) in um."""
    from scipy.fft import irfft

    trend = np.linspace(position_um[0], position_um[-1], len(position_um))
    spectrum = _lines(position_um - trend, sample_rate_hz, MOVED_TAPER)
    return spectrum.first, np.array([np.max(np.abs(irfft(np.where(spectrum.octave == k, spectrum.lines, 0),
                                                         spectrum.samples))) for k in range(spectrum.octaves)])


class _Lines(NamedTuple):
    """Spectrum of a tapered signal, and the octave of each line: `first` and the following ones."""

    lines: np.ndarray
    samples: int  # that the signal was padded to
    first: int
    octave: np.ndarray  # (lines,), counted from `first`
    octaves: int


def _lines(signal: np.ndarray, sample_rate_hz: float, taper: float) -> _Lines:
    from scipy.fft import next_fast_len, rfft
    from scipy.signal.windows import tukey

    count = next_fast_len(len(signal), True)
    lines = rfft(signal * tukey(len(signal), taper), count)
    lowest, highest = sample_rate_hz / len(signal), sample_rate_hz / 2
    first, last = int(np.floor(log2(lowest))), int(np.ceil(log2(highest))) - 1
    frequency = np.maximum(np.arange(len(lines)) * sample_rate_hz / count, lowest)
    octave = np.clip(np.floor(np.log2(frequency)).astype(int), first, last) - first
    return _Lines(lines, count, first, octave, last - first + 1)


def quantile_edges(values: np.ndarray, bins: int) -> np.ndarray:
    """Edges of at most `bins` intervals that hold equally many values; at least two edges, increasing."""
    edges = np.unique(np.quantile(values, np.linspace(0, 1, bins + 1)))
    return edges if len(edges) > 1 else np.array([edges[0], np.nextafter(edges[0], np.inf)])


def bin_of(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Bin of each value, 0 … len(edges) - 2; values beyond the ends count to the end's bin."""
    return np.searchsorted(edges[1:-1], values, side="right")


class _Windows(NamedTuple):
    """Whole runs and parts of them: how the prediction moved there, and the rms of the residual, mean removed."""

    std_um: np.ndarray
    span_um: np.ndarray
    loop_um: np.ndarray
    rate_um_per_s: np.ndarray
    rms_um: np.ndarray
    weight: np.ndarray  # a run's windows of one size weigh 1 together


_FEATURES = 4  # the first fields of _Windows


def _features(coords: Coordinates, part: slice = slice(None)) -> np.ndarray:
    position = coords["position_um"][part]
    return np.array([np.std(position), np.ptp(position), _rms(coords["amplitude_um"][part]),
                     _rms(coords["rate_um_per_s"][part])])


def _windows(residuals: Sequence[Residual]) -> tuple[_Windows, np.ndarray]:
    """The windows of all runs and the number of the run of each; no finer splits than MAX_WINDOWS allows. Of the only
    run, the number of the part of each, -1 for all of it.
    """
    splits = [split for k, split in enumerate(SPLITS)
              if split == 1 or len(residuals) * sum(SPLITS[:k + 1]) <= tuned.MAX_WINDOWS]
    rows, owner = [], []
    for k, one in enumerate(residuals):
        position = one.coords["position_um"]
        least = (tuned.LEAST * max(float(np.ptp(position)), np.finfo(float).eps)) ** 2
        kinds = [kind for kind in (one.held_out_um, one.fitted_um) if kind is not None]
        for split, part in _parts(len(position), splits):
            square = np.exp(np.mean([np.log(max(float(np.var(kind[part])), least)) for kind in kinds]))
            rows.append([*_features(one.coords, part), np.sqrt(square), 1 / split])
            within = -1 if split == 1 else (part.start + part.stop) * PARTS // (2 * len(position))
            owner.append(k if len(residuals) > 1 else within)
    return _Windows(*np.array(rows).T), np.array(owner)


def _least_std(residuals: Sequence[Residual]) -> float:
    """Of the recording that moves least while it moves: the median of its quarters, for a sweep may come first."""
    stds = [np.array([np.std(part) for part in np.array_split(one.coords["position_um"], PARTS)]) for one in residuals]
    rest = tuned.AT_REST * max(map(np.max, stds))
    return float(min(np.median(std[std >= rest]) for std in stds if np.any(std >= rest)))


def _parts(samples: int, splits: Sequence[int]) -> Iterator[tuple[int, slice]]:
    for split in splits:
        if split == 1 or samples >= split * tuned.MIN_WINDOW:
            ends = np.linspace(0, samples, split + 1).astype(int)
            for start, end in zip(ends[:-1], ends[1:]):
                yield split, slice(start, end)


def _terms(features: np.ndarray) -> np.ndarray:
    std, rate = features[..., 0], features[..., 3]
    return np.stack([np.ones_like(std), std, std**2, rate**2], axis=-1)


def _coefficients(windows: _Windows) -> np.ndarray:
    """Of _terms, none negative, so that the relative errors of the windows' mean squares are least; unbiased in log."""
    from scipy.optimize import nnls

    terms, square = _terms(np.stack(windows[:_FEATURES], axis=-1)), windows.rms_um**2
    size = np.maximum(np.mean(terms, axis=0), np.finfo(float).tiny)
    found, guess, usual = np.zeros(len(size)), np.full(len(square), np.mean(square)), float(np.mean(square))
    for _ in range(12):  # the errors are relative to what the iteration before expected
        scale = np.sqrt(windows.weight) / np.maximum(guess, 0.02 * usual)
        found = nnls(terms / size * scale[:, None], square * scale)[0]
        guess = terms / size @ found
    guess = np.maximum(guess, 1e-4 * usual)
    return found / size * np.exp(np.average(np.log(square / guess), weights=windows.weight))


def _level(windows: _Windows, coefficients: np.ndarray, features: np.ndarray) -> float:
    """Mean square to be expected with these features: the sum of terms, corrected by what similar windows say."""
    known = np.stack(windows[:_FEATURES], axis=-1)
    floor = tuned.LOW * np.sqrt(np.mean(known**2, axis=0)) + np.finfo(float).tiny
    least = 1e-4 * np.mean(windows.rms_um**2)
    distance = np.log(np.hypot(known, floor) / np.hypot(features, floor))
    weight = windows.weight * np.exp(-np.sum(distance**2, axis=1) / (2 * tuned.KERNEL**2))
    guess = np.maximum(_terms(known) @ coefficients, least)
    correction = weight @ np.log(windows.rms_um**2 / guess) / (np.sum(weight) + tuned.HALF)
    return float(max(_terms(features) @ coefficients, least) * np.exp(correction))


def _spread(windows: _Windows, owner: np.ndarray, fitted: bool) -> float:
    """sd of the logarithm of actual / expected, each run's expectation being made from the others. Of the only run, parts
    stand for runs, and say less; if it was fitted only, they say nothing.
    """
    alone = owner[0] < 0
    worth, usual = tuned.PART_WORTH if alone else 1.0, tuned.SPREAD_FITTED if fitted else tuned.SPREAD
    misses: list[float] = []
    for k in () if alone and fitted else np.flatnonzero(windows.weight == (1 / PARTS if alone else 1)):
        others = _Windows(*(column[(owner != owner[k]) & (owner >= 0)] for column in windows))
        features = np.array([column[k] for column in windows[:_FEATURES]])
        if not alone and not tuned.NEAR * np.min(others.std_um[others.weight == 1]) <= features[0] \
                <= np.max(others.std_um) / tuned.NEAR:
            continue  # the passport is not asked about what moves so much less or more than all of it
        expected = _level(others, _coefficients(others), features)
        misses.append(float(np.log(windows.rms_um[k] ** 2 / expected) / 2))
    prior = tuned.SPREAD_RUNS
    return float(np.sqrt((worth * np.sum(np.square(misses)) + prior * usual**2) / (worth * len(misses) + prior)))


def _energy(one: Residual) -> np.ndarray:
    """Square to be expected on other recordings, per sample.

    A run that was left out may lie beyond the others, and the model without it be worse than the model; with it, the
    model has adapted to it. The truth lies between.
    """
    if one.held_out_um is None or one.fitted_um is None:
        return _centred(one.fitted_um if one.held_out_um is None else one.held_out_um) ** 2
    return np.abs(_centred(one.held_out_um) * _centred(one.fitted_um))


def _run(one: Residual) -> records.PassportRun:
    held_out = one.fitted_um if one.held_out_um is None else one.held_out_um
    measured = one.run.displacement_um
    return records.PassportRun(
        file=one.run.path, digest=one.run.digest, samples=len(measured), held_out=one.how,
        rms_um=_rms(_centred(held_out)), fitted_rms_um=None if one.fitted_um is None else _rms(_centred(one.fitted_um)),
        offset_um=float(np.mean(held_out)), noise_um=one.noise_um, kurtosis=_kurtosis(_centred(held_out)),
        stroke_um=float(np.ptp(measured)), sample_rate_hz=one.run.sample_rate_hz, step_um=signals.grid_step(measured),
        stuck=None if one.stuck is None else stick_slip.share(held_out, one.stuck))


def _axes(values: Mapping[str, np.ndarray], square: np.ndarray) -> records.PassportAxes:
    """The residual in bins along each of AXES, and factors along SHAPE_AXES."""
    axes, bins = {}, {}
    for name, along in values.items():
        edges = DIRECTION_EDGES if name == "direction" else quantile_edges(along, BINS)
        bins[name] = bin_of(along, edges)
        count = np.bincount(bins[name], minlength=len(edges) - 1)
        energy = np.bincount(bins[name], square, len(count))
        axes[name] = records.PassportAxis(edges=edges, rms_um=np.sqrt(energy / np.maximum(count, 1)),
                                          occupancy=count / len(square))
    shape = tuple(len(axes[name].edges) - 1 for name in SHAPE_AXES)
    cell = np.ravel_multi_index([bins[name] for name in SHAPE_AXES], shape)
    count = np.bincount(cell, minlength=shape[0] * shape[1])
    energy = np.bincount(cell, square, len(count))
    for name, factor in zip(SHAPE_AXES, _factors(count.reshape(shape), energy.reshape(shape))):
        axes[name].factor = factor
    return records.PassportAxes(**axes)


def _factors(count: np.ndarray, energy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors along both axes whose product is the energy per sample in a cell; largest 1.

    Fitted to the sums along each axis in turn: what fast movement explains is not put down to the positions where it
    is fast as well.
    """
    rows, columns = np.ones(len(energy)), np.ones(len(energy.T))
    for _ in range(PASSES if np.any(energy) else 0):
        rows = _limited(np.sum(energy, axis=1), count @ columns)
        columns = _limited(np.sum(energy, axis=0), rows @ count)
    return rows, columns


def _limited(energy: np.ndarray, weight: np.ndarray) -> np.ndarray:
    factor = np.divide(energy, weight, out=np.zeros_like(energy), where=weight > 0)
    return np.maximum(factor / np.max(factor), tuned.LOW**2)


def _spectra(residuals: Sequence[Residual]) -> records.PassportOctaves:
    """Mean share of each run's residual per octave, in Hz and relative to where the prediction moves."""
    pairs = [(octaves(_centred(one.fitted_um if one.held_out_um is None else one.held_out_um), one.run.sample_rate_hz),
              octaves(_centred(one.coords["position_um"]), one.run.sample_rate_hz)) for one in residuals]
    both = [(left, drive) for left, drive in pairs if np.any(left.power) and np.any(drive.power)]
    absolute = [(left.first, left.power / np.sum(left.power)) for left, _ in both]
    relative = [(left.first - drive.first - len(drive.power) + 1,
                 np.convolve(left.power / np.sum(left.power), drive.power[::-1] / np.sum(drive.power)))
                for left, drive in both]
    return records.PassportOctaves(absolute=_mean_share(absolute), relative=_mean_share(relative),
                                   moved=_moved(residuals, pairs))


def _moved(residuals: Sequence[Residual], pairs: Sequence[tuple[Octaves, Octaves]]) -> records.OctavePeaks:
    """How far the predictions moved in each octave, the largest of them, and what was missed of all that moved there;
    `pairs` are what is left of each run, and its movement.
    """
    parts = [moved_um(one.coords["position_um"], one.run.sample_rate_hz) for one in residuals]
    first, last = min(start for start, _ in parts), max(start + len(peaks) for start, peaks in parts)
    missed, moved = (sum(len(one.run) * _window(pair[k].power, pair[k].first, first, last)
                         for one, pair in zip(residuals, pairs)) for k in range(2))
    return records.OctavePeaks(
        first=first, peak_um=np.max([_window(peaks, start, first, last) for start, peaks in parts], axis=0),
        missed=np.sqrt(missed / np.maximum(moved, max(tuned.AT_REST**2 * np.sum(moved), np.finfo(float).tiny))))


def _mean_share(parts: Sequence[tuple[int, np.ndarray]]) -> records.OctaveShare:
    if not parts:  # a residual of exactly 0 has no spectrum
        return records.OctaveShare(first=0, share=[1.0])
    first, last = min(start for start, _ in parts), max(start + len(share) for start, share in parts)
    return records.OctaveShare(first=first, share=np.mean([_window(share, start, first, last)
                                                           for start, share in parts], axis=0))


def _window(values: np.ndarray, first: int, low: int, high: int) -> np.ndarray:
    """Values that start at index `first`, from index `low` to before `high`; 0 where there are none."""
    result = np.zeros(high - low)
    start, end = max(first, low), min(first + len(values), high)
    if end > start:
        result[start - low:end - low] = values[start - first:end - first]
    return result


def _centred(values: np.ndarray) -> np.ndarray:
    return values - np.mean(values)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _kurtosis(centred: np.ndarray) -> float:
    """Fourth moment over the square of the second: 3 for normal noise, 0 for a signal that is 0."""
    variance = float(np.mean(centred**2))
    return float(np.mean(centred**4)) / variance**2 if variance > 0 else 0.0


def _rounded(passport: Passport) -> Passport:
    """The same with numbers of DIGITS significant digits."""
    def rounded(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: rounded(item) for name, item in value.items()}
        if isinstance(value, list):
            return [rounded(item) for item in value]
        return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value

    return Passport.from_json(rounded(passport.to_json()))
