"""The pictures of `rdpi gap`'s report: where the residual lies, how it looks over time, and how far it shrinks."""

from __future__ import annotations

import base64
import io
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...data import Recording
from ..sections import GapDocument, RunEntry
from .numbers import base, drawn, edge_names, magnitude, plain
from .words import AXES, terms

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ...fit import Axis, AxisEntry, Table

INK = "#747a82"  # reads on white and on black
NOW, AFTER = "#d0642a", "#2f86c4"  # also told apart by those who are colour-blind
STYLE = {"font.size": 9, "text.color": INK, "axes.edgecolor": INK, "axes.labelcolor": INK, "xtick.color": INK,
         "ytick.color": INK, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
         "figure.facecolor": "none", "axes.facecolor": "none", "savefig.facecolor": "none", "svg.hashsalt": "rdpi"}
SMALL, WIDE = (3.4, 2.3), (4.6, 3.3)  # inches
COLUMNS = 500  # of a curve over time: more cannot be seen
ZOOM = 0.05  # of a recording, shown once more where the gap is worst
NUMBERED = 120  # cells of the heat map that have room for a number
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


class Shown(NamedTuple):
    """A picture of the page."""

    source: str
    caption: str
    wide: bool
    dominant: bool = False  # whether it shows the axis along which the gap concentrates most


def where(document: GapDocument, pictures: Pictures) -> list[Shown]:
    """Of the section "where": the residual along each axis, over position and rate, over time."""
    found, added, usual = document.where, bool(document.effects), terms(document).usually
    dominant, axes = found.dominant, found.axes
    worst = int(np.argmax([np.std(residual) for residual in pictures.before_um]))
    with _style():
        shown = [Shown(_source(axis_figure(name, axes[name], usual)), f"Along {AXES[name].title}.", False,
                       name == dominant) for name in AXES if name not in ("frequency_hz", "recording")]
        shown += [
            Shown(_source(spectrum_figure(axes["frequency_hz"], pictures.spectrum_after, usual)),
                  "Spectrum of the residual.", True, dominant == "frequency_hz"),
            Shown(_source(table_figure(pictures.table)),
                  "rms of the residual over position and rate. Empty cells hold hardly any samples.", True),
            Shown(_source(time_figure(pictures.runs[worst], pictures.before_um[worst],
                                      pictures.after_um[worst] if added else None,
                                      document.runs[worst].noise_floor_um)),
                  f"Residual of {'the recording' if len(pictures.runs) == 1 else 'the worst recording'}, "
                  f"{plain(base(pictures.runs[worst].path), 60)}: all of it, and where it is worst.", True)]
    return shown


def recordings(document: GapDocument) -> str:
    """The source of the picture of all recordings, the one with the largest share of the gap first."""
    with _style():
        return _source(runs_figure(ranked(document), bool(document.effects), terms(document).usually))


def ranked(document: GapDocument) -> list[RunEntry]:
    """Recordings, the one with the largest share of the gap first."""
    return sorted(document.runs, key=lambda run: -run.share)


def axis_figure(name: str, axis: AxisEntry, usual: str) -> Figure:
    """The rms in each bin, and beside it what is `usual` by the passport."""
    figure, axes = _panel(SMALL)
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
    _legend(axes)
    return figure


def spectrum_figure(axis: AxisEntry, after: Axis | None, usual: str) -> Figure:
    """rms per band of frequency now, as is `usual` by the passport, and with the effects added."""
    figure, axes = _panel(WIDE)
    edges = np.array(axis.edges)
    curves = [("now", axis.rms_um, edges, {"color": NOW, "lw": 1.8})]
    if axis.expected_um:
        curves.append((usual, axis.expected_um, edges, {"color": INK, "lw": 1.4, "ls": "--"}))
    if after is not None:
        curves.append((WITH, after.rms_um, after.edges, {"color": AFTER, "lw": 1.8}))
    for label, rms, bands, look in curves:
        axes.stairs(np.where(np.array(rms) > 0, rms, np.nan), bands, baseline=None, label=label, **look)
    axes.set(xscale="log", yscale="log", xlabel=AXES["frequency_hz"].label, ylabel="residual per band [µm rms]",
             xlim=(edges[edges > 0][0], edges[-1]))
    _legend(axes)
    return figure


def table_figure(table: Table) -> Figure:
    """Heat map; the cells are drawn equally large, with the bins' true edges beside them."""
    from matplotlib import colormaps

    figure, axes = _panel(WIDE)
    rms = table.rms_um.T
    colours = colormaps["cividis"]
    mesh = axes.pcolormesh(np.arange(rms.shape[1] + 1), np.arange(rms.shape[0] + 1), np.ma.masked_invalid(rms),
                           cmap=colours, vmin=0, edgecolors="none")
    if rms.size <= NUMBERED:
        decimals = max(0, 1 - magnitude(np.nanmax(rms, initial=0.0) / 2))
        for (row, column), value in np.ndenumerate(rms):
            if np.isfinite(value):
                axes.text(column + 0.5, row + 0.5, f"{value:.{decimals}f}", ha="center", va="center", fontsize=6,
                          color="black" if mesh.norm(value) > 0.5 else "white")
    for ticks, edges in ((axes.set_xticks, table.position_um), (axes.set_yticks, table.rate_um_per_s)):
        step = -(-len(edges) // 9)
        ticks(np.arange(len(edges))[::step], edge_names(edges)[::step])
    axes.set(xlabel=AXES["position_um"].label, ylabel=AXES["rate_um_per_s"].label)
    figure.colorbar(mesh, ax=axes, label="residual [µm rms]", pad=0.02)
    return figure


def time_figure(run: Recording, before_um: np.ndarray, after_um: np.ndarray | None, noise_um: float) -> Figure:
    """The residual over all of a run, and once more where it is worst; means removed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDE[0], 1.2 * WIDE[1]), layout="constrained")
    panels = figure.subplots(2, 1)
    time_s = run.time_s - run.time_s[0]
    residuals = [("now", NOW, before_um), *([] if after_um is None else [(WITH, AFTER, after_um)])]
    length = max(2, min(len(time_s), max(COLUMNS // 2, int(ZOOM * len(time_s)))))
    energy = np.cumsum(np.r_[0.0, (before_um - np.mean(before_um))**2])
    start = int(np.argmax(energy[length:] - energy[:-length]))
    for axes, part in zip(panels, (slice(None), slice(start, start + length))):
        for label, colour, residual in residuals:
            _band(axes, time_s[part], (residual - np.mean(residual))[part], colour, label)
        for side in (-1, 1):
            axes.axhline(side * noise_um, color=INK, lw=0.8, ls=":", label="noise, ±1 rms" if side > 0 else None)
        axes.set(ylabel="residual [µm]", xlim=(time_s[part][0], time_s[part][-1]))
    panels[1].set_xlabel(AXES["time_s"].label)
    _legend(panels[0])
    return figure


def runs_figure(runs: Sequence[RunEntry], added: bool, usual: str) -> Figure:
    """rms of each run now and, with effects `added`, with them; the noise floor and what is `usual` beside them."""
    shown = runs[:BARS]
    figure, axes = _panel((WIDE[0], 1.1 + 0.3 * len(shown)))
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
    _legend(axes)
    return figure


def _panel(size: tuple[float, float]) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots()


def _band(axes: Axes, time_s: np.ndarray, values: np.ndarray, colour: str, label: str) -> None:
    """A curve, or of a long one the span between its extremes in each column of the picture: peaks stay."""
    per_column = len(values) // COLUMNS
    if per_column < 2:
        axes.plot(time_s, values, color=colour, lw=0.9, label=label)
        return
    first = np.arange(0, len(values), per_column)
    axes.fill_between(time_s[first], np.minimum.reduceat(values, first), np.maximum.reduceat(values, first),
                      color=colour, lw=0.4, alpha=0.85, label=label)


def _legend(axes: Axes) -> None:
    """Above the panel, where it covers nothing."""
    count = len(axes.get_legend_handles_labels()[1])
    if count > 1:
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncol=2 if count == 4 else count, fontsize="small",
                    borderaxespad=0.2, columnspacing=1.2, handlelength=1.4)


def _style() -> Any:
    from matplotlib import rc_context

    return rc_context(STYLE)


def _source(figure: Figure) -> str:
    """A picture as the data URI of an SVG; the same bytes for the same picture."""
    data = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # letters the font lacks
        figure.savefig(data, format="svg", metadata={"Date": None, "Creator": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(data.getvalue()).decode()}"
