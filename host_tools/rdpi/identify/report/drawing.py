"""What the pictures of a report's page have in common: colours, panels, residuals over time, frequency and place."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...data import Recording
from ..localise import Table
from ..strokes import turning_points
from . import interactive
from .figure import last_cycle, thin, whatever_letters
from .numbers import edge_names, magnitude

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

INK = "#747a82"  # reads on white and on black
NOW, AFTER = "#d0642a", "#2f86c4"  # also told apart by those who are colour-blind
STYLE = {"font.size": 9, "text.color": INK, "axes.edgecolor": INK, "axes.labelcolor": INK, "xtick.color": INK,
         "ytick.color": INK, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
         "figure.facecolor": "none", "axes.facecolor": "none", "savefig.facecolor": "none", "svg.hashsalt": "rdpi",
         "pdf.fonttype": 42}
LABELS = {"time_s": "time from the start [s]", "frequency_hz": "frequency [Hz]", "rate_um_per_s": "rate [µm/s]",
          "position_um": "position [µm]"}
WIDE, LOOP = (4.6, 3.3), (3.6, 3.4)  # inches
COLUMNS = 500  # of a curve over time: more cannot be seen
ZOOM = 0.05  # of a recording, shown once more where the residual is worst
STROKES = 8  # of a recording, shown beside what is predicted
DYNAMIC = 1e3  # of a spectrum: what is so much smaller than the largest is not shown
NUMBERED = 120  # cells of the heat map that have room for a number


class Shown(NamedTuple):
    """A picture of a page."""

    source: str  # as the data URI of an SVG
    pdf: str  # likewise of a PDF
    plot: str  # see interactive.py
    caption: str
    wide: bool = True
    dominant: bool = False  # whether it shows the axis along which the gap depends on most


def shown(figure: Figure, caption: str, wide: bool = True, dominant: bool = False) -> Shown:
    picture = source(figure)
    figure.set_layout_engine("none")  # all three have the same layout, and finding it takes long
    return Shown(picture, source(figure, "pdf"), interactive.plot(figure), caption, wide, dominant)


def panel(size: tuple[float, float] = WIDE) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots()


def spectrum_figure(curves: Sequence[tuple[str, Sequence[float], np.ndarray, dict[str, Any]]],
                    what: str = "residual") -> Figure:
    """rms per band of frequency: label, rms, edges of the bands and look of each curve; the first sets the range."""
    figure, axes = panel()
    for label, rms, bands, look in curves:
        axes.stairs(np.where(np.array(rms) > 0, rms, np.nan), bands, baseline=None, label=label, **look)
    edges = curves[0][2]
    everything = np.concatenate([np.array(rms, float) for _, rms, _, _ in curves])
    shown = everything[everything > 0]  # what is missed nowhere has no logarithm
    axes.set(xscale="log", yscale="log" if len(shown) else "linear", xlabel=LABELS["frequency_hz"],
             ylabel=f"{what} per band [µm rms]", xlim=(edges[edges > 0][0], edges[-1]))
    if len(shown) and np.min(shown) < np.max(shown) / DYNAMIC:
        axes.set_ylim(bottom=np.max(shown) / DYNAMIC)
    logarithmic(axes)
    legend(axes)
    return figure


def table_figure(table: Table, most_um: float | None = None) -> Figure:
    """Heat map; the cells are drawn equally large, with the bins' true edges beside them. Colours reach to `most_um`,
    or to the largest value.
    """
    from matplotlib import colormaps

    figure, axes = panel()
    rms = table.rms_um.T
    colours = colormaps["cividis"]
    mesh = axes.pcolormesh(np.arange(rms.shape[1] + 1), np.arange(rms.shape[0] + 1), np.ma.masked_invalid(rms),
                           cmap=colours, vmin=0, vmax=most_um, edgecolors="none")
    if rms.size <= NUMBERED:
        decimals = max(0, 1 - magnitude(np.nanmax(rms, initial=0.0) / 2))
        for (row, column), value in np.ndenumerate(rms):
            if np.isfinite(value):
                text = f"{value:.{decimals}f}"
                axes.text(column + 0.5, row + 0.5, text.removeprefix("0") if decimals > 2 else text, ha="center",
                          va="center", fontsize=min(6, 24 / len(text)),
                          color="black" if mesh.norm(value) > 0.5 else "white")
    for ticks, edges in ((axes.set_xticks, table.position_um), (axes.set_yticks, table.rate_um_per_s)):
        step = -(-len(edges) // 9)
        ticks(np.arange(len(edges))[::step], edge_names(edges)[::step])
    axes.set(xlabel=LABELS["position_um"], ylabel=LABELS["rate_um_per_s"])
    figure.colorbar(mesh, ax=axes, label="residual [µm rms]", pad=0.02)
    return figure


def worst_part(residual_um: np.ndarray) -> slice:
    """The part of a recording that is shown once more: where its residual is worst."""
    length = max(2, min(len(residual_um), max(COLUMNS // 2, int(ZOOM * len(residual_um)))))
    energy = np.cumsum(np.r_[0.0, (residual_um - np.mean(residual_um))**2])
    start = int(np.argmax(energy[length:] - energy[:-length]))
    return slice(start, start + length)


def worst_strokes(run: Recording, residual_um: np.ndarray) -> slice:
    """The STROKES in the worst part of which most is missed, or all of that part: more would cover one another."""
    part = worst_part(residual_um)
    turns = part.start + turning_points(run.command_V[part])
    if len(turns) <= STROKES + 1:
        return part
    energy = np.cumsum(np.r_[0.0, (residual_um - np.mean(residual_um))**2])
    first, last = turns[:-STROKES], turns[STROKES:]
    worst = int(np.argmax((energy[last] - energy[first]) / (last - first)))
    return slice(int(first[worst]), int(last[worst]) + 1)


def residual_figure(run: Recording, residuals_um: Mapping[str, np.ndarray], noise_um: float) -> Figure:
    """One residual or two, by name, over all of a run, and once more where the first is worst; means removed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDE[0], 1.2 * WIDE[1]), layout="constrained")
    panels = figure.subplots(2, 1)
    time_s = run.time_s - run.time_s[0]
    for axes, part in zip(panels, (slice(None), worst_part(next(iter(residuals_um.values()))))):
        for colour, (label, residual) in zip((NOW, AFTER), residuals_um.items()):
            band(axes, time_s[part], (residual - np.mean(residual))[part], colour, label)
        for side in (-1, 1):
            axes.axhline(side * noise_um, color=INK, lw=0.8, ls=":", label="noise, ±1 rms" if side > 0 else None)
        axes.set(ylabel="residual [µm]", xlim=(time_s[part][0], time_s[part][-1]))
    panels[1].set_xlabel(LABELS["time_s"])
    legend(panels[0])
    return figure


def time_figure(run: Recording, residuals_um: Mapping[str, np.ndarray]) -> Figure:
    """Measured and predicted where the first residual is worst, mean errors removed."""
    figure, axes = panel()
    part = worst_strokes(run, next(iter(residuals_um.values())))
    time_s = (run.time_s - run.time_s[0])[part]
    axes.plot(time_s, run.displacement_um[part], color=INK, lw=3.5, alpha=0.6, label="measured")
    for label, predicted, look in _predicted(run, residuals_um, means=False):
        axes.plot(time_s, predicted[part], label=label, **look)
    axes.set(xlabel=LABELS["time_s"], ylabel="displacement [µm]", xlim=(time_s[0], time_s[-1]))
    legend(axes)
    return figure


def loop_figure(run: Recording, residuals_um: Mapping[str, np.ndarray]) -> Figure:
    """One wide cycle measured and predicted, and below it what is missed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=LOOP, layout="constrained")
    loop, miss = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    cycle = last_cycle(run.command_V)
    command = run.command_V[cycle]
    part = thin(len(command))
    loop.plot(command[part], run.displacement_um[cycle][part], color=INK, lw=3.5, alpha=0.6, label="measured")
    for label, predicted, look in _predicted(run, residuals_um, means=True):
        loop.plot(command[part], predicted[cycle][part], label=label, **look)
    for colour, residual in zip((NOW, AFTER), residuals_um.values()):
        miss.plot(command[part], residual[cycle][part], color=colour, lw=0.9)
    loop.set(ylabel="displacement [µm]")
    miss.set(xlabel="command [V]", ylabel="missed [µm]")
    legend(loop)
    return figure


def _predicted(run: Recording, residuals_um: Mapping[str, np.ndarray], means: bool
               ) -> Iterator[tuple[str, np.ndarray, dict[str, Any]]]:
    """Name, prediction and look of each side, the last one first; with `means`, their errors' means are left in."""
    sides = list(zip(residuals_um.items(), (NOW, AFTER)))
    for ((label, residual), colour), dash in zip(sides[::-1], ("-", "--")):
        yield label, run.displacement_um - residual + (0.0 if means else np.mean(residual)), {"color": colour, "lw": 1,
                                                                                            "ls": dash}


def band(axes: Axes, time_s: np.ndarray, values: np.ndarray, colour: str, label: str) -> None:
    """A curve, or of a long one the span between its extremes in each column of the picture: peaks stay."""
    per_column = len(values) // COLUMNS
    if per_column < 2:
        axes.plot(time_s, values, color=colour, lw=0.9, label=label)
        return
    first = np.arange(0, len(values), per_column)
    axes.fill_between(time_s[first], np.minimum.reduceat(values, first), np.maximum.reduceat(values, first),
                      color=colour, lw=0.4, alpha=0.85, label=label)


def counting(axis: Axis) -> None:
    """Labels at whole numbers only."""
    axis.get_major_locator().set_params(integer=True)
    axis.set_major_formatter(interactive.WHOLE)


def logarithmic(axes: Axes) -> None:
    """Two labels or more on each axis with a logarithmic scale, also where it reaches over less than two powers of ten."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() != "log":
            continue
        low, high = axis.get_view_interval()
        for locator in (axis.get_major_locator(), LogLocator(subs=(1, 2, 5)), LogLocator(subs=range(1, 10)), MaxNLocator(4)):
            ticks = locator.tick_values(low, high)
            if np.count_nonzero((ticks >= low) & (ticks <= high)) > 1:
                break
        if locator is not axis.get_major_locator():
            axis.set_major_locator(locator)
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())


def legend(axes: Axes) -> None:
    """Above the panel, where it covers nothing."""
    count = len(axes.get_legend_handles_labels()[1])
    if count > 1:
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncol=2 if count == 4 else count, fontsize="small",
                    borderaxespad=0.2, columnspacing=1.2, handlelength=1.4)


def style() -> Any:
    from matplotlib import rc_context

    return rc_context(STYLE)


UNDATED = {"svg": {"Date": None, "Creator": None}, "pdf": {"CreationDate": None, "Creator": None, "Producer": None}}
MEDIA = {"svg": "image/svg+xml", "pdf": "application/pdf"}


def source(figure: Figure, form: str = "svg") -> str:
    """A picture as the data URI of an SVG or a PDF; the same bytes for the same picture."""
    data = io.BytesIO()
    with whatever_letters():
        figure.savefig(data, format=form, metadata=UNDATED[form])
    return f"data:{MEDIA[form]};base64,{base64.b64encode(data.getvalue()).decode()}"
