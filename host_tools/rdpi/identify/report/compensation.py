"""The page of `rdpi compensate --report`: the drive that the firmware computes, beside what was recorded."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import version
from ...data import Recording, atomic_write, make_folder
from . import drawing
from .figure import thin
from .numbers import base, number, plain
from .templating import environment

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE, DOCUMENT = "compensate.html", "compensate.json"

TEMPLATES = environment(__package__)


def write_compensation(folder: str | os.PathLike[str], drive: Recording, effects: Sequence[str],
                       rms_percent: float | None, document: dict[str, Any]) -> None:
    """Write compensate.html and compensate.json, the `document`, into a folder, which is made, each atomically.

    `drive` has the columns of `rdpi compensate -o`, with displacement_um. `effects` are lines of text.
    `rms_percent` is the computed drive's distance from recorded_V, of its peak-to-peak; None without that column.
    """
    text = _page(drive, effects, rms_percent)
    make_folder(folder)
    atomic_write(Path(folder) / PAGE, text)
    atomic_write(Path(folder) / DOCUMENT, json.dumps(document, indent=2, allow_nan=False) + "\n")


def _page(drive: Recording, effects: Sequence[str], rms_percent: float | None) -> str:
    with drawing.style():
        return TEMPLATES.get_template("compensate.html.j2").render(
            heading=plain(drive.metadata.get("actuator") or base(drive.path), 100),
            sentence=_sentence(drive, rms_percent), effects=[plain(line, 400) for line in effects],
            flagged=int(np.count_nonzero(drive.columns["flags"])), samples=len(drive),
            figures=[drawing.shown(made, caption, wide) for made, caption, wide in _figures(drive, rms_percent is not None)],
            facts=[("tool", f"rdpi {version()}")])


def _sentence(drive: Recording, rms_percent: float | None) -> str:
    computed_V = drive.columns["command_V"]
    text = f"The firmware's drive spans {number(computed_V.min(), 4)} to {number(computed_V.max(), 4)} V"
    if rms_percent is None:
        return f"{text}."
    return f"{text}. It is {number(rms_percent, 2)} % rms of the recorded drive's peak-to-peak away from that."


def _figures(drive: Recording, recorded: bool) -> list[tuple[Figure, str, bool]]:
    """Pictures, captions, and which are wide."""
    computed_V = drive.columns["command_V"]
    missed_um = drive.displacement_um - drive.columns["reference_um"]
    apart_V = computed_V - drive.columns["recorded_V"] if recorded else None
    part = drawing.worst_part(np.nan_to_num(missed_um if apart_V is None else apart_V))  # nan: no reference
    found = [(_time(drive, part, recorded), "Reference and displacement, and the drives, where they are furthest apart.",
              True)]
    if apart_V is not None:
        found.append((_difference(drive, apart_V), "Computed less recorded drive, against the reference. A loop is "
                                                   "hysteresis or delay that the model lacks.", True))
    return [*found, (_against(drive, recorded), "The drives against the reference.", False)]


def _time(drive: Recording, part: slice, recorded: bool) -> Figure:
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(drawing.WIDE[0], 1.2 * drawing.WIDE[1]), layout="constrained")
    upper, lower = drawn.subplots(2, 1, sharex=True)
    time_s = (drive.time_s - drive.time_s[0])[part]
    upper.plot(time_s, drive.columns["reference_um"][part], color=drawing.INK, lw=2, alpha=0.7, label="reference")
    upper.plot(time_s, drive.displacement_um[part], "--", color=drawing.NOW, lw=1, label="displacement")
    upper.set(ylabel="displacement [µm]", xlim=(time_s[0], time_s[-1]))
    if recorded:
        lower.plot(time_s, drive.columns["recorded_V"][part], color=drawing.INK, lw=2, alpha=0.7, label="recorded")
    lower.plot(time_s, drive.columns["command_V"][part], color=drawing.AFTER, lw=1, label="computed")
    lower.set(xlabel=drawing.LABELS["time_s"], ylabel="drive [V]")
    drawing.legend(upper)
    drawing.legend(lower)
    return drawn


def _difference(drive: Recording, apart_V: np.ndarray) -> Figure:
    drawn, axes = drawing.panel()
    part = thin(len(drive))
    axes.plot(drive.columns["reference_um"][part], apart_V[part], color=drawing.NOW, lw=0.6)
    axes.set(xlabel="reference [µm]", ylabel="difference [V]")
    return drawn


def _against(drive: Recording, recorded: bool) -> Figure:
    drawn, axes = drawing.panel()
    part = thin(len(drive))
    if recorded:
        axes.plot(drive.columns["reference_um"][part], drive.columns["recorded_V"][part], color=drawing.INK, lw=1.5,
                  alpha=0.7, label="recorded")
    axes.plot(drive.columns["reference_um"][part], drive.columns["command_V"][part], color=drawing.AFTER, lw=0.7,
              label="computed")
    axes.set(xlabel="reference [µm]", ylabel="drive [V]")
    drawing.legend(axes)
    return drawn
