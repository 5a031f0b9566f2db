"""What is said of predictions: the table of their errors, the error over all runs, and why not to trust one."""

from __future__ import annotations

from collections.abc import Sequence

from ..data import Recording
from ..model import Model
from .chain import Prediction, Score

WORTH_A_NOTE = 0.01  # of the drive's range, or of the samples


def overall_rms_percent(scores: Sequence[Score], samples: Sequence[int]) -> float:
    """rms error over all runs in percent of the stroke, each run weighted by its number of samples."""
    squares = sum(weight * score.rms_percent**2 for weight, score in zip(samples, scores))
    return (squares / sum(samples)) ** 0.5


def table(rows: Sequence[tuple[str, Score, str]]) -> list[str]:
    """Lines of a table: path, errors and a remark for each run; at least one."""
    width = max(len(path) for path, _, _ in rows)
    lines = [f"  {'':{width}}  {'rms um':>9} {'max um':>9} {'rms %':>7} {'max %':>7}   (% of the run's stroke)"]
    return lines + [f"  {path:{width}}  {score.rms_um:9.4g} {score.max_um:9.4g} "
                    f"{score.rms_percent:7.3f} {score.max_percent:7.3f}   {remark}" for path, score, remark in rows]


def notes(model: Model, run: Recording, prediction: Prediction) -> list[str]:
    """Why the prediction of a run may be worse than the model: its drive, its rate, a rate that did not settle."""
    found = []
    low_V, high_V = model.drive.min_V, model.drive.max_V
    beyond = max(low_V - run.command_V.min(), run.command_V.max() - high_V)
    if beyond > WORTH_A_NOTE * (high_V - low_V):
        found.append(f"{run.path}: the command goes {beyond:.3g} V beyond the model's drive range, "
                     f"{low_V:g} to {high_V:g} V")
    guarded = float((prediction.rate_um_per_s > model.rate.max_um_per_s).mean())
    if guarded > WORTH_A_NOTE:
        found.append(f"{run.path}: in {100 * guarded:.2g} % of the samples the rate was beyond the guard, "
                     f"{model.rate.max_um_per_s:.4g} um/s, and clamped")
    if not prediction.settled:
        found.append(f"{run.path}: the prediction's own rate did not settle; treat it with care, "
                     "or fit with a longer --rate-window")
    return found
