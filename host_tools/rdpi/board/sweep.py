"""The start-up sweep: a decaying oscillation of the drive, and what the plays remember after it."""

from __future__ import annotations

from ..data import amid
from ..model import Model

STILL = 1e-3  # of the DAC's range: a drive that moves no more has stayed where the sweep ended
OFF_THE_MIDDLE = "the sweep does not end in the middle of its range"


def memory_after(model: Model, first_V: float) -> tuple[str, str]:
    """What a drive remembers that starts at `first_V`, in V, right after the model's start-up sweep.

    Returns the metadata `memory`, "reset" or "unknown", and the reason where the sweep itself makes it unknown, else
    "". It is "reset" if the drive starts where the sweep ends, and it is known where that leaves the plays: near the
    middle of the drive's range, or anywhere if the model says so.
    """
    low_V, high_V, end_V = model.drive.min_V, model.drive.max_V, model.sweep_end()
    stays = abs(first_V - end_V) <= STILL * (high_V - low_V)
    if stays and (model.memory.sweep_share is not None or amid(end_V, low_V, high_V)):
        return "reset", ""
    return "unknown", OFF_THE_MIDDLE if stays else ""
