"""The pictures of `rdpi gap`'s report: where the residual lies, how it looks over time, and how far it shrinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...data import Recording
from ...identify.report import base, drawing, drawn, edge_names, plain
from ..sections import GapDocument, RunEntry
from .words import AXES, terms

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...identify import Axis, AxisEntry, Table

AFTER, INK, NOW, WIDE = drawing.AFTER, drawing.INK, drawing.NOW, drawing.WIDE
SMALL = 3.4, 2.3  # inches
LETTERS = 24  # that fit below a small picture side by side
BARS = 24  # recordings in the picture; the table has all
WITH = "with the effects"


@dataclass(frozen=True)
class Pictures:
    """What the pictures need beyond the document."""

    runs: Sequence[Recording]
    before_um: Sequence[np.ndarray]  # measured - predicted, (samples,) per run
    after_um: Sequence[np.ndarray]  # the same with the effects added
    table: Table  # rms over position x rate
    spectrum_after: Axis | None  # the axis frequency_hz with the effects added; None where none was


def where(document: GapDocument, pictures: Pictures) -> list[drawing.Shown]:
    """Of the section "where": the residual along each axis, over position and rate, over time."""
    found, added, usual = document.where, bool(document.effects), terms(document).usually
    dominant, axes = found.dominant, found.axes
    worst = int(np.argmax([np.std(residual) for residual in pictures.before_um]))
    run, before = pictures.runs[worst], pictures.before_um[worst]
    after = {WITH: pictures.after_um[worst]} if added else {}
    name = (f"{'the recording' if len(pictures.runs) == 1 else 'the worst recording'}, "
            f"{plain(base(run.path), 60)}")
    with drawing.style():
        shown = [drawing.shown(axis_figure(name, axes[name], usual), f"Along {AXES[name].title}.", False,
                               name == dominant) for name in AXES if name not in ("frequency_hz", "recording")]
        shown += [
            drawing.shown(spectrum_figure(axes["frequency_hz"], pictures.spectrum_after, usual),
                          "Spectrum of the residual.", True, dominant == "frequency_hz"),
            drawing.shown(drawing.table_figure(pictures.table),
                          "rms of the residual over position and rate. Empty cells hold hardly any samples."),
            drawing.shown(drawing.residual_figure(run, {"now": before, **after}, document.runs[worst].noise_floor_um),
                          f"Residual of {name}: all of it, and where it is worst."),
            drawing.shown(drawing.time_figure(run, {"model": before, **after}),
                          f"Measured against predicted where {name}, is missed most. The mean error is removed."),
            drawing.shown(drawing.loop_figure(run, {"model": before, **after}),
                          f"Loop of {name}: one wide cycle, and what is missed of it.", False)]
    return shown


def recordings(document: GapDocument) -> drawing.Shown:
    """The picture of all recordings, the one with the largest share of the gap first."""
    with drawing.style():
        return drawing.shown(runs_figure(ranked(document), bool(document.effects), terms(document).usually),
                             "Residual of each recording.")


def ranked(document: GapDocument) -> list[RunEntry]:
    """Recordings, the one with the largest share of the gap first."""
    return sorted(document.runs, key=lambda run: -run.share)


def axis_figure(name: str, axis: AxisEntry, usual: str) -> Figure:
    """The rms in each bin, and beside it what is `usual` by the passport."""
    figure, axes = drawing.panel(SMALL)
    rms = np.array(axis.rms_um)
    at = np.arange(len(rms))
    if axis.expected_um:
        axes.bar(at - 0.21, rms, width=0.42, color=NOW, label="now")
        axes.bar(at + 0.21, axis.expected_um, width=0.42, color=INK, label=usual)
    else:
        axes.bar(at, rms, width=0.84, color=NOW)
    if axis.edges is not None:
        labels = edge_names(axis.edges)
        axes.set_xticks(np.arange(len(labels)) - 0.5, labels)
    else:
        labels = [drawn(base(label), 14) for label in axis.bins]
        axes.set_xticks(at, labels)
    if sum(map(len, labels)) > LETTERS:
        for label in axes.get_xticklabels():
            label.set(rotation=45, ha="right", rotation_mode="anchor")
    axes.set(xlabel=AXES[name].label, ylabel="residual [µm rms]", xlim=(-0.6, len(rms) - 0.4))
    drawing.legend(axes)
    return figure


def spectrum_figure(axis: AxisEntry, after: Axis | None, usual: str) -> Figure:
    """rms per band of frequency now, as is `usual` by the passport, and with the effects added."""
    edges = np.array(axis.edges)
    curves = [("now", axis.rms_um, edges, {"color": NOW, "lw": 1.8})]
    if axis.expected_um:
        curves.append((usual, axis.expected_um, edges, {"color": INK, "lw": 1.4, "ls": "--"}))
    if after is not None:
        curves.append((WITH, after.rms_um, after.edges, {"color": AFTER, "lw": 1.8}))
    return drawing.spectrum_figure(curves)


def runs_figure(runs: Sequence[RunEntry], added: bool, usual: str) -> Figure:
    """rms of each run now and, with effects `added`, with them; the noise floor and what is `usual` beside them."""
    shown = runs[:BARS]
    figure, axes = drawing.panel((WIDE[0], 1.1 + 0.3 * len(shown)))
    at = np.arange(len(shown))
    before = np.array([run.rms_um.before for run in shown])
    marks = [("now", before, {"marker": "o", "color": NOW, "ms": 7})]
    if added:
        after = np.array([run.rms_um.after for run in shown])
        axes.hlines(at, np.minimum(before, after), np.maximum(before, after), color=INK, lw=1)
        marks.append((WITH, after, {"marker": "o", "color": AFTER, "ms": 7}))
    noise = np.array([run.noise_floor_um for run in shown])
    expected = np.array([before[k] / run.ratio if run.ratio else np.nan for k, run in enumerate(shown)])
    marks += [(usual, expected, {"marker": "|", "color": INK, "ms": 13, "mew": 2}),
              ("noise floor", noise, {"marker": "x", "color": INK, "ms": 5})]
    for label, values, look in marks:
        if np.isfinite(values).any():
            axes.plot(values, at, ls="", label=label, zorder=3, **look)
    axes.set_yticks(at, [f"{drawn(base(run.file), 22)}  {k}" for k, run in enumerate(shown, 1)])
    axes.set(xlabel="residual [µm rms]", ylim=(len(shown) - 0.4, -0.6))
    axes.set_xlim(left=0)
    axes.grid(axis="x", color=INK, alpha=0.25, lw=0.6)
    axes.set_axisbelow(True)
    drawing.legend(axes)
    return figure
