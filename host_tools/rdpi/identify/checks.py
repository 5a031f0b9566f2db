"""Intake: what makes a recording unfit for identification, found before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .. import firmware
from ..data import RATE_TOLERANCE, Recording
from ..errors import BadInput
from ..model import LARGEST, MAX_OFFSET, Model
from ..simulate import signals
from . import passport_file
from . import thresholds as tuned

LARGEST_INPUT = 1e6  # V or um
COHERENT_PARTS = 16  # of a recording: half as many of what is not coherent seems so, each overlapping the next
LEAST_RANGE = 1e-12  # V or um; below, it is rounding that moves


def check_run(run: Recording, related: bool = True) -> None:
    """Raise BadInput, naming the file and a remedy, for a run from which no hysteresis can be identified.

    `related`: command and displacement must go together.
    """
    command, displacement = run.command_V, run.displacement_um
    for name, values in (("command_V", command), ("displacement_um", displacement)):
        largest = float(np.max(np.abs(values)))
        if largest > LARGEST_INPUT:
            raise BadInput(f"{run.path}: {name} reaches {largest:g}; check its unit")
    if run.sample_rate_hz > LARGEST:
        raise BadInput(f"{run.path}: was sampled at {run.sample_rate_hz:g} Hz, beyond the firmware's {LARGEST:g}; check "
                       "time_s, which is in s, and sample_rate_hz")
    if np.ptp(command) < LEAST_RANGE:
        raise BadInput(f"{run.path}: command_V is constant at {command[0]:g} V; "
                       "identification needs a drive that moves: remove this run, or see `rdpi excite`")
    if np.ptp(displacement) < LEAST_RANGE:
        raise BadInput(f"{run.path}: displacement_um is constant at {displacement[0]:g} um; "
                       "check the sensor and its column")
    together = late_correlations(run, displacement)
    if related and np.max(np.abs(together)) < tuned.MIN_CORRELATION and _coherence(run) < tuned.MIN_COHERENCE:
        raise BadInput(f"{run.path}: command_V and displacement_um are unrelated (correlation {together[0]:.2f}); "
                       "check their order and units, and that both columns are of the same run")
    if reversals(command, 0.05) == 0:
        raise BadInput(f"{run.path}: command_V never changes direction, so the run shows no hysteresis; "
                       "record a drive that goes up and down, see `rdpi excite`")
    offset, stroke = float(np.mean(displacement)), float(np.ptp(displacement))
    if abs(offset) > MAX_OFFSET * stroke:
        raise BadInput(f"{run.path}: displacement_um moves by {stroke:.3g} um at {offset:.6g} um; "
                       "the firmware's single precision cannot hold both: subtract the offset first")


def check_readings(run: Recording) -> None:
    """Raise BadInput for a disturbed reading and for a sensor that has stopped: they would pass for stroke and creep."""
    if (found := _disturbed(run) or _stopped(run)) is not None:
        raise BadInput(found)


def _disturbed(run: Recording) -> str | None:
    """Names a reading far from both its neighbours, which lie together, where the command has none such."""
    spikes = _spikes(run.displacement_um)
    if not 0 < len(spikes) <= tuned.FEW_SPIKES or len(_spikes(run.command_V)):
        return None
    at, z = int(spikes[0]), run.displacement_um
    return (f"{run.path}: displacement_um is {z[at]:.6g} um in sample {at} (at {run.time_s[at]:.6g} s), "
            f"{abs(z[at] - z[at - 1]):.3g} um from the readings before and after it: a disturbed reading; correct "
            "it, or cut the recording there (`rdpi import --rows`)")


def _stopped(run: Recording) -> str | None:
    """Says from where on no reading changes, amid the range and for much longer than before, while the command moves on
    to the end.
    """
    z, changes = run.displacement_um, np.flatnonzero(np.diff(run.displacement_um)) + 1
    if not len(changes) or z[-1] in (np.min(z), np.max(z)):  # it is clipped, or the amplifier is
        return None
    last = int(changes[-1])
    enough = max(tuned.DEAD_SHARE * len(z), tuned.DEAD_TIMES * float(np.max(np.diff(np.r_[0, changes]))))
    if len(z) - last < enough or np.ptp(run.command_V[last:]) < tuned.DEAD * np.ptp(run.command_V):
        return None
    return (f"{run.path}: displacement_um stays at {z[-1]:.6g} um from sample {last} (at {run.time_s[last]:.6g} s) to the end "
            "while the command moves: the sensor has stopped; cut the recording there (`rdpi import --rows`)")


def _spikes(values: np.ndarray) -> np.ndarray:
    """Samples that lie aside of both neighbours, by far more than these lie apart, and than others do. What rings at a
    few samples a period does so again and again.
    """
    off = np.abs(values[1:-1] - (values[:-2] + values[2:]) / 2)
    apart = np.abs(values[2:] - values[:-2])
    low, high = np.percentile(values, (1, 99))
    least = max(tuned.SPIKE * (high - low), tuned.USUAL_SPIKE * np.median(off))
    further = np.maximum.reduce([np.roll(off, by) for by in (-3, -2, 2, 3)])  # one sample moves its neighbours' too
    return 1 + np.flatnonzero((off > least) & (np.maximum(apart, further) < tuned.SPIKE * off))


def reversals(command: np.ndarray, share: float, first: int = 0) -> int:
    """How often the command turns round, by more than this share of its range, from sample `first` on."""
    band = share * np.ptp(command)
    command = command[first:]
    settled = firmware.plays(command, np.array([0.0, band / 2]), np.full(2, command[0]))[0][:, 1]
    moves = np.sign(np.diff(settled))
    moves = moves[moves != 0]
    return int(np.count_nonzero(np.diff(moves)))


def check_together(runs: Sequence[Recording], hold_out: Sequence[Recording]) -> None:
    """Each run once, all of one actuator: same sign, same zero, about as many um per volt (small loops have fewer)."""
    _check_once([run.digest or id(run) for run in (*runs, *hold_out)], [*runs, *hold_out],
                " and cannot be both fitted and held out")
    gains = np.array([_gains_um_per_V(run) for run in runs])
    low, high = int(np.argmin(gains.max(axis=1))), int(np.argmax(gains.min(axis=1)))
    if gains[high].min() > tuned.GAIN_SPREAD * gains[low].max():
        raise BadInput(f"{runs[high].path} moves {gains[high, 0]:.3g} um/V, but {runs[low].path} moves "
                       f"{gains[low, 0]:.3g} um/V: their units or actuators differ; "
                       "check units and gain (`rdpi import --command-gain`)")
    largest = max(runs, key=lambda run: np.ptp(run.command_V))
    slope, zero = np.polyfit(largest.command_V, largest.displacement_um, 1)
    for run in runs:
        if _opposite(run, slope):
            raise BadInput(f"{run.path}: moves opposite to {largest.path}; the sign of one of them is inverted")
        moved = float(np.mean(run.displacement_um) - slope * np.mean(run.command_V) - zero)
        if abs(moved) > np.ptp(largest.displacement_um) / 2:
            raise BadInput(f"{run.path}: lies {moved:.4g} um from {largest.path} at the same command; "
                           "the sensor's zero or the command's offset has changed; subtract the change, or fit the "
                           "runs separately")


def check_drive(runs: Sequence[Recording], min_V: float | None, max_V: float | None) -> None:
    """Raise BadInput where the drive was recorded nowhere within limits, as far as they are given, or in other units."""
    low_V, high_V = (end(float(end(run.command_V)) for run in runs) for end in (min, max))
    least_V, most_V = -np.inf if min_V is None else min_V, np.inf if max_V is None else max_V
    outside = most_V < low_V or least_V > high_V or tuned.OTHER_UNITS * (most_V - least_V) < high_V - low_V
    if outside and most_V > least_V:
        given = [f"{name} {end_V:g}" for name, end_V in (("--min-V", min_V), ("--max-V", max_V)) if end_V is not None]
        raise BadInput(f"{runs[0].path}: the recorded drive goes from {low_V:g} to {high_V:g} V, which is not within "
                       f"{' '.join(given)}; give command_V and limits both in V at the actuator (`rdpi import --command-gain`)")


def _gains_um_per_V(run: Recording) -> tuple[float, float]:
    """Of all that it moves, and of what it moves along with the command: what rings moves further, but not along."""
    return (float(np.ptp(run.displacement_um) / np.ptp(run.command_V)),
            abs(float(np.polyfit(run.command_V, run.displacement_um, 1)[0])))


def _opposite(run: Recording, gain: float) -> bool:
    """Whether it moves against a gain of this sign, and not because it rings or is late by half a period."""
    late = late_correlations(run, run.displacement_um) * np.sign(gain)
    return bool(np.min(late) < -tuned.MIN_CORRELATION and np.max(late) < tuned.MIN_CORRELATION)


def _check_once(marks: Sequence[object], runs: Sequence[Recording], why: str = "") -> None:
    """Raise BadInput if a mark is there twice."""
    first: dict[object, str] = {}
    for run, mark in zip(runs, marks):
        if mark in first:
            what = "given twice" if first[mark] == run.path else f"holds the samples of {first[mark]}"
            raise BadInput(f"{run.path}: {what}; a run counts once{why}")
        first[mark] = run.path


def same_samples(runs: Sequence[Recording]) -> list[str]:
    """A remark for each recording whose command and displacement another one has already shown."""
    seen: dict[int, str] = {}
    found = []
    for run in runs:
        mark = _mark(run)
        if mark in seen:
            found.append(f"{run.path} holds the same samples as {seen[mark]}: it shows nothing more")
        seen.setdefault(mark, run.path)
    return found


def read_differently(runs: Sequence[Recording], model: Model | None = None) -> list[str]:
    """A remark where `rdpi import --at` read recordings, these or those of the model, at two moments of the hold."""
    fitted = [] if model is None else [(run.get("file"), run.get("read_at")) for run in _fitted(model)]
    first: dict[str, object] = {}  # recording of each moment
    for path, at in [*fitted, *((run.path, run.metadata.get("read_at")) for run in runs)]:
        if isinstance(at, str):
            first.setdefault(at, path)
    if len(first) < 2:
        return []
    where = " and ".join(f"{path} with --at {at}" for at, path in first.items())
    return [f"half a sample of the drive lies between recordings that were imported as {where}; that looks like a delay: "
            "import them alike"]


def slow_sensors(runs: Sequence[Recording]) -> list[str]:
    """A remark where a sensor is slower than the recording: half of its hold counts as delay."""
    slow = [(run, times) for run in runs if (times := signals.repeats(run.displacement_um)) > 1]
    if not slow:
        return []
    run, times = slow[0]
    more = f" and {len(slow) - 1} more" if len(slow) > 1 else ""
    return [f"{run.path}{more}: each reading is repeated for {times} samples, so the sensor is slower than the recording; its "
            f"readings are late by {500 * (times - 1) * run.sample_time_s:.3g} ms in the mean, which looks like a delay"]


def _mark(run: Recording) -> int:
    """The same for recordings of the same command and displacement."""
    return hash(run.command_V.tobytes() + run.displacement_um.tobytes())


def check_against(model: Model, runs: Sequence[Recording]) -> list[str]:
    """Remarks; raises BadInput for recordings that are not this actuator's, or not in these units."""
    notes = []
    widest = max(runs, key=lambda run: float(np.ptp(run.command_V)))
    for run in runs:
        check_run(run, related=run is widest)  # what shakes the actuator may drown its small movements
    _check_once([_mark(run) for run in runs], runs)
    usual = abs(model.gain_um_per_V) * float(model.slopes[-1])
    for run in runs:
        together = correlation(run)
        if _opposite(run, model.gain_um_per_V):
            raise BadInput(f"{run.path}: moves opposite to the model; check the sign of command and displacement")
        if together * np.sign(model.gain_um_per_V) < -tuned.MIN_CORRELATION:
            notes.append(f"{run.path} moves opposite to the model, as one that is late by half a period does; if its "
                         "sign was changed, the diagnosis means nothing")
        gain, along = _gains_um_per_V(run)
        times = max(gain / usual, usual / gain)
        if along > 0:
            times = min(times, max(along / usual, usual / along))
        if times > tuned.OTHER_UNITS:
            raise BadInput(f"{run.path}: moves {gain:.3g} um/V, but the model moves {usual:.3g} um/V: the units "
                           "differ; give volts as at commissioning and displacement in um (`rdpi import`)")
        if times > tuned.MODEL_SPREAD and abs(together) > tuned.MIN_CORRELATION:
            notes.append(f"{run.path} moves {gain:.3g} um/V, but the model moves {usual:.3g} um/V; check that it is "
                         "of the same actuator")
        if (found := _disturbed(run) or _stopped(run)) is not None:
            notes.append(found)
        stays = stays_at_an_end(run)
        if stays:
            notes.append(f"{run.path}: {stays} samples stay at the highest or lowest reading while the command "
                         "moves; a clipped sensor looks like saturation of the amplifier or a curved scale")
        _check_covariates(run)
        if "monitor_V" in run.columns:
            check_monitor(run, model.drive.max_V - model.drive.min_V)
        low, high = float(np.min(run.command_V)), float(np.max(run.command_V))
        beyond = max(model.drive.min_V - low, high - model.drive.max_V)
        if beyond > model.drive.max_V - model.drive.min_V:
            raise BadInput(f"{run.path}: the command goes {beyond:.3g} V beyond {model.drive.min_V:g} to "
                           f"{model.drive.max_V:g} V, the whole range of the model; check units and actuator, or fit "
                           "a model to such drives")
        if beyond > tuned.BEYOND * (model.drive.max_V - model.drive.min_V):
            notes.append(f"{run.path}: the command goes {beyond:.3g} V beyond the range that the model was fitted to")
    known = passport_file.read(model)
    rates = [run.sample_rate_hz for run in (known.runs if known else ()) if run.sample_rate_hz]
    for run in runs:
        if rates and not min(rates) / tuned.OTHER_CLOCK < run.sample_rate_hz < max(rates) * tuned.OTHER_CLOCK:
            notes.append(f"{run.path} has {run.sample_rate_hz:.3g} samples per second, the recordings of the fit "
                         f"{min(rates):.4g} to {max(rates):.4g}; check that time_s is in s")
    if (count := sum(map(len, runs))) < tuned.FEW_SAMPLES:
        notes.append(f"there are only {count} samples, too few to rely on what is named")
    others = sorted({name for run in runs if (name := run.metadata.get("actuator", "")) and name != model.actuator})
    if others and model.actuator:
        notes.append(f"the recordings are of {', '.join(others)}, but the model is of {model.actuator}")
    fitted = fitted_digests(model)
    seen = [run.path for run in runs if run.digest and run.digest in fitted]
    if seen:
        notes.append(f"the model was fitted to {', '.join(seen)}; give other recordings")
    if known is None:
        notes.append("the model has no passport, so its own error cannot be separated from what is new; "
                     "fit the model again to get one")
    if len(runs) == 1:
        notes.append("there is only one recording, so effects were judged on parts of it that were left out; this "
                     "promises more than other recordings keep; give several recordings with different waveforms")
    return notes


def fitted_digests(model: Model) -> list[str]:
    """Digests of the runs that the model was fitted to, without those held out. Raises BadInput, naming the key, where
    they cannot be read.
    """
    return [run["digest"] for run in _fitted(model)
            if isinstance(run.get("digest"), str) and run.get("held_out") is not True]


def _fitted(model: Model) -> list[dict[str, Any]]:
    runs = model.fit.get("runs", [])
    if not isinstance(runs, list) or not all(isinstance(run, dict) for run in runs):
        raise BadInput(f"{model.where}: fit.runs: must be a list of objects, as `rdpi fit` writes it; "
                       "fit the model again, or remove fit.runs")
    return runs


def same_drives(runs: Sequence[Recording], earlier: Sequence[Recording]) -> list[Recording]:
    """For each run the earlier recording whose command is the same from the first sample on, as long as the run.

    Raises BadInput for a run that has none, or one that lacks what effects follow.
    """
    found = []
    for run in runs:
        for one in earlier:
            both = min(len(run), len(one))
            if all(np.array_equal(run.columns[name][:both], one.columns[name][:both])
                   for name in ("command_V", "displacement_um")):
                raise BadInput(f"{run.path}: holds the samples of {one.path}, which is to be earlier; give the later "
                               "recording and the earlier one")
        alike = [one for one in earlier if abs(one.sample_time_s / run.sample_time_s - 1) < RATE_TOLERANCE]
        if not alike:
            raise BadInput(f"{run.path}: no earlier recording has its {run.sample_rate_hz:g} samples per second")
        apart, nearest = min(((_apart(run, one), one) for one in alike), key=lambda pair: pair[0])
        if apart > tuned.SAME_DRIVE or len(nearest) < len(run):
            short = f"which differs by {f'up to {100 * apart:.3g} %' if apart < 1 else 'more than all'} of the range" \
                if apart > tuned.SAME_DRIVE and len(nearest) >= len(run) \
                else f"which ends after {len(nearest)} of its {len(run)} samples"
            raise BadInput(f"{run.path}: no earlier recording has the same drive throughout (the nearest is "
                           f"{nearest.path}, {short}); remove this run, or add its earlier recording with another "
                           "`earlier`")
        lacks = [name for name in run.columns if name.endswith(("_V", "_degC")) and name not in nearest.columns]
        if lacks:
            raise BadInput(f"{nearest.path}: lacks {', '.join(lacks)}, which {run.path} has; remove it from "
                           f"{run.path}, or give another earlier recording")
        found.append(replace(nearest, columns={name: values[:len(run)] for name, values in nearest.columns.items()}))
    return found


def _apart(run: Recording, other: Recording) -> float:
    """Largest distance of two commands as far as both go, as a share of the range, and the share that one lacks."""
    both = min(len(run), len(other))
    span_V = max(float(np.ptp(run.command_V)), LEAST_RANGE)
    apart = float(np.max(np.abs(other.command_V[:both] - run.command_V[:both]))) / span_V
    return apart + 1 - both / len(run)


def _check_covariates(run: Recording) -> None:
    """Raise BadInput for absurd covariates."""
    for name, values in run.columns.items():
        if np.max(np.abs(values)) > LARGEST_INPUT and name != "time_s":
            raise BadInput(f"{run.path}: {name} reaches {np.max(np.abs(values)):g}; check its unit, or remove the "
                           "column")


def check_monitor(run: Recording, range_V: float) -> None:
    """Raise BadInput for a monitor that cannot be what drives the actuator, in V."""
    monitor = run.columns["monitor_V"]
    if np.ptp(monitor) < LEAST_RANGE:
        raise BadInput(f"{run.path}: monitor_V is constant at {monitor[0]:g} V while the command moves; check the monitor, "
                       "or remove the column")
    late = np.abs(late_correlations(run, monitor))
    slope = float(np.polyfit(run.command_V, monitor, 1)[0])
    middle, moved = float(np.mean(run.command_V)), float(np.mean(monitor))
    # An amplifier of another gain moves its mean as well; one that is too slow for the drive does not.
    aside = min(abs(moved - middle), abs(moved - slope * middle))
    # An amplifier too slow for the drive follows it by little, and late; in other units, at once.
    slow = late[0] < tuned.AT_ONCE and np.max(late) > tuned.MIN_CORRELATION
    least, most = tuned.MONITOR_SLOPE
    if not (least < slope < most or slow) or aside > tuned.MONITOR_ASIDE * range_V:
        raise BadInput(f"{run.path}: monitor_V moves {slope:.3g} V per volt of the command and lies {moved - middle:.3g} V "
                       "from it; give volts at the actuator, as in command_V, or remove the column")


def correlation(run: Recording) -> float:
    """Of command and displacement, -1 to 1."""
    return float(np.corrcoef(run.command_V, run.displacement_um)[0, 1])


def late_correlations(run: Recording, signal: np.ndarray) -> np.ndarray:
    """Of the command and what a signal is so many samples later, from 0 to LATEST_S, itself not included; (lags,), -1 to 1.

    A fast drive and an actuator that is late by half its period go against each other.
    """
    samples = len(run)
    lags = max(1, min(samples // 4, round(tuned.LATEST_S / run.sample_time_s)))
    u, z = (values - np.mean(values) for values in (run.command_V, signal))
    size = 1 << (2 * samples - 1).bit_length()
    product = np.fft.irfft(np.conj(np.fft.rfft(u, size)) * np.fft.rfft(z, size), size)[:lags]
    return product / max(float(np.sqrt((u @ u) * (z @ z))), np.finfo(float).tiny)


def _coherence(run: Recording) -> float:
    """Of command and displacement, 0 to 1: mean over frequency as the displacement's power lies. What rings goes along with
    the command at every frequency, each time otherwise; what has nothing to do with it does not.
    """
    from scipy import signal

    part = min(max(len(run) // COHERENT_PARTS, 8), len(run))
    shared = signal.coherence(run.command_V, run.displacement_um, nperseg=part)[1]
    power = signal.welch(run.displacement_um, nperseg=part)[1]
    return float(np.sum(np.nan_to_num(shared) * power) / max(float(np.sum(power)), np.finfo(float).tiny))


def stays_at_an_end(run: Recording) -> int:
    """Samples at the very highest or lowest reading while the command moves, 0 if a sound sensor may do that."""
    z, moving = run.displacement_um, np.gradient(run.command_V) != 0
    stays = max(int(np.count_nonzero((z == end) & moving)) for end in (z.min(), z.max()))
    grid = len(np.unique(z)) < len(z) / 20  # a coarse sensor has many equal readings everywhere
    return stays if stays > tuned.CLIPPED_SHARE * len(z) and not grid else 0
