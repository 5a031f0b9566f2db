"""Intake: what makes a recording unfit for identification, found before anything is fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from . import firmware
from .errors import BadInput
from .model import MAX_OFFSET, Model
from .recording import Recording

LARGEST_INPUT = 1e6  # V or um
MIN_CORRELATION = 0.5  # between command and displacement
GAIN_SPREAD = 5.0  # between the runs' um per volt
MODEL_SPREAD = 3.0  # between the model's um per volt and a recording's
UNITS = 200.0  # ... from which it is a matter of units
CLIPPED_SHARE = 0.01  # of the samples at the very highest or lowest reading while the command moves


def check_run(run: Recording, related: bool = True) -> None:
    """Raise BadInput, naming the file and a remedy, for a run from which no hysteresis can be identified.

    `related`: command and displacement must go together.
    """
    command, displacement = run.command_V, run.displacement_um
    for name, values in (("command_V", command), ("displacement_um", displacement)):
        largest = float(np.max(np.abs(values)))
        if largest > LARGEST_INPUT:
            raise BadInput(f"{run.path}: {name} reaches {largest:g}; check its unit")
    if np.ptp(command) == 0:
        raise BadInput(f"{run.path}: command_V is constant at {command[0]:g} V; "
                       "identification needs a drive that moves: leave this run out, or see `rdpi excite`")
    if np.ptp(displacement) == 0:
        raise BadInput(f"{run.path}: displacement_um is constant at {displacement[0]:g} um; "
                       "check the sensor and its column")
    together = correlation(run)
    if related and abs(together) < MIN_CORRELATION:
        raise BadInput(f"{run.path}: command_V and displacement_um are unrelated (correlation {together:.2f}); "
                       "check that both columns are of the same run, and their order and units")
    if reversals(command, 0.05) == 0:
        raise BadInput(f"{run.path}: command_V never turns round, so that nothing of the hysteresis shows; "
                       "record a drive that goes up and down, see `rdpi excite`")
    offset, stroke = float(np.mean(displacement)), float(np.ptp(displacement))
    if abs(offset) > MAX_OFFSET * stroke:
        raise BadInput(f"{run.path}: displacement_um moves by {stroke:.3g} um at {offset:.6g} um; "
                       "the firmware's single precision cannot carry both: subtract the offset first")


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
    check_once([*runs, *hold_out], ", and one that is fitted is not held out")
    gains = [float(np.ptp(run.displacement_um) / np.ptp(run.command_V)) for run in runs]
    low, high = int(np.argmin(gains)), int(np.argmax(gains))
    if gains[high] > GAIN_SPREAD * gains[low]:
        raise BadInput(f"{runs[high].path} moves {gains[high]:.3g} um/V and {runs[low].path} {gains[low]:.3g}: "
                       "they are not in the same units, or not of the same actuator; "
                       "check --command-gain and units of `rdpi import`")
    largest = max(runs, key=lambda run: np.ptp(run.command_V))
    slope, zero = np.polyfit(largest.command_V, largest.displacement_um, 1)
    for run in runs:
        if correlation(run) * slope < 0:
            raise BadInput(f"{run.path}: moves opposite to {largest.path}; one of them has the sign inverted")
        moved = float(np.mean(run.displacement_um) - slope * np.mean(run.command_V) - zero)
        if abs(moved) > np.ptp(largest.displacement_um) / 2:
            raise BadInput(f"{run.path}: lies {moved:.4g} um from {largest.path} at the same command; "
                           "the sensor's zero or the command's offset has changed: subtract it, or fit the runs apart")


def check_once(runs: Sequence[Recording], why: str = "") -> None:
    """Raise BadInput for a run that is given twice."""
    digests = [run.digest for run in runs if run.digest]
    for run in runs:
        if digests.count(run.digest) > 1:
            raise BadInput(f"{run.path}: given twice (the same bytes); a run counts once{why}")


def check_against(model: Model, runs: Sequence[Recording]) -> list[str]:
    """Remarks; raises BadInput for recordings that are not this actuator's, or not in these units."""
    notes = []
    widest = max(runs, key=lambda run: float(np.ptp(run.command_V)))
    for run in runs:
        check_run(run, related=run is widest)  # what shakes the actuator may drown its small movements
    check_once(runs)
    usual = abs(model.gain_um_per_V) * float(model.slopes[-1])
    for run in runs:
        together = correlation(run)
        if together * np.sign(model.gain_um_per_V) < -MIN_CORRELATION:
            raise BadInput(f"{run.path}: moves opposite to the model; check the sign of command and displacement")
        gain = float(np.ptp(run.displacement_um) / np.ptp(run.command_V))
        times = max(gain / usual, usual / gain)
        if times > UNITS:
            raise BadInput(f"{run.path}: moves {gain:.3g} um/V, the model {usual:.3g}: these are other units; give "
                           "volts as at commissioning, and displacement in um (`rdpi import`)")
        if times > MODEL_SPREAD and abs(together) > MIN_CORRELATION:
            notes.append(f"{run.path} moves {gain:.3g} um/V and the model {usual:.3g}: is it the same actuator?")
        name = run.metadata.get("actuator", "")
        if name and model.actuator and name != model.actuator:
            notes.append(f"{run.path} was recorded from {name}, the model is of {model.actuator}")
        stays = stays_at_an_end(run)
        if stays:
            notes.append(f"{run.path}: {stays} samples stand at the very highest or lowest reading while the command "
                         "moves: a clipped sensor looks like saturation of the amplifier or a curved scale")
        low, high = float(np.min(run.command_V)), float(np.max(run.command_V))
        beyond = max(model.drive.min_V - low, high - model.drive.max_V)
        if beyond > 0.05 * (model.drive.max_V - model.drive.min_V):
            notes.append(f"{run.path}: the command goes {beyond:.3g} V beyond what the model was fitted to")
    if model.passport is None:
        notes.append("the model has no passport: what it always missed cannot be told from what is new; "
                     "fit it again to get one")
    if len(runs) == 1:
        notes.append("one recording only: effects were judged on parts of it that were left out, which promises more "
                     "than other recordings keep; give several with different waveforms")
    return notes


def correlation(run: Recording) -> float:
    """Of command and displacement, -1 to 1."""
    return float(np.corrcoef(run.command_V, run.displacement_um)[0, 1])


def stays_at_an_end(run: Recording) -> int:
    """Samples at the very highest or lowest reading while the command moves, 0 if a sound sensor may do that."""
    z, moving = run.displacement_um, np.gradient(run.command_V) != 0
    stays = max(int(np.count_nonzero((z == end) & moving)) for end in (z.min(), z.max()))
    grid = len(np.unique(z)) < len(z) / 20  # a coarse sensor has many equal readings everywhere
    return stays if stays > CLIPPED_SHARE * len(z) and not grid else 0
