"""What is said of predictions and of tracking: the table of errors, the error over all runs, why not to trust one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..data import Recording
from ..model import Model
from . import effects
from .chain import ALONE, Prediction, Score, reachable_um
from .inverse import Inverse
from .memory import swept_um
from .tracking import Tracked

WORTH_A_NOTE = 0.01  # of the drive's range, or of the samples
ROUNDED = 2e-4  # of the drive's range: noise that single precision adds
OTHER_SIZE = 10.0  # times as far, or a tenth: a run is in other units
OPPOSITE = -0.5  # correlation with the prediction, below which a run is upside down


def lacking(model: Model, run: Recording) -> list[str]:
    """Effects of the model that the run lacks something for."""
    return [f"{run.path}: {missing}, so {one.effect.name} is left out"
            for one in effects.acting(model) if (missing := one.effect.missing_in(run, one.values))]


def estimated_start(model: Model) -> dict[str, Any] | None:
    """The first recording of the model, if its memory was only estimated: the model begins there."""
    fitted = model.fit.get("runs")
    first = fitted[0] if isinstance(fitted, list) and fitted else None
    return first if isinstance(first, dict) and first.get("memory") == "estimated" else None


def begins_aside(inverse: Inverse, drive_V: np.ndarray) -> str | None:
    """That the drive begins aside of where the start-up sweep ends, and where a reference begins that does not. None: it
    begins there.
    """
    model = inverse.model
    end_V = model.sweep_end()
    aside_V = float(drive_V[0]) - end_V
    if abs(aside_V) < WORTH_A_NOTE * (model.drive.max_V - model.drive.min_V):
        return None
    return (f"the drive begins {aside_V:+.4g} V from where the start-up sweep ends, in one sample; a reference that begins at "
            f"{swept_um(model, float(model.x_of(end_V))):.4g} um and at rest begins without a step")


def doubts(model: Model, inverse: Inverse, run: Recording, column: str, swept: bool, single: bool) -> list[str]:
    """Why the drive for a reference, a column of `run` in um, may not take the actuator there: a memory that was only
    estimated, where no start-up sweep comes first; a lead that looks beyond the reference's end; columns that the
    reference lacks; `single` precision, where the chain differentiates its rounding.
    """
    found = [f"{run.path}: has no column {one.column}, so nothing is subtracted for it" for one in inverse.addends
             if one.column not in run.columns]
    if not swept and (first := estimated_start(model)) is not None:
        found.append(f"the drive begins where the first recording of the model began, {first.get('file')}, whose "
                     "memory was estimated; for an actuator behind its start-up sweep give --sweep")
    if (ahead := inverse.chain.preview_samples(run.sample_time_s)) >= len(run):
        found.append(f"{run.path}: its {len(run)} samples are no more than the {ahead} that the lead looks ahead, so "
                     "its last value is all that is tracked")
    drive, reference_um = inverse.model.drive, run.columns[column]
    usable_um = np.clip(reference_um[np.isfinite(reference_um)], *reachable_um(inverse.model))
    largest_um = float(np.max(np.abs(usable_um), initial=0.0))
    rounded_V = inverse.chain.rounding_um(run.sample_time_s, largest_um) / abs(inverse.model.gain_um_per_V)
    if single and rounded_V > ROUNDED * (drive.max_V - drive.min_V):
        found.append(f"single precision rounds the reference, and the chain differentiates that: the drive has about "
                     f"{rounded_V:.2g} V rms of noise at {run.sample_rate_hz:g} samples per second; use fixed point "
                     "(q31), fewer samples per second, or leave out what the lead compensates")
    return found


def overall_rms_percent(scores: Sequence[Score | Tracked], samples: Sequence[int]) -> float:
    """rms error over all runs in percent of the stroke, each run weighted by its number of samples."""
    squares = sum(weight * score.rms_percent**2 for weight, score in zip(samples, scores))
    return (squares / sum(samples)) ** 0.5


def table(rows: Sequence[tuple[str, Score | Tracked, str]], of: str = "the run's stroke") -> list[str]:
    """Lines of a table: path, errors in um and in % `of` something, and a remark for each run; at least one."""
    width = max(len(path) for path, _, _ in rows)
    lines = [f"  {'':{width}}  {'rms um':>9} {'max um':>9} {'rms %':>7} {'max %':>7}   (% of {of})"]
    return lines + [f"  {path:{width}}  {score.rms_um:9.4g} {score.max_um:9.4g} "
                    f"{score.rms_percent:7.3f} {score.max_percent:7.3f}   {remark}" for path, score, remark in rows]


def _at_odds(run: Recording, prediction: Prediction) -> list[str]:
    """That a run moves opposite to its prediction, or far more or less: of another sign, or in other units."""
    measured, predicted = run.columns.get("displacement_um"), prediction.predicted_um
    if measured is None or not np.ptp(measured) > 0 or not np.ptp(predicted) > 0:
        return []
    times, alike = float(np.ptp(measured) / np.ptp(predicted)), float(np.corrcoef(measured, predicted)[0, 1])
    found = [f"{run.path}: moves opposite to the prediction; check the sign of command and displacement"] \
        if alike < OPPOSITE else []
    if not 1 / OTHER_SIZE < times < OTHER_SIZE:
        found.append(f"{run.path}: moves {times:.3g} times as far as predicted; give volts as at commissioning and the "
                     "displacement in um")
    return found


def notes(model: Model, run: Recording, prediction: Prediction) -> list[str]:
    """Why the prediction of a run may be worse than the model: its drive, its rate, a column that it lacks.
    """
    found = lacking(model, run) + _at_odds(run, prediction)
    if run.memory == "carried" and prediction.memory == "estimated":
        found.append(f"{run.path}: {ALONE}; the prediction starts from an estimate")
    low_V, high_V = model.drive.min_V, model.drive.max_V
    beyond = max(low_V - run.command_V.min(), run.command_V.max() - high_V)
    if beyond > WORTH_A_NOTE * (high_V - low_V):
        found.append(f"{run.path}: the command goes {beyond:.3g} V beyond the drive range of the model, "
                     f"{low_V:g} to {high_V:g} V")
    guarded = float((prediction.rate_um_per_s > model.rate.max_um_per_s).mean())
    if guarded > WORTH_A_NOTE:
        found.append(f"{run.path}: in {100 * guarded:.3g} % of the samples the rate exceeded the guard, "
                     f"{model.rate.max_um_per_s:.4g} um/s, and was clamped")
    return found
