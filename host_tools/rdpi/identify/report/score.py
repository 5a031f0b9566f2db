"""The page of `rdpi score --report`: how well references were tracked."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import version
from ...data import Recording, atomic_write, make_folder
from ...simulate import tracking
from .. import passport
from . import drawing, figure
from .numbers import base, number, plain, um
from .templating import environment

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 4  # recordings with pictures, those first that were tracked worst
PAGE, DOCUMENT = "score.html", "score.json"

TEMPLATES = environment(__package__)


def write_score(folder: str | os.PathLike[str], runs: Sequence[Recording], scores: Sequence[tracking.Tracked],
                document: dict[str, Any], remove_offset: bool = False) -> None:
    """Write score.html and score.json, the `document`, into a folder, which is made. Each is written atomically.
    `remove_offset`: the scores are without the mean errors, and so are the pictures.
    """
    text = _page(runs, scores, remove_offset)
    make_folder(folder)
    atomic_write(Path(folder) / PAGE, text)
    atomic_write(Path(folder) / DOCUMENT, json.dumps(document, indent=2, allow_nan=False) + "\n")


def _page(runs: Sequence[Recording], scores: Sequence[tracking.Tracked], remove_offset: bool) -> str:
    worst = sorted(range(len(runs)), key=lambda k: -scores[k].rms_percent)
    actuator = next((run.metadata["actuator"] for run in runs if run.metadata.get("actuator")), "the reference")
    with drawing.style():
        return TEMPLATES.get_template("score.html.j2").render(
            heading=plain(actuator, 100), sentence=_sentence(scores, remove_offset), rows=_rows(runs, scores),
            figures=[one for k in worst[:SHOWN] for one in _figures(runs[k], remove_offset)],
            remove_offset=remove_offset, facts=[("tool", f"rdpi {version()}")])


def _sentence(scores: Sequence[tracking.Tracked], remove_offset: bool) -> str:
    worst = max(scores, key=lambda one: one.rms_percent)
    text = f"The displacement follows the reference to {number(worst.rms_percent, 2)} % rms of its peak-to-peak"
    better = ", or better" if len(scores) > 1 else ""
    return text + better + ("; the mean error is removed." if remove_offset else ".")


def _rows(runs: Sequence[Recording], scores: Sequence[tracking.Tracked]) -> list[dict[str, str]]:
    return [{"number": str(k + 1), "file": plain(base(run.path), 60), "rms": um(one.rms_um),
             "percent": f"{number(one.rms_percent, 2)} %", "max": f"{number(one.max_percent, 2)} %",
             "offset": um(one.offset_um), "late": f"{number(1e3 * one.delay_s, 2)} ms",
             "apart": f"{number(one.rms_percent_without_delay, 2)} %"}
            for k, (run, one) in enumerate(zip(runs, scores))]


def _figures(run: Recording, remove_offset: bool) -> list[drawing.Shown]:
    name, error = plain(base(run.path), 60), run.displacement_um - run.columns["reference_um"]
    if remove_offset:
        error = error - np.mean(error)
    made = [(_time(run, error), f"{name}: the stretch where the error is largest in rms, over time."),
            (_against(run, error), f"{name}: the error against the reference. A loop is hysteresis or delay."),
            (_spectrum(run, error), f"{name}: spectrum of the error, in octaves.")]
    return [drawing.shown(drawn, caption) for drawn, caption in made]


def _time(run: Recording, error: np.ndarray) -> Figure:
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(drawing.WIDE[0], 1.2 * drawing.WIDE[1]), layout="constrained")
    both, missed = drawn.subplots(2, 1, sharex=True)
    part = drawing.worst_part(error)
    time_s = (run.time_s - run.time_s[0])[part]
    both.plot(time_s, run.columns["reference_um"][part], color=drawing.INK, lw=2, alpha=0.7, label="reference")
    both.plot(time_s, run.displacement_um[part], "--", color=drawing.AFTER, lw=1, label="displacement")
    both.set(ylabel="displacement [µm]", xlim=(time_s[0], time_s[-1]))
    drawing.band(missed, time_s, error[part], drawing.NOW, "error")
    missed.set(xlabel=drawing.LABELS["time_s"], ylabel="error [µm]")
    drawing.legend(both)
    return drawn


def _against(run: Recording, error: np.ndarray) -> Figure:
    drawn, axes = drawing.panel()
    part = figure.thin(len(run))
    axes.plot(run.columns["reference_um"][part], error[part], color=drawing.NOW, lw=0.6)
    axes.set(xlabel="reference [µm]", ylabel="error [µm]")
    return drawn


def _spectrum(run: Recording, error: np.ndarray) -> Figure:
    bands = passport.octaves(error - np.mean(error), run.sample_rate_hz)
    edges = 2.0 ** np.arange(bands.first, bands.first + len(bands.power) + 1)
    return drawing.spectrum_figure([("error", np.sqrt(bands.power), edges, {"color": drawing.NOW, "lw": 1.8})], "error")
